//! The journal of applied frames taken piece by piece: each piece is judged as the continuation of the one before, and
//! nothing is kept but the head of each MC's chain.

use fam_gateway_core::recorder::{self, Takeover};
use fam_proto::{Applied, McId};
use std::collections::BTreeMap;

/// The heads of all chains.
#[derive(Debug, Default)]
pub struct Chain {
    newest: BTreeMap<McId, Applied>,
}

/// What a piece shows.
#[derive(Debug, Default)]
pub struct Shown {
    /// MCs that went from one owner, or epoch, to the next.
    pub takeovers: Vec<Takeover>,
    /// Frames that were applied although another controller drove.
    pub double_driven: u64,
    /// Longest time between two frames of an MC, in microseconds.
    pub longest_gap_us: u64,
}

impl Chain {
    /// The last frame applied of an MC.
    pub fn head(&self, mc: &McId) -> Option<&Applied> {
        self.newest.get(mc)
    }

    /// Takes the next piece.
    pub fn take(&mut self, applied: &[Applied]) -> Shown {
        let mut joined: Vec<Applied> = self.newest.values().cloned().collect();
        joined.extend_from_slice(applied);
        // A frame of an epoch that is over takes nothing over: it is a second driver.
        let mut takeovers = recorder::takeovers(&joined);
        takeovers.retain(|t| t.from.0 < t.to.0);
        let mut shown = Shown {
            takeovers,
            double_driven: recorder::double_driven_scans(&joined),
            longest_gap_us: 0,
        };
        for entry in applied {
            match self.newest.get_mut(&entry.mc) {
                Some(before) => {
                    let gap_us = entry.at_us.saturating_sub(before.at_us);
                    shown.longest_gap_us = shown.longest_gap_us.max(gap_us);
                    // A frame of an epoch that is over is counted as double-driven, and continues nothing.
                    if before.epoch <= entry.epoch {
                        *before = entry.clone();
                    }
                }
                None => {
                    self.newest.insert(entry.mc.clone(), entry.clone());
                }
            }
        }
        shown
    }
}

/// Whether the new epoch starts from a scan beyond the last one that was seen applied. The journal of a killed gateway ends a
/// tick early, so that this is no loss if the gateway was started again in between.
pub fn starts_beyond_what_was_seen(t: &Takeover) -> bool {
    t.base_scan > t.last_scan
}
