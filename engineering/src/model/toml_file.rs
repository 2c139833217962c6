//! The text form of a cell: what stands in `cell.toml`, as it stands there, with the place of everything that can be wrong.
//!
//! Times are in milliseconds and shares in percent, as people write them; [`super::resolve`] turns them into the units of
//! the rest of the program.

use serde::Deserialize;
use std::collections::BTreeMap;
use toml::Spanned;

/// Version of the form that this build reads.
pub const FORMAT: i64 = 1;

/// The whole file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellFile {
    /// Version of the form.
    pub format: Spanned<i64>,
    /// The cell itself.
    pub cell: CellTable,
    /// Settings of the agents.
    #[serde(default)]
    pub settings: SettingsTable,
    /// Gateways.
    #[serde(default)]
    pub gateway: Vec<Spanned<GatewayTable>>,
    /// Controllers.
    #[serde(default)]
    pub controller: Vec<Spanned<ControllerTable>>,
    /// Mechatronic components.
    #[serde(default)]
    pub mc: Vec<Spanned<McTable>>,
}

/// `[cell]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CellTable {
    /// Name of the cell.
    pub name: Spanned<String>,
    /// Scan tick of nodes and gateways.
    #[serde(default = "default_tick_ms")]
    pub tick_ms: Spanned<f64>,
    /// Throughput of the slowest link between nodes and gateway, if frames are to be held against it.
    pub link_mbit_s: Option<Spanned<f64>>,
}

fn default_tick_ms() -> Spanned<f64> {
    Spanned::new(0..0, 5.0)
}

/// `[settings]`: all keys optional, defaults as in `fam_proto::model::Settings`.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsTable {
    pub report_ms: Option<Spanned<f64>>,
    pub report_lost_ms: Option<Spanned<f64>>,
    pub bids_ms: Option<Spanned<f64>>,
    pub activation_ms: Option<Spanned<f64>>,
    pub release_ms: Option<Spanned<f64>>,
    pub spread_percent: Option<Spanned<f64>>,
    pub gain_percent: Option<Spanned<f64>>,
    pub balance_hold_ms: Option<Spanned<f64>>,
    pub balance_pause_ms: Option<Spanned<f64>>,
}

/// `[[gateway]]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GatewayTable {
    pub name: Spanned<String>,
    /// `modbus` or `image`.
    pub driver: Spanned<String>,
    /// Host and port of the field device, `modbus` only.
    pub address: Option<Spanned<String>>,
}

/// `[[controller]]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ControllerTable {
    pub name: Spanned<String>,
    #[serde(default)]
    pub description: String,
    /// Speed relative to the reference controller.
    pub cpu_factor: Option<Spanned<f64>>,
    /// Memory for MCs.
    pub memory_mb: Option<Spanned<f64>>,
    /// Share of its cycle that it may spend on MCs.
    pub limit_percent: Option<Spanned<f64>>,
}

/// `hosts = "all"` or a list of controllers.
#[derive(Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "this is neither \"all\" nor a list of controllers in [ ]"
)]
pub enum Hosts {
    /// `"all"`; another word is reported with its place.
    Word(String),
    /// Names.
    List(Vec<String>),
}

/// `[[mc]]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct McTable {
    pub name: Spanned<String>,
    /// Name of the main PROGRAM, if it is not the MC's.
    pub program: Option<Spanned<String>>,
    /// Files of its logic, relative to the file.
    pub logic: Spanned<Vec<Spanned<String>>>,
    pub gateway: Spanned<String>,
    pub hosts: Option<Spanned<Hosts>>,
    #[serde(default)]
    pub criticality: u32,
    pub cycle_ms: Option<Spanned<f64>>,
    pub worst_case_us: Spanned<u32>,
    pub watchdog_ms: Option<Spanned<f64>>,
    pub suspect_ms: Option<Spanned<f64>>,
    /// POU that stops the MC safely.
    pub stop: Option<Spanned<String>>,
    /// The variables that are state, if not all of them are.
    pub state: Option<Vec<Spanned<String>>>,
    #[serde(default)]
    pub inputs: BTreeMap<Spanned<String>, Spanned<String>>,
    #[serde(default)]
    pub outputs: BTreeMap<Spanned<String>, Spanned<OutputTable>>,
    #[serde(default)]
    pub critical_interval: Vec<Spanned<IntervalTable>>,
}

/// What an output drives.
#[derive(Debug, Deserialize)]
#[serde(
    deny_unknown_fields,
    expecting = "a table: { field = \"...\", fail_safe = ... }"
)]
pub struct OutputTable {
    /// Field point, such as `modbus:1/coil/0`.
    pub field: Option<Spanned<String>>,
    /// Whether other MCs may read it.
    #[serde(default)]
    pub export: bool,
    /// The value that it gets when nobody drives it.
    pub fail_safe: Option<Spanned<toml::Value>>,
}

/// `[[mc.critical_interval]]`
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IntervalTable {
    pub name: Spanned<String>,
    /// ST expression over the state.
    pub condition: Spanned<String>,
    /// `checkpoint` or `unrecoverable`.
    pub kind: Spanned<String>,
    /// POU of the recovery action.
    pub recovery: Option<Spanned<String>>,
    /// Whether an interrupted action may be gone on with.
    #[serde(default)]
    pub repeatable: bool,
    /// Values that Deserialize lays over the state.
    #[serde(default)]
    pub checkpoint_state: BTreeMap<Spanned<String>, Spanned<toml::Value>>,
}
