//! A recorder behind the fence: the frames that were applied, in order, and what they show.
//!
//! The journal is bounded and keeps the order of application. The analysis is pure: benchmarks and the demo compute
//! failover times, missed scans and double-driven scans from it, and tests the chain.

use fam_proto::{Applied, CheckpointId, Epoch, McId, Owner, Scan};
use std::collections::{BTreeMap, VecDeque};

/// A bounded journal: the oldest entries go, their number is known.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Journal {
    first: u64,
    entries: VecDeque<Applied>,
    capacity: usize,
}

impl Journal {
    /// A journal of at most `capacity` entries.
    #[must_use]
    pub fn new(capacity: usize) -> Journal {
        Journal {
            first: 0,
            entries: VecDeque::new(),
            capacity: capacity.max(1),
        }
    }

    /// Takes the next entry.
    pub fn push(&mut self, applied: Applied) {
        if self.entries.len() == self.capacity {
            self.entries.pop_front();
            self.first += 1;
        }
        self.entries.push_back(applied);
    }

    /// Position of the next entry.
    #[must_use]
    pub fn end(&self) -> u64 {
        self.first + self.entries.len() as u64
    }

    /// Entries from a position on, at most `limit`, and the position of the first of them (later than asked for where older ones are gone).
    #[must_use]
    pub fn since(&self, position: u64, limit: usize) -> (u64, Vec<Applied>) {
        let from = position.clamp(self.first, self.end());
        let skip = usize::try_from(from - self.first).unwrap_or(usize::MAX);
        let entries = self.entries.iter().skip(skip).take(limit).cloned();
        (from, entries.collect())
    }
}

/// Scans that were applied although another controller was driving: of each MC, frames whose epoch is below one applied before,
/// and frames of an epoch from another owner than the one that was seen first in it. 0 wherever the fence holds.
#[must_use]
pub fn double_driven_scans(applied: &[Applied]) -> u64 {
    struct Seen<'a> {
        highest: Epoch,
        owners: BTreeMap<Epoch, &'a Owner>,
    }
    let mut seen: BTreeMap<&McId, Seen<'_>> = BTreeMap::new();
    let mut count = 0;
    for entry in applied {
        let seen = seen.entry(&entry.mc).or_insert_with(|| Seen {
            highest: entry.epoch,
            owners: BTreeMap::new(),
        });
        let owner = *seen.owners.entry(entry.epoch).or_insert(&entry.owner);
        if entry.epoch < seen.highest || owner != &entry.owner {
            count += 1;
        }
        seen.highest = seen.highest.max(entry.epoch);
    }
    count
}

/// Two frames of an MC between which scans are missing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gap {
    /// The MC.
    pub mc: McId,
    /// When the frame before was applied, on the gateway's clock, in microseconds.
    pub from_us: u64,
    /// When the next one was.
    pub to_us: u64,
    /// Whole cycles without a frame.
    pub missed_scans: u64,
    /// The epoch before and after.
    pub epochs: (Epoch, Epoch),
}

/// Gaps of two cycles and more between frames applied one after the other. A gap of `n` to `n + 1` cycles has missed `n - 1` scans.
/// MCs without an entry in `cycle_us` are left out.
#[must_use]
pub fn gaps(applied: &[Applied], cycle_us: &BTreeMap<McId, u64>) -> Vec<Gap> {
    let mut last: BTreeMap<&McId, &Applied> = BTreeMap::new();
    let mut gaps = Vec::new();
    for entry in applied {
        let before = last.insert(&entry.mc, entry);
        let (Some(before), Some(&cycle)) = (before, cycle_us.get(&entry.mc)) else {
            continue;
        };
        let cycles = entry.at_us.saturating_sub(before.at_us) / cycle.max(1);
        if cycles >= 2 {
            gaps.push(Gap {
                mc: entry.mc.clone(),
                from_us: before.at_us,
                to_us: entry.at_us,
                missed_scans: cycles - 1,
                epochs: (before.epoch, entry.epoch),
            });
        }
    }
    gaps
}

/// An MC that went from one owner, or epoch, to the next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Takeover {
    /// The MC.
    pub mc: McId,
    /// Epoch and owner before.
    pub from: (Epoch, Owner),
    /// Epoch and owner after.
    pub to: (Epoch, Owner),
    /// When the last frame of the old epoch was applied, on the gateway's clock, in microseconds.
    pub last_us: u64,
    /// When the first of the new one was.
    pub first_us: u64,
    /// Whether the last frame had released the MC: a planned move.
    pub released: bool,
    /// Scans that are lost between the two: 0 if the new owner went on where the plant had been left.
    pub scans_behind: u64,
    /// Scan of the last frame of the old epoch in the journal.
    pub last_scan: Scan,
    /// Scan of the checkpoint that the first frame of the new epoch names as its base; 0 without one.
    pub base_scan: Scan,
}

/// All changes of epoch, in order.
#[must_use]
pub fn takeovers(applied: &[Applied]) -> Vec<Takeover> {
    let mut last: BTreeMap<&McId, &Applied> = BTreeMap::new();
    let mut found = Vec::new();
    for entry in applied {
        let Some(before) = last.insert(&entry.mc, entry) else {
            continue;
        };
        if before.epoch == entry.epoch {
            continue;
        }
        let builds_on_last = entry.base == Some(before.checkpoint_id());
        let base_scan = entry.base.map_or(Scan(0), |base| base.scan);
        found.push(Takeover {
            mc: entry.mc.clone(),
            from: (before.epoch, before.owner.clone()),
            to: (entry.epoch, entry.owner.clone()),
            last_us: before.at_us,
            first_us: entry.at_us,
            released: before.released,
            last_scan: before.scan,
            base_scan,
            scans_behind: if builds_on_last {
                0
            } else {
                before.scan.0.saturating_sub(base_scan.0).max(1)
            },
        });
    }
    found
}

/// Where a chain of frames is broken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ChainBreak {
    /// A scan number that does not rise.
    #[error("{mc}: scan {found} of epoch {epoch} was applied after scan {before}")]
    ScanFell {
        /// The MC.
        mc: McId,
        /// Epoch of the later frame.
        epoch: Epoch,
        /// The scan before.
        before: Scan,
        /// The later scan.
        found: Scan,
    },
    /// An epoch that falls.
    #[error("{mc}: a frame of epoch {found} was applied after one of epoch {before}")]
    EpochFell {
        /// The MC.
        mc: McId,
        /// The epoch before.
        before: Epoch,
        /// The later one.
        found: Epoch,
    },
    /// One epoch with two owners.
    #[error("{mc}: epoch {epoch} was driven by {first} and by {second}")]
    TwoOwners {
        /// The MC.
        mc: McId,
        /// The epoch.
        epoch: Epoch,
        /// Its first owner.
        first: Owner,
        /// The other one.
        second: Owner,
    },
    /// The first frame of an epoch does not build on what was applied last.
    #[error("{mc}: epoch {epoch} builds on {base:?}, applied last was {head:?}")]
    WrongBase {
        /// The MC.
        mc: McId,
        /// The epoch.
        epoch: Epoch,
        /// What its first frame names.
        base: Option<CheckpointId>,
        /// What was applied last.
        head: CheckpointId,
    },
}

/// Checks the chain of every MC: epochs never fall, one owner for each, scans rise, and each epoch builds on the head before
/// (or on nothing, after a cold reset). `whole` says that the entries are without holes; else bases are not compared.
///
/// # Errors
/// The first break.
pub fn check_chain(applied: &[Applied], whole: bool) -> Result<(), ChainBreak> {
    let mut last: BTreeMap<&McId, &Applied> = BTreeMap::new();
    for entry in applied {
        let Some(before) = last.insert(&entry.mc, entry) else {
            continue;
        };
        let mc = || entry.mc.clone();
        if entry.epoch < before.epoch {
            return Err(ChainBreak::EpochFell {
                mc: mc(),
                before: before.epoch,
                found: entry.epoch,
            });
        }
        if entry.epoch == before.epoch && entry.owner != before.owner {
            return Err(ChainBreak::TwoOwners {
                mc: mc(),
                epoch: entry.epoch,
                first: before.owner.clone(),
                second: entry.owner.clone(),
            });
        }
        if entry.scan <= before.scan {
            return Err(ChainBreak::ScanFell {
                mc: mc(),
                epoch: entry.epoch,
                before: before.scan,
                found: entry.scan,
            });
        }
        let head = before.checkpoint_id();
        if whole && entry.epoch > before.epoch && entry.base.is_some() && entry.base != Some(head) {
            return Err(ChainBreak::WrongBase {
                mc: mc(),
                epoch: entry.epoch,
                base: entry.base,
                head,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{BootId, ControllerId, Digest, Phase};

    fn owner(n: u64) -> Owner {
        Owner {
            controller: ControllerId::new(&format!("c{n}")).unwrap(),
            boot: BootId(1),
        }
    }

    /// An entry whose digest is its scan and epoch.
    fn entry(epoch: u64, by: u64, scan: u64, at_us: u64, base: Option<(u64, u64)>) -> Applied {
        let digest = |epoch: u64, scan: u64| {
            let mut bytes = [0; 16];
            bytes[..8].copy_from_slice(&scan.to_le_bytes());
            bytes[8..].copy_from_slice(&epoch.to_le_bytes());
            Digest(bytes)
        };
        Applied {
            mc: McId::new("Station1").unwrap(),
            epoch: Epoch(epoch),
            owner: owner(by),
            scan: Scan(scan),
            digest: digest(epoch, scan),
            base: base.map(|(epoch, scan)| CheckpointId {
                epoch: Epoch(epoch),
                scan: Scan(scan),
                digest: digest(epoch, scan),
            }),
            phase: Phase::Running,
            released: false,
            at_us,
        }
    }

    #[test]
    fn double_driving_is_counted() {
        let base = Some((1, 1));
        for (name, entries, want) in [
            (
                "one after the other",
                vec![entry(1, 1, 1, 0, None), entry(2, 2, 2, 5, base)],
                0,
            ),
            (
                "a deposed owner goes on",
                vec![
                    entry(1, 1, 1, 0, None),
                    entry(2, 2, 2, 5, base),
                    entry(1, 1, 2, 6, None),
                    entry(2, 2, 3, 7, base),
                    entry(1, 1, 3, 8, None),
                ],
                2,
            ),
            (
                "one epoch, two owners",
                vec![entry(1, 1, 1, 0, None), entry(1, 2, 2, 5, None)],
                1,
            ),
        ] {
            assert_eq!(double_driven_scans(&entries), want, "{name}");
        }
    }

    #[test]
    fn gaps_of_two_cycles_count_and_shorter_ones_do_not() {
        let cycle = BTreeMap::from([(McId::new("Station1").unwrap(), 5_000)]);
        let entries = [
            entry(1, 1, 1, 0, None),
            entry(1, 1, 2, 9_999, None),
            entry(1, 1, 3, 20_000, None),
            entry(2, 2, 4, 36_000, None),
        ];
        let found: Vec<_> = gaps(&entries, &cycle)
            .iter()
            .map(|gap| (gap.from_us, gap.missed_scans))
            .collect();
        assert_eq!(found, [(9_999, 1), (20_000, 2)]);
        assert_eq!(gaps(&entries, &BTreeMap::new()), []);
    }

    #[test]
    fn a_takeover_tells_its_time_and_what_it_lost() {
        let entries = [
            entry(1, 1, 1, 0, None),
            entry(1, 1, 2, 5, None),
            entry(2, 2, 3, 12, Some((1, 2))),
            entry(3, 1, 4, 30, Some((1, 2))),
        ];
        let found = takeovers(&entries);
        let times: Vec<_> = found
            .iter()
            .map(|t| (t.last_us, t.first_us, t.scans_behind))
            .collect();
        assert_eq!(times, [(5, 12, 0), (12, 30, 1)]);
    }

    #[test]
    fn each_break_of_a_chain_is_found() {
        let start = entry(1, 1, 5, 0, None);
        for (name, next, want) in [
            ("whole", entry(1, 1, 6, 1, None), None),
            ("takeover", entry(2, 2, 6, 1, Some((1, 5))), None),
            ("cold reset", entry(2, 2, 6, 1, None), None),
            (
                "scan",
                entry(1, 1, 5, 1, None),
                Some("was applied after scan 5"),
            ),
            (
                "epoch",
                entry(0, 1, 6, 1, None),
                Some("after one of epoch 1"),
            ),
            ("owners", entry(1, 2, 6, 1, None), Some("was driven by c1")),
            ("base", entry(2, 2, 6, 1, Some((1, 4))), Some("builds on")),
        ] {
            let found = check_chain(&[start.clone(), next], true).map_err(|e| e.to_string());
            match (found, want) {
                (Ok(()), None) => {}
                (Err(text), Some(want)) => assert!(text.contains(want), "{name}: {text}"),
                (found, want) => panic!("{name}: {found:?} instead of {want:?}"),
            }
        }
    }

    #[test]
    fn the_journal_is_bounded_and_says_what_is_gone() {
        let mut journal = Journal::new(3);
        for scan in 0..5 {
            journal.push(entry(1, 1, scan, scan, None));
        }
        let scans = |from, limit| {
            let (first, entries) = journal.since(from, limit);
            (first, entries.iter().map(|e| e.scan.0).collect::<Vec<_>>())
        };
        assert_eq!(journal.end(), 5);
        assert_eq!(scans(0, 10), (2, vec![2, 3, 4]));
        assert_eq!(scans(3, 1), (3, vec![3]));
        assert_eq!(scans(9, 10), (5, vec![]));
    }
}
