//! Warnings about programs that are right by the rules and probably wrong by intention.

use std::collections::{BTreeMap, BTreeSet};

use crate::check::tree::{
    Expr, ExprKind, For, Location, Place, Pou, PouId, Root, StepKind, Stmt, StmtKind, TypedProject,
    VarId,
};
use crate::check::visit::{Node, visit, visit_writes};
use crate::diag::{Diagnostic, Problem, finish_all};
use crate::image;
use crate::source::Span;
use crate::syntax::ast::{BinOp, PouKind, VarSection};
use crate::types::{Elem, TypeKind};
use crate::value::Value;

/// All warnings about the project's own POUs.
pub fn lint(project: &TypedProject) -> Vec<Diagnostic> {
    let mut linter = Linter {
        project,
        problems: Vec::new(),
    };
    for (index, pou) in project.pous.iter().enumerate() {
        if !pou.library && !pou.name.starts_with("__") {
            linter.pou(PouId(index as u32), pou);
        }
    }
    linter.unused();
    linter.writers();
    finish_all(linter.problems, &project.sources)
}

struct Linter<'p> {
    project: &'p TypedProject,
    problems: Vec<Problem>,
}

/// Variables that are mentioned, and those that are written, by one list of statements.
fn uses(body: &[Stmt]) -> (BTreeSet<VarId>, BTreeSet<VarId>) {
    let mut seen = BTreeMap::new();
    visit(body, &mut |node| {
        if let Node::Place(place) = node
            && let Root::Var(id) = place.root
        {
            *seen.entry(id).or_insert(0u32) += 1;
        }
    });
    let mut written = BTreeSet::new();
    visit_writes(body, &mut |place, _| {
        if let Root::Var(id) = place.root {
            written.insert(id);
        }
    });
    // Whose address is taken may be written through it.
    visit(body, &mut |node| {
        if let Node::Expr(Expr {
            kind: ExprKind::AddressOf(place),
            ..
        }) = node
            && let Root::Var(id) = place.root
        {
            written.insert(id);
        }
    });
    (seen.into_keys().collect(), written)
}

/// Variables that the project mentions, and those that it writes, as far as its statements tell.
fn used(project: &TypedProject) -> (BTreeSet<VarId>, BTreeSet<VarId>) {
    let mut seen = BTreeSet::new();
    let mut written = BTreeSet::new();
    for pou in &project.pous {
        let (s, w) = uses(&pou.body);
        seen.extend(s);
        written.extend(w);
        // Members of instances are reached from outside.
        visit(&pou.body, &mut |node| {
            if let Node::Place(place) = node {
                for step in &place.steps {
                    if let StepKind::Member(id) = step.kind {
                        seen.insert(id);
                        written.insert(id);
                    }
                }
            }
        });
    }
    (seen, written)
}

/// Whether some statement may give the variable a value; without one it keeps its initial value for ever.
#[must_use]
pub fn may_be_written(project: &TypedProject, var: VarId) -> bool {
    used(project).1.contains(&var)
}

impl Linter<'_> {
    fn warn(&mut self, code: &'static str, span: Span, pou: &str, message: String, hint: &str) {
        self.problems
            .push(Problem::warning(code, span, message).hint(hint).in_pou(pou));
    }

    fn pou(&mut self, id: PouId, pou: &Pou) {
        self.statements(&pou.body, &pou.name);
        self.outputs(id, pou);
    }

    /// Statements that can never run, and conditions that are always the same.
    fn statements(&mut self, body: &[Stmt], pou: &str) {
        for (index, stmt) in body.iter().enumerate() {
            let leaves = matches!(
                stmt.kind,
                StmtKind::Return | StmtKind::Exit | StmtKind::Continue
            );
            if leaves && let Some(next) = body.get(index + 1) {
                self.warn(
                    "W703",
                    next.span,
                    pou,
                    "this statement is never reached".to_owned(),
                    "remove it, or the statement before it that leaves",
                );
            }
            match &stmt.kind {
                StmtKind::If(branches, otherwise) => {
                    for (condition, inner) in branches {
                        self.condition(condition, pou);
                        self.statements(inner, pou);
                    }
                    self.statements(otherwise, pou);
                }
                StmtKind::Case {
                    branches,
                    otherwise,
                    ..
                } => {
                    for (_, inner) in branches {
                        self.statements(inner, pou);
                    }
                    self.statements(otherwise, pou);
                }
                StmtKind::For(data) => {
                    self.loop_variable(data, pou);
                    self.statements(&data.body, pou);
                }
                // WHILE TRUE with an EXIT inside is usual.
                StmtKind::While(condition, inner) => {
                    if !matches!(condition.kind, ExprKind::Const(Value::Bool(true))) {
                        self.condition(condition, pou);
                    }
                    self.statements(inner, pou);
                }
                StmtKind::Repeat(inner, condition) => {
                    if !matches!(condition.kind, ExprKind::Const(_)) {
                        self.condition(condition, pou);
                    }
                    self.statements(inner, pou);
                }
                StmtKind::Block(inner) => self.statements(inner, pou),
                _ => {}
            }
        }
    }

    /// The statements of a FOR shall not write its variable (clause 7.3.3.4.2): it may never end.
    fn loop_variable(&mut self, data: &For, pou: &str) {
        let Root::Var(variable) = data.var.root else {
            return;
        };
        if !data.var.steps.is_empty() {
            return;
        }
        let mut written = None;
        visit_writes(&data.body, &mut |place, _| {
            if matches!(place.root, Root::Var(id) if id == variable) {
                written.get_or_insert(place.span);
            }
        });
        if let Some(span) = written {
            let name = &self.project.var(variable).name;
            let message = format!("`{name}` counts the loop, and is written in it");
            self.warn("W716", span, pou, message, "use another variable, or WHILE");
        }
    }

    fn condition(&mut self, condition: &Expr, pou: &str) {
        // What diagrams and charts write themselves stands for no text of its own.
        let text = self.project.sources.slice(condition.span);
        if text.is_empty() || text.starts_with('<') {
            return;
        }
        if let Some(value) = always(self.project, condition) {
            let word = if value { "true" } else { "false" };
            self.warn(
                "W704",
                condition.span,
                pou,
                format!("this condition is always {word}"),
                "compare with something that can change, or remove the condition",
            );
        }
    }

    /// Outputs and results that nothing gives a value.
    fn outputs(&mut self, id: PouId, pou: &Pou) {
        if pou.is_abstract || pou.body.is_empty() {
            return;
        }
        let (_, mut written) = uses(&pou.body);
        for (_, method) in &pou.methods {
            written.extend(uses(&self.project.pou(*method).body).1);
        }
        for var in pou.vars.iter().chain(pou.result.as_ref()) {
            let data = self.project.var(*var);
            let is_result = pou.result == Some(*var);
            let counts = data.owner == Some(id)
                && (is_result || data.section == VarSection::Output)
                && data.init.is_none()
                && data.location.is_none()
                && !data.name.starts_with("__")
                && !matches!(self.project.types.kind(data.ty), TypeKind::FunctionBlock(_));
            if counts && !written.contains(var) {
                let (what, span) = if is_result {
                    (
                        format!("the result of {} is never assigned", pou.name),
                        pou.name_span,
                    )
                } else {
                    (
                        format!("the output `{}` is never assigned", data.name),
                        data.span,
                    )
                };
                self.warn(
                    "W706",
                    span,
                    &pou.name,
                    what,
                    "assign a value, or remove it",
                );
            }
        }
    }

    /// Variables that nothing mentions, and those that are read but never written.
    fn unused(&mut self) {
        let (seen, written) = used(self.project);
        for (index, var) in self.project.vars.iter().enumerate() {
            let id = VarId(index as u32);
            let Some(owner) = var.owner else { continue };
            let pou = self.project.pou(owner);
            // Of a function what was made of it is looked at; a function block shares its variables with that.
            let stands_for_none = pou.pattern && pou.kind != PouKind::FunctionBlock;
            if pou.library
                || stands_for_none
                || pou.name.starts_with("__")
                || pou.is_abstract
                || var.name.starts_with("__")
                || pou.result == Some(id)
                || var.constant
                || !matches!(var.section, VarSection::Local | VarSection::Temp)
            {
                continue;
            }
            // Steps of charts are declared by the chart.
            if let TypeKind::FunctionBlock(of) = self.project.types.kind(var.ty)
                && self.project.pou(*of).name.starts_with("__")
            {
                continue;
            }
            let name = pou.name.clone();
            if !seen.contains(&id) {
                if var.location.is_none() {
                    self.warn(
                        "W702",
                        var.span,
                        &name,
                        format!("the variable `{}` is never used", var.name),
                        "remove it",
                    );
                }
            } else if !written.contains(&id)
                && var.init.is_none()
                && var.location.is_none()
                && !var.open_input
                && self.project.types.elem(var.ty).is_some()
                && pou.kind != PouKind::Program
            {
                self.warn(
                    "W708",
                    var.span,
                    &name,
                    format!("the variable `{}` is read but never written", var.name),
                    "give it an initial value, declare it CONSTANT, or assign it",
                );
            }
        }
    }

    /// Outputs of the process image that several POUs, or several variables, write.
    fn writers(&mut self) {
        // First bit, last bit, who writes, where.
        let mut all: Vec<(u64, u64, PouId, Option<VarId>, Span)> = Vec::new();
        let mut texts = BTreeSet::new();
        for (index, pou) in self.project.pous.iter().enumerate() {
            let id = PouId(index as u32);
            // What was made of one text for several kinds of arrays is one writer.
            if !pou.body.is_empty() && !texts.insert(pou.name_span) {
                continue;
            }
            let mut seen = BTreeSet::new();
            let mut note = |place: &Place| {
                let (location, var) = match place.root {
                    Root::Direct(location) => (location, None),
                    Root::Var(var) => match self.project.var(var).location {
                        Some(location) => (location, Some(var)),
                        None => return,
                    },
                    Root::This => return,
                };
                if !location.output || location.memory {
                    return;
                }
                let (first, last) = bits(self.project, location, var, place);
                if seen.insert((first, last, var)) {
                    all.push((first, last, id, var, place.span));
                }
            };
            visit_writes(&pou.body, &mut |place, _| note(place));
        }
        for (number, one) in all.iter().enumerate() {
            let other = all[..number]
                .iter()
                .find(|o| o.0 <= one.1 && one.0 <= o.1 && (o.2 != one.2 || o.3 != one.3));
            if let Some(other) = other {
                let (a, b) = (
                    self.project.pou(other.2).name.clone(),
                    self.project.pou(one.2).name.clone(),
                );
                let text = self.project.sources.slice(one.4).to_owned();
                let message = if a == b {
                    format!("the output behind `{text}` is written through another name too")
                } else {
                    format!("the output `{text}` is written by {a} and by {b}")
                };
                self.warn(
                    "W707",
                    one.4,
                    &b,
                    message,
                    "let one POU write an output, and others tell it what they want",
                );
            }
        }
    }
}

/// First and last bit of the image that a place takes: of an array all that its index may mean.
fn bits(
    project: &TypedProject,
    location: Location,
    var: Option<VarId>,
    place: &Place,
) -> (u64, u64) {
    let first = u64::from(location.byte) * 8 + u64::from(location.bit.unwrap_or(0));
    if let Some(id) = var {
        let types = &project.types;
        let (mut from, mut spread, mut ty) = (first, 0, project.var(id).ty);
        for step in &place.steps {
            match (&step.kind, types.kind(ty)) {
                (StepKind::Field(index, owner), _) => {
                    from += image::field_bit(types, *owner, *index);
                }
                (StepKind::Index(indices), TypeKind::Array { dims, elem }) => {
                    let stride = image::stride_bits(types, *elem);
                    let (least, most) = elements(indices, dims);
                    from += least * stride;
                    spread += (most - least) * stride;
                }
                _ => break,
            }
            ty = step.ty;
        }
        if let Some((bits, _)) = image::extent(types, ty) {
            return (from, from + spread + bits - 1);
        }
    }
    if location.bit.is_some() {
        return (first, first);
    }
    let width = match location.size {
        'W' => 16,
        'D' => 32,
        'L' => 64,
        _ => 8,
    };
    (first, first + width - 1)
}

/// Numbers of the first and the last element of an array that the indices may mean.
fn elements(indices: &[Expr], dims: &[(i64, i64)]) -> (u64, u64) {
    let (mut from, mut to) = (0, 0);
    for (index, (low, high)) in indices.iter().zip(dims) {
        let len = (high - low + 1).unsigned_abs();
        let known = match &index.kind {
            ExprKind::Const(value) => value.as_i128(),
            _ => None,
        };
        let known = known.map(|v| (v - i128::from(*low)).unsigned_abs() as u64);
        let (least, most) = known.map_or((0, len - 1), |v| (v, v));
        (from, to) = (from * len + least, to * len + most);
    }
    (from, to)
}

/// The value of a condition that cannot change.
fn always(project: &TypedProject, condition: &Expr) -> Option<bool> {
    match &condition.kind {
        ExprKind::Const(value) => value.as_bool(),
        ExprKind::Unary(_, inner) => always(project, inner).map(|v| !v),
        ExprKind::Binary(op, Elem::Bool, a, b) if op.is_logic() => {
            let (a, b) = (always(project, a), always(project, b));
            match op {
                BinOp::And if a == Some(false) || b == Some(false) => Some(false),
                BinOp::And => Some(a? && b?),
                BinOp::Or if a == Some(true) || b == Some(true) => Some(true),
                BinOp::Or => Some(a? || b?),
                _ => None,
            }
        }
        ExprKind::Binary(op, elem, left, right) if op.is_comparison() => {
            if let (ExprKind::Load(a), ExprKind::Load(b)) = (&left.kind, &right.kind)
                && let (Some(a), Some(b)) = (project.path_of(a), project.path_of(b))
                && a == b
                && !elem.is_real()
            {
                return Some(matches!(op, BinOp::Eq | BinOp::Le | BinOp::Ge));
            }
            let (lo, hi) = elem.limits()?;
            let (op, bound) = match (&left.kind, &right.kind) {
                (_, ExprKind::Const(v)) => (*op, v.as_i128()?),
                (ExprKind::Const(v), _) => (mirrored(*op), v.as_i128()?),
                _ => return None,
            };
            // A value between lo and hi against a bound.
            match op {
                BinOp::Lt if bound <= lo => Some(false),
                BinOp::Lt if bound > hi => Some(true),
                BinOp::Le if bound >= hi => Some(true),
                BinOp::Le if bound < lo => Some(false),
                BinOp::Gt if bound >= hi => Some(false),
                BinOp::Gt if bound < lo => Some(true),
                BinOp::Ge if bound <= lo => Some(true),
                BinOp::Ge if bound > hi => Some(false),
                _ => None,
            }
        }
        _ => None,
    }
}

fn mirrored(op: BinOp) -> BinOp {
    match op {
        BinOp::Lt => BinOp::Gt,
        BinOp::Le => BinOp::Ge,
        BinOp::Gt => BinOp::Lt,
        BinOp::Ge => BinOp::Le,
        op => op,
    }
}
