//! From the built cell to what this controller hosts: specs, machine code, passive instances.

use crate::cache;
use fam_engineering::build::in_parallel;
use fam_engineering::{BuiltCell, BuiltMc};
use fam_node_core::plc::PlcRuntime;
use fam_node_core::spec::SpecError;
use fam_node_core::{ControlOffsets, McSpec};
use fam_proto::model::{ControllerModel, McModel};
use fam_proto::{ControllerId, McId};
use fam_soft_plc::{Engine, RuntimeError};
use std::path::Path;
use std::sync::Arc;

/// Why a controller cannot host what the cell gives it.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// The cell has no such controller.
    #[error("the cell {cell} has no controller `{controller}`: it has {known}")]
    UnknownController {
        /// The cell.
        cell: String,
        /// The name given.
        controller: ControllerId,
        /// The names that there are.
        known: String,
    },
    /// An MC's machine code or instance.
    #[error("{mc} cannot run here: {why}")]
    Runtime {
        /// The MC.
        mc: McId,
        /// Why.
        why: RuntimeError,
    },
    /// An MC whose layout contradicts itself.
    #[error(transparent)]
    Spec(#[from] SpecError),
}

/// What a controller hosts.
pub struct Hosted {
    /// The controller.
    pub controller: ControllerModel,
    /// MCs, in the order of the cell model.
    pub models: Vec<Arc<McModel>>,
    /// What the node core knows of them.
    pub specs: Vec<Arc<McSpec>>,
    /// An instance of each.
    pub runtimes: Vec<PlcRuntime>,
}

/// Compiles (or takes from the cache directory) and instantiates all that the controller hosts.
///
/// # Errors
/// [`HostError`], which names the MC or the controllers that there are.
pub fn host(
    built: &BuiltCell,
    controller: &ControllerId,
    engine: &Engine,
    cache: Option<&Path>,
) -> Result<Hosted, HostError> {
    let Some(model) = built.model.controller(controller) else {
        let known: Vec<&str> = built
            .model
            .controllers
            .iter()
            .map(|c| c.controller.as_str())
            .collect();
        return Err(HostError::UnknownController {
            cell: built.model.cell.to_string(),
            controller: controller.clone(),
            known: known.join(", "),
        });
    };
    let mut hosted = Hosted {
        controller: model.clone(),
        models: Vec::new(),
        specs: Vec::new(),
        runtimes: Vec::new(),
    };
    let mcs: Vec<(&McModel, &BuiltMc)> = built
        .model
        .mcs
        .iter()
        .filter(|model| model.hosts.contains(controller))
        .filter_map(|model| Some((model, built.mc(&model.mc)?)))
        .collect();
    // Compiling is most of a start, and no scan runs yet that would want the processors.
    let made = in_parallel(mcs.len(), |index| {
        let (model, mc) = mcs[index];
        one(index, model, mc, engine, cache)
    });
    for ((model, _), made) in mcs.into_iter().zip(made) {
        let (spec, runtime) = made?;
        hosted.models.push(Arc::new(model.clone()));
        hosted.specs.push(spec);
        hosted.runtimes.push(runtime);
    }
    Ok(hosted)
}

/// Compiles (or takes from the cache directory) and instantiates one MC.
pub(crate) fn one(
    index: usize,
    model: &McModel,
    built: &BuiltMc,
    engine: &Engine,
    cache: Option<&Path>,
) -> Result<(Arc<McSpec>, PlcRuntime), HostError> {
    let spec = spec(index, model, built);
    spec.check()?;
    let failed = |why| HostError::Runtime {
        mc: model.mc.clone(),
        why,
    };
    let module = cache::prepare(engine, &model.mc, &built.compiled, cache).map_err(failed)?;
    let runtime = PlcRuntime::new(engine, &module, built.checkpoint_region()).map_err(failed)?;
    Ok((Arc::new(spec), runtime))
}

fn spec(index: usize, model: &McModel, built: &BuiltMc) -> McSpec {
    let control = &built.control;
    let wide = |at: u32| at as usize;
    let retained = built.state_variables.iter().filter(|v| v.retain).map(|v| {
        let from = wide(control.state.start + v.offset);
        from..from + wide(v.len)
    });
    McSpec {
        index,
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
