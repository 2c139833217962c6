//! **Only the named successor goes on** (design, section 5, work balance): a released MC is opened by the successor under the epoch that
//! was reserved for it, or by anyone under a higher one.

use super::{Ended, Facts, Invariant, Seen, release_words};

pub(super) struct NamedSuccessor;

impl Invariant for NamedSuccessor {
    fn name(&self) -> &'static str {
        "only the named successor goes on"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Granted { opened, owner, .. } = seen else {
            return Ok(());
        };
        let grant = facts.mc(&opened.mc)?.grant.as_ref();
        let Some(Ended::Released(to)) = grant.and_then(|g| g.ended.as_ref()) else {
            return Ok(());
        };
        let named = opened.epoch == to.epoch && **owner == to.owner;
        if named || opened.epoch > to.epoch {
            return Ok(());
        }
        Err(format!(
            "{}: epoch {} is granted to {owner} although the MC was released to {}",
            opened.mc,
            opened.epoch,
            release_words(to)
        ))
    }
}
