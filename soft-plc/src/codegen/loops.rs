//! Loops.

use wasm_encoder::{BlockType, Instruction as I, ValType};

use super::SiteKind;
use super::expr::simple;
use super::fun::{Fun, mem, val};
use super::hold::whole_var;
use crate::check::stdfun::Signature;
use crate::check::tree::{Expr, ExprKind, For, Limits, Place, Root, Stmt, StmtKind};
use crate::check::visit::{Node, visit, visit_writes};
use crate::memory::{SCAN_NUMBER_AT, STOP_AT, STOP_FENCE_AT};
use crate::source::Span;
use crate::syntax::ast::BinOp;
use crate::types::{Elem, TypeKind};
use crate::value::Value;

/// A FOR loop needs no look at the watchdog if it runs at most so many statements, loops inside and called POUs included.
const UNWATCHED_STATEMENTS_MAX: u64 = 128_000;
/// A FOR loop is written out step by step if that makes at most so many nodes of the tree ...
const WRITTEN_OUT_NODES_MAX: u64 = 500;
/// ... and several steps are written into each round of a longer one if they make at most so many.
const ROUND_NODES_MAX: u64 = 260;
/// Steps of a round.
const ROUND_STEPS: [i128; 2] = [4, 2];
/// Steps of a loop that is written out although its statements only compute.
const PURE_STEPS_MAX: i128 = 6;

/// The values of a FOR variable, when all are known.
#[derive(Clone, Copy)]
struct Course {
    from: i128,
    by: i128,
    steps: i128,
}

impl Course {
    /// The value in step number `n`; after the last step, the one behind the loop.
    fn value(&self, n: i128) -> i128 {
        self.from + n * self.by
    }
}

/// The end of each round of a counted loop.
#[derive(Clone)]
pub struct Round {
    var: Place,
    by: Value,
    /// The value with which no more round begins.
    bound: Value,
    upwards: bool,
    /// Depths of the blocks: where the next round begins, and behind the loop.
    top: u32,
    exit: u32,
}

impl Fun<'_, '_> {
    fn advance(&mut self, round: &Round) {
        let elem = self.elem(round.var.ty);
        self.store(&round.var, |f| {
            f.load(&round.var);
            f.constant(round.by, elem);
            f.i(simple(BinOp::Add, elem));
        });
    }

    /// Takes the step; goes to the next round, if there is one.
    fn end_round(&mut self, round: &Round) {
        let elem = self.elem(round.var.ty);
        self.advance(round);
        self.load(&round.var);
        self.constant(round.bound, elem);
        let before = if round.upwards { BinOp::Lt } else { BinOp::Gt };
        self.i(simple(before, elem));
        self.i(I::BrIf(self.label(round.top)));
    }

    /// The same at the end of a branch of CASE, which goes on nowhere else. Machines foresee best what such branches do if each has
    /// a jump of its own.
    pub fn end_branch_of(&mut self, round: &Round) {
        self.end_round(round);
        self.i(I::Br(self.label(round.exit)));
    }

    pub fn while_loop(&mut self, condition: &Expr, body: &[Stmt], span: Span) {
        let outermost = self.watching();
        let start = self.code.len();
        let exit = self.open(I::Block(BlockType::Empty));
        let top = self.open(I::Loop(BlockType::Empty));
        self.watch(span);
        self.expr(condition);
        self.i(I::I32Eqz);
        self.i(I::BrIf(self.label(exit)));
        self.labels.push((exit, top));
        self.stmts(body);
        self.labels.pop();
        self.i(I::Br(self.label(top)));
        self.end_loop(start, span);
        self.watched(outermost);
    }

    pub fn repeat_loop(&mut self, body: &[Stmt], condition: &Expr, span: Span) {
        let outermost = self.watching();
        let start = self.code.len();
        let exit = self.open(I::Block(BlockType::Empty));
        let top = self.open(I::Loop(BlockType::Empty));
        self.watch(span);
        let next = self.open(I::Block(BlockType::Empty));
        self.labels.push((exit, next));
        let stable = self.known.valid.clone();
        self.stmts(body);
        self.known.meet(&stable);
        self.labels.pop();
        self.close();
        self.expr(condition);
        self.i(I::I32Eqz);
        self.i(I::BrIf(self.label(top)));
        self.end_loop(start, span);
        self.watched(outermost);
    }

    fn end_loop(&mut self, start: usize, span: Span) {
        self.close();
        self.close();
        self.loops.push((start, self.code.len(), span));
    }

    /// Whether the FOR variable is in a local that its body does not write.
    fn is_own_counter(&self, data: &For) -> bool {
        let same = |place: &Place| match (&place.root, &data.var.root) {
            (Root::Var(a), Root::Var(b)) => a == b,
            _ => false,
        };
        let mut own = data.var.steps.is_empty() && self.local_of(&data.var).is_some();
        visit_writes(&data.body, &mut |place, _| own &= !same(place));
        own
    }

    /// The values of the variable, if they are constant, nothing else writes it, and the step behind the last does not wrap.
    fn course(&self, data: &For) -> Option<Course> {
        let (from, to, by) = (
            constant_of(&data.from)?,
            constant_of(&data.to)?,
            constant_of(&data.by)?,
        );
        if by == 0 || !self.is_own_counter(data) {
            return None;
        }
        let steps = ((to - from) / by + 1).max(0);
        let none = (to < from && by > 0) || (to > from && by < 0);
        let course = Course {
            from,
            by,
            steps: if none { 0 } else { steps },
        };
        let (low, high) = self.elem(data.var.ty).limits()?;
        (low..=high)
            .contains(&course.value(course.steps))
            .then_some(course)
    }

    /// Whether the loop certainly ends so soon that the watchdog can wait for it.
    fn is_short(&mut self, course: Course, body: &[Stmt]) -> bool {
        let mut rounds = u64::try_from(course.steps).ok();
        visit(body, &mut |node| {
            if let Node::Stmt(Stmt {
                kind: StmtKind::For(inner),
                ..
            }) = node
            {
                // As if each were inside all others: more than it can be.
                let steps = self
                    .course(inner)
                    .and_then(|c| u64::try_from(c.steps.max(1)).ok());
                rounds = rounds.zip(steps).and_then(|(a, b)| a.checked_mul(b));
            }
        });
        rounds.is_some_and(|r| {
            r.saturating_mul(self.m.statements_of(body)) <= UNWATCHED_STATEMENTS_MAX
        })
    }

    /// Before a loop that is watched: brings the number of this scan into a local, if an outer loop has not. What it answers goes to
    /// `watched` behind the loop.
    fn watching(&mut self) -> bool {
        if self.scan_number.is_some() {
            return false;
        }
        let local = self.temp(ValType::I32);
        self.i(I::I32Const(0));
        self.i(I::I32Load(mem(SCAN_NUMBER_AT, 2)));
        self.i(I::LocalSet(local));
        self.scan_number = Some(local);
        true
    }

    fn watched(&mut self, outermost: bool) {
        if outermost && let Some(local) = self.scan_number.take() {
            self.release(local);
        }
    }

    /// At the top of a loop: ends the scan when the watchdog wants it.
    fn watch(&mut self, span: Span) {
        let Some(number) = self.scan_number else {
            return;
        };
        self.i(I::I32Const(0));
        self.i(I::I32Const(0));
        self.i(I::I32Store(mem(STOP_FENCE_AT, 2)));
        self.i(I::I32Const(0));
        self.i(I::I32Load(mem(STOP_AT, 2)));
        self.i(I::LocalGet(number));
        self.i(I::I32Eq);
        self.trap_if(SiteKind::EndlessLoop, span, None);
    }

    pub fn for_loop(&mut self, data: &For, span: Span) {
        match self.course(data) {
            Some(course) => self.counted_loop(data, course, span),
            None => self.open_loop(data, span),
        }
    }

    /// A loop whose steps are known: short ones are written out, of longer ones several steps make a round.
    fn counted_loop(&mut self, data: &For, course: Course, span: Span) {
        let elem = self.elem(data.var.ty);
        let number = |f: &mut Self, value: i128| f.constant(Value::from_i128(elem, value), elem);
        self.store(&data.var, |f| number(f, course.from));
        if course.steps == 0 {
            return;
        }
        let per_round = self.steps_of_round(course.steps, &data.body);
        let rounds = course.steps / per_round;
        let start = self.code.len();
        let exit = self.open(I::Block(BlockType::Empty));
        let written_out = if rounds > 1 { rounds * per_round } else { 0 };
        if rounds > 1 {
            let stable = self.known.valid.clone();
            let short = self.is_short(course, &data.body);
            let outermost = !short && self.watching();
            let top = self.open(I::Loop(BlockType::Empty));
            if !short {
                self.watch(span);
            }
            // Who leaves early needs the variable as it is.
            let id = whole_var(&data.var).filter(|_| !leaves(&data.body));
            let together = if id.is_some() { per_round } else { 1 };
            let round = Round {
                var: data.var.clone(),
                by: Value::from_i128(elem, together * course.by),
                bound: Value::from_i128(elem, course.value(rounds * per_round)),
                upwards: course.by > 0,
                top,
                exit,
            };
            let last = course.value((rounds - 1) * per_round);
            for n in 0..per_round {
                let by = n * course.by;
                let (one, other) = (course.from + by, last + by);
                if n > 0 {
                    match id {
                        Some(id) => drop(self.ahead.insert(id, by)),
                        None => self.advance(&round),
                    }
                }
                let end = (per_round == 1).then_some(&round);
                self.step(data, (one.min(other), one.max(other)), exit, end);
            }
            if let Some(id) = id {
                self.ahead.remove(&id);
            }
            self.end_round(&round);
            self.close();
            self.watched(outermost);
            self.known.meet(&stable);
        }
        for n in written_out..course.steps {
            let value = course.value(n);
            self.step(data, (value, value), exit, None);
            self.store(&data.var, |f| number(f, course.value(n + 1)));
        }
        self.close();
        self.loops.push((start, self.code.len(), span));
    }

    /// How many steps are written into one round of a loop; all of them, if it is to be no loop.
    fn steps_of_round(&self, steps: i128, body: &[Stmt]) -> i128 {
        let weight = self.weight(body);
        let nodes = |n: i128| u64::try_from(n).map_or(u64::MAX, |n| n.saturating_mul(weight));
        if nodes(steps) <= WRITTEN_OUT_NODES_MAX && (steps <= PURE_STEPS_MAX || acts(body)) {
            return steps;
        }
        ROUND_STEPS
            .into_iter()
            .find(|n| *n < steps && nodes(*n) <= ROUND_NODES_MAX)
            .unwrap_or(1)
    }

    /// How much code the statements make, in nodes of the tree; without end where the time goes into loops, calls and strings.
    pub fn weight(&self, body: &[Stmt]) -> u64 {
        let mut nodes = 0u64;
        visit(body, &mut |node| {
            nodes = nodes.saturating_add(match node {
                Node::Stmt(stmt) => match &stmt.kind {
                    // Branches of CASE are foreseen worse when they stand in several copies.
                    StmtKind::For(_)
                    | StmtKind::While(..)
                    | StmtKind::Repeat(..)
                    | StmtKind::Case { .. } => u64::MAX,
                    StmtKind::Invoke(call) => self.weight_in_place(call).unwrap_or(u64::MAX),
                    _ => 1,
                },
                Node::Call(_) => u64::MAX,
                Node::Expr(expr) if is_long(expr) => u64::MAX,
                Node::Place(_) | Node::Expr(_) => 1,
            });
        });
        nodes
    }

    /// The body once, with the variable in this range. Branches of a CASE at its end may end the round on their own.
    fn step(&mut self, data: &For, range: (i128, i128), exit: u32, end: Option<&Round>) {
        self.check_counter(data);
        let stable = self.known.valid.clone();
        let next = self.open(I::Block(BlockType::Empty));
        self.labels.push((exit, next));
        let id = whole_var(&data.var);
        let outer = id.and_then(|id| self.ranges.insert(id, range));
        if let Some((last, before)) = data.body.split_last() {
            self.stmts(before);
            let is_case = matches!(last.kind, StmtKind::Case { .. });
            self.round = end.filter(|_| is_case).cloned();
            self.stmts(std::slice::from_ref(last));
        }
        if let Some(id) = id {
            match outer {
                Some(outer) => self.ranges.insert(id, outer),
                None => self.ranges.remove(&id),
            };
        }
        self.labels.pop();
        self.close();
        if continues(&data.body) {
            self.known.meet(&stable);
        }
    }

    /// The end and the step are evaluated once. A loop up to the largest value of its type ends: the distance to the end is
    /// tested before the step is added, where adding it could wrap.
    fn open_loop(&mut self, data: &For, span: Span) {
        let elem = self.elem(data.var.ty);
        let ty = val(elem);
        let wide = ty == ValType::I64;
        let stable = self.known.valid.clone();
        self.store(&data.var, |f| f.expr(&data.from));
        let known = constant_of;
        let end = known(&data.to).is_none().then(|| self.spill(&data.to));
        let step = known(&data.by).is_none().then(|| self.spill(&data.by));
        // If nothing but the loop writes the variable, its first value is tested once, and each next one where it is made.
        let own = self.is_own_counter(data);
        let outermost = self.watching();
        let start = self.code.len();
        let exit = self.open(I::Block(BlockType::Empty));

        let push_end = |f: &mut Self| match end {
            Some(local) => f.i(I::LocalGet(local)),
            None => f.expr(&data.to),
        };
        let push_step = |f: &mut Self| match step {
            Some(local) => f.i(I::LocalGet(local)),
            None => f.expr(&data.by),
        };
        let zero = if wide { I::I64Const(0) } else { I::I32Const(0) };
        let subtract = if wide { I::I64Sub } else { I::I32Sub };
        let below = if wide { I::I64LtU } else { I::I32LtU };
        let upwards = known(&data.by).map(|s| s > 0);

        // Past the end?
        let push_past = |f: &mut Self, up: bool| {
            f.load(&data.var);
            push_end(f);
            f.i(simple(if up { BinOp::Gt } else { BinOp::Lt }, elem));
        };
        // Does the next step go past the end? With the value in `local`.
        let push_last = |f: &mut Self, up: bool, local: u32| {
            if up {
                push_end(f);
                f.i(I::LocalGet(local));
            } else {
                f.i(I::LocalGet(local));
                push_end(f);
            }
            f.i(subtract.clone());
            if up {
                push_step(f);
            } else {
                f.i(zero.clone());
                push_step(f);
                f.i(subtract.clone());
            }
            f.i(below.clone());
        };
        let either = |f: &mut Self, up: &dyn Fn(&mut Self, bool)| match upwards {
            Some(direction) => up(f, direction),
            None => f.aside(|f| {
                push_step(f);
                f.i(zero.clone());
                f.i(simple(BinOp::Ge, elem));
                f.open(I::If(BlockType::Result(ValType::I32)));
                up(f, true);
                f.i(I::Else);
                up(f, false);
                f.close();
            }),
        };
        let runs = match (known(&data.from), known(&data.to), upwards) {
            (Some(from), Some(to), Some(up)) => from == to || (from < to) == up,
            _ => false,
        };
        if own && !runs {
            either(self, &push_past);
            self.i(I::BrIf(self.label(exit)));
        }
        // What the limits have read may be written by the body.
        self.known.meet(&stable);
        let top = self.open(I::Loop(BlockType::Empty));
        self.watch(span);
        if !own {
            either(self, &push_past);
            self.i(I::BrIf(self.label(exit)));
        }
        self.check_counter(data);
        let next = self.open(I::Block(BlockType::Empty));
        self.labels.push((exit, next));
        // The steps lie between the first value and the last, whichever way the loop goes.
        let step_known = known(&data.by).is_some();
        let to = known(&data.to).filter(|_| step_known);
        let ranged = self.note_range(&data.var, known(&data.from), to, &data.body);
        self.stmts(&data.body);
        self.known.meet(&stable);
        if let Some(var) = ranged {
            self.ranges.remove(&var);
        }
        self.labels.pop();
        self.close();
        let limits = elem.limits().unwrap_or((0, 0));
        let cannot_wrap = match (known(&data.to), known(&data.by)) {
            (Some(to), Some(by)) if own => (limits.0..=limits.1).contains(&(to + by)),
            _ => false,
        };
        // Has the step wrapped? The body may have brought the variable to anything.
        let push_wrapped = |f: &mut Self, up: bool, before: u32| {
            f.load(&data.var);
            f.i(I::LocalGet(before));
            f.i(simple(if up { BinOp::Lt } else { BinOp::Gt }, elem));
        };
        let current = self.temp(ty);
        self.load(&data.var);
        self.i(I::LocalSet(current));
        self.store(&data.var, |f| {
            f.i(I::LocalGet(current));
            push_step(f);
            f.i(simple(BinOp::Add, elem));
            if !cannot_wrap {
                f.normalise_integer(elem);
            }
        });
        if cannot_wrap {
            either(self, &push_past);
        } else if own {
            either(self, &|f, up| push_last(f, up, current));
        } else {
            either(self, &|f, up| push_wrapped(f, up, current));
        }
        self.i(I::I32Eqz);
        self.i(I::BrIf(self.label(top)));
        self.release(current);
        self.end_loop(start, span);
        self.watched(outermost);
        for local in [end, step].into_iter().flatten() {
            self.release(local);
        }
    }

    /// A FOR variable of a subrange keeps to it while the body runs; behind the loop it stands one step further.
    fn check_counter(&mut self, data: &For) {
        let TypeKind::Subrange { lo, hi, .. } = *self.m.project.types.kind(data.var.ty) else {
            return;
        };
        let elem = self.elem(data.var.ty);
        let value = Expr {
            kind: ExprKind::Load(Box::new(data.var.clone())),
            ty: data.var.ty,
            span: data.var.span,
        };
        self.expr(&value);
        self.check(elem, &Limits::Range(lo, hi), &value);
        self.i(I::Drop);
    }

    fn normalise_integer(&mut self, elem: Elem) {
        if val(elem) == ValType::I32 {
            self.normalise(elem);
        }
    }
}

fn constant_of(expr: &Expr) -> Option<i128> {
    match &expr.kind {
        ExprKind::Const(value) => value.as_i128(),
        _ => None,
    }
}

/// Whether the expression is a string, or computed outside of the module.
fn is_long(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Text(_) | ExprKind::Binary(BinOp::Pow, ..) => true,
        ExprKind::Std(fun, _) => matches!(fun.signature(), Signature::Real | Signature::Real2),
        _ => false,
    }
}

/// Whether the statements branch or write to elements and fields. Of others the compiler behind this one does all loads first, and
/// then has no registers left.
fn acts(body: &[Stmt]) -> bool {
    let mut found = false;
    visit(body, &mut |node| {
        found |= match node {
            Node::Stmt(stmt) => match &stmt.kind {
                StmtKind::Assign(place, _) => whole_var(place).is_none(),
                _ => true,
            },
            _ => false,
        };
    });
    found
}

/// Whether EXIT or RETURN stands in the statements.
fn leaves(body: &[Stmt]) -> bool {
    contains(body, |kind| {
        matches!(kind, StmtKind::Exit | StmtKind::Return)
    })
}

/// Whether RETURN stands in the statements.
pub fn returns(body: &[Stmt]) -> bool {
    contains(body, |kind| matches!(kind, StmtKind::Return))
}

/// Whether CONTINUE leads to the end of the statements.
fn continues(body: &[Stmt]) -> bool {
    contains(body, |kind| matches!(kind, StmtKind::Continue))
}

fn contains(body: &[Stmt], wanted: impl Fn(&StmtKind) -> bool) -> bool {
    let mut found = false;
    visit(body, &mut |node| {
        if let Node::Stmt(stmt) = node {
            found |= wanted(&stmt.kind);
        }
    });
    found
}
