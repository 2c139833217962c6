//! The watchdog thread: ends endless loops, reads the host's load, and says what cannot be reached.
//!
//! A scan is ended by the CPU time that the scan thread has spent in it, not by the wall clock: a machine that stalls
//! makes no MC trap. A scan that is over its time gets one tick of the engine, and a second one, which ends it, only if
//! the same scan still runs at the next look: the scan after it cannot be hit.

use crate::cpu::{Bell, ThreadClock};
use crate::mailbox::Mailbox;
use crate::scan_thread::{Doing, Jitter};
use crate::shared::Shared;
use crate::trace::{Point, Trace};
use crossbeam_channel::{Receiver, Sender};
use fam_driver::{Link, Topic};
use fam_proto::GatewayId;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use sysinfo::{ProcessRefreshKind, ProcessesToUpdate, System};

/// A scan's time is looked at so many times before it is over.
const LOOKS: u32 = 4;
/// How often the scan thread is looked at, at most and at least.
const LOOK_MIN: Duration = Duration::from_millis(1);
const LOOK_MAX: Duration = Duration::from_millis(10);
/// How often the host's load is read.
const HOST_EVERY: Duration = Duration::from_millis(500);
/// How often measuring points are published.
const TRACE_EVERY: Duration = Duration::from_millis(100);
/// How often a silence is said again.
const SAY_EVERY: Duration = Duration::from_secs(5);
/// An MC's scan may take this many cycles of CPU time.
const CYCLES_MAX: u64 = 4;

/// Longest CPU time of a scan, in nanoseconds: some cycles, but well before the gateway takes the MC as silent.
pub(crate) fn scan_ns_max(cycle_us: u32, suspect_us: u64) -> u64 {
    let cycles_us = u64::from(cycle_us) * CYCLES_MAX;
    let silent_us = (suspect_us / 2).max(u64::from(cycle_us));
    cycles_us.min(silent_us) * 1_000
}

/// What the watchdog thread is given.
pub(crate) struct Watchdog<I> {
    pub doing: Arc<Doing>,
    /// Rung for a scan that goes on: frames of the scans before it may wait.
    pub frames_bell: Arc<Bell>,
    pub clock: Option<ThreadClock>,
    /// For each MC, in nanoseconds.
    pub scan_ns_max: Vec<u64>,
    /// Gives the engine a tick.
    pub interrupt: I,
    pub shared: Arc<Shared>,
    pub mailbox: Arc<Mailbox>,
    pub link: Link,
    pub trace: Arc<Trace>,
    pub trace_topic: Option<Topic>,
    pub jitter_in: Receiver<Jitter>,
    pub jitter_back: Sender<Jitter>,
    /// Endpoints that the node connects to.
    pub connect: Vec<String>,
    /// The controller, for messages to people.
    pub name: String,
}

/// A scan that is over its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Over {
    turn: u64,
}

impl<I: Fn()> Watchdog<I> {
    /// The thread's body; ends when the process stops.
    pub(crate) fn run(mut self) {
        let mut host = Host::new();
        let mut over = None;
        let mut total: Option<Jitter> = crate::scan_thread::jitter();
        let started = Instant::now();
        let shortest = self.scan_ns_max.iter().min().copied();
        let look = shortest.map_or(LOOK_MAX, |ns| {
            (Duration::from_nanos(ns) / LOOKS).clamp(LOOK_MIN, LOOK_MAX)
        });
        let (mut host_at, mut trace_at, mut say_at) = (started, started, started + SAY_EVERY);
        while !self.shared.stopped() {
            std::thread::sleep(look);
            over = self.look(over);
            let now = Instant::now();
            if now >= host_at {
                host_at = now + HOST_EVERY;
                if let Some(host) = &mut host {
                    host.read(&self.shared);
                }
                self.shared
                    .counters
                    .bad_messages
                    .store(self.link.bad_messages(), Ordering::Relaxed);
            }
            if now >= trace_at {
                trace_at = now + TRACE_EVERY;
                self.publish_trace();
            }
            self.collect(&mut total);
            if now >= say_at {
                say_at = now + SAY_EVERY;
                self.say();
            }
        }
        self.collect(&mut total);
        self.sum_up(total.as_ref());
    }

    /// Looks at the scan that runs, if one does.
    fn look(&mut self, over: Option<Over>) -> Option<Over> {
        let clock = self.clock?;
        let turn = self.doing.turn.load(Ordering::Acquire);
        if turn.is_multiple_of(2) {
            return None;
        }
        self.frames_bell.ring();
        let mc = self.doing.mc.load(Ordering::Relaxed) as usize;
        let from_ns = self.doing.from_ns.load(Ordering::Relaxed);
        let limit_ns = *self.scan_ns_max.get(mc)?;
        let spent_ns = clock.ns().saturating_sub(from_ns);
        if spent_ns < limit_ns || self.doing.turn.load(Ordering::Acquire) != turn {
            return None;
        }
        (self.interrupt)();
        if over == Some(Over { turn }) {
            let mc = &self.shared.specs[mc].mc;
            tracing::warn!(mc = %mc, "a scan of {mc} has been ended after {} ms of CPU time", spent_ns / 1_000_000);
            return None;
        }
        Some(Over { turn })
    }

    fn publish_trace(&self) {
        if let Some(topic) = &self.trace_topic
            && let Some(lines) = self.trace.take()
        {
            topic.put(lines);
        }
    }

    /// Takes full histograms and gives them back empty.
    fn collect(&self, total: &mut Option<Jitter>) {
        while let Ok(mut full) = self.jitter_in.try_recv() {
            tracing::debug!(
                "{}: ticks were late by {} us (half of them), {} us (1 %), at most {} us",
                self.name,
                full.value_at_quantile(0.5) / 1_000,
                full.value_at_quantile(0.99) / 1_000,
                full.max() / 1_000
            );
            if let Some(total) = total {
                let _ = total.add(&full);
            }
            self.trace.add(|| Point::Late {
                buckets: full
                    .iter_recorded()
                    .map(|bucket| {
                        (
                            bucket.value_iterated_to(),
                            bucket.count_since_last_iteration(),
                        )
                    })
                    .collect(),
            });
            full.reset();
            let _ = self.jitter_back.try_send(full);
        }
    }

    /// Who has not been heard of.
    fn say(&self) {
        let now = fam_driver::now();
        let silent: BTreeMap<&GatewayId, Option<u64>> = self
            .mailbox
            .ages()
            .map(|(gateway, at)| (gateway, at.map(|at| now.since_us(at))))
            .filter(|(_, age_us)| age_us.is_none_or(|us| us > 1_000_000))
            .collect();
        let endpoints = if self.connect.is_empty() {
            String::new()
        } else {
            format!(" (connecting to {})", self.connect.join(", "))
        };
        for (gateway, age_us) in silent {
            let since = age_us.map_or_else(
                || "since the start".to_owned(),
                |us| format!("for {} s", us / 1_000_000),
            );
            tracing::warn!(
                "{} has had no input image of gateway {gateway} {since} and waits for it{endpoints}",
                self.name
            );
        }
        if !self.shared.registered.load(Ordering::Relaxed) {
            tracing::warn!(
                "no manager has taken the registration of {}, which keeps trying{endpoints}",
                self.name
            );
        }
    }

    fn sum_up(&self, total: Option<&Jitter>) {
        let count = |place: &std::sync::atomic::AtomicU64| place.load(Ordering::Relaxed);
        let counters = &self.shared.counters;
        let (starved, unsent) = self.shared.starved_and_unsent();
        let (half, percent, most) = total.map_or((0, 0, 0), |t| {
            (
                t.value_at_quantile(0.5) / 1_000,
                t.value_at_quantile(0.99) / 1_000,
                t.max() / 1_000,
            )
        });
        tracing::info!(
            late_ticks = count(&counters.late_ticks),
            overruns = count(&counters.overruns),
            frames_dropped = count(&counters.frames_dropped) + unsent,
            frames_missed = count(&counters.frames_missed),
            frames_refused = count(&counters.frames_refused),
            starved,
            "{}: ticks were late by {half} us (half of them), {percent} us (1 %), at most {most} us",
            self.name
        );
    }
}

/// Load of host and process.
struct Host {
    system: System,
    pid: sysinfo::Pid,
}

impl Host {
    fn new() -> Option<Host> {
        let pid = sysinfo::get_current_pid().ok()?;
        Some(Host {
            system: System::new().ok()?,
            pid,
        })
    }

    fn read(&mut self, shared: &Shared) {
        self.system.refresh_cpu_usage();
        let kind = ProcessRefreshKind::nothing()
            .with_cpu()
            .with_memory()
            .without_tasks();
        self.system
            .refresh_processes_specifics(ProcessesToUpdate::Some(&[self.pid]), false, kind);
        let permille = |percent: f32| {
            let permille = (f64::from(percent) * 10.0).round().max(0.0);
            permille as u64 // saturates, and percentages are small
        };
        let counters = &shared.counters;
        counters
            .host_cpu_permille
            .store(permille(self.system.global_cpu_usage()), Ordering::Relaxed);
        if let Some(process) = self.system.process(self.pid) {
            counters
                .process_cpu_permille
                .store(permille(process.cpu_usage()), Ordering::Relaxed);
            counters
                .process_memory_kb
                .store(process.memory() / 1_024, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_is_ended_before_the_gateway_calls_it_silent() {
        assert_eq!(scan_ns_max(5_000, 50_000), 20_000_000);
        assert_eq!(scan_ns_max(20_000, 50_000), 25_000_000);
        assert_eq!(scan_ns_max(100_000, 50_000), 100_000_000);
    }

    #[test]
    fn the_process_has_memory_and_the_host_a_load() {
        let shared = Shared::new(Vec::new());
        let mut host = Host::new().unwrap();
        host.read(&shared);
        assert!(shared.counters.process_memory_kb.load(Ordering::Relaxed) > 500);
        assert!(shared.counters.host_cpu_permille.load(Ordering::Relaxed) <= 1_000);
    }
}
