//! What may go wrong: the faults, what they are counted as, how long they last and whom they hit.

use super::cell::McInfo;
use super::network::{Pid, Weather};
use fam_proto::{CommandKind, McId};
use serde::{Deserialize, Serialize};

/// How long the first node is down if a fault that was meant for another one for good is led to it, in microseconds.
const FIRST_NODE_DOWN_US: u64 = 500_000;

/// A fault, or an operator at the wrong moment.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Fault {
    /// A process is killed and started again after a while; `None`: not before the quiet time, if at all. With `after_outputs` it dies
    /// in the middle of carrying out what its state machine wants.
    Crash {
        /// Which.
        pid: Pid,
        /// Outputs that it still carries out.
        after_outputs: Option<u32>,
        /// How long it is down, in microseconds.
        down_us: Option<u64>,
    },
    /// A process stands still for a while (SIGSTOP, SIGCONT): what comes meanwhile waits.
    Freeze {
        /// Which.
        pid: Pid,
        /// How long, in microseconds.
        us: u64,
    },
    /// A node is asked to end (SIGTERM), and started again after a while.
    Terminate {
        /// Which.
        node: usize,
        /// How long it is down then, in microseconds.
        down_us: u64,
    },
    /// These directions are cut for a while.
    Cut {
        /// From and to.
        pairs: Vec<(Pid, Pid)>,
        /// How long, in microseconds.
        us: u64,
    },
    /// The network is bad for a while.
    Storm {
        /// What kind of bad.
        kind: Storm,
        /// How.
        weather: Weather,
        /// How long, in microseconds.
        us: u64,
    },
    /// A direction takes longer than the others for a while.
    SlowLink {
        /// From.
        from: Pid,
        /// To.
        to: Pid,
        /// How much longer, in microseconds.
        by_us: u64,
        /// How long, in microseconds.
        us: u64,
    },
    /// An operator's command.
    Command(CommandKind),
    /// The logic of an MC traps.
    Trap {
        /// Which MC.
        mc: usize,
        /// Whether its actions trap too.
        always: bool,
    },
    /// The field does not answer for a while: inputs are not fresh.
    FieldSilent {
        /// How long, in microseconds.
        us: u64,
    },
    /// The manager's disk refuses writes for a while.
    ManagerDiskFails {
        /// How long, in microseconds.
        us: u64,
    },
    /// The manager's machine loses its power in the middle of a write to its disk.
    ManagerDiskCrash {
        /// Operations on the disk that still go well.
        operations: u64,
        /// What was not synced may be there in part, down to single sectors.
        torn: bool,
        /// How long it is down, in microseconds.
        down_us: u64,
    },
    /// The manager is killed, and started again on an old copy of its repository.
    OldCopy {
        /// Which copy: 0 is the newest.
        back: usize,
        /// How long it is down, in microseconds.
        down_us: u64,
    },
    /// A second manager runs for a while, on a copy of the repository.
    SecondManager {
        /// Which copy; `None`: one made at that moment.
        back: Option<usize>,
        /// How long, in microseconds.
        us: u64,
    },
    /// The gateway's disk refuses syncs for a while.
    GatewayDiskFails {
        /// How long, in microseconds.
        us: u64,
    },
    /// The gateway is killed in the middle of writing a head into its record.
    GatewayTornRecord {
        /// How long it is down, in microseconds.
        down_us: u64,
    },
    /// The gateway's machine loses its power: what was not synced is gone.
    GatewayPower {
        /// How long it is down, in microseconds.
        down_us: u64,
    },
    /// A node's link is congested for a while: images to it get lost, messages do not.
    LostImages {
        /// Which.
        node: usize,
        /// How many, in a thousand.
        permille: u64,
        /// How long, in microseconds.
        us: u64,
    },
    /// Images to a node come late for a while, messages do not.
    StaleImages {
        /// Which.
        node: usize,
        /// How late, in microseconds.
        by_us: u64,
        /// How long, in microseconds.
        us: u64,
    },
    /// Frames to a node's replicas get lost for a while: what they hold grows old.
    LostFrames {
        /// Which.
        node: usize,
        /// How many, in a thousand.
        permille: u64,
        /// How long, in microseconds.
        us: u64,
    },
    /// A node's replica of an MC forgets all checkpoints, its agent does not know of it.
    WipedReplica {
        /// Which.
        node: usize,
        /// Of which MC.
        mc: usize,
    },
    /// A node comes back with another version of an MC's project, and later with the right one.
    OtherVersion {
        /// Which.
        node: usize,
        /// Of which MC.
        mc: usize,
        /// How long, in microseconds.
        us: u64,
    },
    /// A node's scan thread wakes late for a while.
    LateTicks {
        /// Which.
        node: usize,
        /// How late at most, in microseconds.
        late_us: u64,
        /// How long, in microseconds.
        us: u64,
    },
    /// Each scan on a node takes longer for a while: ticks are overrun.
    SlowScans {
        /// Which.
        node: usize,
        /// How much longer, in microseconds.
        by_us: u64,
        /// How long, in microseconds.
        us: u64,
    },
    /// A process's monotonic clock runs too fast or too slow for a while.
    ClockDrift {
        /// Whose.
        pid: Pid,
        /// How much too fast, in millionths.
        ppm: i64,
        /// How long, in microseconds.
        us: u64,
    },
    /// The wall clock of a process's machine is set to another time, for good.
    ClockStep {
        /// Whose.
        pid: Pid,
        /// By how much, in microseconds.
        by_us: i64,
    },
}

/// Kinds of bad weather.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Storm {
    /// All takes longer, in order.
    Delay,
    /// Nothing keeps its order.
    Reordering,
    /// Messages get lost.
    Loss,
    /// Messages arrive twice.
    Duplication,
}

/// Whom a fault hits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    /// A node.
    Node(usize),
    /// An MC.
    Mc(usize),
    /// The cell.
    Cell,
}

impl Fault {
    /// What it is counted as.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Fault::Crash {
                pid: Pid::Manager, ..
            } => "manager crash",
            Fault::Crash {
                pid: Pid::Gateway, ..
            } => "gateway crash",
            Fault::Crash { .. } => "node crash",
            Fault::Freeze {
                pid: Pid::Manager, ..
            } => "manager freeze",
            Fault::Freeze {
                pid: Pid::Gateway, ..
            } => "gateway freeze",
            Fault::Freeze { .. } => "node freeze",
            Fault::Terminate { .. } => "node SIGTERM",
            Fault::Cut { pairs, .. } if pairs.len() == 1 => "one-way cut",
            Fault::Cut { pairs, .. } if pairs.len() == 2 => "two-way cut",
            Fault::Cut { .. } => "isolation",
            Fault::Storm { kind, .. } => match kind {
                Storm::Delay => "delay",
                Storm::Reordering => "reordering",
                Storm::Loss => "loss",
                Storm::Duplication => "duplication",
            },
            Fault::SlowLink { .. } => "slow link",
            Fault::Command(CommandKind::Move { force: true, .. }) => "forced move",
            Fault::Command(CommandKind::Move { .. }) => "move",
            Fault::Command(CommandKind::Drain(_)) => "drain",
            Fault::Command(CommandKind::Undrain(_)) => "undrain",
            Fault::Command(CommandKind::Stop(_)) => "stop",
            Fault::Command(CommandKind::Reset { .. }) => "reset",
            Fault::Command(CommandKind::Pin { .. }) => "pin",
            Fault::Command(CommandKind::Unpin(_)) => "unpin",
            Fault::Command(CommandKind::Acknowledge(_)) => "acknowledge",
            Fault::Command(CommandKind::Reload(_)) => "reload",
            Fault::Trap { .. } => "trap",
            Fault::FieldSilent { .. } => "silent field",
            Fault::ManagerDiskFails { .. } => "manager's disk fails",
            Fault::ManagerDiskCrash { torn: false, .. } => "manager's disk loses writes",
            Fault::ManagerDiskCrash { .. } => "manager's disk tears writes",
            Fault::OldCopy { .. } => "old copy of repository",
            Fault::SecondManager { .. } => "second manager",
            Fault::GatewayDiskFails { .. } => "gateway's disk fails",
            Fault::GatewayTornRecord { .. } => "gateway's record torn",
            Fault::GatewayPower { .. } => "gateway power failure",
            Fault::LostImages { .. } => "missing images",
            Fault::StaleImages { .. } => "stale images",
            Fault::LostFrames { .. } => "old replicas",
            Fault::WipedReplica { .. } => "missing replica",
            Fault::OtherVersion { .. } => "other version",
            Fault::LateTicks { .. } => "late ticks",
            Fault::SlowScans { .. } => "slow scans",
            Fault::ClockDrift { .. } => "clock drift",
            Fault::ClockStep { .. } => "clock step",
        }
    }

    /// How long it lasts, in microseconds.
    #[must_use]
    pub fn lasts_us(&self) -> u64 {
        match self {
            Fault::Freeze { us, .. }
            | Fault::Cut { us, .. }
            | Fault::Storm { us, .. }
            | Fault::SlowLink { us, .. }
            | Fault::FieldSilent { us }
            | Fault::ManagerDiskFails { us }
            | Fault::SecondManager { us, .. }
            | Fault::GatewayDiskFails { us }
            | Fault::LostImages { us, .. }
            | Fault::StaleImages { us, .. }
            | Fault::LostFrames { us, .. }
            | Fault::OtherVersion { us, .. }
            | Fault::LateTicks { us, .. }
            | Fault::SlowScans { us, .. }
            | Fault::ClockDrift { us, .. } => *us,
            Fault::Crash { down_us, .. } => down_us.unwrap_or(0),
            Fault::ManagerDiskCrash { down_us, .. }
            | Fault::OldCopy { down_us, .. }
            | Fault::GatewayTornRecord { down_us }
            | Fault::GatewayPower { down_us } => *down_us,
            Fault::Terminate { .. }
            | Fault::Command(_)
            | Fault::Trap { .. }
            | Fault::WipedReplica { .. }
            | Fault::ClockStep { .. } => 0,
        }
    }

    /// The same fault, half as long; `None` if it has no length, or hardly any.
    #[must_use]
    pub fn halved(&self) -> Option<Fault> {
        let mut half = self.clone();
        let us = match &mut half {
            Fault::Freeze { us, .. }
            | Fault::Cut { us, .. }
            | Fault::Storm { us, .. }
            | Fault::SlowLink { us, .. }
            | Fault::FieldSilent { us }
            | Fault::ManagerDiskFails { us }
            | Fault::SecondManager { us, .. }
            | Fault::GatewayDiskFails { us }
            | Fault::LostImages { us, .. }
            | Fault::StaleImages { us, .. }
            | Fault::LostFrames { us, .. }
            | Fault::OtherVersion { us, .. }
            | Fault::LateTicks { us, .. }
            | Fault::SlowScans { us, .. }
            | Fault::ClockDrift { us, .. } => us,
            Fault::Crash {
                down_us: Some(us), ..
            }
            | Fault::ManagerDiskCrash { down_us: us, .. }
            | Fault::OldCopy { down_us: us, .. }
            | Fault::GatewayTornRecord { down_us: us }
            | Fault::GatewayPower { down_us: us } => us,
            Fault::Crash { down_us: None, .. }
            | Fault::Terminate { .. }
            | Fault::Command(_)
            | Fault::Trap { .. }
            | Fault::WipedReplica { .. }
            | Fault::ClockStep { .. } => return None,
        };
        if *us < 20_000 {
            return None;
        }
        *us /= 2;
        Some(half)
    }

    /// Leads it to another target of the same kind.
    pub(super) fn lead_to(&mut self, target: Target, mcs: &[McInfo]) {
        match (target, self) {
            (Target::Node(n), Fault::Crash { pid, down_us, .. }) => {
                *pid = Pid::Node(n);
                if n == 0 {
                    // One node always comes back: with none at all nothing can be in flight any more.
                    down_us.get_or_insert(FIRST_NODE_DOWN_US);
                }
            }
            (
                Target::Node(n),
                Fault::Freeze { pid, .. }
                | Fault::ClockDrift { pid, .. }
                | Fault::ClockStep { pid, .. }
                | Fault::SlowLink { to: pid, .. },
            ) => *pid = Pid::Node(n),
            (
                Target::Node(n),
                Fault::Terminate { node, .. }
                | Fault::LostImages { node, .. }
                | Fault::StaleImages { node, .. }
                | Fault::LostFrames { node, .. }
                | Fault::LateTicks { node, .. }
                | Fault::SlowScans { node, .. },
            ) => *node = n,
            // What is hosted differs from node to node.
            (
                Target::Node(n),
                Fault::WipedReplica { node, mc } | Fault::OtherVersion { node, mc, .. },
            ) => {
                let hosted = |mc: &usize| mcs[*mc].hosts.contains(&n);
                if let Some(found) = std::iter::once(*mc).chain(0..mcs.len()).find(hosted) {
                    (*node, *mc) = (n, found);
                }
            }
            (
                Target::Mc(n),
                Fault::Command(
                    CommandKind::Move { mc, .. }
                    | CommandKind::Pin { mc, .. }
                    | CommandKind::Unpin(mc)
                    | CommandKind::Stop(mc)
                    | CommandKind::Reset { mc, .. },
                ),
            ) => *mc = mcs[n].mc.clone(),
            (Target::Mc(n), Fault::Trap { mc, .. }) => *mc = n,
            _ => {}
        }
    }

    /// Whom it hits. `mc` tells an MC's place in the cell.
    pub fn target(&self, mc: impl Fn(&McId) -> Option<usize>) -> Target {
        let node = |pid: &Pid| match pid {
            Pid::Node(n) => Target::Node(*n),
            _ => Target::Cell,
        };
        match self {
            Fault::Crash { pid, .. }
            | Fault::Freeze { pid, .. }
            | Fault::ClockDrift { pid, .. }
            | Fault::ClockStep { pid, .. }
            | Fault::SlowLink { to: pid, .. } => node(pid),
            Fault::Terminate { node, .. }
            | Fault::LostImages { node, .. }
            | Fault::StaleImages { node, .. }
            | Fault::LostFrames { node, .. }
            | Fault::WipedReplica { node, .. }
            | Fault::OtherVersion { node, .. }
            | Fault::LateTicks { node, .. }
            | Fault::SlowScans { node, .. } => Target::Node(*node),
            Fault::Command(
                CommandKind::Move { mc: name, .. }
                | CommandKind::Pin { mc: name, .. }
                | CommandKind::Unpin(name)
                | CommandKind::Stop(name)
                | CommandKind::Reset { mc: name, .. },
            ) => mc(name).map_or(Target::Cell, Target::Mc),
            Fault::Trap { mc, .. } => Target::Mc(*mc),
            Fault::Cut { .. }
            | Fault::Storm { .. }
            | Fault::Command(
                CommandKind::Drain(_)
                | CommandKind::Undrain(_)
                | CommandKind::Acknowledge(_)
                | CommandKind::Reload(_),
            )
            | Fault::FieldSilent { .. }
            | Fault::ManagerDiskFails { .. }
            | Fault::ManagerDiskCrash { .. }
            | Fault::OldCopy { .. }
            | Fault::SecondManager { .. }
            | Fault::GatewayDiskFails { .. }
            | Fault::GatewayTornRecord { .. }
            | Fault::GatewayPower { .. } => Target::Cell,
        }
    }
}
