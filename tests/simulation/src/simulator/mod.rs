//! A whole cell in one thread and virtual time: the real agents, the real cores of gateway, node and repository, a network and disks
//! that fail, and the invariants of the safety contract checked after every event. A seed says everything.
//!
//! ```text
//!  seed ──> cell (controllers, MCs, hosting) ──> schedule of faults ──> run ──> quiet time ──> liveness
//!                                                  after each event: all invariants
//! ```
//!
//! The processes are driven as the production driver drives them: outputs strictly in order, `Persist` answered before the next output.
//! Not simulated: threads inside a process other than the scan thread, the clients' side of
//! commands beyond sending them.

mod canary;
mod cell;
mod delivered;
mod faults;
mod field;
mod gateway;
mod generate;
mod lives;
mod log;
mod logic;
mod manager;
mod network;
mod nodes;
mod profile;
mod quiet;
mod random;
mod stages;
mod time;
mod trouble;
mod world;

pub use canary::Canary;
pub use cell::{Cell, FAIL_SAFE, McInfo, Size, TICK_US};
pub use faults::{Fault, Storm, Target};
pub use generate::{Trouble, When, kinds, schedule};
pub use logic::{Logic, SimMc};
pub use network::{CALM, Network, Pid, Weather};
pub use profile::Profile;
pub use random::Random;
pub use stages::{Matrix, Stage};
pub use time::{Clock, Queue};

use crate::invariants::Violation;
use fam_proto::Applied;
use std::collections::BTreeMap;
use world::World;

/// What is simulated, beside the seed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Options {
    /// Which cells, and how much goes wrong.
    pub profile: Profile,
    /// After the last fault every MC has to be driven within this time, in microseconds.
    pub bound_us: u64,
    /// A schedule of one's own, in place of the one that the seed chooses.
    pub script: Option<Vec<(u64, Fault)>>,
    /// When the faults are over, for a schedule that was recorded.
    pub quiet_us: Option<u64>,
    /// A planted bug.
    pub canary: Option<Canary>,
    /// Only the invariant of this name is checked: whether it finds a planted bug by itself.
    pub only: Option<&'static str>,
    /// Whether the event log is written.
    pub log: bool,
}

impl Default for Options {
    fn default() -> Options {
        Options::of(Profile::Default)
    }
}

impl Options {
    /// Those of a profile.
    #[must_use]
    pub fn of(profile: Profile) -> Options {
        Options {
            profile,
            bound_us: profile.bound_us(),
            script: None,
            quiet_us: None,
            canary: None,
            only: None,
            log: false,
        }
    }
}

/// What came of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// The seed.
    pub seed: u64,
    /// Promises broken: the run ends at the first event that breaks one.
    pub violations: Vec<Violation>,
    /// Faults that were carried out, by kind.
    pub faults: BTreeMap<&'static str, u64>,
    /// The same, each with its time: given as a script, they make the same run again.
    pub carried: Vec<(u64, Fault)>,
    /// When the faults were over, in microseconds.
    pub quiet_us: u64,
    /// Which stages the faults have hit.
    pub matrix: Matrix,
    /// Faults that came while a failover or a move was under way.
    pub in_flight: u64,
    /// Products that the plant has finished, where there is one.
    pub products: u64,
    /// What the cell did, by kind: so that a schedule in which nothing happened is seen.
    pub deeds: BTreeMap<&'static str, u64>,
    /// Events handled.
    pub events: u64,
    /// Virtual time that passed, in microseconds.
    pub virtual_us: u64,
    /// How long after the last fault all MCs were driven again, in microseconds.
    pub recovered_us: u64,
    /// Digest of all events.
    pub digest: u64,
    /// Frames applied to the field, if the log was asked for.
    pub applied: Vec<Applied>,
    /// The event log, if it was asked for.
    pub log: Vec<String>,
}

/// The cell that a seed chooses.
#[must_use]
pub fn cell(seed: u64, options: &Options) -> Cell {
    options.profile.cell(&mut Random::new(seed, 1))
}

/// Runs the schedule of a seed.
#[must_use]
pub fn run(seed: u64, options: &Options) -> Outcome {
    World::new(seed, options).run()
}

/// Runs the schedule of a seed once more with its log, and puts all into one text: for the one who has to find the cause.
#[must_use]
pub fn explain(seed: u64, options: &Options) -> String {
    let options = Options {
        log: true,
        ..options.clone()
    };
    let outcome = run(seed, &options);
    let mut text = format!("seed {seed}\n");
    for line in &outcome.log {
        text.push_str(line);
        text.push('\n');
    }
    for violation in &outcome.violations {
        text.push_str(&format!("VIOLATION {violation}\n"));
    }
    text
}
