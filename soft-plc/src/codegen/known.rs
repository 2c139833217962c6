//! Values of memory cells that a local holds as well, so that they are not loaded again.
//!
//! Every write still goes to memory at once; what is spared is reading back. A cell is known by the place that named it, as long
//! as nothing can have written it: an assignment to a variable or field of the same name, to a variable in an index, through
//! a reference or VAR_IN_OUT, or a call. Cranelift does this only until the next store to any other cell.

use std::collections::{BTreeMap, BTreeSet};

use super::fun::{Fun, Slot, val};
use crate::check::tree::{Expr, ExprKind, Place, Root, Step, StepKind, Stmt, StmtKind, VarId};
use crate::check::visit::{Node, visit, visit_writes};
use crate::syntax::ast::BinOp;
use crate::types::{Elem, TypeId};

/// How many cells one function keeps apart.
const CELLS_MAX: usize = 2_000;
/// A value is forgotten after so many instructions: a register for so long costs more than a load.
const INSTRUCTIONS_MAX: usize = 120;

/// The innermost variable or field that a cell belongs to. Cells with different ones are different cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Name {
    Var(VarId),
    Field(TypeId, usize),
}

/// A place without what differs between two mentions of it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Part {
    Var(VarId),
    /// An instance without a name of its own: the one of a call that stands here in the code.
    Call(usize),
    Field(TypeId, usize),
    Index,
    Value(i128),
    Operator(u8, Elem),
    Conversion(Elem, Elem),
}

#[derive(Clone, Debug)]
struct Cell {
    local: u32,
    name: Name,
    /// Variables in its indices.
    depends_on: Vec<VarId>,
    /// Number of instructions when it was used last.
    used_at: usize,
}

/// Cells whose locals hold their values now.
pub type Valid = BTreeSet<usize>;

#[derive(Debug, Default)]
pub struct Known {
    numbers: BTreeMap<Vec<Part>, usize>,
    cells: Vec<Cell>,
    pub valid: Valid,
}

impl Known {
    pub fn forget_all(&mut self) {
        self.valid.clear();
    }

    /// Keeps the set small.
    pub fn forget_old(&mut self, now: usize) {
        let cells = &self.cells;
        self.valid
            .retain(|number| now.saturating_sub(cells[*number].used_at) <= INSTRUCTIONS_MAX);
    }

    /// The variable is written, in whichever instance: forgets its cells and those that it is an index of.
    pub fn forget_variable(&mut self, id: VarId) {
        self.forget_named(Name::Var(id));
    }

    fn forget_named(&mut self, name: Name) {
        let cells = &self.cells;
        self.valid.retain(|number| {
            let cell = &cells[*number];
            let moved = match name {
                Name::Var(id) => cell.depends_on.contains(&id),
                Name::Field(..) => false,
            };
            cell.name != name && !moved
        });
    }

    /// What holds on two ways to the same point.
    pub fn meet(&mut self, other: &Valid) {
        self.valid.retain(|number| other.contains(number));
    }
}

/// The parts of a key while it is built.
#[derive(Default)]
struct Key {
    parts: Vec<Part>,
    name: Option<Name>,
    depends_on: Vec<VarId>,
}

impl Fun<'_, '_> {
    /// The number of the cell, if it is one that can be known. A bit at the end is not looked at.
    fn cell(&mut self, place: &Place) -> Option<usize> {
        let mut key = Key::default();
        self.key_of(place, &mut key)?;
        if let Some(number) = self.known.numbers.get(&key.parts) {
            return Some(*number);
        }
        if self.known.cells.len() >= CELLS_MAX {
            return None;
        }
        let local = self.new_local(val(self.whole_elem(place)));
        let number = self.known.cells.len();
        self.known.cells.push(Cell {
            local,
            name: key.name?,
            depends_on: key.depends_on,
            used_at: 0,
        });
        self.known.numbers.insert(key.parts, number);
        Some(number)
    }

    /// The name of an instance, and the variables in its indices.
    pub fn key_parts(&self, place: &Place) -> Option<(Vec<Part>, Vec<VarId>)> {
        let mut key = Key::default();
        self.key_of(place, &mut key)?;
        Some((key.parts, key.depends_on))
    }

    fn key_of(&self, place: &Place, key: &mut Key) -> Option<()> {
        let project = self.m.project;
        let Root::Var(id) = place.root else {
            return None;
        };
        let in_memory = matches!(self.slots.get(&id), None | Some(Slot::Scratch(_)));
        if !in_memory || project.var(id).location.is_some() {
            return None;
        }
        if self.is_in_instance(id) {
            key.parts.clone_from(&self.instance.key);
            key.depends_on.clone_from(&self.instance.depends_on);
        }
        key.parts.push(Part::Var(id));
        key.name = Some(Name::Var(id));
        for step in &place.steps {
            match &step.kind {
                StepKind::Field(index, owner) => {
                    key.parts.push(Part::Field(*owner, *index));
                    key.name = Some(Name::Field(*owner, *index));
                }
                StepKind::Member(var) => {
                    key.parts.push(Part::Var(*var));
                    key.name = Some(Name::Var(*var));
                }
                StepKind::Index(indices) => {
                    for index in indices {
                        key.parts.push(Part::Index);
                        self.index_key(index, key)?;
                    }
                }
                StepKind::Bit(_) | StepKind::Part(..) => break,
                StepKind::Deref | StepKind::Element(_) | StepKind::Char(_) => return None,
            }
        }
        Some(())
    }

    fn index_key(&self, index: &Expr, key: &mut Key) -> Option<()> {
        if let Some(value) = self.only_value(index) {
            key.parts.push(Part::Value(value));
            return Some(());
        }
        match &index.kind {
            ExprKind::Load(place) => {
                let Root::Var(id) = place.root else {
                    return None;
                };
                let by_reference = matches!(
                    self.slots.get(&id),
                    Some(Slot::Pointer(_) | Slot::PointerText(..))
                );
                if !place.steps.is_empty()
                    || by_reference
                    || self.m.project.var(id).location.is_some()
                {
                    return None;
                }
                key.parts.push(Part::Var(id));
                key.depends_on.push(id);
                if let Some(ahead) = self.ahead.get(&id) {
                    key.parts.push(Part::Value(*ahead));
                }
            }
            ExprKind::Convert(inner) => {
                let (from, to) = (self.elem(inner.ty), self.elem(index.ty));
                key.parts.push(Part::Conversion(from, to));
                self.index_key(inner, key)?;
            }
            ExprKind::Binary(op @ (BinOp::Add | BinOp::Sub | BinOp::Mul), elem, left, right) => {
                key.parts.push(Part::Operator(*op as u8, *elem));
                self.index_key(left, key)?;
                self.index_key(right, key)?;
            }
            _ => return None,
        }
        Some(())
    }

    /// The local that holds the value of the cell.
    pub fn known_local(&mut self, place: &Place) -> Option<u32> {
        let number = self.cell(place)?;
        if !self.known.valid.contains(&number) {
            return None;
        }
        let cell = &mut self.known.cells[number];
        cell.used_at = self.code.len();
        Some(cell.local)
    }

    /// The value on the stack is that of the cell: answers the local that shall keep it.
    pub fn learn(&mut self, place: &Place) -> Option<u32> {
        let number = self.cell(place)?;
        let cell = &mut self.known.cells[number];
        cell.used_at = self.code.len();
        self.known.valid.insert(number);
        Some(cell.local)
    }

    /// The place, or a bit of it, is written: forgets what could be the same cell or lie behind another index now.
    pub fn forget(&mut self, place: &Place) {
        let project = self.m.project;
        let by_name = match place.root {
            Root::Direct(_) => return,
            Root::This => false,
            Root::Var(id) => !matches!(
                self.slots.get(&id),
                Some(Slot::Pointer(_) | Slot::PointerText(..))
            ),
        };
        let reached = |s: &Step| !matches!(s.kind, StepKind::Deref);
        if !by_name || !place.steps.iter().all(reached) || project.types.is_aggregate(place.ty) {
            return self.known.forget_all();
        }
        let mut name = match place.root {
            Root::Var(id) => Name::Var(id),
            _ => return self.known.forget_all(),
        };
        for step in &place.steps {
            match step.kind {
                StepKind::Field(index, owner) => name = Name::Field(owner, index),
                StepKind::Member(var) => name = Name::Var(var),
                _ => {}
            }
        }
        self.known.forget_named(name);
    }

    /// Forgets all that the statements can write: what remains is known before, while and after they run, in any order.
    pub fn forget_writes(&mut self, body: &[Stmt]) {
        let mut all = false;
        visit(body, &mut |node| {
            all |= match node {
                Node::Call(_) => true,
                Node::Stmt(stmt) => {
                    matches!(stmt.kind, StmtKind::Invoke(_) | StmtKind::CopyRegion { .. })
                }
                Node::Place(_) | Node::Expr(_) => false,
            };
        });
        if all {
            return self.known.forget_all();
        }
        visit_writes(body, &mut |place, _| self.forget(place));
    }

    /// Emits what runs on some of the ways only.
    pub fn aside<R>(&mut self, emit: impl FnOnce(&mut Self) -> R) -> R {
        let before = self.known.valid.clone();
        let result = emit(self);
        self.known.meet(&before);
        result
    }
}
