//! Runs compiled MCs: engine, modules, instances, traps.

mod engine;
mod instance;
mod math;
mod trap;

pub use engine::{Engine, EngineOptions, Interruption, Module, RuntimeError};
pub use instance::{Instance, WriteError};
pub use trap::{Trap, TrapKind};
