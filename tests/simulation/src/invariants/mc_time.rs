//! **Time is part of the state** (point 8): along the chain MC time grows by one cycle with each scan, whoever runs it.

use super::{Facts, Invariant, Seen};

pub(super) struct McTime;

impl Invariant for McTime {
    fn name(&self) -> &'static str {
        "MC time grows by one cycle a scan"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Recorded { mc: name, head } = seen else {
            return Ok(());
        };
        let mc = facts.mc(name)?;
        let Some(before) = &mc.head else {
            return Ok(()); // the first of a life; its own beginning is judged with the state
        };
        let scans = head.meta.id.scan.0.saturating_sub(before.id.scan.0);
        let expected = before.mc_time_us + scans * u64::from(mc.model.cycle_us);
        if head.meta.mc_time_us != expected {
            return Err(format!(
                "{name}: MC time is {} us after scan {}, expected {expected} us: {} us after scan {} and {scans} scans since",
                head.meta.mc_time_us, head.meta.id.scan, before.mc_time_us, before.id.scan
            ));
        }
        Ok(())
    }
}
