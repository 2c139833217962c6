//! Statements.

use crate::check::Checker;
use crate::check::tree::{Expr, ExprKind, For, Root, Stmt, StmtKind};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, CaseLabel};
use crate::types::{Elem, TypeId};
use crate::value::Value;

/// How many single values the labels of one CASE may name, ranges counted once.
const CASE_LABELS_MAX: usize = 10_000;

impl Checker<'_> {
    pub(super) fn stmts(&mut self, list: &[ast::Stmt]) -> Vec<Stmt> {
        list.iter()
            .filter_map(|stmt| {
                let kind = match self.enabled_call(stmt) {
                    Some(kind) => kind?,
                    None => self.stmt(stmt)?,
                };
                Some(Stmt {
                    kind,
                    span: stmt.span,
                })
            })
            .collect()
    }

    /// `r ?= x`: a reference to an instance of the right kind, else NULL.
    fn try_assign(&mut self, target: &ast::Expr, value: &ast::Expr) -> Option<StmtKind> {
        let place = self.place(target)?;
        let typed = self.expr(value, Some(place.ty));
        if typed.ty == TypeId::ERROR || !self.writable(&place) {
            return None;
        }
        let accepted = self.accepted_by(place.ty);
        if !self.types.is_ref(typed.ty) || accepted.is_empty() {
            let message = format!(
                "`?=` does not apply to {} and {}",
                self.type_name(place.ty),
                self.type_name(typed.ty)
            );
            self.report(
                Problem::error("E323", value.span, message)
                    .expected("references to function blocks, or interfaces"),
            );
            return None;
        }
        let span = typed.span;
        let checked = Expr {
            kind: ExprKind::AddressIf(Box::new(typed), accepted),
            ty: place.ty,
            span,
        };
        Some(StmtKind::Assign(place, checked))
    }

    pub(super) fn stmt(&mut self, stmt: &ast::Stmt) -> Option<StmtKind> {
        match &stmt.kind {
            ast::StmtKind::Empty => None,
            ast::StmtKind::Assign(target, value) => self.assign(target, value),
            ast::StmtKind::Call(call) => self.call_stmt(call),
            ast::StmtKind::If(branches, otherwise) => {
                let branches = branches
                    .iter()
                    .map(|(condition, body)| {
                        let condition = self.condition(condition);
                        (condition, self.stmts(body))
                    })
                    .collect();
                Some(StmtKind::If(branches, self.stmts(otherwise)))
            }
            ast::StmtKind::Case(selector, branches, otherwise) => {
                self.case(selector, branches, otherwise.as_deref())
            }
            ast::StmtKind::For(data) => self.for_loop(data),
            ast::StmtKind::While(condition, body) => {
                let condition = self.condition(condition);
                let body = self.loop_body(body);
                Some(StmtKind::While(condition, body))
            }
            ast::StmtKind::Repeat(body, condition) => {
                let body = self.loop_body(body);
                let condition = self.condition(condition);
                Some(StmtKind::Repeat(body, condition))
            }
            ast::StmtKind::Exit => self.in_loop("EXIT", stmt.span).then_some(StmtKind::Exit),
            ast::StmtKind::Continue => self
                .in_loop("CONTINUE", stmt.span)
                .then_some(StmtKind::Continue),
            ast::StmtKind::Return => Some(StmtKind::Return),
            ast::StmtKind::Block(body) => Some(StmtKind::Block(self.stmts(body))),
            ast::StmtKind::TryAssign(target, value) => self.try_assign(target, value),
        }
    }

    fn loop_body(&mut self, body: &[ast::Stmt]) -> Vec<Stmt> {
        self.current.loops += 1;
        let body = self.stmts(body);
        self.current.loops -= 1;
        body
    }

    fn in_loop(&mut self, word: &str, span: Span) -> bool {
        let inside = self.current.loops > 0;
        if !inside {
            self.report(Problem::error(
                "E413",
                span,
                format!("{word} stands outside of any loop"),
            ));
        }
        inside
    }

    pub(super) fn condition(&mut self, expr: &ast::Expr) -> Expr {
        let typed = self.expr(expr, Some(TypeId::BOOL));
        if typed.ty != TypeId::ERROR && typed.ty != TypeId::BOOL {
            let same = self.types.elem(typed.ty) == Some(Elem::Bool);
            if !same {
                let message = format!(
                    "a condition must be BOOL, and this is {}",
                    self.type_name(typed.ty)
                );
                self.report(
                    Problem::error("E308", expr.span, message)
                        .expected("a comparison or a BOOL variable"),
                );
            }
        }
        typed
    }

    fn assign(&mut self, target: &ast::Expr, value: &ast::Expr) -> Option<StmtKind> {
        self.current.defining = true;
        let place = self.place(target);
        self.current.defining = false;
        let expected = place
            .as_ref()
            .map(|p| p.ty)
            .filter(|t| *t != TypeId::INFERRED);
        self.current.assigned = Some(value.span);
        let typed = self.expr(value, expected);
        self.current.assigned = None;
        let mut place = place?;
        if place.ty == TypeId::INFERRED {
            place.ty = self.infer(&place, &typed)?;
        }
        self.current.assigned = Some(place.span);
        let writable = self.writable(&place);
        self.current.assigned = None;
        if !writable {
            return None;
        }
        if matches!(
            self.types.kind(place.ty),
            crate::types::TypeKind::Array { .. } | crate::types::TypeKind::Struct { .. }
        ) && !matches!(typed.kind, ExprKind::Load(_) | ExprKind::Call(_))
            && typed.ty != TypeId::ERROR
        {
            let message = format!("this is no value of {}", self.type_name(place.ty));
            self.report(
                Problem::error("E302", value.span, message).expected("a variable of the same type"),
            );
            return None;
        }
        let typed = self.coerce(typed, place.ty);
        if typed.ty == TypeId::ERROR {
            return None;
        }
        if let Root::Var(holder) = place.root {
            self.warn_of_temporary(holder, &typed);
        }
        match self.by_elements(&place, &typed) {
            Some(assignments) => assignments,
            None => Some(StmtKind::Assign(place, typed)),
        }
    }

    /// The wire takes the type of its first value.
    fn infer(&mut self, place: &crate::check::tree::Place, value: &Expr) -> Option<TypeId> {
        let crate::check::tree::Root::Var(id) = place.root else {
            return None;
        };
        let settled = self.settle(value.clone());
        let ty = match settled.ty {
            TypeId::VOID => return None,
            // What is wrong has been said: readers of the value have nothing to add.
            TypeId::ERROR => {
                self.vars[id.0 as usize].ty = TypeId::ERROR;
                return None;
            }
            ty => ty,
        };
        if matches!(
            self.types.kind(ty),
            crate::types::TypeKind::FunctionBlock(_)
        ) {
            return None;
        }
        self.vars[id.0 as usize].ty = ty;
        Some(ty)
    }

    fn case(
        &mut self,
        selector: &ast::Expr,
        branches: &[(Vec<CaseLabel>, Vec<ast::Stmt>)],
        otherwise: Option<&[ast::Stmt]>,
    ) -> Option<StmtKind> {
        let selector_expr = self.expr(selector, None);
        let selector_expr = self.settle(selector_expr);
        let ty = selector_expr.ty;
        let elem = self.types.elem(ty);
        let usable = elem.is_some_and(|e| e.is_int() || e.is_bit());
        if !usable && ty != TypeId::ERROR {
            let message = format!("{} cannot select a case", self.type_name(ty));
            self.report(
                Problem::error("E309", selector.span, message)
                    .expected("an integer, a bit string or an enumeration"),
            );
        }
        let mut seen: Vec<(i128, i128)> = Vec::new();
        let mut list = Vec::new();
        for (labels, body) in branches {
            let mut ranges = Vec::new();
            for label in labels {
                let (span, range) = match label {
                    CaseLabel::Single(expr) => {
                        let value = self.label(expr, ty);
                        (expr.span, value.map(|v| (v, v)))
                    }
                    CaseLabel::Range(from, to) => {
                        let (low, high) = (self.label(from, ty), self.label(to, ty));
                        (from.span.to(to.span), low.zip(high))
                    }
                };
                let Some((low, high)) = range else { continue };
                if low > high {
                    let message = format!("{low}..{high} holds no value");
                    self.report(
                        Problem::error("E414", span, message).expected("the smaller value first"),
                    );
                    continue;
                }
                if seen.iter().any(|(l, h)| low <= *h && high >= *l) {
                    self.report(Problem::error(
                        "E414",
                        span,
                        "this value has a branch already",
                    ));
                    continue;
                }
                if seen.len() >= CASE_LABELS_MAX {
                    self.report(Problem::error(
                        "E414",
                        span,
                        format!("a CASE has at most {CASE_LABELS_MAX} labels"),
                    ));
                    return None;
                }
                seen.push((low, high));
                // Unsigned 64-bit labels keep their bit pattern, as the selector does.
                ranges.push((low as i64, high as i64));
            }
            let body = self.stmts(body);
            list.push((ranges, body));
        }
        let otherwise = otherwise.map_or_else(Vec::new, |body| self.stmts(body));
        (usable && ty != TypeId::ERROR).then_some(StmtKind::Case {
            selector: selector_expr,
            branches: list,
            otherwise,
        })
    }

    fn label(&mut self, expr: &ast::Expr, ty: TypeId) -> Option<i128> {
        let typed = self.expr(expr, Some(ty));
        let typed = self.coerce(typed, ty);
        if typed.ty == TypeId::ERROR {
            return None;
        }
        if let ExprKind::Const(value) = &typed.kind {
            return value.as_i128();
        }
        self.report(
            Problem::error("E414", expr.span, "a label of CASE must be constant")
                .expected("a literal, a constant or an enumerated value"),
        );
        None
    }

    fn for_loop(&mut self, data: &ast::ForLoop) -> Option<StmtKind> {
        let ast::ForLoop {
            var,
            from,
            to,
            by,
            body,
        } = data;
        let place = self.place(var);
        let ty = place.as_ref().map_or(TypeId::ERROR, |p| p.ty);
        let from_expr = self.expr(from, Some(ty));
        let from_expr = self.coerce(from_expr, ty);
        // Limits are computed in the type of the variable, even where that is a subrange.
        let base = self.types.elem(ty).map_or(TypeId::ERROR, TypeId::of);
        let to_expr = self.expr(to, Some(base));
        let to_expr = self.coerce(to_expr, base);
        let by_expr = match by {
            Some(by) => {
                let typed = self.expr(by, Some(base));
                self.coerce(typed, base)
            }
            None => crate::check::expr::constant(
                Value::from_i128(self.types.elem(base).unwrap_or(Elem::Int), 1),
                base,
                to.span,
            ),
        };
        let body = self.loop_body(body);
        let place = place?;
        let elem = self
            .types
            .elem(ty)
            .filter(|e| e.is_int() && !self.types.is_enum(ty));
        if elem.is_none() {
            let message = format!("{} cannot count a FOR loop", self.type_name(ty));
            self.report(
                Problem::error("E415", var.span, message).expected("a variable of an integer type"),
            );
            return None;
        }
        if !self.writable(&place) {
            return None;
        }
        if let ExprKind::Const(step) = &by_expr.kind
            && step.as_i128() == Some(0)
            && by_expr.ty != TypeId::ERROR
        {
            self.report(Problem::error(
                "E415",
                by_expr.span,
                "the step of a FOR loop cannot be 0",
            ));
            return None;
        }
        let broken = [&from_expr, &to_expr, &by_expr]
            .iter()
            .any(|e| e.ty == TypeId::ERROR);
        (!broken).then(|| {
            StmtKind::For(Box::new(For {
                var: place,
                from: from_expr,
                to: to_expr,
                by: by_expr,
                body,
            }))
        })
    }
}
