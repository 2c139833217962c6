//! The schedule of faults that a seed chooses: some at a time, some aimed at a stage of a flow.

use super::cell::Cell;
use super::faults::{Fault, Storm};
use super::network::{Pid, Weather};
use super::random::Random;
use super::stages::Stage;
use fam_proto::{CommandKind, Reset};

/// How much goes wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trouble {
    /// When the first fault may come, in microseconds.
    pub from_us: u64,
    /// When the last one may come, in microseconds.
    pub to_us: u64,
    /// Fewest and most faults; those that only prepare the ground for an aimed one come on top.
    pub faults: (u64, u64),
    /// Faults that are aimed at a stage of a flow, in a thousand.
    pub aimed_permille: u64,
    /// Only what leaves a real plant in a state from which its logic can go on: no initial values, no lost records.
    pub gentle: bool,
}

/// When a fault comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum When {
    /// At this time, in microseconds.
    At(u64),
    /// A little after the stage is seen at its target.
    Aimed {
        /// Not before this time, in microseconds.
        from_us: u64,
        /// The stage.
        stage: Stage,
        /// How long after, in microseconds.
        plus_us: u64,
    },
}

/// Kinds of faults: name, how often among those that come at a time, and how one is made.
type Maker = fn(&Cell, &mut Random) -> Fault;
const KINDS: &[(&str, u64, Maker)] = &[
    ("node crash", 15, |c, r| crash(Pid::Node(node(c, r)), r)),
    ("node freeze", 9, |c, r| freeze(Pid::Node(node(c, r)), r)),
    ("node SIGTERM", 2, |c, r| Fault::Terminate {
        node: node(c, r),
        down_us: ms(r, 20, 800),
    }),
    ("manager crash", 7, |_, r| crash(Pid::Manager, r)),
    ("manager freeze", 3, |_, r| freeze(Pid::Manager, r)),
    ("gateway crash", 6, |_, r| crash(Pid::Gateway, r)),
    ("gateway freeze", 3, |_, r| freeze(Pid::Gateway, r)),
    ("one-way cut", 4, |c, r| cut(1, c, r)),
    ("two-way cut", 4, |c, r| cut(2, c, r)),
    ("isolation", 2, |c, r| cut(3, c, r)),
    ("delay", 2, |_, r| storm(Storm::Delay, r)),
    ("reordering", 2, |_, r| storm(Storm::Reordering, r)),
    ("loss", 2, |_, r| storm(Storm::Loss, r)),
    ("duplication", 2, |_, r| storm(Storm::Duplication, r)),
    ("slow link", 3, |c, r| Fault::SlowLink {
        from: if r.chance(700) {
            Pid::Gateway
        } else {
            Pid::Manager
        },
        to: Pid::Node(node(c, r)),
        by_us: ms(r, 2, 60),
        us: ms(r, 100, 1_500),
    }),
    ("move", 7, |c, r| moving(c, r, false)),
    ("forced move", 1, |c, r| moving(c, r, true)),
    ("drain", 3, |c, r| {
        Fault::Command(CommandKind::Drain(c.controllers[node(c, r)].clone()))
    }),
    ("undrain", 3, |c, r| {
        Fault::Command(CommandKind::Undrain(c.controllers[node(c, r)].clone()))
    }),
    ("pin", 1, |c, r| {
        let mc = r.index(c.mcs.len());
        let to = r.chance(500).then(|| host(c, mc, r));
        Fault::Command(CommandKind::Pin {
            mc: c.mcs[mc].mc.clone(),
            to: to.map(|n| c.controllers[n].clone()),
        })
    }),
    ("unpin", 1, |c, r| {
        Fault::Command(CommandKind::Unpin(c.mcs[r.index(c.mcs.len())].mc.clone()))
    }),
    ("stop", 1, |c, r| {
        Fault::Command(CommandKind::Stop(c.mcs[r.index(c.mcs.len())].mc.clone()))
    }),
    ("reset", 2, |c, r| {
        Fault::Command(CommandKind::Reset {
            mc: c.mcs[r.index(c.mcs.len())].mc.clone(),
            how: *r
                .pick(&[Reset::Cold, Reset::Warm, Reset::Resume])
                .unwrap_or(&Reset::Cold),
        })
    }),
    ("acknowledge", 1, |_, _| {
        Fault::Command(CommandKind::Acknowledge(Some(1)))
    }),
    ("trap", 2, |c, r| Fault::Trap {
        mc: r.index(c.mcs.len()),
        always: r.chance(300),
    }),
    ("silent field", 2, |_, r| Fault::FieldSilent {
        us: ms(r, 10, 400),
    }),
    ("manager's disk fails", 2, |_, r| Fault::ManagerDiskFails {
        us: ms(r, 10, 1_000),
    }),
    ("manager's disk loses writes", 2, |_, r| {
        Fault::ManagerDiskCrash {
            operations: r.below(24),
            torn: false,
            down_us: ms(r, 5, 700),
        }
    }),
    ("manager's disk tears writes", 2, |_, r| {
        Fault::ManagerDiskCrash {
            operations: r.below(24),
            torn: true,
            down_us: ms(r, 5, 700),
        }
    }),
    ("old copy of repository", 2, |_, r| Fault::OldCopy {
        back: r.index(4),
        down_us: ms(r, 5, 700),
    }),
    ("second manager", 2, |_, r| Fault::SecondManager {
        back: r.chance(500).then(|| r.index(4)),
        us: ms(r, 100, 2_500),
    }),
    ("gateway's disk fails", 2, |_, r| Fault::GatewayDiskFails {
        us: ms(r, 10, 300),
    }),
    ("gateway's record torn", 1, |_, r| {
        Fault::GatewayTornRecord {
            down_us: ms(r, 5, 500),
        }
    }),
    ("gateway power failure", 1, |_, r| Fault::GatewayPower {
        down_us: ms(r, 5, 700),
    }),
    ("missing images", 2, |c, r| Fault::LostImages {
        node: node(c, r),
        permille: r.between(200, 1_000),
        us: ms(r, 50, 1_500),
    }),
    ("stale images", 2, |c, r| Fault::StaleImages {
        node: node(c, r),
        by_us: ms(r, 5, 1_200),
        us: ms(r, 50, 1_500),
    }),
    ("old replicas", 2, |c, r| Fault::LostFrames {
        node: node(c, r),
        permille: r.between(100, 1_000),
        us: ms(r, 100, 2_000),
    }),
    ("missing replica", 1, |c, r| {
        let mc = r.index(c.mcs.len());
        Fault::WipedReplica {
            node: host(c, mc, r),
            mc,
        }
    }),
    ("other version", 1, |c, r| {
        let mc = r.index(c.mcs.len());
        Fault::OtherVersion {
            node: host(c, mc, r),
            mc,
            us: ms(r, 100, 2_000),
        }
    }),
    ("late ticks", 1, |c, r| Fault::LateTicks {
        node: node(c, r),
        late_us: ms(r, 4, 30),
        us: ms(r, 50, 500),
    }),
    ("slow scans", 2, |c, r| {
        let hung = r.chance(300);
        Fault::SlowScans {
            node: node(c, r),
            by_us: if hung { ms(r, 30, 600) } else { ms(r, 1, 8) },
            us: ms(r, 50, 1_000),
        }
    }),
    ("clock drift", 2, |c, r| Fault::ClockDrift {
        pid: any(c, r),
        ppm: i64::try_from(r.below(60_000)).unwrap_or(0) - 30_000,
        us: ms(r, 500, 4_000),
    }),
    ("clock step", 3, |c, r| Fault::ClockStep {
        pid: any(c, r),
        // Mostly back, by less or more than the cell has lived.
        by_us: {
            let by_us = i64::try_from(ms(r, 1, 20_000)).unwrap_or(0);
            if r.chance(800) { -by_us } else { by_us }
        },
    }),
];

/// All kinds of faults.
pub fn kinds() -> impl Iterator<Item = &'static str> {
    KINDS.iter().map(|(name, ..)| *name)
}

/// Whether a kind is left out of gentle schedules.
#[must_use]
pub fn is_rough(kind: &str) -> bool {
    matches!(
        kind,
        "reset" | "stop" | "trap" | "gateway power failure" | "forced move"
    )
}

/// The schedule of a seed: when, and what.
#[must_use]
pub fn schedule(cell: &Cell, trouble: &Trouble, random: &mut Random) -> Vec<(When, Fault)> {
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
        let at_us = at_us.min(trouble.to_us);
        if random.chance(trouble.aimed_permille) {
            let stage = *random.pick(&Stage::ALL).unwrap_or(&Stage::Active);
            let (_, _, make) = pick(trouble, random, |_| 1);
            let fault = make(cell, random);
            if let Some(before) = ground(stage, cell, random) {
                schedule.push((When::At(at_us), before));
            }
            let aimed = When::Aimed {
                from_us: at_us,
                stage,
                plus_us: if random.chance(500) {
                    random.below(300)
                } else {
                    random.below(20_000)
                },
            };
            schedule.push((aimed, fault));
        } else {
            let (_, _, make) = pick(trouble, random, |weight| weight);
            let fault = make(cell, random);
            let step = matches!(fault, Fault::ClockStep { .. }).then(|| fault.clone());
            schedule.push((When::At(at_us), fault));
            // A machine's wall clock is looked at when a process starts.
            if let Some(Fault::ClockStep { pid, .. }) = step {
                let at_us = at_us + random.below(20_000);
                schedule.push((When::At(at_us), crash(pid, random)));
            }
        }
    }
    schedule
}

/// What makes a failover or a move that is in flight when another fault comes: for schedules in which too little has happened.
#[must_use]
pub fn more(
    cell: &Cell,
    trouble: &Trouble,
    now_us: u64,
    random: &mut Random,
) -> [(When, Fault); 4] {
    // What was stopped does not move, and nothing goes where all is drained.
    let undrain = CommandKind::Undrain(cell.controllers[node(cell, random)].clone());
    let reset = CommandKind::Reset {
        mc: cell.mcs[random.index(cell.mcs.len())].mc.clone(),
        how: if trouble.gentle {
            Reset::Resume
        } else {
            Reset::Cold
        },
    };
    let first = if random.chance(500) {
        Fault::Crash {
            pid: Pid::Node(node(cell, random)),
            after_outputs: None,
            down_us: Some(ms(random, 20, 300)),
        }
    } else {
        moving(cell, random, false)
    };
    let second = match random.below(3) {
        0 => cut(1, cell, random),
        1 => storm(Storm::Loss, random),
        _ => storm(Storm::Delay, random),
    };
    let aimed = When::Aimed {
        from_us: now_us,
        stage: Stage::Plan,
        plus_us: random.below(300),
    };
    [
        (aimed, second),
        (When::At(now_us + 500), Fault::Command(undrain)),
        (When::At(now_us + 1_000), Fault::Command(reset)),
        (When::At(now_us + 60_000), first),
    ]
}

fn pick(
    trouble: &Trouble,
    random: &mut Random,
    weight: impl Fn(u64) -> u64,
) -> &'static (&'static str, u64, Maker) {
    let open = |kind: &&(&str, u64, Maker)| !(trouble.gentle && is_rough(kind.0));
    let sum: u64 = KINDS.iter().filter(open).map(|kind| weight(kind.1)).sum();
    let mut at = random.below(sum);
    for kind in KINDS.iter().filter(open) {
        let weight = weight(kind.1);
        if at < weight {
            return kind;
        }
        at -= weight;
    }
    &KINDS[0]
}

/// What brings a stage about.
fn ground(stage: Stage, cell: &Cell, random: &mut Random) -> Option<Fault> {
    let short = |pid, random: &mut Random| Fault::Crash {
        pid,
        after_outputs: None,
        down_us: Some(ms(random, 5, 200)),
    };
    match stage {
        Stage::Active => None,
        Stage::Join | Stage::NodeRestart | Stage::Recovering => {
            Some(short(Pid::Node(node(cell, random)), random))
        }
        Stage::Opening | Stage::Plan if random.chance(500) => {
            Some(short(Pid::Node(node(cell, random)), random))
        }
        Stage::Opening | Stage::Plan | Stage::Releasing => Some(moving(cell, random, false)),
        Stage::ManagerRestart => Some(short(Pid::Manager, random)),
        Stage::GatewayRestart => Some(short(Pid::Gateway, random)),
    }
}

fn ms(random: &mut Random, from: u64, to: u64) -> u64 {
    1_000 * random.between(from, to)
}

fn node(cell: &Cell, random: &mut Random) -> usize {
    random.index(cell.controllers.len())
}

fn host(cell: &Cell, mc: usize, random: &mut Random) -> usize {
    random.pick(&cell.mcs[mc].hosts).copied().unwrap_or(0)
}

fn any(cell: &Cell, random: &mut Random) -> Pid {
    match random.below(4) {
        0 => Pid::Manager,
        1 => Pid::Gateway,
        _ => Pid::Node(node(cell, random)),
    }
}

fn moving(cell: &Cell, random: &mut Random, force: bool) -> Fault {
    let mc = random.index(cell.mcs.len());
    let to = cell.controllers[host(cell, mc, random)].clone();
    let mc = cell.mcs[mc].mc.clone();
    Fault::Command(CommandKind::Move { mc, to, force })
}

fn crash(pid: Pid, random: &mut Random) -> Fault {
    let after_outputs = random
        .chance(500)
        .then(|| u32::try_from(random.below(40)).unwrap_or(0));
    let down_us = match pid {
        Pid::Manager | Pid::Rival => Some(ms(random, 5, 900)),
        Pid::Gateway => Some(ms(random, 5, 700)),
        Pid::Node(n) => {
            let down_us = ms(random, 20, 1_500);
            let for_good = random.chance(300);
            (n == 0 || !for_good).then_some(down_us)
        }
        Pid::Operator => None,
    };
    Fault::Crash {
        pid,
        after_outputs,
        down_us,
    }
}

fn freeze(pid: Pid, random: &mut Random) -> Fault {
    Fault::Freeze {
        pid,
        us: match pid {
            Pid::Gateway => ms(random, 10, 900),
            _ => ms(random, 15, 1_500),
        },
    }
}

fn cut(kind: u8, cell: &Cell, random: &mut Random) -> Fault {
    let mut all = vec![Pid::Manager, Pid::Gateway];
    all.extend((0..cell.controllers.len()).map(Pid::Node));
    let a = random.index(all.len());
    let b = (a + 1 + random.index(all.len() - 1)) % all.len();
    let (a, b) = (all[a], all[b]);
    let pairs = match kind {
        1 => vec![(a, b)],
        2 => vec![(a, b), (b, a)],
        _ => all
            .iter()
            .filter(|c| **c != a)
            .flat_map(|c| [(a, *c), (*c, a)])
            .collect(),
    };
    Fault::Cut {
        pairs,
        us: ms(random, 5, 1_500),
    }
}

fn storm(kind: Storm, random: &mut Random) -> Fault {
    let us = ms(random, 20, 700);
    let slowest = ms(random, 2, 120);
    let weather = |delay_us, lost_permille, doubled_permille, ordered| Weather {
        delay_us,
        lost_permille,
        doubled_permille,
        ordered,
    };
    let weather = match kind {
        Storm::Delay => weather((100, slowest), 0, 0, true),
        Storm::Reordering => weather((60, slowest), 0, 0, false),
        Storm::Loss => weather((60, 1_000), random.between(50, 400), 0, true),
        Storm::Duplication => weather((60, 10_000), 20, random.between(100, 500), false),
    };
    Fault::Storm { kind, weather, us }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::Size;

    #[test]
    fn each_kind_makes_faults_of_its_name() {
        let mut random = Random::new(5, 0);
        let size = Size {
            controllers: (3, 5),
            mcs: (2, 8),
            hosts_max: 5,
            plc: false,
        };
        let cell = Cell::choose(&size, &mut random);
        for (name, _, make) in KINDS {
            for _ in 0..20 {
                assert_eq!(make(&cell, &mut random).kind(), *name);
            }
        }
    }
}
