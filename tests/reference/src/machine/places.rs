//! Places: which node of memory a path of steps leads to, and its bits.

use fam_soft_plc::TrapKind;
use fam_soft_plc::check::tree::{Place, Root, StepKind, VarId};
use fam_soft_plc::types::{Elem, TypeId, TypeKind};

use super::{Frame, Machine, Part, Run, Spot, Stop};
use crate::memory::{Data, Node, NodeId};
use crate::value::{self, Scalar};

impl Machine<'_> {
    pub(super) fn spot(&mut self, place: &Place, frame: &mut Frame) -> Run<Spot> {
        let (mut node, mut ty) = match &place.root {
            Root::This => (
                frame.this.ok_or(Stop::Unknown("THIS in a program"))?,
                place.ty,
            ),
            Root::Direct(_) => return Err(Stop::Unknown("direct addresses")),
            Root::Var(id) => (self.root(*id, frame)?, self.project.var(*id).ty),
        };
        let mut part = Part::Whole;
        for step in &place.steps {
            match &step.kind {
                StepKind::Field(index, _) => node = self.memory.children(node)[*index],
                StepKind::Member(var) => {
                    let found = self.memory.member(node, *var);
                    node = found.ok_or(Stop::Unknown("a member that is nowhere"))?;
                }
                StepKind::Index(indices) => {
                    let TypeKind::Array { dims, .. } = self.project.types.kind(ty) else {
                        return Err(Stop::Unknown("an index of no array"));
                    };
                    let mut number = 0;
                    for (index, (low, high)) in indices.iter().zip(dims) {
                        let at = self.scalar(index, frame)?.int();
                        if at < i128::from(*low) || at > i128::from(*high) {
                            return self.trap(TrapKind::Index, index.span);
                        }
                        number = number * (high - low + 1) + (at as i64 - low);
                    }
                    node = self.memory.children(node)[number as usize];
                }
                StepKind::Bit(bit) => {
                    let low = match part {
                        Part::Bits(low, _) => low,
                        _ => 0,
                    };
                    part = Part::Bits(low + u32::from(*bit), 1);
                }
                StepKind::Part(low, count) => part = Part::Bits((*low).into(), (*count).into()),
                StepKind::Deref => match self.memory.scalar(node) {
                    Scalar::Ref(Some(target)) => node = target,
                    _ => return self.trap(TrapKind::NullReference, place.span),
                },
                StepKind::Element(_) => return Err(Stop::Unknown("pointers")),
                StepKind::Char(index) => {
                    let at = self.scalar(index, frame)?.int();
                    let len = self.memory.text(node).len();
                    if at < 1 || at > len as i128 {
                        return self.trap(TrapKind::Index, index.span);
                    }
                    part = Part::Char(at as usize - 1);
                }
            }
            ty = step.ty;
        }
        Ok(Spot { node, part })
    }

    pub(super) fn root(&self, id: VarId, frame: &Frame) -> Run<NodeId> {
        let found = frame
            .own
            .get(&id)
            .copied()
            .or_else(|| self.fixed(id))
            .or_else(|| frame.this.and_then(|this| self.memory.member(this, id)));
        found.ok_or(Stop::Unknown("a variable that is nowhere"))
    }

    pub(super) fn load(&self, spot: Spot) -> Scalar {
        match spot.part {
            Part::Whole => self.memory.scalar(spot.node),
            Part::Bits(low, count) => {
                let whole = self.memory.scalar(spot.node).int();
                Scalar::Int(whole >> low & ((1 << count) - 1))
            }
            Part::Char(at) => Scalar::Int(self.memory.text(spot.node)[at].into()),
        }
    }

    pub(super) fn store(&mut self, spot: Spot, data: &Data) {
        match (spot.part, data) {
            (Part::Whole, data) => self.memory.set_data(spot.node, data),
            (Part::Bits(low, count), Data::Scalar(value)) => {
                let Node::Scalar(elem, old) = self.memory.node(spot.node).clone() else {
                    return;
                };
                let mask = ((1i128 << count) - 1) << low;
                let new = old.int() & !mask | value.int() << low & mask;
                self.memory
                    .set(spot.node, Scalar::Int(value::wrap(elem, new)));
            }
            (Part::Char(at), Data::Scalar(value)) => {
                self.memory.set_unit(spot.node, at, value.int() as u16);
            }
            _ => {}
        }
    }

    // Expressions.

    pub(super) fn elem(&self, ty: TypeId) -> Elem {
        self.project.types.elem(ty).unwrap_or(Elem::Bool)
    }

    pub(super) fn is_text(&self, ty: TypeId) -> bool {
        matches!(self.project.types.kind(ty), TypeKind::Str { .. })
    }
}
