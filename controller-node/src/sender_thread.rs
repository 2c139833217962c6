//! The sender thread: digest, full or delta, bytes, and the put that the scan thread must never do.

use crate::cpu::{monotonic_ns, thread_ns};
use crate::shared::Shared;
use crate::trace::{Point, Trace};
use crossbeam_channel::Receiver;
use fam_driver::FrameSender;
use fam_node_core::{FrameEncoder, ScannedFrame};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Frames that wait for the sender thread; further ones are dropped and counted.
pub(crate) const FRAMES_WAITING_MAX: usize = 64;
/// One line in the log for frames that cannot be encoded in this time.
const LOG_PAUSE: Duration = Duration::from_secs(5);
/// How often the end of the process is looked for.
const LOOK: Duration = Duration::from_millis(50);

/// A frame on its way to the network.
pub(crate) struct SenderJob {
    pub frame: ScannedFrame,
    /// When the scan thread handed it over; 0 unless traced.
    pub at_ns: u64,
}

/// The thread's body; ends when the process stops and the queue is empty.
pub(crate) fn run(
    jobs: &Receiver<SenderJob>,
    sender: &FrameSender,
    shared: &Arc<Shared>,
    trace: &Arc<Trace>,
) {
    let mut encoders: Vec<FrameEncoder> =
        shared.specs.iter().map(|_| FrameEncoder::new()).collect();
    let mut said: Option<Instant> = None;
    loop {
        let job = match jobs.recv_timeout(LOOK) {
            Ok(job) => job,
            Err(_) if shared.stopped() => return,
            Err(_) => continue,
        };
        let from_ns = if trace.is_on() { thread_ns() } else { 0 };
        let frame = job.frame;
        let spec = frame.spec.clone();
        match encoders[spec.index].encode(&frame, fam_driver::now()) {
            Ok(encoded) => {
                let (full, bytes) = (encoded.full, encoded.bytes.len());
                sender.put_frame(&spec.mc, encoded.bytes);
                trace.add(|| Point::Scanned {
                    mc: spec.mc.clone(),
                    epoch: frame.epoch.0,
                    scan: frame.scan.0,
                    scan_end_ns: job.at_ns.saturating_sub(frame.capture_ns),
                    sent_ns: monotonic_ns(),
                    capture_cpu_ns: frame.capture_ns,
                    sender_cpu_ns: thread_ns().saturating_sub(from_ns),
                    bytes,
                    full,
                });
            }
            Err(error) => {
                if said.is_none_or(|at| at.elapsed() > LOG_PAUSE) {
                    said = Some(Instant::now());
                    tracing::error!(mc = %spec.mc, "frames of {} cannot be sent: {error}", spec.mc);
                }
            }
        }
    }
}
