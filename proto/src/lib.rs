//! Everything that crosses a wire or reaches a disk in FAM, and the words that all other crates share.
//!
//! This crate does no I/O, reads no clock and starts no task. Its parts:
//!
//! - [`ids`]: names and numbers: controllers, mechatronic components (MCs), epochs, scans, boots, agents.
//! - [`now`]: time as an argument.
//! - [`access`]: the narrow interface between an MC Agent and its MC.
//! - [`agent`]: the interface of every state machine in FAM.
//! - [`codec`]: the one module that knows the binary format (bincode), its limits and its version check.
//! - [`keys`]: Zenoh key expressions as text.
//! - [`mark`]: how moments and growing numbers are hashed, for whoever explores states.
//! - [`v1`]: the frozen wire and disk types of version 1: frames, input images, records, messages, events.
//! - [`delta`]: how a checkpoint is told as a difference to an earlier one.
//! - [`diagnosis`]: masks over a serialized state, and the decision that they lead to.
//! - [`model`]: what a generated cell looks like to the processes that run it.

pub mod access;
pub mod agent;
pub mod codec;
pub mod delta;
pub mod diagnosis;
pub mod ids;
pub mod keys;
pub mod mark;
pub mod model;
pub mod now;
pub mod v1;

pub use agent::Agent;
pub use ids::*;
pub use now::Now;
pub use v1::*;
