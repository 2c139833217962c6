//! The five agents of FAM as pure state machines, and the planner (design, sections 5 to 8).
//!
//! - [`node`]: a controller node's agents: [`controller`] (Controller Agent) and [`component`] (one MC Agent for each MC).
//! - [`manager`]: the manager's agents: Middleware Manager, with [`monitor`] (QoS Monitors) and [`decision`] (Diagnosis & Decision);
//!   what they know of the cell is [`cell_view`], the epochs that they give out are [`epochs`].
//! - [`planner`]: which MC goes on which controller.

pub mod cell_view;
pub mod component;
pub mod controller;
pub mod decision;
pub mod epochs;
pub mod manager;
pub mod monitor;
pub mod node;
#[cfg(test)]
mod node_tests;
pub mod planner;
pub mod unfit;
