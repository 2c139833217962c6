//! What must hold after every event, one file for each promise of the safety contract (design, section 4).
//!
//! The simulator tells what it sees, from outside of all agents: orders on the wire, answers of the gateway, what reaches its
//! record and the field, what scan threads run. [`Facts`] keeps the books; each invariant judges with them and may keep its own.

mod epochs_never_reused;
mod facts;
mod fail_safe_latched;
mod healthy_owner;
mod inputs_never_older;
mod liveness;
mod mc_time;
mod no_invented_state;
mod nothing_lost;
mod one_driver;
mod one_writer;
mod plant_unharmed;
mod recovery;
mod reference;
mod release;
mod repository_keeps;
mod stopped_stays_stopped;
mod successor;
mod trap_not_passed_on;

pub use facts::{Ended, Facts, Grant, HeadFact, McFacts};

use crate::simulator::Cell;
use fam_gateway_core::StoredHead;
use fam_node_core::ScannedFrame;
use fam_proto::{
    Applied, BootId, ControllerId, Epoch, InputImage, Ledger, McId, Opened, Order, Owner, Successor,
};
use std::sync::Arc;

/// What the simulator sees.
#[derive(Debug)]
pub enum Seen<'a> {
    /// A manager sends an order.
    Ordered {
        /// Its life.
        manager: BootId,
        /// Which history its repository tells: a copy begins another one.
        history: u64,
        /// The order.
        order: &'a Order,
        /// To the MC Agent on this controller.
        to: &'a ControllerId,
        /// Highest epoch of the MC that the repository has promised to keep.
        durable: Epoch,
    },
    /// The gateway answers an open with a grant.
    Granted {
        /// The answer.
        opened: &'a Opened,
        /// Who opened.
        owner: &'a Owner,
        /// An operator forced it.
        force: bool,
        /// Whether the gateway sees the liveliness token of the owner before.
        token_seen: bool,
    },
    /// An epoch is on record; its answer may never leave the gateway.
    Opened {
        /// The MC.
        mc: &'a McId,
        /// The ledger.
        ledger: &'a Ledger,
    },
    /// The gateway's record has a new head.
    Recorded {
        /// The MC.
        mc: &'a McId,
        /// The head.
        head: &'a StoredHead,
    },
    /// A frame's outputs are applied to the field.
    Applied {
        /// The journal's entry.
        applied: &'a Applied,
        /// The outputs.
        outputs: &'a [u8],
    },
    /// Fail-safe values are applied to the field.
    FailSafe {
        /// The MC.
        mc: &'a McId,
    },
    /// At its start the gateway sets what stood at the field of an MC that has stopped.
    Kept {
        /// The MC.
        mc: &'a McId,
        /// The outputs.
        outputs: &'a [u8],
    },
    /// The gateway's record says that the fail-safe values are set.
    Closed {
        /// The MC.
        mc: &'a McId,
        /// Because its logic trapped: it needs a reset.
        faulted: bool,
    },
    /// The gateway sends an image.
    Image(&'a Arc<InputImage>),
    /// A scan thread hands a frame on.
    Scanned(&'a ScannedFrame),
    /// An MC Agent sends its MC from normal logic into the stop POU: on order, or after a trap.
    Diverted {
        /// The MC.
        mc: &'a McId,
        /// The node.
        owner: &'a Owner,
        /// The epoch.
        epoch: Epoch,
    },
    /// Logic has trapped on a scan thread.
    Trapped {
        /// The MC.
        mc: &'a McId,
        /// The node.
        owner: &'a Owner,
        /// The epoch.
        epoch: Epoch,
    },
    /// The gateway's machine has lost its power: heads of records are gone.
    PowerLost,
    /// A manager has loaded its repository.
    Restored {
        /// Epochs that were promised and are not there.
        lost: &'a [String],
    },
    /// The gateway hands a write on to its field driver.
    WriteBegun {
        /// The gateway's life.
        gateway: BootId,
        /// Whose outputs.
        mc: &'a McId,
        /// The outputs.
        outputs: &'a [u8],
    },
    /// A write reaches the field.
    Written {
        /// The gateway's life.
        gateway: BootId,
        /// Whose outputs.
        mc: &'a McId,
        /// The outputs.
        outputs: &'a [u8],
    },
    /// What the plant has suffered so far.
    Plant {
        /// Incidents.
        incidents: u64,
        /// The last one.
        last: Option<&'a str>,
    },
    /// The gateway has started, or goes on after it stood still.
    GatewayUp {
        /// It has started anew: all epochs are closed.
        restarted: bool,
    },
    /// The quiet time is over.
    End {
        /// For each MC, whether it has to be driven by now, and what stands in the way.
        must_drive: &'a [(McId, Option<String>)],
    },
}

/// One promise.
pub trait Invariant {
    /// Its name.
    fn name(&self) -> &'static str;
    /// Judges what is seen, with the facts as they were before it.
    ///
    /// # Errors
    /// How the promise was broken.
    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String>;
}

/// A promise that was broken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// Which.
    pub invariant: &'static str,
    /// When, in microseconds of virtual time.
    pub at_us: u64,
    /// How.
    pub text: String,
}

impl std::fmt::Display for Violation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{:.6} s: {}: {}",
            self.at_us as f64 / 1e6,
            self.invariant,
            self.text
        )
    }
}

/// All promises.
pub struct Invariants {
    all: Vec<Box<dyn Invariant>>,
    facts: Facts,
    violations: Vec<Violation>,
}

impl Invariants {
    /// All promises, or only the one of that name, for a cell that has not started.
    #[must_use]
    pub fn new(cell: Arc<Cell>, only: Option<&str>) -> Invariants {
        let mut all: Vec<Box<dyn Invariant>> = vec![
            Box::new(one_driver::OneDriver),
            Box::new(healthy_owner::HealthyOwner),
            Box::<epochs_never_reused::EpochsNeverReused>::default(),
            Box::<no_invented_state::NoInventedState>::default(),
            Box::new(nothing_lost::NothingLost),
            Box::<recovery::RecoveryAsDeclared>::default(),
            Box::new(release::ReleaseOutsideCriticalIntervals),
            Box::new(fail_safe_latched::FailSafeLatched),
            Box::new(mc_time::McTime),
            Box::new(inputs_never_older::InputsNeverOlder),
            Box::new(stopped_stays_stopped::StoppedStaysStopped),
            Box::new(successor::NamedSuccessor),
            Box::<trap_not_passed_on::TrapNotPassedOn>::default(),
            Box::<one_writer::OneWriter>::default(),
            Box::new(repository_keeps::RepositoryKeeps),
            Box::new(plant_unharmed::PlantUnharmed),
            Box::new(liveness::Liveness),
        ];
        all.retain(|invariant| only.is_none_or(|name| invariant.name() == name));
        Invariants {
            all,
            facts: Facts::new(cell),
            violations: Vec::new(),
        }
    }

    /// Judges what is seen.
    pub fn see(&mut self, seen: &Seen<'_>, at_us: u64) {
        self.facts.now_us = at_us;
        for invariant in &mut self.all {
            if let Err(text) = invariant.see(seen, &self.facts) {
                self.violations.push(Violation {
                    invariant: invariant.name(),
                    at_us,
                    text,
                });
            }
        }
        self.facts.take(seen);
    }

    /// Something that no promise covers went wrong: a program error.
    pub fn defect(&mut self, at_us: u64, text: String) {
        self.violations.push(Violation {
            invariant: "no defect",
            at_us,
            text,
        });
    }

    /// What is known.
    #[must_use]
    pub fn facts(&self) -> &Facts {
        &self.facts
    }

    /// Promises broken so far.
    #[must_use]
    pub fn violations(&self) -> &[Violation] {
        &self.violations
    }
}

/// In words.
pub(crate) fn release_words(to: &Successor) -> String {
    format!("epoch {} of {}", to.epoch, to.owner)
}
