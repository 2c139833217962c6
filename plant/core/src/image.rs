//! The process image of one unit, as Modbus sees it.

use thiserror::Error;

/// Number of discrete inputs of each unit.
pub const DISCRETE_INPUTS: u16 = 48;
/// Number of coils of each unit.
pub const COILS: u16 = 32;
/// Number of input registers of each unit.
pub const INPUT_REGISTERS: u16 = 8;
/// Number of holding registers of each unit.
pub const HOLDING_REGISTERS: u16 = 4;

/// A controller asked for something that the cell does not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum AddressError {
    #[error("there is no unit {unit}: the cell has units 1 (base) to 5 (transport)")]
    Unit { unit: u8 },
    #[error("there is no unit {unit}: the machine has unit 1 only")]
    OneUnit { unit: u8 },
    #[error("unit {unit} has no {table} {address}: the last one is {last}")]
    Address {
        unit: u8,
        table: &'static str,
        address: u16,
        last: u16,
    },
}

/// Inputs and outputs of one unit. Bit `n` of a bit field is address `n`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct UnitImage {
    pub discrete_inputs: u64,
    pub coils: u32,
    pub input_registers: [u16; INPUT_REGISTERS as usize],
    pub holding_registers: [u16; HOLDING_REGISTERS as usize],
}

impl UnitImage {
    pub fn discrete_input(&self, address: u16) -> bool {
        address < DISCRETE_INPUTS && self.discrete_inputs >> address & 1 == 1
    }

    pub fn coil(&self, address: u16) -> bool {
        address < COILS && self.coils >> address & 1 == 1
    }

    /// Value of an input register; 0 beyond the last one.
    pub fn input_register(&self, address: u16) -> u16 {
        self.input_registers
            .get(usize::from(address))
            .copied()
            .unwrap_or(0)
    }

    /// Value of a holding register; 0 beyond the last one.
    pub fn holding_register(&self, address: u16) -> u16 {
        self.holding_registers
            .get(usize::from(address))
            .copied()
            .unwrap_or(0)
    }

    pub(crate) fn sense(&mut self, address: u16, on: bool) {
        let bit = 1_u64 << address;
        if on {
            self.discrete_inputs |= bit;
        } else {
            self.discrete_inputs &= !bit;
        }
    }

    pub(crate) fn measure(&mut self, address: u16, value: u16) {
        self.input_registers[usize::from(address)] = value;
    }

    pub(crate) fn set_coil(&mut self, address: u16, on: bool) {
        let bit = 1_u32 << address;
        if on {
            self.coils |= bit;
        } else {
            self.coils &= !bit;
        }
    }
}
