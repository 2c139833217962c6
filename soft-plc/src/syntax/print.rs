//! Writes a POU as Structured Text: what is read again gives the same syntax tree.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use crate::syntax::ast::{
    Access, Arg, CaseLabel, Edge, Expr, ExprKind, Ident, Init, Pou, PouKind, Stmt, StmtKind,
    TypeSpec, TypeSpecKind, UnOp, VarBlock, VarDecl, VarSection,
};
use crate::types::Elem;
use crate::value::{Value, format_time};

/// What is written otherwise than it stands in the tree.
pub struct Words<'a> {
    /// The name that is written for a name.
    pub name: &'a dyn Fn(&str) -> String,
    /// What stands for a variable of the POU where its statements and those of its methods name it.
    pub variable: &'a dyn Fn(&str) -> Option<String>,
    /// The type of a wire of a diagram, which its declaration does not say.
    pub wire: &'a dyn Fn(&str) -> Option<String>,
}

/// The text of a POU, its methods included.
pub fn pou(pou: &Pou, words: &Words<'_>) -> String {
    let mut printer = Printer {
        words,
        out: String::new(),
        depth: 0,
        own: BTreeSet::new(),
    };
    printer.pou(pou);
    printer.out
}

fn word_of(access: Access) -> &'static str {
    match access {
        Access::Public => "PUBLIC",
        Access::Internal => "INTERNAL",
        Access::Protected => "PROTECTED",
        Access::Private => "PRIVATE",
    }
}

struct Printer<'a> {
    words: &'a Words<'a>,
    out: String,
    depth: usize,
    /// Names of the method that is being written, in upper case: they hide those of its POU.
    own: BTreeSet<String>,
}

impl Printer<'_> {
    fn line(&mut self, text: &str) {
        let _ = writeln!(
            self.out,
            "{:width$}{text}",
            "",
            width = self.depth.min(60) * 4
        );
    }

    fn inside(&mut self, f: impl FnOnce(&mut Self)) {
        self.depth += 1;
        f(self);
        self.depth -= 1;
    }

    fn name(&self, name: &str) -> String {
        (self.words.name)(name)
    }

    fn names(&self, list: &[Ident]) -> String {
        let names: Vec<String> = list.iter().map(|i| self.name(&i.name)).collect();
        names.join(", ")
    }

    fn pou(&mut self, pou: &Pou) {
        let class = &pou.class;
        let mut head = pou.kind.to_string();
        let access = match class.access {
            // What is not said means PROTECTED in the standard.
            Access::Public => (pou.kind == PouKind::Method).then_some("PUBLIC"),
            other => Some(word_of(other)),
        };
        let flags = [
            access,
            class.is_abstract.then_some("ABSTRACT"),
            class.is_final.then_some("FINAL"),
            class.is_override.then_some("OVERRIDE"),
        ];
        for flag in flags.into_iter().flatten() {
            let _ = write!(head, " {flag}");
        }
        let _ = write!(head, " {}", self.name(&pou.name.name));
        if let Some(base) = &class.extends {
            let _ = write!(head, " EXTENDS {}", self.name(&base.name));
        }
        if !class.implements.is_empty() {
            let _ = write!(head, " IMPLEMENTS {}", self.names(&class.implements));
        }
        if let Some(result) = &pou.result {
            let _ = write!(head, " : {}", self.type_spec(result));
        }
        self.line(&head);
        for path in &class.usings {
            self.line(&format!("USING {};", path.name));
        }
        for block in &pou.vars {
            self.block(block);
        }
        for method in &class.methods {
            let decls = method.vars.iter().flat_map(|b| &b.decls);
            let names = decls.map(|d| &d.name).chain([&method.name]);
            self.own = names.map(|n| n.name.to_ascii_uppercase()).collect();
            self.inside(|p| p.pou(method));
            self.own.clear();
        }
        self.statements(&pou.body);
        self.line(match pou.kind {
            PouKind::Program => "END_PROGRAM",
            PouKind::Function => "END_FUNCTION",
            PouKind::FunctionBlock => "END_FUNCTION_BLOCK",
            PouKind::Method => "END_METHOD",
        });
    }

    fn block(&mut self, block: &VarBlock) {
        if block.decls.is_empty() {
            return;
        }
        let mut head = block.section.to_string();
        if let Some(access) = block.access {
            let _ = write!(head, " {}", word_of(access));
        }
        if block.constant {
            head.push_str(" CONSTANT");
        }
        if block.retain {
            head.push_str(" RETAIN");
        }
        self.line(&head);
        let is_external = block.section == VarSection::External;
        for decl in &block.decls {
            let text = self.declaration(decl, is_external);
            self.inside(|p| p.line(&text));
        }
        self.line("END_VAR");
    }

    fn declaration(&self, decl: &VarDecl, is_external: bool) -> String {
        let mut text = self.name(&decl.name.name);
        if let Some(location) = &decl.location {
            let _ = write!(text, " AT {}", location.name);
        }
        let wire = matches!(decl.spec.kind, TypeSpecKind::Inferred)
            .then(|| (self.words.wire)(&decl.name.name))
            .flatten();
        let ty = wire.unwrap_or_else(|| self.type_spec(&decl.spec));
        let _ = write!(text, " : {ty}");
        match decl.edge {
            Some(Edge::Rising) => text.push_str(" R_EDGE"),
            Some(Edge::Falling) => text.push_str(" F_EDGE"),
            None => {}
        }
        if let Some(init) = decl.init.as_ref().filter(|_| !is_external) {
            let _ = write!(text, " := {}", self.init(init));
        }
        text.push(';');
        text
    }

    fn type_spec(&self, spec: &TypeSpec) -> String {
        match &spec.kind {
            TypeSpecKind::Named(name) => self.name(&name.name),
            TypeSpecKind::Str { wide, len } => {
                let word = if *wide { "WSTRING" } else { "STRING" };
                match len {
                    Some(len) => format!("{word}[{}]", self.expr(len)),
                    None => word.to_owned(),
                }
            }
            TypeSpecKind::Array { dims, elem } => {
                let dims: Vec<String> = dims
                    .iter()
                    .map(|(lo, hi)| format!("{}..{}", self.expr(lo), self.expr(hi)))
                    .collect();
                format!("ARRAY[{}] OF {}", dims.join(", "), self.type_spec(elem))
            }
            TypeSpecKind::OpenArray { dims, elem } => {
                let stars = vec!["*"; *dims as usize].join(", ");
                format!("ARRAY[{stars}] OF {}", self.type_spec(elem))
            }
            TypeSpecKind::Subrange { base, lo, hi } => {
                format!(
                    "{} ({}..{})",
                    self.name(&base.name),
                    self.expr(lo),
                    self.expr(hi)
                )
            }
            TypeSpecKind::Enum { base, values } => {
                let values: Vec<String> = values
                    .iter()
                    .map(|(name, value)| match value {
                        Some(value) => {
                            format!("{} := {}", self.name(&name.name), self.expr(value))
                        }
                        None => self.name(&name.name),
                    })
                    .collect();
                let values = format!("({})", values.join(", "));
                match base {
                    Some(base) => format!("{} {values}", self.name(&base.name)),
                    None => values,
                }
            }
            TypeSpecKind::Struct { overlap, fields } => {
                let overlap = if *overlap { "OVERLAP " } else { "" };
                let fields: Vec<String> =
                    fields.iter().map(|f| self.declaration(f, false)).collect();
                format!("STRUCT {overlap}{} END_STRUCT", fields.join(" "))
            }
            TypeSpecKind::Ref(to) => format!("REF_TO {}", self.type_spec(to)),
            TypeSpecKind::Pointer(to) => format!("POINTER TO {}", self.type_spec(to)),
            TypeSpecKind::Inferred => "BOOL".to_owned(),
        }
    }

    fn init(&self, init: &Init) -> String {
        match init {
            Init::Expr(expr) => self.expr(expr),
            Init::Array(items, _) => {
                let items: Vec<String> = items
                    .iter()
                    .map(|(count, item)| match count {
                        Some(count) => format!("{}({})", self.expr(count), self.init(item)),
                        None => self.init(item),
                    })
                    .collect();
                format!("[{}]", items.join(", "))
            }
            Init::Struct(fields, _) => {
                let fields: Vec<String> = fields
                    .iter()
                    .map(|(name, item)| format!("{} := {}", self.name(&name.name), self.init(item)))
                    .collect();
                format!("({})", fields.join(", "))
            }
        }
    }

    /// Statements one level deeper; an empty list is an empty statement.
    fn statements(&mut self, list: &[Stmt]) {
        self.inside(|p| {
            if list.is_empty() {
                p.line(";");
            }
            list.iter().for_each(|s| p.statement(s));
        });
    }

    fn statement(&mut self, stmt: &Stmt) {
        match &stmt.kind {
            StmtKind::Assign(target, value) => {
                let text = format!("{} := {};", self.expr(target), self.expr(value));
                self.line(&text);
            }
            StmtKind::TryAssign(target, value) => {
                let text = format!("{} ?= {};", self.expr(target), self.expr(value));
                self.line(&text);
            }
            StmtKind::Call(call) => {
                let text = format!("{};", self.expr(call));
                self.line(&text);
            }
            StmtKind::If(branches, otherwise) => {
                for (index, (condition, body)) in branches.iter().enumerate() {
                    let word = if index == 0 { "IF" } else { "ELSIF" };
                    let text = format!("{word} {} THEN", self.expr(condition));
                    self.line(&text);
                    self.statements(body);
                }
                if !otherwise.is_empty() {
                    self.line("ELSE");
                    self.statements(otherwise);
                }
                self.line("END_IF;");
            }
            StmtKind::Case(selector, branches, otherwise) => {
                let text = format!("CASE {} OF", self.expr(selector));
                self.line(&text);
                for (labels, body) in branches {
                    let labels: Vec<String> = labels
                        .iter()
                        .map(|label| match label {
                            CaseLabel::Single(value) => self.expr(value),
                            CaseLabel::Range(from, to) => {
                                format!("{}..{}", self.expr(from), self.expr(to))
                            }
                        })
                        .collect();
                    let text = format!("{}:", labels.join(", "));
                    self.inside(|p| {
                        p.line(&text);
                        p.statements(body);
                    });
                }
                if let Some(otherwise) = otherwise {
                    self.line("ELSE");
                    self.statements(otherwise);
                }
                self.line("END_CASE;");
            }
            StmtKind::For(head) => {
                let mut text = format!(
                    "FOR {} := {} TO {}",
                    self.expr(&head.var),
                    self.expr(&head.from),
                    self.expr(&head.to)
                );
                if let Some(by) = &head.by {
                    let _ = write!(text, " BY {}", self.expr(by));
                }
                text.push_str(" DO");
                self.line(&text);
                self.statements(&head.body);
                self.line("END_FOR;");
            }
            StmtKind::While(condition, body) => {
                let text = format!("WHILE {} DO", self.expr(condition));
                self.line(&text);
                self.statements(body);
                self.line("END_WHILE;");
            }
            StmtKind::Repeat(body, until) => {
                self.line("REPEAT");
                self.statements(body);
                let text = format!("UNTIL {}", self.expr(until));
                self.line(&text);
                self.line("END_REPEAT;");
            }
            StmtKind::Exit => self.line("EXIT;"),
            StmtKind::Continue => self.line("CONTINUE;"),
            StmtKind::Return => self.line("RETURN;"),
            // Structured Text has no such statement: `plain` has taken care of what RETURN means in it.
            StmtKind::Block(body) => body.iter().for_each(|s| self.statement(s)),
            StmtKind::Empty => self.line(";"),
        }
    }

    /// An operand: in parentheses unless nothing could tear it apart.
    fn operand(&self, expr: &Expr) -> String {
        let is_one = match &expr.kind {
            ExprKind::Binary(..) | ExprKind::Unary(..) => false,
            ExprKind::Int(value) => *value >= 0,
            ExprKind::Real(value) => value.is_sign_positive(),
            _ => true,
        };
        let text = self.expr(expr);
        if is_one { text } else { format!("({text})") }
    }

    fn expr(&self, expr: &Expr) -> String {
        match &expr.kind {
            ExprKind::Int(value) => value.to_string(),
            ExprKind::Real(value) => real(*value),
            ExprKind::Bool(value) => Value::Bool(*value).to_string(),
            ExprKind::Time(ns) => format_time(*ns),
            ExprKind::Str(text) => string(text, '\''),
            ExprKind::WStr(text) => string(text, '"'),
            ExprKind::Date(Elem::Date, ns) => Value::Date(*ns).to_string(),
            ExprKind::Date(Elem::Tod, ns) => Value::Tod(*ns).to_string(),
            ExprKind::Date(_, ns) => Value::Dt(*ns).to_string(),
            ExprKind::Null => "NULL".to_owned(),
            ExprKind::Deref(of) => format!("{}^", self.operand(of)),
            ExprKind::Partial(of, size, number) => {
                format!("{}.%{size}{number}", self.operand(of))
            }
            ExprKind::Typed(elem, value) => format!("{elem}#{}", self.expr(value)),
            ExprKind::EnumValue(ty, value) => {
                format!("{}#{}", self.name(&ty.name), self.name(&value.name))
            }
            ExprKind::Name(name) => {
                let is_own = self.own.contains(&name.to_ascii_uppercase());
                let other = (!is_own).then(|| (self.words.variable)(name)).flatten();
                other.unwrap_or_else(|| self.name(name))
            }
            ExprKind::Direct(address) => address.clone(),
            ExprKind::Field(of, field) => {
                format!("{}.{}", self.operand(of), self.name(&field.name))
            }
            ExprKind::Bit(of, bit) => format!("{}.{bit}", self.operand(of)),
            ExprKind::Index(of, indices) => {
                let indices: Vec<String> = indices.iter().map(|i| self.expr(i)).collect();
                format!("{}[{}]", self.operand(of), indices.join(", "))
            }
            ExprKind::Call(callee, args) => {
                let args: Vec<String> = args.iter().map(|a| self.argument(a)).collect();
                let callee = match &callee.kind {
                    ExprKind::Name(name) => self.name(name),
                    _ => self.operand(callee),
                };
                format!("{callee}({})", args.join(", "))
            }
            ExprKind::Unary(UnOp::Not, inner) => format!("NOT {}", self.operand(inner)),
            ExprKind::Unary(UnOp::Neg, inner) => format!("-{}", self.operand(inner)),
            ExprKind::Binary(op, left, right) => {
                format!(
                    "{} {} {}",
                    self.operand(left),
                    op.text(),
                    self.operand(right)
                )
            }
        }
    }

    fn argument(&self, arg: &Arg) -> String {
        let mut text = String::new();
        if let Some(name) = &arg.name {
            let not = if arg.negated { "NOT " } else { "" };
            let arrow = if arg.output { "=>" } else { ":=" };
            let _ = write!(text, "{not}{} {arrow} ", self.name(&name.name));
        }
        if let Some(value) = &arg.value {
            text.push_str(&self.expr(value));
        }
        text
    }
}

/// With the point that the standard asks for: `1.0E-7`.
fn real(value: f64) -> String {
    if value.is_infinite() {
        return if value > 0.0 { "1.0E999" } else { "-1.0E999" }.to_owned();
    }
    let text = format!("{value:?}").to_ascii_uppercase();
    match text.split_once('E') {
        Some((number, exponent)) if !number.contains('.') => format!("{number}.0E{exponent}"),
        _ => text,
    }
}

/// In quotes, with `$` before what cannot stand there.
fn string(text: &str, quote: char) -> String {
    let mut out = String::from(quote);
    for c in text.chars() {
        match c {
            '$' => out.push_str("$$"),
            c if c == quote => {
                out.push('$');
                out.push(quote);
            }
            c if c.is_control() => {
                let digits = if quote == '"' { 4 } else { 2 };
                let _ = write!(out, "${:0digits$X}", u32::from(c));
            }
            c => out.push(c),
        }
    }
    out.push(quote);
    out
}
