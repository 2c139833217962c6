//! **One driver** (point 1): a frame is applied only under the newest granted epoch, by its owner, while that epoch is open, and its
//! scan is higher. The frames of an MC form one chain: the first frame of an epoch builds on the head of the record.

use super::{Facts, Invariant, Seen};

pub(super) struct OneDriver;

impl Invariant for OneDriver {
    fn name(&self) -> &'static str {
        "one driver"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Applied { applied, .. } = seen else {
            return Ok(());
        };
        let mc = facts.mc(&applied.mc)?;
        let what = format!(
            "{}: scan {} of epoch {} by {} is applied",
            applied.mc, applied.scan, applied.epoch, applied.owner
        );
        let Some(grant) = &mc.grant else {
            return Err(format!("{what} although no epoch was ever granted"));
        };
        if (grant.epoch, &grant.owner) != (applied.epoch, &applied.owner) {
            return Err(format!(
                "{what} although epoch {} of {} is the newest",
                grant.epoch, grant.owner
            ));
        }
        if let Some(ended) = &grant.ended {
            return Err(format!("{what} although that epoch has ended: {ended:?}"));
        }
        if let Some((last, owner)) = &mc.applied {
            if applied.epoch < last.epoch || applied.scan <= last.scan {
                return Err(format!(
                    "{what} after scan {} of epoch {} by {owner}",
                    last.scan, last.epoch
                ));
            }
            if applied.epoch == last.epoch && applied.owner != *owner {
                return Err(format!("{what} after {owner} had driven that epoch"));
            }
        }
        let first = mc
            .applied
            .as_ref()
            .is_none_or(|(last, _)| last.epoch < applied.epoch)
            && mc.before.as_ref().map(|b| b.id.epoch) != Some(applied.epoch);
        if first {
            let head = mc.before.as_ref().map(|h| h.id);
            if applied.base != head {
                return Err(format!(
                    "{what} as the first of its epoch on base {:?}, but the head is {head:?}",
                    applied.base
                ));
            }
        }
        Ok(())
    }
}
