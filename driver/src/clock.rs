//! The process's clocks: monotonic for agents, wall clock for boot ids and for people.

use fam_proto::{BootId, Now};
use std::path::Path;
use std::sync::OnceLock;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

static START: OnceLock<Instant> = OnceLock::new();

/// Microseconds on the monotonic clock since this process first asked. All parts of a process share this zero.
#[must_use]
pub fn now() -> Now {
    let elapsed = START.get_or_init(Instant::now).elapsed();
    Now(u64::try_from(elapsed.as_micros()).unwrap_or(u64::MAX))
}

/// The process's monotonic clock, to be handed to threads.
pub fn clock() -> impl Fn() -> Now + Clone + Send + Sync + 'static {
    let _ = now();
    now
}

/// For tests: `<milliseconds>:<seconds>` lets this process see its wall clock step by so many seconds once it has run for so
/// many milliseconds. The machine's clock is not touched.
const STEP: &str = "FAM_TEST_CLOCK_STEP";

/// Wall clock in microseconds since 1970, for people only.
#[must_use]
pub fn wall_us() -> u64 {
    static STEPS: OnceLock<Option<Step>> = OnceLock::new();
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let wall_us = since.map_or(0, |d| u64::try_from(d.as_micros()).unwrap_or(u64::MAX));
    let step = STEPS.get_or_init(|| std::env::var(STEP).ok().as_deref().and_then(Step::read));
    step.map_or(wall_us, |step| step.seen(wall_us, now()))
}

/// A step of the wall clock, as a test wants it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Step {
    at: Now,
    by_us: i64,
}

impl Step {
    fn read(text: &str) -> Option<Step> {
        let (ms, seconds) = text.split_once(':')?;
        Some(Step {
            at: Now(ms.parse::<u64>().ok()?.checked_mul(1_000)?),
            by_us: seconds.parse::<i64>().ok()?.checked_mul(1_000_000)?,
        })
    }

    fn seen(self, wall_us: u64, now: Now) -> u64 {
        if now >= self.at {
            wall_us.saturating_add_signed(self.by_us)
        } else {
            wall_us
        }
    }
}

static BOOT: OnceLock<BootId> = OnceLock::new();

/// Number of this life of the process: the wall clock at the first call, so that it grows over restarts, unless
/// [`boot_after`] was called before.
#[must_use]
pub fn boot_id() -> BootId {
    *BOOT.get_or_init(|| BootId(wall_us()))
}

/// As [`boot_id`], above the number of the life before, which `file` keeps: whoever is asked to obey only the latest life
/// (a manager its nodes, nodes their manager) must not be left alone because a wall clock was set back. A file that cannot
/// be read or written is a warning, and the wall clock alone counts.
pub fn boot_after(file: &Path) -> BootId {
    *BOOT.get_or_init(|| next_boot(file, wall_us()))
}

fn next_boot(file: &Path, wall_us: u64) -> BootId {
    let last = match std::fs::read_to_string(file) {
        Ok(text) => text.trim().parse().unwrap_or(0),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => 0,
        Err(error) => {
            tracing::warn!("cannot read {}: {error}", file.display());
            0
        }
    };
    let boot = wall_us.max(last + 1);
    if boot > wall_us {
        tracing::warn!(
            "the wall clock was set back since the life before; this one counts on from it (boot {boot})"
        );
    }
    if let Err(error) = keep(file, boot) {
        tracing::warn!(
            "cannot write {}: {error}; if the wall clock is set back before the next start, the others may not accept that life",
            file.display()
        );
    }
    BootId(boot)
}

/// Whole or not at all.
fn keep(file: &Path, boot: u64) -> std::io::Result<()> {
    if let Some(folder) = file.parent() {
        std::fs::create_dir_all(folder)?;
    }
    let part = file.with_extension("part");
    std::fs::write(&part, format!("{boot}\n"))?;
    std::fs::rename(&part, file)
}

/// The monotonic instant of a moment, for tokio's timers.
pub(crate) fn instant(at: Now) -> tokio::time::Instant {
    let start = *START.get_or_init(Instant::now);
    // A deadline further away than a day is waited for in pieces.
    let us = at.0.min(now().0.saturating_add(86_400_000_000));
    tokio::time::Instant::from_std(start + std::time::Duration::from_micros(us))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lives_are_numbered_upwards_whatever_the_wall_clock_does() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("node").join("boot");
        let boots: Vec<u64> = [1_000, 2_000, 500, 400, 3_000]
            .into_iter()
            .map(|wall_us| next_boot(&file, wall_us).0)
            .collect();
        assert_eq!(boots, [1_000, 2_000, 2_001, 2_002, 3_000]);
        std::fs::write(&file, "damaged").unwrap();
        assert_eq!(next_boot(&file, 7).0, 7);
        assert_eq!(
            next_boot(Path::new("/proc/none/boot"), 7).0,
            7,
            "a file that cannot be written is no obstacle"
        );
    }

    #[test]
    fn a_step_is_seen_from_its_moment_on() {
        let step = Step::read("1500:-3600").unwrap();
        let hour_us = 3_600_000_000;
        assert_eq!(step.seen(2 * hour_us, Now(1_499_999)), 2 * hour_us);
        assert_eq!(step.seen(2 * hour_us, Now(1_500_000)), hour_us);
        for bad in ["", "1", "x:1", "1:x", "-1:1"] {
            assert_eq!(Step::read(bad), None, "{bad}");
        }
    }
}
