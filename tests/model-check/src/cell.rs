//! The cell, and the state from which everything is explored: all processes up, the MC driven by controller 1.
//!
//! Times are chosen coarse, so that few deadlines lie between two events; which of two processes' deadlines comes first is not
//! said by them anyway, for each process has a clock of its own.

use crate::action::Action;
use crate::plc::{OUTPUTS_LEN, Plc, STATE_LEN};
use crate::state::{Body, Facts, Faults, Pid, Process, State};
use crate::step::World;
use fam_agents::manager::ManagerAgents;
use fam_agents::monitor::{Availability, Qualities};
use fam_agents::node::{NodeAgents, NodeConfig};
use fam_gateway_core::{Gateway, MemoryRecords};
use fam_proto::diagnosis::Diagnosis;
use fam_proto::model::{
    CellModel, ControllerModel, FieldDriver, GatewayModel, McModel, OutputPoint, Place, Settings,
};
use fam_proto::{
    BootId, CellId, ControllerId, GatewayId, LayoutHash, McId, NameError, Owner, RepoState,
};
use std::sync::Arc;

/// Layout of the MC.
pub const LAYOUT: LayoutHash = LayoutHash(7);
const TICK_US: u32 = 100_000;

fn sure<T>(name: Result<T, NameError>) -> T {
    match name {
        Ok(name) => name,
        Err(error) => unreachable!("{error}"),
    }
}

/// What does not change.
#[derive(Debug, Clone)]
pub struct Cell {
    /// The model.
    pub model: Arc<CellModel>,
    /// The MC.
    pub mc: McId,
    /// Its gateway.
    pub gateway: GatewayId,
    /// The controllers.
    pub controllers: [ControllerId; 2],
}

impl Default for Cell {
    fn default() -> Cell {
        let mc = sure(McId::new("Mc"));
        let gateway = sure(GatewayId::new("gateway1"));
        let controllers = ["a", "b"].map(|name| sure(ControllerId::new(name)));
        let controller = |controller: &ControllerId| ControllerModel {
            controller: controller.clone(),
            description: String::new(),
            cpu_factor_permille: 1_000,
            memory_kb: 1_000,
            limit_permille: 900,
            tick_us: TICK_US,
        };
        let model = CellModel {
            cell: sure(CellId::new("cell")),
            controllers: controllers.iter().map(controller).collect(),
            mcs: vec![McModel {
                mc: mc.clone(),
                gateway: gateway.clone(),
                hosts: controllers.to_vec(),
                criticality: 1,
                cycle_us: TICK_US,
                worst_case_us: 100,
                memory_kb: 1,
                watchdog_us: 4 * u64::from(TICK_US) + 60_000,
                suspect_us: 3 * u64::from(TICK_US) + 30_000,
                hash: 1,
                layout: LAYOUT,
                diagnosis: Diagnosis {
                    state_offset: 0,
                    checkpoint_len: STATE_LEN as u32,
                    intervals: Vec::new(),
                    stop_action: None,
                },
                inputs: Vec::new(),
                inputs_len: 0,
                outputs: vec![OutputPoint {
                    name: "Q".to_owned(),
                    number: fam_proto::model::Number::Unsigned,
                    place: Place::Bit { byte: 0, bit: 0 },
                    field: None,
                }],
                fail_safe: vec![0; OUTPUTS_LEN],
            }],
            gateways: vec![GatewayModel {
                gateway: gateway.clone(),
                tick_us: TICK_US,
                driver: FieldDriver::Image,
            }],
            settings: Settings {
                // Reports come when the manager's clock would miss them.
                report_us: 1 << 50,
                report_lost_us: 2_500_000,
                bids_us: 20_000,
                // One repetition of the open lies within.
                activation_us: 4_000,
                release_us: 4_000,
                // Work balance has nothing to do with one MC.
                spread_permille: 10_000,
                gain_permille: 10_000,
                balance_hold_us: 2_000_000,
                balance_pause_us: 2_000_000,
            },
        };
        Cell {
            model: Arc::new(model),
            mc,
            gateway,
            controllers,
        }
    }
}

impl Cell {
    /// The owner that a node is in a life.
    #[must_use]
    pub fn owner(&self, node: usize, boot: BootId) -> Owner {
        Owner {
            controller: self.controllers[node].clone(),
            boot,
        }
    }

    /// A process at its start.
    #[must_use]
    pub fn start(
        &self,
        pid: Pid,
        boot: BootId,
        repository: &RepoState,
        records: &MemoryRecords,
        run: u32,
    ) -> Process {
        let now = fam_proto::Now(10_000_000);
        let model = &self.model;
        let body = match pid {
            // Work balance and cycle time have nothing to decide with one MC.
            Pid::Manager => Body::Manager(ManagerAgents::with_qualities(
                Arc::clone(model),
                repository.clone(),
                boot,
                now,
                Qualities::none().with(Box::new(Availability::default())),
            )),
            Pid::Gateway => {
                let stored = records.after_kill();
                match Gateway::new(model, &self.gateway, boot, run, stored, now) {
                    Ok(gateway) => Body::Gateway(gateway),
                    Err(error) => unreachable!("{error}"),
                }
            }
            Pid::Node(n) => {
                let config = NodeConfig {
                    owner: self.owner(n, boot),
                    model: model.controllers[n].clone(),
                    mcs: model.mcs.iter().map(|m| Arc::new(m.clone())).collect(),
                    settings: model.settings.clone(),
                    real_time: Vec::new(),
                    criteria: Vec::new(),
                };
                Body::Node(NodeAgents::new(config, now), Plc::default())
            }
        };
        Process::new(boot, body)
    }

    /// All processes started, everything delivered at once, until controller 1 or 2 has driven the MC for a while.
    #[must_use]
    pub fn settled(&self, faults: Faults) -> State {
        let mut state = State {
            processes: [None, None, None, None],
            repository: Arc::default(),
            records: Arc::default(),
            runs: 0,
            boots: 100,
            flights: Vec::new(),
            image: None,
            cut: None,
            faults: Faults::default(),
            facts: Arc::new(Facts::default()),
            late: [false; 2],
            activations: 0,
        };
        let world = World {
            cell: self,
            bug: None,
        };
        for pid in [Pid::Gateway, Pid::Node(0), Pid::Node(1), Pid::Manager] {
            state = self.take(&world, &state, Action::Start(pid));
        }
        let begun = state
            .process(Pid::Manager)
            .map_or(fam_proto::Now(0), |p| p.now);
        let mut quiet_from = None;
        loop {
            // What can be delivered is; then the MC scans; then the earliest deadline comes, on one clock for all.
            let ready = world.actions(&state).into_iter().find(|action| {
                matches!(
                    action,
                    Action::Deliver(_) | Action::Image | Action::Token(..)
                )
            });
            if let Some(action) = ready {
                state = self.take(&world, &state, action);
                continue;
            }
            let Some((at, pid, _)) = world.deadlines(&state).min() else {
                unreachable!("the gateway ticks");
            };
            state = self.take(&world, &state, Action::Time(pid));
            if state.facts.driven {
                let since = *quiet_from.get_or_insert(at);
                if at.since_us(since) > 3_200_000 {
                    break;
                }
            }
            assert!(
                at.since_us(begun) < 60_000_000,
                "the cell does not come up: {:?}",
                state.facts
            );
        }
        state.faults = faults;
        state.activations = 0;
        state
    }

    fn take(&self, world: &World<'_>, state: &State, action: Action) -> State {
        match world.step(state, &action) {
            Ok(next) => next,
            Err(violation) => unreachable!("without any fault: {violation}"),
        }
    }
}
