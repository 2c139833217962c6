//! From the typed tree to a WebAssembly module.
//!
//! One Wasm function for each program, function block and function that the entry reaches. A function block's function takes
//! the address of its instance and of its VAR_IN_OUTs; a function takes its inputs by value (arrays and structures by
//! address) and gives its result and outputs as results. Loops whose steps are known are written out (`loops`), and small function
//! blocks stand in the place of their calls (`inline`); what locals hold already is not read again (`hold`, `known`). POUs do
//! not recurse, so temporary arrays and structures have fixed addresses in scratch memory. Run-time checks call `$trap(site, detail)`, which notes both in the system area and stops.

mod call;
mod cells;
mod convert;
mod dispatch;
mod expr;
mod fun;
mod helper;
mod hold;
mod index;
mod inline;
mod known;
mod loops;
mod math;
mod place;
mod pointer;
mod pointer_helper;
mod stdfun;
mod stmt;
mod text;

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};
use wasm_encoder::{
    BranchHint, BranchHints, CodeSection, ConstExpr, DataSection, EntityType, ExportKind,
    ExportSection, Function, FunctionSection, ImportSection, Instruction, MemorySection,
    MemoryType, Module, TypeSection, ValType,
};

use crate::check::tree::{PouId, TypedProject, VarId};
use crate::diag::{Diagnostic, Problem, finish_all};
use crate::layout::{CompileSpec, Layout};
use crate::memory::{MEMORY_BYTES_MAX, round_up};
use crate::plan::Plan;
use crate::source::Span;
pub(crate) use dispatch::tag_of;
use fun::{Fun, FunctionCode};
#[cfg(feature = "runtime")]
pub(crate) use pointer_helper::{BEHIND_STRING, IS_CONSTANT, NO_STRING};

/// Name of the exported function that runs one scan.
pub const SCAN_EXPORT: &str = "scan";
/// Name of the exported linear memory.
pub const MEMORY_EXPORT: &str = "memory";
/// Module name of the imported mathematical functions.
pub const MATH_MODULE: &str = "math";

const PAGE_BYTES: u64 = 65_536;
/// Function number from which on a call means an import, until the imports are counted.
const IMPORT_BASE: u32 = 0x4000_0000;

/// A compiled MC: module, layout, and what is needed to name the place of a trap.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CompiledMc {
    pub wasm: Vec<u8>,
    pub layout: Layout,
    /// Site n (counted from 1) is `sites[n - 1]`.
    pub sites: Vec<Site>,
    pub code_map: CodeMap,
    /// Equal for equal logic and layout: what two controllers compare before they share an MC.
    pub logic_hash: u64,
}

/// A place in the program at which a run-time check may fail.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Site {
    pub kind: SiteKind,
    pub pou: String,
    pub file: String,
    pub line: u32,
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SiteKind {
    DivisionByZero,
    /// Bounds of the dimension.
    Index(i64, i64),
    /// Limits of the subrange.
    Range(i64, i64),
    /// The enumeration that has no such value.
    Enumeration(String),
    /// MUX with a selector beyond its inputs (their number).
    Selector(i64),
    /// The integer type that the real number does not fit.
    Conversion(String),
    /// The type that the text shows no value of.
    Text(String),
    NullReference,
    /// A pointer that leads to no variable, or to none that can be used so.
    Address,
    /// A character that the string does not have.
    Character,
    /// A loop that the watchdog has stopped.
    EndlessLoop,
    /// The call of a POU of the library: the line of a trap in it that means something to people.
    Caller,
}

/// Lines of the code: for traps that have no site, such as an endless loop.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CodeMap {
    /// Number of the first function of the list, after imports and helpers.
    pub first_function: u32,
    pub functions: Vec<FunctionMap>,
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FunctionMap {
    pub pou: String,
    pub file: String,
    /// Offset in the function's body and line of each statement, ascending.
    pub lines: Vec<(u32, u32)>,
    /// Offsets of start and end, and line, of each loop; inner loops stand before outer ones.
    pub loops: Vec<(u32, u32, u32)>,
}

/// Compiles the entry program of `spec` and all that it reaches.
pub fn compile(project: &TypedProject, spec: &CompileSpec) -> Result<CompiledMc, Vec<Diagnostic>> {
    let plan = Plan::new(project, spec)?;
    let mut state = State::new(project, plan);
    let mut functions = Vec::new();
    for pou in state.order.clone() {
        let sites = state.sites.len();
        functions.push(Fun::compile(&mut state, pou));
        if project.pou(pou).library && state.sites.len() > sites {
            state.trapping.insert(pou);
        }
    }
    state.note_strings();
    let needed = round_up(u64::from(state.scratch_at), 8);
    if needed > MEMORY_BYTES_MAX {
        let message = format!(
            "variables and temporary values take {needed} bytes, and an MC has at most {MEMORY_BYTES_MAX}"
        );
        state.problems.push(Problem::general("E505", message));
    }
    if !state.problems.is_empty() {
        return Err(finish_all(state.problems, &project.sources));
    }
    Ok(state.assemble(&functions, needed))
}

const REAL_64: &[ValType] = &[ValType::F64];

/// A function that is made because another calls it.
enum Behind {
    Dispatcher(dispatch::Dispatcher),
    Formula(math::Formula),
}

/// What all functions share while they are compiled.
struct State<'p> {
    project: &'p TypedProject,
    plan: Plan,
    /// POUs with code, in the order of their functions: those of the library first.
    order: Vec<PouId>,
    numbers: BTreeMap<PouId, u32>,
    imports: Vec<(&'static str, Vec<ValType>, Vec<ValType>)>,
    sites: Vec<Site>,
    site_numbers: BTreeMap<Site, i32>,
    scratch_at: u32,
    /// Initial images of temporary arrays and structures.
    data: Vec<(u32, Vec<u8>)>,
    problems: Vec<Problem>,
    /// Scratch memory of temporary arrays and structures, by variable.
    scratch: BTreeMap<crate::check::tree::VarId, u32>,
    touched: BTreeMap<PouId, hold::Touched>,
    /// How many statements a call of the POU runs at most.
    statements: BTreeMap<PouId, u64>,
    /// Variables that a reference may lead to.
    referenced: BTreeSet<VarId>,
    /// Characters of the longest STRING and WSTRING that a VAR_IN_OUT may be.
    passed_texts: [u32; 2],
    /// Constants that code reads from memory.
    constants: BTreeMap<Vec<u8>, u32>,
    /// Functions of the module's own that stand behind those of the POUs.
    behind: Vec<Behind>,
    /// POUs of the library with run-time checks.
    trapping: BTreeSet<PouId>,
    /// POINTER TO of CODESYS is used: helpers for it stand behind the others.
    pointers: bool,
    /// Variables of calls whose address is taken: they live in memory.
    addressed: BTreeSet<VarId>,
    reach: pointer_helper::Reach,
}

impl<'p> State<'p> {
    fn new(project: &'p TypedProject, plan: Plan) -> Self {
        let mut order: Vec<PouId> = (0..project.pous.len() as u32)
            .map(PouId)
            .filter(|p| plan.reachable[p.0 as usize])
            .collect();
        // Whoever calls the library has to know what can trap there.
        order.sort_by_key(|p| !project.pou(*p).library);
        let pointers = project.uses_pointers();
        // The helpers come first.
        let numbers = order
            .iter()
            .enumerate()
            .map(|(i, p)| (*p, i as u32 + helpers(pointers)))
            .collect();
        let scratch_at = plan.scratch_at;
        Self {
            project,
            plan,
            order,
            numbers,
            imports: Vec::new(),
            sites: Vec::new(),
            site_numbers: BTreeMap::new(),
            scratch_at,
            data: Vec::new(),
            problems: Vec::new(),
            scratch: BTreeMap::new(),
            touched: BTreeMap::new(),
            statements: BTreeMap::new(),
            referenced: hold::referenced(project),
            passed_texts: if pointers {
                pointer::longest_texts(project)
            } else {
                hold::passed_texts(project)
            },
            constants: BTreeMap::new(),
            behind: Vec::new(),
            trapping: BTreeSet::new(),
            pointers,
            addressed: pointer::addressed(project, pointers),
            reach: pointer_helper::Reach::default(),
        }
    }

    /// The address of the characters of a string constant.
    fn text_constant(&mut self, wide: bool, units: &[u16]) -> u32 {
        let bytes: Vec<u8> = if wide {
            units.iter().flat_map(|u| u.to_le_bytes()).collect()
        } else {
            units.iter().map(|u| *u as u8).collect()
        };
        self.data_constant(&bytes)
    }

    /// The address of a constant that code reads.
    fn data_constant(&mut self, bytes: &[u8]) -> u32 {
        if let Some(at) = self.constants.get(bytes) {
            return *at;
        }
        let at = self.allocate(bytes.len() as u64);
        self.data.push((at, bytes.to_vec()));
        self.constants.insert(bytes.to_vec(), at);
        at
    }

    /// Scratch memory that nothing else uses.
    fn allocate(&mut self, bytes: u64) -> u32 {
        let at = self.scratch_at;
        let end = round_up(u64::from(at) + bytes, 8);
        self.scratch_at = u32::try_from(end).unwrap_or(u32::MAX);
        at
    }

    fn import(&mut self, name: &'static str, params: &[ValType], results: &[ValType]) -> u32 {
        let found = self.imports.iter().position(|(n, _, _)| *n == name);
        let index = found.unwrap_or_else(|| {
            self.imports.push((name, params.to_vec(), results.to_vec()));
            self.imports.len() - 1
        });
        IMPORT_BASE + index as u32
    }

    /// Number of the function behind the POUs that `is` accepts, if there is one.
    fn find_behind(&self, is: impl Fn(&Behind) -> bool) -> Option<u32> {
        let index = self.behind.iter().position(is)?;
        Some(self.first_behind() + index as u32)
    }

    fn push_behind(&mut self, function: Behind) -> u32 {
        self.behind.push(function);
        self.first_behind() + self.behind.len() as u32 - 1
    }

    fn first_behind(&self) -> u32 {
        helpers(self.pointers) + self.order.len() as u32
    }

    /// Number of a mathematical function: our own where there is one, else the imported.
    fn real_function(&mut self, name: &'static str, params: &[ValType], result: ValType) -> u32 {
        let known = self.find_behind(|b| matches!(b, Behind::Formula(f) if f.name() == name));
        if let Some(number) = known {
            return number;
        }
        let import = self.import(name, params, &[result]);
        match math::Formula::of(name, import) {
            Some(formula) => self.push_behind(Behind::Formula(formula)),
            None => import,
        }
    }

    /// Whether a check in this POU of the library, or in one that it calls, can stop the scan.
    fn may_trap(&self, pou: PouId) -> bool {
        let calls = &self.project.pou(pou).calls;
        self.trapping.contains(&pou) || calls.iter().any(|p| self.may_trap(*p))
    }

    /// The number of a trap site. What is written out several times has one.
    fn site(&mut self, kind: SiteKind, pou: PouId, span: Span) -> i32 {
        let source = self.project.sources.get(span.source);
        let site = Site {
            kind,
            pou: self.project.pou(pou).name.clone(),
            file: source.name.clone(),
            line: source.position(span.start).line,
        };
        let next = self.site_numbers.len() as i32 + 1;
        match self.site_numbers.entry(site) {
            Entry::Occupied(known) => *known.get(),
            Entry::Vacant(new) => {
                self.sites.push(new.key().clone());
                *new.insert(next)
            }
        }
    }

    fn assemble(self, functions: &[FunctionCode], needed: u64) -> CompiledMc {
        let import_count = self.imports.len() as u32;
        let mut types = TypeSection::new();
        let mut imports = ImportSection::new();
        for (name, params, results) in &self.imports {
            imports.import(MATH_MODULE, name, EntityType::Function(types.len()));
            types
                .ty()
                .function(params.iter().copied(), results.iter().copied());
        }
        let mut function_section = FunctionSection::new();
        let mut code = CodeSection::new();
        let mut hints = BranchHints::new();
        let mut all = helper::all(import_count, self.pointers);
        if self.pointers {
            all.extend(pointer_helper::all(import_count, self.reach));
        }
        for helper in all {
            function_section.function(types.len());
            types.ty().function(helper.params, helper.results);
            code.function(&helper.code);
        }
        let mut code_map = CodeMap {
            first_function: import_count + helpers(self.pointers),
            functions: Vec::new(),
        };
        for function in functions {
            function_section.function(types.len());
            types.ty().function(
                function.params.iter().copied(),
                function.results.iter().copied(),
            );
            let (body, map, likely) = self.encode(function, import_count);
            if !likely.is_empty() {
                hints.function_hints(import_count + code.len(), likely);
            }
            code.function(&body);
            code_map.functions.push(map);
        }
        for function in &self.behind {
            function_section.function(types.len());
            let (params, results, body) = match function {
                Behind::Dispatcher(d) => (&*d.params, &*d.results, d.encode(import_count)),
                Behind::Formula(f) => (REAL_64, REAL_64, f.encode(import_count)),
            };
            types
                .ty()
                .function(params.iter().copied(), results.iter().copied());
            code.function(&body);
        }
        let mut memory = MemorySection::new();
        let pages = needed.div_ceil(PAGE_BYTES).max(1);
        memory.memory(MemoryType {
            minimum: pages,
            maximum: Some(pages),
            memory64: false,
            shared: false,
            page_size_log2: None,
        });
        let mut exports = ExportSection::new();
        let entry = self.numbers[&self.plan.entry] + import_count;
        exports.export(SCAN_EXPORT, ExportKind::Func, entry);
        exports.export(MEMORY_EXPORT, ExportKind::Memory, 0);
        let mut data = DataSection::new();
        let initial = self.plan.initial_data();
        let own = self.data.iter().map(|(at, bytes)| (*at, bytes.as_slice()));
        for (at, bytes) in initial.into_iter().chain(own) {
            for (start, run) in runs(bytes) {
                let address = ConstExpr::i32_const((at + start) as i32);
                data.active(0, &address, run.iter().copied());
            }
        }
        let mut module = Module::new();
        module.section(&types);
        if import_count > 0 {
            module.section(&imports);
        }
        module
            .section(&function_section)
            .section(&memory)
            .section(&exports)
            .section(&hints)
            .section(&code)
            .section(&data);
        let wasm = module.finish();
        let layout = self.plan.layout;
        let mut hasher = xxhash_rust::xxh3::Xxh3::new();
        hasher.update(&wasm);
        hasher.update(&layout.hash().to_le_bytes());
        CompiledMc {
            wasm,
            layout,
            sites: self.sites,
            code_map,
            logic_hash: hasher.digest(),
        }
    }

    /// Writes the instructions and notes at which byte each statement and loop stands.
    fn encode(
        &self,
        function: &FunctionCode,
        import_count: u32,
    ) -> (Function, FunctionMap, Vec<BranchHint>) {
        let mut body = Function::new_with_locals_types(function.locals.iter().copied());
        let pou = self.project.pou(function.pou);
        let mut map = FunctionMap {
            pou: pou.name.clone(),
            file: self.project.sources.get(pou.name_span.source).name.clone(),
            ..FunctionMap::default()
        };
        let line = |span: &Span| self.project.sources.position(*span).line;
        let mut offsets = Vec::with_capacity(function.code.len() + 1);
        for instruction in &function.code {
            offsets.push(body.byte_len() as u32);
            body.instruction(&linked(instruction, import_count));
        }
        offsets.push(body.byte_len() as u32);
        map.lines = function
            .marks
            .iter()
            .map(|(at, span)| (offsets[*at], line(span)))
            .collect();
        map.loops = function
            .loops
            .iter()
            .map(|(from, to, span)| (offsets[*from], offsets[*to], line(span)))
            .collect();
        if let Some((_, span)) = function.marks.first() {
            map.file
                .clone_from(&self.project.sources.get(span.source).name);
        }
        let hints = function.hints.iter().map(|(at, taken)| BranchHint {
            branch_func_offset: offsets[*at],
            branch_hint_value: u32::from(*taken),
        });
        (body, map, hints.collect())
    }
}

/// How many helpers stand before the functions of the POUs.
fn helpers(pointers: bool) -> u32 {
    helper::COUNT + if pointers { pointer_helper::COUNT } else { 0 }
}

/// The instruction with the number that the called function has in the module: imports come first.
fn linked(instruction: &Instruction<'static>, import_count: u32) -> Instruction<'static> {
    match instruction {
        Instruction::Call(n) if *n >= IMPORT_BASE => Instruction::Call(n - IMPORT_BASE),
        Instruction::Call(n) => Instruction::Call(n + import_count),
        other => other.clone(),
    }
}

/// The parts of `bytes` that are not zero; short gaps stay inside a run.
fn runs(bytes: &[u8]) -> Vec<(u32, &[u8])> {
    const GAP: usize = 16;
    let mut out = Vec::new();
    let mut at = 0;
    while let Some(skip) = bytes[at..].iter().position(|b| *b != 0) {
        let start = at + skip;
        let mut end = start + 1;
        let mut zeros = 0;
        let mut i = end;
        while i < bytes.len() && zeros < GAP {
            if bytes[i] == 0 {
                zeros += 1;
            } else {
                zeros = 0;
                end = i + 1;
            }
            i += 1;
        }
        out.push((start as u32, &bytes[start..end]));
        at = end;
    }
    out
}
