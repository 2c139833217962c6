//! The sender thread: digest, full or delta, bytes, and the put that the scan thread must never do.

use crate::cpu::{Bell, monotonic_ns, thread_ns};
use crate::shared::Shared;
use crate::trace::{Point, Trace};
use crossbeam_channel::{Receiver, Sender, TrySendError};
use fam_driver::FrameSender;
use fam_node_core::{FrameEncoder, ScannedFrame};
use fam_proto::McId;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Frames that wait for the sender thread; further ones are dropped and counted.
pub(crate) const FRAMES_WAITING_MAX: usize = 64;
/// One line in the log for frames that cannot be encoded in this time.
const LOG_PAUSE: Duration = Duration::from_secs(5);
/// How often the end of the process is looked for, in nanoseconds.
const LOOK_NS: u64 = 50_000_000;
/// The part of a tick for which a frame may wait for those of the next scans.
const HOLD_PART: u64 = 20;

/// A frame on its way to the network.
pub(crate) struct SenderJob {
    frame: ScannedFrame,
    /// When the scan thread handed it over; 0 unless traced.
    at_ns: u64,
}

/// The scan thread's side. Frames of one tick go together, so that the sender thread wakes once for them and they leave in one
/// packet; but none waits for a scan that would hold it up.
pub(crate) struct Outbox {
    jobs: Sender<SenderJob>,
    bell: Arc<Bell>,
    timed: bool,
    hold_ns: u64,
    /// When the first one that waits was scanned.
    since_ns: Option<u64>,
}

impl Outbox {
    pub(crate) fn new(
        jobs: Sender<SenderJob>,
        bell: Arc<Bell>,
        tick_us: u32,
        timed: bool,
    ) -> Outbox {
        Outbox {
            jobs,
            bell,
            timed,
            hold_ns: u64::from(tick_us) * 1_000 / HOLD_PART,
            since_ns: None,
        }
    }

    /// Takes a frame; `false` if there is no room for it.
    pub(crate) fn put(&mut self, frame: ScannedFrame) -> bool {
        let now_ns = monotonic_ns();
        self.since_ns.get_or_insert(now_ns);
        let at_ns = if self.timed { now_ns } else { 0 };
        let put = self.jobs.try_send(SenderJob { frame, at_ns });
        !matches!(put, Err(TrySendError::Full(_)))
    }

    /// A scan is about to begin that will take as long as this.
    pub(crate) fn before_a_scan_of(&mut self, scan_ns: u64) {
        if let Some(since) = self.since_ns
            && monotonic_ns().saturating_sub(since) + scan_ns > self.hold_ns
        {
            self.flush();
        }
    }

    /// What waits goes now.
    pub(crate) fn flush(&mut self) {
        if self.since_ns.take().is_some() {
            self.bell.ring();
        }
    }
}

/// What the sender thread is given.
pub(crate) struct SenderThread {
    pub jobs: Receiver<SenderJob>,
    /// Rung when frames are to go.
    pub bell: Arc<Bell>,
    pub sender: FrameSender,
    pub shared: Arc<Shared>,
    pub trace: Arc<Trace>,
}

impl SenderThread {
    /// The thread's body; ends when the process stops and the queue is empty.
    pub(crate) fn run(self) {
        let specs = &self.shared.specs;
        let mut encoders: Vec<FrameEncoder> = specs.iter().map(|_| FrameEncoder::new()).collect();
        let mut said: Option<Instant> = None;
        let mut heard = self.bell.rings();
        loop {
            let mut ready: Option<Encoded> = None;
            while let Ok(job) = self.jobs.try_recv() {
                let encoder = &mut encoders[job.frame.spec.index];
                match self.encode(encoder, job) {
                    Ok(next) => {
                        if let Some(before) = ready.replace(next) {
                            self.put(before, true);
                        }
                    }
                    Err((mc, error)) => {
                        if said.is_none_or(|at| at.elapsed() > LOG_PAUSE) {
                            said = Some(Instant::now());
                            tracing::error!(mc = %mc, "frames of {mc} cannot be sent: {error}");
                        }
                    }
                }
            }
            if let Some(last) = ready {
                self.put(last, false);
                continue;
            }
            if self.shared.stopped() {
                return;
            }
            self.bell.wait_until_ns(monotonic_ns() + LOOK_NS, heard);
            heard = self.bell.rings();
        }
    }

    fn encode(
        &self,
        encoder: &mut FrameEncoder,
        job: SenderJob,
    ) -> Result<Encoded, (McId, fam_proto::codec::CodecError)> {
        let from_ns = if self.trace.is_on() { thread_ns() } else { 0 };
        match encoder.encode(&job.frame, fam_driver::now()) {
            Ok(encoded) => Ok(Encoded {
                bytes: encoded.bytes,
                full: encoded.full,
                cpu_ns: if self.trace.is_on() {
                    thread_ns().saturating_sub(from_ns)
                } else {
                    0
                },
                job,
            }),
            Err(error) => Err((job.frame.spec.mc.clone(), error)),
        }
    }

    fn put(&self, encoded: Encoded, followed: bool) {
        let Encoded {
            job,
            bytes,
            full,
            cpu_ns,
        } = encoded;
        let from_ns = if self.trace.is_on() { thread_ns() } else { 0 };
        let (mc, len) = (&job.frame.spec.mc, bytes.len());
        self.sender.put_frame(mc, bytes, followed);
        self.trace.add(|| Point::Scanned {
            mc: mc.clone(),
            epoch: job.frame.epoch.0,
            scan: job.frame.scan.0,
            scan_end_ns: job.at_ns.saturating_sub(job.frame.capture_ns),
            sent_ns: monotonic_ns(),
            capture_cpu_ns: job.frame.capture_ns,
            sender_cpu_ns: cpu_ns + thread_ns().saturating_sub(from_ns),
            bytes: len,
            full,
        });
    }
}

/// A frame with its bytes.
struct Encoded {
    job: SenderJob,
    bytes: Vec<u8>,
    full: bool,
    /// CPU time of encoding, if traced.
    cpu_ns: u64,
}
