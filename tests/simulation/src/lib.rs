//! A seeded simulation of a whole cell, and the invariants of the safety contract.

pub mod invariants;
pub mod simulator;

#[allow(missing_docs)]
#[path = "../tests/fms200/mod.rs"]
pub mod closed_loop;
pub mod undisturbed;
