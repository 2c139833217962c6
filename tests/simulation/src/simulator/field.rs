//! The field: inputs that change with time for invented cells, the real plant step for delivered cells.

use super::cell::{Cell, McInfo};
use super::logic::Logic;
use fam_gateway_core::place;
use fam_plant_core::{PlantConfig, machine};
use fam_proto::McInputs;
use fam_proto::model::{FieldPoint, InputSource, ModbusTable};
use std::collections::BTreeMap;

/// The plant's own step, in microseconds: no finer than this it is moved on.
const PLANT_STEP_US: u64 = 1_000;

/// The field.
pub(super) struct Field {
    /// Nothing real: inputs count on.
    reads: u64,
    /// First input byte that makes an MC's logic trap.
    pub traps: BTreeMap<usize, u8>,
    /// The mechanics, for delivered cells.
    plant: Option<Mechanics>,
}

struct Mechanics {
    plant: Box<dyn fam_plant_core::Mechanics>,
    at_us: u64,
}

impl Mechanics {
    fn go_on(&mut self, now_us: u64) {
        let whole_us = (now_us - self.at_us) / PLANT_STEP_US * PLANT_STEP_US;
        if whole_us > 0 {
            self.plant.step(whole_us);
            self.at_us += whole_us;
        }
    }
}

impl Field {
    pub(super) fn invented() -> Field {
        Field {
            reads: 0,
            traps: BTreeMap::new(),
            plant: None,
        }
    }

    /// A machine that is simulated in earnest.
    pub(super) fn of(config: PlantConfig) -> Field {
        let plant = machine(config).expect("the plant's own configuration");
        Field {
            plant: Some(Mechanics { plant, at_us: 0 }),
            ..Field::invented()
        }
    }

    /// Inputs of all MCs as they are now.
    pub(super) fn read(&mut self, cell: &Cell, fresh: bool, now_us: u64) -> Vec<McInputs> {
        self.reads += 1;
        if let Some(mechanics) = &mut self.plant {
            mechanics.go_on(now_us);
            mechanics.plant.heard();
        }
        let mcs = cell.mcs.iter().enumerate();
        mcs.map(|(n, info)| McInputs {
            mc: info.mc.clone(),
            bytes: match &self.plant {
                Some(mechanics) => sensed(mechanics.plant.as_ref(), info),
                None => self.counted(n, info),
            },
            fresh,
        })
        .collect()
    }

    fn counted(&self, n: usize, info: &McInfo) -> Vec<u8> {
        let mut bytes = vec![0; info.model.inputs_len as usize];
        let value = self.reads.wrapping_mul(7) + n as u64;
        match &info.logic {
            Logic::Model { .. } => {
                bytes[0] = u8::try_from(value % 200).unwrap_or(0);
                bytes[1] = u8::try_from(value / 200 % 256).unwrap_or(0);
                if let Some(trap) = self.traps.get(&n) {
                    bytes[0] = *trap;
                }
            }
            // Sensors that come and go at speeds of their own.
            Logic::Plc(_) => {
                for (at, byte) in bytes.iter_mut().enumerate() {
                    let turn = value.wrapping_mul(0x9E37_79B9) >> (at % 7 + 9);
                    *byte = u8::try_from(turn % 256).unwrap_or(0);
                }
            }
        }
        bytes
    }

    /// Outputs of an MC reach the field.
    pub(super) fn write(
        &mut self,
        info: &McInfo,
        outputs: &[u8],
        now_us: u64,
    ) -> Result<(), String> {
        let Some(mechanics) = &mut self.plant else {
            return Ok(());
        };
        mechanics.go_on(now_us);
        mechanics.plant.heard();
        for output in &info.model.outputs {
            let Some(FieldPoint::Modbus {
                unit,
                table,
                address,
            }) = &output.field
            else {
                continue;
            };
            let value = place::get(outputs, output.place).unwrap_or(0);
            let written = match table {
                ModbusTable::Coil => mechanics.plant.write_coil(*unit, *address, value != 0),
                _ => {
                    let value = u16::try_from(value & 0xFFFF).unwrap_or(0);
                    mechanics
                        .plant
                        .write_holding_register(*unit, *address, value)
                }
            };
            written.map_err(|error| format!("{} of {}: {error}", output.name, info.mc))?;
        }
        Ok(())
    }

    /// What the plant has suffered, and the last of it in words; `None`: there is no plant.
    pub(super) fn incidents(&self) -> Option<(u64, Option<String>)> {
        let plant = &self.plant.as_ref()?.plant;
        let last = plant.incidents().last().map(|i| format!("{i:?}"));
        Some((plant.incidents_total(), last))
    }

    /// Products that the plant has finished.
    pub(super) fn products(&self) -> u64 {
        self.plant.as_ref().map_or(0, |m| m.plant.finished())
    }
}

fn sensed(plant: &dyn fam_plant_core::Mechanics, info: &McInfo) -> Vec<u8> {
    let mut bytes = vec![0; info.model.inputs_len as usize];
    for input in &info.model.inputs {
        let InputSource::Field(FieldPoint::Modbus {
            unit,
            table,
            address,
        }) = &input.source
        else {
            continue; // exports are the gateway's
        };
        let Ok(unit) = plant.image(*unit) else {
            continue;
        };
        let value = match table {
            ModbusTable::DiscreteInput => u64::from(unit.discrete_input(*address)),
            _ => u64::from(unit.input_register(*address)),
        };
        place::set(&mut bytes, input.place, value);
    }
    bytes
}
