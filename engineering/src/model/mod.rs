//! The cell model as its engineer wrote it: read from `cell.toml` or AutomationML, names and references resolved, units converted.
//!
//! Nothing here knows the logic; what the model says of variables is held against the logic in [`mod@crate::build`].

pub mod open;
pub mod points;
pub mod resolve;
mod resolve_mc;
pub mod toml_file;
pub mod toml_text;

use crate::problem::ModelText;
use fam_proto::diagnosis::IntervalKind;
use fam_proto::model::{ControllerModel, FieldPoint, GatewayModel, Settings};
use fam_proto::{CellId, ControllerId, GatewayId, McId};
use std::ops::Range;
use toml::Spanned;

/// A resolved cell. Parts that could not be resolved are missing; the problems say so.
#[derive(Debug)]
pub struct Cell {
    /// The file, for later problems.
    pub text: ModelText,
    /// Name of the cell.
    pub cell: CellId,
    /// Tick of nodes and gateways, in microseconds.
    pub tick_us: u32,
    /// Throughput of the slowest link in bytes per second, with its place in the file.
    pub link_bytes_s: Option<Spanned<u64>>,
    /// Settings of the agents.
    pub settings: Settings,
    /// Gateways, by name.
    pub gateways: Vec<GatewayModel>,
    /// Controllers, by name.
    pub controllers: Vec<ControllerModel>,
    /// Mechatronic components, by name.
    pub mcs: Vec<McSpec>,
}

/// A mechatronic component as modelled.
#[derive(Debug)]
pub struct McSpec {
    /// Name, with its place.
    pub mc: McId,
    /// Place of the name.
    pub at: Range<usize>,
    /// Main PROGRAM.
    pub program: Spanned<String>,
    /// Files of its logic, relative to the model.
    pub logic: Vec<Spanned<String>>,
    /// Its gateway; `None` if that is unknown (reported).
    pub gateway: Option<GatewayId>,
    /// Controllers that host it.
    pub hosts: Vec<ControllerId>,
    /// Higher is placed first when capacity is short.
    pub criticality: u32,
    /// Cycle in microseconds.
    pub cycle_us: u32,
    /// Declared worst-case scan time at CPU factor 1.0.
    pub worst_case_us: u32,
    /// Watchdog at the gateway.
    pub watchdog_us: u64,
    /// Silence that the gateway reports.
    pub suspect_us: u64,
    /// Stop POU.
    pub stop: Option<Spanned<String>>,
    /// The variables that are state, if not all of them are.
    pub state: Option<Vec<Spanned<String>>>,
    /// Inputs, by variable name.
    pub inputs: Vec<InputSpec>,
    /// Outputs, by variable name.
    pub outputs: Vec<OutputSpec>,
    /// Critical intervals in the order of the file.
    pub intervals: Vec<IntervalSpec>,
}

impl McSpec {
    /// An output by its variable's name (IEC names ignore case).
    #[must_use]
    pub fn output(&self, name: &str) -> Option<&OutputSpec> {
        self.outputs
            .iter()
            .find(|o| o.name.get_ref().eq_ignore_ascii_case(name))
    }
}

/// Where an input comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum InputFrom {
    /// A field device.
    Field(FieldPoint),
    /// An exported variable of another MC.
    Export {
        /// The MC.
        mc: McId,
        /// Its output variable.
        variable: String,
    },
}

/// An input.
#[derive(Debug)]
pub struct InputSpec {
    /// Variable.
    pub name: Spanned<String>,
    /// Source; `None` if it could not be read (reported).
    pub from: Option<InputFrom>,
    /// Place of the source.
    pub at: Range<usize>,
}

/// An output.
#[derive(Debug)]
pub struct OutputSpec {
    /// Variable.
    pub name: Spanned<String>,
    /// Field point, with its place.
    pub field: Option<Spanned<FieldPoint>>,
    /// Whether other MCs may read it.
    pub export: bool,
    /// Fail-safe value.
    pub fail_safe: Option<Spanned<toml::Value>>,
}

/// A critical interval.
#[derive(Debug)]
pub struct IntervalSpec {
    /// Name.
    pub name: Spanned<String>,
    /// Condition in ST.
    pub condition: Spanned<String>,
    /// Kind.
    pub kind: IntervalKind,
    /// POU of its action: the recovery, or for an unrecoverable interval without one the stop POU.
    pub recovery: Spanned<String>,
    /// Whether an interrupted action may be gone on with.
    pub repeatable: bool,
    /// Checkpoint state: state variable and value.
    pub checkpoint_state: Vec<(Spanned<String>, Spanned<toml::Value>)>,
}
