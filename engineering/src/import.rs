//! From the logic of an existing PLC project to a proposal of mechatronic components: one for each program instance.
//!
//! Each gets what its program needs of the project: POUs, types and global variables. Its inputs and outputs are its located
//! variables, and what one program writes and others read is exported to them. What the engineer has to decide stands in a list:
//! fail-safe values, critical intervals, and what the programs share today but cannot share as MCs.

use crate::caex::{FAM_LIBRARY, FAM_LIBRARY_FILE};
use crate::convert::model_text;
use crate::import_exchange::{Exchange, exchanges, placed};
use crate::import_tables::{PlacedMc, ProposedController, name_of, tables};
use crate::plcopen::logic_file::{Selection, write};
use crate::problem::{Explain, Problems, file_error};
use fam_soft_plc::check::tree::{
    Place, PouId, Root, TypedProject, VarId, visit_places, visit_writes,
};
use fam_soft_plc::check::{CheckOptions, check};
use fam_soft_plc::diag::{Diagnostic, Severity};
use fam_soft_plc::image::scalars;
use fam_soft_plc::instances::own_programs;
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use fam_soft_plc::syntax::ast::{Pou, PouKind, Project, VarBlock, VarSection};
use fam_soft_plc::types::{Elem, TypeId};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use toml::Spanned;

/// What was found in a PLC project.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Proposal {
    /// A mechatronic component for each program instance.
    pub mcs: Vec<ProposedMc>,
    /// What the engineer has to decide, one sentence each.
    pub to_do: Vec<String>,
}

/// A proposed mechatronic component.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposedMc {
    /// Name: that of the program instance.
    pub name: String,
    /// Its main PROGRAM.
    pub program: String,
    /// Interval of its task.
    pub cycle_ms: Option<f64>,
    /// What it reads.
    pub inputs: Vec<ProposedInput>,
    /// What it writes.
    pub outputs: Vec<ProposedOutput>,
    /// Its logic as PLCopen XML.
    pub logic: String,
}

/// An input of a proposed MC.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProposedInput {
    /// Variable.
    pub name: String,
    /// The MC that exports it, and its variable; `None` for a point of the field.
    pub from: Option<(String, String)>,
    /// Its address in the PLC project; nothing for what other MCs export.
    pub address: String,
}

/// An output of a proposed MC.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposedOutput {
    /// Variable.
    pub name: String,
    /// The value that a variable of its type has by itself.
    pub idle: toml::Value,
    /// Whether it goes to the field.
    pub field: bool,
    /// Its address in the PLC project; nothing for what goes to other MCs alone.
    pub address: String,
    /// Whether other MCs read it.
    pub export: bool,
}

/// Reads a project and proposes.
///
/// # Errors
/// What the compiler finds wrong with the project.
pub fn propose(sources: &[SourceFile]) -> Result<Proposal, Vec<Diagnostic>> {
    let (mut project, found) = parse_project(sources);
    if found.iter().any(|d| d.severity == Severity::Error) {
        return Err(found);
    }
    if project
        .configurations
        .iter()
        .any(|c| !c.configured.is_empty())
    {
        // Instances of one program may differ.
        own_programs(&mut project);
    }
    let typed = check(&project, CheckOptions::default())?;
    let mut proposal = Proposal::default();
    let mut parts = Vec::new();
    for (name, program, cycle_ms) in instances(&project, &typed) {
        let Some(pou) = typed.find_pou(&program) else {
            proposal.to_do.push(format!(
                "the instance {name} is of the PROGRAM {program}, which the project does not contain"
            ));
            continue;
        };
        let pous = reached(&project, &typed, pou);
        parts.push(Part {
            name,
            program: typed.pou(pou).name.clone(),
            cycle_ms,
            globals: used_globals(&project, &typed, &pous),
            written: written_globals(&typed, &pous),
            pous,
        });
    }
    let exchanges = exchanges(&typed, &parts);
    for index in 0..parts.len() {
        let own = exchanges.iter().filter(|e| e.users().any(|u| u == index));
        let own: Vec<&Exchange> = own.collect();
        let proposed = mc(&project, &typed, sources, &parts, index, &own);
        proposal.mcs.push(proposed);
    }
    to_do(&typed, &parts, &exchanges, &mut proposal);
    connected(&project, &mut proposal);
    Ok(proposal)
}

/// What the configuration connects with program instances, and nobody does for an MC.
fn connected(project: &Project, proposal: &mut Proposal) {
    let resources = project.configurations.iter().flat_map(|c| &c.resources);
    for instance in resources.flat_map(|r| &r.instances) {
        for connection in &instance.connections {
            let (sign, name) = (if connection.output { "=>" } else { ":=" }, &instance.name);
            let (own, other) = (&connection.parameter, &connection.value);
            proposal.to_do.push(format!(
                "{name}: the configuration connects `{own} {sign} {other}`, which an MC does not know: write it as an assignment in the program"
            ));
        }
    }
}

/// A program instance, and what it needs of the project.
pub(crate) struct Part {
    pub name: String,
    program: String,
    cycle_ms: Option<f64>,
    pub pous: BTreeSet<PouId>,
    pub globals: BTreeSet<VarId>,
    pub written: BTreeSet<VarId>,
}

/// A whole model from the files of a PLC project: an AutomationML file named `file_name`, the logic of each proposed MC, the
/// list of what is to be decided as `TODO.md`.
///
/// # Errors
/// What the compiler finds wrong with the project, or that it has no PROGRAM.
pub fn model(
    sources: &[SourceFile],
    file_name: &str,
) -> Result<BTreeMap<String, String>, Problems> {
    let proposal = propose(sources).map_err(|list| Problems { list })?;
    if proposal.mcs.is_empty() {
        let name = sources.first().map_or("", |s| s.name.as_str());
        let problem = file_error(
            "M210",
            Path::new(name),
            "the project has no PROGRAM".to_owned(),
        );
        return Err(Problems::one(problem.hint(
            "only programs can be run; call its function blocks from one",
        )));
    }
    let stem = file_name.split('.').next().unwrap_or("cell");
    let controllers: Vec<ProposedController> = (1..=2)
        .map(|n| ProposedController {
            name: format!("controller{n}"),
            description: String::new(),
            at: 0..0,
        })
        .collect();
    let mut files = BTreeMap::new();
    let mut in_files = Vec::new();
    for mc in proposal.mcs {
        let file = format!("logic/{}.xml", name_of(&mc.name));
        files.insert(file.clone(), mc.logic.clone());
        in_files.push(PlacedMc { mc, at: 0..0, file });
    }
    let cell = Spanned::new(0..0, name_of(stem));
    let tables = tables(cell, &controllers, &in_files);
    let text = model_text(&tables, &files, file_name, None);
    let mut list = String::from(
        "# To do\n\nWhat the import could not know. `fam check` tells what is wrong after each change.\n\n",
    );
    for sentence in &proposal.to_do {
        list.push_str(&format!("- [ ] {sentence}\n"));
    }
    files.insert("TODO.md".to_owned(), list);
    files.insert(FAM_LIBRARY_FILE.to_owned(), FAM_LIBRARY.to_owned());
    files.insert(file_name.to_owned(), text);
    Ok(files)
}

/// Program instances with their cycles; every PROGRAM that no other one calls, if the project has none.
fn instances(project: &Project, typed: &TypedProject) -> Vec<(String, String, Option<f64>)> {
    let mut list = Vec::new();
    let mut names = BTreeSet::new();
    for resource in project.configurations.iter().flat_map(|c| &c.resources) {
        for instance in &resource.instances {
            let task = resource
                .tasks
                .iter()
                .find(|t| Some(&t.name) == instance.task.as_ref());
            #[allow(clippy::cast_precision_loss)] // intervals are far below 2^53 ns
            let cycle_ms = task
                .and_then(|t| t.interval_ns)
                .filter(|ns| *ns > 0)
                .map(|ns| ns as f64 / 1e6);
            let mut name = instance.name.clone();
            while !names.insert(name.to_ascii_uppercase()) {
                name.push_str("_2");
            }
            list.push((name, instance.program.clone(), cycle_ms));
        }
    }
    if list.is_empty() {
        let called: BTreeSet<PouId> = typed
            .pous
            .iter()
            .flat_map(|p| p.calls.iter().copied())
            .collect();
        for program in typed.programs() {
            if typed
                .find_pou(program)
                .is_some_and(|p| !called.contains(&p))
            {
                list.push((program.to_owned(), program.to_owned(), None));
            }
        }
    }
    list
}

/// The POUs that a program needs: what it calls, and the function blocks and functions that are named in them.
fn reached(project: &Project, typed: &TypedProject, main: PouId) -> BTreeSet<PouId> {
    let mut reached = BTreeSet::from([main]);
    let mut todo = vec![main];
    while let Some(pou) = todo.pop() {
        let of = typed.pou(pou);
        let mut next: Vec<PouId> = of.calls.iter().copied().collect();
        next.extend(of.methods.iter().map(|(_, method)| *method));
        next.extend(of.extends.into_iter().chain(of.instance_of));
        // An instance that is declared and never called has a type all the same.
        for decl in project
            .pous
            .iter()
            .filter(|p| p.name.name.eq_ignore_ascii_case(&of.name))
            .flat_map(blocks)
            .flat_map(|b| &b.decls)
        {
            let text = project.sources.slice(decl.spec.span);
            next.extend(words(text).filter_map(|w| typed.find_pou(w)));
            if let fam_soft_plc::syntax::ast::TypeSpecKind::Named(name) = &decl.spec.kind {
                next.extend(typed.find_pou(&name.name));
            }
        }
        todo.extend(next.into_iter().filter(|p| {
            let is_other_program =
                typed.pou(*p).kind == PouKind::Program && !typed.pou(pou).calls.contains(p);
            !is_other_program && reached.insert(*p)
        }));
    }
    reached
}

/// The declarations of a POU and of its methods.
fn blocks(pou: &Pou) -> impl Iterator<Item = &VarBlock> {
    let methods = pou.class.methods.iter();
    pou.vars.iter().chain(methods.flat_map(|m| &m.vars))
}

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
        .filter(|w| !w.is_empty())
}

/// Global variables that some POUs read, write or declare VAR_EXTERNAL.
fn used_globals(
    project: &Project,
    typed: &TypedProject,
    pous: &BTreeSet<PouId>,
) -> BTreeSet<VarId> {
    let mut used = BTreeSet::new();
    for pou in pous {
        visit_places(&typed.pou(*pou).body, &mut |place| {
            used.extend(global(typed, place));
        });
    }
    let is_one = |name: &str| {
        pous.iter()
            .any(|p| typed.pou(*p).name.eq_ignore_ascii_case(name))
    };
    let pous = project.pous.iter().filter(|p| is_one(&p.name.name));
    let declared = pous
        .flat_map(blocks)
        .filter(|b| b.section == VarSection::External)
        .flat_map(|b| &b.decls);
    used.extend(declared.filter_map(|d| typed.find_global(&d.name.name)));
    used
}

fn written_globals(typed: &TypedProject, pous: &BTreeSet<PouId>) -> BTreeSet<VarId> {
    let mut written = BTreeSet::new();
    for pou in pous {
        visit_writes(&typed.pou(*pou).body, &mut |place, _| {
            written.extend(global(typed, place));
        });
    }
    written
}

fn global(typed: &TypedProject, place: &Place) -> Option<VarId> {
    match &place.root {
        Root::Var(id) if typed.var(*id).owner.is_none() => Some(*id),
        _ => None,
    }
}

fn mc(
    project: &Project,
    typed: &TypedProject,
    sources: &[SourceFile],
    parts: &[Part],
    index: usize,
    exchanges: &[&Exchange],
) -> ProposedMc {
    let part = &parts[index];
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    let inner = part.pous.iter().flat_map(|p| typed.pou(*p).vars.iter());
    for id in part.globals.iter().chain(inner) {
        if exchanges.iter().any(|e| e.var == *id) {
            continue;
        }
        for scalar in scalars(typed, typed.var(*id)) {
            if scalar.location.output {
                outputs.push(ProposedOutput {
                    name: scalar.path,
                    idle: idle_value(typed, scalar.ty),
                    field: true,
                    address: scalar.location.to_string(),
                    export: false,
                });
            } else {
                inputs.push(ProposedInput {
                    name: scalar.path,
                    from: None,
                    address: scalar.location.to_string(),
                });
            }
        }
    }
    for exchange in exchanges {
        let var = typed.var(exchange.var);
        if exchange.from == index {
            outputs.push(ProposedOutput {
                name: var.name.clone(),
                idle: idle_value(typed, var.ty),
                field: var.location.is_some_and(|l| !l.memory),
                address: var.location.map(|l| l.to_string()).unwrap_or_default(),
                export: true,
            });
        } else {
            inputs.push(ProposedInput {
                name: var.name.clone(),
                from: Some((parts[exchange.from].name.clone(), var.name.clone())),
                address: String::new(),
            });
        }
    }
    // Constants that other declarations are made of are needed without being used in any body.
    let constants = typed.globals.iter().filter(|g| typed.var(**g).constant);
    let selection = Selection {
        pous: part
            .pous
            .iter()
            .map(|p| typed.pou(*p).name.to_ascii_uppercase())
            .collect(),
        globals: part
            .globals
            .iter()
            .chain(constants)
            .map(|g| typed.var(*g).name.to_ascii_uppercase())
            .collect(),
    };
    let placed = placed(project, typed, part, index, exchanges);
    ProposedMc {
        logic: write(&part.name, &placed, sources, Some(&selection)),
        program: part.program.clone(),
        name: part.name.clone(),
        cycle_ms: part.cycle_ms,
        inputs,
        outputs,
    }
}

/// FALSE, 0, or the first value of an enumeration: what the engineer has to look at.
fn idle_value(typed: &TypedProject, ty: TypeId) -> toml::Value {
    if let fam_soft_plc::types::TypeKind::Enum { values, .. } = typed.types.kind(ty)
        && let Some((name, _)) = values.first()
    {
        return toml::Value::String(name.clone());
    }
    match typed.types.elem(ty) {
        Some(Elem::Bool) => toml::Value::Boolean(false),
        Some(Elem::Real | Elem::Lreal) => toml::Value::Float(0.0),
        Some(elem @ (Elem::Time | Elem::Date | Elem::Tod | Elem::Dt)) => {
            toml::Value::String(fam_soft_plc::Value::zero(elem).to_string())
        }
        Some(Elem::Char) => toml::Value::String("'$00'".to_owned()),
        Some(Elem::Wchar) => toml::Value::String("\"$0000\"".to_owned()),
        _ => toml::Value::Integer(0),
    }
}

fn to_do(typed: &TypedProject, parts: &[Part], exchanges: &[Exchange], proposal: &mut Proposal) {
    let names = |which: &mut dyn Iterator<Item = usize>| -> String {
        let names: Vec<&str> = which.map(|w| parts[w].name.as_str()).collect();
        names.join(", ")
    };
    let mut exported: BTreeMap<(usize, &[usize]), Vec<&str>> = BTreeMap::new();
    for exchange in exchanges {
        let list = exported.entry((exchange.from, &exchange.to)).or_default();
        list.push(&typed.var(exchange.var).name);
    }
    for ((from, to), variables) in exported {
        proposal.to_do.push(format!(
            "{} exports {} to {}: what it writes is seen there a cycle later; look whether the programs stand that",
            parts[from].name,
            variables.join(", "),
            names(&mut to.iter().copied()),
        ));
    }
    for id in &typed.globals {
        let var = typed.var(*id);
        let which = |of: fn(&Part) -> &BTreeSet<VarId>| {
            (0..parts.len()).filter(move |p| of(&parts[*p]).contains(id))
        };
        let is_settled = exchanges.iter().any(|e| e.var == *id);
        if is_settled || var.constant || which(|p| &p.globals).count() < 2 {
            continue;
        }
        let name = &var.name;
        let users = names(&mut which(|p| &p.globals));
        let writers = names(&mut which(|p| &p.written));
        proposal.to_do.push(match var.location {
            Some(location) if location.output => format!(
                "the output {name} is used by {users} and written by {writers}: let one of them drive it, and export to it what the others want"
            ),
            Some(_) => continue,
            None => format!(
                "the global variable {name} is used by {users}: MCs share no memory, so that each has its own now; let one of them export it and the others read it as an input"
            ),
        });
    }
    for mc in &proposal.mcs {
        let name = &mc.name;
        if !mc.outputs.is_empty() {
            proposal.to_do.push(format!(
                "{name}: look at the fail-safe value of each output; they are FALSE and 0 now"
            ));
        }
        proposal.to_do.push(format!(
            "{name}: give it its critical intervals, each with a recovery action; it has none now, so that every interruption is gone on from directly"
        ));
        proposal.to_do.push(format!(
            "{name}: write a stop POU (FUNCTION_BLOCK with `end : BOOL`), and give the worst-case time of a scan, which is a guess now"
        ));
        if mc.cycle_ms.is_none() {
            proposal.to_do.push(format!(
                "{name}: the project gives it no cycle; it has the tick's now"
            ));
        }
    }
}
