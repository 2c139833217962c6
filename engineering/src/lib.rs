//! Engineering of a cell: from its model (AutomationML or `cell.toml`) and its IEC 61131-3 logic to everything that runs.
//!
//! - [`model`]: what the engineer wrote, read and resolved.
//! - [`caex`]: AutomationML files, read into the same model and written.
//! - [`mod@files`]: the files of a model, bounded and confined.
//! - [`import_tables`]: that proposal as the tables of a cell.
//! - [`import`]: a proposal from the logic of an existing PLC project.
//! - [`generate`]: the three POUs of each MC: Control, Serialize, Deserialize.
//! - [`masks`]: conditions of critical intervals as masks over the serialized state.
//! - [`mod@build`]: all of it together: model, modules, masks; every problem at once.
//! - [`control`]: where a checkpoint keeps its control variables.
//! - [`plcopen`]: Flexible Automation Projects and diagnosis files.
//! - [`mod@convert`]: a model from one form into the other.
//! - [`deployment`]: how a cell is brought up on one machine.
//! - [`new_cell`]: a small cell to begin with. [`large_cell`]: one to measure with.
//! - [`output`]: all generated files. [`show`]: a cell as a tree. [`reload`]: two versions of a cell.
//! - [`problem`]: how problems are told.

mod actuators;
pub mod build;
pub mod caex;
pub mod changes;
pub mod control;
pub mod convert;
pub mod deployment;
pub mod files;
pub mod generate;
pub mod import;
mod import_exchange;
pub mod import_tables;
mod intervals;
mod io;
pub mod large_cell;
mod logic;
pub mod masks;
pub mod model;
mod narrow;
pub mod new_cell;
pub mod output;
pub mod plcopen;
pub mod problem;
pub mod reload;
pub mod show;
mod staged;
mod values;
mod writers;

pub use build::{BuiltCell, BuiltMc, build, build_model};
pub use control::{ControlLayout, ControlState};
pub use deployment::{Deployment, DeploymentFile};
pub use plcopen::write_projects;
pub use problem::Problems;
