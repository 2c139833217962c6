//! Indices of arrays.

use wasm_encoder::{Instruction as I, ValType};

use super::SiteKind;
use super::fun::{Fun, val};
use super::place::{Addr, Form};
use crate::check::tree::{Expr, ExprKind};
use crate::syntax::ast::BinOp;
use crate::types::Elem;

impl Fun<'_, '_> {
    /// An element of a located array of BOOL, bits side by side from `first` on. Answers whether something was pushed.
    pub fn bit_of_image(
        &mut self,
        indices: &[Expr],
        dims: &[(i64, i64)],
        first: u64,
        addr: &mut Addr,
    ) -> bool {
        let mut known = first as u32;
        let mut pushed = false;
        let mut weight = 1u32;
        for (index, bounds) in indices.iter().zip(dims).rev() {
            if let ExprKind::Const(value) = &index.kind {
                let at = value.as_i128().unwrap_or(0) - i128::from(bounds.0);
                known = known.wrapping_add((at as u32).wrapping_mul(weight));
            } else {
                self.index(index, *bounds, weight, &mut known);
                if pushed {
                    self.i(I::I32Add);
                }
                pushed = true;
            }
            weight = weight.saturating_mul((bounds.1 - bounds.0 + 1) as u32);
        }
        if !pushed {
            addr.offset += known / 8;
            addr.form = Form::ImageBit((known % 8) as u8);
            return false;
        }
        let number = self.new_local(ValType::I32);
        self.i(I::I32Const(known as i32));
        self.i(I::I32Add);
        self.i(I::LocalTee(number));
        self.i(I::I32Const(3));
        self.i(I::I32ShrU);
        addr.form = Form::ImageBitAt(number);
        true
    }

    /// Pushes `(index - low) * weight` after checking the bounds, or less than that, and the rest is added to `offset`.
    pub fn index(&mut self, index: &Expr, bounds: (i64, i64), weight: u32, offset: &mut u32) {
        let elem = self.elem(index.ty);
        let count = bounds.1 - bounds.0 + 1;
        let (least, most) = (i128::from(bounds.0), i128::from(bounds.1));
        if let Some((low, high)) = self.range_of(index)
            && low >= least
            && high <= most
        {
            let (inner, mut constant) = self.apart(index);
            let mut lowest = self.range_of(inner).map_or(-1, |(low, _)| low);
            let held = match &inner.kind {
                ExprKind::Load(place) => self
                    .ahead_of(place)
                    .and_then(|ahead| Some((self.local_of(place)?, i64::try_from(ahead).ok()?))),
                _ => None,
            };
            if let Some((_, ahead)) = held {
                constant += ahead;
                lowest -= i128::from(ahead);
            }
            let mut rest = bounds.0 - constant;
            if lowest >= 0 {
                rest = self.take_over(rest, weight, offset);
            }
            match held {
                Some((local, _)) => self.i(I::LocalGet(local)),
                None => self.expr(inner),
            }
            if val(self.elem(inner.ty)) == ValType::I64 {
                self.i(I::I32WrapI64);
            }
            self.subtract(rest);
            self.scale(weight);
            return;
        }
        self.expr(index);
        let kind = SiteKind::Index(bounds.0, bounds.1);
        // UDINT and LINT are checked in 64 bits, so that no wrapped value looks valid.
        let wide = matches!(elem, Elem::Udint | Elem::Lint);
        if elem == Elem::Udint {
            self.i(I::I64ExtendI32U);
        }
        let ty = if wide { ValType::I64 } else { ValType::I32 };
        let local = self.temp(ty);
        self.i(I::LocalTee(local));
        if wide {
            self.i(I::I64Const(bounds.0));
            self.i(I::I64Sub);
            self.i(I::I64Const(count));
            self.i(I::I64GeU);
            self.trap_if(kind, index.span, Some((local, Elem::Lint)));
            self.i(I::LocalGet(local));
            self.i(I::I32WrapI64);
        } else {
            self.subtract(bounds.0);
            self.i(I::I32Const(count as i32));
            self.i(I::I32GeU);
            self.trap_if(kind, index.span, Some((local, Elem::Dint)));
            self.i(I::LocalGet(local));
        }
        let rest = if bounds.0 > 0 {
            self.take_over(bounds.0, weight, offset)
        } else {
            bounds.0
        };
        self.subtract(rest);
        self.release(local);
        self.scale(weight);
    }

    /// An index that certainly does not wrap, as an expression that is never negative plus a constant.
    fn apart<'e>(&self, index: &'e Expr) -> (&'e Expr, i64) {
        if let ExprKind::Binary(op @ (BinOp::Add | BinOp::Sub), _, left, right) = &index.kind
            && let (Some((low, _)), Some(by)) = (self.range_of(left), self.only_value(right))
            && low >= 0
            && let Ok(by) = i64::try_from(by)
        {
            return (left, if *op == BinOp::Sub { -by } else { by });
        }
        (index, 0)
    }

    /// Takes `low * weight` off the offset, so that `low` need not be taken off an index that is never negative. Addresses do not wrap:
    /// answers what must be taken off the index all the same.
    fn take_over(&self, low: i64, weight: u32, offset: &mut u32) -> i64 {
        let moved = i64::from(*offset) - low.saturating_mul(i64::from(weight));
        match u32::try_from(moved) {
            Ok(moved) if moved <= i32::MAX as u32 => {
                *offset = moved;
                0
            }
            _ => low,
        }
    }

    fn subtract(&mut self, low: i64) {
        if low != 0 {
            self.i(I::I32Const(low as i32));
            self.i(I::I32Sub);
        }
    }

    pub fn scale(&mut self, weight: u32) {
        if weight.is_power_of_two() {
            if weight > 1 {
                self.i(I::I32Const(weight.trailing_zeros() as i32));
                self.i(I::I32Shl);
            }
        } else {
            self.i(I::I32Const(weight as i32));
            self.i(I::I32Mul);
        }
    }
}
