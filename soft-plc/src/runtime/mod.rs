//! Runs compiled MCs: engine, modules, instances, traps.

mod engine;
mod instance;
mod math;
mod text;
mod trap;
mod watchdog;

pub use engine::{Engine, EngineOptions, Interruption, Module, RuntimeError};
pub use instance::{Instance, WriteError};
pub use text::{text_of, value_of};
pub use trap::{Trap, TrapKind};
