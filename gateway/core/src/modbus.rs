//! What to read and write of Modbus devices for the MCs of a gateway, without touching any.
//!
//! Inputs are read in as few requests as contiguous addresses allow; addresses in between that the model does not name
//! are never touched. Outputs are written when they differ from what the device holds, neighbours that are owned in one request.

use crate::place;
use fam_proto::model::{CellModel, FieldPoint, InputSource, ModbusTable, Place};
use fam_proto::{GatewayId, McId, McInputs};
use std::collections::BTreeMap;

/// Most bits of one read request (Modbus Application Protocol 1.1b3, 6.1).
pub const READ_BITS_MAX: u16 = 2000;
/// Most registers of one read request (6.3).
pub const READ_REGISTERS_MAX: u16 = 125;
/// Most coils of one write request (6.11).
pub const WRITE_COILS_MAX: usize = 1968;
/// Most registers of one write request (6.12).
pub const WRITE_REGISTERS_MAX: usize = 123;

/// A table of a unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Table {
    /// Unit identifier.
    pub unit: u8,
    /// Which of its tables.
    pub table: ModbusTable,
}

/// Addresses that follow each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Range {
    /// Where.
    pub table: Table,
    /// First address.
    pub address: u16,
    /// How many.
    pub count: u16,
}

fn is_bit(table: ModbusTable) -> bool {
    matches!(table, ModbusTable::DiscreteInput | ModbusTable::Coil)
}

/// Addresses that a value takes: wide values go on in the following registers.
fn words(table: ModbusTable, place: Place) -> u16 {
    if is_bit(table) {
        1
    } else {
        place::width_bits(place).div_ceil(16) as u16
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct InputSlot {
    mc: McId,
    place: Place,
    /// Range and position in it of each word, lowest first: a wide value may reach over the end of a request.
    words: Vec<(usize, usize)>,
}

/// The reads of one cycle, and the way of their values into input images.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReadPlan {
    ranges: Vec<Range>,
    slots: Vec<InputSlot>,
    last: BTreeMap<McId, Vec<u8>>,
}

impl ReadPlan {
    /// The reads for all MCs of a gateway.
    #[must_use]
    pub fn new(cell: &CellModel, gateway: &GatewayId) -> ReadPlan {
        let mut points = Vec::new();
        let mut last = BTreeMap::new();
        for mc in cell.mcs.iter().filter(|mc| &mc.gateway == gateway) {
            for input in &mc.inputs {
                if let InputSource::Field(FieldPoint::Modbus {
                    unit,
                    table,
                    address,
                }) = input.source
                {
                    last.entry(mc.mc.clone())
                        .or_insert_with(|| vec![0; mc.inputs_len as usize]);
                    points.push((Table { unit, table }, address, &mc.mc, input.place));
                }
            }
        }
        let used = points.iter().flat_map(|&(table, address, _, place)| {
            (0..words(table.table, place)).map(move |n| (table, address.saturating_add(n)))
        });
        let ranges = join(used.collect());
        let slots = points
            .iter()
            .map(|&(table, address, mc, place)| InputSlot {
                mc: mc.clone(),
                place,
                words: (0..words(table.table, place))
                    .filter_map(|n| find(&ranges, table, address.saturating_add(n)))
                    .collect(),
            })
            .collect();
        ReadPlan {
            ranges,
            slots,
            last,
        }
    }

    /// What to read, in this order.
    #[must_use]
    pub fn ranges(&self) -> &[Range] {
        &self.ranges
    }

    /// Puts the answers (one for each range; bits as 0 and 1; `None` where the device did not answer) into input images. An MC that
    /// misses an answer keeps its last bytes and is not fresh.
    pub fn take(&mut self, answers: &[Option<Vec<u16>>]) -> Vec<McInputs> {
        let mut fresh: BTreeMap<&McId, bool> = self.last.keys().map(|mc| (mc, true)).collect();
        let mut next = self.last.clone();
        for slot in &self.slots {
            let value = slot
                .words
                .iter()
                .rev()
                .try_fold(0_u64, |value, (range, at)| {
                    let word = answers.get(*range)?.as_ref()?.get(*at)?;
                    Some(value << 16 | u64::from(*word))
                });
            let (Some(value), Some(image)) = (value, next.get_mut(&slot.mc)) else {
                fresh.insert(&slot.mc, false);
                continue;
            };
            place::set(image, slot.place, value);
        }
        let inputs: Vec<McInputs> = fresh
            .into_iter()
            .map(|(mc, fresh)| McInputs {
                mc: mc.clone(),
                bytes: if fresh {
                    next[mc].clone()
                } else {
                    self.last[mc].clone()
                },
                fresh,
            })
            .collect();
        for input in inputs.iter().filter(|input| input.fresh) {
            self.last.insert(input.mc.clone(), input.bytes.clone());
        }
        inputs
    }
}

fn find(ranges: &[Range], table: Table, address: u16) -> Option<(usize, usize)> {
    ranges.iter().enumerate().find_map(|(n, range)| {
        let at = address.checked_sub(range.address)?;
        (range.table == table && at < range.count).then_some((n, usize::from(at)))
    })
}

/// Joins addresses to ranges, split at the size of a request.
fn join(mut used: Vec<(Table, u16)>) -> Vec<Range> {
    used.sort_unstable();
    used.dedup();
    let mut ranges: Vec<Range> = Vec::new();
    for (table, address) in used {
        let max = if is_bit(table.table) {
            READ_BITS_MAX
        } else {
            READ_REGISTERS_MAX
        };
        match ranges.last_mut() {
            Some(last)
                if last.table == table
                    && u32::from(last.address) + u32::from(last.count) == u32::from(address)
                    && last.count < max =>
            {
                last.count += 1;
            }
            _ => ranges.push(Range {
                table,
                address,
                count: 1,
            }),
        }
    }
    ranges
}

/// Values to be written at addresses that follow each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Write {
    /// Where.
    pub table: Table,
    /// First address.
    pub address: u16,
    /// Values; coils as 0 and 1.
    pub values: Vec<u16>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Cell {
    wanted: Option<u16>,
    written: Option<u16>,
}

/// The outputs of a gateway at its Modbus device: what they should be, and what was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WritePlan {
    slots: BTreeMap<McId, Vec<(Place, Table, u16)>>,
    cells: BTreeMap<(Table, u16), Cell>,
}

impl WritePlan {
    /// All outputs of the gateway's MCs; none has a value yet.
    #[must_use]
    pub fn new(cell: &CellModel, gateway: &GatewayId) -> WritePlan {
        let mut slots: BTreeMap<McId, Vec<(Place, Table, u16)>> = BTreeMap::new();
        let mut cells = BTreeMap::new();
        for mc in cell.mcs.iter().filter(|mc| &mc.gateway == gateway) {
            for output in &mc.outputs {
                if let Some(FieldPoint::Modbus {
                    unit,
                    table,
                    address,
                }) = output.field
                {
                    let at = Table { unit, table };
                    slots
                        .entry(mc.mc.clone())
                        .or_default()
                        .push((output.place, at, address));
                    for n in 0..words(table, output.place) {
                        cells.insert((at, address.saturating_add(n)), Cell::default());
                    }
                }
            }
        }
        WritePlan { slots, cells }
    }

    /// An MC's outputs are to be these; what was wanted before and not yet written is forgotten.
    pub fn set(&mut self, mc: &McId, outputs: &[u8]) {
        for &(place, table, address) in self.slots.get(mc).into_iter().flatten() {
            let Some(value) = place::get(outputs, place) else {
                continue;
            };
            for n in 0..words(table.table, place) {
                let word = if is_bit(table.table) {
                    u16::from(value != 0)
                } else {
                    (value >> (16 * u32::from(n))) as u16
                };
                if let Some(cell) = self.cells.get_mut(&(table, address.saturating_add(n))) {
                    cell.wanted = Some(word);
                }
            }
        }
    }

    /// The first write that is due, if any.
    #[must_use]
    pub fn next(&self) -> Option<Write> {
        let mut cells = self.cells.iter();
        let (&(table, address), cell) = cells.find(|(_, cell)| cell.is_due())?;
        let max = if is_bit(table.table) {
            WRITE_COILS_MAX
        } else {
            WRITE_REGISTERS_MAX
        };
        let mut values = vec![cell.wanted?];
        let mut due = 1;
        for (&(next_table, next_address), cell) in cells {
            let follows = u32::from(address) + values.len() as u32 == u32::from(next_address);
            let Some(wanted) = cell.wanted else { break };
            if next_table != table || !follows || values.len() == max {
                break;
            }
            values.push(wanted);
            if cell.is_due() {
                due = values.len();
            }
        }
        values.truncate(due);
        Some(Write {
            table,
            address,
            values,
        })
    }

    /// The device has taken a write.
    pub fn written(&mut self, write: &Write) {
        for (address, value) in (write.address..).zip(&write.values) {
            if let Some(cell) = self.cells.get_mut(&(write.table, address)) {
                cell.written = Some(*value);
            }
        }
    }

    /// What the device holds is unknown (it was away, or a write failed): everything is written again.
    pub fn forget(&mut self) {
        for cell in self.cells.values_mut() {
            cell.written = None;
        }
    }

    /// Whether anything is to be written.
    #[must_use]
    pub fn is_due(&self) -> bool {
        self.cells.values().any(|cell| cell.is_due())
    }
}

impl Cell {
    fn is_due(&self) -> bool {
        self.wanted.is_some() && self.wanted != self.written
    }
}

#[cfg(test)]
mod tests;
