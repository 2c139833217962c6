//! Calls of methods: whose method it is, which may run, and the bodies of bases (IEC 61131-3 third edition, clause 6.6.5).

use crate::check::expr::error_expr;
use crate::check::tree::{
    Expr, ExprKind, FunctionCall, Invocation, Place, PouId, Receiver, Root, StmtKind,
};
use crate::check::{Checker, key};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{self, Access, Arg, PouKind, VarSection};
use crate::types::{TypeId, TypeKind};

impl Checker<'_> {
    /// The call of a method, if the callee is one. `Some(None)` after a mistake.
    pub(super) fn method_call(
        &mut self,
        callee: &ast::Expr,
        args: &[Arg],
        span: Span,
    ) -> Option<Option<FunctionCall>> {
        match &callee.kind {
            ast::ExprKind::Name(name) => {
                if self.find_var(name).is_some() {
                    return None;
                }
                let block = self.current_block().or(self
                    .current
                    .pou
                    .filter(|p| self.pou(*p).kind == PouKind::Program))?;
                let method = self.find_method(block, &key(name))?;
                let this = self.this_place(block, span);
                Some(self.call_method(method, Receiver::Derived(this), args, span))
            }
            ast::ExprKind::Field(base, name) => {
                let word = match &base.kind {
                    ast::ExprKind::Name(word) => Some(word),
                    ast::ExprKind::Deref(inner) => match &inner.kind {
                        ast::ExprKind::Name(word) => Some(word),
                        _ => None,
                    },
                    _ => None,
                };
                if let Some(word) = word
                    && self.find_var(word).is_none()
                    && let Some(block) = self.current_block()
                {
                    let method_name = key(&name.name);
                    if word.eq_ignore_ascii_case("SUPER") {
                        let found = self
                            .pou(block)
                            .extends
                            .and_then(|b| self.find_method(b, &method_name));
                        let Some(method) = found else {
                            self.no_method(block, name);
                            return Some(None);
                        };
                        let this = self.this_place(block, span);
                        return Some(self.call_method(method, Receiver::Fixed(this), args, span));
                    }
                    if word.eq_ignore_ascii_case("THIS") {
                        let found = self.find_method(block, &method_name);
                        let Some(method) = found else {
                            // `THIS^.instance(...)`
                            return None;
                        };
                        let this = self.this_place(block, span);
                        return Some(self.call_method(method, Receiver::Derived(this), args, span));
                    }
                }
                self.call_on_place(base, name, args, span)
            }
            _ => None,
        }
    }

    fn call_on_place(
        &mut self,
        base: &ast::Expr,
        name: &ast::Ident,
        args: &[Arg],
        span: Span,
    ) -> Option<Option<FunctionCall>> {
        let before = self.problems.len();
        let place = self.place(base);
        let Some(place) = place else {
            self.problems.truncate(before);
            return None;
        };
        match *self.types.kind(place.ty) {
            TypeKind::FunctionBlock(block) => {
                let is_variable = self
                    .pou(block)
                    .vars
                    .iter()
                    .any(|v| self.var(*v).name.eq_ignore_ascii_case(&name.name));
                if is_variable {
                    return None;
                }
                let Some(method) = self.find_method(block, &key(&name.name)) else {
                    self.no_method(block, name);
                    return Some(None);
                };
                let exact = self.is_exact(&place);
                let receiver = if exact {
                    Receiver::Fixed(place)
                } else {
                    Receiver::Derived(place)
                };
                Some(self.call_method(method, receiver, args, span))
            }
            TypeKind::Interface(id) => {
                let found = self.interfaces[id.0 as usize]
                    .methods
                    .iter()
                    .find(|(n, _)| *n == key(&name.name))
                    .map(|(_, m)| *m);
                let Some(method) = found else {
                    let message = format!(
                        "{} has no method `{}`",
                        self.interfaces[id.0 as usize].name, name.name
                    );
                    self.report(Problem::error("E416", name.span, message));
                    return Some(None);
                };
                Some(self.call_method(method, Receiver::Interface(place, id), args, span))
            }
            _ => None,
        }
    }

    /// Whether the instance is certainly of its declared type: not behind a reference or VAR_IN_OUT.
    pub(super) fn is_exact(&self, place: &Place) -> bool {
        let by_reference = match place.root {
            Root::Var(id) => self.var(id).section == VarSection::InOut && place.steps.is_empty(),
            Root::This => true,
            Root::Direct(_) => false,
        };
        !by_reference
            && !matches!(
                place.steps.last().map(|s| &s.kind),
                Some(crate::check::tree::StepKind::Deref)
            )
    }

    fn no_method(&mut self, block: PouId, name: &ast::Ident) {
        let message = format!("{} has no method `{}`", self.pou(block).name, name.name);
        self.report(Problem::error("E416", name.span, message));
    }

    pub(super) fn this_place(&self, block: PouId, span: Span) -> Place {
        Place {
            root: Root::This,
            steps: Vec::new(),
            ty: self.fb_types.get(&block).copied().unwrap_or(TypeId::ERROR),
            span,
        }
    }

    fn call_method(
        &mut self,
        method: PouId,
        receiver: Receiver,
        args: &[Arg],
        span: Span,
    ) -> Option<FunctionCall> {
        let owner = self.pou(method).instance_of;
        let inside = self.sees_inside(owner);
        let access = self.pou(method).access;
        let allowed = match access {
            Access::Public => true,
            Access::Internal => {
                let block = owner.map_or_else(String::new, |o| self.pou(o).name.clone());
                self.same_space(&block, &self.current.space)
            }
            Access::Protected => inside,
            Access::Private => owner == self.current_block() && inside,
        };
        if !allowed {
            let message = format!("{} cannot be called from here", self.pou(method).name);
            self.report(Problem::error("E416", span, message).hint(
                "it is PRIVATE, PROTECTED or INTERNAL: declare it PUBLIC to call it from outside",
            ));
            return None;
        }
        let interface = match receiver {
            Receiver::Interface(_, id) => Some(id),
            _ => None,
        };
        let method = self.method_with_bounds(method, interface, args, span)?;
        let virtual_call = !matches!(receiver, Receiver::Fixed(_));
        if virtual_call {
            // All that may run count as called.
            let name = key(self.pou(method).name.rsplit('.').next().unwrap_or_default());
            for index in 0..self.pous.len() {
                let other = self
                    .pou(PouId(index as u32))
                    .methods
                    .iter()
                    .find(|(n, _)| *n == name);
                if let Some((_, id)) = other.cloned()
                    && self.may_run(method, id, &receiver)
                {
                    self.note_call(id);
                }
            }
        }
        let mut call = self.function_call(method, args, span)?;
        call.receiver = Some(receiver);
        Some(call)
    }

    /// Whether a call of `declared` may end in `other`.
    fn may_run(&self, declared: PouId, other: PouId, receiver: &Receiver) -> bool {
        let Some(other_block) = self.pou(other).instance_of else {
            return false;
        };
        match receiver {
            Receiver::Interface(_, id) => (0..self.pous.len() as u32)
                .map(PouId)
                .any(|p| self.implements(p, *id) && self.derives_pou(p, other_block)),
            _ => self
                .pou(declared)
                .instance_of
                .is_some_and(|block| self.derives_pou(other_block, block)),
        }
    }

    pub(super) fn derives_pou(&self, from: PouId, to: PouId) -> bool {
        let mut at = Some(from);
        while let Some(id) = at {
            if id == to {
                return true;
            }
            at = self.pou(id).extends;
        }
        false
    }

    /// `SUPER()`: the body of the base.
    pub(super) fn super_body(&mut self, span: Span) -> Option<StmtKind> {
        let block = self.current_block();
        let Some(base) = block.and_then(|b| self.pou(b).extends) else {
            self.report(Problem::error(
                "E321",
                span,
                "SUPER needs a function block with EXTENDS",
            ));
            return None;
        };
        self.note_call(base);
        Some(StmtKind::Invoke(Invocation {
            pou: base,
            instance: Some(self.this_place(base, span)),
            inputs: Vec::new(),
            in_outs: self.base_in_outs(base, span),
            outputs: Vec::new(),
            span,
        }))
    }

    fn base_in_outs(&self, base: PouId, span: Span) -> Vec<Place> {
        self.pou(base)
            .vars
            .iter()
            .filter(|v| self.var(**v).section == VarSection::InOut)
            .map(|v| Place {
                root: Root::Var(*v),
                steps: Vec::new(),
                ty: self.var(*v).ty,
                span,
            })
            .collect()
    }

    /// The result of a method in an expression.
    pub(super) fn method_value(&mut self, call: Option<FunctionCall>, span: Span) -> Expr {
        let Some(call) = call else {
            return error_expr(span);
        };
        let Some(result) = self.pou(call.pou).result else {
            let message = format!("the method {} has no result", self.pou(call.pou).name);
            self.report(Problem::error("E401", span, message).hint("call it as a statement"));
            return error_expr(span);
        };
        Expr {
            ty: self.var(result).ty,
            kind: ExprKind::Call(Box::new(call)),
            span,
        }
    }
}
