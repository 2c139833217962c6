//! The narrow interface between an MC Agent and its MC (the paper's PLCAccessibility): activate with a recovery, release,
//! read the state, stop. A foreign PLC could implement it too.
//!
//! Neither side crosses a wire with these types: agent and MC live in one process.

use crate::ids::{Epoch, Scan};
use crate::v1::{Checkpoint, CheckpointId, Successor, TrapInfo};
use std::sync::Arc;

/// What an MC Agent asks of its MC. Everything but `ReadState` is idempotent.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum McAct {
    /// Give me this checkpoint from the passive instance; answered by [`McNews::State`].
    ReadState {
        /// Which one.
        id: CheckpointId,
    },
    /// Run from the next tick on; answered by [`McNews::Started`] or [`McNews::NotStarted`].
    Activate(Box<Activation>),
    /// Release at the next non-critical state; answered by [`McNews::Released`] or [`McNews::ReleaseCancelled`].
    Release {
        /// The epoch that is to be released.
        epoch: Epoch,
        /// Who goes on.
        successor: Successor,
        /// After this long without a non-critical state it is off, in microseconds.
        within_us: u64,
    },
    /// If the released frame is not out yet, go on; answered by [`McNews::ReleaseCancelled`] if a release was pending.
    CancelRelease {
        /// The epoch meant.
        epoch: Epoch,
    },
    /// Leave normal logic and run this action, from the last good checkpoint and under the same epoch: the stop POU.
    RunAction {
        /// The epoch meant.
        epoch: Epoch,
        /// Value of `recoveryAction`.
        action: u16,
    },
    /// Hold this version from now on: another controller runs it.
    Adopt {
        /// Hash of the version.
        version: u64,
    },
    /// Scan no more, and be passive.
    Deactivate {
        /// The epoch meant.
        epoch: Epoch,
    },
}

/// All that an MC needs to run an epoch.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Activation {
    /// The epoch, open at the gateway.
    pub epoch: Epoch,
    /// Head of the chain, which the first frame names as base.
    pub base: Option<CheckpointId>,
    /// What the MC's variables start from.
    pub start: Start,
    /// Value of `recoveryAction`: 0 direct recovery.
    pub recovery: u16,
    /// Whether the action's variables keep their values (an interrupted action goes on) or begin anew.
    pub keep_action: bool,
    /// Output image to begin with: what the field holds.
    pub outputs: Vec<u8>,
    /// Number of the first scan.
    pub next_scan: Scan,
    /// The epoch before was interrupted, so that a cycle or more is missing: the first scan does not wait for the next tick.
    pub at_once: bool,
    /// Run this staged version from now on; the start is a checkpoint of the version of before.
    pub renew: Option<u64>,
}

/// What an epoch starts from.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Start {
    /// Initial values.
    Initial,
    /// A checkpoint.
    From {
        /// Where its bytes are.
        source: StateSource,
        /// Only retained variables are taken from it, the others get their initial values.
        retained_only: bool,
    },
}

/// Where a checkpoint's bytes are.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum StateSource {
    /// In the passive instance.
    Held(CheckpointId),
    /// Here.
    Given(Arc<Checkpoint>),
}

/// What an MC tells its MC Agent.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum McNews {
    /// Answer to [`McAct::ReadState`]; `None` if it is not held (any more).
    State {
        /// Which one was asked for.
        id: CheckpointId,
        /// The checkpoint.
        checkpoint: Option<Arc<Checkpoint>>,
    },
    /// A frame has been seen that releases the MC to this successor.
    Handed(Successor),
    /// The scan thread has taken the MC over.
    Started {
        /// Its epoch.
        epoch: Epoch,
    },
    /// It cannot run.
    NotStarted {
        /// The epoch asked for.
        epoch: Epoch,
        /// Why.
        why: String,
    },
    /// The recovery action has ended and normal logic runs.
    Recovered {
        /// Its epoch.
        epoch: Epoch,
        /// First scan of normal logic.
        scan: Scan,
    },
    /// The released frame is acknowledged; the MC is passive.
    Released {
        /// Its epoch.
        epoch: Epoch,
        /// The last scan.
        scan: Scan,
    },
    /// The release is off; it goes on.
    ReleaseCancelled {
        /// Its epoch.
        epoch: Epoch,
        /// Why.
        why: String,
    },
    /// The stop action has ended, the last frame is acknowledged; the MC is passive.
    Stopped {
        /// Its epoch.
        epoch: Epoch,
        /// The last scan.
        scan: Scan,
    },
    /// The logic trapped: no more scans until [`McAct::RunAction`] or [`McAct::Deactivate`].
    Trapped {
        /// Its epoch.
        epoch: Epoch,
        /// Where and why.
        trap: TrapInfo,
    },
    /// The gateway's record shows that the epoch drives no more; the MC is passive.
    Deposed {
        /// Its epoch.
        epoch: Epoch,
        /// What the record shows.
        why: String,
    },
}

impl McNews {
    /// The epoch of this node that the news is about.
    #[must_use]
    pub fn epoch(&self) -> Option<Epoch> {
        match self {
            McNews::State { .. } | McNews::Handed(_) => None,
            McNews::Started { epoch }
            | McNews::NotStarted { epoch, .. }
            | McNews::Recovered { epoch, .. }
            | McNews::Released { epoch, .. }
            | McNews::ReleaseCancelled { epoch, .. }
            | McNews::Stopped { epoch, .. }
            | McNews::Trapped { epoch, .. }
            | McNews::Deposed { epoch, .. } => Some(*epoch),
        }
    }
}
