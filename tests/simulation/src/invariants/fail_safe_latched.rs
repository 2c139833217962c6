//! **Outputs fail safe** (point 7): without a valid frame for the watchdog time the fail-safe values are set, timers before queued
//! frames, and they stand until a new activation, which is told of it.

use super::{Ended, Facts, Invariant, McFacts, Seen};

/// How much later than its time the watchdog may be seen to act: a tick, and clocks that differ, in microseconds.
const SLACK_US: u64 = 12_000;
/// The watchdog runs by the gateway's own clock, which may be slow by this much, in thousandths.
const SLOW_PERMILLE: u64 = 35;

pub(super) struct FailSafeLatched;

impl Invariant for FailSafeLatched {
    fn name(&self) -> &'static str {
        "outputs fail safe, and it latches"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        match seen {
            Seen::Applied { applied, .. } => {
                let mc = facts.mc(&applied.mc)?;
                overdue(mc, facts, "a frame is applied")
            }
            Seen::Image(_) => facts
                .mcs
                .values()
                .filter(|mc| !mc.fail_safe)
                .try_for_each(|mc| overdue(mc, facts, "the cycle goes on")),
            Seen::Granted { opened, .. } => {
                let mc = facts.mc(&opened.mc)?;
                if mc.fail_safe && !opened.fail_safe {
                    return Err(format!(
                        "{}: epoch {} is granted without the word that the fail-safe values stand, and they do",
                        opened.mc, opened.epoch
                    ));
                }
                if let Some(field) = &mc.field
                    && *field != opened.outputs
                {
                    return Err(format!(
                        "{}: epoch {} is granted on outputs {:?}, but {field:?} stand at the field",
                        opened.mc, opened.epoch, opened.outputs
                    ));
                }
                let after = mc.grant.as_ref().and_then(|g| g.ended.as_ref());
                if after == Some(&Ended::FailSafe)
                    && !(opened.fail_safe && (opened.interrupted || opened.base.is_none()))
                {
                    return Err(format!(
                        "{}: epoch {} is granted without the word that the fail-safe values stand",
                        opened.mc, opened.epoch
                    ));
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

fn overdue(mc: &McFacts, facts: &Facts, when: &str) -> Result<(), String> {
    let Some(grant) = &mc.grant else {
        return Ok(());
    };
    if matches!(
        grant.ended,
        Some(Ended::Stopped | Ended::FailSafe | Ended::Faulted | Ended::HeadLost)
    ) {
        return Ok(());
    }
    let last_us = grant.applied_at_us.unwrap_or(0).max(grant.at_us).max(
        if grant.ended == Some(Ended::Restart) {
            facts.gateway_up_us
        } else {
            0
        },
    );
    // A gateway that stood still sets the values when it goes on.
    let wakes_us = facts.gateway_up_us + SLACK_US;
    let due_us =
        last_us + mc.model.watchdog_us + mc.model.watchdog_us * SLOW_PERMILLE / 1_000 + SLACK_US;
    let applying = when.starts_with("a frame");
    if facts.now_us > due_us && (applying || facts.now_us > wakes_us) {
        return Err(format!(
            "{}: {when} {} ms after the last valid word of epoch {}, its watchdog time is {} ms",
            mc.model.mc,
            (facts.now_us - last_us) / 1_000,
            grant.epoch,
            mc.model.watchdog_us / 1_000
        ));
    }
    Ok(())
}
