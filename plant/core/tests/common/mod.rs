//! A plain sequencer that drives the cell correctly, so that the mechanics can be tested. It is no controller: the logic of the
//! cell is in ST, in `deploy/fms200`.
#![allow(dead_code)] // each test file uses its own part

use std::collections::{BTreeMap, VecDeque};

use fam_plant_core::signals::{self, Signal, Table};
use fam_plant_core::{Incident, IncidentKind, Plant, PlantConfig};

/// Scan time of the sequencer.
pub const SCAN_US: u64 = 5_000;

pub fn plant(seed: u64) -> Plant {
    Plant::new(PlantConfig {
        seed,
        pallets: 5,
        orders: 1000,
        ..PlantConfig::default()
    })
    .expect("a valid configuration")
}

fn signal(name: &str, table: Table) -> &'static Signal {
    let signal = signals::find(name).unwrap_or_else(|| panic!("no signal {name}"));
    assert_eq!(signal.table, table, "{name}");
    signal
}

/// Reads a sensor.
pub fn is(plant: &Plant, name: &str) -> bool {
    let signal = signal(name, Table::DiscreteInput);
    plant
        .image(signal.unit)
        .expect("unit")
        .discrete_input(signal.address)
}

pub fn word(plant: &Plant, name: &str) -> u16 {
    let signal = signal(name, Table::InputRegister);
    plant
        .image(signal.unit)
        .expect("unit")
        .input_register(signal.address)
}

/// Writes a coil.
pub fn set(plant: &mut Plant, name: &str, on: bool) {
    let signal = signal(name, Table::Coil);
    plant
        .write_coil(signal.unit, signal.address, on)
        .expect("coil");
}

pub fn put(plant: &mut Plant, name: &str, value: u16) {
    let signal = signal(name, Table::HoldingRegister);
    plant
        .write_holding_register(signal.unit, signal.address, value)
        .expect("register");
}

/// Gives every output of a unit its fail-safe value.
pub fn fail_safe(plant: &mut Plant, unit: u8) {
    for signal in signals::ALL.iter().filter(|signal| signal.unit == unit) {
        match (signal.table, signal.safe) {
            (Table::Coil, Some(value)) => set(plant, signal.name, value != 0),
            (Table::HoldingRegister, Some(value)) => put(plant, signal.name, value),
            _ => {}
        }
    }
}

/// Steps until a sensor is as wanted.
pub fn until(plant: &mut Plant, name: &str, wanted: bool) {
    for _ in 0..20_000 {
        if is(plant, name) == wanted {
            return;
        }
        plant.step(1_000);
    }
    panic!(
        "{name} has not become {wanted} in 20 s; incidents: {:?}",
        plant.incidents()
    );
}

pub fn kinds(incidents: &[Incident]) -> Vec<(u8, IncidentKind)> {
    incidents
        .iter()
        .map(|incident| (incident.unit, incident.kind))
        .collect()
}

pub fn assert_conserved(plant: &Plant) {
    assert!(
        plant.ledger().balanced(),
        "parts do not add up: {:?}",
        plant.ledger()
    );
}

/// Carries the axes to a place along a trajectory, as from the actual position.
pub fn drive_to(plant: &mut Plant, x: i32, z: i32) {
    let mut axes = Station4::default();
    for (axis, name) in axes.axes.iter_mut().zip(["S4_XPosition", "S4_ZPosition"]) {
        axis.setpoint = i32::from(word(plant, name) as i16);
    }
    for _ in 0..2_000 {
        if axes.travel(plant, (x, z)) {
            return;
        }
        set(plant, "S4_AxesEnable", true);
        plant.step(SCAN_US);
    }
    panic!(
        "the axes have not reached {x}, {z}; incidents: {:?}",
        plant.incidents()
    );
}

/// Between transport and station k: pallet there (with its order), work done.
#[derive(Clone, Copy, Debug, Default)]
pub struct Handover {
    pub pallet: Option<(u16, u16)>,
    pub done: bool,
}

#[derive(Clone, Debug, Default)]
pub struct Sequencer {
    pub handover: [Handover; 4],
    pub s1: u32,
    pub s2: Station2,
    pub s3: u32,
    pub s4: Station4,
    pub transport: TransportSequence,
    /// Scans that pass before outputs reach the plant, as through a gateway.
    pub latency_scans: usize,
    wanted: Outputs,
    on_the_way: VecDeque<Outputs>,
    /// Station whose outputs are not written (its controller is down), if any.
    pub held_station: Option<u8>,
}

/// Coils and holding registers of all units.
type Outputs = [(u32, [u16; 4]); 5];

fn outputs(plant: &Plant) -> Outputs {
    [1, 2, 3, 4, 5].map(|unit| {
        let image = plant.image(unit).expect("unit");
        (image.coils, image.holding_registers)
    })
}

fn write_outputs(plant: &mut Plant, outputs: &Outputs) {
    for (unit, (coils, registers)) in (1..).zip(outputs) {
        let bits: Vec<bool> = (0..32).map(|bit| coils >> bit & 1 == 1).collect();
        plant.write_coils(unit, 0, &bits).expect("coils");
        plant
            .write_holding_registers(unit, 0, registers)
            .expect("registers");
    }
}

#[derive(Clone, Debug, Default)]
pub struct Station2 {
    bearing: u32,
    shaft: u32,
    arm: u32,
    samples: Vec<u16>,
}

#[derive(Clone, Debug, Default)]
pub struct Station4 {
    pub step: u32,
    order: u16,
    next_slot: u16,
    axes: [Axis; 2],
}

#[derive(Clone, Copy, Debug, Default)]
struct Axis {
    setpoint: i32,
    speed: i32,
}

#[derive(Clone, Debug, Default)]
pub struct TransportSequence {
    stops: [u32; 4],
    /// By pallet code: order, variant, stations done.
    pallets: BTreeMap<u16, (u16, u16, usize)>,
}

impl Sequencer {
    /// Drives the plant for a number of scans.
    pub fn run(&mut self, plant: &mut Plant, scans: u32) {
        for _ in 0..scans {
            if self.latency_scans == 0 {
                self.scan(plant);
            } else {
                write_outputs(plant, &self.wanted);
                self.scan(plant);
                self.wanted = outputs(plant);
                self.on_the_way.push_back(self.wanted);
                let arrived = self.on_the_way.len().checked_sub(self.latency_scans + 1);
                let now = if arrived.is_some() {
                    self.on_the_way.pop_front()
                } else {
                    None
                };
                write_outputs(plant, &now.unwrap_or_default());
            }
            plant.step(SCAN_US);
        }
    }

    /// Drives the plant until so many products are stored.
    pub fn run_until_products(&mut self, plant: &mut Plant, products: usize) {
        let limit = 4_000 * (products as u32 + 4);
        for _ in 0..limit {
            if plant.products().len() >= products {
                return;
            }
            self.run(plant, 1);
        }
        panic!(
            "only {} products after {} s: {self:?}",
            plant.products().len(),
            plant.now_us() / 1_000_000
        );
    }

    /// One scan.
    pub fn scan(&mut self, plant: &mut Plant) {
        let held = self.held_station;
        for station in (1..=5).filter(|station| held != Some(*station)) {
            match station {
                1 => self.station1(plant),
                2 => self.station2(plant),
                3 => self.station3(plant),
                4 => self.station4(plant),
                _ => self.transport(plant),
            }
        }
    }

    /// Puts a station back to its initial state, as a controller would that starts without its checkpoint.
    pub fn restart(&mut self, plant: &mut Plant, station: u8) {
        match station {
            1 => self.s1 = 0,
            2 => self.s2 = Station2::default(),
            3 => self.s3 = 0,
            4 => self.s4 = Station4::default(),
            _ => self.transport = TransportSequence::default(),
        }
        for signal in signals::ALL.iter().filter(|signal| signal.unit == station) {
            match signal.table {
                Table::Coil => set(plant, signal.name, false),
                Table::HoldingRegister => put(plant, signal.name, 0),
                Table::DiscreteInput | Table::InputRegister => {}
            }
        }
    }

    /// Sends every pallet that carries at least a base to the storage without the stations between.
    pub fn skip_to_storage(&mut self) {
        for entry in self
            .transport
            .pallets
            .values_mut()
            .filter(|(_, _, done)| *done > 0)
        {
            entry.2 = 3;
        }
    }

    /// Drives the plant until the storage is in that step.
    pub fn run_until_storage_step(&mut self, plant: &mut Plant, step: u32) {
        for _ in 0..20_000 {
            if self.s4.step == step {
                return;
            }
            self.run(plant, 1);
        }
        panic!(
            "the storage has not come to step {step}; incidents: {:?}",
            plant.incidents()
        );
    }

    fn ready(&mut self, station: usize) -> Option<(u16, u16)> {
        let handover = &mut self.handover[station - 1];
        if handover.pallet.is_none() {
            handover.done = false;
        }
        handover.pallet.filter(|_| !handover.done)
    }

    fn station1(&mut self, p: &mut Plant) {
        let ready = self.ready(1).is_some();
        self.s1 = match self.s1 {
            0 if is(p, "S1_MagazinePart") && is(p, "S1_PusherRetracted") => {
                then(p, 1, &[("S1_PusherExtend", true), ("S1_ArmToCheck", false)])
            }
            1 if is(p, "S1_PusherExtended") => {
                then(p, 2, &[("S1_PusherExtend", false), ("S1_GaugeLower", true)])
            }
            2 if is(p, "S1_GaugeContact") => {
                let upright = (2900..=3100).contains(&word(p, "S1_GaugeDepth"));
                then(p, if upright { 10 } else { 3 }, &[("S1_GaugeLower", false)])
            }
            3 if is(p, "S1_GaugeUp") && is(p, "S1_PusherRetracted") => {
                then(p, 4, &[("S1_EjectorExtend", true)])
            }
            4 if is(p, "S1_EjectorExtended") => then(p, 5, &[("S1_EjectorExtend", false)]),
            5 if is(p, "S1_EjectorRetracted") => 0,
            10 if is(p, "S1_GaugeUp") && is(p, "S1_ArmAtCheck") => {
                then(p, 11, &[("S1_HandLower", true)])
            }
            11 if is(p, "S1_HandDown") => then(p, 12, &[("S1_Suction", true)]),
            12 if is(p, "S1_Vacuum") => then(p, 13, &[("S1_HandLower", false)]),
            13 if is(p, "S1_HandUp") => then(p, 14, &[("S1_ArmToPallet", true)]),
            14 if is(p, "S1_ArmAtPallet") && ready => {
                then(p, 15, &[("S1_ArmToPallet", false), ("S1_HandLower", true)])
            }
            15 if is(p, "S1_HandDown") => then(p, 16, &[("S1_Suction", false)]),
            16 if !is(p, "S1_Vacuum") => then(p, 17, &[("S1_HandLower", false)]),
            17 if is(p, "S1_HandUp") => {
                self.handover[0].done = true;
                then(p, 0, &[("S1_ArmToCheck", true)])
            }
            same => same,
        };
    }

    fn station2(&mut self, p: &mut Plant) {
        let ready = self.ready(2);
        let s = &mut self.s2;
        s.bearing = match s.bearing {
            0 if is(p, "S2_BearingMagazinePart") && is(p, "S2_BearingPusherRetracted") => {
                then(p, 1, &[("S2_BearingPusherExtend", true)])
            }
            1 if is(p, "S2_BearingPusherExtended") => {
                then(p, 2, &[("S2_BearingPusherExtend", false)])
            }
            2 if is(p, "S2_BearingPusherRetracted") => {
                s.samples.clear();
                then(p, 3, &[("S2_HeadTraverse", true)])
            }
            3 => {
                let place = word(p, "S2_ProfilePosition");
                if [130..=230, 370..=430, 570..=630, 770..=870]
                    .iter()
                    .any(|land| land.contains(&place))
                {
                    s.samples.push(word(p, "S2_ProfileHeight"));
                }
                if is(p, "S2_HeadEnd") {
                    then(p, 4, &[("S2_HeadTraverse", false)])
                } else {
                    3
                }
            }
            4 if is(p, "S2_HeadHome") => {
                s.samples.sort_unstable();
                let median = s.samples.get(s.samples.len() / 2).copied().unwrap_or(0);
                if (1170..=1230).contains(&median) {
                    10
                } else {
                    then(p, 5, &[("S2_BearingEjectorExtend", true)])
                }
            }
            5 if is(p, "S2_BearingEjectorExtended") => {
                then(p, 6, &[("S2_BearingEjectorExtend", false)])
            }
            6 if is(p, "S2_BearingEjectorRetracted") => 0,
            same => same,
        };
        let nylon = ready.is_some_and(|(_, variant)| variant & 8 != 0);
        s.shaft = match s.shaft {
            0 if ready.is_some() => then(
                p,
                1,
                &[("S2_SelectNylon", nylon), ("S2_SelectAluminium", !nylon)],
            ),
            1 if is(
                p,
                if nylon {
                    "S2_SelectorAtNylon"
                } else {
                    "S2_SelectorAtAluminium"
                },
            ) && is(p, "S2_ShaftMagazinePart") =>
            {
                then(
                    p,
                    2,
                    &[
                        ("S2_SelectNylon", false),
                        ("S2_SelectAluminium", false),
                        ("S2_ShaftPusherExtend", true),
                    ],
                )
            }
            2 if is(p, "S2_ShaftPusherExtended") => then(p, 3, &[("S2_ShaftPusherExtend", false)]),
            3 if is(p, "S2_ShaftPusherRetracted") => {
                if is(p, "S2_ShaftInductive") == nylon {
                    then(p, 4, &[("S2_ShaftEjectorExtend", true)])
                } else {
                    10
                }
            }
            4 if is(p, "S2_ShaftEjectorExtended") => {
                then(p, 5, &[("S2_ShaftEjectorExtend", false)])
            }
            5 if is(p, "S2_ShaftEjectorRetracted") => 1,
            same => same,
        };
        s.arm = match s.arm {
            0 if ready.is_some() && s.bearing == 10 => {
                put(p, "S2_ArmTarget", 0);
                then(p, 1, &[("S2_ArmEnable", true)])
            }
            10 if s.shaft == 10 => {
                put(p, "S2_ArmTarget", 2);
                11
            }
            1 | 11 if word(p, "S2_ArmPosition") == if s.arm == 1 { 0 } else { 2000 } => {
                then(p, s.arm + 1, &[("S2_HandLower", true)])
            }
            2 | 12 if is(p, "S2_HandDown") => then(p, s.arm + 1, &[("S2_Suction", true)]),
            3 | 13 if is(p, "S2_Vacuum") => then(p, s.arm + 1, &[("S2_HandLower", false)]),
            4 | 14 if is(p, "S2_HandUp") => {
                if s.arm == 4 {
                    s.bearing = 0;
                }
                put(p, "S2_ArmTarget", 1);
                s.arm + 1
            }
            5 | 15 if word(p, "S2_ArmPosition") == 1000 => {
                then(p, s.arm + 1, &[("S2_HandLower", true)])
            }
            6 | 16 if is(p, "S2_HandDown") => then(p, s.arm + 1, &[("S2_Suction", false)]),
            7 | 17 if !is(p, "S2_Vacuum") => then(p, s.arm + 1, &[("S2_HandLower", false)]),
            8 if is(p, "S2_HandUp") => 10,
            18 if is(p, "S2_HandUp") => {
                s.shaft = 0;
                self.handover[1].done = true;
                0
            }
            same => same,
        };
    }

    fn station3(&mut self, p: &mut Plant) {
        let ready = self.ready(3);
        let (material, high) = ready.map_or((0, 0), |(_, variant)| (variant & 3, variant >> 2 & 1));
        self.s3 = match self.s3 {
            0 if ready.is_some() && is(p, "S3_PusherRetracted") => {
                put(p, "S3_TurretTarget", material * 2 + high);
                then(p, 1, &[("S3_TurretEnable", true), ("S3_ArmToNest", false)])
            }
            1 if word(p, "S3_TurretPosition") == 1000 * (material * 2 + high)
                && is(p, "S3_MagazinePart") =>
            {
                then(p, 2, &[("S3_PusherExtend", true)])
            }
            2 if is(p, "S3_PusherExtended") => {
                then(p, 3, &[("S3_PusherExtend", false), ("S3_GaugeLower", true)])
            }
            3 if is(p, "S3_GaugeContact") => {
                let is_high = (2100..=2300).contains(&word(p, "S3_GaugeDepth"));
                let fits = is(p, "S3_Inductive") == (material == 0)
                    && is(p, "S3_Bright") == (material != 2);
                then(
                    p,
                    if fits && is_high == (high == 1) {
                        10
                    } else {
                        4
                    },
                    &[("S3_GaugeLower", false)],
                )
            }
            4 if is(p, "S3_GaugeUp") && is(p, "S3_PusherRetracted") => {
                then(p, 5, &[("S3_EjectorExtend", true)])
            }
            5 if is(p, "S3_EjectorExtended") => then(p, 6, &[("S3_EjectorExtend", false)]),
            6 if is(p, "S3_EjectorRetracted") => 1,
            10 if is(p, "S3_GaugeUp") && is(p, "S3_ArmAtNest") => {
                then(p, 11, &[("S3_HandLower", true)])
            }
            11 if is(p, "S3_HandDown") => then(p, 12, &[("S3_Suction", true)]),
            12 if is(p, "S3_Vacuum") => then(p, 13, &[("S3_HandLower", false)]),
            13 if is(p, "S3_HandUp") => then(p, 14, &[("S3_ArmToPallet", true)]),
            14 if is(p, "S3_ArmAtPallet") => {
                then(p, 15, &[("S3_ArmToPallet", false), ("S3_HandLower", true)])
            }
            15 if is(p, "S3_HandDown") => then(p, 16, &[("S3_Suction", false)]),
            16 if !is(p, "S3_Vacuum") => then(p, 17, &[("S3_HandLower", false)]),
            17 if is(p, "S3_HandUp") => {
                self.handover[2].done = true;
                then(p, 0, &[("S3_ArmToNest", true)])
            }
            same => same,
        };
    }

    fn station4(&mut self, p: &mut Plant) {
        const TRANSFER: (i32, i32) = (500, 1000);
        let ready = self.ready(4);
        let s = &mut self.s4;
        let slot = (
            2000 + 800 * i32::from(s.next_slot % 4),
            500 + 1000 * i32::from(s.next_slot / 4),
        );
        let step = s.step;
        s.step = match step {
            // Axes are moved to the transfer place with the set-point taken from the actual position first.
            0 => then(
                p,
                1,
                &[
                    ("S4_AxesEnable", true),
                    ("S4_ForkRetract", true),
                    ("S4_GripOpen", true),
                ],
            ),
            1 if is(p, "S4_ForkRetracted") && is(p, "S4_GripOpened") => {
                then(p, 2, &[("S4_ForkRetract", false), ("S4_GripOpen", false)])
            }
            2 if s.travel(p, TRANSFER) => 3,
            3 if ready.is_some() => {
                s.order = ready.map_or(0, |(order, _)| order);
                then(p, 4, &[("S4_ForkExtend", true)])
            }
            4 if is(p, "S4_ForkExtended") => {
                then(p, 5, &[("S4_ForkExtend", false), ("S4_GripClose", true)])
            }
            5 if is(p, "S4_GripClosed") => then(p, 6, &[("S4_GripClose", false)]),
            6 if s.travel(p, (TRANSFER.0, TRANSFER.1 + 200)) => {
                then(p, 7, &[("S4_ForkRetract", true)])
            }
            7 if is(p, "S4_ForkRetracted") => {
                self.handover[3].done = true;
                then(p, 8, &[("S4_ForkRetract", false)])
            }
            8 if word(p, "S4_SlotOccupied") >> s.next_slot & 1 == 0
                && s.travel(p, (slot.0, slot.1 + 200)) =>
            {
                put(p, "S4_OrderNumber", s.order);
                then(p, 9, &[("S4_ForkExtend", true)])
            }
            9 if is(p, "S4_ForkExtended") => then(p, 10, &[("S4_ForkExtend", false)]),
            10 if s.travel(p, slot) => then(p, 11, &[("S4_GripOpen", true)]),
            11 if is(p, "S4_GripOpened") => {
                s.next_slot = (s.next_slot + 1) % 12;
                then(p, 1, &[("S4_ForkRetract", true)])
            }
            same => same,
        };
    }

    fn transport(&mut self, p: &mut Plant) {
        set(p, "T_BeltRun", true);
        for k in 1..=4 {
            let name = |what: &str| format!("T_{what}{k}");
            let code = word(p, &name("PalletCode"));
            let t = &mut self.transport;
            let handover = &mut self.handover[k - 1];
            t.stops[k - 1] = match t.stops[k - 1] {
                0 if is(p, &name("PalletAt"))
                    && is(p, &name("LifterDown"))
                    && is(p, &name("StopperClosed")) =>
                {
                    if k == 1 && !t.pallets.contains_key(&code) {
                        let order = word(p, "T_OrderNumber");
                        if order != 0 {
                            t.pallets
                                .insert(code, (order, word(p, "T_OrderVariant"), 0));
                            put(p, "T_OrderTaken", order);
                        }
                    }
                    if t.pallets
                        .get(&code)
                        .is_some_and(|(_, _, done)| *done == k - 1)
                    {
                        then(p, 1, &[(&name("LifterRaise"), true)])
                    } else {
                        then(p, 5, &[(&name("StopperOpen"), true)])
                    }
                }
                1 if is(p, &name("LifterUp")) => {
                    handover.pallet = t
                        .pallets
                        .get(&code)
                        .map(|(order, variant, _)| (*order, *variant));
                    then(p, 2, &[(&name("LifterRaise"), false)])
                }
                2 if handover.done => {
                    handover.pallet = None;
                    match t.pallets.get_mut(&code) {
                        Some(entry) if k < 4 => entry.2 = k,
                        _ => {
                            t.pallets.remove(&code);
                        }
                    }
                    then(p, 3, &[(&name("LifterLower"), true)])
                }
                3 if is(p, &name("LifterDown")) => then(
                    p,
                    5,
                    &[(&name("LifterLower"), false), (&name("StopperOpen"), true)],
                ),
                5 if !is(p, &name("PalletAt")) => then(p, 0, &[(&name("StopperOpen"), false)]),
                same => same,
            };
        }
    }
}

impl Station4 {
    /// Moves both set-points a scan further; true when both axes stand there.
    fn travel(&mut self, p: &mut Plant, (x, z): (i32, i32)) -> bool {
        let arrived = self.axes[0].advance(x) & self.axes[1].advance(z);
        put(p, "S4_XSetpoint", self.axes[0].setpoint as i16 as u16);
        put(p, "S4_ZSetpoint", self.axes[1].setpoint as i16 as u16);
        let stands =
            |name: &str, axis: Axis| (i32::from(word(p, name) as i16) - axis.setpoint).abs() <= 5;
        arrived
            && stands("S4_XPosition", self.axes[0])
            && stands("S4_ZPosition", self.axes[1])
            && word(p, "S4_XVelocity") == 0
            && word(p, "S4_ZVelocity") == 0
    }
}

impl Axis {
    /// A trapezoid of 4 m/s² and 600 mm/s in units of 0.1 mm a scan.
    fn advance(&mut self, target: i32) -> bool {
        let left = (target - self.setpoint).abs();
        let braking = self.speed * (self.speed + 1) / 2;
        self.speed = if left <= braking {
            (self.speed - 1).max(1)
        } else {
            (self.speed + 1).min(30)
        }
        .min(left);
        self.setpoint += self.speed * (target - self.setpoint).signum();
        left == 0
    }
}

/// Sets coils on the way to the next step.
fn then(plant: &mut Plant, next: u32, coils: &[(&str, bool)]) -> u32 {
    for (name, on) in coils {
        set(plant, name, *on);
    }
    next
}
