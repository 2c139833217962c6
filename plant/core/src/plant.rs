//! The whole cell: five units, their process images, the orders, and the tick.

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::closing::ClosingStation;
use crate::feeding::FeedingStation;
use crate::fitting::FittingStation;
use crate::image::{AddressError, COILS, HOLDING_REGISTERS, UnitImage};
use crate::incident::Incident;
use crate::machine::MachineKind;
use crate::order::Variant;
use crate::records::{Ledger, PartPlaces, Product, Records};
use crate::signals::{CLOCK, transport as at};
use crate::storage::StorageStation;
use crate::transport::{PALLETS_THAT_FIT, Transport};

/// The mechanics advance in ticks of this length.
pub const TICK_US: u32 = 1_000;
/// Number of Modbus units: four stations and the transport.
pub const UNITS: u8 = 5;
/// The most pallets that the loop takes.
pub const PALLETS_MAX: u8 = PALLETS_THAT_FIT;

const TRANSPORT: usize = 4;

/// What a cell is set up with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlantConfig {
    /// Which machine is simulated.
    pub machine: MachineKind,
    /// Decides what parts come out of the magazines and what is ordered.
    pub seed: u64,
    /// Pallets on the loop, 1 to [`PALLETS_MAX`].
    pub pallets: u8,
    /// Number of orders, at least 1.
    pub orders: u16,
}

impl Default for PlantConfig {
    fn default() -> Self {
        PlantConfig {
            machine: MachineKind::Fms200,
            seed: 200,
            pallets: 5,
            orders: u16::MAX,
        }
    }
}

/// A cell that cannot be set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ConfigError {
    #[error("the plant has pallets = {0}, but the loop takes 1 to {PALLETS_MAX}")]
    Pallets(u8),
    #[error(
        "the plant has orders = 0: give at least 1, or leave it out for as many as there can be"
    )]
    Orders,
}

/// The simulated cell.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Plant {
    config: PlantConfig,
    /// Time that has been given to [`Plant::step`] but does not fill a tick yet.
    remainder_us: u64,
    images: [UnitImage; UNITS as usize],
    feeding: FeedingStation,
    fitting: FittingStation,
    closing: ClosingStation,
    storage: StorageStation,
    transport: Transport,
    records: Records,
}

impl Plant {
    pub fn new(config: PlantConfig) -> Result<Self, ConfigError> {
        if !(1..=PALLETS_MAX).contains(&config.pallets) {
            return Err(ConfigError::Pallets(config.pallets));
        }
        if config.orders == 0 {
            return Err(ConfigError::Orders);
        }
        let mut plant = Plant {
            config,
            remainder_us: 0,
            images: Default::default(),
            feeding: FeedingStation::new(),
            fitting: FittingStation::new(),
            closing: ClosingStation::new(),
            storage: StorageStation::new(),
            transport: Transport::new(config.pallets),
            records: Records::new(config.seed),
        };
        // The inputs must be right before the first tick: a controller may read them at once.
        plant.tick();
        Ok(plant)
    }

    /// Lets simulated time pass; a rest below a tick is kept for the next call.
    pub fn step(&mut self, dt_us: u64) {
        self.remainder_us += dt_us;
        while self.remainder_us >= u64::from(TICK_US) {
            self.remainder_us -= u64::from(TICK_US);
            self.tick();
        }
    }

    /// Simulated time since power-up.
    pub fn now_us(&self) -> u64 {
        self.records.now_us
    }

    pub fn config(&self) -> PlantConfig {
        self.config
    }

    /// Inputs and outputs of a unit, 1 to 5.
    pub fn image(&self, unit: u8) -> Result<&UnitImage, AddressError> {
        Ok(&self.images[unit_index(unit)?])
    }

    pub fn write_coil(&mut self, unit: u8, address: u16, on: bool) -> Result<(), AddressError> {
        self.write_coils(unit, address, &[on])
    }

    /// Writes neighbouring coils; all or none.
    pub fn write_coils(
        &mut self,
        unit: u8,
        address: u16,
        values: &[bool],
    ) -> Result<(), AddressError> {
        let index = unit_index(unit)?;
        check_range(unit, "coil", address, values.len(), COILS)?;
        for (offset, on) in (0..).zip(values) {
            self.images[index].set_coil(address + offset, *on);
        }
        Ok(())
    }

    pub fn write_holding_register(
        &mut self,
        unit: u8,
        address: u16,
        value: u16,
    ) -> Result<(), AddressError> {
        self.write_holding_registers(unit, address, &[value])
    }

    /// Writes neighbouring holding registers; all or none. A new `T_OrderTaken` shows the next order at once.
    pub fn write_holding_registers(
        &mut self,
        unit: u8,
        address: u16,
        values: &[u16],
    ) -> Result<(), AddressError> {
        let index = unit_index(unit)?;
        check_range(
            unit,
            "holding register",
            address,
            values.len(),
            HOLDING_REGISTERS,
        )?;
        let first = usize::from(address);
        self.images[index].holding_registers[first..first + values.len()].copy_from_slice(values);
        self.show_order();
        Ok(())
    }

    /// Incidents with their cause, the first 1000 of them.
    pub fn incidents(&self) -> &[Incident] {
        &self.records.incidents
    }

    /// Number of all incidents.
    pub fn incidents_total(&self) -> u64 {
        self.records.incidents_total
    }

    /// Where all parts went, with those in the cell counted where they lie.
    pub fn ledger(&self) -> Ledger {
        Ledger {
            in_cell: self.parts_in_cell(),
            ..self.records.ledger
        }
    }

    pub fn parts_in_cell(&self) -> PartPlaces {
        let feeding = self
            .feeding
            .feeding_parts()
            .chain(self.fitting.feeding_parts())
            .chain(self.closing.feeding_parts());
        let hands = [
            self.feeding.held(),
            self.fitting.held(),
            self.closing.held(),
        ];
        PartPlaces {
            feeding: feeding.count() as u64,
            held: hands.iter().flatten().count() as u64 + self.storage.held_parts().count() as u64,
            on_pallets: self.transport.parts().count() as u64,
        }
    }

    /// Sets laid into the rack, in that order.
    pub fn products(&self) -> &[Product] {
        &self.records.products
    }

    /// What an order asks for.
    pub fn ordered(&self, number: u16) -> Variant {
        Variant::ordered(self.config.seed, number)
    }

    fn tick(&mut self) {
        self.records.now_us += u64::from(TICK_US);
        let records = &mut self.records;
        let transport = &mut self.transport;
        let [unit1, unit2, unit3, unit4, unit5] = &mut self.images;
        transport.step(unit5, records);
        self.feeding.step(unit1, transport, records);
        self.fitting.step(unit2, transport, records);
        self.closing.step(unit3, transport, records);
        self.storage
            .step(unit4, transport, self.config.orders, records);
        let clock = (self.records.now_us / 1000 % 65_536) as u16;
        for image in &mut self.images {
            image.measure(CLOCK, clock);
        }
        self.show_order();
    }

    fn show_order(&mut self) {
        let image = &mut self.images[TRANSPORT];
        let next = image
            .holding_register(at::ORDER_TAKEN)
            .checked_add(1)
            .filter(|number| *number <= self.config.orders);
        image.measure(at::ORDER_NUMBER, next.unwrap_or(0));
        image.measure(
            at::ORDER_VARIANT,
            next.map_or(0, |number| {
                Variant::ordered(self.config.seed, number).code()
            }),
        );
    }
}

fn unit_index(unit: u8) -> Result<usize, AddressError> {
    if (1..=UNITS).contains(&unit) {
        Ok(usize::from(unit) - 1)
    } else {
        Err(AddressError::Unit { unit })
    }
}

pub(crate) fn check_range(
    unit: u8,
    table: &'static str,
    address: u16,
    count: usize,
    size: u16,
) -> Result<(), AddressError> {
    let end = usize::from(address) + count;
    if end <= usize::from(size) {
        return Ok(());
    }
    let beyond = usize::from(address)
        .max(usize::from(size))
        .min(usize::from(u16::MAX));
    Err(AddressError::Address {
        unit,
        table,
        address: beyond as u16,
        last: size - 1,
    })
}
