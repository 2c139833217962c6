//! Statements.

use std::borrow::Cow;

use wasm_encoder::{BlockType, Instruction as I, ValType};

use super::expr::simple;
use super::fun::{Fun, val};
use super::known::Valid;
use super::loops::Round;
use crate::check::tree::{Branch, Expr, ExprKind, Place, Stmt, StmtKind};
use crate::diag::Problem;
use crate::source::Span;
use crate::syntax::ast::{BinOp, UnOp};
use crate::types::{Elem, TypeKind};
use crate::value::Value;

/// A CASE with so many ranges is decided by halving: such branches are foreseen better than a jump through a table.
const TREE_RANGES: std::ops::RangeInclusive<usize> = 4..=7;
/// A CASE becomes a jump table if it has at least this many ranges ...
const TABLE_VALUES_MIN: usize = 8;
/// ... and they span at most this many numbers.
const TABLE_SPAN_MAX: i64 = 1024;

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
            StmtKind::While(condition, body) => self.while_loop(condition, body, stmt.span),
            StmtKind::Repeat(body, condition) => self.repeat_loop(body, condition, stmt.span),
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
        let checked = self.keep_for_strings(place.ty);
        source(self);
        self.copy(size);
        self.settle(checked, size);
        self.forget(place);
    }

    fn if_chain(&mut self, branches: &[(Expr, Vec<Stmt>)], otherwise: &[Stmt]) {
        let end = self.open(I::Block(BlockType::Empty));
        let mut ends = Vec::new();
        for (condition, body) in branches {
            let next = self.open(I::Block(BlockType::Empty));
            let skipped = self.jump(condition, false, next);
            self.stmts(body);
            ends.push(std::mem::replace(&mut self.known.valid, skipped));
            self.i(I::Br(self.label(end)));
            self.close();
        }
        self.stmts(otherwise);
        for end in ends {
            self.known.meet(&end);
        }
        self.close();
    }

    /// Goes to the block of this depth if the condition is `when`. The parts of AND and OR jump on their own: conditions of control
    /// logic change seldom, so that jumps are foreseen, and what comes behind the first of them need not be evaluated.
    /// Answers what is known wherever the jump is taken.
    fn jump(&mut self, condition: &Expr, when: bool, target: u32) -> Valid {
        match &condition.kind {
            ExprKind::Unary(UnOp::Not, inner) => self.jump(inner, !when, target),
            ExprKind::Binary(op @ (BinOp::And | BinOp::Or), Elem::Bool, left, right) => {
                // AND is false, and OR true, as soon as its left side is.
                let deciding = *op == BinOp::Or;
                if when == deciding {
                    let first = self.jump(left, when, target);
                    let mut both = self.jump(right, when, target);
                    both.retain(|cell| first.contains(cell));
                    return both;
                }
                let past = self.open(I::Block(BlockType::Empty));
                let first = self.jump(left, deciding, past);
                let taken = self.jump(right, when, target);
                self.close();
                self.known.meet(&first);
                taken
            }
            _ => {
                self.expr(condition);
                if !when {
                    self.i(I::I32Eqz);
                }
                self.i(I::BrIf(self.label(target)));
                self.known.valid.clone()
            }
        }
    }

    fn case(&mut self, selector: &Expr, branches: &[Branch], otherwise: &[Stmt]) {
        let round = self.round.take();
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
            self.case_table(local, (min, span), branches, otherwise, round.as_ref());
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
        (min, span): (i64, i64),
        branches: &[Branch],
        otherwise: &[Stmt],
        round: Option<&Round>,
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
        self.close_branches(exit, branches, otherwise, round);
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
    fn close_branches(
        &mut self,
        exit: u32,
        branches: &[Branch],
        otherwise: &[Stmt],
        round: Option<&Round>,
    ) {
        let before = self.known.valid.clone();
        let mut ends = Vec::new();
        for (_, body) in branches {
            self.close();
            self.stmts(body);
            if let Some(round) = round {
                self.end_branch_of(round);
                self.known.valid.clone_from(&before);
                continue;
            }
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
        let limits = elem.limits().unwrap_or((i128::MIN, i128::MAX));
        self.decide(
            local,
            elem,
            &ranges,
            innermost - branches.len() as u32,
            limits,
        );
        self.close_branches(exit, branches, otherwise, None);
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

    /// Goes to the block of the range that the value lies in, or to `otherwise`. The ranges ascend; the value is known to lie
    /// between the limits.
    fn decide(
        &mut self,
        local: u32,
        elem: Elem,
        ranges: &[(i64, i64, u32)],
        otherwise: u32,
        limits: (i128, i128),
    ) {
        if let [(low, high, target)] = ranges {
            if limits.0 >= i128::from(*low) && limits.1 <= i128::from(*high) {
                self.i(I::Br(self.label(*target)));
                return;
            }
            self.is_within(local, elem, *low, *high);
            self.i(I::BrIf(self.label(*target)));
            self.i(I::Br(self.label(otherwise)));
            return;
        }
        let (lower, upper) = ranges.split_at(ranges.len() / 2);
        let pivot = i128::from(upper[0].0);
        self.i(I::LocalGet(local));
        self.constant(Value::from_i128(elem, pivot), elem);
        self.i(simple(BinOp::Lt, elem));
        self.open(I::If(BlockType::Empty));
        self.decide(local, elem, lower, otherwise, (limits.0, pivot - 1));
        self.close();
        self.decide(local, elem, upper, otherwise, (pivot, limits.1));
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
