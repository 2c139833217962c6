//! Calls of standard functions: conversions, operators in functional form, and the rest.

use crate::check::calls::mixed_arguments;
use crate::check::expr::error_expr;
use crate::check::stdfun::{self, Signature, StdFun};
use crate::check::tree::{Expr, ExprKind, Limits};
use crate::check::{Checker, Declared, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{Arg, BinOp, UnOp};
use crate::types::{Elem, TypeId, TypeKind};

fn operator(name: &str) -> Option<BinOp> {
    Some(match name {
        "ADD" | "ADD_TIME" | "ADD_LTIME" | "ADD_TOD_TIME" | "ADD_LTOD_LTIME" | "ADD_DT_TIME"
        | "ADD_LDT_LTIME" => BinOp::Add,
        "SUB" | "SUB_TIME" | "SUB_LTIME" | "SUB_DATE_DATE" | "SUB_LDATE_LDATE" | "SUB_TOD_TIME"
        | "SUB_LTOD_LTIME" | "SUB_TOD_TOD" | "SUB_LTOD_LTOD" | "SUB_DT_TIME" | "SUB_LDT_LTIME"
        | "SUB_DT_DT" | "SUB_LDT_LDT" => BinOp::Sub,
        "MUL" | "MUL_TIME" | "MUL_LTIME" | "MULTIME" => BinOp::Mul,
        "DIV" | "DIV_TIME" | "DIV_LTIME" | "DIVTIME" => BinOp::Div,
        "MOD" => BinOp::Mod,
        "EXPT" => BinOp::Pow,
        "AND" => BinOp::And,
        "OR" => BinOp::Or,
        "XOR" => BinOp::Xor,
        "GT" => BinOp::Gt,
        "GE" => BinOp::Ge,
        "EQ" => BinOp::Eq,
        "LE" => BinOp::Le,
        "LT" => BinOp::Lt,
        "NE" => BinOp::Ne,
        _ => return None,
    })
}

/// How a conversion function treats its argument.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    Round,
    Truncate,
}

impl Checker<'_> {
    /// The call of a standard function, or `None` if there is none of this name.
    pub(super) fn standard_call(
        &mut self,
        name: &str,
        args: &[Arg],
        expected: Option<TypeId>,
        span: Span,
    ) -> Option<Expr> {
        let upper = key(name);
        if let Some(op) = operator(&upper) {
            return Some(self.operator_call(&upper, op, args, expected, span));
        }
        if upper == "NOT" || upper == "MOVE" {
            let Some(list) = self.collect_args(&upper, &["IN"], false, args, expected, span) else {
                return Some(error_expr(span));
            };
            let inner = list.into_iter().next()?;
            return Some(if upper == "NOT" {
                self.unary(UnOp::Not, inner, span)
            } else {
                inner
            });
        }
        match upper.as_str() {
            "REF" | "ADR" | "SIZEOF" => return Some(self.address_call(&upper, args, span)),
            "LOWER_BOUND" | "UPPER_BOUND" => return Some(self.bound_call(&upper, args, span)),
            "TO_LITTLE_ENDIAN" | "FROM_LITTLE_ENDIAN" => {
                let list = self.collect_args(&upper, &["IN"], false, args, expected, span);
                return Some(match list.and_then(|l| l.into_iter().next()) {
                    Some(inner) => inner,
                    None => error_expr(span),
                });
            }
            "__NEW" | "__DELETE" => {
                self.report(
                    Problem::error(
                        "E109",
                        span,
                        format!("{upper} (memory from a heap) is not supported"),
                    )
                    .hint("declare the variable, or an array of as many as are needed"),
                );
                return Some(error_expr(span));
            }
            _ => {}
        }
        // Typed names of overloaded functions: ADD_INT, LEN_STRING and their like are not of the standard.
        if let Some(fun) = StdFun::from_name(&upper) {
            return Some(self.function(fun, &upper, args, expected, span));
        }
        self.conversion(&upper, args, span)
    }

    /// Arguments in the order of the parameters. `open` allows more than are named: IN3, IN4, ...
    pub(super) fn collect_args(
        &mut self,
        name: &str,
        parameters: &[&str],
        open: bool,
        args: &[Arg],
        expected: Option<TypeId>,
        span: Span,
    ) -> Option<Vec<Expr>> {
        let formal = args.iter().filter(|a| a.name.is_some()).count();
        if formal != 0 && formal != args.len() {
            self.report(mixed_arguments(span));
            return None;
        }
        let mut slots: Vec<Option<Expr>> = Vec::new();
        for (index, arg) in args.iter().enumerate() {
            let position = match &arg.name {
                None => index,
                Some(given) => {
                    let known = parameters
                        .iter()
                        .position(|p| p.eq_ignore_ascii_case(&given.name));
                    let numbered = || {
                        let last = parameters.last()?;
                        let first: usize = last.strip_prefix("IN")?.parse().ok()?;
                        let number: usize = key(&given.name).strip_prefix("IN")?.parse().ok()?;
                        (open && number >= first && number < first + 64)
                            .then(|| number - first + parameters.len() - 1)
                    };
                    match known.or_else(numbered) {
                        Some(position) => position,
                        None => {
                            let message = format!("{name} has no parameter `{}`", given.name);
                            self.report(
                                Problem::error("E409", given.span, message)
                                    .expected(format!("one of {}", parameters.join(", "))),
                            );
                            return None;
                        }
                    }
                }
            };
            let Some(value) = &arg.value else {
                self.report(Problem::error("E411", span, "an argument has no value"));
                return None;
            };
            let typed = self.expr(value, expected);
            if position >= 4096 {
                self.report(Problem::error("E411", span, "too many arguments"));
                return None;
            }
            if slots.len() <= position {
                slots.resize(position + 1, None);
            }
            slots[position] = Some(typed);
        }
        let count = slots.len();
        let enough = count >= parameters.len() && (open || count == parameters.len());
        let list: Option<Vec<Expr>> = slots.into_iter().collect();
        match list {
            Some(list) if enough => {
                let broken = list.iter().any(|e| e.ty == TypeId::ERROR);
                (!broken).then_some(list)
            }
            _ => {
                let more = if open { " or more" } else { "" };
                let message = format!(
                    "{name} takes {}{more} argument{}",
                    parameters.len(),
                    if parameters.len() == 1 { "" } else { "s" }
                );
                let problem = Problem::error("E411", span, message);
                self.report(if parameters.is_empty() {
                    problem
                } else {
                    problem.expected(format!(
                        "{name}({}{})",
                        parameters.join(", "),
                        if open { ", ..." } else { "" }
                    ))
                });
                None
            }
        }
    }

    fn operator_call(
        &mut self,
        name: &str,
        op: BinOp,
        args: &[Arg],
        expected: Option<TypeId>,
        span: Span,
    ) -> Expr {
        let open = matches!(
            op,
            BinOp::Add | BinOp::Mul | BinOp::And | BinOp::Or | BinOp::Xor
        ) || (op.is_comparison() && op != BinOp::Ne);
        let expected = if op.is_comparison() { None } else { expected };
        let Some(list) = self.collect_args(name, &["IN1", "IN2"], open, args, expected, span)
        else {
            return error_expr(span);
        };
        if op.is_comparison() {
            // GT(a, b, c) is (a > b) AND (b > c).
            let mut all: Option<Expr> = None;
            for pair in list.windows(2) {
                let one = self.binary(op, pair[0].clone(), pair[1].clone(), span);
                all = Some(match all {
                    None => one,
                    Some(before) => self.binary(BinOp::And, before, one, span),
                });
            }
            return all.unwrap_or_else(|| error_expr(span));
        }
        let mut list = list.into_iter();
        let mut result = list.next().unwrap_or_else(|| error_expr(span));
        for next in list {
            result = self.binary(op, result, next, span);
        }
        result
    }

    fn function(
        &mut self,
        fun: StdFun,
        name: &str,
        args: &[Arg],
        expected: Option<TypeId>,
        span: Span,
    ) -> Expr {
        let signature = fun.signature();
        let open =
            matches!(signature, Signature::Extensible | Signature::Mux) || fun == StdFun::Concat;
        let pass = match signature {
            Signature::Sel | Signature::Extensible | Signature::Limit | Signature::Mux => expected,
            _ => None,
        };
        let Some(list) = self.collect_args(name, fun.parameters(), open, args, pass, span) else {
            return error_expr(span);
        };
        match signature {
            Signature::Text => self.text_function(fun, name, list, expected, span),
            Signature::Sel | Signature::Mux | Signature::Extensible | Signature::Limit
                if list.last().is_some_and(|e| self.types.text(e.ty).is_some()) =>
            {
                self.choose_text(fun, name, list, span)
            }
            Signature::Swap => {
                let inner = list.into_iter().next().unwrap_or_else(|| error_expr(span));
                let inner = self.settle(inner);
                if !self
                    .types
                    .elem(inner.ty)
                    .is_some_and(|e| e.bits() >= 8 && !e.is_char() && e != Elem::Ref)
                {
                    return self.wrong_argument(name, &inner, "a number or bit string");
                }
                let ty = inner.ty;
                self.standard(fun, vec![inner], ty, span)
            }
            Signature::Num => {
                self.uniform(fun, name, list, 0, expected, span, Elem::is_num, "a number")
            }
            Signature::Real | Signature::Real2 => {
                let list: Vec<Expr> = list
                    .into_iter()
                    .map(|e| self.as_real(e, expected))
                    .collect();
                self.uniform(
                    fun,
                    name,
                    list,
                    0,
                    expected,
                    span,
                    Elem::is_real,
                    "REAL or LREAL",
                )
            }
            Signature::Shift => self.shift(fun, name, list, expected, span),
            Signature::Sel => {
                let mut list = list.into_iter();
                let selector = list.next().unwrap_or_else(|| error_expr(span));
                let selector = self.coerce(selector, TypeId::BOOL);
                let list = std::iter::once(selector).chain(list).collect();
                self.uniform(
                    fun,
                    name,
                    list,
                    1,
                    expected,
                    span,
                    |_| true,
                    "elementary values",
                )
            }
            Signature::Mux => {
                let mut list = list.into_iter();
                let selector = list.next().unwrap_or_else(|| error_expr(span));
                let selector = self.settle(selector);
                let selector = self.coerce(selector, TypeId::of(Elem::Lint));
                let list = std::iter::once(selector).chain(list).collect();
                self.uniform(
                    fun,
                    name,
                    list,
                    1,
                    expected,
                    span,
                    |_| true,
                    "elementary values",
                )
            }
            Signature::Extensible | Signature::Limit => self.uniform(
                fun,
                name,
                list,
                0,
                expected,
                span,
                |_| true,
                "elementary values",
            ),
            Signature::Trunc => {
                let inner = list.into_iter().next().unwrap_or_else(|| error_expr(span));
                let wanted = expected
                    .and_then(|t| self.types.elem(t))
                    .filter(|e| e.is_int());
                let inner = self.settle(inner);
                let to = wanted.unwrap_or(match self.types.elem(inner.ty) {
                    Some(Elem::Lreal) => Elem::Lint,
                    _ => Elem::Dint,
                });
                self.truncate(inner, to, span)
            }
            Signature::Validity => {
                let inner = list.into_iter().next().unwrap_or_else(|| error_expr(span));
                let inner = self.settle(inner);
                if !self.types.elem(inner.ty).is_some_and(Elem::is_real) {
                    return self.wrong_argument(name, &inner, "REAL or LREAL");
                }
                self.standard(fun, vec![inner], TypeId::BOOL, span)
            }
            Signature::Time => Expr {
                kind: ExprKind::Std(fun, Vec::new()),
                ty: TypeId::TIME,
                span,
            },
        }
    }

    /// Integers and literals become reals, as the implicit conversions allow.
    fn as_real(&mut self, expr: Expr, expected: Option<TypeId>) -> Expr {
        let wanted = expected
            .and_then(|t| self.types.elem(t))
            .filter(|e| e.is_real())
            .unwrap_or(Elem::Lreal);
        if matches!(expr.ty, TypeId::UNTYPED_INT | TypeId::UNTYPED_REAL) {
            return self.coerce(expr, TypeId::of(wanted));
        }
        match self.types.elem(expr.ty) {
            Some(e) if e.is_int() && !self.types.is_enum(expr.ty) => match e.common(Elem::Real) {
                Some(real) => self.coerce(expr, TypeId::of(real)),
                None => expr,
            },
            _ => expr,
        }
    }

    pub(super) fn wrong_argument(&mut self, name: &str, expr: &Expr, expected: &str) -> Expr {
        let message = format!("{name} does not apply to {}", self.type_name(expr.ty));
        self.report(Problem::error("E306", expr.span, message).expected(expected));
        error_expr(expr.span)
    }

    /// A function whose arguments from number `skip` on have one type, which is the type of the result.
    #[allow(clippy::too_many_arguments)]
    fn uniform(
        &mut self,
        fun: StdFun,
        name: &str,
        list: Vec<Expr>,
        skip: usize,
        expected: Option<TypeId>,
        span: Span,
        fits: fn(Elem) -> bool,
        wanted: &str,
    ) -> Expr {
        if list.iter().any(|e| e.ty == TypeId::ERROR) {
            return error_expr(span);
        }
        let Some(ty) = self.common_type(&list[skip..], expected) else {
            let names: Vec<String> = list[skip..].iter().map(|e| self.type_name(e.ty)).collect();
            let message = format!(
                "the arguments of {name} have no common type: {}",
                names.join(", ")
            );
            self.report(Problem::error("E306", span, message).expected(wanted));
            return error_expr(span);
        };
        let elem = self.types.elem(ty);
        if !elem.is_some_and(fits) {
            let first = list[skip].clone();
            return self.wrong_argument(name, &first, wanted);
        }
        let list: Vec<Expr> = list
            .into_iter()
            .enumerate()
            .map(|(i, e)| if i < skip { e } else { self.coerce(e, ty) })
            .collect();
        self.standard(fun, list, ty, span)
    }

    /// The type that all of these widen to; literals follow the others, or `expected`.
    fn common_type(&mut self, list: &[Expr], expected: Option<TypeId>) -> Option<TypeId> {
        let untyped = |t: TypeId| matches!(t, TypeId::UNTYPED_INT | TypeId::UNTYPED_REAL);
        let mut common: Option<TypeId> = None;
        for expr in list.iter().filter(|e| !untyped(e.ty)) {
            common = Some(match common {
                None => expr.ty,
                Some(before) if self.types.same(before, expr.ty) => before,
                Some(before) => {
                    if self.types.is_enum(before) || self.types.is_enum(expr.ty) {
                        return None;
                    }
                    let (a, b) = (self.types.elem(before)?, self.types.elem(expr.ty)?);
                    TypeId::of(a.common(b).or_else(|| self.liberal_common(a, b))?)
                }
            });
        }
        let Some(common) = common else {
            let wanted = expected
                .and_then(|t| self.types.elem(t))
                .filter(|e| e.is_num());
            let real = list.iter().any(|e| e.ty == TypeId::UNTYPED_REAL);
            let settled = list.first().map(|e| self.settle(e.clone()).ty)?;
            return Some(match wanted {
                Some(e) if e.is_real() || !real => TypeId::of(e),
                _ if real => TypeId::of(Elem::Lreal),
                _ => settled,
            });
        };
        if let TypeKind::Subrange { base, .. } = self.types.kind(common) {
            return Some(TypeId::of(*base));
        }
        let mut common = common;
        // MAX(i, 1.5) and MAX(i, 100000): the literal may need a wider type.
        for expr in list.iter().filter(|e| untyped(e.ty)) {
            if self.types.is_enum(common) {
                continue;
            }
            let elem = self.types.elem(common)?;
            if expr.ty == TypeId::UNTYPED_REAL && elem.is_int() {
                common = TypeId::of(elem.common(Elem::Real)?);
            } else if let ExprKind::Const(v) = &expr.kind
                && expr.ty == TypeId::UNTYPED_INT
                && elem.is_int()
                && !v.fits(elem)
            {
                let settled = self.settle(expr.clone()).ty;
                common = TypeId::of(elem.common(self.types.elem(settled)?)?);
            }
        }
        Some(common)
    }

    fn shift(
        &mut self,
        fun: StdFun,
        name: &str,
        list: Vec<Expr>,
        expected: Option<TypeId>,
        span: Span,
    ) -> Expr {
        let mut list = list.into_iter();
        let (Some(value), Some(count)) = (list.next(), list.next()) else {
            return error_expr(span);
        };
        let wanted = expected
            .and_then(|t| self.types.elem(t))
            .filter(|e| e.is_bit() && *e != Elem::Bool);
        let value = match (value.ty, wanted) {
            (TypeId::UNTYPED_INT, Some(e)) => self.coerce(value, TypeId::of(e)),
            _ => value,
        };
        let value = if self.is_liberal() {
            self.settle(value)
        } else {
            value
        };
        let elem = self.types.elem(value.ty);
        let is_bits = elem.is_some_and(|e| e.is_bit() && e != Elem::Bool);
        if !(is_bits || self.is_liberal() && elem.is_some_and(Elem::is_int)) {
            return self.wrong_argument(name, &value, "a bit string: BYTE, WORD, DWORD or LWORD");
        }
        let count = self.settle(count);
        let count = self.as_whole_number(count);
        if !self
            .types
            .elem(count.ty)
            .is_some_and(|e| e.is_int() && e.widens_to(Elem::Lint))
        {
            return self.wrong_argument(name, &count, "an integer number of places");
        }
        let count = self.coerce(count, TypeId::of(Elem::Lint));
        if let Some(shifted) = self.liberal_shift(fun, &value, &count, span) {
            return shifted;
        }
        let ty = value.ty;
        self.standard(fun, vec![value, count], ty, span)
    }

    /// The call itself; of constants its value.
    pub(super) fn standard(
        &mut self,
        fun: StdFun,
        args: Vec<Expr>,
        ty: TypeId,
        span: Span,
    ) -> Expr {
        if args.iter().any(|e| e.ty == TypeId::ERROR) {
            return error_expr(span);
        }
        let values: Option<Vec<_>> = args
            .iter()
            .map(|e| match &e.kind {
                ExprKind::Const(v) => Some(*v),
                _ => None,
            })
            .collect();
        if let (Some(values), Some(elem)) = (values, self.types.elem(ty)) {
            let result = stdfun::evaluate(fun, elem, &values);
            return self.folded(result, ty, span);
        }
        Expr {
            kind: ExprKind::Std(fun, args),
            ty,
            span,
        }
    }

    fn truncate(&mut self, inner: Expr, to: Elem, span: Span) -> Expr {
        if !self.types.elem(inner.ty).is_some_and(Elem::is_real) {
            return self.wrong_argument("TRUNC", &inner, "REAL or LREAL");
        }
        self.standard(StdFun::Trunc, vec![inner], TypeId::of(to), span)
    }

    /// `INT_TO_REAL(x)`, `TO_REAL(x)`, `REAL_TRUNC_INT(x)`, `TRUNC_INT(x)`, and the same with enumerations.
    fn conversion(&mut self, name: &str, args: &[Arg], span: Span) -> Option<Expr> {
        if let Some(result) = self.text_conversion(name, args, span) {
            return Some(result);
        }
        let (from, to, mode) = self.conversion_types(name)?;
        let Some(list) = self.collect_args(name, &["IN"], false, args, from, span) else {
            return Some(error_expr(span));
        };
        let inner = list.into_iter().next()?;
        let inner = match from {
            Some(from) => self.coerce(inner, from),
            None => self.settle(inner),
        };
        if inner.ty == TypeId::ERROR {
            return Some(error_expr(span));
        }
        let (Some(source), Some(target)) = (self.types.elem(inner.ty), self.types.elem(to)) else {
            return Some(self.wrong_argument(name, &inner, "an elementary value"));
        };
        if mode == Mode::Truncate {
            return Some(self.truncate(inner, target, span));
        }
        if !self.types.is_enum(inner.ty) && !self.types.is_enum(to) {
            let seen = Expr {
                ty: TypeId::of(source),
                ..inner.clone()
            };
            if let Some(converted) = self.liberal_conversion(seen, source, target, span) {
                return Some(Expr {
                    ty: to,
                    ..converted
                });
            }
        }
        let allowed = convertible(source, target)
            && (!self.types.is_enum(to) || source.is_int() || self.types.same(inner.ty, to));
        let bits_and_real =
            (source.is_bit() && target.is_real()) || (source.is_real() && target.is_bit());
        if !allowed && bits_and_real {
            self.report(
                Problem::warning(
                    "W711",
                    span,
                    format!("the standard has no conversion from {source} to {target}"),
                )
                .hint("what is converted is the number; between DWORD and REAL, and LWORD and LREAL, the standard transfers the bits"),
            );
            let seen = Expr {
                ty: TypeId::of(source),
                ..inner
            };
            let converted = self.bits_as_number(seen, source, target, span)?;
            return Some(Expr {
                ty: to,
                ..converted
            });
        }
        if !allowed {
            let problem = Problem::error(
                "E307",
                span,
                format!("there is no conversion from {source} to {target}"),
            );
            let problem = match (source, target) {
                (Elem::Time, _) => problem.hint("TIME_TO_LINT(t) gives nanoseconds, TIME_TO_DINT(t) milliseconds"),
                (_, Elem::Time) => problem.hint("LINT_TO_TIME(n) takes nanoseconds, DINT_TO_TIME(n) milliseconds; or multiply: T#1ms * n"),
                _ => problem,
            };
            self.report(problem);
            return Some(error_expr(span));
        }
        if let TypeKind::Enum { values, .. } = self.types.kind(to).clone()
            && !self.types.same(inner.ty, to)
        {
            let numbers: Vec<i64> = values.iter().map(|v| v.1).collect();
            let constant = match &inner.kind {
                ExprKind::Const(v) => Some(v.as_i128().unwrap_or(0)),
                _ => None,
            };
            if let Some(v) = constant
                && !numbers.iter().any(|n| i128::from(*n) == v)
            {
                let message = format!("{} has no value {v}", self.type_name(to));
                self.report(Problem::error("E318", span, message));
                return Some(error_expr(span));
            }
            let checked = match constant {
                Some(_) => inner,
                None => Expr {
                    ty: inner.ty,
                    span: inner.span,
                    kind: ExprKind::Check(Box::new(inner), Limits::Values(numbers)),
                },
            };
            let converted = self.convert(checked, target, span);
            return Some(Expr {
                ty: to,
                ..converted
            });
        }
        // Seen as its base type from here on.
        let inner = Expr {
            ty: TypeId::of(source),
            ..inner
        };
        let converted = self.convert(inner, target, span);
        Some(Expr {
            ty: to,
            ..converted
        })
    }

    fn conversion_types(&mut self, name: &str) -> Option<(Option<TypeId>, TypeId, Mode)> {
        for (prefix, mode) in [("TO_", Mode::Round), ("TRUNC_", Mode::Truncate)] {
            if let Some(to) = name
                .strip_prefix(prefix)
                .and_then(|to| self.scalar_type(to))
            {
                return Some((None, to, mode));
            }
        }
        for (middle, mode) in [("_TO_", Mode::Round), ("_TRUNC_", Mode::Truncate)] {
            for (at, _) in name.match_indices(middle) {
                let (from, to) = (&name[..at], &name[at + middle.len()..]);
                if let (Some(from), Some(to)) = (self.scalar_type(from), self.scalar_type(to)) {
                    return Some((Some(from), to, mode));
                }
            }
        }
        None
    }

    /// An elementary type or an enumeration of this name.
    pub(super) fn scalar_type(&mut self, name: &str) -> Option<TypeId> {
        if let Some(elem) = Elem::from_name(name) {
            return Some(TypeId::of(elem));
        }
        let Some(Declared::Type(index)) = self.lookup(name) else {
            return None;
        };
        let span = self.project.types[index].name.span;
        let ty = self.resolve_declared(index, span);
        self.types.elem(ty).map(|_| ty)
    }
}

/// Which explicit conversions exist.
fn convertible(from: Elem, to: Elem) -> bool {
    if from == to {
        return true;
    }
    match (from, to) {
        (Elem::Ref, _) | (_, Elem::Ref) => false,
        (Elem::Dt, Elem::Date | Elem::Tod) | (Elem::Date, Elem::Dt) => true,
        // Milliseconds, except LINT, which takes the nanoseconds.
        (Elem::Time, to) => to.is_num() || (to.is_bit() && to.bits() >= 32),
        (from, Elem::Time) => from.is_num() || (from.is_bit() && from.bits() >= 32),
        (Elem::Date | Elem::Tod | Elem::Dt, to) => to == Elem::Lint || to == Elem::Lword,
        (from, Elem::Date | Elem::Tod | Elem::Dt) => from == Elem::Lint || from == Elem::Lword,
        (Elem::Char | Elem::Wchar, to) => {
            to.is_char() || to.is_int() || (to.is_bit() && to != Elem::Bool)
        }
        (from, Elem::Char | Elem::Wchar) => from.is_int() || (from.is_bit() && from != Elem::Bool),
        (Elem::Real, _) if to.is_bit() => matches!(to, Elem::Dword | Elem::Lword),
        (Elem::Lreal, _) if to.is_bit() => to == Elem::Lword,
        (_, Elem::Real) if from.is_bit() => matches!(from, Elem::Dword),
        (_, Elem::Lreal) if from.is_bit() => from == Elem::Lword,
        _ => true,
    }
}
