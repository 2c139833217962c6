//! Engineering of a cell: from `cell.toml` and its IEC 61131-3 logic to everything that runs.
//!
//! - [`model`]: what the engineer wrote, read and resolved.
//! - [`generate`]: the three POUs of each MC: Control, Serialize, Deserialize.
//! - [`masks`]: conditions of critical intervals as masks over the serialized state.
//! - [`mod@build`]: all of it together: model, modules, masks; every problem at once.
//! - [`control`]: where a checkpoint keeps its control variables.
//! - [`plcopen`]: Flexible Automation Projects and diagnosis files.
//! - [`deployment`]: how a cell is brought up on one machine.
//! - [`problem`]: how problems are told.

pub mod build;
pub mod control;
pub mod deployment;
pub mod generate;
mod intervals;
mod io;
mod logic;
pub mod masks;
pub mod model;
pub mod plcopen;
pub mod problem;
mod values;

pub use build::{BuiltCell, BuiltMc, build, build_model};
pub use control::{ControlLayout, ControlState};
pub use deployment::{Deployment, DeploymentFile};
pub use plcopen::write_projects;
pub use problem::Problems;
