//! The stall witness: a paced thread on each core that notes when this machine stops it, so that trials hit by a stall are told apart.

use crate::observe::monotonic_us;
use nix::sched::{CpuSet, sched_setaffinity};
use nix::unistd::Pid;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// Pace of the witness.
const PERIOD_US: u64 = 1_000;
/// A wake-up later than this is a stall.
const STALL_US: u64 = 2_500;

/// A running witness.
pub struct Witness {
    stalls: Arc<Mutex<Vec<(u64, u64)>>>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Witness {
    /// Starts one.
    pub fn start() -> Witness {
        let stalls = Arc::new(Mutex::new(Vec::new()));
        let stop = Arc::new(AtomicBool::new(false));
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = (0..cores)
            .map(|core| {
                let (s, end) = (stalls.clone(), stop.clone());
                std::thread::spawn(move || watch(core, &s, &end))
            })
            .collect();
        Witness {
            stalls,
            stop,
            threads,
        }
    }

    /// Whether this machine stalled at any time between the two moments of its monotonic clock, in microseconds.
    pub fn stalled_between_us(&self, from_us: u64, to_us: u64) -> bool {
        self.stalls.lock().is_ok_and(|stalls| {
            stalls
                .iter()
                .any(|&(begin, end)| begin < to_us && end > from_us)
        })
    }

    /// Number of stalls seen so far.
    pub fn stalls(&self) -> usize {
        self.stalls.lock().map_or(0, |stalls| stalls.len())
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn watch(core: usize, stalls: &Mutex<Vec<(u64, u64)>>, end: &AtomicBool) {
    let mut cores = CpuSet::new();
    // Where threads may not be bound, the witness sees the machine as a whole.
    let _ = cores
        .set(core)
        .and_then(|()| sched_setaffinity(Pid::from_raw(0), &cores));
    let mut due = monotonic_us() + PERIOD_US;
    while !end.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_micros(due.saturating_sub(monotonic_us())));
        let now = monotonic_us();
        if now.saturating_sub(due) > STALL_US
            && let Ok(mut stalls) = stalls.lock()
        {
            stalls.push((due, now));
        }
        due = (due + PERIOD_US).max(now);
    }
}
