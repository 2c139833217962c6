//! The quiet time after the last fault: everything is repaired, and within a bound every MC has to be driven.

use super::network::{CALM, Pid};
use super::world::{Event, World};
use crate::invariants::Seen;
use fam_proto::{CommandKind, EventKind, McId, Phase, RecordState, Reset};

/// A schedule lasts at least so long, in microseconds.
const LASTS_US: u64 = 10_000_000;
/// How often it is looked whether all is well, in microseconds.
const CHECK_US: u64 = 50_000;
/// All has to be well so many times one after the other.
const CHECKS: u32 = 6;
/// How often the operator looks after stopped MCs, in microseconds.
const OPERATOR_US: u64 = 600_000;
/// A node that was killed for good stays away, in a thousand.
const STAYS_AWAY_PERMILLE: u64 = 350;
/// An MC is driven if it was heard of within so many cycles.
const DRIVEN_CYCLES: u64 = 4;

/// How the quiet time goes.
pub(super) struct Quiet {
    began_us: u64,
    /// Since when all is well.
    well_us: Option<u64>,
    checks: u32,
}

impl Quiet {
    pub(super) fn recovered_us(&self) -> u64 {
        self.well_us.map_or(0, |at| at - self.began_us)
    }
}

impl World {
    pub(super) fn begin_quiet(&mut self) {
        self.note(|| "QUIET: no more faults".to_owned());
        self.quiet = Some(Quiet {
            began_us: self.now_us,
            well_us: None,
            checks: 0,
        });
        self.network.set_weather(CALM);
        self.field.traps.clear();
        for pid in self.pids() {
            let is_node = matches!(pid, Pid::Node(_));
            if let Some(life) = self.lives.get_mut(&pid) {
                life.doomed = None;
            }
            let stays_away = is_node && self.random.chance(STAYS_AWAY_PERMILLE);
            if !self.is_up(pid) && !stays_away && pid != Pid::Rival {
                let at_us = self.now_us + self.random.between(1, 100_000);
                self.queue.push(at_us, Event::Start(pid));
            }
        }
        self.queue.push(self.now_us + 200_000, Event::Operator);
        self.queue.push(self.now_us + CHECK_US, Event::Check);
    }

    /// MCs that have stopped safely, or faulted, are reset by the operator: cold, for the plant was put in order.
    pub(super) fn operator(&mut self) {
        for mc in 0..self.cell.mcs.len() {
            let name = self.cell.mcs[mc].mc.clone();
            let gate = self.gateway.as_ref().and_then(|g| g.gate(&name));
            let stopped = gate.is_some_and(|g| g.ledger().state.needs_reset());
            let manager = self.managing.agents.as_ref();
            let held = manager
                .and_then(|m| m.view().mcs.get(&name))
                .is_some_and(|m| m.stopped);
            if stopped || held {
                self.command(CommandKind::Reset {
                    mc: name,
                    how: Reset::Cold,
                });
            }
        }
        self.queue.push(self.now_us + OPERATOR_US, Event::Operator);
    }

    pub(super) fn check(&mut self) {
        let state: Vec<(McId, Option<String>)> = self
            .cell
            .mcs
            .iter()
            .map(|info| (info.mc.clone(), self.missing(&info.mc)))
            .collect();
        let well = state.iter().all(|(_, missing)| missing.is_none());
        let (now_us, bound_us) = (self.now_us, self.options.bound_us);
        let Some(quiet) = &mut self.quiet else {
            return;
        };
        if well {
            quiet.well_us.get_or_insert(now_us);
            quiet.checks += 1;
        } else {
            quiet.well_us = None;
            quiet.checks = 0;
        }
        let over = now_us - quiet.began_us > bound_us && quiet.checks < CHECKS;
        if over || (quiet.checks >= CHECKS && now_us >= LASTS_US) {
            self.finished = true;
            self.see(&Seen::End { must_drive: &state });
            return;
        }
        self.queue.push(now_us + CHECK_US, Event::Check);
    }

    /// What an MC that has to be driven lacks.
    fn missing(&self, mc: &McId) -> Option<String> {
        let (Some(gateway), Some(manager)) = (&self.gateway, &self.managing.agents) else {
            return Some("gateway or manager is down".to_owned());
        };
        let info = &self.cell.mcs[self.cell.index(mc)?];
        let emptied = |n: usize| {
            let view = manager.view().controllers.get(&self.cell.controllers[n]);
            view.is_some_and(|c| c.drained || c.leaving)
        };
        let able = |n: &usize| self.nodes[*n].is_some() && !emptied(*n);
        if !info.hosts.iter().any(able) {
            return None;
        }
        let record = gateway.gate(mc)?.summary(self.local(Pid::Gateway));
        // It has to leave a drained controller, too.
        let well_placed = record.owner.as_ref().is_some_and(|o| {
            let node = self.cell.node(&o.controller);
            let stays = |n| !emptied(n) || self.options.profile.sensors_lie();
            node.is_some_and(|n| self.is_this(Pid::Node(n), o.boot) && stays(n))
        });
        let fresh_us = DRIVEN_CYCLES * u64::from(info.model.cycle_us) + 10_000;
        let driven = record.state == RecordState::Open
            && record.driven
            && well_placed
            && record.silent_us <= fresh_us
            && (record.phase == Some(Phase::Running) || self.options.profile.sensors_lie());
        (!driven).then(|| {
            let owner = record.owner.as_ref();
            format!(
                "its record is {} (epoch {} of {}, driven {}, phase {:?}, silent for {} ms)",
                record.state.word(),
                record.epoch,
                owner.map_or_else(|| "nobody".to_owned(), ToString::to_string),
                record.driven,
                record.phase,
                record.silent_us / 1_000
            )
        })
    }
}

/// What the manager's events are counted as.
pub(super) fn deed_of(kind: EventKind) -> &'static str {
    match kind {
        EventKind::ManagerStarted => "manager started",
        EventKind::ControllerJoined => "controller joined",
        EventKind::ControllerLost => "controller lost",
        EventKind::ControllerRefused => "controller refused",
        EventKind::PlanDecided => "plan decided",
        EventKind::PlanRefused => "plan refused",
        EventKind::PlanDone => "plan done",
        EventKind::MoveOrdered => "move ordered",
        EventKind::MoveCancelled => "move cancelled",
        EventKind::McActivated => "MC activated",
        EventKind::McReleased => "MC released",
        EventKind::McRecovering => "MC recovering",
        EventKind::McStopped => "MC stopped",
        EventKind::McFaulted => "MC faulted",
        EventKind::McSuspect => "MC suspect",
        EventKind::McUnplaced => "MC unplaced",
        EventKind::ActivationFailed => "activation failed",
        EventKind::OperatorCommand => "operator's command",
        EventKind::FramesRejected => "frames rejected",
        EventKind::RepositoryFailed => "repository failed",
        _ => "other event",
    }
}
