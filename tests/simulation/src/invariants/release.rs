//! **Planned moves never start in a critical interval** (point 6): a frame that releases an MC carries a checkpoint of normal logic,
//! outside of all critical intervals.

use super::{Facts, Invariant, Seen};
use fam_proto::Phase;

pub(super) struct ReleaseOutsideCriticalIntervals;

impl Invariant for ReleaseOutsideCriticalIntervals {
    fn name(&self) -> &'static str {
        "planned moves never start in a critical interval"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Scanned(frame) = seen else {
            return Ok(());
        };
        if frame.released_to.is_none() {
            return Ok(());
        }
        let mc = facts.mc(&frame.spec.mc)?;
        let state = frame.buffer.state();
        if let Some(interval) = mc.model.diagnosis.critical_interval(state) {
            return Err(format!(
                "{}: scan {} is released in critical interval {}",
                frame.spec.mc, frame.scan, interval.name
            ));
        }
        if frame.phase != Phase::Running {
            return Err(format!(
                "{}: scan {} is released in phase {:?}",
                frame.spec.mc, frame.scan, frame.phase
            ));
        }
        Ok(())
    }
}
