//! From a model and its logic to everything that runs: the cell model for all processes, a compiled module for each MC.
//!
//! Stages: read the model; for each MC (in parallel) read and check its logic and hold its variables against the model; join the
//! MCs (exports, writers); for each MC (in parallel) work out the masks, generate the POUs, compile. Every stage collects
//! its problems, so that one run shows all that is wrong. The same files give the same result, whatever the machine.

mod built;
mod finish;
mod sizes;

pub(crate) use built::type_name;
pub use built::{BuiltCell, BuiltMc, IntervalText, StateVariable};

use crate::actuators;
use crate::caex::hints::retell;
use crate::files::{ModelAt, ModelFiles};
use crate::generate::{
    Copy, Names, Plan, PlanInterval, REGION_CHECKPOINT, REGION_STATE, Target, generate, portable,
};
use crate::intervals::{Interval, State, intervals};
use crate::io::{self, Image};
use crate::logic::{self, Logic};
use crate::model::open::{Opened, open};
use crate::model::{Cell, McSpec, resolve};
use crate::narrow::narrowed;
use crate::problem::{Explain, Problems};
use crate::writers::{names_alike, two_writers};
use fam_proto::model::CellModel;
use fam_soft_plc::check::{CheckOptions, check};
use fam_soft_plc::diag::{Diagnostic, Severity};
use fam_soft_plc::layout::{Area, CompileSpec, Layout, RegionSpec, WORK_REGION, layout_of};
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use fam_soft_plc::types::Elem;
use fam_soft_plc::{CompiledMc, compile};
use finish::{fail_safe, finish, mc_hash, mc_model};
use sizes::{sizes, too_large};
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Builds a cell from its model: `cell.toml`, AutomationML (`.aml`) or a container (`.amlx`).
///
/// # Errors
/// All [`Problems`] of model and logic at once.
pub fn build<'a>(model: impl Into<ModelAt<'a>>) -> Result<BuiltCell, Problems> {
    build_for(model, Target::Fam)
}

/// The cell model alone, for processes that run no logic.
///
/// # Errors
/// As [`build`].
pub fn build_model<'a>(model: impl Into<ModelAt<'a>>) -> Result<CellModel, Problems> {
    build(model).map(|built| built.model)
}

/// Builds with Serialize and Deserialize in the given form.
///
/// # Errors
/// As [`build`].
pub fn build_for<'a>(model: impl Into<ModelAt<'a>>, target: Target) -> Result<BuiltCell, Problems> {
    let Opened {
        file,
        text,
        files,
        problems,
    } = open(model);
    let Some(file) = file else {
        return Err(Problems {
            list: sorted(problems),
        });
    };
    let (cell, mut problems) = resolve::resolve(file, text, problems);
    let Some(cell) = cell else {
        return Err(Problems {
            list: sorted(problems),
        });
    };

    let at_once = at_once(&cell);
    let front: Vec<Front> = in_parallel(cell.mcs.len(), |index| {
        let mut front = front(&cell, index, &files, target);
        if at_once[index]
            && let Some(logic) = front.logic.take()
        {
            front.back = Some(finished(
                &cell,
                index,
                &logic,
                target,
                !has_error(&front.problems),
            ));
        }
        front
    });
    let (mut logics, mut images, mut backs) = (Vec::new(), Vec::new(), Vec::new());
    for part in front {
        problems.extend(part.problems);
        logics.push(part.logic);
        images.push(part.image);
        backs.push(part.back);
    }
    logic::shared_globals(&cell, &logics, &mut problems);
    two_writers(&cell, &images, &mut problems);
    names_alike(&cell, &mut problems);
    let points: Vec<_> = (0..cell.mcs.len())
        .map(|index| io::connect(&cell, index, &images, &mut problems))
        .collect();

    let good = !has_error(&problems);
    let later: Vec<Option<Back>> = in_parallel(cell.mcs.len(), |index| {
        let logic = logics[index].as_ref()?;
        Some(finished(&cell, index, logic, target, good))
    });
    let mut mcs = Vec::new();
    for (built, found) in backs.into_iter().zip(later).filter_map(|(a, b)| a.or(b)) {
        problems.extend(found);
        mcs.extend(built);
    }
    if mcs.len() == cell.mcs.len() {
        sizes(&cell, &mcs, &mut problems);
    }
    let mut problems = sorted(problems);
    if cell.text.is_caex() {
        problems.iter_mut().for_each(retell);
    }
    if has_error(&problems) {
        return Err(Problems { list: problems });
    }
    let mut models = Vec::new();
    for (((spec, built), image), (inputs, outputs)) in
        cell.mcs.iter().zip(&mcs).zip(&images).zip(points)
    {
        let (Some(gateway), Some(image)) = (&spec.gateway, image) else {
            continue;
        };
        let mut model = mc_model(spec, built, gateway.clone());
        model.fail_safe = fail_safe(built, image);
        model.inputs = inputs;
        model.outputs = outputs;
        model.hash = mc_hash(&model, built);
        models.push(model);
    }
    Ok(BuiltCell {
        model: CellModel {
            cell: cell.cell.clone(),
            controllers: cell.controllers.clone(),
            mcs: models,
            gateways: cell.gateways.clone(),
            settings: cell.settings.clone(),
        },
        mcs,
        warnings: problems,
    })
}

/// Typed trees of so many MCs are kept from the first stage to the last one.
const LOGICS_KEPT_MAX: usize = 100;

/// Which MCs go through all stages at once, because the logic of a large cell would not fit into memory as a whole: those that
/// share no file with another one, which nothing in between asks for.
fn at_once(cell: &Cell) -> Vec<bool> {
    let mut users: BTreeMap<&str, usize> = BTreeMap::new();
    for file in cell.mcs.iter().flat_map(|mc| &mc.logic) {
        *users.entry(file.get_ref()).or_default() += 1;
    }
    let is_own = |file: &toml::Spanned<String>| users.get(file.get_ref().as_str()) == Some(&1);
    cell.mcs
        .iter()
        .map(|mc| cell.mcs.len() > LOGICS_KEPT_MAX && mc.logic.iter().all(is_own))
        .collect()
}

/// Errors first, otherwise in the order found; each once.
fn sorted(problems: Vec<Diagnostic>) -> Vec<Diagnostic> {
    let mut list: Vec<Diagnostic> = Vec::new();
    for problem in problems {
        // A file of several MCs has its problems in each of them.
        if !list.contains(&problem) {
            list.push(problem);
        }
    }
    list.sort_by_key(|p| p.severity);
    list
}

/// How many jobs run at a time.
pub(crate) fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Runs a job for each index on all processors; results in the order of the indices.
pub fn in_parallel<T: Send>(count: usize, job: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let results: Mutex<Vec<(usize, T)>> = Mutex::new(Vec::with_capacity(count));
    let next = AtomicUsize::new(0);
    let threads = processors().min(count);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    if index >= count {
                        return;
                    }
                    let result = job(index);
                    results
                        .lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner)
                        .push((index, result));
                }
            });
        }
    });
    let mut results = results
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

/// An MC after its last stage, and what was found there.
type Back = (Option<BuiltMc>, Vec<Diagnostic>);

struct Front {
    logic: Option<Logic>,
    image: Option<Image>,
    problems: Vec<Diagnostic>,
    /// The last stage too, of an MC that goes through all at once.
    back: Option<Back>,
}

fn has_error(problems: &[Diagnostic]) -> bool {
    problems.iter().any(|p| p.severity == Severity::Error)
}

fn finished(cell: &Cell, index: usize, logic: &Logic, target: Target, good: bool) -> Back {
    let mut problems = Vec::new();
    let built = back(&cell.mcs[index], cell, logic, target, good, &mut problems);
    (built, problems)
}

fn front(cell: &Cell, index: usize, files: &ModelFiles, target: Target) -> Front {
    let mc = &cell.mcs[index];
    let mut problems = Vec::new();
    let logic = logic::load(cell, mc, files, target, &mut problems);
    let image = logic.as_ref().map(|logic| {
        actuators::check(cell, mc, &logic.typed, &mut problems);
        io::image(cell, mc, logic, &mut problems)
    });
    Front {
        logic,
        image,
        problems,
        back: None,
    }
}

/// Regions of the module: see `generate`.
fn spec(mc: &McSpec, logic: &Logic, with_control: bool, has_state: bool) -> CompileSpec {
    let names = Names::of(mc.mc.as_str());
    let state = RegionSpec {
        name: REGION_STATE.to_owned(),
        programs: logic.programs.clone(),
        globals: logic
            .state_globals
            .iter()
            .map(|id| logic.typed.var(*id).name.clone())
            .collect(),
        markers: true,
    };
    if !with_control {
        return CompileSpec {
            entry: mc.program.get_ref().clone(),
            regions: vec![state],
            ..CompileSpec::default()
        };
    }
    let checkpoint = RegionSpec {
        name: REGION_CHECKPOINT.to_owned(),
        programs: vec![names.control.clone()],
        globals: if has_state {
            vec![names.state]
        } else {
            Vec::new()
        },
        markers: false,
    };
    CompileSpec {
        entry: names.control,
        regions: vec![checkpoint, state],
        ..CompileSpec::default()
    }
}

/// Masks, generated POUs, module. With `good` FALSE only what finds problems is done.
fn back(
    mc: &McSpec,
    cell: &Cell,
    logic: &Logic,
    target: Target,
    good: bool,
    problems: &mut Vec<Diagnostic>,
) -> Option<BuiltMc> {
    let before = problems.len();
    let layout = match layout_of(&logic.typed, &spec(mc, logic, false, true)) {
        Ok(layout) => layout,
        Err(found) => {
            problems.extend(found);
            return None;
        }
    };
    let state_index = layout.region_index(REGION_STATE)?;
    let narrowed = narrowed(cell, mc, &layout, state_index, problems);
    let anywhere = |path: &str| -> Option<(u32, Elem)> {
        let found = layout.find(path)?;
        // A bit at %MX shares its byte with others, which no mask could tell apart.
        (found.area == Area::Region(state_index) && found.bit.is_none()).then_some(())?;
        Some((found.offset, found.ty.elem()?))
    };
    let in_state = |path: &str| anywhere(path).filter(|(offset, _)| !narrowed.contains(*offset));
    let offset = |path: &str| -> Option<u32> {
        let found = layout.find(path)?;
        (found.area == Area::Region(state_index)).then_some(found.offset)
    };
    let initial = &layout.initial[state_index];
    let state = State {
        locate: &in_state,
        contains: &|path| offset(path).is_some_and(|at| !narrowed.contains(at)),
        initial,
    };
    let found = intervals(cell, mc, logic, state, problems);
    if !good || has_error(&problems[before..]) {
        return None;
    }
    let intervals: Vec<Interval> = found.into_iter().flatten().collect();
    let state_len = layout.regions[state_index].len;
    if let Some(problem) = too_large(cell, mc, state_len as usize) {
        problems.push(problem);
        return None;
    }
    let memory = portable::Memory {
        offset: &offset,
        initial,
    };
    let copy = match copy(mc, logic, target, memory) {
        Ok(copy) => copy,
        Err(e) => {
            let problem = cell
                .text
                .error("M511", mc.at.clone(), format!("MC {}: {e}", mc.mc));
            problems.push(problem.hint(e.hint));
            return None;
        }
    };
    let plan = Plan {
        mc: mc.mc.as_str(),
        program: mc.program.get_ref(),
        intervals: mc
            .intervals
            .iter()
            .zip(&intervals)
            .map(|(spec, interval)| PlanInterval {
                name: spec.name.get_ref(),
                kind: spec.kind,
                pou: spec.recovery.get_ref(),
                overlay: interval.overlay.clone(),
            })
            .collect(),
        stop: mc.stop.as_ref().map(|s| s.get_ref().as_str()),
        state_len,
        copy,
        fixed: &narrowed.places,
    };
    let control_st = generate(&plan);
    let mut sources = logic.sources.clone();
    sources.push(SourceFile::new(
        format!("{} (generated)", mc.mc),
        control_st.clone(),
    ));
    match compiled(mc, logic, &sources, state_len > 0) {
        Ok(compiled) => {
            outside(cell, mc, &compiled.layout, problems);
            Some(finish(
                mc, &intervals, compiled, sources, control_st, &narrowed,
            ))
        }
        Err(found) => {
            problems.extend(found);
            None
        }
    }
}

/// What lies in no named region would not be in a checkpoint.
fn outside(cell: &Cell, mc: &McSpec, layout: &Layout, problems: &mut Vec<Diagnostic>) {
    let work = layout.region_index(WORK_REGION).map(Area::Region);
    for lost in layout.roots.iter().filter(|r| Some(r.area) == work) {
        let message = format!(
            "MC {}: `{}` would be lost when the MC moves",
            mc.mc, lost.path
        );
        problems.push(
            cell.text
                .error("M213", mc.at.clone(), message)
                .expected("variables of the main PROGRAM, of what it calls, or global ones")
                .hint("call its PROGRAM from the main one, or move the variable there"),
        );
    }
}

fn copy(
    mc: &McSpec,
    logic: &Logic,
    target: Target,
    memory: portable::Memory<'_>,
) -> Result<Copy, portable::PortableError> {
    match target {
        Target::Fam => Ok(Copy::Block),
        Target::Portable => portable::statements(
            &logic.typed,
            &logic.programs,
            &logic.state_globals,
            &Names::of(mc.mc.as_str()).state,
            memory,
        )
        .map(Copy::Statements),
    }
}

fn compiled(
    mc: &McSpec,
    logic: &Logic,
    sources: &[SourceFile],
    has_state: bool,
) -> Result<CompiledMc, Vec<Diagnostic>> {
    compile_sources(sources, &spec(mc, logic, true, has_state))
}

/// Compiles sources that hold generated POUs.
///
/// # Errors
/// What the compiler finds.
pub fn compile_sources(
    sources: &[SourceFile],
    spec: &CompileSpec,
) -> Result<CompiledMc, Vec<Diagnostic>> {
    let (project, found) = parse_project(sources);
    if found.iter().any(|d| d.severity == Severity::Error) {
        return Err(found);
    }
    // The logic has passed without it: only what is generated makes use of it.
    let options = CheckOptions {
        allow_internal_access: true,
        ..CheckOptions::default()
    };
    let typed = check(project, options)?;
    compile(&typed, spec)
}
