//! Virtual time: the queue of what is to happen, and each process's own clock.

use fam_proto::Now;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// What is to happen, ordered by time and, at one time, by the order in which it was put in.
#[derive(Debug)]
pub struct Queue<E> {
    heap: BinaryHeap<Reverse<Entry<E>>>,
    sequence: u64,
}

#[derive(Debug)]
struct Entry<E> {
    at_us: u64,
    /// Faults come before all else of their moment, so that a recorded schedule repeats what an aimed one did.
    late: bool,
    sequence: u64,
    event: E,
}

impl<E> PartialEq for Entry<E> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl<E> Eq for Entry<E> {}
impl<E> PartialOrd for Entry<E> {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl<E> Ord for Entry<E> {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        let key = |e: &Self| (e.at_us, e.late, e.sequence);
        key(self).cmp(&key(other))
    }
}

impl<E> Queue<E> {
    /// An empty queue.
    #[must_use]
    pub fn new() -> Queue<E> {
        Queue {
            heap: BinaryHeap::new(),
            sequence: 0,
        }
    }

    /// Lets something happen at a time.
    pub fn push(&mut self, at_us: u64, event: E) {
        self.put(at_us, true, event);
    }

    /// Lets something happen at a time, before all that is put there by [`Queue::push`].
    pub fn push_first(&mut self, at_us: u64, event: E) {
        self.put(at_us, false, event);
    }

    fn put(&mut self, at_us: u64, late: bool, event: E) {
        self.sequence += 1;
        self.heap.push(Reverse(Entry {
            at_us,
            late,
            sequence: self.sequence,
            event,
        }));
    }

    /// What happens next, and when.
    pub fn pop(&mut self) -> Option<(u64, E)> {
        self.heap.pop().map(|Reverse(e)| (e.at_us, e.event))
    }
}

impl<E> Default for Queue<E> {
    fn default() -> Self {
        Queue::new()
    }
}

/// A process's monotonic clock: begins anywhere, and runs a little too fast or too slow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    /// When the process began, in virtual time.
    pub origin_us: u64,
    /// What its clock showed then.
    pub start_us: u64,
    /// How much too fast it runs, in millionths.
    pub fast_ppm: i64,
}

impl Clock {
    /// What the clock shows at a virtual time.
    #[must_use]
    pub fn local(&self, at_us: u64) -> Now {
        let passed = at_us.saturating_sub(self.origin_us);
        let drift = i64::try_from(passed).unwrap_or(i64::MAX / 2_000) * self.fast_ppm / 1_000_000;
        Now(self.start_us + passed.saturating_add_signed(drift))
    }

    /// From a virtual time on it runs at another rate; what it shows then does not jump.
    pub fn drift(&mut self, at_us: u64, fast_ppm: i64) {
        self.start_us = self.local(at_us).0;
        self.origin_us = self.origin_us.max(at_us);
        self.fast_ppm = fast_ppm;
    }

    /// The first virtual time at which the clock shows `now` or more.
    #[must_use]
    pub fn global(&self, now: Now) -> u64 {
        let wanted = now.0.saturating_sub(self.start_us);
        let rate = u64::try_from(1_000_000 + self.fast_ppm).unwrap_or(1_000_000);
        let guess = u128::from(wanted) * 1_000_000 / u128::from(rate.max(1));
        let mut at_us = self
            .origin_us
            .saturating_add(u64::try_from(guess).unwrap_or(u64::MAX / 2))
            .saturating_sub(2);
        while self.local(at_us) < now {
            at_us += 1;
        }
        at_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_time_keeps_the_order_of_putting_in() {
        let mut queue = Queue::new();
        for (at, event) in [(5, 'b'), (3, 'a'), (5, 'c'), (5, 'd')] {
            queue.push(at, event);
        }
        queue.push_first(5, 'f');
        let order: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(order, [(3, 'a'), (5, 'f'), (5, 'b'), (5, 'c'), (5, 'd')]);
    }

    #[test]
    fn a_clock_that_changes_its_rate_does_not_jump() {
        let mut clock = Clock {
            origin_us: 0,
            start_us: 50,
            fast_ppm: 0,
        };
        clock.drift(1_000_000, 30_000);
        assert_eq!(clock.local(1_000_000), Now(1_000_050));
        assert_eq!(clock.local(2_000_000), Now(2_030_050));
        clock.drift(2_000_000, -30_000);
        assert_eq!(clock.local(3_000_000), Now(3_000_050));
    }

    #[test]
    fn a_drifting_clock_reads_back() {
        for fast_ppm in [-900, -1, 0, 1, 900] {
            let clock = Clock {
                origin_us: 777,
                start_us: 5_000_000,
                fast_ppm,
            };
            for wanted in [5_000_000, 5_000_001, 5_123_456, 9_999_999, 40_000_000] {
                let at = clock.global(Now(wanted));
                assert!(clock.local(at) >= Now(wanted), "{clock:?} {wanted}");
                assert!(
                    at == 0 || at <= 777 || clock.local(at - 1) < Now(wanted),
                    "{clock:?} {wanted}"
                );
            }
        }
    }
}
