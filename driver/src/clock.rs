//! The process's clocks: monotonic for agents, wall clock for boot ids and for people.

use fam_proto::{BootId, Now};
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

/// Wall clock in microseconds since 1970, for people only.
#[must_use]
pub fn wall_us() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |d| u64::try_from(d.as_micros()).unwrap_or(u64::MAX))
}

/// Number of this life of the process: the wall clock at the first call, so that it grows over restarts.
#[must_use]
pub fn boot_id() -> BootId {
    static BOOT: OnceLock<BootId> = OnceLock::new();
    *BOOT.get_or_init(|| BootId(wall_us()))
}

/// The monotonic instant of a moment, for tokio's timers.
pub(crate) fn instant(at: Now) -> tokio::time::Instant {
    let start = *START.get_or_init(Instant::now);
    // A deadline further away than a day is waited for in pieces.
    let us = at.0.min(now().0.saturating_add(86_400_000_000));
    tokio::time::Instant::from_std(start + std::time::Duration::from_micros(us))
}
