//! Stops scans that take too long. Scans are numbered; compiled loops compare a word of their own linear memory (`STOP_AT`) with the
//! number of the scan that they belong to, and a tick of the watchdog writes there the number of a scan whose ticks are used up.
//! Wasmtime's epochs would do, but the call that is behind each of their checks makes the code keep floating-point variables in
//! memory: inner loops take three times as long.

use std::sync::atomic::{AtomicPtr, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// No scan runs, or one without end.
const IDLE: u64 = 0;
/// Ticks are compared modulo 2^32; so many are as good as no end (24 days of milliseconds).
const TICKS_MAX: u64 = 1 << 31;

/// The ticks of an engine, and the instances that they concern.
#[derive(Debug, Default)]
pub(super) struct Watchdog {
    ticks: AtomicU64,
    watches: Mutex<Vec<Arc<Watch>>>,
}

/// What the watchdog knows of one instance.
#[derive(Debug)]
pub(super) struct Watch {
    /// `IDLE`, or the tick at which the scan that runs is stopped (upper half) and its number (lower half, not 0): one word, so that
    /// no tick of one scan is taken for that of the next.
    due: AtomicU64,
    stop: AtomicPtr<u32>,
}

impl Watchdog {
    /// Takes an instance in.
    ///
    /// # Safety
    /// `stop` is valid and aligned until `forget`, and nobody holds a reference to it.
    pub unsafe fn watch(&self, stop: *mut u32) -> Arc<Watch> {
        let watch = Arc::new(Watch {
            due: AtomicU64::new(IDLE),
            stop: AtomicPtr::new(stop),
        });
        self.list().push(watch.clone());
        watch
    }

    pub fn forget(&self, watch: &Arc<Watch>) {
        self.list().retain(|w| !Arc::ptr_eq(w, watch));
    }

    pub fn tick(&self) {
        let now = self.ticks.fetch_add(1, Ordering::SeqCst) + 1;
        // While the list is locked no instance on it goes away.
        for watch in self.list().iter() {
            watch.stop_if_due(now);
        }
    }

    /// The scan of this number begins, which may take so many ticks; the one that is running counts as the first.
    pub fn begin(&self, watch: &Watch, scan: u32, budget_ticks: u64) {
        let due = if budget_ticks < TICKS_MAX {
            let tick = self.ticks.load(Ordering::SeqCst).wrapping_add(budget_ticks);
            tick << 32 | u64::from(scan)
        } else {
            IDLE
        };
        watch.due.store(due, Ordering::Release);
    }

    fn list(&self) -> MutexGuard<'_, Vec<Arc<Watch>>> {
        // A list is whole between any two of its operations.
        self.watches.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Watch {
    /// The scan has ended. The watchdog may still write its number once more, which no later scan has.
    pub fn end(&self) {
        self.due.store(IDLE, Ordering::Release);
    }

    fn stop_if_due(&self, now: u64) {
        let due = self.due.load(Ordering::Acquire);
        let past = (now as u32).wrapping_sub((due >> 32) as u32);
        if due == IDLE || u64::from(past) >= TICKS_MAX {
            return;
        }
        let stop = self.stop.load(Ordering::Relaxed);
        // SAFETY: who called `Watchdog::watch` keeps the word valid and unreferenced. Compiled code reads it with plain loads of an
        // aligned word, which see the old or the new value.
        unsafe { AtomicU32::from_ptr(stop) }.store(due as u32, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_word(test: impl FnOnce(&Watchdog, &Watch, &dyn Fn() -> u32)) {
        let mut word = 0u32;
        let at: *mut u32 = &mut word;
        let watchdog = Watchdog::default();
        // SAFETY: the word outlives the watchdog, and is read through the same pointer.
        let watch = unsafe { watchdog.watch(at) };
        test(&watchdog, &watch, &|| {
            unsafe { AtomicU32::from_ptr(at) }.load(Ordering::Relaxed)
        });
    }

    #[test]
    fn a_scan_is_stopped_at_the_last_of_its_ticks_and_not_before() {
        with_word(|watchdog, watch, word| {
            watchdog.tick();
            watchdog.begin(watch, 7, 2);
            watchdog.tick();
            assert_eq!(word(), 0);
            watchdog.tick();
            assert_eq!(word(), 7);
        });
    }

    #[test]
    fn nothing_is_written_between_scans_and_without_end() {
        with_word(|watchdog, watch, word| {
            watchdog.begin(watch, 1, 1);
            watch.end();
            watchdog.tick();
            assert_eq!(word(), 0, "between scans");
            watchdog.begin(watch, 2, u64::MAX);
            watchdog.tick();
            assert_eq!(word(), 0, "a budget without end");
        });
    }

    #[test]
    fn ticks_are_compared_beyond_32_bits() {
        with_word(|watchdog, watch, word| {
            watchdog
                .ticks
                .store(u64::from(u32::MAX) - 1, Ordering::SeqCst);
            watchdog.begin(watch, 3, 4);
            for _ in 0..3 {
                watchdog.tick();
                assert_eq!(word(), 0);
            }
            watchdog.tick();
            assert_eq!(word(), 3);
        });
    }
}
