//! Random well-typed projects in Structured Text: types, functions, function blocks with methods and bases, global variables, and
//! several programs that use them. Every loop ends; most operations are guarded so that most programs do not trap.

mod block;
mod expr;
mod located;
mod scope;
mod stmt;
mod types;

use std::collections::BTreeMap;

use fam_soft_plc::types::Elem;

use crate::compare::ENTRY;
use crate::random::Random;
use crate::shrink::Piece;

/// A type of a variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ty {
    El(Elem),
    Str(bool, u32),
    Enum(usize),
    Sub(usize),
    Struct(usize),
    Array(Box<Ty>, Vec<(i64, i64)>),
    Ref(Box<Ty>),
    Block(usize),
}

#[derive(Clone, Debug)]
struct EnumDef {
    name: String,
    values: Vec<String>,
}

#[derive(Clone, Debug)]
struct SubDef {
    name: String,
    base: Elem,
    low: i128,
    high: i128,
}

#[derive(Clone, Debug)]
struct StructDef {
    name: String,
    fields: Vec<(String, Ty)>,
}

/// A function, method or function block as it is called.
#[derive(Clone, Debug, Default)]
pub struct Callable {
    name: String,
    inputs: Vec<(String, Ty)>,
    outputs: Vec<(String, Ty)>,
    in_outs: Vec<(String, Ty)>,
    result: Option<Ty>,
}

#[derive(Clone, Debug)]
struct BlockDef {
    call: Callable,
    methods: Vec<Callable>,
    base: Option<usize>,
    standard: bool,
}

/// What has been generated so far.
pub struct World {
    random: Random,
    enums: Vec<EnumDef>,
    subs: Vec<SubDef>,
    structs: Vec<StructDef>,
    functions: Vec<Callable>,
    blocks: Vec<BlockDef>,
    globals: Vec<(String, Ty)>,
    /// Whether operations that may trap are left unguarded.
    risky: bool,
    /// How often each feature was generated.
    pub features: BTreeMap<&'static str, u64>,
    names: u32,
    /// Bytes of the process image that are taken.
    image_bytes: u32,
}

/// A project: its text as a tree, the names of its programs, and what it contains.
pub struct Generated {
    pub tree: Piece,
    pub programs: Vec<String>,
    pub features: BTreeMap<&'static str, u64>,
}

/// The project of this seed with so many programs.
pub fn project(seed: u64, programs: usize) -> Generated {
    let mut world = World {
        random: Random::new(seed),
        enums: Vec::new(),
        subs: Vec::new(),
        structs: Vec::new(),
        functions: Vec::new(),
        blocks: block::standard(),
        globals: Vec::new(),
        risky: false,
        features: BTreeMap::new(),
        names: 0,
        image_bytes: 0,
    };
    let mut parts = Vec::new();
    let types = world.types();
    parts.push(Piece::block("TYPE", types, "END_TYPE"));
    let mut globals = Vec::new();
    for number in 0..6 {
        let ty = world.data_type(1);
        let name = format!("g{number}");
        globals.push(world.declaration(&name, &ty));
        world.globals.push((name, ty));
    }
    parts.push(Piece::block("VAR_GLOBAL", globals, "END_VAR"));
    for number in 0..6 {
        if number % 2 == 0 {
            parts.push(world.function(number));
        } else {
            parts.push(world.function_block(number));
        }
    }
    let mut names = Vec::new();
    let mut calls = Vec::new();
    for number in 0..programs {
        world.risky = number % 4 == 3;
        let name = format!("P{number}");
        parts.push(world.program(&name));
        calls.push(Piece::line(format!("{number}: {name}();")));
        names.push(name);
    }
    let main = Piece::block(
        format!("PROGRAM {ENTRY}"),
        vec![
            Piece::line("VAR_INPUT which : INT; END_VAR"),
            Piece::block("CASE which OF", calls, "END_CASE;"),
        ],
        "END_PROGRAM",
    );
    parts.push(main);
    Generated {
        tree: Piece {
            inner: parts,
            ..Piece::default()
        },
        programs: names,
        features: world.features,
    }
}

impl World {
    fn note(&mut self, feature: &'static str) {
        *self.features.entry(feature).or_default() += 1;
    }

    /// A name that nothing else has.
    fn fresh(&mut self, prefix: &str) -> String {
        self.names += 1;
        format!("{prefix}{}", self.names)
    }
}
