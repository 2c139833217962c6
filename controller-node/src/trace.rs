//! Measuring points on the production path, for benchmarks: off unless asked for.
//!
//! One JSON object a line under [`key`], in batches; times are CLOCK_MONOTONIC nanoseconds, which processes of one machine
//! share. `late`: how late ticks began. `scanned`: the scan has ended on the node that drives the MC, with what checkpoint and frame have cost.
//! `held`: the checkpoint lies in the passive instance of another node.

use fam_proto::{CellId, CheckpointId, ControllerId, McId};
use serde::Serialize;
use std::sync::Mutex;

/// Points kept until the next batch is taken; further ones are dropped.
const POINTS_MAX: usize = 100_000;

/// Key under which a node publishes its points.
#[must_use]
pub fn key(cell: &CellId, controller: &ControllerId) -> String {
    format!("fam/{cell}/trace/{controller}")
}

/// One measuring point.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "point", rename_all = "lowercase")]
pub enum Point {
    /// A frame has been handed to the network.
    Scanned {
        /// The MC.
        mc: McId,
        /// Epoch of the scan.
        epoch: u64,
        /// The scan.
        scan: u64,
        /// When the scan had ended, before its checkpoint was copied.
        scan_end_ns: u64,
        /// When the network had taken the frame.
        sent_ns: u64,
        /// CPU time of copying the checkpoint on the scan thread.
        capture_cpu_ns: u64,
        /// CPU time of the sender thread for this frame.
        sender_cpu_ns: u64,
        /// Length of the frame, in bytes.
        bytes: usize,
        /// Whether the whole checkpoint was in it.
        full: bool,
    },
    /// A checkpoint lies in the passive instance.
    Held {
        /// The MC.
        mc: McId,
        /// Its epoch.
        epoch: u64,
        /// Its scan.
        scan: u64,
        /// When.
        at_ns: u64,
    },
    /// How late ticks were since the last such point.
    Late {
        /// Upper ends of the histogram's buckets, in nanoseconds, and how many ticks lie in each.
        buckets: Vec<(u64, u64)>,
    },
}

impl Point {
    pub(crate) fn held(mc: &McId, id: CheckpointId, at_ns: u64) -> Point {
        Point::Held {
            mc: mc.clone(),
            epoch: id.epoch.0,
            scan: id.scan.0,
            at_ns,
        }
    }
}

/// Collects points; not for the scan thread.
#[derive(Debug, Default)]
pub(crate) struct Trace {
    points: Option<Mutex<Vec<Point>>>,
}

impl Trace {
    pub(crate) fn new(on: bool) -> Trace {
        Trace {
            points: on.then(Mutex::default),
        }
    }

    pub(crate) fn is_on(&self) -> bool {
        self.points.is_some()
    }

    pub(crate) fn add(&self, point: impl FnOnce() -> Point) {
        if let Some(points) = &self.points
            && let Ok(mut points) = points.lock()
            && points.len() < POINTS_MAX
        {
            points.push(point());
        }
    }

    /// What has come since the last time, one JSON object a line; `None` if nothing has.
    pub(crate) fn take(&self) -> Option<Vec<u8>> {
        let points = std::mem::take(&mut *self.points.as_ref()?.lock().ok()?);
        if points.is_empty() {
            return None;
        }
        let mut lines = Vec::new();
        for point in points {
            if serde_json::to_writer(&mut lines, &point).is_ok() {
                lines.push(b'\n');
            }
        }
        Some(lines)
    }
}
