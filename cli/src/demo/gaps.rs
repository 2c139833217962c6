//! What the journal of applied frames says about a stretch of time: takeovers, gaps, missed scans.

use crate::bench::Witness;
use fam_gateway_core::recorder::{self, Gap, Takeover};
use fam_proto::{Applied, McId};
use std::collections::BTreeMap;

/// What happened between two moments.
#[derive(Debug, Clone, Default)]
pub struct Stretch {
    /// MCs that got another owner or epoch.
    pub takeovers: Vec<Takeover>,
    /// Gaps of two cycles or more.
    pub gaps: Vec<Gap>,
}

/// Missed scans, those apart for which the machine itself may be to blame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Missed {
    /// Missed without the machine's fault.
    pub scans: u64,
    /// Missed while the machine was disturbed.
    pub disturbed: u64,
}

impl std::fmt::Display for Missed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} missed", self.scans)?;
        if self.disturbed > 0 {
            write!(
                f,
                ", {} more while the machine itself was disturbed",
                self.disturbed
            )
        } else {
            Ok(())
        }
    }
}

impl Stretch {
    /// Reads the journal; times are of the machine's monotonic clock, in microseconds.
    pub fn between(
        applied: &[Applied],
        cycles_us: &BTreeMap<McId, u64>,
        from_us: u64,
        to_us: u64,
    ) -> Stretch {
        let within = |at_us: u64| (from_us..=to_us).contains(&at_us);
        let mut stretch = Stretch {
            takeovers: recorder::takeovers(applied),
            gaps: recorder::gaps(applied, cycles_us),
        };
        stretch.takeovers.retain(|t| within(t.first_us));
        stretch.gaps.retain(|g| within(g.to_us));
        stretch
    }

    /// Longest time without an applied frame at a takeover, in milliseconds.
    #[allow(clippy::cast_precision_loss)]
    pub fn longest_takeover_ms(&self) -> Option<f64> {
        self.takeovers
            .iter()
            .map(|t| (t.first_us - t.last_us) as f64 / 1_000.0)
            .reduce(f64::max)
    }

    /// Counts missed scans in gaps that `counts` picks.
    pub fn missed(&self, witness: &Witness, counts: impl Fn(&Gap) -> bool) -> Missed {
        let mut missed = Missed::default();
        for gap in self.gaps.iter().filter(|g| counts(g)) {
            if witness.disturbed_between_us(gap.from_us, gap.to_us) {
                missed.disturbed += gap.missed_scans;
            } else {
                missed.scans += gap.missed_scans;
            }
        }
        missed
    }
}
