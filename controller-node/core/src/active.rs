//! An active MC: its instance and all that a scan needs. It moves as one box from the replica to the scan thread and back.

use crate::buffers::{Buffer, Pool};
use crate::record::LastWord;
use crate::runtime::McRuntime;
use crate::spec::McSpec;
use crate::workload::Workload;
use fam_proto::{CheckpointId, Epoch, ImageNumber, Now, Owner, Phase, Scan, Successor, TrapInfo};
use std::sync::Arc;

/// What a scan leaves for the sender thread.
#[derive(Debug, Clone)]
pub struct ScannedFrame {
    /// The MC.
    pub spec: Arc<McSpec>,
    /// Who drives it.
    pub owner: Owner,
    /// The epoch.
    pub epoch: Epoch,
    /// The scan.
    pub scan: Scan,
    /// The image that it used.
    pub image: ImageNumber,
    /// Head that the epoch started from, until a frame of this epoch is acknowledged.
    pub base: Option<CheckpointId>,
    /// Bytes of `base`, if the epoch started from exactly them: a delta may be told against them.
    pub base_bytes: Option<Arc<Buffer>>,
    /// MC time after the scan, in microseconds.
    pub mc_time_us: u64,
    /// Phase after the scan.
    pub phase: Phase,
    /// Marked on this very checkpoint.
    pub released_to: Option<Successor>,
    /// CPU time of the scan, in microseconds.
    pub scan_us: u32,
    /// CPU time of copying the checkpoint, in nanoseconds.
    pub capture_ns: u64,
    /// Newest checkpoint of this epoch that the gateway has acknowledged.
    pub acknowledged: Option<CheckpointId>,
    /// Checkpoint and outputs.
    pub buffer: Arc<Buffer>,
}

/// A release that waits for a non-critical state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct PendingRelease {
    pub successor: Successor,
    pub until: Now,
    pub within_us: u64,
}

/// How far an active MC has got.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mode {
    /// Scans.
    Scans,
    /// Has trapped, and waits for what its agent decides.
    Trapped,
    /// Has said its last word, and repeats it until it is acknowledged.
    Ended,
}

/// An active MC.
pub struct ActiveMc<R> {
    pub(crate) spec: Arc<McSpec>,
    pub(crate) runtime: R,
    pub(crate) pool: Pool,
    pub(crate) owner: Owner,
    pub(crate) epoch: Epoch,
    pub(crate) base: Option<CheckpointId>,
    pub(crate) base_bytes: Option<Arc<Buffer>>,
    pub(crate) next_scan: Scan,
    pub(crate) mc_time_us: u64,
    pub(crate) image: ImageNumber,
    pub(crate) phase: Phase,
    /// Checkpoint and outputs of the last good scan, or what the epoch started from.
    pub(crate) good: Arc<Buffer>,
    pub(crate) mode: Mode,
    pub(crate) release: Option<PendingRelease>,
    /// The last frame of the epoch.
    pub(crate) last: Option<ScannedFrame>,
    /// MC time, phase and image of `good`, with its scan: what the replica takes back.
    pub(crate) scanned: Option<(Scan, u64)>,
    pub(crate) acknowledged: Option<CheckpointId>,
    /// Tick at which it is due.
    pub(crate) due: u64,
    /// Its first scan does not wait for a tick.
    pub(crate) at_once: bool,
    pub(crate) work: Workload,
}

impl<R: McRuntime> ActiveMc<R> {
    /// What a node knows of it.
    #[must_use]
    pub fn spec(&self) -> &Arc<McSpec> {
        &self.spec
    }

    /// The epoch that it runs, or ran.
    #[must_use]
    pub fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// Counts since activation.
    #[must_use]
    pub fn workload(&self) -> &Workload {
        &self.work
    }

    /// Phase after the last scan.
    #[must_use]
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Its instance; for tests and tools that look into it.
    #[must_use]
    pub fn runtime(&self) -> &R {
        &self.runtime
    }

    pub(crate) fn last_word(&self) -> LastWord<'_> {
        match (self.mode, &self.last) {
            (Mode::Ended, Some(last)) => match &last.released_to {
                Some(successor) => LastWord::Released(successor),
                None => LastWord::Stopped,
            },
            _ => LastWord::None,
        }
    }

    /// Runs the logic once on this input image.
    pub(crate) fn scan(&mut self, image: ImageNumber, inputs: &[u8]) -> Result<(), TrapInfo> {
        self.runtime.inputs_mut().copy_from_slice(inputs);
        let mc_time_us = self.mc_time_us + u64::from(self.spec.cycle_us);
        self.runtime.scan(mc_time_us)?;
        self.mc_time_us = mc_time_us;
        self.image = image;
        self.phase = self.spec.phase(self.runtime.checkpoint());
        Ok(())
    }

    /// Copies checkpoint and outputs of the scan that has just run; `None` if no buffer is free.
    pub(crate) fn capture(&mut self) -> Option<Arc<Buffer>> {
        let buffer = self
            .pool
            .fill(self.runtime.checkpoint(), self.runtime.outputs())?;
        self.good = buffer.clone();
        self.scanned = Some((self.next_scan, self.mc_time_us));
        Some(buffer)
    }

    /// The frame of the scan that has just run.
    pub(crate) fn frame(
        &self,
        buffer: Arc<Buffer>,
        released_to: Option<Successor>,
        scan_us: u32,
        capture_ns: u64,
    ) -> ScannedFrame {
        ScannedFrame {
            spec: self.spec.clone(),
            owner: self.owner.clone(),
            epoch: self.epoch,
            scan: self.next_scan,
            image: self.image,
            base: if self.acknowledged.is_some() {
                None
            } else {
                self.base
            },
            base_bytes: if self.acknowledged.is_some() {
                None
            } else {
                self.base_bytes.clone()
            },
            mc_time_us: self.mc_time_us,
            phase: self.phase,
            released_to,
            scan_us,
            capture_ns,
            acknowledged: self.acknowledged,
            buffer,
        }
    }

    /// Leaves normal logic: from the last good checkpoint, run this action.
    pub(crate) fn run_action(&mut self, action: u16) {
        self.runtime.reset();
        let checkpoint = self.runtime.checkpoint_mut();
        checkpoint.copy_from_slice(self.good.state());
        self.spec.activate(checkpoint, action, false);
        self.runtime
            .outputs_mut()
            .copy_from_slice(self.good.outputs());
        self.phase = self.spec.phase_of(action);
        self.mode = Mode::Scans;
        self.release = None;
    }

    /// The critical interval that forbids a release now.
    pub(crate) fn critical_interval(&self) -> Option<&str> {
        let interval = self.spec.diagnosis.critical_interval(self.good.state());
        interval.map(|i| i.name.as_str())
    }
}
