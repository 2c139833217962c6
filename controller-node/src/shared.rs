//! What the threads of a node tell each other without waiting: counters in atomics.

use fam_agents::node::{McTotals, NodeSample};
use fam_node_core::McSpec;
use fam_node_core::workload::Workload;
use fam_proto::{CheckpointId, Epoch};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

/// Load of one MC; epoch 0 while it is passive. A reader may see one scan more in one number than in another.
#[derive(Debug, Default)]
struct LoadCell {
    epoch: AtomicU64,
    scans: AtomicU64,
    cpu_ns: AtomicU64,
    worst_ns: AtomicU64,
    lag_us: AtomicU64,
    starved: AtomicU64,
    unsent: AtomicU64,
}

/// Counters of the process.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    /// Ticks that began later than half a tick after their time.
    pub late_ticks: AtomicU64,
    /// Ticks whose work took longer than the tick.
    pub overruns: AtomicU64,
    /// Frames that the sender's queue had no room for.
    pub frames_dropped: AtomicU64,
    /// Frames that no replica could use.
    pub frames_refused: AtomicU64,
    /// Frames from others that the replica thread's queue had no room for.
    pub frames_missed: AtomicU64,
    pub host_cpu_permille: AtomicU64,
    pub process_cpu_permille: AtomicU64,
    pub process_memory_kb: AtomicU64,
    pub bad_messages: AtomicU64,
}

/// All of it.
#[derive(Debug)]
pub(crate) struct Shared {
    pub specs: Vec<Arc<McSpec>>,
    loads: Vec<LoadCell>,
    /// Newest checkpoint in each passive instance; not for the scan thread.
    held: Mutex<Vec<Option<CheckpointId>>>,
    pub counters: Counters,
    /// The manager has taken the registration.
    pub registered: AtomicBool,
    /// All threads end.
    pub stop: AtomicBool,
}

impl Shared {
    pub(crate) fn new(specs: Vec<Arc<McSpec>>) -> Shared {
        Shared {
            loads: specs.iter().map(|_| LoadCell::default()).collect(),
            held: Mutex::new(vec![None; specs.len()]),
            specs,
            counters: Counters::default(),
            registered: AtomicBool::new(false),
            stop: AtomicBool::new(false),
        }
    }

    pub(crate) fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Writes the loads of the active MCs; the others become passive. For the scan thread.
    pub(crate) fn write_loads(&self, loads: impl Iterator<Item = (usize, Epoch, Workload, u64)>) {
        let mut next = 0;
        for (mc, epoch, work, lag_us) in loads {
            self.passive(next..mc);
            next = mc + 1;
            let cell = &self.loads[mc];
            for (place, value) in [
                (&cell.epoch, epoch.0),
                (&cell.scans, work.scans),
                (&cell.cpu_ns, work.cpu_ns),
                (&cell.worst_ns, work.worst_ns()),
                (&cell.lag_us, lag_us),
                (&cell.starved, work.starved),
                (&cell.unsent, work.unsent),
            ] {
                place.store(value, Ordering::Relaxed);
            }
        }
        self.passive(next..self.loads.len());
    }

    fn passive(&self, mcs: std::ops::Range<usize>) {
        for cell in &self.loads[mcs] {
            cell.epoch.store(0, Ordering::Relaxed);
        }
    }

    /// The checkpoint that lies in a passive instance now.
    pub(crate) fn hold(&self, mc: usize, id: CheckpointId) {
        if let Ok(mut held) = self.held.lock() {
            held[mc] = Some(id);
        }
    }

    pub(crate) fn held(&self) -> Vec<Option<CheckpointId>> {
        self.held.lock().map(|h| h.clone()).unwrap_or_default()
    }

    /// Ticks at which MCs were due and had no fresh image, and frames that found no buffer, of the active MCs.
    pub(crate) fn starved_and_unsent(&self) -> (u64, u64) {
        let sum = |of: fn(&LoadCell) -> &AtomicU64| {
            let active = self
                .loads
                .iter()
                .filter(|c| c.epoch.load(Ordering::Relaxed) > 0);
            active.map(|c| of(c).load(Ordering::Relaxed)).sum()
        };
        (sum(|c| &c.starved), sum(|c| &c.unsent))
    }

    /// Everything that the Controller Agent reports.
    pub(crate) fn sample(&self) -> NodeSample {
        let get = |place: &AtomicU64| place.load(Ordering::Relaxed);
        let small = |place: &AtomicU64| u32::try_from(get(place)).unwrap_or(u32::MAX);
        let mcs = self.specs.iter().zip(&self.loads);
        let mcs = mcs
            .filter(|(_, cell)| get(&cell.epoch) > 0)
            .map(|(spec, cell)| McTotals {
                mc: spec.mc.clone(),
                cycle_us: spec.cycle_us,
                scans: get(&cell.scans),
                cpu_ns: get(&cell.cpu_ns),
                worst_us: u32::try_from(get(&cell.worst_ns) / 1_000).unwrap_or(u32::MAX),
                lag_us: get(&cell.lag_us),
            });
        let c = &self.counters;
        NodeSample {
            mcs: mcs.collect(),
            host_cpu_permille: small(&c.host_cpu_permille),
            process_cpu_permille: small(&c.process_cpu_permille),
            process_memory_kb: get(&c.process_memory_kb),
            late_ticks: get(&c.late_ticks),
            overruns: get(&c.overruns),
            bad_messages: get(&c.bad_messages) + get(&c.frames_refused),
        }
    }
}
