//! The stages of the flows (design, section 5): which of them a fault has hit, and faults that wait for one.

use super::faults::{Fault, Target};
use super::generate::{When, kinds};
use super::network::Pid;
use super::world::{Event, World};
use fam_proto::McaState;
use std::collections::BTreeMap;

/// A process that has come back counts as restarting for so long, in microseconds.
const RESTARTED_US: u64 = 200_000;

/// A stage of a flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// A node runs and is not registered.
    Join,
    /// An MC Agent opens an epoch.
    Opening,
    /// An MC runs.
    Active,
    /// An MC is to be released.
    Releasing,
    /// A recovery action or the stop POU runs.
    Recovering,
    /// A plan is being carried out.
    Plan,
    /// A node is down or has come back lately.
    NodeRestart,
    /// The manager is.
    ManagerRestart,
    /// The gateway is.
    GatewayRestart,
}

impl Stage {
    /// All of them.
    pub const ALL: [Stage; 9] = [
        Stage::Join,
        Stage::Opening,
        Stage::Active,
        Stage::Releasing,
        Stage::Recovering,
        Stage::Plan,
        Stage::NodeRestart,
        Stage::ManagerRestart,
        Stage::GatewayRestart,
    ];

    /// In words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Stage::Join => "join",
            Stage::Opening => "opening",
            Stage::Active => "active",
            Stage::Releasing => "releasing",
            Stage::Recovering => "recovering",
            Stage::Plan => "plan under way",
            Stage::NodeRestart => "restart of node",
            Stage::ManagerRestart => "restart of manager",
            Stage::GatewayRestart => "restart of gateway",
        }
    }
}

/// How often a kind of fault has hit a stage.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Matrix(BTreeMap<(&'static str, Stage), u64>);

impl Matrix {
    /// Counts a hit.
    pub fn count(&mut self, kind: &'static str, stage: Stage) {
        *self.0.entry((kind, stage)).or_default() += 1;
    }

    /// Adds another one's counts.
    pub fn add(&mut self, other: &Matrix) {
        for (cell, n) in &other.0 {
            *self.0.entry(*cell).or_default() += n;
        }
    }

    /// How often a kind of fault has hit a stage.
    #[must_use]
    pub fn hits(&self, kind: &str, stage: Stage) -> u64 {
        let found = self.0.iter().find(|(k, _)| k.0 == kind && k.1 == stage);
        found.map_or(0, |(_, n)| *n)
    }

    /// Cells that could be reached and were not.
    #[must_use]
    pub fn empty(&self) -> Vec<(&'static str, Stage)> {
        kinds()
            .flat_map(|kind| Stage::ALL.map(|stage| (kind, stage)))
            .filter(|(kind, stage)| is_reachable(kind, *stage) && self.hits(kind, *stage) == 0)
            .collect()
    }
}

/// Whether a kind of fault can hit a stage at all.
#[must_use]
pub fn is_reachable(kind: &str, stage: Stage) -> bool {
    match stage {
        // There is no replica to be wiped on a node that has just started; on one that runs unregistered there is.
        Stage::NodeRestart | Stage::Join => kind != "missing replica",
        _ => true,
    }
}

impl World {
    /// Whether a stage is under way at the target of a fault.
    pub(super) fn in_stage(&self, stage: Stage, target: Target) -> bool {
        let mca = |state| self.is_any_mca(state, target);
        match stage {
            Stage::Join => (0..self.nodes.len()).any(|n| {
                let concerned = match target {
                    Target::Node(m) => n == m,
                    Target::Mc(mc) => self.cell.mcs[mc].hosts.contains(&n),
                    Target::Cell => true,
                };
                let node = self.nodes[n].as_ref().filter(|_| concerned);
                node.is_some_and(|node| !node.agents.controller().is_registered())
            }),
            Stage::Opening => mca(McaState::Opening),
            Stage::Active => mca(McaState::Active),
            Stage::Releasing => mca(McaState::Releasing),
            Stage::Recovering => mca(McaState::Recovering),
            Stage::Plan => self.managing.agents.as_ref().is_some_and(|manager| {
                manager.view().mcs.iter().any(|(mc, view)| {
                    view.under_way.is_some()
                        && match target {
                            Target::Mc(index) => self.cell.mcs[index].mc == *mc,
                            _ => true,
                        }
                })
            }),
            Stage::NodeRestart => match target {
                Target::Node(n) => self.restarts(Pid::Node(n)),
                _ => (0..self.nodes.len()).any(|n| self.restarts(Pid::Node(n))),
            },
            Stage::ManagerRestart => self.restarts(Pid::Manager),
            Stage::GatewayRestart => self.restarts(Pid::Gateway),
        }
    }

    fn is_any_mca(&self, state: McaState, target: Target) -> bool {
        let nodes = match target {
            Target::Node(n) => n..n + 1,
            _ => 0..self.nodes.len(),
        };
        self.nodes[nodes].iter().flatten().any(|node| match target {
            Target::Mc(mc) => node
                .agents
                .component(&self.cell.mcs[mc].mc)
                .is_some_and(|c| c.state() == state),
            _ => node.agents.components().any(|c| c.state() == state),
        })
    }

    /// The first start of a process is not a restart.
    fn restarts(&self, pid: Pid) -> bool {
        let Some(life) = self.lives.get(&pid) else {
            return false;
        };
        if self.is_up(pid) {
            life.starts > 1 && self.now_us < life.started_us + RESTARTED_US
        } else {
            true
        }
    }

    /// Counts the stages that a fault hits; whether a failover or a move is in flight.
    pub(super) fn count_stages(&mut self, fault: &Fault) {
        let target = fault.target(|mc| self.cell.index(mc));
        for stage in Stage::ALL {
            if self.in_stage(stage, target) {
                self.matrix.count(fault.kind(), stage);
            }
        }
        if self.in_stage(Stage::Plan, Target::Cell) || self.in_stage(Stage::Opening, Target::Cell) {
            self.in_flight += 1;
        }
    }

    /// A fault of the schedule waits for its stage.
    pub(super) fn wait_for_stage(&mut self, n: usize) {
        if let (When::Aimed { stage, plus_us, .. }, fault) = &self.schedule[n] {
            let target = fault.target(|mc| self.cell.index(mc));
            self.aimed.push((n, *stage, target, *plus_us));
        }
    }

    /// Faults whose stage has come, wherever that is: they are led there.
    pub(super) fn take_aim(&mut self) {
        let mut waiting = std::mem::take(&mut self.aimed);
        waiting.retain(|(n, stage, target, plus_us)| {
            let Some(found) = self.find_stage(*stage, *target) else {
                return true;
            };
            let mut fault = self.schedule[*n].1.clone();
            fault.lead_to(found, &self.cell.mcs);
            self.lead_to_replica(&mut fault);
            // A process that is down, or a replica that is not there, cannot be hit: the fault waits until it can be.
            if !self.has_effect(&fault) {
                return true;
            }
            self.schedule[*n].1 = fault;
            self.queue
                .push_first(self.now_us + 1 + plus_us, Event::Fault(*n));
            false
        });
        self.aimed = waiting;
    }

    /// What a node runs it holds no replica of: a replica is wiped of an MC that runs elsewhere.
    fn lead_to_replica(&self, fault: &mut Fault) {
        if let Fault::WipedReplica { node, mc } = fault
            && let Some(there) = &self.nodes[*node]
            && !there.holds(*mc)
            && let Some(held) = (0..self.cell.mcs.len()).find(|mc| there.holds(*mc))
        {
            *mc = held;
        }
    }

    /// Where a stage is under way, among targets of the same kind.
    fn find_stage(&self, stage: Stage, like: Target) -> Option<Target> {
        if self.in_stage(stage, like) {
            return Some(like);
        }
        let found = |target: &Target| self.in_stage(stage, *target);
        match like {
            Target::Node(_) => (0..self.nodes.len()).map(Target::Node).find(found),
            Target::Mc(_) => (0..self.cell.mcs.len()).map(Target::Mc).find(found),
            Target::Cell => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_matrix_knows_what_it_lacks() {
        let mut matrix = Matrix::default();
        let all = matrix.empty().len();
        matrix.count("node crash", Stage::Opening);
        matrix.count("node crash", Stage::Opening);
        assert_eq!(matrix.hits("node crash", Stage::Opening), 2);
        assert_eq!(matrix.empty().len(), all - 1);
        assert!(!matrix.empty().contains(&("missing replica", Stage::Join)));
    }
}
