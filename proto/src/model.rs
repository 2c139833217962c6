//! What a generated cell looks like to the processes that run it. `engineering` makes it; agents, gateway and nodes read it.

use crate::diagnosis::Diagnosis;
use crate::ids::{CellId, ControllerId, GatewayId, McId};
use crate::v1::LayoutHash;
use serde::{Deserialize, Serialize};

/// A whole cell.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CellModel {
    /// Its name.
    pub cell: CellId,
    /// Controllers, by name.
    pub controllers: Vec<ControllerModel>,
    /// MCs, by name.
    pub mcs: Vec<McModel>,
    /// Gateways, by name.
    pub gateways: Vec<GatewayModel>,
    /// Settings of the agents.
    pub settings: Settings,
}

/// A controller.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ControllerModel {
    /// Its name.
    pub controller: ControllerId,
    /// For people.
    pub description: String,
    /// Speed relative to the reference controller, in permille.
    pub cpu_factor_permille: u32,
    /// Memory for MCs, in kB.
    pub memory_kb: u64,
    /// Share of its cycle that it may spend on MCs, in permille.
    pub limit_permille: u32,
    /// Tick of its scan thread, in microseconds.
    pub tick_us: u32,
}

/// An MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct McModel {
    /// Its name.
    pub mc: McId,
    /// The gateway that serves all its inputs and outputs.
    pub gateway: GatewayId,
    /// Controllers that host it.
    pub hosts: Vec<ControllerId>,
    /// Higher is placed first when capacity is short.
    pub criticality: u32,
    /// Its cycle, a multiple of the tick, in microseconds.
    pub cycle_us: u32,
    /// Declared worst-case scan time at CPU factor 1.0, in microseconds.
    pub worst_case_us: u32,
    /// Memory of an instance, in kB.
    pub memory_kb: u64,
    /// Without a valid frame for this long the gateway sets the fail-safe values, in microseconds.
    pub watchdog_us: u64,
    /// Without a valid frame for this long the gateway reports silence, in microseconds.
    pub suspect_us: u64,
    /// Hash of logic, layout and masks.
    pub hash: u64,
    /// Layout of its checkpoint.
    pub layout: LayoutHash,
    /// Its diagnosis file.
    pub diagnosis: Diagnosis,
    /// Its input image.
    pub inputs: Vec<InputPoint>,
    /// Length of the input image, in bytes.
    pub inputs_len: u32,
    /// Its output image.
    pub outputs: Vec<OutputPoint>,
    /// Fail-safe values: an output image.
    pub fail_safe: Vec<u8>,
}

/// How long a state may grow by new versions of the logic where it has this length at the gateway's start, in bytes: so much room
/// its record has on disk.
#[must_use]
pub const fn state_room(checkpoint_len: usize) -> usize {
    checkpoint_len + checkpoint_len / 2 + 4_096
}

/// A place in an MC's process image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Place {
    /// One bit of a byte.
    Bit {
        /// Byte in the image.
        byte: u32,
        /// Bit in the byte, 0 is the lowest.
        bit: u8,
    },
    /// Whole bytes, little endian.
    Bytes {
        /// First byte in the image.
        byte: u32,
        /// 1, 2, 4 or 8.
        width: u8,
    },
}

/// A point of a field device.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum FieldPoint {
    /// Modbus.
    Modbus {
        /// Unit identifier.
        unit: u8,
        /// Table.
        table: ModbusTable,
        /// Address, 0-based. Values wider than 16 bits take the following registers, low word first.
        address: u16,
    },
    /// A point of the `image` driver: its name.
    Image(String),
}

/// Modbus tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum ModbusTable {
    /// 1 bit, read only.
    DiscreteInput,
    /// 1 bit, written.
    Coil,
    /// 16 bits, read only.
    InputRegister,
    /// 16 bits, written.
    HoldingRegister,
}

/// Where an input comes from.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum InputSource {
    /// A field device.
    Field(FieldPoint),
    /// An exported variable: an output of another MC, visible once applied; at another gateway a cycle later.
    Export {
        /// The MC that exports it.
        mc: McId,
        /// Where it lies in that MC's output image.
        place: Place,
    },
}

/// How the bits of a point are read as a number.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Number {
    /// BOOL, bit strings, unsigned integers, and all that is no number.
    #[default]
    Unsigned,
    /// Signed integers.
    Signed,
    /// REAL and LREAL.
    Real,
}

/// One input of an MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct InputPoint {
    /// Variable name in the logic.
    pub name: String,
    /// Where it lies in the input image.
    pub place: Place,
    /// How its bits are read.
    pub number: Number,
    /// Where it comes from.
    pub source: InputSource,
}

/// One output of an MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct OutputPoint {
    /// Variable name in the logic.
    pub name: String,
    /// Where it lies in the output image.
    pub place: Place,
    /// How its bits are read.
    pub number: Number,
    /// The field point that it drives; `None` for an export.
    pub field: Option<FieldPoint>,
}

/// A gateway.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct GatewayModel {
    /// Its name.
    pub gateway: GatewayId,
    /// Its cycle, in microseconds.
    pub tick_us: u32,
    /// Which field driver.
    pub driver: FieldDriver,
}

/// Field drivers.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum FieldDriver {
    /// Modbus TCP client of one device (with several units).
    Modbus {
        /// Host and port.
        address: String,
    },
    /// No device: values are set and read with `fam io`.
    Image,
}

/// Settings of agents and monitors, all with defaults in the cell model.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Settings {
    /// Interval of resource reports, in microseconds.
    pub report_us: u64,
    /// A controller without a report for this long counts as lost, in microseconds.
    pub report_lost_us: u64,
    /// How long bids are waited for, in microseconds.
    pub bids_us: u64,
    /// How long an activation may take until its first applied frame, in microseconds.
    pub activation_us: u64,
    /// How long a release may wait for a non-critical state, in microseconds.
    pub release_us: u64,
    /// Work balance: spread of workloads that is tolerated, in permille of the limit.
    pub spread_permille: u32,
    /// Work balance: what a plan has to gain at least, in permille.
    pub gain_permille: u32,
    /// Work balance: how long an imbalance has to last, in microseconds.
    pub balance_hold_us: u64,
    /// Work balance: pause after a plan, in microseconds.
    pub balance_pause_us: u64,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            report_us: 100_000,
            report_lost_us: 600_000,
            bids_us: 20_000,
            activation_us: 500_000,
            release_us: 5_000_000,
            spread_permille: 250,
            gain_permille: 50,
            balance_hold_us: 500_000,
            balance_pause_us: 2_000_000,
        }
    }
}

impl CellModel {
    /// The model of an MC.
    #[must_use]
    pub fn mc(&self, mc: &McId) -> Option<&McModel> {
        self.mcs.iter().find(|m| &m.mc == mc)
    }
    /// The model of a controller.
    #[must_use]
    pub fn controller(&self, controller: &ControllerId) -> Option<&ControllerModel> {
        self.controllers
            .iter()
            .find(|c| &c.controller == controller)
    }
}
