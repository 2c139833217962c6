//! The journal that the gateway writes behind its fence, read while it grows, over all lives of the gateway.

use fam_gateway_core::recorder::{self, Takeover};
use fam_proto::{Applied, AppliedBatch, McId, codec};
use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;

/// One life's file.
struct Life {
    path: PathBuf,
    read: u64,
    /// Position of the next entry; a batch beyond it shows a hole.
    next: u64,
    holes: u64,
    first_us: Option<u64>,
}

/// All that was applied since the cell's start.
#[derive(Default)]
pub struct Journal {
    lives: Vec<Life>,
    pub applied: Vec<Applied>,
    pub newest: BTreeMap<McId, Applied>,
}

/// Microseconds of the machine's monotonic clock, as in [`Journal::applied`].
pub fn monotonic_us() -> u64 {
    fam_gateway::recording::monotonic_us()
}

impl Journal {
    /// Where the gateway's next life writes.
    pub fn next_life(&mut self, dir: &std::path::Path) -> PathBuf {
        self.read();
        let path = dir.join(format!("applied-{}.journal", self.lives.len()));
        self.lives.push(Life {
            path: path.clone(),
            read: 0,
            next: 0,
            holes: 0,
            first_us: None,
        });
        path
    }

    /// Takes what has come.
    pub fn read(&mut self) {
        for life in &mut self.lives {
            let Ok(mut file) = std::fs::File::open(&life.path) else {
                continue;
            };
            let mut bytes = Vec::new();
            if file.seek(SeekFrom::Start(life.read)).is_err()
                || file.read_to_end(&mut bytes).is_err()
            {
                continue;
            }
            let mut at = 0;
            while let Some(head) = bytes.get(at..at + 4) {
                let len = u32::from_le_bytes(head.try_into().expect("four bytes")) as usize;
                // The rest of a batch that is being written comes later, or never if the gateway was killed.
                let Some(body) = bytes.get(at + 4..at + 4 + len) else {
                    break;
                };
                let batch: AppliedBatch = codec::decode(body).expect("the journal reads");
                life.holes += batch.first.saturating_sub(life.next);
                life.next = batch.first + batch.entries.len() as u64;
                for mut entry in batch.entries {
                    entry.at_us = entry.at_us.saturating_add_signed(batch.monotonic_offset_us);
                    life.first_us.get_or_insert(entry.at_us);
                    self.newest.insert(entry.mc.clone(), entry.clone());
                    self.applied.push(entry);
                }
                at += 4 + len;
            }
            life.read += at as u64;
        }
    }

    /// Takeovers whose first frame came after this moment.
    pub fn takeovers_since(&self, at_us: u64) -> Vec<Takeover> {
        let mut all = recorder::takeovers(&self.applied);
        all.retain(|t| t.first_us > at_us);
        all
    }

    /// Everything that the safety contract forbids and that was seen here, in words.
    pub fn wrong(&self) -> Vec<String> {
        let mut wrong = Vec::new();
        let double = recorder::double_driven_scans(&self.applied);
        if double > 0 {
            wrong.push(format!(
                "{double} scans were applied while another controller drove"
            ));
        }
        let holes: u64 = self.lives.iter().map(|l| l.holes).sum();
        if holes > 0 {
            wrong.push(format!("the journal misses {holes} entries"));
        }
        for t in recorder::takeovers(&self.applied) {
            let restarted = self
                .lives
                .iter()
                .skip(1)
                .filter_map(|l| l.first_us)
                .any(|first_us| t.last_us < first_us && first_us <= t.first_us);
            // A killed gateway takes the last entries of its journal along: a base beyond them was applied unseen.
            let unseen = restarted && t.base_scan > t.last_scan;
            if t.scans_behind > 0 && !unseen {
                wrong.push(format!(
                    "{} goes on from scan {} in epoch {}, applied last was scan {}",
                    t.mc, t.base_scan, t.to.0, t.last_scan
                ));
            }
        }
        wrong
    }
}
