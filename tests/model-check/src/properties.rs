//! What must hold after every step, in the words of the safety contract (design, section 4). Told by what leaves the processes,
//! not by what they think.

use crate::plc::parent;
use crate::state::Facts;
use fam_proto::{Applied, CheckpointId, Digest, Epoch, Owner};

/// A promise broken: which, and how.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Violation {
    /// The promise.
    pub property: &'static str,
    /// What happened.
    pub text: String,
}

impl std::fmt::Display for Violation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.property, self.text)
    }
}

/// Point 1: only one drives, and the frames applied make one chain.
pub const ONE_DRIVER: &str = "one driver";
/// Point 2: a healthy owner keeps its MC.
pub const HEALTHY_OWNER: &str = "a healthy owner keeps its MC";
/// Point 3: no epoch is ordered or granted twice, and none is ordered that is not durable.
pub const EPOCHS: &str = "epochs are never reused";
/// Point 4: an epoch begins from the state behind the outputs applied last.
pub const STATE: &str = "no invented state";
/// Point 10: with everything mended, the MC can be driven again from wherever it stands.
pub const LIVENESS: &str = "eventually driven";

/// All of them.
pub const ALL: [&str; 5] = [ONE_DRIVER, HEALTHY_OWNER, EPOCHS, STATE, LIVENESS];

fn broken(property: &'static str, text: String) -> Result<(), Violation> {
    Err(Violation { property, text })
}

impl Facts {
    /// The gateway has applied a frame with this state.
    pub(crate) fn applied(&mut self, applied: &Applied, state: &[u8]) -> Result<(), Violation> {
        let what = format!(
            "scan {} of epoch {} by {} is applied",
            applied.scan, applied.epoch, applied.owner
        );
        let id = applied.checkpoint_id();
        let granted = self.grant.as_ref();
        if granted != Some(&(applied.epoch, applied.owner.clone())) {
            return broken(ONE_DRIVER, format!("{what}, but the grant is {granted:?}"));
        }
        if let Some(last) = &self.applied
            && (applied.epoch < last.epoch || applied.scan <= last.scan)
        {
            return broken(
                ONE_DRIVER,
                format!("{what} after scan {} of {}", last.scan, last.epoch),
            );
        }
        if !self.driven {
            let before = self.base.map_or(Digest::default(), |b| b.digest);
            if applied.base != self.base || parent(state) != before {
                let text = format!(
                    "{what} as the first of its epoch, from {:?} on base {:?}; the plant has seen {:?} last",
                    parent(state),
                    applied.base,
                    self.base
                );
                return broken(STATE, text);
            }
            let next = self.base.map_or(1, |b| b.scan.0 + 1);
            if applied.scan.0 != next {
                return broken(STATE, format!("{what}, expected scan {next}"));
            }
        }
        self.driven = true;
        self.applied = Some(id);
        Ok(())
    }

    /// The gateway answers an open with a grant. `healthy`: the owner of before drives in time and its token is seen.
    pub(crate) fn granted(
        &mut self,
        epoch: Epoch,
        owner: &Owner,
        base: Option<CheckpointId>,
        healthy: bool,
        force: bool,
    ) -> Result<(), Violation> {
        let this = (epoch, owner.clone());
        if self.grant.as_ref() == Some(&this) {
            return Ok(()); // the same answer again
        }
        if let Some((last, before)) = &self.grant {
            if epoch <= *last {
                let text = format!("epoch {epoch} is granted to {owner}, {last} was to {before}");
                return broken(EPOCHS, text);
            }
            if healthy && !force {
                let text = format!("epoch {epoch} is granted to {owner} over {before}");
                return broken(HEALTHY_OWNER, text);
            }
        }
        if base != self.applied {
            let text = format!(
                "epoch {epoch} is granted on base {base:?}, the plant has seen {:?} last",
                self.applied
            );
            return broken(STATE, text);
        }
        self.grant = Some(this);
        self.base = base;
        self.driven = false;
        Ok(())
    }

    /// The manager orders `to` to open an epoch, of which `durable` are reserved on disk. Whether for the first time.
    pub(crate) fn ordered(
        &mut self,
        epoch: Epoch,
        to: &Owner,
        durable: Epoch,
    ) -> Result<bool, Violation> {
        if epoch > durable {
            let text = format!("epoch {epoch} is ordered, up to {durable} are on the disk");
            broken(EPOCHS, text)?;
        }
        let mut new = true;
        if let Some((highest, owner)) = &self.ordered {
            new = epoch > *highest;
            if !new && (epoch < *highest || owner.controller != to.controller) {
                let text = format!("epoch {epoch} is ordered for {to}, {highest} was for {owner}");
                broken(EPOCHS, text)?;
            }
        }
        self.ordered = Some((epoch, to.clone()));
        Ok(new)
    }
}
