//! A seeded simulation of a whole cell, and the invariants of the safety contract.

pub mod campaign;
pub mod invariants;
pub mod simulator;

pub mod closed_loop;
pub mod undisturbed;
