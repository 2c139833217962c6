//! From a model and its logic to everything that runs: the cell model for all processes, a compiled module for each MC.
//!
//! Stages: read the model; for each MC (in parallel) read and check its logic and hold its variables against the model; join the
//! MCs (exports, writers); for each MC (in parallel) work out the masks, generate the POUs, compile. Every stage collects
//! its problems, so that one run shows all that is wrong. The same files give the same result, whatever the machine.

use crate::caex::hints::retell;
use crate::control::ControlLayout;
use crate::files::ModelFiles;
use crate::generate::{
    Copy, Names, Plan, PlanInterval, REGION_CHECKPOINT, REGION_STATE, Target, generate, portable,
    stop_number,
};
use crate::intervals::{Interval, intervals};
use crate::io::{self, Image};
use crate::logic::{self, Logic};
use crate::model::open::{Opened, open};
use crate::model::{Cell, McSpec, resolve};
use crate::narrow::{Narrowed, narrowed};
use crate::problem::{Explain, Problems};
use fam_proto::codec::MESSAGE_BYTES_MAX;
use fam_proto::diagnosis::{CriticalInterval, Diagnosis};
use fam_proto::model::{CellModel, McModel};
use fam_proto::{LayoutHash, McId};
use fam_soft_plc::check::{CheckOptions, check};
use fam_soft_plc::diag::{Diagnostic, Severity};
use fam_soft_plc::layout::{
    Area, CompileSpec, Layout, RegionSpec, TypeNode, VariableInfo, WORK_REGION, layout_of,
};
use fam_soft_plc::project::parse_project;
use fam_soft_plc::source::SourceFile;
use fam_soft_plc::types::Elem;
use fam_soft_plc::{CompiledMc, compile};
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use xxhash_rust::xxh3::Xxh3;

/// Header of a frame or image beside its bytes, in bytes, at most.
const HEADER_BYTES_MAX: usize = 1024;

/// A cell, ready to run.
#[derive(Debug, Clone)]
pub struct BuiltCell {
    /// What all processes read.
    pub model: CellModel,
    /// MCs, in the order of `model.mcs`.
    pub mcs: Vec<BuiltMc>,
    /// What is worth a look, but stops nothing.
    pub warnings: Vec<Diagnostic>,
}

impl BuiltCell {
    /// An MC.
    #[must_use]
    pub fn mc(&self, mc: &McId) -> Option<&BuiltMc> {
        self.mcs.iter().find(|m| &m.mc == mc)
    }
}

/// An MC, ready to run.
#[derive(Debug, Clone)]
pub struct BuiltMc {
    /// Its name.
    pub mc: McId,
    /// Its main PROGRAM.
    pub program: String,
    /// Its cycle, in microseconds.
    pub cycle_us: u32,
    /// The module: entry is `<MC>_Control`; regions `checkpoint`, `state`, `work`.
    pub compiled: CompiledMc,
    /// Where the control variables lie in the checkpoint.
    pub control: ControlLayout,
    /// Checkpoint of an MC without history: all variables at their initial values.
    pub initial_checkpoint: Vec<u8>,
    /// Masks and actions.
    pub diagnosis: Diagnosis,
    /// Intervals as people wrote them, in the order of `diagnosis.intervals`.
    pub intervals: Vec<IntervalText>,
    /// Variables of the serialized state, arrays whole.
    pub state_variables: Vec<StateVariable>,
    /// All sources, the generated one last.
    pub sources: Vec<SourceFile>,
    /// ST of the three generated POUs.
    pub control_st: String,
}

/// A critical interval for the diagnosis file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IntervalText {
    /// Condition in ST.
    pub condition: String,
    /// Checkpoint state: variable and value as text.
    pub checkpoint_state: Vec<(String, String)>,
}

/// A variable of the serialized state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateVariable {
    /// Dotted path, such as `Station1.timer.ET`.
    pub path: String,
    /// Type as ST writes it.
    pub type_name: String,
    /// Offset in the serialized state, in bytes.
    pub offset: u32,
    /// Whether a warm reset keeps it.
    pub retain: bool,
    /// Bytes that it takes.
    pub len: u32,
}

impl BuiltMc {
    /// Number of the region `checkpoint` in the module's layout.
    #[must_use]
    pub fn checkpoint_region(&self) -> usize {
        self.compiled
            .layout
            .region_index(REGION_CHECKPOINT)
            .unwrap_or(0)
    }

    /// Checkpoint for a warm reset: initial values, but retained variables as in `last`.
    #[must_use]
    pub fn warm_checkpoint(&self, last: &[u8]) -> Vec<u8> {
        let mut checkpoint = self.initial_checkpoint.clone();
        if last.len() != checkpoint.len() {
            return checkpoint;
        }
        for variable in self.state_variables.iter().filter(|v| v.retain) {
            let from = (self.control.state.start + variable.offset) as usize;
            let range = from..from + variable.len as usize;
            if let (Some(target), Some(source)) =
                (checkpoint.get_mut(range.clone()), last.get(range))
            {
                target.copy_from_slice(source);
            }
        }
        checkpoint
    }
}

/// Builds a cell from its model: `cell.toml`, AutomationML (`.aml`) or a container (`.amlx`).
///
/// # Errors
/// All [`Problems`] of model and logic at once.
pub fn build(path: &Path) -> Result<BuiltCell, Problems> {
    build_for(path, Target::Fam)
}

/// The cell model alone, for processes that run no logic.
///
/// # Errors
/// As [`build`].
pub fn build_model(path: &Path) -> Result<CellModel, Problems> {
    build(path).map(|built| built.model)
}

/// Builds with Serialize and Deserialize in the given form.
///
/// # Errors
/// As [`build`].
pub fn build_for(path: &Path, target: Target) -> Result<BuiltCell, Problems> {
    let Opened {
        file,
        text,
        files,
        problems,
    } = open(path);
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

    let front: Vec<Front> = in_parallel(cell.mcs.len(), |index| front(&cell, index, &files));
    let (mut logics, mut images) = (Vec::new(), Vec::new());
    for part in front {
        problems.extend(part.problems);
        logics.push(part.logic);
        images.push(part.image);
    }
    logic::shared_globals(&cell, &logics, &mut problems);
    io::two_writers(&cell, &images, &mut problems);
    let points: Vec<_> = (0..cell.mcs.len())
        .map(|index| io::connect(&cell, index, &images, &mut problems))
        .collect();

    let good = !problems.iter().any(|p| p.severity == Severity::Error);
    let back: Vec<(Option<BuiltMc>, Vec<Diagnostic>)> = in_parallel(cell.mcs.len(), |index| {
        let mut problems = Vec::new();
        let built = logics[index]
            .as_ref()
            .and_then(|logic| back(&cell.mcs[index], &cell, logic, target, good, &mut problems));
        (built, problems)
    });
    let mut mcs = Vec::new();
    for (built, found) in back {
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
    if problems.iter().any(|p| p.severity == Severity::Error) {
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

/// Runs a job for each index on all processors; results in the order of the indices.
fn in_parallel<T: Send>(count: usize, job: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let results: Mutex<Vec<(usize, T)>> = Mutex::new(Vec::with_capacity(count));
    let next = AtomicUsize::new(0);
    let threads = std::thread::available_parallelism()
        .map_or(1, usize::from)
        .min(count);
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

struct Front {
    logic: Option<Logic>,
    image: Option<Image>,
    problems: Vec<Diagnostic>,
}

fn front(cell: &Cell, index: usize, files: &ModelFiles) -> Front {
    let mc = &cell.mcs[index];
    let mut problems = Vec::new();
    let logic = logic::load(cell, mc, files, &mut problems);
    let image = logic
        .as_ref()
        .map(|logic| io::image(cell, mc, logic, &mut problems));
    Front {
        logic,
        image,
        problems,
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
        (found.area == Area::Region(state_index)).then_some(())?;
        Some((found.offset, found.ty.elem()?))
    };
    let in_state = |path: &str| anywhere(path).filter(|(offset, _)| !narrowed.contains(*offset));
    let found = intervals(
        cell,
        mc,
        logic,
        &in_state,
        &layout.initial[state_index],
        problems,
    );
    if !good
        || problems[before..]
            .iter()
            .any(|p| p.severity == Severity::Error)
    {
        return None;
    }
    let intervals: Vec<Interval> = found.into_iter().flatten().collect();
    let state_len = layout.regions[state_index].len;
    let copy = match copy(mc, logic, target, &anywhere) {
        Ok(copy) => copy,
        Err(e) => {
            let problem = cell
                .text
                .error("M511", mc.at.clone(), format!("MC {}: {e}", mc.mc));
            problems.push(problem.hint("use the block copy (target fam) for this MC"));
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
    in_state: &dyn Fn(&str) -> Option<(u32, Elem)>,
) -> Result<Copy, portable::PortableError> {
    match target {
        Target::Fam => Ok(Copy::Block),
        Target::Portable => portable::statements(
            &logic.typed,
            &logic.programs,
            &logic.state_globals,
            &Names::of(mc.mc.as_str()).state,
            &|path| in_state(path).map(|(offset, _)| offset),
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
    let typed = check(&project, options)?;
    compile(&typed, spec)
}

fn finish(
    mc: &McSpec,
    intervals: &[Interval],
    compiled: CompiledMc,
    sources: Vec<SourceFile>,
    control_st: String,
    narrowed: &Narrowed,
) -> BuiltMc {
    let layout = &compiled.layout;
    let control = ControlLayout::of(mc.mc.as_str(), layout);
    let checkpoint = layout.region_index(REGION_CHECKPOINT).unwrap_or(0);
    let state = layout.region_index(REGION_STATE).unwrap_or(0);
    let mut initial_checkpoint = layout.initial[checkpoint].clone();
    initial_checkpoint[control.state.start as usize..control.state.end as usize]
        .copy_from_slice(&layout.initial[state]);
    let diagnosis = Diagnosis {
        state_offset: control.state.start,
        checkpoint_len: layout.regions[checkpoint].len,
        intervals: mc
            .intervals
            .iter()
            .zip(intervals)
            .zip(1..)
            .map(|((spec, interval), action)| CriticalInterval {
                name: spec.name.get_ref().clone(),
                rows: interval.rows.clone(),
                kind: spec.kind,
                action,
                pou: spec.recovery.get_ref().clone(),
                repeatable: spec.repeatable,
            })
            .collect(),
        stop_action: mc.stop.as_ref().map(|_| stop_number(mc.intervals.len())),
    };
    let texts = mc
        .intervals
        .iter()
        .zip(intervals)
        .map(|(spec, interval)| IntervalText {
            condition: spec.condition.get_ref().clone(),
            checkpoint_state: interval
                .overlay
                .iter()
                .map(|o| (o.path.clone(), o.value.clone()))
                .collect(),
        })
        .collect();
    let state_variables = layout
        .variables
        .iter()
        .filter(|v| v.area == Area::Region(state) && !narrowed.contains(v.offset))
        .map(state_variable)
        .collect();
    BuiltMc {
        mc: mc.mc.clone(),
        program: mc.program.get_ref().clone(),
        cycle_us: mc.cycle_us,
        control,
        initial_checkpoint,
        diagnosis,
        intervals: texts,
        state_variables,
        sources,
        control_st,
        compiled,
    }
}

fn state_variable(variable: &VariableInfo) -> StateVariable {
    StateVariable {
        path: variable.path.clone(),
        type_name: type_name(&variable.ty),
        offset: variable.offset,
        retain: variable.retain,
        len: variable.len,
    }
}

pub(crate) fn type_name(node: &TypeNode) -> String {
    match node {
        TypeNode::Elem(elem) => elem.name().to_owned(),
        TypeNode::Enum { name, base, values } if name.is_empty() => {
            let names: Vec<&str> = values.iter().map(|(n, _)| n.as_str()).collect();
            format!("{base} ({})", names.join(", "))
        }
        TypeNode::Enum { name, .. } | TypeNode::Struct { name, .. } => name.clone(),
        TypeNode::Subrange { base, lo, hi } => format!("{base} ({lo}..{hi})"),
        TypeNode::Text { wide, len } => {
            format!("{}[{len}]", if *wide { "WSTRING" } else { "STRING" })
        }
        TypeNode::Array { dims, elem, .. } => {
            let dims: Vec<String> = dims.iter().map(|(lo, hi)| format!("{lo}..{hi}")).collect();
            format!("ARRAY[{}] OF {}", dims.join(", "), type_name(elem))
        }
    }
}

/// Frames have to fit into messages, and all of them together through the link.
fn sizes(cell: &Cell, mcs: &[BuiltMc], problems: &mut Vec<Diagnostic>) {
    let mut link_bytes_s: u64 = 0;
    for (spec, built) in cell.mcs.iter().zip(mcs) {
        let frame = frame_len(built);
        if frame > MESSAGE_BYTES_MAX {
            let message = format!(
                "MC {}: its frames would have {frame} bytes, a message has at most {MESSAGE_BYTES_MAX}",
                spec.mc
            );
            problems.push(cell.text.error("M408", spec.at.clone(), message).hint(
                "make its arrays smaller, keep what is no state in VAR_TEMP, or divide the MC",
            ));
        }
        link_bytes_s += frame as u64 * 1_000_000 / u64::from(spec.cycle_us.max(1));
        for controller in cell
            .controllers
            .iter()
            .filter(|c| spec.hosts.contains(&c.controller))
        {
            let kb = memory_kb(&built.compiled.layout);
            if kb > controller.memory_kb {
                let message = format!(
                    "MC {}: an instance needs {kb} kB, controller {} has {} kB",
                    spec.mc, controller.controller, controller.memory_kb
                );
                problems.push(
                    cell.text
                        .error("M409", spec.at.clone(), message)
                        .hint("give the controller more memory_mb, or take it from the MC's hosts"),
                );
            }
        }
    }
    if let Some(limit) = &cell.link_bytes_s
        && link_bytes_s > *limit.get_ref()
    {
        let message = format!(
            "all MCs together may send {:.1} Mbit/s, the link carries {:.1}",
            link_bytes_s as f64 / 125_000.0,
            *limit.get_ref() as f64 / 125_000.0
        );
        problems.push(
            cell.text
                .error("M410", limit.span(), message)
                .hint("make states smaller or cycles longer, or use a faster link"),
        );
    }
}

fn frame_len(built: &BuiltMc) -> usize {
    HEADER_BYTES_MAX + built.initial_checkpoint.len() + built.compiled.layout.outputs.len as usize
}

/// Linear memory comes in pages.
fn memory_kb(layout: &Layout) -> u64 {
    const PAGE_KB: u64 = 64;
    let end = layout
        .regions
        .iter()
        .map(|r| u64::from(r.offset) + u64::from(r.len))
        .max()
        .unwrap_or(0);
    (end.div_ceil(PAGE_KB * 1024)).max(1) * PAGE_KB
}

fn mc_model(spec: &McSpec, built: &BuiltMc, gateway: fam_proto::GatewayId) -> McModel {
    let layout = &built.compiled.layout;
    McModel {
        mc: spec.mc.clone(),
        gateway,
        hosts: spec.hosts.clone(),
        criticality: spec.criticality,
        cycle_us: spec.cycle_us,
        worst_case_us: spec.worst_case_us,
        memory_kb: memory_kb(layout),
        watchdog_us: spec.watchdog_us,
        suspect_us: spec.suspect_us,
        hash: 0,
        layout: LayoutHash(layout.hash()),
        diagnosis: built.diagnosis.clone(),
        inputs: Vec::new(),
        inputs_len: layout.inputs.len,
        outputs: Vec::new(),
        fail_safe: Vec::new(),
    }
}

fn fail_safe(built: &BuiltMc, image: &Image) -> Vec<u8> {
    let mut bytes = vec![0; built.compiled.layout.outputs.len as usize];
    for (l, _, value) in &image.outputs {
        io::put(&mut bytes, l.place, value);
    }
    bytes
}

/// Hash of logic, layout and masks, and of the process image: two nodes with the same hash run the same MC.
fn mc_hash(model: &McModel, built: &BuiltMc) -> u64 {
    let mut hasher = Xxh3::new();
    hasher.update(&built.compiled.logic_hash.to_le_bytes());
    hasher.update(&model.layout.0.to_le_bytes());
    hasher.update(crate::plcopen::diagnosis_file::write(built).as_bytes());
    hasher.update(format!("{:?}{:?}{:?}", model.inputs, model.outputs, model.fail_safe).as_bytes());
    hasher.update(&model.cycle_us.to_le_bytes());
    hasher.digest()
}
