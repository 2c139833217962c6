//! Calls of small function blocks with their statements put in the place of the call, so that inputs and outputs are handed over in
//! locals. Memory is written all the same: what is spared is reading back, and the call.

use wasm_encoder::{BlockType, Instruction as I, ValType};

use super::fun::{Fun, Slot};
use super::known::Part;
use super::loops::returns;
use super::place::Kept;
use crate::check::tree::{Invocation, Place, PouId, VarId};
use crate::syntax::ast::{PouKind, VarSection};

/// How large a function block may be, in nodes of the tree ...
const NODES_MAX: u64 = 250;
/// ... and how much may be put into one function.
const ALL_NODES_MAX: u64 = 5_000;

/// The instance that the variables of a function block belong to while its statements are compiled.
#[derive(Clone, Debug)]
pub struct Instance {
    /// Local with the address; without it, the address is `offset` alone.
    pub base: Option<u32>,
    pub offset: u32,
    /// How the caller names it, for cells that are known, and variables in its indices.
    pub key: Vec<Part>,
    pub depends_on: Vec<VarId>,
}

impl Instance {
    /// That of a function which gets the address as its first parameter.
    pub fn parameter() -> Self {
        Self {
            base: Some(0),
            offset: 0,
            key: Vec::new(),
            depends_on: Vec::new(),
        }
    }
}

impl Fun<'_, '_> {
    /// How much code the call makes if the statements of the function block are put in its place; else it stays a call.
    pub fn weight_in_place(&self, call: &Invocation) -> Option<u64> {
        let project = self.m.project;
        // What calls others is left to the compiler behind this one, which puts their code in place as well.
        let calls = project.pou(call.pou).calls.is_empty();
        if call.instance.is_none() || !calls || project.pou(call.pou).kind != PouKind::FunctionBlock
        {
            return None;
        }
        let weight = self.weight(project.body(call.pou));
        (weight <= NODES_MAX && self.put_in_place + weight <= ALL_NODES_MAX).then_some(weight)
    }

    /// The statements of the function block, when the inputs are set. The addresses of its VAR_IN_OUTs are on the stack.
    pub fn put_in_place(&mut self, call: &Invocation, place: &Place, base: &Kept) {
        let project = self.m.project;
        let body = project.body(call.pou);
        self.put_in_place += self.weight(body);
        // Variables of a base are those of the caller too, if that is derived from it.
        let slots = self.slots.clone();
        let passed = self.take_addresses(call.pou);
        let instance = self.named_instance(call, place, base);
        let outer = std::mem::replace(&mut self.instance, instance);
        let caller = std::mem::replace(&mut self.pou, call.pou);
        // EXIT and CONTINUE belong to loops inside, and there are none; what is not empty only says that a loop is around.
        let ranges = self.ranges.clone();
        let temporaries = self.temporaries(call.pou);
        let early = returns(body);
        if early {
            self.forget_writes(body);
        }
        let stable = self.known.valid.clone();
        let block = self.open(I::Block(BlockType::Empty));
        self.returns.push((block, true));
        self.stmts(body);
        self.returns.pop();
        self.close();
        if early {
            self.known.meet(&stable);
        }
        self.ranges = ranges;
        self.pou = caller;
        self.instance = outer;
        self.slots = slots;
        for local in temporaries {
            self.release(local);
        }
        if !passed.is_empty() {
            // Another name for what the caller knows by its own.
            self.known.forget_all();
        }
        for local in passed {
            self.release(local);
        }
    }

    /// The instance under the name that the caller gives it, if that means the same until the end of the statements.
    fn named_instance(&mut self, call: &Invocation, place: &Place, base: &Kept) -> Instance {
        let named = self.key_parts(place).filter(|(_, depends_on)| {
            call.in_outs.is_empty()
                && depends_on.iter().all(|id| {
                    !self.m.referenced.contains(id) && !self.m.roots_touched(call.pou).contains(id)
                })
        });
        let (key, depends_on) =
            named.unwrap_or_else(|| (vec![Part::Call(self.code.len())], Vec::new()));
        Instance {
            base: base.base,
            offset: base.addr.offset,
            key,
            depends_on,
        }
    }

    /// Brings what `pass` has pushed into locals, and answers them.
    fn take_addresses(&mut self, pou: PouId) -> Vec<u32> {
        let project = self.m.project;
        let in_outs = project
            .pou(pou)
            .vars
            .iter()
            .filter(|v| project.var(**v).section == VarSection::InOut);
        let mut locals = Vec::new();
        for id in in_outs.rev() {
            let slot = if project.types.text(project.var(*id).ty).is_some() {
                let (at, capacity) = (self.temp(ValType::I32), self.temp(ValType::I32));
                self.i(I::LocalSet(capacity));
                self.i(I::LocalSet(at));
                locals.extend([at, capacity]);
                Slot::PointerText(at, capacity)
            } else {
                let at = self.temp(ValType::I32);
                self.i(I::LocalSet(at));
                locals.push(at);
                Slot::Pointer(at)
            };
            self.slots.insert(*id, slot);
        }
        locals
    }
}
