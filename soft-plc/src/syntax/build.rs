//! Builds syntax trees: what the front ends of diagrams, charts and instruction lists lower into.

use crate::source::Span;
use crate::syntax::ast::{
    Arg, BinOp, Expr, ExprKind, Ident, Stmt, StmtKind, TypeSpec, TypeSpecKind, UnOp, VarBlock,
    VarDecl, VarSection,
};

/// Makes nodes that all stand for one place in the text.
#[derive(Clone, Copy, Debug)]
pub struct At(pub Span);

impl At {
    pub fn expr(self, kind: ExprKind) -> Expr {
        Expr { kind, span: self.0 }
    }

    pub fn stmt(self, kind: StmtKind) -> Stmt {
        Stmt { kind, span: self.0 }
    }

    pub fn ident(self, name: &str) -> Ident {
        Ident {
            name: name.to_owned(),
            span: self.0,
        }
    }

    pub fn name(self, name: &str) -> Expr {
        self.expr(ExprKind::Name(name.to_owned()))
    }

    /// `of.field`
    pub fn field(self, of: &str, field: &str) -> Expr {
        self.expr(ExprKind::Field(Box::new(self.name(of)), self.ident(field)))
    }

    pub fn bool(self, value: bool) -> Expr {
        self.expr(ExprKind::Bool(value))
    }

    pub fn int(self, value: i128) -> Expr {
        self.expr(ExprKind::Int(value))
    }

    pub fn not(self, inner: Expr) -> Expr {
        self.expr(ExprKind::Unary(UnOp::Not, Box::new(inner)))
    }

    pub fn binary(self, op: BinOp, left: Expr, right: Expr) -> Expr {
        self.expr(ExprKind::Binary(op, Box::new(left), Box::new(right)))
    }

    pub fn and(self, left: Expr, right: Expr) -> Expr {
        self.binary(BinOp::And, left, right)
    }

    /// At least one of them; `None` of none.
    pub fn any(self, list: impl IntoIterator<Item = Expr>) -> Option<Expr> {
        self.join(BinOp::Or, list.into_iter().collect())
    }

    /// All of them; `None` of none.
    pub fn all(self, list: impl IntoIterator<Item = Expr>) -> Option<Expr> {
        self.join(BinOp::And, list.into_iter().collect())
    }

    /// As a tree whose depth grows with the logarithm of the number, however many there are.
    fn join(self, op: BinOp, mut list: Vec<Expr>) -> Option<Expr> {
        if list.len() < 2 {
            return list.pop();
        }
        let right = list.split_off(list.len() / 2);
        let (left, right) = (self.join(op, list)?, self.join(op, right)?);
        Some(self.binary(op, left, right))
    }

    pub fn assign(self, target: Expr, value: Expr) -> Stmt {
        self.stmt(StmtKind::Assign(target, value))
    }

    pub fn if_then(self, condition: Expr, body: Vec<Stmt>) -> Stmt {
        self.stmt(StmtKind::If(vec![(condition, body)], Vec::new()))
    }

    pub fn input(self, name: &str, value: Expr) -> Arg {
        Arg {
            name: Some(self.ident(name)),
            output: false,
            negated: false,
            value: Some(value),
        }
    }

    pub fn output(self, name: &str, target: Expr) -> Arg {
        Arg {
            output: true,
            ..self.input(name, target)
        }
    }

    pub fn call(self, callee: Expr, args: Vec<Arg>) -> Expr {
        self.expr(ExprKind::Call(Box::new(callee), args))
    }

    pub fn invoke(self, callee: Expr, args: Vec<Arg>) -> Stmt {
        self.stmt(StmtKind::Call(self.call(callee, args)))
    }

    pub fn mc_time(self) -> Expr {
        self.call(self.name("__MC_TIME"), Vec::new())
    }

    pub fn var(self, name: &str, ty: &str) -> VarDecl {
        self.var_of(name, TypeSpecKind::Named(self.ident(ty)))
    }

    /// A wire: its type is that of the value that it gets.
    pub fn wire(self, name: &str) -> VarDecl {
        self.var_of(name, TypeSpecKind::Inferred)
    }

    fn var_of(self, name: &str, kind: TypeSpecKind) -> VarDecl {
        VarDecl {
            name: self.ident(name),
            location: None,
            spec: TypeSpec { kind, span: self.0 },
            init: None,
            edge: None,
        }
    }
}

pub fn block(section: VarSection, decls: Vec<VarDecl>) -> VarBlock {
    VarBlock {
        access: None,
        section,
        constant: false,
        retain: false,
        decls,
    }
}

/// Parts of a body between labels, and jumps between them, as statements without jumps.
///
/// `segments[k]` runs when the counter `pc` is at most k; a jump sets the counter and starts over.
pub fn with_jumps(at: At, pc: &str, segments: Vec<Vec<Stmt>>) -> Vec<Stmt> {
    let end = segments.len() as i128;
    let counter = || at.name(pc);
    let mut round = Vec::new();
    for (number, segment) in segments.into_iter().enumerate() {
        let here = at.binary(BinOp::Le, counter(), at.int(number as i128));
        round.push(at.if_then(here, segment));
    }
    round.push(at.assign(counter(), at.int(end)));
    vec![
        at.assign(counter(), at.int(0)),
        at.stmt(StmtKind::While(
            at.binary(BinOp::Lt, counter(), at.int(end)),
            round,
        )),
    ]
}

/// The jump to segment `number`.
pub fn jump(at: At, pc: &str, number: usize) -> Vec<Stmt> {
    vec![
        at.assign(at.name(pc), at.int(number as i128)),
        at.stmt(StmtKind::Continue),
    ]
}
