//! When two states are one: a hasher that knows the marks of moments and growing numbers (`fam_proto::mark`).
//!
//! - Of epochs, boot ids, scans, plans and counters only their order counts; of orders and digests only which are equal (which order is
//!   newer is told by [`crate::action`], where those that are over are left out); of images nothing: each that arrives is
//!   newer than all before. 0 stays 0. The agents look at nothing else of these numbers.
//! - A moment that lies ahead on its process's clock counts by its place among those that lie ahead: which deadline comes first, and not how far off it is.
//! - A moment that is past counts in classes of distance ([`Lens::past_us`]).
//! - A text with a blank in it is for people.

use fam_proto::Now;
use fam_proto::mark::{MARK, Mark};
use std::collections::BTreeSet;
use std::hash::{Hash, Hasher};
use xxhash_rust::xxh3::Xxh3;

/// How a part of a state is looked at.
#[derive(Debug, Clone, Copy)]
pub struct Lens {
    /// Its clock.
    pub now: Now,
    /// Past moments are told apart by whether they lie further back than these, in microseconds.
    pub past_us: &'static [u64],
}

impl Lens {
    /// For what has no clock.
    pub const TIMELESS: Lens = Lens {
        now: Now(0),
        past_us: &[],
    };
}

/// A moment ahead, before it has its rank.
const AHEAD: u64 = 1 << 32;

/// What a process, or a part of one, feeds: plain words folded to one, and marked numbers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Words {
    words: Vec<(u8, u64)>,
    exact: u128,
}

/// The part of a state that one clock belongs to.
struct Feeder {
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

    fn number(&mut self, bytes: &[u8]) {
        self.any = true;
        self.plain.update(bytes);
    }
}

impl Hasher for Feeder {
    /// Texts come this way, and bytes.
    fn write(&mut self, bytes: &[u8]) {
        let for_people = bytes.contains(&b' ') && std::str::from_utf8(bytes).is_ok();
        self.number(if for_people { b" " } else { bytes });
    }

    fn write_u8(&mut self, value: u8) {
        // The kind of a marked number comes right before it.
        self.mark = value;
        self.number(&[value]);
    }

    fn write_u16(&mut self, value: u16) {
        self.number(&value.to_le_bytes());
    }

    fn write_u32(&mut self, value: u32) {
        self.number(&value.to_le_bytes());
    }

    fn write_u64(&mut self, value: u64) {
        self.number(&value.to_le_bytes());
    }

    fn write_usize(&mut self, value: usize) {
        self.number(&value.to_le_bytes());
    }

    fn write_isize(&mut self, value: isize) {
        self.number(&value.to_le_bytes());
    }

    fn write_u128(&mut self, value: u128) {
        if value & !u128::from(u64::MAX) != MARK {
            return self.number(&value.to_le_bytes());
        }
        self.flush();
        #[allow(clippy::cast_possible_truncation)] // the low half is the number
        self.words.push((self.mark, value as u64));
    }

    fn finish(&self) -> u64 {
        self.plain.digest()
    }
}

impl Words {
    /// The words of a part, seen through its lens.
    #[must_use]
    pub fn of<T: Hash + ?Sized>(part: &T, lens: Lens) -> Words {
        let mut feeder = Feeder {
            plain: Xxh3::new(),
            any: false,
            mark: 0,
            words: Vec::new(),
        };
        part.hash(&mut feeder);
        feeder.flush();
        let mut words = feeder.words;
        let exact = exact(&words, lens.now);
        let now = lens.now.0;
        let mut ahead = BTreeSet::new();
        for (mark, number) in &mut words {
            if *mark == Mark::Image as u8 {
                *number = 0;
            } else if *mark == Mark::Now as u8 && *number > now {
                ahead.insert(*number);
            } else if *mark == Mark::Now as u8 {
                let back = now - *number;
                *number = lens.past_us.partition_point(|us| *us < back) as u64;
            }
        }
        for (mark, number) in &mut words {
            if *mark == Mark::Now as u8 && *number > now {
                *number = AHEAD + ahead.range(..*number).count() as u64;
            }
        }
        Words { words, exact }
    }

    /// Fingerprint of the part with all its numbers as they are.
    #[must_use]
    pub fn exact(&self) -> u128 {
        self.exact
    }
}

fn exact(words: &[(u8, u64)], now: Now) -> u128 {
    let mut hash = Xxh3::new();
    hash.update(&now.0.to_le_bytes());
    for (mark, number) in words {
        hash.update(&[*mark]);
        hash.update(&number.to_le_bytes());
    }
    hash.digest128()
}

/// How a kind of numbers is told apart.
fn is_ranked(mark: u8) -> bool {
    mark > Mark::Now as u8 && !is_equated(mark)
}

fn is_equated(mark: u8) -> bool {
    mark == Mark::Digest as u8 || mark == Mark::Order as u8
}

/// Fingerprint of a state, from the words of its parts.
#[must_use]
pub fn fingerprint<'a>(parts: impl Iterator<Item = &'a Words> + Clone) -> u128 {
    let mut ranked: Vec<(u8, u64)> = parts
        .clone()
        .flat_map(|words| &words.words)
        .filter(|(mark, number)| is_ranked(*mark) && *number != 0)
        .copied()
        .collect();
    ranked.sort_unstable();
    ranked.dedup();
    let first = |mark: u8| ranked.partition_point(|(m, _)| *m < mark);
    let mut equated: Vec<(u8, u64)> = Vec::new();
    let mut hash = Xxh3::new();
    for (n, words) in parts.enumerate() {
        hash.update(&[0xFF, u8::try_from(n).unwrap_or(u8::MAX)]);
        for word in &words.words {
            let (mark, number) = *word;
            let number = if number == 0 || mark <= Mark::Now as u8 {
                number
            } else if is_equated(mark) {
                let known = equated.iter().position(|w| w == word);
                known.unwrap_or_else(|| {
                    equated.push(*word);
                    equated.len() - 1
                }) as u64
                    + 1
            } else {
                let at = ranked.binary_search(word).unwrap_or_else(|at| at);
                (at - first(mark)) as u64 + 1
            };
            hash.update(&[mark]);
            hash.update(&number.to_le_bytes());
        }
    }
    hash.digest128()
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{Epoch, ImageNumber, OrderId, Scan};

    fn print<T: Hash>(part: &T, at: u64) -> u128 {
        let lens = Lens {
            now: Now(at),
            past_us: &[0, 1_000],
        };
        fingerprint([Words::of(part, lens)].iter())
    }

    #[test]
    fn only_what_agents_look_at_counts() {
        let at = 10_000_000;
        // Past moments count in classes, and move with their clock.
        let state = |base: u64| (Now(base - 5), Now(base + 7), "x", 3u32);
        assert_eq!(print(&state(at), at), print(&state(at + 99), at + 99));
        assert_eq!(print(&Now(1), at), print(&Now(2), at));
        assert_ne!(print(&Now(at - 1), at), print(&Now(at), at));
        assert_ne!(print(&Now(at - 1), at), print(&Now(at - 1_001), at));
        // Moments ahead by which comes first.
        let two = |a: u64, b: u64| print(&(Now(at + a), Now(at + b)), at);
        assert_eq!(two(1, 2), two(5, 9_000));
        assert_ne!(two(1, 2), two(2, 1));
        assert_ne!(two(1, 2), two(1, 1));
        assert_ne!(print(&Now(at + 1), at), print(&Now(at), at));
        // Epochs and scans by rank, orders by which are equal, images not at all, plain numbers as they are.
        let epochs = |a, b| print(&(Epoch(a), Epoch(b)), 0);
        assert_eq!(epochs(3, 9), epochs(5, 6));
        assert_ne!(epochs(3, 3), epochs(5, 6));
        assert_ne!(epochs(0, 3), epochs(1, 3));
        let scans = |a, b| print(&(Scan(a), Scan(b)), 0);
        assert_eq!(scans(3, 4), scans(8, 10));
        assert_ne!(scans(3, 4), scans(4, 3));
        let orders = |a, b| print(&(OrderId(a), OrderId(b)), 0);
        assert_eq!(orders(3, 4), orders(9, 8));
        assert_ne!(orders(3, 4), orders(4, 4));
        assert_eq!(print(&ImageNumber(3), 0), print(&ImageNumber(4), 0));
        assert_ne!(print(&3u64, 0), print(&4u64, 0));
        // Names count, what is told to people does not.
        assert_ne!(print(&"station1", 0), print(&"station2", 0));
        assert_eq!(print(&"in 3 ms", 0), print(&"in 14 ms", 0));
    }
}
