//! Initial values of variables, fields and types.

use crate::check::Checker;
use crate::check::tree::{ExprKind, InitValue, Root, VarId};
use crate::diag::Problem;
use crate::syntax::ast::{self, Init, VarSection};
use crate::types::{TypeId, TypeKind};

/// What an initial value belongs to that is worked out once everything is declared.
#[derive(Clone, Copy, Debug)]
pub(super) enum Pending {
    Var(VarId),
    Field(TypeId, usize),
    Type(TypeId),
}

impl Checker<'_> {
    pub(super) fn settle_inits(&mut self, from: usize) {
        for index in from..self.pending_inits.len() {
            let (target, init) = self.pending_inits[index];
            let ty = match target {
                Pending::Var(id) => {
                    self.enter(self.var(id).owner);
                    self.var(id).ty
                }
                Pending::Field(ty, field) => match self.types.kind(ty) {
                    TypeKind::Struct { fields } => fields[field].ty,
                    _ => continue,
                },
                Pending::Type(ty) => ty,
            };
            let value = self.init_value(init, ty);
            self.leave();
            let Some(value) = value else { continue };
            match target {
                Pending::Var(id) => self.vars[id.0 as usize].init = Some(value),
                Pending::Field(ty, field) => self.types.set_field_init(ty, field, value),
                Pending::Type(ty) => self.types.set_init(ty, value),
            }
        }
    }

    /// The initial value `init` for something of type `ty`; `None` after reporting what is wrong.
    pub(super) fn init_value(&mut self, init: &Init, ty: TypeId) -> Option<InitValue> {
        if ty == TypeId::ERROR {
            return None;
        }
        let kind = self.types.kind(ty).clone();
        match (init, kind) {
            (Init::Array(items, span), TypeKind::Array { dims, elem }) => {
                let total: u64 = dims.iter().map(|(l, h)| (h - l + 1) as u64).product();
                let mut values = Vec::new();
                let mut used: u64 = 0;
                self.array_items(items, elem, 1, &mut values, &mut used)?;
                if used > total {
                    let message = format!("{used} values for an array of {total} elements");
                    self.report(Problem::error("E215", *span, message));
                    return None;
                }
                Some(InitValue::Array(values))
            }
            (Init::Struct(items, _), TypeKind::Struct { fields }) => {
                let mut values = Vec::new();
                for (name, item) in items {
                    let found = fields
                        .iter()
                        .position(|f| f.name.eq_ignore_ascii_case(&name.name));
                    let Some(index) = found else {
                        let message =
                            format!("{} has no field `{}`", self.type_name(ty), name.name);
                        self.report(Problem::error("E216", name.span, message));
                        return None;
                    };
                    values.push((index, self.init_value(item, fields[index].ty)?));
                }
                Some(InitValue::Struct(values))
            }
            (Init::Struct(items, _), TypeKind::FunctionBlock(pou)) => {
                let mut values = Vec::new();
                for (name, item) in items {
                    let found = self
                        .pou(pou)
                        .vars
                        .iter()
                        .copied()
                        .find(|v| self.var(*v).name.eq_ignore_ascii_case(&name.name));
                    let open = |section| matches!(section, VarSection::Input | VarSection::Output);
                    let Some(var) = found.filter(|v| {
                        open(self.var(*v).section)
                            || (self.options.allow_internal_access
                                && self.var(*v).section == VarSection::Local)
                    }) else {
                        let message =
                            format!("{} has no input `{}`", self.type_name(ty), name.name);
                        self.report(Problem::error("E216", name.span, message));
                        return None;
                    };
                    values.push((var, self.init_value(item, self.var(var).ty)?));
                }
                Some(InitValue::Instance(values))
            }
            // A constant of the same type.
            (Init::Expr(expr), TypeKind::Array { .. } | TypeKind::Struct { .. })
                if matches!(expr.kind, ast::ExprKind::Name(_)) =>
            {
                let place = self.place(expr)?;
                if let Root::Var(id) = place.root
                    && self.var(id).constant
                    && self.types.same(place.ty, ty)
                {
                    return self.constant_init(id);
                }
                self.report(Problem::error(
                    "E217",
                    expr.span,
                    "an initial value must be constant",
                ));
                None
            }
            // `a : ARRAY[0..3] OF INT := 1, 2, 3, 4` without brackets, and one value for a whole array, are CODESYS 2.
            (Init::Expr(expr), kind)
                if !matches!(
                    kind,
                    TypeKind::Array { .. } | TypeKind::Struct { .. } | TypeKind::FunctionBlock(_)
                ) =>
            {
                let typed = self.expr(expr, Some(ty));
                let typed = self.coerce(typed, ty);
                if typed.ty == TypeId::ERROR {
                    return None;
                }
                match typed.kind {
                    ExprKind::Const(value) => return Some(InitValue::Scalar(value)),
                    ExprKind::Text(units) => return Some(InitValue::Text(units)),
                    ExprKind::Load(place) if self.types.text(ty).is_some() => {
                        if let Root::Var(id) = place.root
                            && self.var(id).constant
                            && place.steps.is_empty()
                        {
                            return self.constant_init(id);
                        }
                    }
                    ExprKind::AddressOf(_) => {
                        self.report(
                            Problem::error("E217", expr.span, "a reference begins as NULL")
                                .hint("assign it in the first scan"),
                        );
                        return None;
                    }
                    _ => {}
                }
                self.report(
                    Problem::error("E217", expr.span, "an initial value must be constant")
                        .expected("literals, constants and operators"),
                );
                None
            }
            (init, kind) => {
                let expected = match kind {
                    TypeKind::Array { .. } => "values in brackets: [1, 2, 3(0)]",
                    TypeKind::Struct { .. } | TypeKind::FunctionBlock(_) => {
                        "values in parentheses: (a := 1, b := 2)"
                    }
                    _ => "a single value",
                };
                let message = format!("this is no initial value of {}", self.type_name(ty));
                self.report(Problem::error("E218", init.span(), message).expected(expected));
                None
            }
        }
    }

    /// The initial value of a constant, which may be waiting still.
    fn constant_init(&mut self, id: VarId) -> Option<InitValue> {
        if let Some(value) = &self.var(id).init {
            return Some(value.clone());
        }
        let ty = self.var(id).ty;
        if self.init_depth > 50 {
            let span = self.var(id).span;
            self.report(Problem::error(
                "E204",
                span,
                "this constant needs its own value",
            ));
            return None;
        }
        let waiting = self
            .pending_inits
            .iter()
            .find(|(p, _)| matches!(p, Pending::Var(v) if *v == id))
            .map(|(_, init)| *init)?;
        self.init_depth += 1;
        let value = self.init_value(waiting, ty);
        self.init_depth -= 1;
        value
    }

    fn array_items(
        &mut self,
        items: &[(Option<crate::syntax::ast::Expr>, Init)],
        elem: TypeId,
        times: u64,
        values: &mut Vec<(u64, InitValue)>,
        used: &mut u64,
    ) -> Option<()> {
        // Limits the work that `1000000(1, 2)` can cause.
        const REPEATED_LISTS_MAX: u64 = 100_000;
        for _ in 0..times {
            for (count, item) in items {
                let count = match count {
                    Some(count) => u64::try_from(self.const_int(count)?).ok()?,
                    None => 1,
                };
                let is_list = matches!(item, Init::Array(..))
                    && !matches!(self.types.kind(elem), TypeKind::Array { .. });
                if let (true, Init::Array(list, span)) = (is_list, item) {
                    if count > REPEATED_LISTS_MAX {
                        self.report(Problem::error("E215", *span, "too many repetitions"));
                        return None;
                    }
                    self.array_items(list, elem, count, values, used)?;
                    continue;
                }
                let value = self.init_value(item, elem)?;
                *used = used.saturating_add(count);
                values.push((count, value));
            }
        }
        Some(())
    }
}
