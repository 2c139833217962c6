//! Opening an epoch: who may become owner of an MC, and what he is told to start from.
//!
//! ```text
//!  epoch <= record's, or out of all reason .. StaleEpoch   (the same open again, before the first frame: the same grant)
//!  another layout than the head's ........... Layout       (unless it was released to exactly this open, or a cold reset)
//!  stopped, faulted, or head lost, no reset . NeedsReset
//!  released to (e, o): epoch < e ............ StaleEpoch
//!                      epoch = e, not o ..... NotSuccessor
//!  open, owner's frames fresh, token seen ... OwnerFresh   (an operator can force it)
//!  otherwise ................................ granted, once the ledger is durable
//! ```

use crate::gate::Gate;
use fam_proto::{Ledger, Now, Open, OpenRefusal, Opened, RecordState, Reset};

/// Frames are fresh if the last one is no older than this many cycles of the MC.
pub const FRESH_CYCLES: u64 = 3;
/// No manager's epochs are further ahead of the record than this: a damaged number must not use up all that are to come.
pub const EPOCHS_AHEAD_MAX: u64 = 1 << 32;

/// What becomes of an open.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Decision {
    /// It is granted once the ledger is durable.
    Grant(Ledger),
    /// It was granted before and its owner has not driven yet (the answer was lost, or is asked for again).
    Again,
    /// It is refused.
    Refuse(OpenRefusal),
}

/// Decides on an open. `owner_seen` says whether the liveliness token of the record's owner is seen.
#[must_use]
pub fn decide(gate: &Gate, open: &Open, owner_seen: bool, now: Now) -> Decision {
    let record = gate.ledger();
    if open.epoch <= record.epoch {
        let again = open.epoch == record.epoch
            && record.owner.as_ref() == Some(&open.owner)
            && record.state == RecordState::Open
            && !record.driven;
        return if again {
            Decision::Again
        } else {
            Decision::Refuse(OpenRefusal::StaleEpoch)
        };
    }
    if open.epoch.0 - record.epoch.0 > EPOCHS_AHEAD_MAX {
        return Decision::Refuse(OpenRefusal::StaleEpoch);
    }
    let continues = gate
        .head()
        .is_none_or(|head| head.meta.layout == open.layout);
    if !continues && !begins_a_layout(record, open) {
        return Decision::Refuse(OpenRefusal::Layout);
    }
    if (record.state.needs_reset() && open.reset.is_none())
        || (record.head_lost && open.reset != Some(Reset::Cold))
    {
        return Decision::Refuse(OpenRefusal::NeedsReset);
    }
    if let RecordState::Released(to) = &record.state {
        if open.epoch < to.epoch {
            return Decision::Refuse(OpenRefusal::StaleEpoch);
        }
        if open.epoch == to.epoch && open.owner != to.owner {
            return Decision::Refuse(OpenRefusal::NotSuccessor);
        }
    }
    let fresh = gate.silent_us(now) <= FRESH_CYCLES * u64::from(gate.model().cycle_us);
    if record.state == RecordState::Open && fresh && owner_seen && !open.force {
        return Decision::Refuse(OpenRefusal::OwnerFresh);
    }
    let cold = open.reset == Some(Reset::Cold);
    Decision::Grant(Ledger {
        epoch: open.epoch,
        owner: Some(open.owner.clone()),
        state: RecordState::Open,
        base: gate.head_id().filter(|_| !cold),
        driven: false,
        fail_safe: gate.fail_safe_stands(),
        last_scan: record.last_scan,
        head_lost: false,
    })
}

/// A new version of the logic may bring a new layout: where the version of before has released the MC to it, at a non-critical
/// state, and where nothing of the state is kept.
fn begins_a_layout(record: &Ledger, open: &Open) -> bool {
    let released_to_it = matches!(
        &record.state,
        RecordState::Released(to) if to.epoch == open.epoch && to.owner == open.owner
    );
    released_to_it || open.reset == Some(Reset::Cold)
}

/// The answer to a granted open, from the record as it stands after the grant.
#[must_use]
pub fn answer(gate: &Gate, open: &Open) -> Opened {
    let head = gate.head();
    Opened {
        mc: open.mc.clone(),
        epoch: gate.ledger().epoch,
        base: gate.head_id(),
        checkpoint: head
            .filter(|head| open.held != Some(head.meta.id))
            .map(|head| Box::new(head.checkpoint())),
        outputs: gate.outputs().to_vec(),
        phase: head.map(|head| head.meta.phase),
        interrupted: gate.is_interrupted(),
        fail_safe: gate.fail_safe_stands(),
        next_scan: gate.ledger().last_scan.next(),
        reset: open.reset,
        owner: open.owner.clone(),
    }
}
