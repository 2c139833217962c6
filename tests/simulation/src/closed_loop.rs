//! The five MCs of the FMS-200 cell, as compiled from `deploy/fms200`, against the plant in virtual time: image exchange once a tick,
//! exported variables a tick late, and interruptions as the middleware would answer them.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::OnceLock;

use fam_engineering::{BuiltCell, BuiltMc, build};
use fam_plant_core::{Part, Plant, PlantConfig, Variant};
use fam_proto::diagnosis::Recovery;
use fam_proto::model::{FieldPoint, InputSource, McModel, ModbusTable, Place};
use fam_soft_plc::{Engine, EngineOptions, Instance, Interruption, Module};

/// Tick of gateway and nodes.
pub const TICK_MS: u64 = 5;
/// Watchdog of the gateway, in ticks.
pub const WATCHDOG_TICKS: u64 = 200;
const BUDGET_TICKS: u64 = 1_000;
/// How activations are counted that begin without an action, or go on with one that was interrupted.
pub const DIRECT: &str = "direct";
pub const GONE_ON: &str = "recovery gone on with";

/// The cell, built and compiled once for all tests.
pub struct Cell {
    pub built: BuiltCell,
    engine: Engine,
    modules: Vec<Module>,
}

/// Builds the cell at the first call.
pub fn cell() -> &'static Cell {
    static CELL: OnceLock<Cell> = OnceLock::new();
    CELL.get_or_init(|| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/fms200/cell.toml");
        let built = build(&path).unwrap_or_else(|problems| panic!("{problems}"));
        let engine = Engine::new(EngineOptions {
            interruption: Interruption::None,
        })
        .expect("an engine");
        let modules = built
            .mcs
            .iter()
            .map(|mc| engine.prepare(&mc.compiled).expect("a module"))
            .collect();
        Cell {
            built,
            engine,
            modules,
        }
    })
}

/// Small seeded generator (SplitMix64).
pub struct Dice(u64);

impl Dice {
    pub fn new(seed: u64) -> Self {
        Dice(seed)
    }

    /// A number from `low` to `high`, both included.
    pub fn roll(&mut self, low: u64, high: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        low + (z ^ (z >> 31)) % (high - low + 1)
    }
}

/// How frames and images travel in a run.
#[derive(Clone, Copy, Debug)]
pub struct Timing {
    /// From the start of a tick until its outputs reach the plant, 0 to 4 ms.
    pub delay_ms: u64,
    /// Ticks that an input image is old when it is scanned, 0 or 1.
    pub image_age: usize,
    /// Between the writes of coils and of registers, 0 or 1 ms.
    pub split_ms: u64,
}

impl Timing {
    pub const PROMPT: Timing = Timing {
        delay_ms: 1,
        image_age: 0,
        split_ms: 0,
    };

    pub fn rolled(dice: &mut Dice) -> Self {
        Timing {
            delay_ms: dice.roll(0, 3),
            image_age: dice.roll(0, 1) as usize,
            split_ms: dice.roll(0, 1),
        }
    }
}

/// One MC: what the gateway keeps of it, and the instance that drives it, if one does.
pub struct Mc {
    pub built: &'static BuiltMc,
    pub model: &'static McModel,
    module: &'static Module,
    instance: Option<Instance>,
    /// Checkpoint and outputs applied last.
    pub checkpoint: Vec<u8>,
    pub outputs: Vec<u8>,
    mc_time_ns: i64,
    /// Ticks since a frame was applied.
    silent: u64,
    /// The activation has ended by itself: safely stopped.
    pub stopped: bool,
    /// Activations by what they began with: `direct`, or the name of the critical interval.
    pub recoveries: BTreeMap<String, u32>,
}

impl Mc {
    fn activate(&mut self, mut checkpoint: Vec<u8>, action: u16, go_on: bool) {
        self.built.control.activate(&mut checkpoint, action, go_on);
        let mut instance = Instance::new(&cell().engine, self.module).expect("an instance");
        instance
            .region_mut(self.built.checkpoint_region())
            .copy_from_slice(&checkpoint);
        instance.outputs_mut().copy_from_slice(&self.outputs);
        self.instance = Some(instance);
    }
}

/// The cell at work.
pub struct Rig {
    pub plant: Plant,
    pub mcs: Vec<Mc>,
    timing: Timing,
    /// Input images by age, newest first; one for each MC.
    images: Vec<Vec<Vec<u8>>>,
    /// Input bits that a defective sensor shows whatever the plant does: name and value.
    pub stuck: Vec<(&'static str, bool)>,
    ticks: u64,
}

impl Rig {
    pub fn new(config: PlantConfig, timing: Timing) -> Self {
        let cell = cell();
        let mcs = cell
            .built
            .mcs
            .iter()
            .zip(&cell.modules)
            .map(|(built, module)| {
                let model = cell.built.model.mc(&built.mc).expect("a model of the MC");
                Mc {
                    built,
                    model,
                    module,
                    instance: None,
                    checkpoint: Vec::new(),
                    outputs: model.fail_safe.clone(),
                    mc_time_ns: 0,
                    silent: 0,
                    stopped: false,
                    recoveries: BTreeMap::new(),
                }
            })
            .collect();
        let mut rig = Rig {
            plant: Plant::new(config).expect("a plant"),
            mcs,
            timing,
            images: Vec::new(),
            stuck: Vec::new(),
            ticks: 0,
        };
        for index in 0..rig.mcs.len() {
            rig.start_cold(index);
        }
        rig
    }

    /// The same cell in the same state, to go on with another timing.
    pub fn fork(&self, timing: Timing) -> Self {
        let mcs = self
            .mcs
            .iter()
            .map(|mc| Mc {
                built: mc.built,
                model: mc.model,
                module: mc.module,
                instance: mc.instance.as_ref().map(|from| {
                    let mut to = Instance::new(&cell().engine, mc.module).expect("an instance");
                    for region in 0..mc.built.compiled.layout.regions.len() {
                        to.region_mut(region).copy_from_slice(from.region(region));
                    }
                    to.outputs_mut().copy_from_slice(from.outputs());
                    to
                }),
                checkpoint: mc.checkpoint.clone(),
                outputs: mc.outputs.clone(),
                recoveries: BTreeMap::new(),
                ..*mc
            })
            .collect();
        Rig {
            plant: self.plant.clone(),
            mcs,
            timing,
            images: self.images.clone(),
            stuck: self.stuck.clone(),
            ticks: self.ticks,
        }
    }

    pub fn index(&self, name: &str) -> usize {
        self.mcs
            .iter()
            .position(|mc| mc.model.mc.as_str() == name)
            .unwrap_or_else(|| panic!("there is no MC {name}"))
    }

    pub fn now_ms(&self) -> u64 {
        self.ticks * TICK_MS
    }

    pub fn runs(&self, index: usize) -> bool {
        self.mcs[index].instance.is_some()
    }

    /// The critical interval in which the applied state of an MC is.
    pub fn interval(&self, index: usize) -> Option<&'static str> {
        let mc = &self.mcs[index];
        mc.model
            .diagnosis
            .critical_interval(&mc.checkpoint)
            .map(|interval| interval.name.as_str())
    }

    /// Activates an MC from its initial values, whatever the plant is doing.
    pub fn start_cold(&mut self, index: usize) {
        let mc = &mut self.mcs[index];
        mc.mc_time_ns = 0;
        mc.stopped = false;
        let checkpoint = mc.built.initial_checkpoint.clone();
        mc.activate(checkpoint, 0, false);
    }

    /// The controller of an MC dies: nothing is scanned any more, the outputs stay.
    pub fn kill(&mut self, index: usize) {
        self.mcs[index].instance = None;
    }

    /// Another controller takes over from the state applied last, diagnosed as interrupted.
    pub fn take_over(&mut self, index: usize) {
        let mc = &mut self.mcs[index];
        if mc.stopped {
            return;
        }
        if mc.checkpoint.is_empty() {
            self.start_cold(index);
            return;
        }
        let control = mc.built.control.read(&mc.checkpoint);
        let under_way = control.is_active && !control.was_active && control.recovery_action > 0;
        let (action, name) = if under_way {
            let interval = mc
                .model
                .diagnosis
                .interval_of_action(control.recovery_action);
            assert!(
                interval.is_some_and(|interval| interval.repeatable),
                "action {} of {} cannot be gone on with",
                control.recovery_action,
                mc.model.mc
            );
            (control.recovery_action, GONE_ON)
        } else {
            match mc.model.diagnosis.recovery(&mc.checkpoint) {
                Recovery::Direct => (0, DIRECT),
                Recovery::Checkpoint(interval) | Recovery::SafeStop(interval) => {
                    (interval.action, interval.name.as_str())
                }
            }
        };
        *mc.recoveries.entry(name.to_owned()).or_default() += 1;
        let checkpoint = mc.checkpoint.clone();
        mc.activate(checkpoint, action, under_way);
    }

    /// The stop POU takes over from the running logic.
    pub fn stop(&mut self, index: usize) {
        let mc = &mut self.mcs[index];
        let action = mc.model.diagnosis.stop_action.expect("a stop POU");
        let checkpoint = mc.checkpoint.clone();
        mc.activate(checkpoint, action, false);
    }

    /// One tick of the whole cell.
    pub fn tick(&mut self) {
        self.read_inputs();
        let images = &self.images[self.timing.image_age.min(self.images.len() - 1)];
        let mut applied = vec![false; self.mcs.len()];
        let mut frames = Vec::new();
        for (index, mc) in self.mcs.iter_mut().enumerate() {
            let Some(instance) = &mut mc.instance else {
                continue;
            };
            instance.inputs_mut().copy_from_slice(&images[index]);
            mc.mc_time_ns += i64::from(mc.model.cycle_us) * 1000;
            if let Err(trap) = instance.scan(mc.mc_time_ns, BUDGET_TICKS) {
                panic!("{} trapped: {trap}", mc.model.mc);
            }
            let checkpoint = instance.region(mc.built.checkpoint_region()).to_vec();
            let outputs = instance.outputs().to_vec();
            if !mc.built.control.read(&checkpoint).is_active {
                mc.stopped = true;
                mc.instance = None;
            }
            applied[index] = true;
            frames.push((index, checkpoint, outputs));
        }
        self.plant.step(self.timing.delay_ms * 1000);
        for (index, checkpoint, outputs) in frames {
            self.mcs[index].checkpoint = checkpoint;
            self.mcs[index].outputs = outputs;
        }
        for (mc, applied) in self.mcs.iter_mut().zip(applied) {
            mc.silent = if applied { 0 } else { mc.silent + 1 };
            if mc.silent >= WATCHDOG_TICKS && !mc.stopped {
                mc.outputs.clone_from(&mc.model.fail_safe);
            }
        }
        self.write_outputs(ModbusTable::Coil);
        self.plant.step(self.timing.split_ms * 1000);
        self.write_outputs(ModbusTable::HoldingRegister);
        self.plant
            .step((TICK_MS - self.timing.delay_ms - self.timing.split_ms) * 1000);
        self.ticks += 1;
    }

    /// Ticks until a condition holds; fails with what stands still after so many seconds.
    pub fn run_until(&mut self, what: &str, limit_s: u64, mut done: impl FnMut(&Rig) -> bool) {
        let end_ms = self.now_ms() + limit_s * 1000;
        while !done(self) {
            assert!(
                self.now_ms() < end_ms,
                "not within {limit_s} s: {what}. {}",
                self.situation()
            );
            self.tick();
        }
    }

    /// Where everything stands, for a failed test.
    pub fn situation(&self) -> String {
        let mut text = format!(
            "At {} ms, {} products, ledger {:?}, incidents {:#?}.",
            self.now_ms(),
            self.plant.products().len(),
            self.plant.ledger(),
            self.plant.incidents()
        );
        for mc in &self.mcs {
            text.push_str(&format!(
                "\n{}: running {}, stopped {}, recoveries {:?}, state",
                mc.model.mc,
                mc.instance.is_some(),
                mc.stopped,
                mc.recoveries
            ));
            if let Some(instance) = &mc.instance {
                for path in [
                    "step",
                    "bearing",
                    "shaft",
                    "axes",
                    "moving",
                    "ticket",
                    "lastTicket",
                ] {
                    if let Some(value) = instance.read(&format!("{}.{path}", mc.model.mc)) {
                        text.push_str(&format!(" {path}={value:?}"));
                    }
                }
                for stop in 1..=4 {
                    if let Some(value) = instance.read(&format!("{}.stop{stop}.step", mc.model.mc))
                    {
                        text.push_str(&format!(" stop{stop}={value:?}"));
                    }
                }
            }
        }
        text
    }

    /// Order, variant and parts of the first products.
    pub fn contents(&self, count: usize) -> Vec<(u16, Variant, Vec<Part>)> {
        self.plant
            .products()
            .iter()
            .take(count)
            .map(fam_plant_core::Product::contents)
            .collect()
    }

    /// Zero incidents, nothing lost, damaged or wasted, all products good.
    pub fn assert_unharmed(&self, context: &str) {
        let ledger = self.plant.ledger();
        assert!(
            self.plant.incidents_total() == 0,
            "{context}: {}",
            self.situation()
        );
        assert_eq!(
            (ledger.lost, ledger.damaged, ledger.rejected_good),
            (0, 0, 0),
            "{context}: {}",
            self.situation()
        );
        assert_eq!(
            ledger.fed,
            self.plant.parts_in_cell().total() + ledger.rejected + ledger.stored,
            "{context}: parts do not add up"
        );
        assert!(self.plant.products().iter().all(|product| product.good));
    }

    fn read_inputs(&mut self) {
        let images = self
            .mcs
            .iter()
            .map(|mc| self.input_image(mc.model))
            .collect();
        self.images.insert(0, images);
        self.images.truncate(2);
    }

    fn input_image(&self, model: &McModel) -> Vec<u8> {
        let mut image = vec![0; model.inputs_len as usize];
        for input in &model.inputs {
            let mut value = match &input.source {
                InputSource::Field(FieldPoint::Modbus {
                    unit,
                    table,
                    address,
                }) => {
                    let unit = self.plant.image(*unit).expect("a unit of the plant");
                    match table {
                        ModbusTable::DiscreteInput => u64::from(unit.discrete_input(*address)),
                        ModbusTable::InputRegister => u64::from(unit.input_register(*address)),
                        other => panic!("{} reads {other:?}", input.name),
                    }
                }
                InputSource::Export { mc, place } => {
                    let exporter = self
                        .mcs
                        .iter()
                        .find(|other| &other.model.mc == mc)
                        .expect("the exporter");
                    get(&exporter.outputs, *place)
                }
                InputSource::Field(other) => panic!("{} is at {other:?}", input.name),
            };
            if let Some((_, stuck)) = self.stuck.iter().find(|(name, _)| *name == input.name) {
                value = u64::from(*stuck);
            }
            put(&mut image, input.place, value);
        }
        image
    }

    fn write_outputs(&mut self, only: ModbusTable) {
        for mc in &self.mcs {
            for output in &mc.model.outputs {
                let Some(FieldPoint::Modbus {
                    unit,
                    table,
                    address,
                }) = &output.field
                else {
                    continue;
                };
                if *table != only {
                    continue;
                }
                let value = get(&mc.outputs, output.place);
                let written = match table {
                    ModbusTable::Coil => self.plant.write_coil(*unit, *address, value != 0),
                    _ => self
                        .plant
                        .write_holding_register(*unit, *address, value as u16),
                };
                written.unwrap_or_else(|e| panic!("{}: {e}", output.name));
            }
        }
    }
}

fn get(image: &[u8], place: Place) -> u64 {
    match place {
        Place::Bit { byte, bit } => u64::from(image[byte as usize] >> bit & 1),
        Place::Bytes { byte, width } => {
            let from = byte as usize;
            let mut wide = [0; 8];
            wide[..width as usize].copy_from_slice(&image[from..from + width as usize]);
            u64::from_le_bytes(wide)
        }
    }
}

fn put(image: &mut [u8], place: Place, value: u64) {
    match place {
        Place::Bit { byte, bit } => {
            let mask = 1 << bit;
            if value == 0 {
                image[byte as usize] &= !mask;
            } else {
                image[byte as usize] |= mask;
            }
        }
        Place::Bytes { byte, width } => {
            let from = byte as usize;
            image[from..from + width as usize]
                .copy_from_slice(&value.to_le_bytes()[..width as usize]);
        }
    }
}
