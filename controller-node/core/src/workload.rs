//! Accounting of one active MC: scan times, scans, lag.

use fam_proto::Now;

/// Counts since activation. Nothing here allocates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Workload {
    /// Scans.
    pub scans: u64,
    /// Their CPU time, in nanoseconds.
    pub cpu_ns: u64,
    /// Ticks at which it was due and had no fresh image.
    pub starved: u64,
    /// Frames that could not be handed on, because all buffers were on the way.
    pub unsent: u64,
    first_at: Option<Now>,
    /// The longest scans of the stretches, longest first, in this half of the window and in the one before.
    longest_ns: [Longest; 2],
    half_began: Now,
    /// The longest scans of the stretch that goes on, longest first.
    stretch_ns: Longest,
    stretch_began: Now,
}

/// Half of the time for which long scans count: long enough for what a station does rarely, short enough that a disturbance
/// of the machine does not weigh for ever.
const HALF_WINDOW_US: u64 = 30_000_000;
/// Of the scans in a stretch of this time the longest counts, and no other: when a machine is disturbed (pages that have to be
/// fetched, a virtual machine that was not run), many scans take long one after the other.
const STRETCH_US: u64 = 2_000_000;
/// The worst case is what scans took in so many stretches of the window: what happens in one or two is the machine's, and no
/// reason to move anything; what the program does comes again.
const WORST_SEEN: usize = 3;

/// CPU times of the longest scans, longest first; 0 for those that there were not.
type Longest = [u64; WORST_SEEN];

fn insert(longest: &mut Longest, ns: u64) {
    let at = longest.partition_point(|known| *known >= ns);
    if at < WORST_SEEN {
        longest[at..].rotate_right(1);
        longest[at] = ns;
    }
}

impl Workload {
    /// A scan at `now` has taken this CPU time.
    pub fn scanned(&mut self, now: Now, cpu_ns: u64) {
        self.first_at.get_or_insert(now);
        self.scans += 1;
        self.cpu_ns += cpu_ns;
        if now.since_us(self.stretch_began) >= STRETCH_US {
            insert(&mut self.longest_ns[0], self.stretch_ns[0]);
            (self.stretch_ns, self.stretch_began) = (Longest::default(), now);
        }
        if now.since_us(self.half_began) >= HALF_WINDOW_US {
            let far = now.since_us(self.half_began) >= 2 * HALF_WINDOW_US;
            let before = self.longest_ns[0];
            self.longest_ns = [
                Longest::default(),
                if far { Longest::default() } else { before },
            ];
            self.half_began = now;
        }
        insert(&mut self.stretch_ns, cpu_ns);
    }

    /// CPU time that scans reached in three stretches of the last 30 to 60 s, in nanoseconds; of fewer stretches, what scans
    /// reached in each of them; in the first stretch, what three scans reached: the very first ones are cold.
    #[must_use]
    pub fn worst_ns(&self) -> u64 {
        let mut longest = self.longest_ns[0];
        for ns in self.longest_ns[1] {
            insert(&mut longest, ns);
        }
        if longest == Longest::default() {
            longest = self.stretch_ns;
        } else {
            insert(&mut longest, self.stretch_ns[0]);
        }
        let seen = longest.iter().rev().find(|ns| **ns > 0);
        seen.copied().unwrap_or(0)
    }

    /// Mean CPU time of a scan, in nanoseconds.
    #[must_use]
    pub fn mean_ns(&self) -> u64 {
        self.cpu_ns / self.scans.max(1)
    }

    /// How far MC time has fallen behind real time since the first scan, in microseconds.
    #[must_use]
    pub fn lag_us(&self, now: Now, cycle_us: u32) -> u64 {
        self.first_at.map_or(0, |first| {
            now.since_us(first)
                .saturating_sub(self.scans.saturating_mul(u64::from(cycle_us)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lag_grows_only_by_scans_that_did_not_come() {
        let mut work = Workload::default();
        assert_eq!(work.lag_us(Now(9_000), 5_000), 0);
        for n in 0..10 {
            work.scanned(Now(1_000 + n * 5_000), 200 + n);
        }
        assert_eq!((work.mean_ns(), work.worst_ns()), (204, 207));
        assert_eq!(work.lag_us(Now(46_000), 5_000), 0);
        assert_eq!(work.lag_us(Now(51_000), 5_000), 0);
        assert_eq!(work.lag_us(Now(71_000), 5_000), 20_000);
    }

    const SECOND: u64 = 1_000_000;

    fn scans(work: &mut Workload, at_s: u64, took: u64) {
        work.scanned(Now(at_s * SECOND), took);
    }

    #[test]
    fn the_worst_case_is_what_came_in_three_stretches_of_one_to_two_half_windows() {
        let mut work = Workload::default();
        for at in [100, 103, 106] {
            scans(&mut work, at, 900);
        }
        for (at, worst) in [
            (120, 900),
            (140, 900),
            (155, 900),
            (161, 900),
            (190, 100),
            (200, 100),
        ] {
            scans(&mut work, at, 100);
            assert_eq!(work.worst_ns(), worst, "after {at} s");
        }
    }

    #[test]
    fn after_a_long_pause_nothing_counts_but_what_came_since() {
        let mut work = Workload::default();
        for at in [100, 103, 106, 500, 503, 506, 509] {
            scans(&mut work, at, if at < 500 { 900 } else { 100 });
        }
        assert_eq!(work.worst_ns(), 100);
    }

    #[test]
    fn what_happens_in_one_or_two_stretches_is_not_the_program() {
        let mut work = Workload::default();
        let expected = [
            (1, 300, 300), // the first scan is all that is known
            (3, 8_000, 300),
            (5, 310, 300), // the cold first scans are one stretch of three
            (7, 320, 310),
            (9, 7_000, 320),
            (11, 305, 320),
            (13, 6_000, 6_000), // in a third one: it comes again
            (15, 7_500, 7_000),
        ];
        for (at, took, worst) in expected {
            scans(&mut work, at, took);
            assert_eq!(work.worst_ns(), worst, "at {at} s");
        }
    }

    #[test]
    fn many_long_scans_one_after_the_other_are_one() {
        let mut work = Workload::default();
        for tick in 0..2_000 {
            let at = Now(10 * SECOND + tick * 5_000);
            // From 12 s to 14 s everything takes long.
            let disturbed = (400..800).contains(&tick);
            work.scanned(at, if disturbed { 5_000 + tick } else { 100 });
        }
        assert_eq!(work.worst_ns(), 100);
    }

    #[test]
    fn the_first_scans_are_cold() {
        let mut work = Workload::default();
        for (at, took) in [900, 800, 110, 120, 100].into_iter().enumerate() {
            work.scanned(Now(10 * SECOND + at as u64), took);
        }
        assert_eq!(work.worst_ns(), 120);
        scans(&mut work, 12, 105);
        assert_eq!(work.worst_ns(), 105);
    }

    #[test]
    fn halves_of_the_window_count_together() {
        let mut work = Workload::default();
        for (at, took) in [
            (101, 100),
            (104, 100),
            (107, 900),
            (135, 800),
            (138, 100),
            (141, 700),
        ] {
            scans(&mut work, at, took);
        }
        assert_eq!(work.worst_ns(), 700);
    }
}
