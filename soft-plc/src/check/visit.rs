//! Walks over the typed tree.

use crate::check::tree::{
    Argument, Expr, ExprKind, FunctionCall, Place, Receiver, StepKind, Stmt, StmtKind,
};

/// A node of the tree; each is shown before what is inside it.
#[derive(Clone, Copy, Debug)]
pub enum Node<'a> {
    Stmt(&'a Stmt),
    Place(&'a Place),
    Expr(&'a Expr),
    /// A function called, as a statement or in an expression.
    Call(&'a FunctionCall),
}

/// Calls `f` with every node in the statements.
pub fn visit(body: &[Stmt], f: &mut dyn FnMut(Node<'_>)) {
    for stmt in body {
        f(Node::Stmt(stmt));
        match &stmt.kind {
            StmtKind::Assign(target, value) => {
                place(target, f);
                expr(value, f);
            }
            StmtKind::Call(inner) => call(inner, f),
            StmtKind::Invoke(inner) => {
                if let Some(instance) = &inner.instance {
                    place(instance, f);
                }
                inner.inputs.iter().for_each(|(_, e)| expr(e, f));
                inner.in_outs.iter().for_each(|p| place(p, f));
                inner.outputs.iter().for_each(|(_, p, _)| place(p, f));
            }
            StmtKind::If(branches, otherwise) => {
                for (condition, body) in branches {
                    expr(condition, f);
                    visit(body, f);
                }
                visit(otherwise, f);
            }
            StmtKind::Case {
                selector,
                branches,
                otherwise,
            } => {
                expr(selector, f);
                branches.iter().for_each(|(_, body)| visit(body, f));
                visit(otherwise, f);
            }
            StmtKind::For(data) => {
                place(&data.var, f);
                for bound in [&data.from, &data.to, &data.by] {
                    expr(bound, f);
                }
                visit(&data.body, f);
            }
            StmtKind::While(condition, body) | StmtKind::Repeat(body, condition) => {
                expr(condition, f);
                visit(body, f);
            }
            StmtKind::CopyRegion { array, .. } => place(array, f),
            StmtKind::Block(body) => visit(body, f),
            StmtKind::Exit | StmtKind::Continue | StmtKind::Return => {}
        }
    }
}

fn place(at: &Place, f: &mut dyn FnMut(Node<'_>)) {
    f(Node::Place(at));
    for step in &at.steps {
        match &step.kind {
            StepKind::Index(indices) => indices.iter().for_each(|e| expr(e, f)),
            StepKind::Char(index) | StepKind::Element(index) => expr(index, f),
            _ => {}
        }
    }
}

fn expr(at: &Expr, f: &mut dyn FnMut(Node<'_>)) {
    f(Node::Expr(at));
    match &at.kind {
        ExprKind::Const(_) | ExprKind::Text(_) => {}
        ExprKind::AddressIf(inner, _) => expr(inner, f),
        ExprKind::Load(from) | ExprKind::AddressOf(from) => place(from, f),
        ExprKind::Unary(_, inner) | ExprKind::Convert(inner) | ExprKind::Check(inner, _) => {
            expr(inner, f);
        }
        ExprKind::Binary(_, _, left, right) => {
            expr(left, f);
            expr(right, f);
        }
        ExprKind::Std(_, args) => args.iter().for_each(|e| expr(e, f)),
        ExprKind::Call(inner) => call(inner, f),
        ExprKind::Enabled(inner) => {
            [&inner.condition, &inner.value, &inner.otherwise]
                .into_iter()
                .for_each(|e| expr(e, f));
            visit(&inner.on, f);
            visit(&inner.off, f);
        }
    }
}

fn call(at: &FunctionCall, f: &mut dyn FnMut(Node<'_>)) {
    f(Node::Call(at));
    match &at.receiver {
        Some(Receiver::Fixed(from) | Receiver::Derived(from) | Receiver::Interface(from, _)) => {
            place(from, f)
        }
        None => {}
    }
    for arg in &at.args {
        match arg {
            Argument::Input(value) => expr(value, f),
            Argument::Output {
                target: Some(target),
                ..
            }
            | Argument::InOut(target) => place(target, f),
            Argument::Output { target: None, .. } => {}
        }
    }
}

/// Calls `f` with every place in the statements, those inside expressions included.
pub fn visit_places(body: &[Stmt], f: &mut dyn FnMut(&Place)) {
    visit(body, &mut |node| {
        if let Node::Place(place) = node {
            f(place);
        }
    });
}

/// Calls `f` with the place and with those inside its indices.
pub fn visit_place(at: &Place, f: &mut dyn FnMut(&Place)) {
    place(at, &mut |node| {
        if let Node::Place(place) = node {
            f(place);
        }
    });
}

/// Calls `f` with every node in the expression.
pub fn visit_nodes(at: &Expr, f: &mut dyn FnMut(Node<'_>)) {
    expr(at, f);
}

/// Calls `f` with every place that the expression reads.
pub fn visit_expr(at: &Expr, f: &mut dyn FnMut(&Place)) {
    expr(at, &mut |node| {
        if let Node::Place(place) = node {
            f(place);
        }
    });
}

/// Calls `f` with every place that the statements write themselves (not what called POUs write on their own), and whether
/// it is passed by reference.
pub fn visit_writes(body: &[Stmt], f: &mut dyn FnMut(&Place, bool)) {
    visit(body, &mut |node| match node {
        Node::Stmt(stmt) => match &stmt.kind {
            StmtKind::Assign(target, _) => f(target, false),
            StmtKind::For(data) => f(&data.var, false),
            StmtKind::Invoke(inner) => {
                inner.in_outs.iter().for_each(|p| f(p, true));
                inner.outputs.iter().for_each(|(_, p, _)| f(p, false));
            }
            StmtKind::CopyRegion {
                array,
                to_bytes: true,
                ..
            } => f(array, false),
            _ => {}
        },
        Node::Call(inner) => {
            for arg in &inner.args {
                match arg {
                    Argument::Output {
                        target: Some(target),
                        ..
                    } => f(target, false),
                    Argument::InOut(target) => f(target, true),
                    Argument::Input(_) | Argument::Output { target: None, .. } => {}
                }
            }
        }
        Node::Place(_) | Node::Expr(_) => {}
    });
}
