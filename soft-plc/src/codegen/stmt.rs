//! Statements.

use std::borrow::Cow;

use wasm_encoder::{BlockType, Instruction as I, ValType};

use super::SiteKind;
use super::expr::simple;
use super::fun::{Fun, mem, val};
use crate::check::tree::{Branch, Expr, ExprKind, For, Limits, Place, Root, Stmt, StmtKind};
use crate::check::visit::visit_writes;
use crate::diag::Problem;
use crate::memory::{STOP_AT, STOP_FENCE_AT};
use crate::source::Span;
use crate::syntax::ast::BinOp;
use crate::types::{Elem, TypeKind};
use crate::value::Value;

/// A CASE with so many ranges is decided by halving: such branches are foreseen better than a jump through a table.
const TREE_RANGES: std::ops::RangeInclusive<usize> = 4..=16;
/// A CASE becomes a jump table if it has at least this many ranges ...
const TABLE_VALUES_MIN: usize = 17;
/// ... and they span at most this many numbers.
const TABLE_SPAN_MAX: i64 = 1024;

/// A FOR loop of so many steps, without loops inside, needs no look at the watchdog ...
const UNWATCHED_STEPS_MAX: i128 = 256;
/// ... if each of them runs at most so many statements, those of the POUs that it calls included.
const UNWATCHED_STATEMENTS_MAX: u64 = 500;

impl Fun<'_, '_> {
    pub fn stmts(&mut self, list: &[Stmt]) {
        for stmt in list {
            self.mark(stmt.span);
            self.known.forget_old(self.code.len());
            self.stmt(stmt);
        }
    }

    fn stmt(&mut self, stmt: &Stmt) {
        let is_loop = matches!(
            stmt.kind,
            StmtKind::For(_) | StmtKind::While(..) | StmtKind::Repeat(..)
        );
        let jumps = is_loop || matches!(stmt.kind, StmtKind::Block(_));
        if jumps {
            // What holds wherever EXIT, CONTINUE, RETURN and the next round lead.
            self.forget_writes(std::slice::from_ref(stmt));
        }
        let stable = self.known.valid.clone();
        if is_loop {
            self.hold_for(stmt);
        }
        self.kind(stmt);
        if jumps {
            self.known.meet(&stable);
        }
        if is_loop {
            self.let_go();
        }
    }

    fn kind(&mut self, stmt: &Stmt) {
        match &stmt.kind {
            StmtKind::Assign(place, value) => self.assign(place, value),
            StmtKind::Call(call) => self.call_for_effect(call),
            StmtKind::Invoke(call) => self.invoke(call),
            StmtKind::If(branches, otherwise) => self.if_chain(branches, otherwise),
            StmtKind::Case {
                selector,
                branches,
                otherwise,
            } => self.case(selector, branches, otherwise),
            StmtKind::For(data) => self.for_loop(data, stmt.span),
            StmtKind::While(condition, body) => {
                let start = self.code.len();
                let exit = self.open(I::Block(BlockType::Empty));
                let top = self.open(I::Loop(BlockType::Empty));
                self.watch(stmt.span);
                self.expr(condition);
                self.i(I::I32Eqz);
                self.i(I::BrIf(self.label(exit)));
                self.labels.push((exit, top));
                self.stmts(body);
                self.labels.pop();
                self.i(I::Br(self.label(top)));
                self.end_loop(start, stmt.span);
            }
            StmtKind::Repeat(body, condition) => {
                let start = self.code.len();
                let exit = self.open(I::Block(BlockType::Empty));
                let top = self.open(I::Loop(BlockType::Empty));
                self.watch(stmt.span);
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
                self.end_loop(start, stmt.span);
            }
            StmtKind::Exit => {
                if let Some((exit, _)) = self.labels.last().copied() {
                    self.i(I::Br(self.label(exit)));
                }
            }
            StmtKind::Continue => {
                if let Some((_, next)) = self.labels.last().copied() {
                    self.i(I::Br(self.label(next)));
                }
            }
            StmtKind::Return => {
                let (target, held) = self.returns.last().copied().unwrap_or((1, false));
                if !held {
                    self.store_held();
                }
                self.i(I::Br(self.label(target)));
            }
            StmtKind::Block(body) => {
                let block = self.open(I::Block(BlockType::Empty));
                self.returns.push((block, !self.held.is_empty()));
                // EXIT and CONTINUE inside belong to loops inside.
                let labels = std::mem::take(&mut self.labels);
                let ranges = self.ranges.clone();
                let outer = !labels.is_empty();
                if outer {
                    self.labels.push(labels[labels.len() - 1]);
                }
                self.stmts(body);
                self.labels = labels;
                self.ranges = ranges;
                self.returns.pop();
                self.close();
            }
            StmtKind::CopyRegion {
                region,
                array,
                to_bytes,
            } => self.copy_region(region, array, *to_bytes, stmt.span),
        }
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

    /// Whether the loop certainly ends so soon that the watchdog can wait for it: few steps, and nothing inside that takes long.
    fn is_short(&mut self, data: &For) -> bool {
        let known = constant_of;
        let (Some(from), Some(to), Some(by)) =
            (known(&data.from), known(&data.to), known(&data.by))
        else {
            return false;
        };
        by != 0
            && (to - from) / by < UNWATCHED_STEPS_MAX
            && self.is_own_counter(data)
            && self.m.statements_of(&data.body) <= UNWATCHED_STATEMENTS_MAX
    }

    /// At the top of a loop: ends the scan when the watchdog wants it.
    fn watch(&mut self, span: Span) {
        self.i(I::I32Const(0));
        self.i(I::I32Const(0));
        self.i(I::I32Store(mem(STOP_FENCE_AT, 2)));
        self.i(I::I32Const(0));
        self.i(I::I32Load(mem(STOP_AT, 2)));
        self.trap_if(SiteKind::EndlessLoop, span, None);
    }

    fn assign(&mut self, place: &Place, value: &Expr) {
        if self.m.project.types.text(place.ty).is_some() {
            self.assign_text(place, value);
        } else if self.m.project.types.is_aggregate(place.ty) {
            self.store_aggregate(place, |f| f.aggregate(value));
        } else {
            self.store_value(place, value);
        }
    }

    /// Stores the array or structure at the address that `source` pushes into the place.
    pub fn store_aggregate(&mut self, place: &Place, source: impl FnOnce(&mut Self)) {
        let size = self.m.size_of(place.ty);
        self.push_full_address(place);
        source(self);
        self.copy(size);
        self.forget(place);
    }

    fn if_chain(&mut self, branches: &[(Expr, Vec<Stmt>)], otherwise: &[Stmt]) {
        let mut ends = Vec::new();
        for (index, (condition, body)) in branches.iter().enumerate() {
            self.expr(condition);
            self.open(I::If(BlockType::Empty));
            let before = self.known.valid.clone();
            self.stmts(body);
            ends.push(std::mem::replace(&mut self.known.valid, before));
            if index + 1 < branches.len() || !otherwise.is_empty() {
                self.i(I::Else);
            }
        }
        self.stmts(otherwise);
        for end in ends {
            self.known.meet(&end);
        }
        for _ in branches {
            self.close();
        }
    }

    fn case(&mut self, selector: &Expr, branches: &[Branch], otherwise: &[Stmt]) {
        let elem = self.elem(selector.ty);
        let local = self.spill(selector);
        let all: Vec<(i64, i64)> = branches.iter().flat_map(|b| b.0.iter().copied()).collect();
        let min = all.iter().map(|r| r.0).min().unwrap_or(0);
        let max = all.iter().map(|r| r.1).max().unwrap_or(0);
        let span = max.saturating_sub(min).saturating_add(1);
        let use_table = val(elem) == ValType::I32
            && all.len() >= TABLE_VALUES_MIN
            && span <= TABLE_SPAN_MAX
            && span <= 8 * all.len() as i64 + 16;
        if use_table {
            self.case_table(local, min, span, branches, otherwise);
        } else if TREE_RANGES.contains(&all.len())
            && are_apart(&all)
            // The upper half of ULINT and LWORD is written as negative numbers here, which stand in another order.
            && (elem.is_signed() || min >= 0)
        {
            self.case_tree(local, elem, branches, otherwise);
        } else {
            self.case_chain(local, elem, branches, otherwise);
        }
        self.release(local);
    }

    fn case_table(
        &mut self,
        local: u32,
        min: i64,
        span: i64,
        branches: &[Branch],
        otherwise: &[Stmt],
    ) {
        let count = branches.len() as u32;
        let mut table = vec![count; span as usize];
        for (number, (ranges, _)) in branches.iter().enumerate() {
            for (low, high) in ranges {
                for value in *low..=*high {
                    table[(value - min) as usize] = number as u32;
                }
            }
        }
        let exit = self.open_branches(branches);
        self.i(I::LocalGet(local));
        if min != 0 {
            self.i(I::I32Const(min as i32));
            self.i(I::I32Sub);
        }
        self.i(I::BrTable(Cow::Owned(table), count));
        self.close_branches(exit, branches, otherwise);
    }

    /// Opens a block for the whole CASE, one for ELSE, and one for each branch: the first is the innermost.
    fn open_branches(&mut self, branches: &[Branch]) -> u32 {
        let exit = self.open(I::Block(BlockType::Empty));
        for _ in 0..=branches.len() {
            self.open(I::Block(BlockType::Empty));
        }
        exit
    }

    /// Closes the blocks; the statements of each branch stand behind its own.
    fn close_branches(&mut self, exit: u32, branches: &[Branch], otherwise: &[Stmt]) {
        let before = self.known.valid.clone();
        let mut ends = Vec::new();
        for (_, body) in branches {
            self.close();
            self.stmts(body);
            ends.push(std::mem::replace(&mut self.known.valid, before.clone()));
            self.i(I::Br(self.label(exit)));
        }
        self.close();
        self.stmts(otherwise);
        for end in ends {
            self.known.meet(&end);
        }
        self.close();
    }

    fn case_tree(&mut self, local: u32, elem: Elem, branches: &[Branch], otherwise: &[Stmt]) {
        let exit = self.open_branches(branches);
        let innermost = self.depth;
        let mut ranges: Vec<(i64, i64, u32)> = Vec::new();
        for (number, (list, _)) in branches.iter().enumerate() {
            let target = innermost - number as u32;
            ranges.extend(list.iter().map(|(low, high)| (*low, *high, target)));
        }
        ranges.sort_unstable();
        self.decide(local, elem, &ranges, innermost - branches.len() as u32);
        self.close_branches(exit, branches, otherwise);
    }

    /// Pushes whether the value lies in a range of CASE.
    fn is_within(&mut self, local: u32, elem: Elem, low: i64, high: i64) {
        let bound = |v: i64| Value::from_i128(elem, i128::from(v));
        self.i(I::LocalGet(local));
        self.constant(bound(low), elem);
        if low == high {
            self.i(simple(BinOp::Eq, elem));
            return;
        }
        self.i(simple(BinOp::Ge, elem));
        self.i(I::LocalGet(local));
        self.constant(bound(high), elem);
        self.i(simple(BinOp::Le, elem));
        self.i(I::I32And);
    }

    /// Goes to the block of the range that the value lies in, or to `otherwise`. The ranges ascend.
    fn decide(&mut self, local: u32, elem: Elem, ranges: &[(i64, i64, u32)], otherwise: u32) {
        if let [(low, high, target)] = ranges {
            self.is_within(local, elem, *low, *high);
            self.i(I::BrIf(self.label(*target)));
            self.i(I::Br(self.label(otherwise)));
            return;
        }
        let (lower, upper) = ranges.split_at(ranges.len() / 2);
        self.i(I::LocalGet(local));
        self.constant(Value::from_i128(elem, i128::from(upper[0].0)), elem);
        self.i(simple(BinOp::Lt, elem));
        self.open(I::If(BlockType::Empty));
        self.decide(local, elem, lower, otherwise);
        self.close();
        self.decide(local, elem, upper, otherwise);
    }

    fn case_chain(&mut self, local: u32, elem: Elem, branches: &[Branch], otherwise: &[Stmt]) {
        let exit = self.open(I::Block(BlockType::Empty));
        let before = self.known.valid.clone();
        let mut ends = Vec::new();
        for (ranges, body) in branches {
            if ranges.is_empty() {
                continue;
            }
            for (number, (low, high)) in ranges.iter().enumerate() {
                self.is_within(local, elem, *low, *high);
                if number > 0 {
                    self.i(I::I32Or);
                }
            }
            self.open(I::If(BlockType::Empty));
            self.stmts(body);
            ends.push(std::mem::replace(&mut self.known.valid, before.clone()));
            self.i(I::Br(self.label(exit)));
            self.close();
        }
        self.stmts(otherwise);
        for end in ends {
            self.known.meet(&end);
        }
        self.close();
    }

    /// The end and the step are evaluated once. A loop up to the largest value of its type ends: the distance to the end is
    /// tested before the step is added, where adding it could wrap.
    fn for_loop(&mut self, data: &For, span: Span) {
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
        if !self.is_short(data) {
            self.watch(span);
        }
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

    fn copy_region(&mut self, name: &str, array: &Place, to_bytes: bool, span: Span) {
        let Some(region) = self.m.plan.layout.region(name).cloned() else {
            let names: Vec<&str> = self
                .m
                .plan
                .layout
                .regions
                .iter()
                .map(|r| r.name.as_str())
                .collect();
            let problem = Problem::error("E507", span, format!("there is no region `{name}`"))
                .expected(format!("one of {}", names.join(", ")));
            self.m.problems.push(problem);
            return;
        };
        let bytes = match self.m.project.types.kind(array.ty) {
            TypeKind::Array { dims, .. } => dims.iter().map(|(l, h)| h - l + 1).product(),
            _ => 0i64,
        };
        if bytes != i64::from(region.len) {
            let message = format!(
                "the region `{name}` has {} bytes and the array has {bytes}",
                region.len
            );
            let problem = Problem::error("E506", span, message)
                .expected(format!("ARRAY[0..{}] OF BYTE", i64::from(region.len) - 1));
            self.m.problems.push(problem);
            return;
        }
        if to_bytes {
            self.push_full_address(array);
            self.i(I::I32Const(region.offset as i32));
        } else {
            self.i(I::I32Const(region.offset as i32));
            self.push_full_address(array);
        }
        self.copy(region.len);
        self.known.forget_all();
    }
}

/// Whether no value lies in two of the ranges.
fn are_apart(ranges: &[(i64, i64)]) -> bool {
    let mut sorted = ranges.to_vec();
    sorted.sort_unstable();
    sorted.iter().all(|(low, high)| low <= high)
        && sorted.windows(2).all(|pair| pair[0].1 < pair[1].0)
}

fn constant_of(expr: &Expr) -> Option<i128> {
    match &expr.kind {
        ExprKind::Const(value) => value.as_i128(),
        _ => None,
    }
}
