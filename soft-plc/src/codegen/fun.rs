//! One function under construction: locals, labels, instructions.

use std::collections::BTreeMap;

use wasm_encoder::{BlockType, Instruction as I, MemArg, ValType};

use super::hold::Held;
use super::inline::Instance;
use super::known::Known;
use super::loops::Round;
use super::{SiteKind, State};
use crate::check::tree::{InitValue, PouId, VarId};
use crate::memory::{Filler, MEMORY_BYTES_MAX, is_kept};
use crate::source::Span;
use crate::syntax::ast::{PouKind, VarSection};
use crate::types::{Elem, TypeId};
use crate::value::Value;

/// The Wasm type that values of an elementary type are computed in.
pub fn val(elem: Elem) -> ValType {
    match elem {
        Elem::Real => ValType::F32,
        Elem::Lreal => ValType::F64,
        e if e.bits() == 64 => ValType::I64,
        _ => ValType::I32,
    }
}

pub fn mem(offset: u32, align: u32) -> MemArg {
    MemArg {
        offset: u64::from(offset),
        align,
        memory_index: 0,
    }
}

/// Where a variable that is not in an instance lives while its POU runs.
#[derive(Clone, Copy, Debug)]
pub enum Slot {
    Local(u32),
    /// Fixed address of an array or structure.
    Scratch(u32),
    /// Local that holds the address (VAR_IN_OUT).
    Pointer(u32),
    /// Locals that hold the address of a string and how many characters it can have (VAR_IN_OUT).
    PointerText(u32, u32),
}

pub struct FunctionCode {
    pub pou: PouId,
    pub params: Vec<ValType>,
    pub results: Vec<ValType>,
    pub locals: Vec<ValType>,
    pub code: Vec<I<'static>>,
    pub marks: Vec<(usize, Span)>,
    pub loops: Vec<(usize, usize, Span)>,
    /// Branches whose condition is nearly always false, or true.
    pub hints: Vec<(usize, bool)>,
}

pub struct Fun<'m, 'p> {
    pub m: &'m mut State<'p>,
    pub pou: PouId,
    params: Vec<ValType>,
    locals: Vec<ValType>,
    free: Vec<(ValType, u32)>,
    pub code: Vec<I<'static>>,
    pub slots: BTreeMap<VarId, Slot>,
    marks: Vec<(usize, Span)>,
    pub loops: Vec<(usize, usize, Span)>,
    hints: Vec<(usize, bool)>,
    /// Number of open blocks.
    pub depth: u32,
    /// Depth of the block that EXIT leaves and of the one that CONTINUE goes to, innermost last.
    pub labels: Vec<(u32, u32)>,
    /// The end of the round of which the next statement, a CASE, is the last.
    pub round: Option<Round>,
    /// Variables in locals while the outermost loop runs.
    pub held: Vec<Held>,
    /// Depth of the blocks that RETURN leaves, and whether variables were held when they were opened.
    pub returns: Vec<(u32, bool)>,
    /// Values that FOR variables keep to.
    pub ranges: BTreeMap<VarId, (i128, i128)>,
    /// FOR variables that are so much ahead of their local: the local is brought up to date once a round.
    pub ahead: BTreeMap<VarId, i128>,
    pub known: Known,
    /// Local with the number of the scan, inside loops that are watched.
    pub scan_number: Option<u32>,
    /// The function block instance whose variables are meant.
    pub instance: Instance,
    /// Nodes of function blocks whose statements stand in the place of their calls.
    pub put_in_place: u64,
    /// The next address is that of something that is only read: a pointer may lead to a constant.
    pub reads: bool,
}

/// Whether variables live only while the POU runs.
pub fn is_function(kind: PouKind) -> bool {
    matches!(kind, PouKind::Function | PouKind::Method)
}

/// Whether the function's first parameter is the address of an instance.
pub fn has_instance(kind: PouKind) -> bool {
    matches!(kind, PouKind::FunctionBlock | PouKind::Method)
}

/// Parameters and results of a POU's function.
pub struct Shape {
    pub params: Vec<ValType>,
    pub results: Vec<ValType>,
    /// Scalar VAR_OUTPUTs of a function, in the order of the results after the function's own.
    pub outputs: Vec<VarId>,
}

impl<'p> State<'p> {
    pub fn shape(&self, pou: PouId) -> Shape {
        let project = self.project;
        let mut shape = Shape {
            params: Vec::new(),
            results: Vec::new(),
            outputs: Vec::new(),
        };
        let unit = project.pou(pou);
        if has_instance(unit.kind) {
            shape.params.push(ValType::I32);
        }
        let is_function = is_function(unit.kind);
        if let Some(result) = unit.result
            && let Some(elem) = project.types.elem(project.var(result).ty)
        {
            shape.results.push(val(elem));
        }
        for id in &unit.vars {
            let var = project.var(*id);
            let scalar = project.types.elem(var.ty).map(val);
            match var.section {
                VarSection::InOut => {
                    shape.params.push(ValType::I32);
                    if project.types.text(var.ty).is_some() {
                        shape.params.push(ValType::I32);
                    }
                }
                VarSection::Input if is_function && !var.constant => {
                    shape.params.push(scalar.unwrap_or(ValType::I32));
                    if project.types.text(var.ty).is_some() {
                        shape.params.push(ValType::I32);
                    }
                }
                VarSection::Output if is_function => {
                    if let Some(scalar) = scalar {
                        shape.results.push(scalar);
                        shape.outputs.push(*id);
                    }
                }
                _ => {}
            }
        }
        shape
    }

    pub fn size_of(&mut self, ty: TypeId) -> u32 {
        self.plan.sizes.of(self.project, ty).0 as u32
    }

    /// Scratch memory of a temporary array or structure: the same for all calls of its POU.
    pub fn scratch_of(&mut self, var: VarId) -> u32 {
        if let Some(at) = self.scratch.get(&var) {
            return *at;
        }
        let size = self.size_of(self.project.var(var).ty);
        let at = self.allocate(u64::from(size));
        self.scratch.insert(var, at);
        at
    }
}

impl<'m, 'p> Fun<'m, 'p> {
    pub fn compile(m: &'m mut State<'p>, pou: PouId) -> FunctionCode {
        let project = m.project;
        let shape = m.shape(pou);
        let mut fun = Fun {
            m,
            pou,
            params: shape.params.clone(),
            locals: Vec::new(),
            free: Vec::new(),
            code: Vec::new(),
            slots: BTreeMap::new(),
            marks: Vec::new(),
            loops: Vec::new(),
            hints: Vec::new(),
            depth: 0,
            labels: Vec::new(),
            round: None,
            held: Vec::new(),
            returns: Vec::new(),
            ranges: BTreeMap::new(),
            ahead: BTreeMap::new(),
            known: Known::default(),
            scan_number: None,
            instance: Instance::parameter(),
            put_in_place: 0,
            reads: false,
        };
        fun.prologue();
        // RETURN leaves this block.
        let body = fun.open(I::Block(BlockType::Empty));
        fun.returns.push((body, false));
        fun.stmts(project.body(pou));
        fun.close();
        let results = project
            .pou(pou)
            .result
            .into_iter()
            .chain(shape.outputs.iter().copied());
        for var in results {
            match fun.slots.get(&var).copied() {
                Some(Slot::Local(local)) => fun.i(I::LocalGet(local)),
                Some(Slot::Scratch(_)) => fun.push_addressed(var),
                _ => {}
            }
        }
        fun.i(I::End);
        FunctionCode {
            pou,
            params: shape.params,
            results: shape.results,
            locals: fun.locals,
            code: fun.code,
            marks: fun.marks,
            loops: fun.loops,
            hints: fun.hints,
        }
    }

    /// Gives every parameter and temporary variable its place and its initial value.
    fn prologue(&mut self) {
        let project = self.m.project;
        let unit = project.pou(self.pou);
        let is_function = is_function(unit.kind);
        let mut param = u32::from(has_instance(unit.kind));
        let mut vars: Vec<VarId> = unit.vars.clone();
        vars.extend(unit.result);
        for id in vars {
            let var = project.var(id);
            if var.constant || (is_kept(var) && !is_function) || var.location.is_some() {
                continue;
            }
            let scalar = project.types.elem(var.ty);
            match (var.section, scalar) {
                (VarSection::InOut, _) if project.types.text(var.ty).is_some() => {
                    self.slots.insert(id, Slot::PointerText(param, param + 1));
                    param += 2;
                }
                (VarSection::InOut, _) => {
                    self.slots.insert(id, Slot::Pointer(param));
                    param += 1;
                }
                (VarSection::Input, None) if project.types.text(var.ty).is_some() => {
                    let (wide, len) = project.types.text(var.ty).unwrap_or_default();
                    let at = self.m.scratch_of(id);
                    self.i(I::I32Const(at as i32));
                    self.i(I::I32Const(len as i32));
                    self.i(I::LocalGet(param));
                    self.i(I::LocalGet(param + 1));
                    self.i(I::Call(super::helper::assign(wide)));
                    self.slots.insert(id, Slot::Scratch(at));
                    param += 2;
                }
                (VarSection::Input, Some(_)) => {
                    self.slots.insert(id, Slot::Local(param));
                    self.place_addressed(id, param);
                    param += 1;
                }
                (VarSection::Input, None) => {
                    // Passed by address, owned by the callee: copied.
                    let at = self.m.scratch_of(id);
                    let size = self.m.size_of(var.ty);
                    self.i(I::I32Const(at as i32));
                    self.i(I::LocalGet(param));
                    self.copy(size);
                    self.slots.insert(id, Slot::Scratch(at));
                    param += 1;
                }
                (_, Some(elem)) => {
                    let local = self.new_local(val(elem));
                    self.slots.insert(id, Slot::Local(local));
                    let value = self.initial(id, elem);
                    if value != Value::zero(elem) {
                        self.constant(value, elem);
                        self.i(I::LocalSet(local));
                    }
                    self.place_addressed(id, local);
                }
                (_, None) => self.prepare_scratch(id),
            }
        }
    }

    /// The value with which a scalar variable begins.
    fn initial(&self, id: VarId, elem: Elem) -> Value {
        let var = self.m.project.var(id);
        match &var.init {
            Some(InitValue::Scalar(value)) => *value,
            _ => self
                .m
                .project
                .types
                .default_value(var.ty)
                .unwrap_or(Value::zero(elem)),
        }
    }

    /// Gives the temporary variables of a function block that is put in the place of its call their places and initial values.
    /// Answers the locals.
    pub fn temporaries(&mut self, pou: PouId) -> Vec<u32> {
        let project = self.m.project;
        let mut locals = Vec::new();
        for id in project.pou(pou).vars.clone() {
            let var = project.var(id);
            if var.section == VarSection::InOut
                || var.constant
                || is_kept(var)
                || var.location.is_some()
            {
                continue;
            }
            match project.types.elem(var.ty) {
                Some(elem) => {
                    let local = self.temp(val(elem));
                    self.slots.insert(id, Slot::Local(local));
                    let value = self.initial(id, elem);
                    self.constant(value, elem);
                    self.i(I::LocalSet(local));
                    self.place_addressed(id, local);
                    locals.push(local);
                }
                None => {
                    self.prepare_scratch(id);
                    // What is known of it is of a call before.
                    self.known.forget_all();
                }
            }
        }
        locals
    }

    fn prepare_scratch(&mut self, id: VarId) {
        let project = self.m.project;
        let var = project.var(id);
        let at = self.m.scratch_of(id);
        let (size, _) = self.m.plan.sizes.of(project, var.ty);
        if size > MEMORY_BYTES_MAX {
            // Reported with the memory of the whole MC.
            self.m.allocate(size);
            return;
        }
        let size = size as u32;
        let mut bytes = vec![0; size as usize];
        let mut filler = Filler {
            project,
            sizes: &mut self.m.plan.sizes,
        };
        filler.variable(&mut bytes, var.ty, var.init.as_ref());
        self.i(I::I32Const(at as i32));
        if bytes.iter().all(|b| *b == 0) {
            self.i(I::I32Const(0));
            self.i(I::I32Const(size as i32));
            self.i(I::MemoryFill(0));
        } else {
            let image = self.m.allocate(u64::from(size));
            self.m.data.push((image, bytes));
            self.i(I::I32Const(image as i32));
            self.copy(size);
        }
        self.slots.insert(id, Slot::Scratch(at));
    }

    pub fn i(&mut self, instruction: I<'static>) {
        self.code.push(instruction);
    }

    /// Copies `size` bytes; destination and source addresses are on the stack.
    pub fn copy(&mut self, size: u32) {
        self.i(I::I32Const(size as i32));
        self.i(I::MemoryCopy {
            src_mem: 0,
            dst_mem: 0,
        });
    }

    pub fn mark(&mut self, span: Span) {
        // Inside a function block that is put in place of its call, the line is that of the call: lines are those of one POU.
        if self.instance.key.is_empty() {
            self.marks.push((self.code.len(), span));
        }
    }

    /// Says that the condition of the branch that comes next is nearly always this: the other way is moved aside.
    pub fn expect(&mut self, condition: bool) {
        self.hints.push((self.code.len(), condition));
    }

    /// Opens a block, loop or if; answers its depth, for `br`.
    pub fn open(&mut self, instruction: I<'static>) -> u32 {
        self.i(instruction);
        self.depth += 1;
        self.depth
    }

    pub fn close(&mut self) {
        self.i(I::End);
        self.depth -= 1;
    }

    /// The label that leads from here to the block of this depth.
    pub fn label(&self, target: u32) -> u32 {
        self.depth - target
    }

    pub fn new_local(&mut self, ty: ValType) -> u32 {
        self.locals.push(ty);
        (self.params.len() + self.locals.len()) as u32 - 1
    }

    /// A local for a moment; give it back with `release`.
    pub fn temp(&mut self, ty: ValType) -> u32 {
        match self.free.iter().position(|(t, _)| *t == ty) {
            Some(index) => self.free.swap_remove(index).1,
            None => self.new_local(ty),
        }
    }

    pub fn release(&mut self, local: u32) {
        let index = local as usize - self.params.len();
        self.free.push((self.locals[index], local));
    }

    /// Traps if the i32 on the stack is not 0. `detail` is a local with the value at fault.
    pub fn trap_if(&mut self, kind: SiteKind, span: Span, detail: Option<(u32, Elem)>) {
        let site = self.m.site(kind, self.pou, span);
        self.expect(false);
        self.open(I::If(BlockType::Empty));
        self.i(I::I32Const(site));
        match detail {
            Some((local, elem)) => {
                self.i(I::LocalGet(local));
                if val(elem) == ValType::I32 {
                    let unsigned = matches!(elem, Elem::Udint | Elem::Dword);
                    self.i(if unsigned {
                        I::I64ExtendI32U
                    } else {
                        I::I64ExtendI32S
                    });
                }
            }
            None => self.i(I::I64Const(0)),
        }
        self.i(I::Call(super::helper::TRAP));
        self.i(I::Unreachable);
        self.close();
    }

    pub fn elem(&self, ty: TypeId) -> Elem {
        self.m.project.types.elem(ty).unwrap_or(Elem::Dint)
    }
}
