//! What goes wrong, and when: chosen by the seed before the run begins.

use super::cell::Cell;
use super::network::{Pid, Weather};
use super::random::Random;
use fam_proto::{CommandKind, Reset};

/// A fault, or an operator at the wrong moment.
#[derive(Debug, Clone, PartialEq, Eq)]
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
        name: &'static str,
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
    /// The gateway's disk refuses syncs for a while.
    GatewayDiskFails {
        /// How long, in microseconds.
        us: u64,
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
    /// A node's scan thread wakes late for a while.
    LateTicks {
        /// Which.
        node: usize,
        /// How late at most, in microseconds.
        late_us: u64,
        /// How long, in microseconds.
        us: u64,
    },
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
            Fault::Storm { name, .. } => name,
            Fault::SlowLink { .. } => "slow link",
            Fault::Command(CommandKind::Move { force: true, .. }) => "forced move",
            Fault::Command(CommandKind::Move { .. }) => "move",
            Fault::Command(CommandKind::Drain(_)) => "drain",
            Fault::Command(CommandKind::Undrain(_)) => "undrain",
            Fault::Command(CommandKind::Stop(_)) => "stop",
            Fault::Command(CommandKind::Reset { .. }) => "reset",
            Fault::Command(_) => "other command",
            Fault::Trap { .. } => "trap",
            Fault::FieldSilent { .. } => "silent field",
            Fault::ManagerDiskFails { .. } => "manager's disk fails",
            Fault::GatewayDiskFails { .. } => "gateway's disk fails",
            Fault::LostImages { .. } => "lost images",
            Fault::LateTicks { .. } => "late ticks",
        }
    }

    /// Until when it lasts if it begins at `at_us`.
    #[must_use]
    pub fn ends_us(&self, at_us: u64) -> u64 {
        at_us
            + match self {
                Fault::Freeze { us, .. }
                | Fault::Cut { us, .. }
                | Fault::Storm { us, .. }
                | Fault::SlowLink { us, .. }
                | Fault::FieldSilent { us }
                | Fault::ManagerDiskFails { us }
                | Fault::GatewayDiskFails { us }
                | Fault::LostImages { us, .. }
                | Fault::LateTicks { us, .. } => *us,
                Fault::Crash { down_us, .. } => down_us.unwrap_or(0),
                Fault::Terminate { .. } | Fault::Command(_) | Fault::Trap { .. } => 0,
            }
    }
}

/// How much goes wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trouble {
    /// When the first fault may come, in microseconds.
    pub from_us: u64,
    /// When the last one may come, in microseconds.
    pub to_us: u64,
    /// Fewest and most faults.
    pub faults: (u64, u64),
}

/// The schedule of a seed: when, and what.
#[must_use]
pub fn schedule(cell: &Cell, trouble: &Trouble, random: &mut Random) -> Vec<(u64, Fault)> {
    let count = random.between(trouble.faults.0, trouble.faults.1);
    let mut schedule = Vec::new();
    let mut at_us = trouble.from_us;
    let mean_us = (trouble.to_us - trouble.from_us) / count.max(1);
    for _ in 0..count {
        // Many come in company: the second one hits the answer to the first.
        at_us += if random.chance(350) {
            random.below(40_000)
        } else {
            random.below(2 * mean_us)
        };
        schedule.push((at_us.min(trouble.to_us), fault(cell, random)));
    }
    schedule
}

fn fault(cell: &Cell, random: &mut Random) -> Fault {
    let node = random.index(cell.controllers.len());
    let controller = cell.controllers[node].clone();
    let mc = random.index(cell.mcs.len());
    let mc_id = cell.mcs[mc].mc.clone();
    let host = *random.pick(&cell.mcs[mc].hosts).unwrap_or(&node);
    let to = cell.controllers[host].clone();
    let ms = |random: &mut Random, from, to| 1_000 * random.between(from, to);
    match random.below(100) {
        0..16 => Fault::Crash {
            pid: Pid::Node(node),
            after_outputs: in_the_middle(random),
            down_us: (!random.chance(300)).then(|| ms(random, 20, 1_500)),
        },
        16..28 => Fault::Freeze {
            pid: Pid::Node(node),
            us: ms(random, 15, 1_500),
        },
        28..36 => Fault::Crash {
            pid: Pid::Manager,
            after_outputs: in_the_middle(random),
            down_us: Some(ms(random, 5, 900)),
        },
        36..39 => Fault::Freeze {
            pid: Pid::Manager,
            us: ms(random, 20, 1_200),
        },
        39..46 => Fault::Crash {
            pid: Pid::Gateway,
            after_outputs: in_the_middle(random),
            down_us: Some(ms(random, 5, 700)),
        },
        46..49 => Fault::Freeze {
            pid: Pid::Gateway,
            us: ms(random, 10, 900),
        },
        49..59 => cut(cell, random),
        59..63 => Fault::SlowLink {
            from: Pid::Gateway,
            to: Pid::Node(node),
            by_us: ms(random, 2, 60),
            us: ms(random, 100, 1_500),
        },
        63..71 => storm(random),
        71..79 => Fault::Command(CommandKind::Move {
            mc: mc_id,
            to,
            force: random.chance(100),
        }),
        79..83 => Fault::Command(CommandKind::Drain(controller)),
        83..86 => Fault::Command(CommandKind::Undrain(controller)),
        86..87 => Fault::Command(CommandKind::Stop(mc_id)),
        87..89 => Fault::Command(CommandKind::Reset {
            mc: mc_id,
            how: *random
                .pick(&[Reset::Cold, Reset::Warm, Reset::Resume])
                .unwrap_or(&Reset::Cold),
        }),
        89..91 => Fault::Trap {
            mc,
            always: random.chance(300),
        },
        91..93 => Fault::FieldSilent {
            us: ms(random, 10, 400),
        },
        93..95 => Fault::ManagerDiskFails {
            us: ms(random, 10, 1_000),
        },
        95..96 => Fault::GatewayDiskFails {
            us: ms(random, 10, 300),
        },
        96..97 => Fault::Terminate {
            node,
            down_us: ms(random, 20, 800),
        },
        97..99 => Fault::LostImages {
            node,
            permille: random.between(200, 950),
            us: ms(random, 50, 1_500),
        },
        _ => Fault::LateTicks {
            node,
            late_us: ms(random, 4, 30),
            us: ms(random, 50, 500),
        },
    }
}

fn in_the_middle(random: &mut Random) -> Option<u32> {
    random
        .chance(500)
        .then(|| u32::try_from(random.below(40)).unwrap_or(0))
}

fn cut(cell: &Cell, random: &mut Random) -> Fault {
    let mut all = vec![Pid::Manager, Pid::Gateway];
    all.extend((0..cell.controllers.len()).map(Pid::Node));
    let a = random.index(all.len());
    let b = (a + 1 + random.index(all.len() - 1)) % all.len();
    let (a, b) = (all[a], all[b]);
    let pairs = match random.below(10) {
        0..4 => vec![(a, b)],
        4..8 => vec![(a, b), (b, a)],
        _ => all
            .iter()
            .filter(|c| **c != a)
            .flat_map(|c| [(a, *c), (*c, a)])
            .collect(),
    };
    Fault::Cut {
        pairs,
        us: 1_000 * random.between(5, 1_500),
    }
}

fn storm(random: &mut Random) -> Fault {
    let us = 1_000 * random.between(20, 700);
    let slowest = 1_000 * random.between(2, 120);
    let weather = |delay_us, lost_permille, doubled_permille, ordered| Weather {
        delay_us,
        lost_permille,
        doubled_permille,
        ordered,
    };
    let (name, weather) = match random.below(4) {
        0 => ("delay", weather((100, slowest), 0, 0, true)),
        1 => ("reordering", weather((60, slowest), 0, 0, false)),
        2 => (
            "loss",
            weather((60, 1_000), random.between(50, 400), 0, true),
        ),
        _ => (
            "duplication",
            weather((60, 10_000), 20, random.between(100, 500), false),
        ),
    };
    Fault::Storm { name, weather, us }
}
