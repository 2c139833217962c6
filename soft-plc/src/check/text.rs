//! Strings: literals, standard functions, comparisons, conversions; and the addresses of variables.

use std::sync::Arc;

use crate::check::Checker;
use crate::check::expr::{constant, error_expr};
use crate::check::stdfun::StdFun;
use crate::check::tree::{Expr, ExprKind, Place, Root, StepKind};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, Arg, BinOp, PouKind, VarSection};
use crate::types::{Elem, STRING_LEN_MAX, TypeId, TypeKind};
use crate::value::Value;

/// The longest text of an elementary value.
pub const VALUE_TEXT_MAX: u32 = 40;

impl Checker<'_> {
    /// A string literal. Characters of a STRING take one byte (ISO 8859-1), those of a WSTRING 16 bits.
    pub(super) fn text_literal(&mut self, text: &str, wide: bool, span: Span) -> Expr {
        let mut units = Vec::new();
        for c in text.chars() {
            let code = u32::from(c);
            if wide {
                let mut buffer = [0; 2];
                units.extend_from_slice(c.encode_utf16(&mut buffer));
            } else if code < 256 {
                units.push(code as u16);
            } else {
                let message = format!("`{c}` does not fit a character of a STRING");
                self.report(
                    Problem::error("E227", span, message)
                        .hint("write a WSTRING with double quotes, or another character"),
                );
                return error_expr(span);
            }
        }
        let len = units.len().max(1) as u32;
        if len > STRING_LEN_MAX {
            self.report(Problem::error("E227", span, "this string is too long"));
            return error_expr(span);
        }
        Expr {
            kind: ExprKind::Text(Arc::from(units)),
            ty: self.types.string(wide, len),
            span,
        }
    }

    /// A string as a value of another string type, a literal of one character as CHAR, CHAR as a string.
    pub(super) fn coerce_text(&mut self, expr: &Expr, ty: TypeId) -> Option<Expr> {
        let to = self.types.text(ty);
        match (self.types.text(expr.ty), to) {
            (Some((from_wide, _)), Some((to_wide, _))) if from_wide == to_wide => {
                return Some(expr.clone());
            }
            (None, Some((wide, _))) => {
                let own = self.types.elem(expr.ty)?;
                let char = if wide { Elem::Wchar } else { Elem::Char };
                if own == char {
                    let ty = self.types.string(wide, 1);
                    return Some(Expr {
                        kind: ExprKind::Std(StdFun::ToText, vec![expr.clone()]),
                        ty,
                        span: expr.span,
                    });
                }
            }
            _ => {}
        }
        let elem = self.types.elem(ty)?;
        match &expr.kind {
            ExprKind::Text(units) if units.len() == 1 && elem.is_char() => {
                let wide = self.types.text(expr.ty)?.0;
                (wide == (elem == Elem::Wchar))
                    .then(|| constant(Value::Char(units[0]), ty, expr.span))
            }
            _ => None,
        }
    }

    /// `=`, `<` and their like between strings; `None` if neither side is one.
    pub(super) fn compare_texts(
        &mut self,
        op: BinOp,
        left: &Expr,
        right: &Expr,
        span: Span,
    ) -> Option<Expr> {
        let (l, r) = (self.types.text(left.ty), self.types.text(right.ty));
        if l.is_none() && r.is_none() {
            return None;
        }
        // A character on one side: its literal becomes one too.
        if l.is_none() || r.is_none() {
            let (text, char) = if l.is_some() {
                (left, right)
            } else {
                (right, left)
            };
            if let Some(other) = self.coerce_text(text, char.ty) {
                let (a, b) = if l.is_some() {
                    (other, char.clone())
                } else {
                    (char.clone(), other)
                };
                return Some(self.binary(op, a, b, span));
            }
            return Some(self.operator_mismatch(op, left, right, span));
        }
        if !op.is_comparison() || l.map(|t| t.0) != r.map(|t| t.0) {
            return Some(self.operator_mismatch(op, left, right, span));
        }
        let order = Expr {
            kind: ExprKind::Std(StdFun::Compare, vec![left.clone(), right.clone()]),
            ty: TypeId::of(Elem::Dint),
            span,
        };
        let zero = constant(Value::Int(0), TypeId::of(Elem::Dint), span);
        Some(Expr {
            kind: ExprKind::Binary(op, Elem::Dint, Box::new(order), Box::new(zero)),
            ty: TypeId::BOOL,
            span,
        })
    }

    fn as_text(&mut self, expr: Expr, name: &str) -> Option<Expr> {
        if self.types.text(expr.ty).is_some() {
            return Some(expr);
        }
        if let Some(elem) = self.types.elem(expr.ty).filter(|e| e.is_char()) {
            let ty = self.types.string(elem == Elem::Wchar, 1);
            return self.coerce_text(&expr, ty);
        }
        self.wrong_argument(name, &expr, "a STRING or WSTRING");
        None
    }

    fn as_count(&mut self, expr: Expr, name: &str) -> Option<Expr> {
        let expr = self.settle(expr);
        let fits = self
            .types
            .elem(expr.ty)
            .is_some_and(|e| e.is_int() && e.widens_to(Elem::Lint));
        if !fits || self.types.is_enum(expr.ty) {
            self.wrong_argument(name, &expr, "an integer");
            return None;
        }
        let expr = self.coerce(expr, TypeId::of(Elem::Lint));
        (expr.ty != TypeId::ERROR).then_some(expr)
    }

    pub(super) fn text_function(
        &mut self,
        fun: StdFun,
        name: &str,
        list: Vec<Expr>,
        expected: Option<TypeId>,
        span: Span,
    ) -> Expr {
        let strings = match fun {
            StdFun::Concat => list.len(),
            StdFun::Insert | StdFun::Replace | StdFun::Find => 2,
            _ => 1,
        };
        let mut args = Vec::new();
        for (index, arg) in list.into_iter().enumerate() {
            let arg = if index < strings {
                self.as_text(arg, name)
            } else {
                self.as_count(arg, name)
            };
            match arg {
                Some(arg) => args.push(arg),
                None => return error_expr(span),
            }
        }
        let kinds: Vec<(bool, u32)> = args[..strings]
            .iter()
            .filter_map(|a| self.types.text(a.ty))
            .collect();
        let wide = kinds.first().is_some_and(|k| k.0);
        if kinds.iter().any(|k| k.0 != wide) {
            let message = format!("{name} cannot mix STRING and WSTRING");
            self.report(Problem::error("E306", span, message));
            return error_expr(span);
        }
        let total: u32 = kinds
            .iter()
            .map(|k| k.1)
            .fold(0, u32::saturating_add)
            .min(STRING_LEN_MAX);
        let ty = match fun {
            StdFun::Len | StdFun::Find => {
                let wanted = expected
                    .and_then(|t| self.types.elem(t))
                    .filter(|e| e.is_int() && e.bits() >= 16);
                TypeId::of(wanted.unwrap_or(Elem::Int))
            }
            StdFun::Concat | StdFun::Insert | StdFun::Replace => self.types.string(wide, total),
            _ => args[0].ty,
        };
        Expr {
            kind: ExprKind::Std(fun, args),
            ty,
            span,
        }
    }

    /// SEL, MUX, MAX and MIN of strings.
    pub(super) fn choose_text(
        &mut self,
        fun: StdFun,
        name: &str,
        list: Vec<Expr>,
        span: Span,
    ) -> Expr {
        let skip = usize::from(matches!(fun, StdFun::Sel | StdFun::Mux));
        let mut args = Vec::new();
        let mut longest = 1;
        let mut width = None;
        for (index, arg) in list.into_iter().enumerate() {
            let arg = if index >= skip {
                self.as_text(arg, name)
            } else if fun == StdFun::Sel {
                Some(self.coerce(arg, TypeId::BOOL))
            } else {
                self.as_count(arg, name)
            };
            let Some(arg) = arg.filter(|a| a.ty != TypeId::ERROR) else {
                return error_expr(span);
            };
            if let Some((wide, len)) = self.types.text(arg.ty).filter(|_| index >= skip) {
                longest = longest.max(len);
                if *width.get_or_insert(wide) != wide {
                    let message = format!("{name} cannot mix STRING and WSTRING");
                    self.report(Problem::error("E306", span, message));
                    return error_expr(span);
                }
            }
            args.push(arg);
        }
        let ty = self.types.string(width.unwrap_or(false), longest);
        Expr {
            kind: ExprKind::Std(fun, args),
            ty,
            span,
        }
    }

    /// `INT_TO_STRING`, `TO_STRING`, `STRING_TO_REAL`, `STRING_TO_WSTRING`; `None` if the name is none of them.
    pub(super) fn text_conversion(&mut self, name: &str, args: &[Arg], span: Span) -> Option<Expr> {
        let wide_of = |part: &str| match part {
            "STRING" => Some(false),
            "WSTRING" => Some(true),
            _ => None,
        };
        let (from, to) = match name.strip_prefix("TO_") {
            Some(to) => (None, to),
            None => name
                .match_indices("_TO_")
                .map(|(at, _)| (Some(&name[..at]), &name[at + 4..]))
                .find(|(from, to)| {
                    wide_of(to).is_some() || from.is_some_and(|f| wide_of(f).is_some())
                })?,
        };
        let from_wide = from.and_then(wide_of);
        let to_wide = wide_of(to);
        if from_wide.is_none() && to_wide.is_none() && from.is_some() {
            return None;
        }
        let to_type = match to_wide {
            Some(_) => None,
            None => Some(self.scalar_type(to)?),
        };
        if from.is_none() && to_wide.is_none() {
            // TO_INT(s) of a string; of anything else it is an ordinary conversion.
            let text = args
                .first()
                .and_then(|a| a.value.as_ref())
                .is_some_and(|v| {
                    let before = self.problems.len();
                    let typed = self.expr(v, None);
                    self.problems.truncate(before);
                    self.types.text(typed.ty).is_some()
                });
            if !text {
                return None;
            }
        }
        let from_type = match from {
            Some(part) if from_wide.is_none() => Some(self.scalar_type(part)?),
            _ => None,
        };
        let Some(list) = self.collect_args(name, &["IN"], false, args, from_type, span) else {
            return Some(error_expr(span));
        };
        let inner = list.into_iter().next()?;
        let inner = match from_type {
            Some(ty) => self.coerce(inner, ty),
            None => self.settle(inner),
        };
        if inner.ty == TypeId::ERROR {
            return Some(error_expr(span));
        }
        let own = self.types.text(inner.ty);
        if let Some(wide) = from_wide
            && own.map(|o| o.0) != Some(wide)
        {
            let wanted = if wide { "a WSTRING" } else { "a STRING" };
            return Some(self.wrong_argument(name, &inner, wanted));
        }
        match (own, to_wide) {
            (Some((from, len)), Some(to)) => {
                if from == to {
                    return Some(inner);
                }
                let ty = self.types.string(to, len);
                Some(Expr {
                    kind: ExprKind::Std(StdFun::ToText, vec![inner]),
                    ty,
                    span,
                })
            }
            (Some(_), None) => {
                let ty = to_type?;
                let elem = self.types.elem(ty)?;
                if elem == Elem::Ref || self.types.is_enum(ty) {
                    return Some(self.wrong_argument(name, &inner, "an elementary type"));
                }
                Some(Expr {
                    kind: ExprKind::Std(StdFun::FromText, vec![inner]),
                    ty,
                    span,
                })
            }
            (None, to) => {
                let Some(elem) = self.types.elem(inner.ty).filter(|e| *e != Elem::Ref) else {
                    return Some(self.wrong_argument(name, &inner, "an elementary value"));
                };
                let inner = Expr {
                    ty: TypeId::of(elem),
                    ..inner
                };
                let ty = self.types.string(to == Some(true), VALUE_TEXT_MAX);
                Some(Expr {
                    kind: ExprKind::Std(StdFun::ToText, vec![inner]),
                    ty,
                    span,
                })
            }
        }
    }

    /// `REF(x)`, `ADR(x)`, `SIZEOF(x)`.
    pub(super) fn address_call(&mut self, name: &str, args: &[Arg], span: Span) -> Expr {
        let [
            Arg {
                value: Some(value), ..
            },
        ] = args
        else {
            let message = format!("{name} takes one argument");
            self.report(Problem::error("E411", span, message).expected("a variable"));
            return error_expr(span);
        };
        if name == "SIZEOF" {
            return self.size_of(value, span);
        }
        let Some(place) = self.place(value) else {
            return error_expr(span);
        };
        if name == "ADR" && self.is_liberal() {
            return self.pointer_to(place, span);
        }
        self.address_of(place, span)
    }

    pub(super) fn address_of(&mut self, place: Place, span: Span) -> Expr {
        let mut problem = None;
        if let Root::Var(id) = place.root
            && !place
                .steps
                .iter()
                .any(|s| matches!(s.kind, StepKind::Deref))
        {
            let var = self.var(id);
            let in_call = var
                .owner
                .is_some_and(|o| matches!(self.pou(o).kind, PouKind::Function | PouKind::Method));
            if var.section == VarSection::Temp || (in_call && var.section != VarSection::InOut) {
                problem = Some("it is temporary, and the reference would outlive it");
            } else if var.location.is_some() {
                problem = Some("it lies in the process image");
            } else if var.constant {
                problem = Some("it is constant");
            }
        }
        if matches!(place.root, Root::Direct(_)) {
            problem = Some("it lies in the process image");
        }
        match place.steps.last().map(|s| &s.kind) {
            Some(StepKind::Bit(_) | StepKind::Part(..) | StepKind::Char(_)) => {
                problem = Some("it is only a part of a variable");
            }
            Some(StepKind::Index(_))
                if self
                    .types
                    .elem(place.ty)
                    .is_some_and(Elem::is_packed_in_arrays) =>
            {
                problem = Some("elements of one byte have no cell of their own");
            }
            _ => {}
        }
        if let Some(why) = problem {
            let text = self.sources.slice(place.span).to_owned();
            self.report(
                Problem::error(
                    "E319",
                    span,
                    format!("there is no reference to `{text}`: {why}"),
                )
                .hint(
                    "refer to a variable in VAR of a program or function block, or to a global one",
                ),
            );
            return error_expr(span);
        }
        let ty = self.types.reference(place.ty);
        Expr {
            kind: ExprKind::AddressOf(Box::new(place)),
            ty,
            span,
        }
    }

    /// The number of bytes that a variable or type takes in memory.
    fn size_of(&mut self, value: &ast::Expr, span: Span) -> Expr {
        let ty = match &value.kind {
            ast::ExprKind::Name(name) if self.find_var(name).is_none() => {
                let ident = ast::Ident {
                    name: name.clone(),
                    span: value.span,
                };
                self.resolve_name(&ident)
            }
            _ => match self.place(value) {
                Some(place) => place.ty,
                None => return error_expr(span),
            },
        };
        match self.laid_out(ty).or_else(|| self.bytes_of(ty)) {
            Some(bytes) => constant(
                Value::Int(i64::try_from(bytes).unwrap_or(i64::MAX)),
                TypeId::UNTYPED_INT,
                span,
            ),
            None => {
                if ty != TypeId::ERROR {
                    let message = format!("the size of {} is not fixed", self.type_name(ty));
                    self.report(Problem::error("E319", span, message));
                }
                error_expr(span)
            }
        }
    }

    /// Bytes of a value as its type is declared (not of its cell, which may be wider).
    fn bytes_of(&self, ty: TypeId) -> Option<u64> {
        match self.types.kind(ty) {
            TypeKind::Str { wide, len } => Some((u64::from(*len) + 1) * if *wide { 2 } else { 1 }),
            TypeKind::Array { dims, elem } => {
                let count: u64 = dims.iter().map(|(l, h)| (h - l + 1) as u64).product();
                self.bytes_of(*elem)?.checked_mul(count)
            }
            TypeKind::Struct { fields } => fields
                .iter()
                .map(|f| self.bytes_of(f.ty))
                .try_fold(0, |sum, b| Some(sum + b?)),
            _ => self.types.elem(ty).map(|e| u64::from(e.image_bytes())),
        }
    }
}
