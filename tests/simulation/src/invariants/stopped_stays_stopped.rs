//! **Stopped stays stopped** (points 5 and 9): an MC that has stopped safely, or whose fault is on record, is opened only with a reset; one
//! whose last state is lost with the gateway's power only with a cold one.

use super::{Ended, Facts, Invariant, Seen};
use fam_proto::Reset;

pub(super) struct StoppedStaysStopped;

impl Invariant for StoppedStaysStopped {
    fn name(&self) -> &'static str {
        "stopped stays stopped"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Granted { opened, owner, .. } = seen else {
            return Ok(());
        };
        let grant = facts.mc(&opened.mc)?.grant.as_ref();
        match grant.and_then(|g| g.ended.as_ref()) {
            Some(ended @ (Ended::Stopped | Ended::Faulted)) if opened.reset.is_none() => {
                Err(format!(
                    "{}: epoch {} is granted to {owner} without a reset after {ended:?}",
                    opened.mc, opened.epoch
                ))
            }
            Some(Ended::HeadLost) if opened.reset != Some(Reset::Cold) => Err(format!(
                "{}: epoch {} is granted to {owner} without a cold reset although its last state is lost",
                opened.mc, opened.epoch
            )),
            _ => Ok(()),
        }
    }
}
