//! Notes when this machine itself stalls: a controller that the machine holds up is rightly taken for a lost one.

use crate::journal::monotonic_us;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Pace of the witness.
const PACE: Duration = Duration::from_millis(1);
/// Woken so much too late is a stall, in microseconds.
const STALL_US: u64 = 8_000;
/// A stall so long before a takeover may have caused it, in microseconds.
const BEFORE_US: u64 = 150_000;

/// Ends when dropped.
#[derive(Default)]
pub struct Stalls {
    seen: Arc<Mutex<Vec<(u64, u64)>>>,
    over: Arc<AtomicBool>,
}

impl Stalls {
    pub fn watch() -> Stalls {
        let stalls = Stalls::default();
        let (seen, over) = (stalls.seen.clone(), stalls.over.clone());
        std::thread::spawn(move || {
            let mut before_us = monotonic_us();
            while !over.load(Ordering::Relaxed) {
                std::thread::sleep(PACE);
                let now_us = monotonic_us();
                if now_us - before_us > STALL_US {
                    let mut seen = seen.lock().unwrap_or_else(PoisonError::into_inner);
                    seen.push((before_us, now_us));
                }
                before_us = now_us;
            }
        });
        stalls
    }

    /// Whether one may have led to what happened between these two moments.
    pub fn explain(&self, from_us: u64, to_us: u64) -> bool {
        let seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.iter()
            .any(|(from, to)| *from < to_us && *to + BEFORE_US > from_us)
    }
}

impl Drop for Stalls {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}
