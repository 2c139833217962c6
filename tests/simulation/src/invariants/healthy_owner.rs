//! **A healthy owner keeps its MC** (point 2): no epoch is granted over an owner whose frames are fresh and whose liveliness token is
//! seen at the gateway, unless it released the MC or an operator forces it.

use super::{Facts, Invariant, Seen};

/// Frames are fresh for this many cycles.
const FRESH_CYCLES: u64 = 3;
/// Virtual time and the gateway's clock may differ by this much over that time, in microseconds,
const CLOCKS_US: u64 = 100;
/// and by this much if its clock runs too fast, in thousandths.
const FAST_PERMILLE: u64 = 35;

pub(super) struct HealthyOwner;

impl Invariant for HealthyOwner {
    fn name(&self) -> &'static str {
        "a healthy owner keeps its MC"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Granted {
            opened,
            owner,
            force,
            token_seen,
        } = seen
        else {
            return Ok(());
        };
        let mc = facts.mc(&opened.mc)?;
        let Some(before) = &mc.grant else {
            return Ok(());
        };
        if before.epoch == opened.epoch || before.ended.is_some() || *force || !*token_seen {
            return Ok(());
        }
        let last_us = before.applied_at_us.unwrap_or(before.at_us);
        let silent_us = facts.now_us - last_us;
        let fresh_us = FRESH_CYCLES * u64::from(mc.model.cycle_us);
        if silent_us + silent_us * FAST_PERMILLE / 1_000 + CLOCKS_US < fresh_us {
            return Err(format!(
                "{}: epoch {} is granted to {owner} although {} drives epoch {}, its last word {silent_us} us ago and its token seen",
                opened.mc, opened.epoch, before.owner, before.epoch
            ));
        }
        Ok(())
    }
}
