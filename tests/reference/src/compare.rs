//! Compiled and interpreted runs side by side: every variable after every scan, traps by kind and line.

use fam_soft_plc::check::tree::{PouId, VarId};
use fam_soft_plc::layout::VariableInfo;
use fam_soft_plc::types::Elem;
use fam_soft_plc::{
    Area, CheckOptions, CompileSpec, CompiledMc, Diagnostic, Engine, EngineOptions, Instance,
    Interruption, Module, SourceFile, TypeNode, TypedProject, Value, check, compile, parse_project,
};

use crate::machine::{Machine, Stop};
use crate::memory::{Memory, Node, NodeId};
use crate::random::Random;
use crate::value::{self, Scalar};

/// Wasm instructions of one scan; far more than the interpreter's limit of statements needs.
const FUEL: u64 = 40_000_000;
/// Name of the program that calls the one chosen by its input `which`.
pub const ENTRY: &str = "Main";

pub fn engine() -> Engine {
    let interruption = Interruption::Fuel(FUEL);
    // With calls inlined, as on a controller.
    Engine::with_inlining(EngineOptions { interruption }, true).expect("the engine can be set up")
}

/// A project compiled once; each of its programs is run by itself.
pub struct Built {
    pub project: TypedProject,
    pub mc: CompiledMc,
    module: Module,
    /// Variables of programs and global ones, with their scalars in the order of memory.
    roots: Vec<(VarId, Option<PouId>, Vec<VariableInfo>)>,
}

/// The typed tree.
pub fn checked(text: &str) -> Result<TypedProject, Vec<Diagnostic>> {
    let (parsed, problems) = parse_project(&[SourceFile::new("random.st", text)]);
    if !problems.is_empty() {
        return Err(problems);
    }
    check(&parsed, CheckOptions::default())
}

/// Checks, compiles, prepares.
pub fn build(engine: &Engine, text: &str) -> Result<Built, Vec<Diagnostic>> {
    let project = checked(text)?;
    let spec = CompileSpec {
        entry: ENTRY.to_owned(),
        ..CompileSpec::default()
    };
    let mc = compile(&project, &spec)?;
    let module = engine.prepare(&mc).expect("compiled code is valid");
    let mut roots = Vec::new();
    for root in &mc.layout.roots {
        let (owner, var) = match root.path.split_once('.') {
            Some((program, name)) => (project.find_pou(program), name),
            None => (None, root.path.as_str()),
        };
        let found = match owner {
            Some(pou) => {
                let mut vars = project.pou(pou).vars.iter().copied();
                vars.find(|v| project.var(*v).name.eq_ignore_ascii_case(var))
            }
            None => project.find_global(var),
        };
        if let Some(id) = found {
            roots.push((id, owner, mc.layout.leaves(root)));
        }
    }
    Ok(Built {
        project,
        mc,
        module,
        roots,
    })
}

impl Built {
    pub fn instance(&self, engine: &Engine) -> Instance {
        Instance::new(engine, &self.module).expect("an instance")
    }
}

#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// Scans that agreed, and whether the last one ended in a trap (in both).
    Agreed {
        scans: u32,
        trapped: bool,
    },
    /// The interpreter gave up: nothing was compared.
    Skipped,
    Different(String),
}

/// Runs one program of the project `scans` times with random inputs.
pub fn run(
    engine: &Engine,
    built: &Built,
    program: &str,
    number: i64,
    seed: u64,
    scans: u32,
) -> Outcome {
    let Some(pou) = built.project.find_pou(program) else {
        // A project that was made smaller may have lost it.
        return Outcome::Skipped;
    };
    let mut random = Random::new(seed);
    let mut instance = built.instance(engine);
    let mut machine = Machine::new(&built.project);
    let which = format!("{ENTRY}.which");
    if instance.write(&which, Value::Int(number)).is_err() {
        // A project that was made smaller may have lost its selector.
        return Outcome::Skipped;
    }
    let mut time_ns = 0;
    let mine: Vec<_> = built
        .roots
        .iter()
        .filter(|(_, owner, _)| owner.is_none() || *owner == Some(pou))
        .collect();
    if let Some(text) = difference(built, &instance, &machine, &mine) {
        return Outcome::Different(format!("{program}, initial values: {text}"));
    }
    for scan in 1..=scans {
        give_inputs(built, pou, &mut instance, &mut machine, &mut random);
        let told = machine.scan(pou, time_ns);
        if matches!(told, Err(Stop::TooLong | Stop::Unknown(_))) {
            return match told {
                Err(Stop::Unknown(what)) => {
                    Outcome::Different(format!("the interpreter does not know {what}"))
                }
                _ => Outcome::Skipped,
            };
        }
        let ran = instance.scan(time_ns, 2);
        match (&ran, &told) {
            (Ok(()), Ok(())) => {}
            (Err(trap), Err(Stop::Trap { kind, line }))
                if trap.kind == *kind && trap.line == *line =>
            {
                return Outcome::Agreed {
                    scans: scan,
                    trapped: true,
                };
            }
            _ => {
                let ran = ran.map_err(|t| t.to_string());
                return Outcome::Different(format!(
                    "{program}, scan {scan}: the program ran to {ran:?}, the interpreter to {told:?}"
                ));
            }
        }
        if let Some(text) = difference(built, &instance, &machine, &mine) {
            return Outcome::Different(format!("{program}, after scan {scan}: {text}"));
        }
        time_ns += [1_000_000, 10_000_000, 250_000_000][random.below(3)];
    }
    Outcome::Agreed {
        scans,
        trapped: false,
    }
}

/// Random values for the inputs of the program.
fn give_inputs(
    built: &Built,
    pou: PouId,
    instance: &mut Instance,
    machine: &mut Machine<'_>,
    random: &mut Random,
) {
    let inputs = built.roots.iter().filter(|(id, owner, _)| {
        let section = built.project.var(*id).section;
        *owner == Some(pou) && section == fam_soft_plc::syntax::ast::VarSection::Input
    });
    for (id, _, leaves) in inputs {
        let (Some(node), [leaf]) = (machine.fixed(*id), leaves.as_slice()) else {
            continue;
        };
        match &*leaf.ty {
            TypeNode::Elem(elem) => {
                let value = edge_value(*elem, random);
                machine.memory.set(node, value);
                let value = match value.kept() {
                    Scalar::Real(v) => Value::Real(v),
                    Scalar::Lreal(v) => Value::Lreal(v),
                    other => Value::from_i128(*elem, other.int()),
                };
                instance
                    .write_variable(leaf, value)
                    .expect("the input can be written");
            }
            TypeNode::Text { .. } => {
                let text =
                    *random.one(&["", "a", "abc", "hello world", "12", "-7", "ABCABC", "xyz "]);
                instance.write_text(leaf, text);
                machine.memory.set_text(node, crate::text::units(text));
            }
            _ => {}
        }
    }
}

fn edge_value(elem: Elem, random: &mut Random) -> Scalar {
    match elem {
        Elem::Real => Scalar::Real(*random.one(&[
            0.0,
            -0.0,
            1.0,
            1.5,
            2.5,
            -2.5,
            3.0e38,
            1.0e-40,
            127.5,
            1e10,
            f32::INFINITY,
            f32::NAN,
            -1e6,
            0.1,
        ])),
        Elem::Lreal => Scalar::Lreal(*random.one(&[
            0.0,
            -0.0,
            1.0,
            1.5,
            2.5,
            -0.5,
            1.0e308,
            1.0e-310,
            255.5,
            -1.0e10,
            f64::NAN,
            f64::NEG_INFINITY,
            1e18,
            0.1,
        ])),
        elem => {
            let (low, high) = value::limits(elem);
            let small = (random.within(-20, 20) as i128).clamp(low, high);
            // Within the years that dates have.
            let span = if matches!(elem, Elem::Date | Elem::Tod | Elem::Dt) {
                86_400_000_000_000
            } else {
                1
            };
            let v = *random.one(&[low, high, 0, 1, small, small, low + 1, high / 2]);
            Scalar::Int(if span == 1 {
                v
            } else {
                (random.within(-1, 20_000) as i128) * span / 7 * i128::from(elem != Elem::Date)
            })
        }
    }
}

type Roots<'a> = Vec<&'a (VarId, Option<PouId>, Vec<VariableInfo>)>;

/// The first variable that differs.
fn difference(
    built: &Built,
    instance: &Instance,
    machine: &Machine<'_>,
    roots: &Roots<'_>,
) -> Option<String> {
    for (id, _, leaves) in roots {
        let mut nodes = Vec::with_capacity(leaves.len());
        let node = machine.fixed(*id)?;
        flatten(built, &machine.memory, node, &mut nodes);
        if nodes.len() != leaves.len() {
            return Some(format!(
                "{} has {} parts and {}",
                built.project.var(*id).name,
                leaves.len(),
                nodes.len()
            ));
        }
        for (leaf, node) in leaves.iter().zip(&nodes) {
            let Some(node) = node else { continue };
            if let Some(text) = compare(instance, &machine.memory, leaf, *node) {
                return Some(text);
            }
        }
    }
    None
}

/// Scalars and strings in the order of memory; `None` for the hidden variable that tells what an instance is of.
fn flatten(built: &Built, memory: &Memory<'_>, at: NodeId, out: &mut Vec<Option<NodeId>>) {
    match memory.node(at) {
        Node::Scalar(..) | Node::Text(..) => out.push(Some(at)),
        Node::List(list) => list.iter().for_each(|n| flatten(built, memory, *n, out)),
        Node::Instance(pou, list) => {
            let unit = built.project.pou(*pou);
            let hidden = unit.tag.and_then(|tag| memory.member(at, tag));
            for node in list {
                if Some(*node) == hidden {
                    out.push(None);
                } else {
                    flatten(built, memory, *node, out);
                }
            }
        }
    }
}

fn compare(
    instance: &Instance,
    memory: &Memory<'_>,
    leaf: &VariableInfo,
    node: NodeId,
) -> Option<String> {
    let found = match memory.node(node) {
        Node::Text(_, units) => {
            let told = String::from_utf16_lossy(units);
            let ran = instance.read_text(leaf)?;
            if !rest_is_clear(instance, leaf) {
                return Some(format!("{}: bytes behind the string are not 0", leaf.path));
            }
            (ran != told).then(|| (format!("'{ran}'"), format!("'{told}'")))
        }
        Node::Scalar(_, told) => {
            let ran = instance.read_variable(leaf)?;
            let same = match (ran, *told) {
                (Value::Real(a), Scalar::Real(b)) => a.to_bits() == b.to_bits(),
                (Value::Lreal(a), Scalar::Lreal(b)) => a.to_bits() == b.to_bits(),
                (Value::Ref(a), Scalar::Ref(b)) => (a == 0) == b.is_none(),
                (a, b) => a.as_i128() == Some(b.int()),
            };
            (!same).then(|| (ran.to_string(), format!("{told:?}")))
        }
        _ => None,
    };
    found.map(|(ran, told)| {
        format!(
            "{} is {ran} in the program and {told} in the interpreter",
            leaf.path
        )
    })
}

/// Equal strings have equal bytes.
fn rest_is_clear(instance: &Instance, leaf: &VariableInfo) -> bool {
    let (TypeNode::Text { wide, .. }, Area::Region(index)) = (&*leaf.ty, leaf.area) else {
        return true;
    };
    let at = leaf.offset as usize;
    let bytes = &instance.region(index)[at..at + leaf.len as usize];
    let mut count = [0; 4];
    count.copy_from_slice(&bytes[..4]);
    let used = u32::from_le_bytes(count) as usize * if *wide { 2 } else { 1 };
    bytes
        .get(4 + used..)
        .is_some_and(|rest| rest.iter().all(|b| *b == 0))
}
