//! The marking machine: a belt brings packs of two kinds, a hydraulic ram marks each with a heated tool, the belt takes it away.
//!
//! One Modbus unit. Lengths are micrometres, temperatures millionths of a degree. The bus coupler lets the drives stand while
//! nobody has asked it anything for [`COUPLER_US`], as couplers do: a gateway that is gone drives nothing on.

use crate::image::{AddressError, COILS, HOLDING_REGISTERS, UnitImage};
use crate::incident::{Incident, IncidentKind};
use crate::machine::Mechanics;
use crate::plant::{PlantConfig, TICK_US, check_range};
use crate::records::{INCIDENTS_KEPT, Ledger, PartPlaces};

/// Its Modbus unit.
pub const UNIT: u8 = 1;
/// How incidents name it, beside the five units of the FMS-200 cell.
const INCIDENT_UNIT: u8 = 6;

/// Discrete inputs, coils, input registers of the unit.
pub mod at {
    /// Discrete: a pack is in the marking position, or up to 40 mm behind.
    pub const PACK_PLACED: u16 = 0;
    /// Discrete: it is of the second kind.
    pub const PACK_TYPE: u16 = 1;
    /// Discrete: the ram is up.
    pub const RAM_UP: u16 = 2;
    /// Discrete: the ram is down; the tool touches what lies there.
    pub const RAM_DOWN: u16 = 3;
    /// Discrete: the switch of the operator, on from the beginning.
    pub const START: u16 = 4;
    /// Discrete: the button that ends a fault.
    pub const RESET: u16 = 5;
    /// Coil.
    pub const BELT: u16 = 0;
    /// Coil.
    pub const RAM: u16 = 1;
    /// Coil: the ram goes up.
    pub const RAM_GOES_UP: u16 = 2;
    /// Coil.
    pub const HEATING: u16 = 3;
    /// Input register: temperature of the tool in tenths of a degree.
    pub const TEMPERATURE: u16 = 0;
}

/// The drives stand when the bus has been silent for so long.
pub const COUPLER_US: u64 = 100_000;
/// 100 mm/s.
const BELT_UM: i64 = 100;
/// 200 mm/s.
const RAM_UM: i64 = 200;
const RAM_DOWN_UM: i64 = 80_000;
/// From here on the tool touches the pack.
const CONTACT_UM: i64 = 78_000;
const PACK_COMES_UM: i64 = -150_000;
const PACK_GOES_UM: i64 = 60_000;
/// Where the presence sensor sees a pack.
const SENSOR_UM: std::ops::RangeInclusive<i64> = -5_000..=40_000;
/// A mark may be so far from its place.
const OFFSET_MAX_UM: i64 = 20_000;
/// The pack may move so far under the tool.
const SMEAR_MAX_UM: i64 = 3_000;
/// The tool has to stay on the pack for so long.
const DWELL_MIN_US: u64 = 150_000;
const COLDEST_MARK_UDEG: i64 = 56_000_000;
const ROOM_UDEG: i64 = 20_000_000;
/// The tool loses one part in so many of what it is above the room in a tick.
const LOSS: i64 = 20_000;
/// 15 degrees in a second.
const HEATING_UDEG: i64 = 15_000;

/// A pack on the belt.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Pack {
    number: u64,
    at_um: i64,
    marks: u32,
    spoilt: bool,
}

/// The tool touches something.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Contact {
    since_us: u64,
    moved_um: i64,
    smeared: bool,
}

/// The simulated marking machine.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct MarkingMachine {
    config: PlantConfig,
    remainder_us: u64,
    now_us: u64,
    heard_us: u64,
    image: UnitImage,
    pack: Pack,
    ram_um: i64,
    tool_udeg: i64,
    contact: Option<Contact>,
    /// The switch and the button.
    start: bool,
    reset: bool,
    good: u64,
    spoilt: u64,
    unmarked: u64,
    incidents: Vec<Incident>,
    incidents_total: u64,
}

impl MarkingMachine {
    pub fn new(config: PlantConfig) -> Self {
        let mut machine = MarkingMachine {
            config,
            remainder_us: 0,
            now_us: 0,
            heard_us: 0,
            image: UnitImage::default(),
            pack: Pack {
                number: 0,
                at_um: PACK_COMES_UM,
                marks: 0,
                spoilt: false,
            },
            ram_um: 0,
            tool_udeg: ROOM_UDEG,
            contact: None,
            start: true,
            reset: false,
            good: 0,
            spoilt: 0,
            unmarked: 0,
            incidents: Vec::new(),
            incidents_total: 0,
        };
        machine.sense();
        machine
    }

    /// The operator's switch.
    pub fn set_start(&mut self, on: bool) {
        self.start = on;
        self.sense();
    }

    /// The operator's button.
    pub fn set_reset(&mut self, on: bool) {
        self.reset = on;
        self.sense();
    }

    /// Packs that left with exactly one good mark.
    pub fn good(&self) -> u64 {
        self.good
    }

    /// Millimetres of the ram below its upper limit.
    pub fn ram_mm(&self) -> i64 {
        self.ram_um / 1000
    }

    /// Whether a pack is of the second kind.
    fn is_second_kind(&self, number: u64) -> bool {
        // SplitMix64 of seed and number.
        let mut z = self
            .config
            .seed
            .wrapping_add(number.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (z ^ (z >> 27)) & 1 == 1
    }

    fn tick(&mut self) {
        self.now_us += u64::from(TICK_US);
        let driven = |coil| self.image.coil(coil) && self.now_us - self.heard_us <= COUPLER_US;
        let (belt, ram, heating) = (driven(at::BELT), driven(at::RAM), driven(at::HEATING));
        self.tool_udeg += (ROOM_UDEG - self.tool_udeg) / LOSS;
        if heating {
            self.tool_udeg += HEATING_UDEG;
        }
        if ram {
            let up = self.image.coil(at::RAM_GOES_UP);
            let by = if up { -RAM_UM } else { RAM_UM };
            self.ram_um = (self.ram_um + by).clamp(0, RAM_DOWN_UM);
        }
        self.touch();
        if belt {
            self.carry();
        }
        self.sense();
    }

    fn touch(&mut self) {
        match (self.contact, self.ram_um >= CONTACT_UM) {
            (None, true) => {
                self.contact = Some(Contact {
                    since_us: self.now_us,
                    moved_um: 0,
                    smeared: false,
                });
                self.mark();
            }
            (Some(contact), false) => {
                self.contact = None;
                let dwell_us = self.now_us - contact.since_us;
                if dwell_us < DWELL_MIN_US {
                    self.spoil(format!(
                        "the tool left pack {} after {} ms",
                        self.pack.number,
                        dwell_us / 1000
                    ));
                }
            }
            _ => {}
        }
    }

    fn mark(&mut self) {
        let number = self.pack.number;
        self.pack.marks += 1;
        if self.pack.marks > 1 {
            self.incident(
                IncidentKind::MarkedTwice,
                format!("pack {number} is marked again"),
            );
            self.pack.spoilt = true;
        }
        if self.pack.at_um.abs() > OFFSET_MAX_UM {
            let mm = self.pack.at_um / 1000;
            self.spoil(format!("pack {number} is marked {mm} mm from its place"));
        }
        if self.tool_udeg < COLDEST_MARK_UDEG {
            let degrees = self.tool_udeg / 1_000_000;
            self.spoil(format!(
                "pack {number} is marked with a tool of {degrees} degrees"
            ));
        }
    }

    fn carry(&mut self) {
        self.pack.at_um += BELT_UM;
        if let Some(contact) = &mut self.contact {
            contact.moved_um += BELT_UM;
            if contact.moved_um > SMEAR_MAX_UM && !contact.smeared {
                contact.smeared = true;
                let number = self.pack.number;
                self.pack.spoilt = true;
                self.incident(
                    IncidentKind::Collision,
                    format!("the belt draws pack {number} away under the tool"),
                );
            }
        }
        if self.pack.at_um <= PACK_GOES_UM {
            return;
        }
        let Pack {
            number,
            marks,
            spoilt,
            ..
        } = self.pack;
        if marks == 0 {
            self.unmarked += 1;
            self.incident(
                IncidentKind::NotMarked,
                format!("pack {number} leaves without a mark"),
            );
        } else if spoilt {
            self.spoilt += 1;
        } else {
            self.good += 1;
        }
        self.pack = Pack {
            number: number + 1,
            at_um: PACK_COMES_UM,
            marks: 0,
            spoilt: false,
        };
    }

    fn spoil(&mut self, cause: String) {
        self.pack.spoilt = true;
        self.incident(IncidentKind::BadMark, cause);
    }

    fn incident(&mut self, kind: IncidentKind, cause: String) {
        self.incidents_total += 1;
        if self.incidents.len() < INCIDENTS_KEPT {
            self.incidents.push(Incident {
                at_us: self.now_us,
                unit: INCIDENT_UNIT,
                kind,
                cause,
            });
        }
    }

    fn sense(&mut self) {
        let placed = SENSOR_UM.contains(&self.pack.at_um);
        let second = placed && self.is_second_kind(self.pack.number);
        for (address, on) in [
            (at::PACK_PLACED, placed),
            (at::PACK_TYPE, second),
            (at::RAM_UP, self.ram_um <= 0),
            (at::RAM_DOWN, self.ram_um >= CONTACT_UM),
            (at::START, self.start),
            (at::RESET, self.reset),
        ] {
            self.image.sense(address, on);
        }
        let tenths = u16::try_from(self.tool_udeg / 100_000).unwrap_or(u16::MAX);
        self.image.measure(at::TEMPERATURE, tenths);
    }
}

fn check_unit(unit: u8) -> Result<(), AddressError> {
    if unit == UNIT {
        Ok(())
    } else {
        Err(AddressError::OneUnit { unit })
    }
}

impl Mechanics for MarkingMachine {
    fn step(&mut self, dt_us: u64) {
        self.remainder_us += dt_us;
        while self.remainder_us >= u64::from(TICK_US) {
            self.remainder_us -= u64::from(TICK_US);
            self.tick();
        }
    }
    fn now_us(&self) -> u64 {
        self.now_us
    }
    fn config(&self) -> PlantConfig {
        self.config
    }
    fn heard(&mut self) {
        self.heard_us = self.now_us;
    }
    fn image(&self, unit: u8) -> Result<&UnitImage, AddressError> {
        check_unit(unit)?;
        Ok(&self.image)
    }
    fn write_coils(&mut self, unit: u8, address: u16, values: &[bool]) -> Result<(), AddressError> {
        check_unit(unit)?;
        check_range(unit, "coil", address, values.len(), COILS)?;
        for (offset, on) in (0..).zip(values) {
            self.image.set_coil(address + offset, *on);
        }
        Ok(())
    }
    fn write_holding_registers(
        &mut self,
        unit: u8,
        address: u16,
        values: &[u16],
    ) -> Result<(), AddressError> {
        check_unit(unit)?;
        check_range(
            unit,
            "holding register",
            address,
            values.len(),
            HOLDING_REGISTERS,
        )?;
        let first = usize::from(address);
        self.image.holding_registers[first..first + values.len()].copy_from_slice(values);
        Ok(())
    }
    fn incidents(&self) -> &[Incident] {
        &self.incidents
    }
    fn incidents_total(&self) -> u64 {
        self.incidents_total
    }
    fn ledger(&self) -> Ledger {
        Ledger {
            fed: self.pack.number + 1,
            stored: self.good + self.spoilt,
            lost: self.unmarked,
            damaged: self.spoilt,
            in_cell: PartPlaces {
                feeding: 1,
                ..PartPlaces::default()
            },
            ..Ledger::default()
        }
    }
    fn finished(&self) -> u64 {
        self.good
    }
}
