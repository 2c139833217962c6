//! Operators: which apply to which types, in which type they are computed, and their values for constants.

use crate::calendar::DAY_NS;
use crate::check::Checker;
use crate::check::expr::{constant, error_expr};
use crate::check::tree::{Expr, ExprKind};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{BinOp, UnOp};
use crate::types::{Elem, TypeId};
use crate::value::{self, Value};

impl Checker<'_> {
    pub(super) fn unary(&mut self, op: UnOp, inner: Expr, span: Span) -> Expr {
        if inner.ty == TypeId::ERROR {
            return error_expr(span);
        }
        if let (UnOp::Neg, ExprKind::Const(value)) = (op, &inner.kind) {
            match inner.ty {
                TypeId::UNTYPED_INT => {
                    let v = -value.as_i128().unwrap_or(0);
                    return self.untyped_int(v, span);
                }
                TypeId::UNTYPED_REAL => {
                    return constant(Value::Lreal(-value.as_f64()), TypeId::UNTYPED_REAL, span);
                }
                _ => {}
            }
        }
        let inner = self.settle(inner);
        let elem = self
            .types
            .elem(inner.ty)
            .filter(|_| !self.types.is_enum(inner.ty));
        let fits = elem.is_some_and(|e| match op {
            UnOp::Neg => e.is_signed() || e.is_real() || e == Elem::Time,
            UnOp::Not => e.is_bit(),
        });
        let (Some(elem), true) = (elem, fits) else {
            if let Some(result) = elem.and_then(|e| self.liberal_unary(op, &inner, e, span)) {
                return result;
            }
            let (text, expected) = match op {
                UnOp::Neg => ("-", "a signed integer, REAL, LREAL or TIME"),
                UnOp::Not => ("NOT", "BOOL or a bit string"),
            };
            let message = format!("`{text}` does not apply to {}", self.type_name(inner.ty));
            self.report(Problem::error("E305", span, message).expected(expected));
            return error_expr(span);
        };
        if let ExprKind::Const(v) = &inner.kind {
            let result = value::unary(op, elem, *v);
            return self.folded(result, TypeId::of(elem), span);
        }
        Expr {
            kind: ExprKind::Unary(op, Box::new(inner)),
            ty: TypeId::of(elem),
            span,
        }
    }

    /// NOT where a value of the type is expected, which a literal takes if it is one of bits: `NOT 16#0F`.
    pub(super) fn not_as(&mut self, inner: Expr, expected: TypeId, span: Span) -> Expr {
        let elem = self.types.elem(expected);
        let inner = match elem.filter(|e| e.is_bit() && *e != Elem::Bool) {
            Some(elem) if inner.ty == TypeId::UNTYPED_INT => self.coerce(inner, TypeId::of(elem)),
            _ => inner,
        };
        self.unary(UnOp::Not, inner, span)
    }

    pub(super) fn binary(&mut self, op: BinOp, left: Expr, right: Expr, span: Span) -> Expr {
        if left.ty == TypeId::ERROR || right.ty == TypeId::ERROR {
            return error_expr(span);
        }
        if self.types.is_pointer(left.ty) || self.types.is_pointer(right.ty) {
            return self.pointer_operator(op, left, right, span);
        }
        if self.types.is_ref(left.ty) || self.types.is_ref(right.ty) {
            return self.compare_references(op, left, right, span);
        }
        if let Some(compared) = self.compare_texts(op, &left, &right, span) {
            return compared;
        }
        if self.types.is_enum(left.ty) || self.types.is_enum(right.ty) {
            return self.compare_enums(op, left, right, span);
        }
        if let Some(dates) = self.date_arithmetic(op, &left, &right, span) {
            return dates;
        }
        if let Some(folded) = self.fold_untyped(op, &left, &right, span) {
            return folded;
        }
        if let Some(time) = self.time_arithmetic(op, &left, &right, span) {
            return time;
        }
        let Some(elem) = self.common_elem(op, &left, &right) else {
            return match self.liberal_binary(op, &left, &right, span) {
                Some(result) => result,
                None => self.operator_mismatch(op, &left, &right, span),
            };
        };
        let fits = match op {
            BinOp::Add | BinOp::Sub => elem.is_num() || elem == Elem::Time,
            BinOp::Mul | BinOp::Div => elem.is_num(),
            BinOp::Mod => elem.is_int(),
            BinOp::Pow => elem.is_real(),
            BinOp::And | BinOp::Or | BinOp::Xor => elem.is_bit(),
            _ => true,
        };
        if !fits {
            return match self.liberal_binary(op, &left, &right, span) {
                Some(result) => result,
                None => self.operator_mismatch(op, &left, &right, span),
            };
        }
        let left = self.coerce(left, TypeId::of(elem));
        let right = self.coerce(right, TypeId::of(elem));
        self.finish_binary(op, elem, left, right, span)
    }

    pub(super) fn finish_binary(
        &mut self,
        op: BinOp,
        elem: Elem,
        left: Expr,
        right: Expr,
        span: Span,
    ) -> Expr {
        if left.ty == TypeId::ERROR || right.ty == TypeId::ERROR {
            return error_expr(span);
        }
        let ty = if op.is_comparison() {
            TypeId::BOOL
        } else {
            TypeId::of(elem)
        };
        if let ExprKind::Const(r) = &right.kind {
            if let ExprKind::Const(l) = &left.kind {
                let result = value::binary(op, elem, *l, *r);
                return self.folded(result, ty, span);
            }
            if matches!(op, BinOp::Div | BinOp::Mod) && r.as_i128() == Some(0) {
                self.report(Problem::error("E318", right.span, "division by zero"));
                return error_expr(span);
            }
        }
        Expr {
            kind: ExprKind::Binary(op, elem, Box::new(left), Box::new(right)),
            ty,
            span,
        }
    }

    fn compare_references(&mut self, op: BinOp, left: Expr, right: Expr, span: Span) -> Expr {
        let fits = self.types.is_ref(left.ty) && self.types.is_ref(right.ty);
        if !fits || !matches!(op, BinOp::Eq | BinOp::Ne) {
            return self.operator_mismatch(op, &left, &right, span);
        }
        self.finish_binary(op, Elem::Ref, left, right, span)
    }

    /// Sums and differences of dates, times of day and durations (third edition, table 35).
    fn date_arithmetic(
        &mut self,
        op: BinOp,
        left: &Expr,
        right: &Expr,
        span: Span,
    ) -> Option<Expr> {
        let (l, r) = (self.types.elem(left.ty)?, self.types.elem(right.ty)?);
        let result = match (op, l, r) {
            (BinOp::Add, Elem::Tod | Elem::Dt, Elem::Time)
            | (BinOp::Sub, Elem::Tod | Elem::Dt, Elem::Time) => l,
            (BinOp::Sub, Elem::Date, Elem::Date)
            | (BinOp::Sub, Elem::Tod, Elem::Tod)
            | (BinOp::Sub, Elem::Dt, Elem::Dt) => Elem::Time,
            _ => return None,
        };
        let seen = |e: &Expr| seen_as(e.clone(), Elem::Time);
        let sum = self.finish_binary(op, Elem::Time, seen(left), seen(right), span);
        if sum.ty == TypeId::ERROR {
            return Some(sum);
        }
        let sum = if result == Elem::Tod {
            self.within_a_day(sum)
        } else {
            sum
        };
        Some(seen_as(sum, result))
    }

    /// A time of day goes on at midnight.
    fn within_a_day(&mut self, time: Expr) -> Expr {
        let span = time.span;
        let day = constant(Value::Int(DAY_NS), TypeId::of(Elem::Lint), span);
        let mut number = seen_as(time, Elem::Lint);
        for op in [BinOp::Mod, BinOp::Add, BinOp::Mod] {
            number = self.finish_binary(op, Elem::Lint, number, day.clone(), span);
        }
        number
    }

    fn compare_enums(&mut self, op: BinOp, left: Expr, right: Expr, span: Span) -> Expr {
        let same = self.types.same(left.ty, right.ty);
        if !same || !matches!(op, BinOp::Eq | BinOp::Ne) {
            return self.operator_mismatch(op, &left, &right, span);
        }
        let elem = self.types.elem(left.ty).unwrap_or(Elem::Int);
        self.finish_binary(op, elem, left, right, span)
    }

    /// Literals among themselves are computed exactly and stay literals.
    fn fold_untyped(&mut self, op: BinOp, left: &Expr, right: &Expr, span: Span) -> Option<Expr> {
        let untyped = |e: &Expr| matches!(e.ty, TypeId::UNTYPED_INT | TypeId::UNTYPED_REAL);
        let (ExprKind::Const(l), ExprKind::Const(r)) = (&left.kind, &right.kind) else {
            return None;
        };
        if !untyped(left) || !untyped(right) {
            return None;
        }
        let reals = left.ty == TypeId::UNTYPED_REAL || right.ty == TypeId::UNTYPED_REAL;
        if reals || op == BinOp::Pow {
            if matches!(op, BinOp::Mod) || op.is_logic() {
                return Some(self.operator_mismatch(op, left, right, span));
            }
            let (l, r) = (Value::Lreal(l.as_f64()), Value::Lreal(r.as_f64()));
            let ty = if op.is_comparison() {
                TypeId::BOOL
            } else {
                TypeId::UNTYPED_REAL
            };
            let result = value::binary(op, Elem::Lreal, l, r);
            return Some(self.folded(result, ty, span));
        }
        let (l, r) = (l.as_i128()?, r.as_i128()?);
        let value = match op {
            BinOp::Add => l.checked_add(r),
            BinOp::Sub => l.checked_sub(r),
            BinOp::Mul => l.checked_mul(r),
            BinOp::Div | BinOp::Mod if r == 0 => {
                self.report(Problem::error("E318", right.span, "division by zero"));
                return Some(error_expr(span));
            }
            BinOp::Div => l.checked_div(r),
            BinOp::Mod => l.checked_rem(r),
            BinOp::And => Some(l & r),
            BinOp::Or => Some(l | r),
            BinOp::Xor => Some(l ^ r),
            _ => {
                let order = l.cmp(&r);
                let truth = match op {
                    BinOp::Eq => order.is_eq(),
                    BinOp::Ne => order.is_ne(),
                    BinOp::Lt => order.is_lt(),
                    BinOp::Le => order.is_le(),
                    BinOp::Gt => order.is_gt(),
                    _ => order.is_ge(),
                };
                return Some(constant(Value::Bool(truth), TypeId::BOOL, span));
            }
        };
        Some(self.untyped_int(value.unwrap_or(i128::MAX), span))
    }

    /// TIME * number, number * TIME and TIME / number.
    fn time_arithmetic(
        &mut self,
        op: BinOp,
        left: &Expr,
        right: &Expr,
        span: Span,
    ) -> Option<Expr> {
        if !matches!(op, BinOp::Mul | BinOp::Div) {
            return None;
        }
        let is_time = |e: &Expr| self.types.elem(e.ty) == Some(Elem::Time);
        let (time, number) = match (is_time(left), is_time(right)) {
            (true, false) => (left.clone(), right.clone()),
            (false, true) if op == BinOp::Mul => (right.clone(), left.clone()),
            _ => return None,
        };
        let number = self.settle(number);
        let elem = self.types.elem(number.ty)?;
        let wide = if elem.is_real() {
            Elem::Lreal
        } else if elem.is_int() && elem.widens_to(Elem::Lint) {
            Elem::Lint
        } else {
            return Some(self.operator_mismatch(op, left, right, span));
        };
        let number = self.coerce(number, TypeId::of(wide));
        Some(self.finish_binary(op, Elem::Time, time, number, span))
    }

    /// The type in which both operands are computed.
    fn common_elem(&mut self, op: BinOp, left: &Expr, right: &Expr) -> Option<Elem> {
        let base = |e: &Expr| self.types.elem(e.ty);
        let elem = match (left.ty, right.ty) {
            (TypeId::UNTYPED_INT | TypeId::UNTYPED_REAL, _) => literal_with(left, base(right)?)?,
            (_, TypeId::UNTYPED_INT | TypeId::UNTYPED_REAL) => literal_with(right, base(left)?)?,
            _ => base(left)?.common(base(right)?)?,
        };
        // `**` is a matter of reals; integers become the real type that holds them.
        if op == BinOp::Pow && elem.is_int() {
            return elem.common(Elem::Real).or(Some(Elem::Lreal));
        }
        Some(elem)
    }

    pub(super) fn operator_mismatch(
        &mut self,
        op: BinOp,
        left: &Expr,
        right: &Expr,
        span: Span,
    ) -> Expr {
        let (l, r) = (self.type_name(left.ty), self.type_name(right.ty));
        let message = if l == r {
            format!("`{}` does not apply to {l}", op.text())
        } else {
            format!("`{}` does not apply to {l} and {r}", op.text())
        };
        let expected = match op {
            BinOp::Add | BinOp::Sub => "numbers, or two TIMEs",
            BinOp::Mul | BinOp::Div => "numbers, or a TIME and a number",
            BinOp::Mod => "integers",
            BinOp::Pow => "numbers",
            BinOp::And | BinOp::Or | BinOp::Xor => "BOOL or bit strings",
            _ if self.types.is_enum(left.ty) || self.types.is_enum(right.ty) => {
                "two values of one enumeration, compared with = or <>"
            }
            _ => "two elementary values of types that widen to one",
        };
        let mut problem = Problem::error("E305", span, message).expected(expected);
        let (le, re) = (self.types.elem(left.ty), self.types.elem(right.ty));
        let both = |f: fn(Elem) -> bool| le.is_some_and(f) || re.is_some_and(f);
        if op.is_logic() && both(Elem::is_int) {
            problem = problem.hint("convert integers to bit strings: INT_TO_WORD(...)");
        } else if !op.is_logic() && !op.is_comparison() && both(|e| e.is_bit() && e != Elem::Bool) {
            problem = problem.hint("convert bit strings to integers: WORD_TO_UINT(...)");
        } else if le.is_some_and(Elem::is_num) && re.is_some_and(Elem::is_num) {
            let of_enum = [(left.ty, le), (right.ty, re)]
                .into_iter()
                .find(|(ty, _)| self.types.is_enum(*ty));
            problem = problem.hint(match of_enum {
                Some((_, Some(base))) => format!("take its number: TO_{}(...)", base.name()),
                _ => format!("convert one of them explicitly: {l}_TO_{r}(...)"),
            });
        }
        self.report(problem);
        error_expr(span)
    }
}

/// The type in which a literal meets an operand of type `other`.
fn literal_with(literal: &Expr, other: Elem) -> Option<Elem> {
    let ExprKind::Const(value) = &literal.kind else {
        return None;
    };
    if literal.ty == TypeId::UNTYPED_REAL {
        return if other.is_real() {
            Some(other)
        } else if other.is_int() {
            other.common(Elem::Real)
        } else {
            None
        };
    }
    let v = value.as_i128()?;
    if other.is_real() {
        return Some(other);
    }
    let (lo, hi) = other.limits()?;
    if other.is_time() || other.is_char() || other == Elem::Ref {
        return None;
    }
    if (lo..=hi).contains(&v) {
        return Some(other);
    }
    if other.is_bit() && other != Elem::Bool {
        let wider = [Elem::Word, Elem::Dword, Elem::Lword];
        return wider.into_iter().find(|e| value.fits(*e));
    }
    if !other.is_int() {
        return None;
    }
    [Elem::Int, Elem::Dint, Elem::Lint, Elem::Ulint]
        .into_iter()
        .filter(|e| value.fits(*e))
        .find_map(|e| other.common(e))
}

/// The same 64 bits as a value of another type.
fn seen_as(expr: Expr, elem: Elem) -> Expr {
    let kind = match expr.kind {
        ExprKind::Const(v) => ExprKind::Const(Value::from_i128(elem, v.as_i128().unwrap_or(0))),
        kind => kind,
    };
    let ty = TypeId::of(elem);
    Expr { kind, ty, ..expr }
}
