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
    /// CPU times of the longest scans, longest first, in this half of the window and in the one before.
    longest_ns: [Longest; 2],
    half_began: Now,
}

/// Half of the time for which long scans count: long enough for what a station does rarely, short enough that a disturbance
/// of the machine does not weigh for ever.
const HALF_WINDOW_US: u64 = 30_000_000;
/// The worst case is what scans took so many times in the window: what happens once or twice in it is the machine's (a page
/// fetched from disk, a virtual machine that was not run), and no reason to move anything; what the program does comes again.
const WORST_SEEN: usize = 3;

/// CPU times of the longest scans, longest first; 0 for scans that there were not.
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
        if now.since_us(self.half_began) >= HALF_WINDOW_US {
            let far = now.since_us(self.half_began) >= 2 * HALF_WINDOW_US;
            let before = self.longest_ns[0];
            self.longest_ns = [
                Longest::default(),
                if far { Longest::default() } else { before },
            ];
            self.half_began = now;
        }
        insert(&mut self.longest_ns[0], cpu_ns);
    }

    /// CPU time that scans of the last 30 to 60 s reached three times, in nanoseconds; of fewer scans, what each of them reached.
    #[must_use]
    pub fn worst_ns(&self) -> u64 {
        let mut longest = self.longest_ns[0];
        for ns in self.longest_ns[1] {
            insert(&mut longest, ns);
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

    #[test]
    fn the_worst_case_is_what_came_three_times_in_one_to_two_half_windows() {
        let mut work = Workload::default();
        let second = 1_000_000;
        for _ in 0..3 {
            work.scanned(Now(second), 900);
        }
        for (at, worst) in [(20, 900), (45, 900), (59, 900), (61, 900), (91, 100)] {
            for _ in 0..3 {
                work.scanned(Now(at * second), 100);
            }
            assert_eq!(work.worst_ns(), worst, "after {at} s");
        }
        for at in [100, 200, 500] {
            work.scanned(Now(at * second), 700);
        }
        for _ in 0..3 {
            work.scanned(Now(500 * second), 100);
        }
        assert_eq!(work.worst_ns(), 100, "after long pauses");
    }

    #[test]
    fn what_happens_once_or_twice_is_not_the_program() {
        let mut work = Workload::default();
        let expected = [
            (300, 300), // the first scan is all that is known
            (8_000, 300),
            (310, 300),
            (320, 310),
            (9_000, 320),
            (305, 320),
            (7_000, 7_000), // a third time: it comes again
            (7_500, 7_500),
        ];
        for (n, (took, worst)) in expected.into_iter().enumerate() {
            work.scanned(Now(n as u64 * 5_000), took);
            assert_eq!(work.worst_ns(), worst, "scan {n}");
        }
    }

    #[test]
    fn halves_of_the_window_count_together() {
        let mut work = Workload::default();
        for (at_s, took) in [
            (1, 100),
            (2, 100),
            (3, 100),
            (4, 900),
            (35, 800),
            (36, 100),
            (37, 700),
        ] {
            work.scanned(Now(at_s * 1_000_000), took);
        }
        assert_eq!(work.worst_ns(), 700);
    }
}
