//! Stops scans that take too long. Compiled loops look at a word of their own linear memory (`STOP_AT`); a tick of the watchdog
//! writes it for every scan whose ticks are used up. Wasmtime's epochs would do, but the call that is behind each of their
//! checks makes the code keep floating-point variables in memory: inner loops take three times as long.

use std::sync::atomic::{AtomicPtr, AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// No scan runs.
const IDLE: u64 = 0;
/// The watchdog writes the word just now.
const WRITING: u64 = u64::MAX;

/// The ticks of an engine, and the instances that they concern.
#[derive(Debug, Default)]
pub(super) struct Watchdog {
    ticks: AtomicU64,
    watches: Mutex<Vec<Arc<Watch>>>,
}

/// What the watchdog knows of one instance.
#[derive(Debug)]
pub(super) struct Watch {
    /// `IDLE`, `WRITING`, or the tick at which the scan that runs is stopped.
    deadline: AtomicU64,
    stop: AtomicPtr<u32>,
}

impl Watchdog {
    /// Takes an instance in.
    ///
    /// # Safety
    /// `stop` is valid and aligned until `forget`, and nobody else holds a reference to it between `Watch::begin` and `Watch::end`.
    pub unsafe fn watch(&self, stop: *mut u32) -> Arc<Watch> {
        let watch = Arc::new(Watch {
            deadline: AtomicU64::new(IDLE),
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

    /// A scan begins that may take so many ticks; the one that is running counts as the first.
    pub fn begin(&self, watch: &Watch, budget_ticks: u64) {
        let deadline = self
            .ticks
            .load(Ordering::SeqCst)
            .saturating_add(budget_ticks);
        watch
            .deadline
            .store(deadline.clamp(IDLE + 1, WRITING - 1), Ordering::Release);
    }

    fn list(&self) -> MutexGuard<'_, Vec<Arc<Watch>>> {
        // A list is whole between any two of its operations.
        self.watches.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Watch {
    /// The scan has ended; when this returns, nothing writes the word any more.
    pub fn end(&self) {
        let mut seen = self.deadline.load(Ordering::Relaxed);
        loop {
            if seen == WRITING {
                std::hint::spin_loop();
                seen = self.deadline.load(Ordering::Relaxed);
                continue;
            }
            match self.deadline.compare_exchange_weak(
                seen,
                IDLE,
                Ordering::Acquire,
                Ordering::Relaxed,
            ) {
                Ok(_) => return,
                Err(now) => seen = now,
            }
        }
    }

    fn stop_if_due(&self, now: u64) {
        let deadline = self.deadline.load(Ordering::Acquire);
        if deadline == IDLE || deadline > now {
            return;
        }
        // Fails if the scan has ended meanwhile. If another has begun with the same deadline, that one is due as well.
        let claimed =
            self.deadline
                .compare_exchange(deadline, WRITING, Ordering::Acquire, Ordering::Relaxed);
        if claimed.is_err() {
            return;
        }
        let stop = self.stop.load(Ordering::Relaxed);
        // SAFETY: who called `Watchdog::watch` keeps the word valid and unreferenced while a scan runs, and `end` waits for
        // what comes next. Compiled code reads it with plain loads of an aligned word, which see the old or the new value.
        unsafe { AtomicU32::from_ptr(stop) }.store(1, Ordering::Relaxed);
        self.deadline.store(deadline, Ordering::Release);
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
            watchdog.begin(watch, 2);
            watchdog.tick();
            assert_eq!(word(), 0);
            watchdog.tick();
            assert_eq!(word(), 1);
        });
    }

    #[test]
    fn nothing_is_written_between_scans_and_after_the_end() {
        with_word(|watchdog, watch, word| {
            watchdog.begin(watch, 1);
            watch.end();
            watchdog.tick();
            assert_eq!(word(), 0, "between scans");
            watchdog.begin(watch, u64::MAX);
            watchdog.tick();
            assert_eq!(word(), 0, "a budget without end");
        });
    }
}
