//! Going through syntax trees.

use crate::syntax::ast::{CaseLabel, Expr, ExprKind, Stmt, StmtKind};

/// Calls `f` with each list of statements in a statement.
pub(crate) fn each_body(kind: &mut StmtKind, f: &mut dyn FnMut(&mut Vec<Stmt>)) {
    match kind {
        StmtKind::If(branches, otherwise) => {
            branches.iter_mut().for_each(|(_, body)| f(body));
            f(otherwise);
        }
        StmtKind::Case(_, branches, otherwise) => {
            branches.iter_mut().for_each(|(_, body)| f(body));
            if let Some(body) = otherwise {
                f(body);
            }
        }
        StmtKind::For(head) => f(&mut head.body),
        StmtKind::While(_, body) | StmtKind::Repeat(body, _) | StmtKind::Block(body) => f(body),
        _ => {}
    }
}

/// Calls `f` with what each assignment in the statements writes.
pub(crate) fn each_target(body: &[Stmt], f: &mut dyn FnMut(&Expr)) {
    for stmt in body {
        match &stmt.kind {
            StmtKind::Assign(to, _) | StmtKind::TryAssign(to, _) => f(to),
            StmtKind::If(branches, otherwise) => {
                branches.iter().for_each(|(_, body)| each_target(body, f));
                each_target(otherwise, f);
            }
            StmtKind::Case(_, branches, otherwise) => {
                branches.iter().for_each(|(_, body)| each_target(body, f));
                each_target(otherwise.as_deref().unwrap_or_default(), f);
            }
            StmtKind::For(head) => {
                f(&head.var);
                each_target(&head.body, f);
            }
            StmtKind::While(_, body) | StmtKind::Repeat(body, _) | StmtKind::Block(body) => {
                each_target(body, f);
            }
            _ => {}
        }
    }
}

/// Calls `f` with each expression in the statements, parts after the whole.
pub(crate) fn each_expr(body: &[Stmt], f: &mut dyn FnMut(&Expr)) {
    for stmt in body {
        match &stmt.kind {
            StmtKind::Assign(to, value) | StmtKind::TryAssign(to, value) => {
                expr(to, f);
                expr(value, f);
            }
            StmtKind::Call(call) => expr(call, f),
            StmtKind::If(branches, otherwise) => {
                for (condition, body) in branches {
                    expr(condition, f);
                    each_expr(body, f);
                }
                each_expr(otherwise, f);
            }
            StmtKind::Case(selector, branches, otherwise) => {
                expr(selector, f);
                for (labels, body) in branches {
                    for label in labels {
                        match label {
                            CaseLabel::Single(value) => expr(value, f),
                            CaseLabel::Range(low, high) => {
                                expr(low, f);
                                expr(high, f);
                            }
                        }
                    }
                    each_expr(body, f);
                }
                each_expr(otherwise.as_deref().unwrap_or_default(), f);
            }
            StmtKind::For(head) => {
                let bounds = [&head.var, &head.from, &head.to];
                bounds.into_iter().chain(&head.by).for_each(|e| expr(e, f));
                each_expr(&head.body, f);
            }
            StmtKind::While(condition, body) | StmtKind::Repeat(body, condition) => {
                expr(condition, f);
                each_expr(body, f);
            }
            StmtKind::Block(body) => each_expr(body, f),
            StmtKind::Exit | StmtKind::Continue | StmtKind::Return | StmtKind::Empty => {}
        }
    }
}

fn expr(whole: &Expr, f: &mut dyn FnMut(&Expr)) {
    f(whole);
    match &whole.kind {
        ExprKind::Deref(inner)
        | ExprKind::Partial(inner, ..)
        | ExprKind::Typed(_, inner)
        | ExprKind::Field(inner, _)
        | ExprKind::Bit(inner, _)
        | ExprKind::Unary(_, inner) => expr(inner, f),
        ExprKind::Index(inner, indices) => {
            expr(inner, f);
            indices.iter().for_each(|index| expr(index, f));
        }
        ExprKind::Call(callee, args) => {
            expr(callee, f);
            args.iter()
                .filter_map(|a| a.value.as_ref())
                .for_each(|e| expr(e, f));
        }
        ExprKind::Binary(_, left, right) => {
            expr(left, f);
            expr(right, f);
        }
        ExprKind::Int(_)
        | ExprKind::Real(_)
        | ExprKind::Bool(_)
        | ExprKind::Time(_)
        | ExprKind::Str(_)
        | ExprKind::WStr(_)
        | ExprKind::Date(..)
        | ExprKind::Null
        | ExprKind::EnumValue(..)
        | ExprKind::Name(_)
        | ExprKind::Direct(_) => {}
    }
}
