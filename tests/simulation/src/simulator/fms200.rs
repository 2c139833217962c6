//! The FMS-200 cell as it is delivered: its model, its compiled logic, prepared once for all schedules of a process.

use super::cell::{Cell, McInfo};
use super::logic::{Logic, PlcLogic};
use fam_engineering::BuiltMc;
use fam_node_core::{ControlOffsets, McSpec};
use fam_proto::model::McModel;
use fam_soft_plc::{Engine, EngineOptions, Interruption};
use std::sync::{Arc, OnceLock};

/// The delivered logic of all MCs, in the order of the model.
fn logics() -> &'static [(McModel, Arc<PlcLogic>)] {
    static LOGICS: OnceLock<Vec<(McModel, Arc<PlcLogic>)>> = OnceLock::new();
    LOGICS.get_or_init(|| {
        let built = &crate::closed_loop::cell().built;
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
    })
}

/// The delivered cell.
#[must_use]
pub fn fms200() -> Cell {
    let model = &crate::closed_loop::cell().built.model;
    let mcs = logics().iter().map(|(mc, logic)| {
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

/// The logic of the `n`-th MC, for cells of one's own: it takes turns.
#[must_use]
pub fn logic(n: usize) -> (&'static McModel, Arc<PlcLogic>) {
    let all = logics();
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
