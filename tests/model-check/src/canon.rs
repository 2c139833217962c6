//! When two states are one: a hasher that knows the marks of moments and growing numbers (`fam_proto::mark`).
//!
//! A moment counts as its distance to the clock of its process, in the classes of [`CLASSES_US`]. Of epochs, boot ids, orders, plans and counters only their order counts, of scans and images also whether one
//! is the next of another, of digests only which are equal. 0 stays 0. The agents look at nothing else of these numbers, so
//! that states with one fingerprint go on alike.

use fam_proto::Now;
use fam_proto::mark::{MARK, Mark};
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{Hash, Hasher};
use xxhash_rust::xxh3::Xxh3;

/// Distances to the clock are told apart in these classes, in microseconds: the times of the cell and of the agents lie between.
pub const CLASSES_US: [u64; 8] = [
    0, 2_000, 6_000, 20_000, 100_000, 330_000, 1_000_000, 2_500_000,
];

/// The class of a moment: even before the clock, odd after it.
fn class(moment: u64, clock: u64) -> u64 {
    let distance = moment.abs_diff(clock);
    let class = CLASSES_US.partition_point(|us| *us < distance) as u64;
    2 * class + u64::from(moment > clock)
}

/// What a process, or a part of one, feeds: plain words folded to one, and marked numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Words(Vec<(u8, u64)>);

/// The part of a state that one clock belongs to.
struct Feeder {
    origin: Now,
    plain: Xxh3,
    any: bool,
    mark: u8,
    words: Vec<(u8, u64)>,
}

impl Feeder {
    fn flush(&mut self) {
        if self.any {
            self.words.push((0, self.plain.digest()));
            self.plain.reset();
            self.any = false;
        }
    }
}

impl Hasher for Feeder {
    fn write(&mut self, bytes: &[u8]) {
        self.any = true;
        self.plain.update(bytes);
    }

    fn write_u8(&mut self, value: u8) {
        // The kind of a marked number comes right before it.
        self.mark = value;
        self.write(&[value]);
    }

    fn write_u128(&mut self, value: u128) {
        if value & !u128::from(u64::MAX) != MARK {
            return self.write(&value.to_le_bytes());
        }
        #[allow(clippy::cast_possible_truncation)] // the low half is the number
        let mut number = value as u64;
        if self.mark == Mark::Now as u8 {
            number = class(number, self.origin.0);
        }
        self.flush();
        self.words.push((self.mark, number));
    }

    fn finish(&self) -> u64 {
        self.plain.digest()
    }
}

impl Words {
    /// The words of what lives on a clock that stands at `origin`.
    #[must_use]
    pub fn of<T: Hash + ?Sized>(part: &T, origin: Now) -> Words {
        let mut feeder = Feeder {
            origin,
            plain: Xxh3::new(),
            any: false,
            mark: 0,
            words: Vec::new(),
        };
        part.hash(&mut feeder);
        feeder.flush();
        Words(feeder.words)
    }
}

/// Fingerprint of a state, from the words of its parts.
#[must_use]
pub fn fingerprint<'a>(parts: impl Iterator<Item = &'a Words> + Clone) -> u128 {
    let mut numbers: BTreeMap<u8, BTreeSet<u64>> = BTreeMap::new();
    for (mark, number) in parts.clone().flat_map(|words| &words.0) {
        if *mark > Mark::Now as u8 && *mark != Mark::Digest as u8 && *number != 0 {
            numbers.entry(*mark).or_default().insert(*number);
        }
    }
    let ranks: BTreeMap<u8, BTreeMap<u64, u64>> = numbers
        .into_iter()
        .map(|(mark, numbers)| (mark, ranks(mark, &numbers)))
        .collect();
    let mut digests: BTreeMap<u64, u64> = BTreeMap::new();
    let mut hash = Xxh3::new();
    for (n, words) in parts.enumerate() {
        hash.update(&[0xFF, u8::try_from(n).unwrap_or(u8::MAX)]);
        for (mark, number) in &words.0 {
            let number = if *mark == Mark::Digest as u8 {
                let next = digests.len() as u64;
                *digests.entry(*number).or_insert(next)
            } else {
                let rank = ranks.get(mark).and_then(|r| r.get(number));
                rank.copied().unwrap_or(*number)
            };
            hash.update(&[*mark]);
            hash.update(&number.to_le_bytes());
        }
    }
    hash.digest128()
}

/// Ranks from 1; a gap counts as one step more for scans and images.
fn ranks(mark: u8, numbers: &BTreeSet<u64>) -> BTreeMap<u64, u64> {
    let gaps = mark == Mark::Scan as u8 || mark == Mark::Image as u8;
    let mut rank = 0;
    let mut before = None;
    let mut ranks = BTreeMap::new();
    for number in numbers {
        let gap = before.is_none_or(|b| number - b > 1);
        rank += if gaps && gap { 2 } else { 1 };
        before = Some(*number);
        ranks.insert(*number, rank);
    }
    ranks
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{Epoch, Scan};

    fn print<T: Hash>(part: &T, at: u64) -> u128 {
        fingerprint([Words::of(part, Now(at))].iter())
    }

    #[test]
    fn only_distances_and_orders_count() {
        let at = 10_000_000;
        // Moments move with their clock, and count in classes.
        let state = |base: u64| (Now(base - 5), Now(base + 7), "x", 3u32);
        assert_eq!(print(&state(at), at), print(&state(at + 99), at + 99));
        assert_eq!(print(&Now(1), at), print(&Now(2), at));
        assert_eq!(print(&Now(at + 1), at), print(&Now(at + 2), at));
        assert_ne!(print(&Now(at + 1), at), print(&Now(at), at));
        assert_ne!(print(&Now(at + 1), at), print(&Now(at - 1), at));
        assert_ne!(print(&Now(at + 1), at), print(&Now(at + 200_000), at));
        // Epochs by rank, scans with their gaps, plain numbers as they are.
        assert_eq!(
            print(&(Epoch(3), Epoch(9)), 0),
            print(&(Epoch(5), Epoch(6)), 0)
        );
        assert_ne!(
            print(&(Epoch(3), Epoch(3)), 0),
            print(&(Epoch(5), Epoch(6)), 0)
        );
        assert_ne!(
            print(&(Epoch(0), Epoch(3)), 0),
            print(&(Epoch(1), Epoch(3)), 0)
        );
        assert_eq!(print(&(Scan(3), Scan(4)), 0), print(&(Scan(8), Scan(9)), 0));
        assert_ne!(
            print(&(Scan(3), Scan(4)), 0),
            print(&(Scan(8), Scan(10)), 0)
        );
        assert_ne!(print(&3u64, 0), print(&4u64, 0));
    }
}
