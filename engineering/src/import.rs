//! From the logic of an existing PLC project to a proposal of mechatronic components: one for each program instance.
//!
//! Each gets what its program needs of the project: POUs, types and global variables. Its inputs and outputs are its located
//! variables. What the engineer has to decide stands in a list: fail-safe values, critical intervals, and what the
//! programs share today but cannot share as MCs.

use crate::caex::{FAM_LIBRARY, FAM_LIBRARY_FILE};
use crate::convert::model_text;
use crate::import_tables::{PlacedMc, ProposedController, name_of, tables};
use crate::plcopen::logic_file::{Selection, write};
use crate::problem::{Explain, Problems, file_error};
use fam_soft_plc::check::tree::{PouId, Root, TypedProject, VarId, visit_places};
use fam_soft_plc::check::{CheckOptions, check};
use fam_soft_plc::diag::{Diagnostic, Severity};
use fam_soft_plc::image::scalars;
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use fam_soft_plc::syntax::ast::{PouKind, Project};
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
    /// Located input variables.
    pub inputs: Vec<String>,
    /// Located output variables, with the value that a variable of its type has by itself.
    pub outputs: Vec<(String, toml::Value)>,
    /// Its logic as PLCopen XML.
    pub logic: String,
}

/// Reads a project and proposes.
///
/// # Errors
/// What the compiler finds wrong with the project.
pub fn propose(sources: &[SourceFile]) -> Result<Proposal, Vec<Diagnostic>> {
    let (project, found) = parse_project(sources);
    if found.iter().any(|d| d.severity == Severity::Error) {
        return Err(found);
    }
    let typed = check(&project, CheckOptions::default())?;
    let instances = instances(&project, &typed);
    let mut proposal = Proposal::default();
    let mut users: BTreeMap<VarId, Vec<String>> = BTreeMap::new();
    for (name, program, cycle_ms) in instances {
        let Some(pou) = typed.find_pou(&program) else {
            proposal.to_do.push(format!(
                "the instance {name} is of the PROGRAM {program}, which the project does not contain"
            ));
            continue;
        };
        let pous = reached(&project, &typed, pou);
        let globals = used_globals(&typed, &pous);
        for global in &globals {
            users.entry(*global).or_default().push(name.clone());
        }
        proposal.mcs.push(mc(
            &project, &typed, sources, name, &program, cycle_ms, &pous, &globals,
        ));
    }
    to_do(&typed, &users, &mut proposal);
    Ok(proposal)
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
    let mut placed = Vec::new();
    for mc in proposal.mcs {
        let file = format!("logic/{}.xml", name_of(&mc.name));
        files.insert(file.clone(), mc.logic.clone());
        placed.push(PlacedMc { mc, at: 0..0, file });
    }
    let cell = Spanned::new(0..0, name_of(stem));
    let tables = tables(cell, &controllers, &placed);
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
        let mut next: Vec<PouId> = typed.pou(pou).calls.iter().copied().collect();
        // An instance that is declared and never called has a type all the same.
        for decl in project
            .pous
            .iter()
            .filter(|p| p.name.name.eq_ignore_ascii_case(&typed.pou(pou).name))
            .flat_map(|p| &p.vars)
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

fn words(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
        .filter(|w| !w.is_empty())
}

/// Global variables that some POUs read, write or declare VAR_EXTERNAL.
fn used_globals(typed: &TypedProject, pous: &BTreeSet<PouId>) -> BTreeSet<VarId> {
    let mut used = BTreeSet::new();
    for pou in pous {
        visit_places(&typed.pou(*pou).body, &mut |place| {
            if let Root::Var(id) = &place.root
                && typed.var(*id).owner.is_none()
            {
                used.insert(*id);
            }
        });
        for var in &typed.pou(*pou).vars {
            let var = typed.var(*var);
            if var.section == fam_soft_plc::syntax::ast::VarSection::External {
                used.extend(typed.find_global(&var.name));
            }
        }
    }
    used
}

#[allow(clippy::too_many_arguments)] // all that was worked out of the project for one program
fn mc(
    project: &Project,
    typed: &TypedProject,
    sources: &[SourceFile],
    name: String,
    program: &str,
    cycle_ms: Option<f64>,
    pous: &BTreeSet<PouId>,
    globals: &BTreeSet<VarId>,
) -> ProposedMc {
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    let inner = pous.iter().flat_map(|p| typed.pou(*p).vars.iter().copied());
    for id in globals.iter().copied().chain(inner) {
        let var = typed.var(id);
        for scalar in scalars(typed, var) {
            if scalar.location.output {
                outputs.push((scalar.path, idle_value(typed, scalar.ty)));
            } else {
                inputs.push(scalar.path);
            }
        }
    }
    // Constants that other declarations are made of are needed without being used in any body.
    let constants = typed.globals.iter().filter(|g| typed.var(**g).constant);
    let selection = Selection {
        pous: pous
            .iter()
            .map(|p| typed.pou(*p).name.to_ascii_uppercase())
            .collect(),
        globals: globals
            .iter()
            .chain(constants)
            .map(|g| typed.var(*g).name.to_ascii_uppercase())
            .collect(),
    };
    ProposedMc {
        logic: write(&name, project, sources, Some(&selection)),
        program: typed
            .find_pou(program)
            .map_or(program.to_owned(), |p| typed.pou(p).name.clone()),
        name,
        cycle_ms,
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

fn to_do(typed: &TypedProject, users: &BTreeMap<VarId, Vec<String>>, proposal: &mut Proposal) {
    for (id, mcs) in users.iter().filter(|(_, mcs)| mcs.len() > 1) {
        let var = typed.var(*id);
        let list = mcs.join(", ");
        let name = &var.name;
        if var.constant {
            continue;
        }
        proposal.to_do.push(match var.location {
            Some(location) if location.output => format!(
                "the output {name} is written by {list}: let one of them drive it, and export to it what the others want"
            ),
            Some(_) => continue,
            None => format!(
                "the global variable {name} is used by {list}: MCs share no memory, so that each has its own now; let one of them export it and the others read it as an input"
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
