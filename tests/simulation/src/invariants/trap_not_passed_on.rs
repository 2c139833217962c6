//! **A trap is not passed on** (point 9): an MC whose logic traps runs no normal logic any more under that epoch: its stop POU leads to
//! a safe stop, or nothing runs.

use super::{Facts, Invariant, Seen};
use fam_proto::{Epoch, McId, Owner, Phase};
use std::collections::BTreeMap;

#[derive(Default)]
pub(super) struct TrapNotPassedOn {
    trapped: BTreeMap<(McId, Owner), Epoch>,
}

impl Invariant for TrapNotPassedOn {
    fn name(&self) -> &'static str {
        "a trap is not passed on"
    }

    fn see(&mut self, seen: &Seen<'_>, _: &Facts) -> Result<(), String> {
        match seen {
            Seen::Trapped { mc, owner, epoch } => {
                let key = ((*mc).clone(), (*owner).clone());
                self.trapped.insert(key, *epoch);
                Ok(())
            }
            Seen::Scanned(frame) => {
                let key = (frame.spec.mc.clone(), frame.owner.clone());
                let trapped = self.trapped.get(&key) == Some(&frame.epoch);
                // A recovery that was interrupted by the trap does not go on either.
                let goes_on = matches!(frame.phase, Phase::Running | Phase::Recovering(_));
                if trapped && goes_on {
                    return Err(format!(
                        "{}: scan {} of epoch {} on {} is {:?} although its logic has trapped",
                        frame.spec.mc, frame.scan, frame.epoch, frame.owner, frame.phase
                    ));
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}
