//! The cell that a seed chooses: controllers, MCs, hosting, cycles, limits.

use super::delivered;
use super::logic::Logic;
use super::random::Random;
use fam_node_core::McSpec;
use fam_node_core::model_mc::{INPUTS_LEN, ModelMc, OUTPUTS_LEN};
use fam_proto::model::{
    CellModel, ControllerModel, FieldDriver, FieldPoint, GatewayModel, InputPoint, InputSource,
    McModel, OutputPoint, Place, Settings,
};
use fam_proto::{CellId, ControllerId, GatewayId, McId, NameError};
use std::sync::Arc;

/// First output byte of the fail-safe values; no logic sets it.
pub const FAIL_SAFE: u8 = 0xFA;
/// Tick of gateway and nodes, in microseconds.
pub const TICK_US: u32 = 5_000;

/// A cell, with what its nodes know of its MCs.
#[derive(Debug, Clone)]
pub struct Cell {
    /// The model that all processes read.
    pub model: Arc<CellModel>,
    /// The MCs, in the order of the model.
    pub mcs: Vec<McInfo>,
    /// Controllers, in the order of the model.
    pub controllers: Vec<ControllerId>,
    /// The gateway.
    pub gateway: GatewayId,
}

/// One MC.
#[derive(Debug, Clone)]
pub struct McInfo {
    /// Its name.
    pub mc: McId,
    /// Its model.
    pub model: Arc<McModel>,
    /// What it runs.
    pub logic: Logic,
    /// What a node knows of it.
    pub spec: Arc<McSpec>,
    /// CPU time of one scan on the reference controller, in nanoseconds.
    pub cpu_ns: u64,
    /// Nodes that host it.
    pub hosts: Vec<usize>,
}

/// Bounds of the cells that seeds choose.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Size {
    /// Fewest and most controllers.
    pub controllers: (u64, u64),
    /// Fewest and most MCs.
    pub mcs: (u64, u64),
    /// Most controllers that host one MC.
    pub hosts_max: usize,
    /// Compiled logic in place of the model MC.
    pub plc: bool,
}

impl Cell {
    /// The cell of a seed.
    #[must_use]
    pub fn choose(size: &Size, random: &mut Random) -> Cell {
        match Cell::make(size, random) {
            Ok(cell) => cell,
            Err(error) => unreachable!("the names made here are names: {error}"),
        }
    }

    fn make(size: &Size, random: &mut Random) -> Result<Cell, NameError> {
        let gateway = GatewayId::new("gateway1")?;
        let count = random.between(size.controllers.0, size.controllers.1);
        let mut controllers = Vec::new();
        for n in 1..=count {
            controllers.push(ControllerModel {
                controller: ControllerId::new(&format!("controller{n}"))?,
                description: "simulated".to_owned(),
                cpu_factor_permille: if random.chance(250) { 500 } else { 1_000 },
                memory_kb: 10_000,
                limit_permille: 600,
                tick_us: TICK_US,
            });
        }
        let count = random.between(size.mcs.0, size.mcs.1);
        let mut names = Vec::new();
        for n in 1..=count {
            names.push(McId::new(&format!("Mc{n}"))?);
        }
        let mcs: Vec<McInfo> = (0..names.len())
            .map(|n| mc(&names, n, &gateway, &controllers, size, random))
            .collect();
        let model = CellModel {
            cell: CellId::new("simulated")?,
            mcs: mcs.iter().map(|m| m.model.as_ref().clone()).collect(),
            gateways: vec![GatewayModel {
                gateway: gateway.clone(),
                tick_us: TICK_US,
                driver: FieldDriver::Image,
            }],
            settings: Settings::default(),
            controllers,
        };
        Ok(Cell {
            controllers: model
                .controllers
                .iter()
                .map(|c| c.controller.clone())
                .collect(),
            model: Arc::new(model),
            mcs,
            gateway,
        })
    }

    /// Position of an MC.
    #[must_use]
    pub fn index(&self, mc: &McId) -> Option<usize> {
        self.mcs.iter().position(|m| &m.mc == mc)
    }

    /// Position of a controller.
    #[must_use]
    pub fn node(&self, controller: &ControllerId) -> Option<usize> {
        self.controllers.iter().position(|c| c == controller)
    }

    /// What a node knows of an MC, as its `place`-th.
    #[must_use]
    pub fn spec(&self, mc: usize, place: usize) -> McSpec {
        McSpec {
            index: place,
            ..self.mcs[mc].spec.as_ref().clone()
        }
    }

    /// Another version of an MC, as a node has it that was generated from another model: other logic and another layout.
    #[must_use]
    pub fn other_version(&self, mc: usize, place: usize) -> (McSpec, McModel) {
        let info = &self.mcs[mc];
        let mut spec = self.spec(mc, place);
        spec.layout.0 += 1;
        let mut model = info.model.as_ref().clone();
        model.layout = spec.layout;
        model.hash += 1;
        (spec, model)
    }
}

fn mc(
    names: &[McId],
    n: usize,
    gateway: &GatewayId,
    controllers: &[ControllerModel],
    size: &Size,
    random: &mut Random,
) -> McInfo {
    let padding = random.index(180);
    let mut hosts: Vec<usize> = (0..controllers.len())
        .filter(|_| random.chance(800))
        .collect();
    if hosts.is_empty() {
        hosts.push(random.index(controllers.len()));
    }
    // Something has to be able to move.
    if n == 0 && hosts.len() == 1 {
        hosts.push((hosts[0] + 1) % controllers.len());
        hosts.sort_unstable();
    }
    while hosts.len() > size.hosts_max {
        hosts.remove(random.index(hosts.len()));
    }
    let cycle_us = TICK_US * random.pick(&[1, 1, 1, 2, 4]).copied().unwrap_or(1);
    let worst_case_us = u32::try_from(random.between(50, 250)).unwrap_or(100);
    let mut fail_safe = vec![0; OUTPUTS_LEN];
    fail_safe[0] = FAIL_SAFE;
    let mut inputs = vec![InputPoint {
        name: "Field".to_owned(),
        number: fam_proto::model::Number::Unsigned,
        place: Place::Bytes { byte: 0, width: 2 },
        source: InputSource::Field(FieldPoint::Image(format!("{}.in", names[n]))),
    }];
    // The MC before exports the low bytes of its count.
    if n > 0 && random.chance(600) {
        inputs.push(InputPoint {
            name: "Before".to_owned(),
            number: fam_proto::model::Number::Unsigned,
            place: Place::Bytes { byte: 2, width: 2 },
            source: InputSource::Export {
                mc: names[n - 1].clone(),
                place: Place::Bytes { byte: 1, width: 2 },
            },
        });
    }
    let mut model = McModel {
        mc: names[n].clone(),
        gateway: gateway.clone(),
        hosts: hosts
            .iter()
            .map(|h| controllers[*h].controller.clone())
            .collect(),
        criticality: u32::try_from(random.between(1, 3)).unwrap_or(1),
        cycle_us,
        worst_case_us,
        memory_kb: 100,
        watchdog_us: 1_000 * random.between(400, 1_000),
        suspect_us: 1_000 * random.between(60, 120),
        hash: 7 + padding as u64,
        layout: ModelMc::layout(padding),
        diagnosis: ModelMc::diagnosis(padding),
        inputs,
        inputs_len: INPUTS_LEN as u32,
        outputs: vec![OutputPoint {
            name: "Phase".to_owned(),
            number: fam_proto::model::Number::Unsigned,
            place: Place::Bytes { byte: 0, width: 1 },
            field: Some(FieldPoint::Image(format!("{}.out", names[n]))),
        }],
        fail_safe,
    };
    let mut logic = Logic::Model { padding };
    if size.plc {
        let (delivered, plc) = delivered::logic(n);
        model.layout = delivered.layout;
        model.hash = delivered.hash;
        model.diagnosis = delivered.diagnosis.clone();
        model.inputs.truncate(1);
        model.inputs[0].place = Place::Bytes { byte: 0, width: 1 };
        model.inputs_len = delivered.inputs_len;
        model.outputs = Vec::new();
        model.fail_safe = delivered.fail_safe.clone();
        logic = Logic::Plc(plc);
    }
    McInfo {
        mc: names[n].clone(),
        spec: Arc::new(logic.spec(0, &names[n], gateway, cycle_us)),
        model: Arc::new(model),
        logic,
        cpu_ns: u64::from(worst_case_us) * random.between(300, 950),
        hosts,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_stay_in_their_bounds_and_differ() {
        let size = Size {
            controllers: (2, 4),
            mcs: (1, 5),
            hosts_max: 3,
            plc: false,
        };
        let mut shapes = std::collections::BTreeSet::new();
        for seed in 0..50 {
            let cell = Cell::choose(&size, &mut Random::new(seed, 0));
            assert!((2..=4).contains(&cell.controllers.len()));
            assert!((1..=5).contains(&cell.mcs.len()));
            for (n, mc) in cell.mcs.iter().enumerate() {
                assert!((1..=3).contains(&mc.hosts.len()));
                cell.spec(n, 0).check().unwrap();
            }
            shapes.insert((cell.controllers.len(), cell.mcs.len()));
        }
        assert!(shapes.len() > 6, "{shapes:?}");
    }
}
