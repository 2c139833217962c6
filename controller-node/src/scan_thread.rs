//! The scan thread: absolute deadlines on the monotonic clock; commands, images, one tick of the core, and again.
//!
//! It waits for nothing but its next tick, and for the command that makes an interrupted MC start before it. What it has for others goes into queues with room for it or is counted as lost.

use crate::cpu::{Bell, ThreadClock, monotonic_ns, thread_ns};
use crate::mailbox::Mailbox;
use crate::real_time::{self, RealTimeOptions};
use crate::replica_thread::ReplicaJob;
use crate::sender_thread::Outbox;
use crate::shared::Shared;
use crossbeam_channel::{Receiver, Sender};
use fam_agents::node::NodeLocal;
use fam_node_core::{ActiveMc, McRuntime, ScanCommand, ScanCore, ScanHost, ScannedFrame};
use fam_proto::Now;
use fam_proto::access::McNews;
use hdrhistogram::Histogram;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::mpsc::UnboundedSender;

/// Longest lateness that the histogram tells apart, in nanoseconds.
const JITTER_NS_MAX: u64 = 10_000_000_000;
/// How often the histogram is handed to the watchdog thread, in nanoseconds.
const JITTER_EVERY_NS: u64 = 10_000_000_000;

/// Lateness of ticks, in nanoseconds.
pub type Jitter = Histogram<u64>;

/// An empty histogram that never grows, so that recording into it allocates nothing.
#[must_use]
pub fn jitter() -> Option<Jitter> {
    Histogram::new_with_bounds(1, JITTER_NS_MAX, 2).ok()
}

/// What the scan thread is doing, for the watchdog.
#[derive(Debug, Default)]
pub(crate) struct Doing {
    /// Counts up at the beginning and at the end of each scan: odd while one runs.
    pub turn: AtomicU64,
    /// Which MC.
    pub mc: AtomicU64,
    /// CPU time of the thread at the scan's beginning, in nanoseconds.
    pub from_ns: AtomicU64,
}

/// What the scan thread is given.
pub(crate) struct ScanThread<R> {
    pub core: ScanCore<R>,
    pub tick_us: u32,
    pub mailbox: Arc<Mailbox>,
    pub shared: Arc<Shared>,
    pub commands: Receiver<ScanCommand<R>>,
    /// Rung for each command.
    pub bell: Arc<Bell>,
    pub host: Host<R>,
    /// Full histograms out, empty ones back.
    pub jitter_out: Sender<Jitter>,
    pub jitter_back: Receiver<Jitter>,
}

/// Where the core's outputs go.
pub(crate) struct Host<R> {
    pub shared: Arc<Shared>,
    pub doing: Arc<Doing>,
    pub frames: Outbox,
    pub replicas: Sender<ReplicaJob<R>>,
    pub news: UnboundedSender<NodeLocal>,
    /// How long the last scan of each MC took, in nanoseconds.
    pub took_ns: Vec<u64>,
    /// The scan that runs, and since when.
    pub scan: Option<(usize, u64)>,
}

impl<R> ScanHost<R> for Host<R> {
    fn cpu_ns(&mut self) -> u64 {
        thread_ns()
    }

    fn scanning(&mut self, mc: Option<usize>) {
        if let Some(mc) = mc {
            self.frames.before_a_scan_of(self.took_ns[mc]);
            self.scan = Some((mc, monotonic_ns()));
            self.doing.mc.store(mc as u64, Ordering::Relaxed);
            self.doing.from_ns.store(thread_ns(), Ordering::Relaxed);
        } else if let Some((mc, from_ns)) = self.scan.take() {
            self.took_ns[mc] = monotonic_ns().saturating_sub(from_ns);
        }
        self.doing.turn.fetch_add(1, Ordering::Release);
    }

    fn spend_ns(&mut self, ns: u64) {
        let until = thread_ns() + ns;
        while thread_ns() < until {
            std::hint::spin_loop();
        }
    }

    fn frame(&mut self, frame: ScannedFrame) {
        if !self.frames.put(frame) {
            let dropped = &self.shared.counters.frames_dropped;
            dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn news(&mut self, mc: usize, news: McNews) {
        let mc = self.shared.specs[mc].mc.clone();
        // An error means that the process is ending.
        let _ = self.news.send(NodeLocal::Mc { mc, news });
    }

    fn returned(&mut self, mc: Box<ActiveMc<R>>) {
        // There is room: the queue is longer than there are MCs, and each has one instance.
        let _ = self.replicas.try_send(ReplicaJob::Returned(mc));
    }
}

/// What the scan thread tells once it has begun.
pub(crate) struct Begun {
    /// Real-time means in force.
    pub real_time: Vec<String>,
    /// Its CPU clock.
    pub clock: Option<ThreadClock>,
}

impl<R: McRuntime> ScanThread<R> {
    /// The thread's body; ends when `shared.stop` is set.
    pub(crate) fn run(mut self, options: &RealTimeOptions, begun: &Sender<Begun>) {
        let real_time = real_time::apply_to_this_thread(options);
        let clock = ThreadClock::of_this_thread();
        let _ = begun.send(Begun { real_time, clock });
        let tick_ns = u64::from(self.tick_us.max(1)) * 1_000;
        let mut jitter = self.jitter_back.try_recv().ok();
        let mut next_ns = monotonic_ns() + tick_ns;
        let mut jitter_ns = next_ns + JITTER_EVERY_NS;
        let mut heard = 0;
        while !self.shared.stopped() {
            self.bell.wait_until_ns(next_ns, heard);
            let rings = self.bell.rings();
            if rings != heard {
                heard = rings;
                self.between_ticks(fam_driver::now());
                continue;
            }
            let began_ns = monotonic_ns();
            let late_ns = began_ns.saturating_sub(next_ns);
            if late_ns > tick_ns / 2 {
                count(&self.shared.counters.late_ticks);
            }
            if let Some(jitter) = &mut jitter {
                jitter.saturating_record(late_ns.max(1));
            }
            self.tick(fam_driver::now());
            let ended_ns = monotonic_ns();
            if ended_ns.saturating_sub(began_ns) > tick_ns {
                count(&self.shared.counters.overruns);
            }
            next_ns += tick_ns;
            // Ticks that were missed in a stall are not made up for: MC time stands meanwhile, and the lag is reported.
            if next_ns < ended_ns {
                next_ns += (ended_ns - next_ns).div_ceil(tick_ns) * tick_ns;
            }
            if ended_ns >= jitter_ns {
                jitter_ns = ended_ns + JITTER_EVERY_NS;
                self.hand_over(&mut jitter);
            }
        }
        self.hand_over(&mut jitter);
    }

    fn tick(&mut self, now: Now) {
        self.take_what_came(now);
        self.core.tick(now, &mut self.host);
        self.host.frames.flush();
        self.shared.write_loads(self.core.loads(now));
    }

    fn between_ticks(&mut self, now: Now) {
        self.take_what_came(now);
        self.core.start_at_once(now, &mut self.host);
        self.host.frames.flush();
    }

    fn take_what_came(&mut self, now: Now) {
        while let Ok(command) = self.commands.try_recv() {
            self.core.command(command, now, &mut self.host);
        }
        let core = &mut self.core;
        self.mailbox
            .each(|stamped| core.image(stamped.image.clone(), stamped.at));
    }

    /// Gives the histogram out if an empty one is there to go on with.
    fn hand_over(&self, jitter: &mut Option<Jitter>) {
        if let Ok(empty) = self.jitter_back.try_recv()
            && let Some(full) = jitter.replace(empty)
        {
            let _ = self.jitter_out.try_send(full);
        }
    }
}

fn count(place: &AtomicU64) {
    place.fetch_add(1, Ordering::Relaxed);
}
