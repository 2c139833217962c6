//! Liberties that CODESYS takes with the standard, and that its programs use: bit strings are unsigned numbers and numbers are bit
//! strings, in operators, assignments, indices, shifts and conversions; dates are numbers of seconds, times of day of milliseconds.

use crate::check::expr::{constant, error_expr};
use crate::check::stdfun::StdFun;
use crate::check::tree::{Expr, ExprKind};
use crate::check::{Checker, Dialect};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{BinOp, UnOp};
use crate::types::{Elem, TypeId};
use crate::value::Value;

/// Nanoseconds in a second, for dates, and in a millisecond, for times of day.
const SECOND_NS: i64 = 1_000_000_000;
const MILLISECOND_NS: i64 = 1_000_000;

impl Checker<'_> {
    pub(super) fn is_liberal(&self) -> bool {
        self.options.dialect == Dialect::Codesys
    }

    /// Arithmetic and logic of CODESYS: bit strings are unsigned numbers, and numbers are bit strings.
    pub(super) fn liberal_binary(
        &mut self,
        op: BinOp,
        left: &Expr,
        right: &Expr,
        span: Span,
    ) -> Option<Expr> {
        if !self.is_liberal() {
            return None;
        }
        let (left, right) = (self.settle(left.clone()), self.settle(right.clone()));
        let (l, r) = (self.types.elem(left.ty)?, self.types.elem(right.ty)?);
        let plain = |e: Elem| (e.is_num() || e.is_bit()) && e != Elem::Bool;
        if !plain(l) || !plain(r) {
            return None;
        }
        let bits = l.bits().max(r.bits());
        let target = if op.is_logic() {
            if l.is_real() || r.is_real() {
                return None;
            }
            bit_string(bits)?
        } else if op == BinOp::Pow && !l.is_real() && !r.is_real() {
            if bits > 32 { Elem::Lreal } else { Elem::Real }
        } else {
            number_of_both(l, r)?
        };
        if op == BinOp::Mod && target.is_real() {
            return None;
        }
        let mut as_target = |e: Expr, from: Elem| {
            let seen = Expr {
                ty: TypeId::of(from),
                ..e
            };
            match self.liberal_conversion(seen.clone(), from, target, span) {
                Some(number) => number,
                None => self.convert(seen, target, span),
            }
        };
        let (a, b) = (as_target(left, l), as_target(right, r));
        Some(self.finish_binary(op, target, a, b, span))
    }

    /// Minus of an unsigned number or bit string, which makes a signed one, and NOT of an integer.
    pub(super) fn liberal_unary(
        &mut self,
        op: UnOp,
        inner: &Expr,
        elem: Elem,
        span: Span,
    ) -> Option<Expr> {
        if !self.is_liberal() || elem == Elem::Bool || !(elem.is_int() || elem.is_bit()) {
            return None;
        }
        let (meanwhile, back) = match op {
            UnOp::Neg => (signed((elem.bits() * 2).min(64))?, None),
            UnOp::Not => (bit_string(elem.bits())?, Some(elem)),
        };
        let seen = self.convert(inner.clone(), meanwhile, span);
        let result = self.unary(op, seen, span);
        Some(match back {
            Some(elem) => self.convert(result, elem, span),
            None => result,
        })
    }

    /// What CODESYS converts without being told: numbers and bit strings among each other, with a warning.
    pub(super) fn narrow(&mut self, expr: &Expr, ty: TypeId) -> Option<Expr> {
        if !self.is_liberal() {
            return None;
        }
        let (from, to) = (self.types.elem(expr.ty)?, self.types.elem(ty)?);
        let plain = |e: Elem| e.is_num() || e.is_bit() || e == Elem::Time;
        if !plain(from) || !plain(to) || (from.is_real() && to.is_bit()) {
            return None;
        }
        if !matches!(expr.kind, ExprKind::Const(_)) && from.bits() > to.bits() {
            self.report(
                Problem::warning(
                    "W710",
                    expr.span,
                    format!("{from} becomes {to} here and may lose digits"),
                )
                .hint(format!("say so: {from}_TO_{to}(...)")),
            );
        }
        let inner = Expr {
            ty: TypeId::of(from),
            ..expr.clone()
        };
        let converted = match self.liberal_conversion(inner.clone(), from, to, expr.span) {
            Some(number) => number,
            None => self.convert(inner, to, expr.span),
        };
        Some(self.within(converted, ty))
    }

    /// Conversions that mean something else than in the standard, or that it does not have.
    pub(super) fn liberal_conversion(
        &mut self,
        expr: Expr,
        from: Elem,
        to: Elem,
        span: Span,
    ) -> Option<Expr> {
        if !self.is_liberal() || from == to {
            return None;
        }
        let number = |e: Elem| e.is_num() || (e.is_bit() && e != Elem::Bool);
        match (from, to) {
            (from, to) if (from.is_bit() && to.is_real()) || (from.is_real() && to.is_bit()) => {
                self.bits_as_number(expr, from, to, span)
            }
            (Elem::Date | Elem::Dt | Elem::Tod, to) if number(to) => {
                let ns = self.convert(expr, Elem::Lint, span);
                let unit = constant(Value::Int(unit_ns(from)), TypeId::of(Elem::Lint), span);
                let count = self.finish_binary(BinOp::Div, Elem::Lint, ns, unit, span);
                Some(self.convert(count, to, span))
            }
            (from, Elem::Date | Elem::Dt | Elem::Tod) if number(from) => {
                let count = self.convert(expr, Elem::Lint, span);
                let unit = constant(Value::Int(unit_ns(to)), TypeId::of(Elem::Lint), span);
                let ns = self.finish_binary(BinOp::Mul, Elem::Lint, count, unit, span);
                if to == Elem::Date {
                    let moment = self.convert(ns, Elem::Dt, span);
                    return Some(self.convert(moment, Elem::Date, span));
                }
                Some(self.convert(ns, to, span))
            }
            _ => None,
        }
    }

    /// A bit string as an unsigned number, where a real is converted to or from it.
    pub(super) fn bits_as_number(
        &mut self,
        expr: Expr,
        from: Elem,
        to: Elem,
        span: Span,
    ) -> Option<Expr> {
        let whole = match (from, to) {
            (Elem::Bool, _) => Elem::Usint,
            (from, Elem::Bool) => {
                let zero = constant(Value::from_i128(from, 0), TypeId::of(from), span);
                return Some(self.finish_binary(BinOp::Ne, from, expr, zero, span));
            }
            (from, _) if from.is_bit() => unsigned(from.bits())?,
            _ => Elem::Lint,
        };
        let number = self.convert(expr, whole, span);
        Some(self.convert(number, to, span))
    }

    /// A bit string where a whole number is expected: an index, a number of places.
    pub(super) fn as_whole_number(&mut self, expr: Expr) -> Expr {
        if !self.is_liberal() || self.types.is_enum(expr.ty) {
            return expr;
        }
        match self.types.elem(expr.ty) {
            Some(elem) if elem.is_bit() && elem != Elem::Bool && elem.bits() < 64 => {
                match unsigned(elem.bits()) {
                    Some(whole) => {
                        let span = expr.span;
                        self.convert(expr, whole, span)
                    }
                    None => expr,
                }
            }
            _ => expr,
        }
    }

    /// SHL, SHR, ROL and ROR of an integer; SHR of a signed one keeps its sign.
    pub(super) fn liberal_shift(
        &mut self,
        fun: StdFun,
        value: &Expr,
        count: &Expr,
        span: Span,
    ) -> Option<Expr> {
        let elem = self.types.elem(value.ty)?;
        if !self.is_liberal() || !elem.is_int() || self.types.is_enum(value.ty) {
            return None;
        }
        let bits = bit_string(elem.bits())?;
        let value = Expr {
            ty: TypeId::of(elem),
            ..value.clone()
        };
        if fun == StdFun::Shr && elem.is_signed() {
            let ty = value.ty;
            return Some(self.standard(fun, vec![value, count.clone()], ty, span));
        }
        let seen = self.convert(value, bits, span);
        let shifted = self.standard(fun, vec![seen, count.clone()], TypeId::of(bits), span);
        if shifted.ty == TypeId::ERROR {
            return Some(error_expr(span));
        }
        Some(self.convert(shifted, elem, span))
    }

    /// The type that arguments of a bit string and a number have in common.
    pub(super) fn liberal_common(&self, a: Elem, b: Elem) -> Option<Elem> {
        let plain = |e: Elem| (e.is_num() || e.is_bit()) && e != Elem::Bool;
        (self.is_liberal() && plain(a) && plain(b))
            .then(|| number_of_both(a, b))
            .flatten()
    }
}

fn unit_ns(elem: Elem) -> i64 {
    if elem == Elem::Tod {
        MILLISECOND_NS
    } else {
        SECOND_NS
    }
}

fn bit_string(bits: u32) -> Option<Elem> {
    [Elem::Byte, Elem::Word, Elem::Dword, Elem::Lword]
        .into_iter()
        .find(|e| e.bits() == bits)
}

fn unsigned(bits: u32) -> Option<Elem> {
    Elem::ALL
        .into_iter()
        .find(|e| e.is_int() && e.bits() == bits && !e.is_signed())
}

fn signed(bits: u32) -> Option<Elem> {
    Elem::ALL
        .into_iter()
        .find(|e| e.is_int() && e.bits() == bits && e.is_signed())
}

/// The number type in which two numbers or bit strings meet.
fn number_of_both(l: Elem, r: Elem) -> Option<Elem> {
    let bits = l.bits().max(r.bits());
    if l.is_real() || r.is_real() {
        let wide = l == Elem::Lreal || r == Elem::Lreal || bits > 32;
        return Some(if wide { Elem::Lreal } else { Elem::Real });
    }
    let signed = l.is_signed() || r.is_signed();
    Elem::ALL
        .into_iter()
        .find(|e| e.is_int() && e.bits() == bits && e.is_signed() == signed)
}
