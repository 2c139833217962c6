//! Calls: arguments in, by reference and out, for functions, methods and function blocks.

use std::collections::BTreeMap;

use fam_soft_plc::TrapKind;
use fam_soft_plc::check::tree::{
    Argument, FunctionCall, Invocation, Place, PouId, Receiver, Root, StepKind, VarId,
};
use fam_soft_plc::syntax::ast::VarSection;
use fam_soft_plc::types::TypeId;

use super::{Frame, Machine, Part, Run, Spot, Stop};
use crate::memory::{Data, Node, NodeId};
use crate::value::{self, Scalar};

impl Machine<'_> {
    /// The node that a VAR_IN_OUT stands for while the call runs, and where its value goes back to if it was copied.
    pub(super) fn by_reference(
        &mut self,
        place: &Place,
        frame: &mut Frame,
    ) -> Run<(NodeId, Option<Spot>)> {
        let spot = self.spot(place, frame)?;
        // Parts of cells are copied in and out.
        let element = matches!(
            place.steps.last().map(|s| &s.kind),
            Some(StepKind::Index(_))
        );
        let narrow = self
            .project
            .types
            .elem(place.ty)
            .is_some_and(|e| value::limits(e).1 < 256);
        // So is what lies in the process image, where it is narrower than in memory, or may be.
        let in_image = match place.root {
            Root::Var(id) => {
                let var = self.project.var(id);
                var.is_closer(&self.project.types)
                    || (var.location.is_some() && place.steps.is_empty())
            }
            _ => false,
        };
        let copied = !matches!(spot.part, Part::Whole) || (element && narrow) || in_image;
        if !copied {
            return Ok((spot.node, None));
        }
        Ok((self.memory.variable(place.ty, None), Some(spot)))
    }

    /// Just before the call, when all arguments have been evaluated.
    pub(super) fn copy_in(&mut self, copies: &[(NodeId, Spot)]) {
        for (node, spot) in copies {
            let value = self.load(*spot);
            self.memory.set(*node, value);
        }
    }

    pub(super) fn bring_back(&mut self, copies: &[(NodeId, Spot)]) {
        for (node, spot) in copies {
            let value = self.memory.scalar(*node);
            self.store(*spot, &Data::Scalar(value));
        }
    }

    /// Stores an output; numbers widen on the way.
    pub(super) fn store_output(
        &mut self,
        from: TypeId,
        target: &Place,
        value: Data,
        negated: bool,
        spot: Spot,
    ) -> Run<()> {
        let data = match value {
            Data::Scalar(scalar) => {
                let (from, to) = (self.elem(from), self.elem(target.ty));
                let scalar = if negated {
                    Scalar::Int(1 - scalar.int())
                } else {
                    scalar
                };
                Data::Scalar(self.or_trap(value::convert(from, to, scalar), target.span)?)
            }
            other => other,
        };
        self.store(spot, &data);
        Ok(())
    }

    pub(super) fn invoke(&mut self, call: &Invocation, frame: &mut Frame) -> Run<()> {
        let mark = self.memory.mark();
        let this = match &call.instance {
            Some(place) => Some(self.spot(place, frame)?.node),
            None => None,
        };
        for (parameter, expr) in &call.inputs {
            let data = self.data(expr, frame)?;
            let node = self.parameter(this, *parameter)?;
            self.memory.set_data(node, &data);
        }
        let parameters = self.project.pou(call.pou).vars.iter().copied();
        let in_outs = parameters.filter(|v| self.project.var(*v).section == VarSection::InOut);
        let mut own = BTreeMap::new();
        let mut copies = Vec::new();
        for (parameter, place) in in_outs.zip(&call.in_outs) {
            let (node, back) = self.by_reference(place, frame)?;
            own.insert(parameter, node);
            copies.extend(back.map(|spot| (node, spot)));
        }
        self.copy_in(&copies);
        self.run_pou(call.pou, this, own)?;
        self.bring_back(&copies);
        for (parameter, place, negated) in &call.outputs {
            let spot = self.spot(place, frame)?;
            let node = self.parameter(this, *parameter)?;
            let value = self.memory.data(node);
            self.store_output(
                self.project.var(*parameter).ty,
                place,
                value,
                *negated,
                spot,
            )?;
        }
        self.memory.forget(mark);
        Ok(())
    }

    pub(super) fn parameter(&self, this: Option<NodeId>, var: VarId) -> Run<NodeId> {
        let found = match this {
            Some(instance) => self.memory.member(instance, var),
            None => self.fixed(var),
        };
        found.ok_or(Stop::Unknown("a parameter that is nowhere"))
    }

    pub(super) fn function_call(
        &mut self,
        call: &FunctionCall,
        frame: &mut Frame,
    ) -> Run<Option<Data>> {
        let project = self.project;
        let mark = self.memory.mark();
        let (this, pou) = self.callee(call, frame)?;
        let takes = |id: &VarId| {
            let var = project.var(*id);
            let section = matches!(
                var.section,
                VarSection::Input | VarSection::Output | VarSection::InOut
            );
            section && !var.constant
        };
        // The method that runs may be another than the one that was declared; its parameters are the same.
        let declared: Vec<VarId> = project
            .pou(call.pou)
            .vars
            .iter()
            .copied()
            .filter(takes)
            .collect();
        let parameters: Vec<VarId> = project
            .pou(pou)
            .vars
            .iter()
            .copied()
            .filter(takes)
            .collect();
        let mut inputs = Vec::new();
        let mut own = BTreeMap::new();
        let mut copies = Vec::new();
        for (parameter, argument) in parameters.iter().zip(&call.args) {
            match argument {
                Argument::Input(expr) => inputs.push((*parameter, self.data(expr, frame)?)),
                Argument::InOut(place) => {
                    let (node, back) = self.by_reference(place, frame)?;
                    own.insert(*parameter, node);
                    copies.extend(back.map(|spot| (node, spot)));
                }
                Argument::Output { .. } => {}
            }
        }
        self.copy_in(&copies);
        let unit = project.pou(pou);
        for id in unit.vars.iter().chain(unit.result.as_ref()) {
            let var = project.var(*id);
            if var.constant || var.section == VarSection::InOut {
                continue;
            }
            let node = self.memory.variable(var.ty, var.init.as_ref());
            if let Some((_, data)) = inputs.iter().find(|(p, _)| p == id) {
                self.memory.set_data(node, data);
            }
            own.insert(*id, node);
        }
        let mut inner = Frame { this, own };
        self.stmts(project.body(pou), &mut inner)?;
        let result = unit.result.map(|id| self.memory.data(inner.own[&id]));
        self.bring_back(&copies);
        for ((parameter, declared), argument) in parameters.iter().zip(&declared).zip(&call.args) {
            if let Argument::Output {
                target: Some(place),
                negated,
            } = argument
            {
                let value = self.memory.data(inner.own[parameter]);
                let spot = self.spot(place, frame)?;
                self.store_output(project.var(*declared).ty, place, value, *negated, spot)?;
            }
        }
        self.memory.forget(mark);
        Ok(result)
    }

    /// Whose method runs, and which.
    pub(super) fn callee(
        &mut self,
        call: &FunctionCall,
        frame: &mut Frame,
    ) -> Run<(Option<NodeId>, PouId)> {
        let (node, fixed) = match &call.receiver {
            None => return Ok((None, call.pou)),
            Some(Receiver::Fixed(place)) => (self.spot(place, frame)?.node, true),
            Some(Receiver::Derived(place)) => (self.spot(place, frame)?.node, false),
            Some(Receiver::Interface(place, _)) => {
                let spot = self.spot(place, frame)?;
                match self.load(spot) {
                    Scalar::Ref(Some(node)) => (node, false),
                    _ => return self.trap(TrapKind::NullReference, place.span),
                }
            }
        };
        if fixed {
            return Ok((Some(node), call.pou));
        }
        let Node::Instance(block, _) = self.memory.node(node) else {
            return Err(Stop::Unknown("a method of no instance"));
        };
        let name = self.project.method_name(call.pou);
        let found = self.project.find_method(*block, &name);
        found
            .map(|m| (Some(node), m))
            .ok_or(Stop::Unknown("a method that is nowhere"))
    }

    // Places.
}
