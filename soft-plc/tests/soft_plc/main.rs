//! Tests of the soft-PLC from text to running program. One binary, so that the engine is linked once.

mod checkpoint;
mod common;
mod diagnostics;
mod expressions;
mod hostile;
mod layout;
mod loops;
mod plcopen;
mod properties;
mod random_expressions;
mod regions;
mod runtime;
mod semantics;
mod traps;
