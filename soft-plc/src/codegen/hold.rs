//! Holds scalar variables in Wasm locals while a loop runs, and works out which indices cannot leave their array.
//!
//! A variable is held only if nothing else can read or write it meanwhile: it is not passed by reference in the loop, no POU
//! that is called below names it, and no region is copied. It is loaded before the loop and stored after it, and before
//! RETURN; a trap leaves memory half updated, as the contract of a scan says.

use std::collections::{BTreeMap, BTreeSet};

use wasm_encoder::Instruction as I;

use super::State;
use super::fun::{Fun, Slot, val};
use crate::check::tree::{
    Expr, ExprKind, Place, PouId, Receiver, Root, StepKind, Stmt, StmtKind, TypedProject, VarId,
};
use crate::check::visit::{Node, visit, visit_places, visit_writes};
use crate::memory::is_kept;
use crate::syntax::ast::{BinOp, PouKind, VarSection};
use crate::types::Elem;

/// How many variables one loop may hold: more than registers are of no use.
const HELD_MAX: usize = 24;

/// Calls inside calls beyond which nobody counts statements.
const CALL_DEPTH_MAX: usize = 8;

/// What the text of one POU touches.
#[derive(Clone, Debug, Default)]
pub struct Touched {
    roots: BTreeSet<VarId>,
    members: BTreeSet<VarId>,
    copies_regions: bool,
    /// Something is reached by an address, which may be that of any variable.
    by_address: bool,
}

pub struct Held {
    var: VarId,
    local: u32,
    written: bool,
}

/// All variables whose address is taken somewhere: they are never held.
pub fn referenced(project: &TypedProject) -> BTreeSet<VarId> {
    let mut found = BTreeSet::new();
    for pou in &project.pous {
        visit(&pou.body, &mut |node| {
            if let Node::Expr(Expr {
                kind: ExprKind::AddressOf(place),
                ..
            }) = node
            {
                if let Root::Var(id) = place.root {
                    found.insert(id);
                }
                for step in &place.steps {
                    if let StepKind::Member(id) = step.kind {
                        found.insert(id);
                    }
                }
            }
        });
    }
    found
}

/// The longest STRING and WSTRING that is passed as VAR_IN_OUT somewhere, in characters: a parameter is the variable itself, which
/// may be declared longer than the parameter.
pub fn passed_texts(project: &TypedProject) -> [u32; 2] {
    let mut most = [0; 2];
    for pou in &project.pous {
        visit_writes(&pou.body, &mut |place, by_reference| {
            if let (true, Some((wide, len))) = (by_reference, project.types.text(place.ty)) {
                let most = &mut most[usize::from(wide)];
                *most = (*most).max(len);
            }
        });
    }
    most
}

impl State<'_> {
    fn touched(&mut self, pou: PouId) -> &Touched {
        let project = self.project;
        self.touched.entry(pou).or_insert_with(|| {
            let mut touched = Touched::default();
            // A derived function block without statements runs those of its base.
            let body = project.body(pou);
            visit(body, &mut |node| match node {
                Node::Place(place) => touched.add(place),
                Node::Stmt(stmt) => {
                    touched.copies_regions |= matches!(stmt.kind, StmtKind::CopyRegion { .. });
                }
                _ => {}
            });
            touched
        })
    }

    /// The variables that the text of `pou` names.
    pub fn roots_touched(&mut self, pou: PouId) -> &BTreeSet<VarId> {
        &self.touched(pou).roots
    }

    /// What all POUs called from `pou`, directly or not, touch; and what `pou` itself reaches through instances.
    fn touched_below(&mut self, pou: PouId) -> Touched {
        let own = self.touched(pou);
        let mut all = Touched {
            roots: BTreeSet::new(),
            members: own.members.clone(),
            copies_regions: own.copies_regions,
            by_address: own.by_address,
        };
        let mut seen = BTreeSet::from([pou]);
        let mut todo: Vec<PouId> = self.project.pou(pou).calls.iter().copied().collect();
        while let Some(next) = todo.pop() {
            if seen.insert(next) {
                let below = self.touched(next);
                all.roots.extend(&below.roots);
                all.members.extend(&below.members);
                all.copies_regions |= below.copies_regions;
                all.by_address |= below.by_address;
                todo.extend(&self.project.pou(next).calls);
            }
        }
        all
    }
}

impl State<'_> {
    /// How many statements run at most when each FOR runs once, those of called POUs each time that they are called; without
    /// end if another loop is among them, any in a called POU, or a method that only the instance tells.
    pub fn statements_of(&mut self, body: &[Stmt]) -> u64 {
        self.statements_within(body, CALL_DEPTH_MAX, true)
    }

    fn statements_within(&mut self, body: &[Stmt], depth: usize, for_once: bool) -> u64 {
        let mut called: Vec<Option<PouId>> = Vec::new();
        let mut count = 0u64;
        visit(body, &mut |node| match node {
            Node::Call(call) => called.push(match &call.receiver {
                None | Some(Receiver::Fixed(_)) => Some(call.pou),
                Some(Receiver::Derived(_) | Receiver::Interface(..)) => None,
            }),
            Node::Stmt(stmt) => {
                count += 1;
                match &stmt.kind {
                    StmtKind::Invoke(call) => called.push(Some(call.pou)),
                    StmtKind::For(_) if for_once => {}
                    StmtKind::For(_)
                    | StmtKind::While(..)
                    | StmtKind::Repeat(..)
                    | StmtKind::CopyRegion { .. } => called.push(None),
                    _ => {}
                }
            }
            Node::Place(_) | Node::Expr(_) => {}
        });
        called.into_iter().fold(count, |sum, pou| {
            sum.saturating_add(pou.map_or(u64::MAX, |p| self.statements_in(p, depth)))
        })
    }

    fn statements_in(&mut self, pou: PouId, depth: usize) -> u64 {
        if let Some(known) = self.statements.get(&pou) {
            return *known;
        }
        let Some(depth) = depth.checked_sub(1) else {
            return u64::MAX;
        };
        let project = self.project;
        let count = self.statements_within(project.body(pou), depth, false);
        self.statements.insert(pou, count);
        count
    }
}

impl Touched {
    fn add(&mut self, place: &Place) {
        if let Root::Var(id) = place.root {
            self.roots.insert(id);
        }
        for step in &place.steps {
            if let StepKind::Member(id) = step.kind {
                self.members.insert(id);
            }
            self.by_address |= matches!(step.kind, StepKind::Deref);
        }
    }
}

/// Only a variable itself, or a bit of it.
pub fn whole_var(place: &Place) -> Option<VarId> {
    match place.root {
        Root::Var(id)
            if place
                .steps
                .iter()
                .all(|s| matches!(s.kind, StepKind::Bit(_) | StepKind::Part(..))) =>
        {
            Some(id)
        }
        _ => None,
    }
}

impl Fun<'_, '_> {
    /// Before an outermost loop: loads what the loop uses into locals.
    pub fn hold_for(&mut self, statement: &Stmt) {
        if !self.labels.is_empty() || !self.held.is_empty() {
            return;
        }
        let body = std::slice::from_ref(statement);
        for var in self.candidates(body) {
            let place = self.place_of(var);
            let elem = self.elem(place.ty);
            self.load(&place);
            let local = self.temp(val(elem));
            self.i(I::LocalSet(local));
            self.held.push(Held {
                var,
                local,
                written: false,
            });
        }
        let mut written = BTreeSet::new();
        visit_writes(body, &mut |place, _| written.extend(whole_var(place)));
        for held in &mut self.held {
            held.written = written.contains(&held.var);
            self.slots.insert(held.var, Slot::Local(held.local));
        }
    }

    /// After the loop: memory has the values again.
    pub fn let_go(&mut self) {
        if !self.labels.is_empty() {
            return;
        }
        self.store_held();
        for held in std::mem::take(&mut self.held) {
            self.slots.remove(&held.var);
            self.release(held.local);
        }
    }

    /// Stores what the loop has written; it stays held.
    pub fn store_held(&mut self) {
        let held = std::mem::take(&mut self.held);
        for one in held.iter().filter(|h| h.written) {
            self.slots.remove(&one.var);
            let place = self.place_of(one.var);
            self.store(&place, |f| f.i(I::LocalGet(one.local)));
            self.slots.insert(one.var, Slot::Local(one.local));
        }
        self.held = held;
    }

    fn place_of(&self, var: VarId) -> Place {
        let data = self.m.project.var(var);
        Place {
            root: Root::Var(var),
            steps: Vec::new(),
            ty: data.ty,
            span: data.span,
        }
    }

    fn candidates(&mut self, body: &[Stmt]) -> Vec<VarId> {
        let project = self.m.project;
        let below = self.m.touched_below(self.pou);
        if below.copies_regions || (self.m.pointers && below.by_address) {
            return Vec::new();
        }
        let unit = project.pou(self.pou);
        let by_reference = unit
            .vars
            .iter()
            .any(|v| project.var(*v).section == VarSection::InOut);
        let mut passed = BTreeSet::new();
        visit_writes(body, &mut |place, by_reference| {
            passed.extend(whole_var(place).filter(|_| by_reference));
        });
        let mut calls = false;
        visit(body, &mut |node| {
            calls |= match node {
                Node::Call(_) => true,
                Node::Stmt(stmt) => matches!(stmt.kind, StmtKind::Invoke(_)),
                _ => false,
            };
        });
        let mut uses: BTreeMap<VarId, u32> = BTreeMap::new();
        visit_places(body, &mut |place| {
            if let Some(id) = whole_var(place) {
                *uses.entry(id).or_default() += 1;
            }
        });
        let mut list: Vec<(u32, VarId)> = uses
            .into_iter()
            .filter(|(id, _)| {
                let var = project.var(*id);
                let own = var.owner == Some(self.pou)
                    && !matches!(unit.kind, PouKind::Function | PouKind::Method);
                let fixed = match var.owner {
                    None => true,
                    Some(pou) => project.pou(pou).kind == PouKind::Program,
                };
                // A parameter by reference may be another name of what the caller can pass.
                let alone = if own {
                    !by_reference
                        || (var.section != VarSection::Input
                            && !project.options.allow_internal_access)
                } else {
                    fixed && !calls && !by_reference
                };
                alone
                    && var.location.is_none()
                    && !var.constant
                    && (var.owner.is_none() || is_kept(var))
                    && project.types.elem(var.ty).is_some()
                    && !self.slots.contains_key(id)
                    && !passed.contains(id)
                    && !self.m.referenced.contains(id)
                    && !below.roots.contains(id)
                    && !below.members.contains(id)
            })
            .map(|(id, count)| (count, id))
            .collect();
        list.sort_by_key(|(count, id)| (std::cmp::Reverse(*count), *id));
        list.truncate(HELD_MAX);
        list.into_iter().map(|(_, id)| id).collect()
    }

    /// While `body` runs, the FOR variable stays within these values, if nothing but the loop can write it.
    pub fn note_range(
        &mut self,
        var: &Place,
        from: Option<i128>,
        to: Option<i128>,
        body: &[Stmt],
    ) -> Option<VarId> {
        let (from, to, id) = (from?, to?, whole_var(var)?);
        if !var.steps.is_empty() || self.local_of(var).is_none() {
            return None;
        }
        let mut written = false;
        visit_writes(body, &mut |place, _| {
            written |= whole_var(place) == Some(id)
        });
        if written {
            return None;
        }
        self.ranges.insert(id, (from.min(to), from.max(to)));
        Some(id)
    }

    /// The value of an integer expression, if it has only one.
    pub fn only_value(&self, expr: &Expr) -> Option<i128> {
        self.range_of(expr)
            .and_then(|(low, high)| (low == high).then_some(low))
    }

    /// Limits that the value of an integer expression certainly keeps.
    pub fn range_of(&self, expr: &Expr) -> Option<(i128, i128)> {
        let elem = self.elem(expr.ty);
        let range = match &expr.kind {
            ExprKind::Const(value) => value.as_i128().map(|v| (v, v)),
            ExprKind::Load(place) if place.steps.is_empty() => {
                self.ranges.get(&whole_var(place)?).copied()
            }
            ExprKind::Convert(inner) if is_whole(self.elem(inner.ty)) => self.range_of(inner),
            // A mask leaves nothing above it, and no sign.
            ExprKind::Binary(BinOp::And, of, _, right) if is_whole(*of) => {
                let mask = self.only_value(right).filter(|m| *m >= 0)?;
                Some((0, mask))
            }
            ExprKind::Binary(BinOp::Mod, of, _, right) => {
                let ExprKind::Const(n) = &right.kind else {
                    return None;
                };
                let most = n.as_i128()?.checked_abs()? - 1;
                Some((if of.is_signed() { -most } else { 0 }, most))
            }
            ExprKind::Binary(op, _, left, right) => {
                let (a, b) = (self.range_of(left)?, self.range_of(right)?);
                match op {
                    BinOp::Add => Some((a.0 + b.0, a.1 + b.1)),
                    BinOp::Sub => Some((a.0 - b.1, a.1 - b.0)),
                    BinOp::Mul if a.0 >= 0 && b.0 >= 0 => {
                        Some((a.0.checked_mul(b.0)?, a.1.checked_mul(b.1)?))
                    }
                    _ => None,
                }
            }
            _ => None,
        }?;
        // What could wrap has no limits.
        let (lo, hi) = elem.limits()?;
        (range.0 >= lo && range.1 <= hi).then_some(range)
    }
}

/// Whether values are whole numbers or bit strings.
fn is_whole(elem: Elem) -> bool {
    elem.is_int() || (elem.is_bit() && elem != Elem::Bool)
}
