//! Compiled IEC 61131-3 logic as an [`McRuntime`].

use crate::runtime::McRuntime;
use fam_proto::TrapInfo;
use fam_soft_plc::{Engine, Instance, Module, RuntimeError, Trap};

/// Ticks of the engine's watchdog that a scan may see: the second one ends it.
pub const BUDGET_TICKS: u64 = 2;

/// An instance of compiled logic.
pub struct PlcRuntime {
    instance: Instance,
    checkpoint: usize,
}

impl PlcRuntime {
    /// A new instance with initial values; `checkpoint` is the number of the checkpoint region in the module's layout.
    ///
    /// # Errors
    /// What the runtime says.
    pub fn new(
        engine: &Engine,
        module: &Module,
        checkpoint: usize,
    ) -> Result<PlcRuntime, RuntimeError> {
        Ok(PlcRuntime {
            instance: Instance::new(engine, module)?,
            checkpoint,
        })
    }

    /// The instance, for tools and tests that read variables.
    #[must_use]
    pub fn instance(&self) -> &Instance {
        &self.instance
    }
}

impl McRuntime for PlcRuntime {
    fn scan(&mut self, mc_time_us: u64) -> Result<(), TrapInfo> {
        let mc_time_ns = i64::try_from(mc_time_us.saturating_mul(1_000)).unwrap_or(i64::MAX);
        self.instance
            .scan(mc_time_ns, BUDGET_TICKS)
            .map_err(|trap| info(&trap))
    }
    fn checkpoint(&self) -> &[u8] {
        self.instance.region(self.checkpoint)
    }
    fn checkpoint_mut(&mut self) -> &mut [u8] {
        self.instance.region_mut(self.checkpoint)
    }
    fn inputs_mut(&mut self) -> &mut [u8] {
        self.instance.inputs_mut()
    }
    fn outputs(&self) -> &[u8] {
        self.instance.outputs()
    }
    fn outputs_mut(&mut self) -> &mut [u8] {
        self.instance.outputs_mut()
    }
    fn reset(&mut self) {
        self.instance.reset();
    }
}

#[cold]
fn info(trap: &Trap) -> TrapInfo {
    TrapInfo {
        pou: trap.pou.clone(),
        file: trap.file.clone(),
        line: trap.line,
        message: trap.message.clone(),
    }
}
