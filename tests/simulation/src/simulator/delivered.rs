//! Cells as they are delivered: their models, their compiled logic, prepared once for all schedules of a process.

use super::cell::{Cell, McInfo};
use super::logic::{Logic, PlcLogic};
use fam_engineering::{BuiltCell, BuiltMc, build};
use fam_node_core::{ControlOffsets, McSpec};
use fam_proto::model::{CellModel, McModel};
use fam_soft_plc::{Engine, EngineOptions, Interruption};
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// The delivered logic of all MCs of a cell, in the order of its model.
type Logics = Vec<(McModel, Arc<PlcLogic>)>;

fn prepared(built: &BuiltCell) -> Logics {
    // Endless loops are the node's own tests' matter.
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::None,
    })
    .expect("an engine");
    let prepared = built.model.mcs.iter().map(|model| {
        let mc = built.mc(&model.mc).expect("each MC of the model is built");
        let logic = PlcLogic {
            module: engine.prepare(&mc.compiled).expect("a module"),
            engine: engine.clone(),
            checkpoint: mc.checkpoint_region(),
            spec: spec(model, mc),
        };
        (model.clone(), Arc::new(logic))
    });
    prepared.collect()
}

fn fms200_logics() -> &'static Logics {
    static LOGICS: OnceLock<Logics> = OnceLock::new();
    LOGICS.get_or_init(|| prepared(&crate::closed_loop::cell().built))
}

/// The FMS-200 cell.
#[must_use]
pub fn fms200() -> Cell {
    cell(&crate::closed_loop::cell().built.model, fms200_logics())
}

/// The marking machine, built at the first call.
#[must_use]
pub fn marking() -> Cell {
    static CELL: OnceLock<(BuiltCell, Logics)> = OnceLock::new();
    let (built, logics) = CELL.get_or_init(|| {
        let path =
            Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/marking-machine/cell.toml");
        let built = build(&path).unwrap_or_else(|problems| panic!("{problems}"));
        let logics = prepared(&built);
        (built, logics)
    });
    cell(&built.model, logics)
}

fn cell(model: &CellModel, logics: &Logics) -> Cell {
    let mcs = logics.iter().map(|(mc, logic)| {
        let hosts = mc.hosts.iter().filter_map(|host| {
            let at = model.controllers.iter();
            at.clone().position(|c| c.controller == *host)
        });
        McInfo {
            mc: mc.mc.clone(),
            hosts: hosts.collect(),
            cpu_ns: u64::from(mc.worst_case_us) * 400,
            spec: Arc::new(logic.spec.clone()),
            logic: Logic::Plc(logic.clone()),
            model: Arc::new(mc.clone()),
        }
    });
    Cell {
        mcs: mcs.collect(),
        controllers: model
            .controllers
            .iter()
            .map(|c| c.controller.clone())
            .collect(),
        gateway: model.gateways[0].gateway.clone(),
        model: Arc::new(model.clone()),
    }
}

/// The logic of the `n`-th MC of the FMS-200 cell, for cells of one's own: it takes turns.
#[must_use]
pub fn logic(n: usize) -> (&'static McModel, Arc<PlcLogic>) {
    let all = fms200_logics();
    let (model, logic) = &all[n % all.len()];
    (model, logic.clone())
}

fn spec(model: &McModel, built: &BuiltMc) -> McSpec {
    let control = &built.control;
    let wide = |at: u32| at as usize;
    let retained = built.state_variables.iter().filter(|v| v.retain).map(|v| {
        let from = wide(control.state.start + v.offset);
        from..from + wide(v.len)
    });
    McSpec {
        index: 0,
        mc: model.mc.clone(),
        gateway: model.gateway.clone(),
        layout: model.layout,
        cycle_us: model.cycle_us,
        diagnosis: model.diagnosis.clone(),
        control: ControlOffsets {
            is_active: wide(control.is_active),
            was_active: wide(control.was_active),
            recovery_action: wide(control.recovery_action),
            actions: wide(control.actions.start)..wide(control.actions.end),
        },
        initial: built.initial_checkpoint.clone(),
        retained: retained.collect(),
        inputs_len: wide(model.inputs_len),
        outputs_len: model.fail_safe.len(),
    }
}
