//! Tests of the soft-PLC from text to running program. One binary, so that the engine is linked once.

mod cases;
mod charts;
mod checkpoint;
mod common;
mod configured;
mod diagnostics;
mod diagrams;
mod expressions;
mod hostile;
mod known_cells;
mod layout;
mod loops;
mod marking_machine;
mod open_arrays;
mod plcopen;
mod properties;
mod random_expressions;
mod recursion;
mod regions;
mod runtime;
mod semantics;
mod standalone;
mod state_survives;
mod third_edition;
mod traps;
mod watchdog;
