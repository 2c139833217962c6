//! Expressions: types, implicit conversions, constants.

use crate::check::tree::{Expr, ExprKind, InitValue, Limits, Place, Root};
use crate::check::{Checker, Declared, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, UnOp};
use crate::types::{Elem, TypeId, TypeKind};
use crate::value::{self, Fault, Value};

pub(super) fn error_expr(span: Span) -> Expr {
    Expr {
        kind: ExprKind::Const(Value::Bool(false)),
        ty: TypeId::ERROR,
        span,
    }
}

pub(super) fn constant(value: Value, ty: TypeId, span: Span) -> Expr {
    Expr {
        kind: ExprKind::Const(value),
        ty,
        span,
    }
}

impl Checker<'_> {
    /// The typed expression. `expected` helps to tell enumerated values of one name apart and types the results of
    /// overloaded functions; the result need not have that type (see `coerce`). After an error the type is `ERROR`.
    pub(super) fn expr(&mut self, expr: &ast::Expr, expected: Option<TypeId>) -> Expr {
        let span = expr.span;
        match &expr.kind {
            ast::ExprKind::Int(v) => self.untyped_int(*v, span),
            ast::ExprKind::Real(v) => constant(Value::Lreal(*v), TypeId::UNTYPED_REAL, span),
            ast::ExprKind::Bool(b) => constant(Value::Bool(*b), TypeId::BOOL, span),
            ast::ExprKind::Time(ns) => constant(Value::Time(*ns), TypeId::TIME, span),
            ast::ExprKind::Date(elem, ns) => constant(
                Value::from_i128(*elem, i128::from(*ns)),
                TypeId::of(*elem),
                span,
            ),
            ast::ExprKind::Str(text) => self.text_literal(text, false, span),
            ast::ExprKind::WStr(text) => self.text_literal(text, true, span),
            ast::ExprKind::Null => constant(Value::Ref(0), TypeId::NULL, span),
            ast::ExprKind::Field(base, value)
                if self.enum_behind(base).is_some() && self.is_no_place(base) =>
            {
                let prefix = self.enum_behind(base).unwrap_or_else(|| value.clone());
                self.enum_value(&prefix, value, span)
            }
            ast::ExprKind::Typed(elem, inner) => self.typed_literal(*elem, inner, span),
            ast::ExprKind::EnumValue(ty, value) => self.enum_value(ty, value, span),
            ast::ExprKind::Name(name) => self.name(name, expected, span),
            ast::ExprKind::Direct(_)
            | ast::ExprKind::Field(..)
            | ast::ExprKind::Index(..)
            | ast::ExprKind::Deref(..)
            | ast::ExprKind::Partial(..)
            | ast::ExprKind::Bit(..) => match self.place(expr) {
                Some(place) => self.load(place),
                None => error_expr(span),
            },
            ast::ExprKind::Call(callee, args) => self.call_expr(callee, args, expected, span),
            ast::ExprKind::Unary(op, inner) => {
                let inner = self.expr(inner, expected);
                match (op, expected) {
                    (UnOp::Not, Some(ty)) => self.not_as(inner, ty, span),
                    _ => self.unary(*op, inner, span),
                }
            }
            ast::ExprKind::Binary(op, left, right) => {
                let pass = if op.is_comparison() { None } else { expected };
                let from_right = op.is_comparison() && self.may_be_enum_name(left)
                    || op.is_logic() && is_not_literal(left);
                let (l, r) = if from_right {
                    let r = self.expr(right, pass);
                    let l = self.expr(left, Some(r.ty));
                    (l, r)
                } else {
                    let l = self.expr(left, pass);
                    let by_left = op.is_comparison() || op.is_logic() && is_not_literal(right);
                    let hint = if by_left { Some(l.ty) } else { pass };
                    let r = self.expr(right, hint);
                    (l, r)
                };
                self.binary(*op, l, r, span)
            }
        }
    }

    /// `Color` in `Color.Red`, as CODESYS writes `Color#Red`.
    fn enum_behind(&mut self, base: &ast::Expr) -> Option<ast::Ident> {
        let name = match &base.kind {
            ast::ExprKind::Name(name) => name.clone(),
            ast::ExprKind::Field(outer, inner) => self.with_path(outer, inner)?,
            _ => return None,
        };
        let Some(Declared::Type(index)) = self.lookup(&name) else {
            return None;
        };
        let ty = self.resolve_declared(index, base.span);
        self.types.is_enum(ty).then_some(ast::Ident {
            name,
            span: base.span,
        })
    }

    fn is_no_place(&mut self, base: &ast::Expr) -> bool {
        match &base.kind {
            ast::ExprKind::Name(name) => self.find_var(name).is_none(),
            ast::ExprKind::Field(outer, _) => self.is_namespace(outer),
            _ => false,
        }
    }

    fn may_be_enum_name(&mut self, expr: &ast::Expr) -> bool {
        matches!(&expr.kind, ast::ExprKind::Name(n) if self.find_var(n).is_none())
    }

    pub(super) fn untyped_int(&mut self, v: i128, span: Span) -> Expr {
        let value = if let Ok(v) = i64::try_from(v) {
            Value::Int(v)
        } else if let Ok(v) = u64::try_from(v) {
            Value::Uint(v)
        } else {
            self.report(Problem::error(
                "E106",
                span,
                format!("{v} does not fit any integer type"),
            ));
            return error_expr(span);
        };
        constant(value, TypeId::UNTYPED_INT, span)
    }

    fn typed_literal(&mut self, elem: Elem, inner: &ast::Expr, span: Span) -> Expr {
        let inner = self.expr(inner, None);
        let typed = self.coerce(inner, TypeId::of(elem));
        Expr { span, ..typed }
    }

    fn enum_value(&mut self, ty_name: &ast::Ident, value: &ast::Ident, span: Span) -> Expr {
        let ty = self.resolve_name(ty_name);
        let (base, found, names) = match self.types.kind(ty) {
            TypeKind::Enum { base, values } => (
                *base,
                values
                    .iter()
                    .find(|(n, _)| n.eq_ignore_ascii_case(&value.name))
                    .map(|(_, v)| *v),
                values.iter().map(|(n, _)| n.clone()).collect::<Vec<_>>(),
            ),
            TypeKind::Error => return error_expr(span),
            _ => {
                let message = format!("`{}` is no enumeration", ty_name.name);
                self.report(Problem::error("E303", ty_name.span, message));
                return error_expr(span);
            }
        };
        match found {
            Some(v) => constant(Value::from_i128(base, i128::from(v)), ty, span),
            None => {
                let message = format!("{} has no value `{}`", self.type_name(ty), value.name);
                self.report(
                    Problem::error("E303", value.span, message)
                        .expected(format!("one of {}", names.join(", "))),
                );
                error_expr(span)
            }
        }
    }

    /// A variable, a constant, or the name of an enumerated value.
    pub(super) fn name(&mut self, name: &str, expected: Option<TypeId>, span: Span) -> Expr {
        if let Some(id) = self.find_var(name) {
            let var = self.var(id);
            let ty = var.ty;
            if ty == TypeId::ERROR {
                return error_expr(span);
            }
            if ty == TypeId::INFERRED {
                self.report(
                    Problem::error("E320", span, "this value is needed before it is computed")
                        .hint("a loop of connections needs a variable in it: write the value to one and read it from there"),
                );
                return error_expr(span);
            }
            if var.constant && !self.types.is_aggregate(ty) {
                return match &var.init {
                    Some(InitValue::Scalar(value)) => constant(*value, ty, span),
                    _ => error_expr(span),
                };
            }
            return self.load(Place {
                root: Root::Var(id),
                steps: Vec::new(),
                ty,
                span,
            });
        }
        let Some(found) = self.enum_values.get(&key(name)) else {
            self.unknown_name(name, span);
            return error_expr(span);
        };
        let wanted = expected.map(|e| self.types.get(e).same_as);
        let found = self.nearest(found);
        let chosen = match found.as_slice() {
            [one] => Some(*one),
            many => many.iter().copied().find(|(ty, _)| Some(*ty) == wanted),
        };
        let Some((ty, v)) = chosen else {
            let names: Vec<String> = found
                .iter()
                .map(|(ty, _)| format!("{}#{name}", self.type_name(*ty)))
                .collect();
            let message = format!("`{name}` is a value of several enumerations");
            self.report(Problem::error("E304", span, message).expected(names.join(" or ")));
            return error_expr(span);
        };
        let base = self.types.elem(ty).unwrap_or(Elem::Int);
        constant(Value::from_i128(base, i128::from(v)), ty, span)
    }

    pub(super) fn load(&mut self, place: Place) -> Expr {
        if !self.usable_whole(&place) {
            return error_expr(place.span);
        }
        Expr {
            ty: place.ty,
            span: place.span,
            kind: ExprKind::Load(Box::new(place)),
        }
    }

    /// Gives an untyped literal the type that it has without context: the smallest of INT, DINT, LINT, ULINT; or LREAL.
    pub(super) fn settle(&mut self, expr: Expr) -> Expr {
        match (expr.ty, &expr.kind) {
            (TypeId::UNTYPED_INT, ExprKind::Const(value)) => {
                let elem = [Elem::Int, Elem::Dint, Elem::Lint, Elem::Ulint]
                    .into_iter()
                    .find(|e| value.fits(*e))
                    .unwrap_or(Elem::Ulint);
                let value = Value::from_i128(elem, value.as_i128().unwrap_or(0));
                constant(value, TypeId::of(elem), expr.span)
            }
            (TypeId::UNTYPED_REAL, _) => Expr {
                ty: TypeId::of(Elem::Lreal),
                ..expr
            },
            _ => expr,
        }
    }

    /// The expression with its implicit conversion to `ty`, as in an assignment.
    pub(super) fn coerce(&mut self, expr: Expr, ty: TypeId) -> Expr {
        if expr.ty == TypeId::ERROR || ty == TypeId::ERROR {
            return error_expr(expr.span);
        }
        if self.types.same(expr.ty, ty) {
            return Expr { ty, ..expr };
        }
        if self.types.is_pointer(ty) {
            return self.as_pointer(expr, ty);
        }
        if self.types.is_pointer(expr.ty) && !self.types.is_ref(ty) {
            return self.pointer_as_number(expr, ty);
        }
        if self.types.is_ref(ty) {
            return self.coerce_reference(expr, ty);
        }
        if let Some(text) = self.coerce_text(&expr, ty) {
            return text;
        }
        let (from, to) = (self.types.elem(expr.ty), self.types.elem(ty));
        if let (ExprKind::Const(value), Some(to)) = (&expr.kind, to)
            && !self.types.is_enum(ty)
        {
            let value = *value;
            match expr.ty {
                TypeId::UNTYPED_INT => return self.coerce_literal(value, to, ty, expr.span),
                TypeId::UNTYPED_REAL if to.is_real() => {
                    let value = match to {
                        Elem::Real => Value::Real(value.as_f64() as f32),
                        _ => value,
                    };
                    return constant(value, ty, expr.span);
                }
                _ => {}
            }
        }
        let enums = self.types.is_enum(expr.ty) || self.types.is_enum(ty);
        if let (Some(from), Some(to), false) = (from, to, enums)
            && from.widens_to(to)
        {
            let span = expr.span;
            let widened = self.convert(expr, to, span);
            return self.within(widened, ty);
        }
        if let Some(narrowed) = self.narrow(&expr, ty) {
            return narrowed;
        }
        self.mismatch(&expr, ty);
        error_expr(expr.span)
    }

    /// A reference, NULL, or an instance where an interface is expected.
    fn coerce_reference(&mut self, expr: Expr, ty: TypeId) -> Expr {
        let fits = match (self.types.kind(ty), self.types.kind(expr.ty)) {
            _ if expr.ty == TypeId::NULL => true,
            (TypeKind::Ref(to), TypeKind::Ref(from)) => self.derives(*from, *to),
            // ADR gives what is wanted; what a pointer leads to later, nobody knows.
            (TypeKind::Ref(to), TypeKind::Pointer(from)) => {
                matches!(expr.kind, ExprKind::AddressOf(_)) && self.derives(*from, *to)
            }
            (TypeKind::Interface(id), TypeKind::FunctionBlock(pou)) => {
                let implements = self.implements(*pou, *id);
                if implements && let ExprKind::Load(place) = expr.kind.clone() {
                    let span = expr.span;
                    let address = self.address_of(*place, span);
                    return Expr { ty, ..address };
                }
                false
            }
            (TypeKind::Interface(to), TypeKind::Interface(from)) => {
                self.interface_extends(*from, *to)
            }
            _ => false,
        };
        if fits {
            return Expr { ty, ..expr };
        }
        self.mismatch(&expr, ty);
        error_expr(expr.span)
    }

    /// Checks a subrange: a constant now, anything else at run time.
    pub(super) fn within(&mut self, expr: Expr, ty: TypeId) -> Expr {
        let TypeKind::Subrange { lo, hi, .. } = *self.types.kind(ty) else {
            return Expr { ty, ..expr };
        };
        let span = expr.span;
        if let ExprKind::Const(value) = &expr.kind {
            let v = value.as_i128().unwrap_or(0);
            if v < lo || v > hi {
                let message = format!("{v} is outside {lo}..{hi}");
                self.report(
                    Problem::error("E302", span, message)
                        .expected(format!("a value of {}", self.type_name(ty))),
                );
                return error_expr(span);
            }
            return Expr { ty, ..expr };
        }
        Expr {
            kind: ExprKind::Check(Box::new(expr), Limits::Range(lo, hi)),
            ty,
            span,
        }
    }

    fn coerce_literal(&mut self, value: Value, to: Elem, ty: TypeId, span: Span) -> Expr {
        let v = value.as_i128().unwrap_or(0);
        if to.is_real() {
            return constant(Value::from_i128(to, v), ty, span);
        }
        if to.is_time() || to.is_char() {
            self.report(
                Problem::error(
                    "E302",
                    span,
                    format!(
                        "{v} is no {}",
                        match to {
                            Elem::Time => "duration",
                            Elem::Date => "date",
                            Elem::Tod => "time of day",
                            Elem::Dt => "date and time",
                            _ => "character",
                        }
                    ),
                )
                .expected(match to {
                    Elem::Time => "a TIME literal such as T#0s",
                    Elem::Date => "a DATE literal such as D#2024-02-29",
                    Elem::Tod => "a literal such as TOD#12:00:00",
                    Elem::Dt => "a literal such as DT#2024-02-29-12:00:00",
                    _ => "a literal such as 'A'",
                }),
            );
            return error_expr(span);
        }
        let (lo, hi) = to.limits().unwrap_or((0, 0));
        if v < lo || v > hi {
            let expected = if to == Elem::Bool {
                "TRUE or FALSE".to_owned()
            } else {
                format!("a value within {lo}..{hi}")
            };
            self.report(
                Problem::error("E302", span, format!("{v} does not fit {to}")).expected(expected),
            );
            return error_expr(span);
        }
        let converted = constant(Value::from_i128(to, v), ty, span);
        self.within(converted, ty)
    }

    pub(super) fn mismatch(&mut self, expr: &Expr, ty: TypeId) {
        let (have, want) = (self.type_name(expr.ty), self.type_name(ty));
        let mut problem = Problem::error(
            "E302",
            expr.span,
            format!("{have} cannot become {want} here"),
        )
        .expected(format!("a value of type {want}"));
        let narrow = match (self.types.elem(expr.ty), self.types.elem(ty)) {
            (Some(Elem::Time), Some(Elem::Lint)) => {
                Some("TIME_TO_LINT(...) gives nanoseconds".to_owned())
            }
            (Some(_), Some(_)) => {
                let from = if self.types.is_enum(expr.ty) || self.types.get(expr.ty).name.is_some()
                {
                    have.clone()
                } else {
                    self.types
                        .elem(expr.ty)
                        .map_or(have.clone(), |e| e.to_string())
                };
                Some(format!("convert it: {from}_TO_{want}(...)"))
            }
            _ if expr.ty == TypeId::UNTYPED_REAL => {
                Some(format!("convert it: LREAL_TO_{want}(...)"))
            }
            _ => match (self.types.text(expr.ty), self.types.text(ty)) {
                (Some((true, _)), Some((false, _))) if matches!(expr.kind, ExprKind::Text(_)) => {
                    Some("a STRING stands between single quotes: 'text'".to_owned())
                }
                (Some((false, _)), Some((true, _))) if matches!(expr.kind, ExprKind::Text(_)) => {
                    Some("a WSTRING stands between double quotes: \"text\"".to_owned())
                }
                (Some((wide, _)), Some(_)) if matches!(expr.kind, ExprKind::Load(_)) => {
                    let pair = if wide {
                        ("WSTRING", "STRING")
                    } else {
                        ("STRING", "WSTRING")
                    };
                    Some(format!("convert it: {}_TO_{}(...)", pair.0, pair.1))
                }
                _ => None,
            },
        };
        let narrow = narrow.filter(|_| !have.starts_with('(') && !want.starts_with('('));
        if expr.ty == TypeId::UNTYPED_INT || expr.ty == TypeId::VOID {
            // A literal or a function without result: there is nothing to convert.
        } else if let Some(hint) = narrow {
            problem = problem.hint(hint);
        }
        self.report(problem);
    }

    /// A conversion whose pair of types is known to exist; constants are converted now.
    pub(super) fn convert(&mut self, expr: Expr, to: Elem, span: Span) -> Expr {
        let Some(from) = self.types.elem(expr.ty) else {
            return error_expr(span);
        };
        if from == to {
            return Expr {
                ty: TypeId::of(to),
                ..expr
            };
        }
        if let ExprKind::Const(value) = &expr.kind {
            let result = value::convert(from, to, *value);
            return self.folded(result, TypeId::of(to), span);
        }
        Expr {
            kind: ExprKind::Convert(Box::new(expr)),
            ty: TypeId::of(to),
            span,
        }
    }

    pub(super) fn folded(&mut self, result: Result<Value, Fault>, ty: TypeId, span: Span) -> Expr {
        match result {
            Ok(value) => constant(value, ty, span),
            Err(fault) => {
                self.report(Problem::error(
                    "E318",
                    span,
                    format!("this constant cannot be worked out: {fault}"),
                ));
                error_expr(span)
            }
        }
    }
}

/// `NOT 16#0F`: its type is that of what stands beside it.
fn is_not_literal(expr: &ast::Expr) -> bool {
    let ast::ExprKind::Unary(UnOp::Not, inner) = &expr.kind else {
        return false;
    };
    matches!(inner.kind, ast::ExprKind::Int(_))
}
