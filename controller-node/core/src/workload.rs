//! Accounting of one active MC: scan times, scans, lag.

use fam_proto::Now;

/// Counts since activation. Nothing here allocates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Workload {
    /// Scans.
    pub scans: u64,
    /// Their CPU time, in nanoseconds.
    pub cpu_ns: u64,
    /// CPU time of the longest, in nanoseconds.
    pub max_ns: u64,
    /// Ticks at which it was due and had no fresh image.
    pub starved: u64,
    /// Frames that could not be handed on, because all buffers were on the way.
    pub unsent: u64,
    first_at: Option<Now>,
}

impl Workload {
    /// A scan at `now` has taken this CPU time.
    pub fn scanned(&mut self, now: Now, cpu_ns: u64) {
        self.first_at.get_or_insert(now);
        self.scans += 1;
        self.cpu_ns += cpu_ns;
        self.max_ns = self.max_ns.max(cpu_ns);
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
        assert_eq!((work.mean_ns(), work.max_ns), (204, 209));
        assert_eq!(work.lag_us(Now(46_000), 5_000), 0);
        assert_eq!(work.lag_us(Now(51_000), 5_000), 0);
        assert_eq!(work.lag_us(Now(71_000), 5_000), 20_000);
    }
}
