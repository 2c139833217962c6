//! What an MC of a simulated cell runs: the model MC in plain Rust, or compiled logic in the real soft-PLC.

use fam_node_core::model_mc::ModelMc;
use fam_node_core::plc::PlcRuntime;
use fam_node_core::{McRuntime, McSpec};
use fam_proto::{GatewayId, McId, TrapInfo};
use fam_soft_plc::{Engine, Module};
use std::sync::Arc;

/// Compiled logic, shared by all cells of a process.
pub struct PlcLogic {
    /// The engine that it was prepared for.
    pub engine: Engine,
    /// Its machine code.
    pub module: Module,
    /// Number of the checkpoint region in its layout.
    pub checkpoint: usize,
    /// What a node knows of it, as its first MC.
    pub spec: McSpec,
}

impl std::fmt::Debug for PlcLogic {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PlcLogic")
            .field("mc", &self.spec.mc)
            .finish_non_exhaustive()
    }
}

/// What an MC runs.
#[derive(Debug, Clone)]
pub enum Logic {
    /// The model MC, with this many bytes of state beyond its own.
    Model {
        /// Bytes.
        padding: usize,
    },
    /// Compiled logic.
    Plc(Arc<PlcLogic>),
}

impl Logic {
    /// A new instance with initial values.
    ///
    /// # Panics
    /// If the soft-PLC has no memory for one more.
    #[must_use]
    pub fn instance(&self) -> SimMc {
        match self {
            Logic::Model { padding } => SimMc::Model(ModelMc::new(*padding)),
            Logic::Plc(plc) => {
                let runtime = PlcRuntime::new(&plc.engine, &plc.module, plc.checkpoint);
                SimMc::Plc(Box::new(runtime.expect("memory for an instance")))
            }
        }
    }

    /// What a node knows of it, as its `index`-th MC.
    #[must_use]
    pub fn spec(&self, index: usize, mc: &McId, gateway: &GatewayId, cycle_us: u32) -> McSpec {
        match self {
            Logic::Model { padding } => {
                ModelMc::spec(index, mc.clone(), gateway.clone(), cycle_us, *padding)
            }
            Logic::Plc(plc) => McSpec {
                index,
                mc: mc.clone(),
                gateway: gateway.clone(),
                cycle_us,
                ..plc.spec.clone()
            },
        }
    }
}

/// An instance.
pub enum SimMc {
    /// Of the model MC.
    Model(ModelMc),
    /// Of compiled logic.
    Plc(Box<PlcRuntime>),
}

impl McRuntime for SimMc {
    fn scan(&mut self, mc_time_us: u64) -> Result<(), TrapInfo> {
        match self {
            SimMc::Model(model) => model.scan(mc_time_us),
            SimMc::Plc(plc) => plc.scan(mc_time_us),
        }
    }
    fn checkpoint(&self) -> &[u8] {
        match self {
            SimMc::Model(model) => model.checkpoint(),
            SimMc::Plc(plc) => plc.checkpoint(),
        }
    }
    fn checkpoint_mut(&mut self) -> &mut [u8] {
        match self {
            SimMc::Model(model) => model.checkpoint_mut(),
            SimMc::Plc(plc) => plc.checkpoint_mut(),
        }
    }
    fn inputs_mut(&mut self) -> &mut [u8] {
        match self {
            SimMc::Model(model) => model.inputs_mut(),
            SimMc::Plc(plc) => plc.inputs_mut(),
        }
    }
    fn outputs(&self) -> &[u8] {
        match self {
            SimMc::Model(model) => model.outputs(),
            SimMc::Plc(plc) => plc.outputs(),
        }
    }
    fn outputs_mut(&mut self) -> &mut [u8] {
        match self {
            SimMc::Model(model) => model.outputs_mut(),
            SimMc::Plc(plc) => plc.outputs_mut(),
        }
    }
    fn reset(&mut self) {
        match self {
            SimMc::Model(model) => model.reset(),
            SimMc::Plc(plc) => plc.reset(),
        }
    }
}
