//! Conversions between elementary types; the counterpart of `value::convert`.

use wasm_encoder::{BlockType, Ieee32, Ieee64, Instruction as I, ValType};

use super::SiteKind;
use super::fun::{Fun, val};
use crate::calendar::DAY_NS;
use crate::check::tree::{Expr, ExprKind, Root};
use crate::source::Span;
use crate::syntax::ast::BinOp;
use crate::types::Elem;

impl Fun<'_, '_> {
    /// Turns the value on the stack from one type into another.
    pub fn convert(&mut self, from: Elem, to: Elem, span: Span) {
        if from == to {
            return;
        }
        if self.convert_time(from, to, span) {
            return;
        }
        match (from.is_real(), to.is_real()) {
            (true, true) => self.i(if to == Elem::Lreal {
                I::F64PromoteF32
            } else {
                I::F32DemoteF64
            }),
            (true, false) => self.real_to(from, to, span),
            (false, true) => self.as_real(from, to),
            (false, false) => self.between_integers(from, to),
        }
    }

    /// Dates, and durations as numbers of milliseconds. Answers whether it was one of these.
    fn convert_time(&mut self, from: Elem, to: Elem, span: Span) -> bool {
        match (from, to) {
            (Elem::Dt, Elem::Date | Elem::Tod) => {
                let local = self.temp(ValType::I64);
                self.i(I::LocalTee(local));
                // The remainder of a day, never negative.
                self.i(I::I64Const(DAY_NS));
                self.i(I::I64RemS);
                self.i(I::I64Const(DAY_NS));
                self.i(I::I64Add);
                self.i(I::I64Const(DAY_NS));
                self.i(I::I64RemS);
                if to == Elem::Date {
                    let rest = self.temp(ValType::I64);
                    self.i(I::LocalSet(rest));
                    self.i(I::LocalGet(local));
                    self.i(I::LocalGet(rest));
                    self.i(I::I64Sub);
                    self.release(rest);
                }
                self.release(local);
                true
            }
            (Elem::Time, to) if to != Elem::Lint => {
                if to.is_real() {
                    self.i(I::F64ConvertI64S);
                    self.i(I::F64Const(Ieee64::from(1e6)));
                    self.i(I::F64Div);
                    self.convert(Elem::Lreal, to, span);
                } else {
                    self.i(I::I64Const(1_000_000));
                    self.i(I::I64DivS);
                    self.convert(Elem::Lint, to, span);
                }
                true
            }
            (from, Elem::Time) if from != Elem::Lint => {
                if from.is_real() {
                    self.convert(from, Elem::Lreal, span);
                    self.i(I::F64Const(Ieee64::from(1e6)));
                    self.i(I::F64Mul);
                    self.i(I::F64Nearest);
                    self.whole_to_integer(Elem::Time, span);
                } else {
                    self.convert(from, Elem::Lint, span);
                    self.i(I::I64Const(1_000_000));
                    self.i(I::I64Mul);
                }
                true
            }
            _ => false,
        }
    }

    fn real_to(&mut self, from: Elem, to: Elem, span: Span) {
        if to == Elem::Bool {
            if from == Elem::Real {
                self.i(I::F64PromoteF32);
            }
            self.i(I::F64Const(Ieee64::from(0.0)));
            self.i(I::F64Ne);
            return;
        }
        if to.is_bit() {
            // The bits, not the number.
            self.canonical(from);
            if from == Elem::Real {
                self.i(I::I32ReinterpretF32);
                if val(to) == ValType::I64 {
                    self.i(I::I64ExtendI32U);
                }
            } else {
                self.i(I::I64ReinterpretF64);
            }
            return;
        }
        if from == Elem::Real {
            self.i(I::F64PromoteF32);
        }
        self.i(I::F64Nearest);
        self.whole_to_integer(to, span);
    }

    /// Makes a NaN on the stack the canonical one. The bits of a NaN differ between hosts, and they can be seen in memory
    /// and through bit strings only: arithmetic and comparisons treat all NaNs alike.
    pub fn canonical(&mut self, elem: Elem) {
        let (nan, at_least) = match elem {
            Elem::Real => (I::F32Const(Ieee32::new(0x7fc0_0000)), I::F32Ge),
            Elem::Lreal => (I::F64Const(Ieee64::new(0x7ff8_0000_0000_0000)), I::F64Ge),
            _ => return,
        };
        let local = self.temp(val(elem));
        self.i(I::LocalSet(local));
        let block = self.open(I::Block(BlockType::Empty));
        // Everything but a NaN is as large as itself; one flag tells, where equality needs two.
        self.i(I::LocalGet(local));
        self.i(I::LocalGet(local));
        self.i(at_least);
        self.expect(true);
        self.i(I::BrIf(self.label(block)));
        self.i(nan);
        self.i(I::LocalSet(local));
        self.close();
        self.i(I::LocalGet(local));
        self.release(local);
    }

    /// Whether the value is certainly no NaN, or the canonical one: then it need not be made so.
    pub fn is_canonical(&self, expr: &Expr) -> bool {
        if !self.elem(expr.ty).is_real() {
            return true;
        }
        match &expr.kind {
            // Cells hold canonical values; locals hold what was computed, and inputs what the field sends.
            ExprKind::Load(place) => {
                let in_image = match place.root {
                    Root::Direct(_) => true,
                    Root::Var(id) => self.m.project.var(id).location.is_some(),
                    Root::This => false,
                };
                !in_image && self.local_of(place).is_none()
            }
            _ => self.bound(expr).is_some(),
        }
    }

    /// A number that the absolute value of a real expression certainly does not exceed, rounding included.
    fn bound(&self, expr: &Expr) -> Option<f64> {
        let largest = match self.elem(expr.ty) {
            Elem::Real => f64::from(f32::MAX),
            Elem::Lreal => f64::MAX,
            _ => return None,
        };
        let bound = match &expr.kind {
            ExprKind::Const(value) => value.as_f64().abs(),
            ExprKind::Convert(inner) => {
                let from = self.elem(inner.ty);
                // Of a bit string the bits are taken.
                if !from.is_int() {
                    return None;
                }
                1.9e19
            }
            ExprKind::Binary(BinOp::Add | BinOp::Sub, _, left, right) => {
                self.bound(left)? + self.bound(right)?
            }
            ExprKind::Binary(BinOp::Mul, _, left, right) => {
                self.bound(left)? * self.bound(right)?
            }
            _ => return None,
        };
        // Half the range is more than all rounding takes.
        (bound <= largest / 2.0).then_some(bound)
    }

    /// Turns the whole f64 on the stack into an integer; traps if it does not fit.
    pub fn whole_to_integer(&mut self, to: Elem, span: Span) {
        let (lo, hi) = to.limits().unwrap_or((0, 0));
        let local = self.temp(ValType::F64);
        self.i(I::LocalTee(local));
        self.i(I::F64Const(Ieee64::from(lo as f64)));
        self.i(I::F64Ge);
        self.i(I::LocalGet(local));
        self.i(I::F64Const(Ieee64::from((hi + 1) as f64)));
        self.i(I::F64Lt);
        self.i(I::I32And);
        self.i(I::I32Eqz);
        self.trap_if(SiteKind::Conversion(to.name().to_owned()), span, None);
        self.i(I::LocalGet(local));
        self.release(local);
        let signed = to.is_signed() || to.is_time();
        self.i(match (val(to), signed) {
            (ValType::I64, true) => I::I64TruncF64S,
            (ValType::I64, false) => I::I64TruncF64U,
            (_, true) => I::I32TruncF64S,
            (_, false) => I::I32TruncF64U,
        });
    }

    fn as_real(&mut self, from: Elem, to: Elem) {
        if from.is_bit() && from != Elem::Bool {
            if to == Elem::Real {
                if val(from) == ValType::I64 {
                    self.i(I::I32WrapI64);
                }
                self.i(I::F32ReinterpretI32);
            } else {
                if val(from) == ValType::I32 {
                    self.i(I::I64ExtendI32U);
                }
                self.i(I::F64ReinterpretI64);
            }
            return;
        }
        let signed = from.is_signed() || from.is_time();
        self.i(match (val(from), to == Elem::Lreal, signed) {
            (ValType::I64, true, true) => I::F64ConvertI64S,
            (ValType::I64, true, false) => I::F64ConvertI64U,
            (ValType::I64, false, true) => I::F32ConvertI64S,
            (ValType::I64, false, false) => I::F32ConvertI64U,
            (_, true, true) => I::F64ConvertI32S,
            (_, true, false) => I::F64ConvertI32U,
            (_, false, true) => I::F32ConvertI32S,
            (_, false, false) => I::F32ConvertI32U,
        });
    }

    fn between_integers(&mut self, from: Elem, to: Elem) {
        let (wide_from, wide_to) = (val(from) == ValType::I64, val(to) == ValType::I64);
        if to == Elem::Bool {
            // The last bit of a bit string; whether an integer is not 0.
            if from.is_bit() {
                if wide_from {
                    self.i(I::I32WrapI64);
                }
                self.i(I::I32Const(1));
                self.i(I::I32And);
            } else if wide_from {
                self.i(I::I64Const(0));
                self.i(I::I64Ne);
            } else {
                self.i(I::I32Const(0));
                self.i(I::I32Ne);
            }
            return;
        }
        match (wide_from, wide_to) {
            (false, true) => self.i(if from.is_signed() {
                I::I64ExtendI32S
            } else {
                I::I64ExtendI32U
            }),
            (true, false) => {
                self.i(I::I32WrapI64);
                self.normalise(to);
            }
            (false, false) => {
                let (lo, hi) = from.limits().unwrap_or((0, 0));
                let (min, max) = to.limits().unwrap_or((0, 0));
                if lo < min || hi > max {
                    self.normalise(to);
                }
            }
            (true, true) => {}
        }
    }
}
