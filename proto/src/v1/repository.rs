//! What the manager keeps on disk (the System Repository): the writes that the Middleware Manager asks for, and what it finds again at its start.
//!
//! The manager's agents ask for [`RepoWrite`]s through `Output::Persist`; the repository stores them and loads their sum as
//! [`RepoState`]. A write is answered `Ok` only when it is durable as [`RepoWrite::must_sync`] says.

use super::event::Event;
use super::message::Registration;
use crate::codec::Wire;
use crate::ids::{ControllerId, Epoch, McId, PlanId};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// How many of the newest events are loaded at the manager's start; the repository may keep more on disk.
pub const EVENTS_LOADED_MAX: usize = 4_096;

/// One change of the repository.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum RepoWrite {
    /// Epochs of the MC up to and including `upto` are reserved: never given out again after a restart.
    EpochBlock {
        /// The MC.
        mc: McId,
        /// Highest reserved epoch. A lower value than the one stored is an error of the caller and must not lower it.
        upto: Epoch,
    },
    /// An entry of the history, stored under its `seq`. An entry with a `seq` that is already stored replaces it (acknowledged alarms).
    Event(Event),
    /// The assignment in force, whole.
    Assignment {
        /// Its generation.
        generation: PlanId,
        /// Which controller each placed MC belongs to.
        assignment: BTreeMap<McId, ControllerId>,
    },
    /// All pins, whole: MC and the controller that it is kept on.
    Pins(BTreeMap<McId, ControllerId>),
    /// All drained controllers, whole.
    Drained(BTreeSet<ControllerId>),
    /// All MCs that an operator stopped and nobody has reset yet, whole.
    Stopped(BTreeSet<McId>),
    /// The newest registration of a controller, stored under its name.
    Registered(Registration),
}

impl RepoWrite {
    /// Whether the write has to be on the disk before it is answered. Others may be batched and lost with the machine
    /// (not with the process).
    #[must_use]
    pub fn must_sync(&self) -> bool {
        !matches!(self, RepoWrite::Event(_) | RepoWrite::Registered(_))
    }
}

impl Wire for RepoWrite {
    const KIND: u8 = 6;
    const NAME: &'static str = "repository write";
}

/// What the manager finds in its repository at its start; empty for a new one.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct RepoState {
    /// For each MC its highest reserved epoch.
    pub epochs: BTreeMap<McId, Epoch>,
    /// Generation of the assignment.
    pub generation: PlanId,
    /// Which controller each placed MC belonged to.
    pub assignment: BTreeMap<McId, ControllerId>,
    /// Pins.
    pub pins: BTreeMap<McId, ControllerId>,
    /// Drained controllers.
    pub drained: BTreeSet<ControllerId>,
    /// MCs stopped by an operator.
    pub stopped: BTreeSet<McId>,
    /// The newest registration of each controller.
    pub registrations: BTreeMap<ControllerId, Registration>,
    /// Position of the newest event; 0 if there is none.
    pub last_event_seq: u64,
    /// The newest events, oldest first, at most [`EVENTS_LOADED_MAX`].
    pub events: Vec<Event>,
}

impl RepoState {
    /// Lays one write over the state: what a repository has to give back after it has stored the write.
    pub fn apply(&mut self, write: &RepoWrite) {
        match write {
            RepoWrite::EpochBlock { mc, upto } => {
                let stored = self.epochs.entry(mc.clone()).or_default();
                *stored = (*stored).max(*upto);
            }
            RepoWrite::Event(event) => {
                match self.events.binary_search_by_key(&event.seq, |e| e.seq) {
                    Ok(at) => self.events[at] = event.clone(),
                    Err(at) => self.events.insert(at, event.clone()),
                }
                let surplus = self.events.len().saturating_sub(EVENTS_LOADED_MAX);
                self.events.drain(..surplus);
                self.last_event_seq = self.last_event_seq.max(event.seq);
            }
            RepoWrite::Assignment {
                generation,
                assignment,
            } => {
                self.generation = *generation;
                self.assignment = assignment.clone();
            }
            RepoWrite::Pins(pins) => self.pins = pins.clone(),
            RepoWrite::Drained(drained) => self.drained = drained.clone(),
            RepoWrite::Stopped(stopped) => self.stopped = stopped.clone(),
            RepoWrite::Registered(registration) => {
                self.registrations
                    .insert(registration.owner.controller.clone(), registration.clone());
            }
        }
    }
}

impl Wire for RepoState {
    const KIND: u8 = 7;
    const NAME: &'static str = "repository";
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{EventKind, Severity};

    #[test]
    fn a_reserved_epoch_never_falls_and_an_acknowledged_event_replaces_itself() {
        let mc = McId::new("station1").unwrap();
        let mut state = RepoState::default();
        for (upto, expected) in [(64, 64), (128, 128), (64, 128)] {
            state.apply(&RepoWrite::EpochBlock {
                mc: mc.clone(),
                upto: Epoch(upto),
            });
            assert_eq!(state.epochs[&mc], Epoch(expected));
        }
        let mut event = Event::new(Severity::Alarm, EventKind::McUnplaced, "no host");
        for seq in [1, 2] {
            event.seq = seq;
            state.apply(&RepoWrite::Event(event.clone()));
        }
        event.seq = 1;
        event.acknowledged = true;
        state.apply(&RepoWrite::Event(event));
        let seen: Vec<_> = state
            .events
            .iter()
            .map(|e| (e.seq, e.acknowledged))
            .collect();
        assert_eq!(seen, [(1, true), (2, false)]);
        assert_eq!(state.last_event_seq, 2);
    }
}
