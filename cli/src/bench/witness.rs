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
/// A wake-up later than this is a disturbance. Several of them, one at each thread that an image or a frame passes, add up to a cycle.
const DISTURBANCE_US: u64 = 1_000;
/// What a disturbance has held up is worked off within this time.
const AFTERMATH_US: u64 = 20_000;

/// A running witness.
pub struct Witness {
    /// Disturbances and stalls: when a wake-up was due, and when it came.
    late: Arc<Mutex<Vec<(u64, u64)>>>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Witness {
    /// Starts one.
    pub fn start() -> Witness {
        let late = Arc::new(Mutex::new(Vec::new()));
        let stop = Arc::new(AtomicBool::new(false));
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let threads = (0..cores)
            .map(|core| {
                let (l, end) = (late.clone(), stop.clone());
                std::thread::spawn(move || watch(core, &l, &end))
            })
            .collect();
        Witness {
            late,
            stop,
            threads,
        }
    }

    /// Whether this machine stalled at any time between the two moments of its monotonic clock, in microseconds.
    pub fn stalled_between_us(&self, from_us: u64, to_us: u64) -> bool {
        self.any(|begin, end| is_stall(begin, end) && begin < to_us && end > from_us)
    }

    /// Whether anything between the two moments may have come of a disturbance of this machine, be it a small one: for what has to
    /// hold on a machine that is left alone.
    pub fn disturbed_between_us(&self, from_us: u64, to_us: u64) -> bool {
        self.any(|begin, end| begin < to_us && end + AFTERMATH_US > from_us)
    }

    /// Number of stalls seen so far.
    pub fn stalls(&self) -> usize {
        self.late.lock().map_or(0, |late| {
            late.iter().filter(|&&(b, e)| is_stall(b, e)).count()
        })
    }

    fn any(&self, of: impl Fn(u64, u64) -> bool) -> bool {
        self.late
            .lock()
            .is_ok_and(|late| late.iter().any(|&(begin, end)| of(begin, end)))
    }
}

fn is_stall(due_us: u64, came_us: u64) -> bool {
    came_us.saturating_sub(due_us) > STALL_US
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn watch(core: usize, late: &Mutex<Vec<(u64, u64)>>, end: &AtomicBool) {
    let mut cores = CpuSet::new();
    // Where threads may not be bound, the witness sees the machine as a whole.
    let _ = cores
        .set(core)
        .and_then(|()| sched_setaffinity(Pid::from_raw(0), &cores));
    let mut due = monotonic_us() + PERIOD_US;
    while !end.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_micros(due.saturating_sub(monotonic_us())));
        let now = monotonic_us();
        if now.saturating_sub(due) > DISTURBANCE_US
            && let Ok(mut late) = late.lock()
        {
            late.push((due, now));
        }
        due = (due + PERIOD_US).max(now);
    }
}
