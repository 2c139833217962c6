//! Calls of functions, function block instances and programs.

use wasm_encoder::{Instruction as I, ValType};

use super::SiteKind;
use super::fun::{Fun, mem, val};
use super::place::{Addr, Form, Kept};
use super::text::calls;
use crate::check::tree::{
    Argument, Expr, ExprKind, FunctionCall, Invocation, Place, PouId, Receiver, Root, Step,
    StepKind, VarId,
};
use crate::memory::CALLER_SITE_AT;
use crate::source::Span;
use crate::syntax::ast::VarSection;
use crate::types::{Elem, TypeId};

/// A scalar passed by reference that has no ordinary cell: when the call begins it goes to a cell in scratch memory, and back
/// when it has ended.
struct WayBack {
    cell: u32,
    elem: Elem,
    target: Target,
    /// Lowest bit and number of bits of a larger value, and its type.
    bits: Option<(Elem, (u8, u8))>,
}

enum Target {
    Local(u32),
    Memory(Kept),
}

impl Fun<'_, '_> {
    /// Pushes the result of a function, if it is a scalar.
    /// Before a POU of the library that can trap: whoever reads of the trap knows this line, and not those of the library.
    fn note_caller(&mut self, callee: PouId, span: Span) {
        let is_library = |pou: PouId| self.m.project.pou(pou).library;
        if !is_library(callee) || is_library(self.pou) || !self.m.may_trap(callee) {
            return;
        }
        let site = self.m.site(SiteKind::Caller, self.pou, span);
        self.i(I::I32Const(0));
        self.i(I::I32Const(site));
        self.i(I::I32Store(mem(CALLER_SITE_AT, 2)));
    }

    pub fn function_call(&mut self, call: &FunctionCall) {
        let project = self.m.project;
        let parameters: Vec<VarId> = self.parameters(call.pou);
        let mut back = Vec::new();
        if let Some(receiver) = &call.receiver {
            self.push_receiver(receiver);
        }
        for (number, (parameter, argument)) in parameters.iter().zip(&call.args).enumerate() {
            let later: Vec<&Expr> = call.args[number + 1..]
                .iter()
                .filter_map(|a| match a {
                    Argument::Input(expr) => Some(expr),
                    _ => None,
                })
                .collect();
            match argument {
                Argument::Input(expr)
                    if project.types.text(project.var(*parameter).ty).is_some() =>
                {
                    self.text_before(expr, &later);
                }
                Argument::Input(expr) if project.types.is_aggregate(project.var(*parameter).ty) => {
                    self.aggregate(expr);
                    if matches!(expr.kind, ExprKind::Load(_)) && later.iter().any(|e| calls(e)) {
                        self.keep_aggregate(expr.ty);
                    }
                }
                Argument::Input(expr) => self.expr(expr),
                Argument::InOut(place) => self.pass(place, &mut back),
                Argument::Output { .. } => {}
            }
        }
        self.copy_in(&back);
        let number = match &call.receiver {
            Some(receiver) => self
                .m
                .method_number(call.pou, receiver, self.pou, call.span),
            None => self.m.numbers[&call.pou],
        };
        self.note_caller(call.pou, call.span);
        self.i(I::Call(number));
        self.known.forget_all();
        // The outputs lie above the result, the last one on top.
        let shape = self.m.shape(call.pou);
        let mut values = Vec::new();
        for output in shape.outputs.iter().rev() {
            let elem = self.elem(project.var(*output).ty);
            let local = self.temp(val(elem));
            self.i(I::LocalSet(local));
            values.push((*output, local, elem));
        }
        self.bring_back(back);
        for (parameter, argument) in parameters.iter().zip(&call.args) {
            let Argument::Output {
                target: Some(place),
                negated,
            } = argument
            else {
                continue;
            };
            match values.iter().find(|(p, _, _)| p == parameter).copied() {
                Some((_, local, elem)) => {
                    self.store_converted(place, elem, *negated, |f| f.i(I::LocalGet(local)))
                }
                None if project.types.text(place.ty).is_some() => {
                    let at = self.m.scratch_of(*parameter);
                    self.copy_text(place, |f| f.i(I::I32Const(at as i32)));
                }
                None => {
                    let at = self.m.scratch_of(*parameter);
                    self.store_aggregate(place, |f| f.i(I::I32Const(at as i32)));
                }
            }
        }
        for (_, local, _) in values {
            self.release(local);
        }
    }

    /// Pushes the address of the instance whose method is called.
    fn push_receiver(&mut self, receiver: &Receiver) {
        match receiver {
            Receiver::Fixed(place) | Receiver::Derived(place) => {
                self.push_full_address(place);
            }
            Receiver::Interface(place, _) => {
                self.load(place);
                let local = self.temp(ValType::I32);
                self.i(I::LocalTee(local));
                self.i(I::I32Eqz);
                self.trap_if(SiteKind::NullReference, place.span, None);
                self.i(I::LocalGet(local));
                self.release(local);
                self.reach_reference(4, place.span);
            }
        }
    }

    /// Calls a function whose result is an array or structure and pushes the address of a copy that no later call touches.
    pub fn aggregate_call(&mut self, call: &FunctionCall, ty: TypeId) {
        self.function_call(call);
        let Some(result) = self.m.project.pou(call.pou).result else {
            return;
        };
        let size = self.m.size_of(ty);
        let from = self.m.scratch_of(result);
        let own = self.m.allocate(u64::from(size));
        self.i(I::I32Const(own as i32));
        self.i(I::I32Const(from as i32));
        self.copy(size);
        self.i(I::I32Const(own as i32));
    }

    fn parameters(&self, pou: PouId) -> Vec<VarId> {
        let project = self.m.project;
        let takes = |s| {
            matches!(
                s,
                VarSection::Input | VarSection::Output | VarSection::InOut
            )
        };
        project
            .pou(pou)
            .vars
            .iter()
            .copied()
            .filter(|v| takes(project.var(*v).section) && !project.var(*v).constant)
            .collect()
    }

    /// Replaces the address of an array or structure on the stack by that of a copy.
    fn keep_aggregate(&mut self, ty: TypeId) {
        let size = self.m.size_of(ty);
        let own = self.m.allocate(u64::from(size));
        let from = self.temp(ValType::I32);
        self.i(I::LocalSet(from));
        self.i(I::I32Const(own as i32));
        self.i(I::LocalGet(from));
        self.copy(size);
        self.i(I::I32Const(own as i32));
        self.release(from);
    }

    /// Pushes the address under which the callee finds the variable.
    fn pass(&mut self, place: &Place, back: &mut Vec<WayBack>) {
        let project = self.m.project;
        if project.types.is_aggregate(place.ty) {
            self.push_full_address(place);
            if project.types.text(place.ty).is_some() {
                self.push_capacity(place);
            }
            return;
        }
        let bits = Self::bits_of(place).map(|bits| (self.whole_elem(place), bits));
        let target = if let Some(local) = self.local_of(place) {
            Target::Local(local)
        } else if bits.is_none() && self.is_ordinary(place) {
            self.push_full_address(place);
            return;
        } else {
            Target::Memory(self.keep_address(place))
        };
        // The same local by two names is one variable.
        let known = back.iter().find(|b| match (&b.target, &target) {
            (Target::Local(a), Target::Local(b2)) => a == b2 && b.bits.is_none() && bits.is_none(),
            _ => false,
        });
        if let Some(known) = known {
            self.i(I::I32Const(known.cell as i32));
            return;
        }
        let cell = self.m.allocate(8);
        self.i(I::I32Const(cell as i32));
        back.push(WayBack {
            cell,
            elem: self.elem(place.ty),
            target,
            bits,
        });
    }

    /// Just before the call, when all arguments have been evaluated.
    fn copy_in(&mut self, list: &[WayBack]) {
        for way in list {
            let whole = way.bits.map_or(way.elem, |b| b.0);
            self.i(I::I32Const(0));
            match &way.target {
                Target::Local(local) => self.i(I::LocalGet(*local)),
                Target::Memory(kept) => {
                    self.push_kept(kept);
                    self.load_from(whole, kept.addr);
                }
            }
            if let Some((_, (low, count))) = way.bits {
                self.pick_bits(whole, low, count);
            }
            self.store_to(way.elem, cell_at(way.cell));
        }
    }

    /// Whether the scalar lies in an ordinary cell.
    fn is_ordinary(&self, place: &Place) -> bool {
        let project = self.m.project;
        if let Root::Var(id) = place.root
            && project.var(id).is_closer(&project.types)
        {
            return false;
        }
        if self.m.pointers && project.is_through_pointer(place) {
            return false;
        }
        match place.steps.last().map(|s| &s.kind) {
            Some(StepKind::Index(_)) => !self.elem(place.ty).is_packed_in_arrays(),
            Some(StepKind::Char(_)) => false,
            Some(_) => true,
            None => match place.root {
                Root::This => true,
                Root::Var(id) => project.var(id).location.is_none(),
                Root::Direct(_) => false,
            },
        }
    }

    fn bring_back(&mut self, list: Vec<WayBack>) {
        for back in list {
            let value = |f: &mut Self| {
                f.i(I::I32Const(0));
                f.load_from(back.elem, cell_at(back.cell));
            };
            match (&back.target, back.bits) {
                (Target::Local(local), None) => {
                    value(self);
                    self.i(I::LocalSet(*local));
                }
                (Target::Local(local), Some((whole, bits))) => {
                    self.merge_bits(whole, bits, |f| f.i(I::LocalGet(*local)), value);
                    self.i(I::LocalSet(*local));
                }
                (Target::Memory(kept), None) => {
                    self.push_kept(kept);
                    value(self);
                    self.store_to(back.elem, kept.addr);
                }
                (Target::Memory(kept), Some((whole, bits))) => {
                    self.store_bits(whole, bits, kept, value);
                }
            }
            if let Target::Memory(kept) = &back.target {
                self.release_kept(kept);
            }
        }
    }

    /// Stores a value of type `from` to a place of the same or a wider type.
    fn store_converted(
        &mut self,
        place: &Place,
        from: Elem,
        negated: bool,
        value: impl FnOnce(&mut Self),
    ) {
        let to = self.elem(place.ty);
        let span = place.span;
        self.store(place, |f| {
            value(f);
            if negated {
                f.i(I::I32Eqz);
            }
            f.convert(from, to, span);
        });
    }

    pub fn invoke(&mut self, call: &Invocation) {
        let base = call.instance.as_ref().map(|place| self.keep_address(place));
        // What the caller writes and the function block reads, and the other way round, stays in locals if both are one function.
        let in_place = call
            .instance
            .as_ref()
            .zip(base.as_ref())
            .filter(|_| self.weight_in_place(call).is_some());
        let seen = in_place.map(|(place, _)| place);
        for (parameter, value) in &call.inputs {
            self.set_input(base.as_ref(), seen, *parameter, value);
        }
        if in_place.is_none()
            && let Some(kept) = &base
        {
            self.push_kept(kept);
            if kept.addr.offset != 0 {
                self.i(I::I32Const(kept.addr.offset as i32));
                self.i(I::I32Add);
            }
        }
        let mut back = Vec::new();
        for place in &call.in_outs {
            self.pass(place, &mut back);
        }
        self.copy_in(&back);
        self.note_caller(call.pou, call.span);
        match in_place {
            Some((place, kept)) => self.put_in_place(call, place, kept),
            None => {
                self.i(I::Call(self.m.numbers[&call.pou]));
                self.known.forget_all();
            }
        }
        self.bring_back(back);
        for (parameter, place, negated) in &call.outputs {
            self.take_output(base.as_ref(), seen, *parameter, place, *negated);
        }
        if let Some(kept) = &base {
            self.release_kept(kept);
        }
    }

    /// `OUT => place`.
    fn take_output(
        &mut self,
        base: Option<&Kept>,
        seen: Option<&Place>,
        parameter: VarId,
        place: &Place,
        negated: bool,
    ) {
        let project = self.m.project;
        let ty = project.var(parameter).ty;
        let addr = self.member(base, parameter);
        let address = |f: &mut Self| {
            f.push_member(base);
            f.i(I::I32Const(addr.offset as i32));
            f.i(I::I32Add);
        };
        if project.types.text(ty).is_some() {
            self.copy_text(place, address);
        } else if project.types.is_aggregate(ty) {
            self.store_aggregate(place, address);
        } else {
            let elem = self.elem(ty);
            let known = seen.and_then(|i| self.known_local(&self.parameter_of(i, parameter)));
            self.store_converted(place, elem, negated, |f| match known {
                Some(local) => f.i(I::LocalGet(local)),
                None => {
                    f.push_member(base);
                    f.load_from(elem, addr);
                }
            });
        }
    }

    /// A parameter as a place of the caller.
    fn parameter_of(&self, instance: &Place, parameter: VarId) -> Place {
        let ty = self.m.project.var(parameter).ty;
        let mut place = instance.clone();
        place.steps.push(Step {
            kind: StepKind::Member(parameter),
            ty,
        });
        place.ty = ty;
        place
    }

    fn push_member(&mut self, base: Option<&Kept>) {
        match base {
            Some(kept) => self.push_kept(kept),
            None => self.i(I::I32Const(0)),
        }
    }

    /// Where a parameter lies, counted from what `push_member` pushes. Programs have one instance, at a fixed address.
    fn member(&self, base: Option<&Kept>, var: VarId) -> Addr {
        let own = self.m.plan.addresses[var.0 as usize];
        cell_at(own + base.map_or(0, |kept| kept.addr.offset))
    }

    /// `IN := value`. `seen`: the instance, if the value is kept in a local as well.
    fn set_input(
        &mut self,
        base: Option<&Kept>,
        seen: Option<&Place>,
        parameter: VarId,
        value: &Expr,
    ) {
        let ty = self.m.project.var(parameter).ty;
        let addr = self.member(base, parameter);
        self.push_member(base);
        // The inputs behind it may read it: nothing that was known of it holds.
        if let Some((wide, len)) = self.m.project.types.text(ty) {
            self.i(I::I32Const(addr.offset as i32));
            self.i(I::I32Add);
            self.i(I::I32Const(len as i32));
            self.text(value);
            self.i(I::Call(super::helper::assign(wide)));
            self.known.forget_all();
        } else if self.m.project.types.is_aggregate(ty) {
            let size = self.m.size_of(ty);
            self.i(I::I32Const(addr.offset as i32));
            self.i(I::I32Add);
            self.aggregate(value);
            self.copy(size);
            self.known.forget_all();
        } else {
            let elem = self.elem(ty);
            self.expr(value);
            if !self.is_canonical(value) {
                self.canonical(elem);
            }
            self.known.forget_variable(parameter);
            if let Some(local) = seen.and_then(|i| self.learn(&self.parameter_of(i, parameter))) {
                self.i(I::LocalTee(local));
            }
            self.store_as_it_is(elem, addr);
        }
    }

    /// Drops what a call of a function for its effects leaves on the stack.
    pub fn call_for_effect(&mut self, call: &FunctionCall) {
        self.function_call(call);
        let result = self.m.project.pou(call.pou).result;
        let scalar =
            result.is_some_and(|r| !self.m.project.types.is_aggregate(self.m.project.var(r).ty));
        if scalar {
            self.i(I::Drop);
        }
    }
}

fn cell_at(offset: u32) -> Addr {
    Addr {
        offset,
        form: Form::Cell,
    }
}
