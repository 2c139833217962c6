//! Memory and file descriptors of the processes of a soak, as `/proc` tells them.

use std::collections::BTreeMap;

/// What a process holds at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Holding {
    /// Resident memory, in kilobytes.
    pub rss_kb: u64,
    /// Open file descriptors.
    pub fds: u64,
}

/// What one process (over all its lives) has held.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Held {
    /// At the first measurement.
    pub start: Holding,
    /// At the last one.
    pub end: Holding,
    /// The most.
    pub peak: Holding,
    /// Number of lives measured.
    pub lives: u64,
    /// Measurements of the life that was measured most, its first and its last.
    pub longest: (u64, Holding, Holding),
    pid: u32,
    life: (u64, Holding),
}

/// All processes.
#[derive(Debug, Default)]
pub struct Meter {
    held: BTreeMap<String, Held>,
}

/// What a process holds now; `None` if it is gone.
pub fn holding(pid: u32) -> Option<Holding> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let rss_kb = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?
        .split_whitespace()
        .next()?
        .parse()
        .ok()?;
    let fds = std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count() as u64;
    Some(Holding { rss_kb, fds })
}

impl Meter {
    /// By process.
    pub fn held(&self) -> &BTreeMap<String, Held> {
        &self.held
    }

    /// Measures these processes.
    pub fn measure(&mut self, pids: &[(String, u32)]) {
        for (name, pid) in pids {
            if let Some(now) = holding(*pid) {
                self.take(name, *pid, now);
            }
        }
    }

    fn take(&mut self, name: &str, pid: u32, now: Holding) {
        let held = self.held.entry(name.to_owned()).or_insert(Held {
            start: now,
            end: now,
            peak: now,
            lives: 1,
            longest: (0, now, now),
            pid,
            life: (0, now),
        });
        if held.pid != pid {
            held.pid = pid;
            held.lives += 1;
            held.life = (0, now);
        }
        held.life.0 += 1;
        if held.life.0 >= held.longest.0 {
            held.longest = (held.life.0, held.life.1, now);
        }
        held.end = now;
        held.peak = Holding {
            rss_kb: held.peak.rss_kb.max(now.rss_kb),
            fds: held.peak.fds.max(now.fds),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lives_are_told_apart() {
        let mut meter = Meter::default();
        for (pid, rss_kb) in [(1, 10), (1, 30), (2, 5), (2, 6), (2, 7)] {
            meter.take("node", pid, Holding { rss_kb, fds: 3 });
        }
        let held = &meter.held()["node"];
        let rss = |h: Holding| h.rss_kb;
        assert_eq!(
            (rss(held.start), rss(held.end), rss(held.peak), held.lives),
            (10, 7, 30, 2)
        );
        assert_eq!(
            (held.longest.0, rss(held.longest.1), rss(held.longest.2)),
            (3, 5, 7)
        );
    }

    #[test]
    fn this_process_holds_something() {
        let now = holding(std::process::id()).unwrap();
        assert!(now.rss_kb > 100 && now.fds >= 3, "{now:?}");
    }
}
