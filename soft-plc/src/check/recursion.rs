//! Recursion is refused: a program that calls itself has no bounded scan, and every POU's memory is laid out once.
//!
//! Who calls whom is a matter of POUs and of the function block that their instance is of: a method of a base that calls another
//! on THIS reaches what overrides it only in an instance of the derived block. So the calls are followed for pairs of a POU and
//! the block of its instance, from all that can be called from outside; a POU recurses if it can be reached from itself, in
//! whatever instance.

use std::collections::{BTreeMap, BTreeSet};

use crate::check::Checker;
use crate::check::tree::{FunctionCall, Invocation, Place, PouId, Receiver, Root, Stmt, StmtKind};
use crate::check::visit::{Node, visit};
use crate::diag::Problem;
use crate::syntax::ast::PouKind;
use crate::types::TypeKind;

/// A POU, and the function block (or program) that the instance it runs in is of.
type Running = (PouId, Option<PouId>);

/// A call in a body, before the instance is known.
enum Called<'t> {
    Function(&'t FunctionCall),
    Block(&'t Invocation),
}

impl Checker<'_> {
    pub(super) fn refuse_recursion(&mut self) {
        let suspects = self.circles();
        if suspects.is_empty() {
            return;
        }
        let calls = self.all_that_can_run();
        let mut told = BTreeSet::new();
        let mut problems = Vec::new();
        for start in suspects {
            if told.contains(&start) {
                continue;
            }
            let Some(path) = circle_through(start, &calls) else {
                continue;
            };
            let mut names: Vec<&str> = path.iter().map(|p| &*self.pou(*p).name).collect();
            told.extend(path.iter().copied());
            let unit = self.pou(start);
            names.push(&unit.name);
            let message = format!("{} calls itself: {}", unit.name, names.join(" > "));
            let problem = Problem::error("E410", unit.name_span, message);
            problems.push(problem.hint("recursion is not allowed; use a loop"));
        }
        self.problems.extend(problems);
    }

    /// POUs that would recurse if every method could run in every instance: those that are left when what nobody calls, and
    /// what calls nobody, is taken away again and again.
    fn circles(&self) -> BTreeSet<PouId> {
        let count = self.pous.len();
        let mut callers: Vec<Vec<usize>> = vec![Vec::new(); count];
        let mut open: Vec<usize> = Vec::with_capacity(count);
        for (caller, unit) in self.pous.iter().enumerate() {
            open.push(unit.calls.len());
            for callee in &unit.calls {
                callers[callee.0 as usize].push(caller);
            }
        }
        let mut done: Vec<usize> = (0..count).filter(|p| open[*p] == 0).collect();
        while let Some(pou) = done.pop() {
            for caller in &callers[pou] {
                open[*caller] -= 1;
                if open[*caller] == 0 {
                    done.push(*caller);
                }
            }
        }
        (0..count)
            .filter(|p| open[*p] > 0)
            .map(|p| PouId(p as u32))
            .collect()
    }

    /// The calls of all that can run, from what can be called from outside.
    fn all_that_can_run(&self) -> BTreeMap<Running, BTreeSet<Running>> {
        let mut todo: Vec<Running> = Vec::new();
        for (index, unit) in self.pous.iter().enumerate() {
            let id = PouId(index as u32);
            match unit.kind {
                PouKind::Function => todo.push((id, None)),
                PouKind::Method => {}
                _ => {
                    todo.push((id, Some(id)));
                    let mut at = Some(id);
                    while let Some(block) = at {
                        let names = self.pou(block).methods.iter();
                        let methods = names.filter_map(|(name, _)| self.find_method(id, name));
                        todo.extend(methods.map(|m| (m, Some(id))));
                        at = self.pou(block).extends;
                    }
                }
            }
        }
        let mut calls = BTreeMap::new();
        while let Some(running) = todo.pop() {
            if calls.contains_key(&running) {
                continue;
            }
            let next = self.calls_of(running);
            todo.extend(next.iter().copied());
            calls.insert(running, next);
        }
        calls
    }

    fn calls_of(&self, (pou, this): Running) -> BTreeSet<Running> {
        let mut found = BTreeSet::new();
        visit(self.body_that_runs(pou), &mut |node| {
            let called = match node {
                Node::Call(call) => Called::Function(call),
                Node::Stmt(Stmt {
                    kind: StmtKind::Invoke(call),
                    ..
                }) => Called::Block(call),
                _ => return,
            };
            self.targets(&called, this, &mut found);
        });
        found
    }

    /// The statements of a POU; a derived function block without any has those of its base.
    fn body_that_runs(&self, pou: PouId) -> &[Stmt] {
        let unit = self.pou(pou);
        match unit.extends {
            Some(base) if unit.body.is_empty() => self.body_that_runs(base),
            _ => &unit.body,
        }
    }

    fn targets(&self, called: &Called<'_>, this: Option<PouId>, found: &mut BTreeSet<Running>) {
        match called {
            Called::Block(call) => match &call.instance {
                Some(place) => {
                    for block in self.kinds_of(place, this) {
                        found.insert((call.pou, Some(block)));
                    }
                }
                None => {
                    found.insert((call.pou, Some(call.pou)));
                }
            },
            Called::Function(call) => match &call.receiver {
                None => {
                    found.insert((call.pou, None));
                }
                Some(Receiver::Fixed(place)) => {
                    for block in self.kinds_of(place, this) {
                        found.insert((call.pou, Some(block)));
                    }
                }
                Some(Receiver::Derived(place)) => {
                    for block in self.kinds_of(place, this) {
                        self.method_in(block, call.pou, found);
                    }
                }
                Some(Receiver::Interface(_, id)) => {
                    for block in (0..self.pous.len() as u32).map(PouId) {
                        let derived = self.bases_of(block).any(|b| self.implements(b, *id));
                        if derived {
                            self.method_in(block, call.pou, found);
                        }
                    }
                }
            },
        }
    }

    /// What runs for `method` in an instance of `block`.
    fn method_in(&self, block: PouId, method: PouId, found: &mut BTreeSet<Running>) {
        let name = &self.pou(method).name;
        let name = name.rsplit('.').next().unwrap_or(name).to_ascii_uppercase();
        let target = self.find_method(block, &name).unwrap_or(method);
        found.insert((target, Some(block)));
    }

    fn bases_of(&self, block: PouId) -> impl Iterator<Item = PouId> {
        std::iter::successors(Some(block), |b| self.pou(*b).extends)
    }

    /// The function blocks that the instance can be of.
    fn kinds_of(&self, place: &Place, this: Option<PouId>) -> Vec<PouId> {
        if matches!(place.root, Root::This) && place.steps.is_empty() {
            return this.into_iter().collect();
        }
        let TypeKind::FunctionBlock(block) = *self.types.kind(place.ty) else {
            return this.into_iter().collect();
        };
        if self.is_exact(place) {
            return vec![block];
        }
        (0..self.pous.len() as u32)
            .map(PouId)
            .filter(|p| self.derives_pou(*p, block))
            .collect()
    }
}

/// The shortest way from the POU back to it.
fn circle_through(
    start: PouId,
    calls: &BTreeMap<Running, BTreeSet<Running>>,
) -> Option<Vec<PouId>> {
    let from: Vec<Running> = calls
        .range((start, None)..)
        .take_while(|((pou, _), _)| *pou == start)
        .map(|(running, _)| *running)
        .collect();
    let mut before: BTreeMap<Running, Running> = BTreeMap::new();
    let mut queue: std::collections::VecDeque<Running> = from.iter().copied().collect();
    while let Some(at) = queue.pop_front() {
        for next in calls.get(&at).into_iter().flatten() {
            if next.0 == start {
                let mut path = vec![at.0];
                let mut back = at;
                while let Some(earlier) = before.get(&back) {
                    path.push(earlier.0);
                    back = *earlier;
                }
                path.reverse();
                return Some(path);
            }
            if !before.contains_key(next) {
                before.insert(*next, at);
                queue.push_back(*next);
            }
        }
    }
    None
}
