//! Exhaustive check of the core protocol on the smallest cell that has it all: two controllers, one MC, a manager, a gateway.
//!
//! The agents and the gateway's core are the real ones. What is modelled is what lies around them: a network that delays,
//! reorders and repeats without bound (a message that never arrives is one that is delayed for ever), clocks that go on each on
//! its own, disks that keep what they have confirmed, and a scan thread reduced to what the chain of frames needs ([`plc`]).
//! One crash at any moment (also between two outputs), one restart, one cut of any connection.
//!
//! An own explorer, in breadth, over the idea of `stateright`: that crate wants whole states to be hashed and kept, and its
//! liveness is unsound on cycles; here states are the same if they differ in absolute times and numbers only ([`canon`]), parts
//! that do not change are shared, and liveness is decided on the graph when it is complete ([`mod@explore`]).
//!
//! - [`cell`]: the cell, and the state from which everything is explored.
//! - [`state`]: a state of the world; [`step`]: what can happen next and what comes of it.
//! - [`properties`]: what must hold after every step.

pub mod action;
pub mod canon;
pub mod cell;
mod clocks;
pub mod explore;
mod lives;
pub mod network;
mod outputs;
pub mod plc;
pub mod properties;
pub mod scenarios;
pub mod state;
pub mod step;

pub use explore::{Bounds, Report, explore};
pub use state::{Bug, Faults, Kind, State};
