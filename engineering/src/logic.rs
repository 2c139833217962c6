//! The logic of one MC: read, checked by the compiler, and held against what the model says of it.

use crate::files::ModelFiles;
use crate::generate::{Names, Target};
use crate::model::{Cell, McSpec};
use crate::problem::{Explain, suggestion};
use fam_soft_plc::check::lint::may_be_written;
use fam_soft_plc::check::tree::{PouId, Root, TypedProject, VarId, visit_places};
use fam_soft_plc::check::{CheckOptions, check};
use fam_soft_plc::diag::{Diagnostic, Severity};
use fam_soft_plc::plain::plain;
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use fam_soft_plc::syntax::ast::{PouKind, VarSection};
use fam_soft_plc::types::Elem;
use std::collections::BTreeSet;
use std::ops::Range;
use toml::Spanned;

/// The logic as the engineer wrote it, without generated POUs.
pub struct Logic {
    /// Files in the order of the model; with charts written out, these in a source of their own behind them.
    pub sources: Vec<SourceFile>,
    /// Typed tree.
    pub typed: TypedProject,
    /// Main PROGRAM, then the programs that it calls: all that belongs to the state.
    pub programs: Vec<String>,
    /// Global variables that belong to the state.
    pub state_globals: Vec<VarId>,
}

/// Reads and checks; for other compilers than FAM's own with charts as plain statements. `None` if the compiler refuses it; other problems leave the logic usable for further checks.
pub fn load(
    cell: &Cell,
    mc: &McSpec,
    files: &ModelFiles,
    target: Target,
    problems: &mut Vec<Diagnostic>,
) -> Option<Logic> {
    if mc.logic.is_empty() {
        return None; // reported with the model
    }
    let mut sources = read_files(cell, mc, files, problems)?;
    let (project, found) = parse_project(&sources);
    let failed = found.iter().any(|d| d.severity == Severity::Error);
    problems.extend(found);
    if failed {
        return None;
    }
    let mut typed = match check(project, CheckOptions::default()) {
        Ok(typed) => typed,
        Err(found) => {
            problems.extend(found);
            return None;
        }
    };
    problems.extend(typed.warnings.iter().cloned());
    // In the order in which the engineer declared them, whatever becomes of the charts: their places in the state depend on it.
    let programs = programs(cell, mc, &typed, problems)?;
    if target == Target::Portable
        && let Some(plain) = plain(&typed.syntax, &typed, &sources)
    {
        sources = plain;
        let (read, found) = parse_project(&sources);
        if found.iter().any(|d| d.severity == Severity::Error) {
            problems.extend(found);
            return None;
        }
        typed = match check(read, CheckOptions::default()) {
            Ok(typed) => typed,
            Err(found) => {
                problems.extend(found);
                return None;
            }
        };
    }
    // The logic keeps to the standard; conditions and checkpoint states may name what is internal to instances.
    typed.options.allow_internal_access = true;
    reserved_names(cell, mc, &typed, problems);
    actions(cell, mc, &typed, problems);
    let state_globals = typed
        .globals
        .iter()
        .copied()
        .filter(|id| {
            let var = typed.var(*id);
            var.location.is_none() && !var.constant
        })
        .collect();
    Some(Logic {
        sources,
        typed,
        programs,
        state_globals,
    })
}

fn read_files(
    cell: &Cell,
    mc: &McSpec,
    files: &ModelFiles,
    problems: &mut Vec<Diagnostic>,
) -> Option<Vec<SourceFile>> {
    let mut sources = Vec::new();
    let mut complete = true;
    for file in &mc.logic {
        match files.read(file.get_ref()) {
            Ok(text) => sources.push(SourceFile::new(file.get_ref().clone(), text)),
            Err(e) => {
                complete = false;
                problems.push(
                    cell.text
                        .error("M209", file.span(), format!("MC {}: {e}", mc.mc))
                        .expected("a file with ST or PLCopen XML, relative to the model")
                        .hint(e.hint()),
                );
            }
        }
    }
    complete.then_some(sources)
}

/// The main PROGRAM and those that it calls, directly or not.
fn programs(
    cell: &Cell,
    mc: &McSpec,
    typed: &TypedProject,
    problems: &mut Vec<Diagnostic>,
) -> Option<Vec<String>> {
    let name = mc.program.get_ref();
    let all: Vec<&str> = typed.programs().collect();
    let main = typed
        .find_pou(name)
        .filter(|p| typed.pou(*p).kind == PouKind::Program);
    let Some(main) = main else {
        let message = format!("MC {}: its logic has no PROGRAM `{name}`", mc.mc);
        problems.push(cell.text.error("M210", mc.program.span(), message).hint(
            if all.is_empty() {
                "write one, or add the file that has it to the MC's logic".to_owned()
            } else {
                format!(
                    "{}; say with `program` which one is the main one",
                    suggestion(name, all)
                )
            },
        ));
        return None;
    };
    let mut order = vec![main];
    let mut next = 0;
    let mut seen: BTreeSet<PouId> = BTreeSet::from([main]);
    while let Some(pou) = order.get(next).copied() {
        next += 1;
        for called in &typed.pou(pou).calls {
            if seen.insert(*called) {
                order.push(*called);
            }
        }
    }
    order.retain(|p| typed.pou(*p).kind == PouKind::Program);
    for idle in all.iter().filter(|p| {
        !order
            .iter()
            .any(|o| typed.pou(*o).name.eq_ignore_ascii_case(p))
    }) {
        let message = format!(
            "MC {}: the PROGRAM `{idle}` is not run: `{name}` does not call it",
            mc.mc
        );
        problems.push(cell.text.warning("W802", mc.program.span(), message));
    }
    Some(
        order
            .into_iter()
            .map(|p| typed.pou(p).name.clone())
            .collect(),
    )
}

/// Names of generated POUs and variables must be free.
fn reserved_names(cell: &Cell, mc: &McSpec, typed: &TypedProject, problems: &mut Vec<Diagnostic>) {
    let names = Names::of(mc.mc.as_str());
    for name in names.all() {
        if typed.find_pou(name).is_some() || typed.find_global(name).is_some() {
            let message = format!(
                "MC {}: its logic declares `{name}`, which is generated",
                mc.mc
            );
            problems.push(
                cell.text
                    .error("M211", mc.at.clone(), message)
                    .hint("rename it in the logic"),
            );
        }
    }
}

/// Recovery actions and stop POUs: FUNCTION_BLOCKs without inputs and with `end : BOOL` as output.
fn actions(cell: &Cell, mc: &McSpec, typed: &TypedProject, problems: &mut Vec<Diagnostic>) {
    for interval in &mc.intervals {
        let what = format!(
            "critical interval {} of MC {}",
            interval.name.get_ref(),
            mc.mc
        );
        action(
            cell,
            &what,
            "recovery action",
            &interval.recovery,
            typed,
            problems,
        );
    }
    if let Some(stop) = &mc.stop {
        action(
            cell,
            &format!("MC {}", mc.mc),
            "stop POU",
            stop,
            typed,
            problems,
        );
    }
}

fn action(
    cell: &Cell,
    what: &str,
    role: &str,
    pou: &Spanned<String>,
    typed: &TypedProject,
    problems: &mut Vec<Diagnostic>,
) {
    let name = pou.get_ref();
    let mut error = |code: &str, message: String, hint: String| {
        let problem = cell.text.error(code, pou.span(), message).hint(hint);
        // The stop POU may serve several intervals; it is wrong once.
        if !problems.contains(&problem) {
            problems.push(problem);
        }
    };
    let Some(id) = typed.find_pou(name) else {
        let blocks: Vec<&str> = typed
            .pous
            .iter()
            .filter(|p| p.kind == PouKind::FunctionBlock && !p.library)
            .map(|p| p.name.as_str())
            .collect();
        let hint = suggestion(name, blocks);
        return error(
            "M504",
            format!("{what}: the logic has no {role} `{name}`"),
            hint,
        );
    };
    let found = typed.pou(id);
    if found.kind != PouKind::FunctionBlock {
        return error(
            "M505",
            format!("{what}: the {role} `{name}` is a {}", found.kind),
            "make it a FUNCTION_BLOCK with `VAR_OUTPUT end : BOOL; END_VAR`".into(),
        );
    }
    let vars = || found.vars.iter().map(|v| typed.var(*v));
    if let Some(input) = vars().find(|v| matches!(v.section, VarSection::Input | VarSection::InOut))
    {
        error(
            "M505",
            format!(
                "{what}: the {role} `{name}` has the input `{}`, but nothing gives it a value",
                input.name
            ),
            "an action reads and writes global variables through VAR_EXTERNAL".into(),
        );
    }
    let end = found.vars.iter().copied().find(|v| {
        let var = typed.var(*v);
        var.name.eq_ignore_ascii_case("end") && var.section == VarSection::Output
    });
    match end.map(|id| (id, typed.var(id))) {
        None => error(
            "M506",
            format!("{what}: the {role} `{name}` has no output `end`"),
            "add `VAR_OUTPUT end : BOOL; END_VAR`; it says when the action is over".into(),
        ),
        Some((_, end)) if typed.types.elem(end.ty) != Some(Elem::Bool) => error(
            "M506",
            format!(
                "{what}: the output `end` of the {role} `{name}` is {}",
                typed.type_name(end.ty)
            ),
            "make it BOOL; it says when the action is over".into(),
        ),
        Some((id, end)) if end.init.is_none() && !may_be_written(typed, id) => error(
            "M514",
            format!(
                "{what}: the {role} `{name}` never sets its output `end`: it would run for ever"
            ),
            "assign it where the action is over, such as `end := InPosition;`".into(),
        ),
        Some(_) => {}
    }
    for name in state_used(typed, id) {
        error(
            "M512",
            format!("{what}: the {role} `{}` uses the global variable `{name}`, which is state", found.name),
            "an action runs before the state is brought back: let it read inputs, write outputs, and keep variables of its own; values that are to hold afterwards go into `checkpoint_state`".into(),
        );
    }
}

/// Global variables of the state that a POU, or one that it calls, reads or writes.
fn state_used(typed: &TypedProject, pou: PouId) -> BTreeSet<String> {
    let mut todo = vec![pou];
    let mut seen = BTreeSet::from([pou]);
    let mut used = BTreeSet::new();
    while let Some(pou) = todo.pop() {
        todo.extend(typed.pou(pou).calls.iter().filter(|c| seen.insert(**c)));
        visit_places(&typed.pou(pou).body, &mut |place| {
            if let Root::Var(id) = &place.root {
                let var = typed.var(*id);
                if var.owner.is_none() && var.location.is_none() && !var.constant {
                    used.insert(var.name.clone());
                }
            }
        });
    }
    used
}

/// A file with plain global variables that belongs to MCs of different kinds looks as if they shared memory: they cannot.
pub fn shared_globals(cell: &Cell, logics: &[Option<Logic>], problems: &mut Vec<Diagnostic>) {
    for (index, mc) in cell.mcs.iter().enumerate() {
        for (other_index, other) in cell.mcs.iter().enumerate().skip(index + 1) {
            if other
                .program
                .get_ref()
                .eq_ignore_ascii_case(mc.program.get_ref())
            {
                continue; // two of one kind: each has variables of its own, as two instances have
            }
            let (Some(logic), Some(_)) = (&logics[index], &logics[other_index]) else {
                continue;
            };
            for file in &other.logic {
                if !mc.logic.iter().any(|f| f.get_ref() == file.get_ref()) {
                    continue;
                }
                for id in &logic.state_globals {
                    let var = logic.typed.var(*id);
                    let source = logic.typed.sources.get(var.span.source);
                    if &source.name == file.get_ref() {
                        problems.push(shared_global(
                            cell,
                            mc,
                            other,
                            &var.name,
                            file.get_ref(),
                            file.span(),
                        ));
                    }
                }
            }
        }
    }
}

fn shared_global(
    cell: &Cell,
    a: &McSpec,
    b: &McSpec,
    name: &str,
    file: &str,
    at: Range<usize>,
) -> Diagnostic {
    cell.text
        .error(
            "M212",
            at,
            format!(
                "the global variable `{name}` in `{file}` would be shared by the MCs {} and {}",
                a.mc, b.mc
            ),
        )
        .expected("no shared memory between MCs: they may run on different controllers")
        .hint("export it as an output of one of them and read it as an input of the other")
}
