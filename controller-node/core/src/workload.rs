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
    /// CPU time of the longest scan in this half of the window and in the one before.
    longest_ns: [u64; 2],
    half_began: Now,
}

/// Half of the time for which the longest scan counts: long enough for what a station does rarely, short enough that
/// one disturbance of the machine does not weigh for ever.
const HALF_WINDOW_US: u64 = 30_000_000;

impl Workload {
    /// A scan at `now` has taken this CPU time.
    pub fn scanned(&mut self, now: Now, cpu_ns: u64) {
        self.first_at.get_or_insert(now);
        self.scans += 1;
        self.cpu_ns += cpu_ns;
        if now.since_us(self.half_began) >= HALF_WINDOW_US {
            let far = now.since_us(self.half_began) >= 2 * HALF_WINDOW_US;
            self.longest_ns = [0, if far { 0 } else { self.longest_ns[0] }];
            self.half_began = now;
        }
        self.longest_ns[0] = self.longest_ns[0].max(cpu_ns);
    }

    /// CPU time of the longest scan of the last 30 to 60 s, in nanoseconds.
    #[must_use]
    pub fn max_ns(&self) -> u64 {
        self.longest_ns[0].max(self.longest_ns[1])
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
        assert_eq!((work.mean_ns(), work.max_ns()), (204, 209));
        assert_eq!(work.lag_us(Now(46_000), 5_000), 0);
        assert_eq!(work.lag_us(Now(51_000), 5_000), 0);
        assert_eq!(work.lag_us(Now(71_000), 5_000), 20_000);
    }

    #[test]
    fn the_longest_scan_counts_for_one_to_two_half_windows() {
        let mut work = Workload::default();
        let second = 1_000_000;
        work.scanned(Now(second), 900);
        for (at, longest) in [(20, 900), (45, 900), (59, 900), (61, 900), (91, 100)] {
            work.scanned(Now(at * second), 100);
            assert_eq!(work.max_ns(), longest, "after {at} s");
        }
        work.scanned(Now(100 * second), 700);
        work.scanned(Now(500 * second), 100);
        assert_eq!(work.max_ns(), 100, "after a long pause");
    }
}
