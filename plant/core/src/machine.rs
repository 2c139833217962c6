//! What every simulated machine is to those who drive it: time, process images, and what went wrong.

use serde::{Deserialize, Serialize};

use crate::image::{AddressError, UnitImage};
use crate::incident::Incident;
use crate::marking::MarkingMachine;
use crate::plant::{ConfigError, Plant, PlantConfig};
use crate::records::{Ledger, Product};

/// Which machine is simulated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MachineKind {
    /// The FMS-200 assembly cell.
    #[default]
    Fms200,
    /// The marking machine.
    Marking,
}

impl MachineKind {
    /// All of them.
    pub const ALL: [MachineKind; 2] = [MachineKind::Fms200, MachineKind::Marking];

    /// Its name, as in a configuration.
    pub fn name(self) -> &'static str {
        match self {
            MachineKind::Fms200 => "fms200",
            MachineKind::Marking => "marking",
        }
    }

    /// The machine of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        MachineKind::ALL.into_iter().find(|m| m.name() == name)
    }
}

/// A simulated machine behind Modbus units.
pub trait Mechanics: Send {
    /// Lets simulated time pass; a rest below a tick is kept for the next call.
    fn step(&mut self, dt_us: u64);
    /// Simulated time since power-up.
    fn now_us(&self) -> u64;
    fn config(&self) -> PlantConfig;
    /// Somebody has asked or told the machine something: its bus is alive.
    fn heard(&mut self) {}
    /// Inputs and outputs of a unit.
    fn image(&self, unit: u8) -> Result<&UnitImage, AddressError>;
    /// Writes neighbouring coils; all or none.
    fn write_coils(&mut self, unit: u8, address: u16, values: &[bool]) -> Result<(), AddressError>;
    /// Writes neighbouring holding registers; all or none.
    fn write_holding_registers(
        &mut self,
        unit: u8,
        address: u16,
        values: &[u16],
    ) -> Result<(), AddressError>;
    /// Incidents with their cause, the first 1000 of them.
    fn incidents(&self) -> &[Incident];
    /// Number of all incidents.
    fn incidents_total(&self) -> u64;
    /// Where everything went.
    fn ledger(&self) -> Ledger;
    /// Products finished.
    fn finished(&self) -> u64;
    /// Products one by one, of machines that keep account of them.
    fn products(&self) -> &[Product] {
        &[]
    }

    fn write_coil(&mut self, unit: u8, address: u16, on: bool) -> Result<(), AddressError> {
        self.write_coils(unit, address, &[on])
    }

    fn write_holding_register(
        &mut self,
        unit: u8,
        address: u16,
        value: u16,
    ) -> Result<(), AddressError> {
        self.write_holding_registers(unit, address, &[value])
    }
}

/// The machine that a configuration asks for.
pub fn machine(config: PlantConfig) -> Result<Box<dyn Mechanics>, ConfigError> {
    Ok(match config.machine {
        MachineKind::Fms200 => Box::new(Plant::new(config)?),
        MachineKind::Marking => Box::new(MarkingMachine::new(config)),
    })
}

impl Mechanics for Plant {
    fn step(&mut self, dt_us: u64) {
        Plant::step(self, dt_us);
    }
    fn now_us(&self) -> u64 {
        Plant::now_us(self)
    }
    fn config(&self) -> PlantConfig {
        Plant::config(self)
    }
    fn image(&self, unit: u8) -> Result<&UnitImage, AddressError> {
        Plant::image(self, unit)
    }
    fn write_coils(&mut self, unit: u8, address: u16, values: &[bool]) -> Result<(), AddressError> {
        Plant::write_coils(self, unit, address, values)
    }
    fn write_holding_registers(
        &mut self,
        unit: u8,
        address: u16,
        values: &[u16],
    ) -> Result<(), AddressError> {
        Plant::write_holding_registers(self, unit, address, values)
    }
    fn incidents(&self) -> &[Incident] {
        Plant::incidents(self)
    }
    fn incidents_total(&self) -> u64 {
        Plant::incidents_total(self)
    }
    fn ledger(&self) -> Ledger {
        Plant::ledger(self)
    }
    fn finished(&self) -> u64 {
        Plant::products(self).len() as u64
    }
    fn products(&self) -> &[Product] {
        Plant::products(self)
    }
}
