//! From a scanned frame to the bytes that are sent: digest, full or delta. Work of the sender thread.

use crate::active::ScannedFrame;
use crate::buffers::Buffer;
use fam_proto::codec::CodecError;
use fam_proto::{
    CheckpointId, Content, Digest, Epoch, FrameHeader, Now, Scan, delta, encode_frame,
};
use std::collections::VecDeque;
use std::sync::Arc;

/// Checkpoints kept, on both sides.
pub const RING: usize = 8;
/// After this many frames without a newer acknowledgement the whole checkpoint is sent.
pub const UNACKNOWLEDGED_MAX: u32 = 3;
/// The whole checkpoint is sent at least this often, for replicas that have come late, in microseconds.
pub const FULL_EVERY_US: u64 = 1_000_000;

/// While a state changes as a whole, so many frames at most go out whole without a delta being tried.
pub const UNTRIED_MAX: u32 = 15;

/// A frame ready to be sent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncodedFrame {
    /// The checkpoint that it carries.
    pub id: CheckpointId,
    /// Its bytes on the wire.
    pub bytes: Vec<u8>,
    /// Whether the whole checkpoint is in it.
    pub full: bool,
}

/// Makes the frames of one MC.
#[derive(Debug, Default)]
pub struct FrameEncoder {
    epoch: Option<Epoch>,
    ring: VecDeque<(CheckpointId, Arc<Buffer>)>,
    acknowledged: Option<CheckpointId>,
    since_acknowledged: u32,
    full_at: Option<Now>,
    delta: Vec<u8>,
    /// Frames for which no delta is tried, and how many that were the last time.
    untried: u32,
    untried_last: u32,
}

impl FrameEncoder {
    /// An encoder that knows no epoch yet.
    #[must_use]
    pub fn new() -> FrameEncoder {
        FrameEncoder::default()
    }

    /// Lets go of all buffers, so that their pool can use them: the epoch is over.
    pub fn clear(&mut self) {
        self.ring.clear();
        self.epoch = None;
        self.acknowledged = None;
    }

    /// Encodes a frame, or a repetition of the last one.
    ///
    /// # Errors
    /// [`CodecError::TooLarge`] for a checkpoint that does not fit into one message.
    pub fn encode(&mut self, frame: &ScannedFrame, now: Now) -> Result<EncodedFrame, CodecError> {
        if self.epoch != Some(frame.epoch) {
            self.begin(frame);
        }
        self.acknowledge(frame.acknowledged);
        let id = self.remember(frame);
        let content = self.choose(frame, now);
        let state = frame.buffer.state();
        let outputs = frame.buffer.outputs();
        let len = |bytes: &[u8]| u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        let header = FrameHeader {
            mc: frame.spec.mc.clone(),
            owner: frame.owner.clone(),
            epoch: frame.epoch,
            scan: frame.scan,
            image: frame.image,
            base: frame.base,
            mc_time_us: frame.mc_time_us,
            layout: frame.spec.layout,
            digest: id.digest,
            phase: frame.phase,
            released_to: frame.released_to.clone(),
            scan_us: frame.scan_us,
            content,
            outputs_len: len(outputs),
            state_len: len(state),
        };
        let full = content == Content::Full;
        let bytes = encode_frame(&header, outputs, if full { state } else { &self.delta })?;
        if full {
            self.full_at = Some(now);
        }
        Ok(EncodedFrame { id, bytes, full })
    }

    /// The head that an epoch starts from counts as acknowledged.
    fn begin(&mut self, frame: &ScannedFrame) {
        self.clear();
        self.epoch = Some(frame.epoch);
        self.since_acknowledged = 0;
        self.full_at = None;
        self.untried = 0;
        self.untried_last = 0;
        if let (Some(base), Some(bytes)) = (frame.base, &frame.base_bytes) {
            self.ring.push_back((base, bytes.clone()));
            self.acknowledged = Some(base);
        }
    }

    fn acknowledge(&mut self, head: Option<CheckpointId>) {
        if head.is_some() && head != self.acknowledged {
            self.acknowledged = head;
            self.since_acknowledged = 0;
        } else {
            self.since_acknowledged = self.since_acknowledged.saturating_add(1);
        }
    }

    /// Keeps the checkpoint, unless it is a repetition.
    fn remember(&mut self, frame: &ScannedFrame) -> CheckpointId {
        if let Some((id, _)) = self.ring.back()
            && (id.epoch, id.scan) == (frame.epoch, frame.scan)
        {
            return *id;
        }
        let id = CheckpointId {
            epoch: frame.epoch,
            scan: frame.scan,
            digest: Digest::of(frame.mc_time_us, frame.buffer.state()),
        };
        if self.ring.len() == RING {
            self.ring.pop_front();
        }
        self.ring.push_back((id, frame.buffer.clone()));
        id
    }

    fn choose(&mut self, frame: &ScannedFrame, now: Now) -> Content {
        let full_due = match self.full_at {
            // The replicas of an epoch's start hold its base; the first whole checkpoint may wait.
            None => {
                self.full_at = Some(now);
                false
            }
            Some(at) => now.since_us(at) >= FULL_EVERY_US,
        };
        if full_due || self.since_acknowledged > UNACKNOWLEDGED_MAX {
            return Content::Full;
        }
        let Some(base) = self.acknowledged else {
            return Content::Full;
        };
        let this: (Epoch, Scan) = (frame.epoch, frame.scan);
        let held = self
            .ring
            .iter()
            .find(|(id, _)| *id == base && (id.epoch, id.scan) != this);
        let Some((_, old)) = held else {
            return Content::Full;
        };
        if self.untried > 0 {
            self.untried -= 1;
            return Content::Full;
        }
        self.delta.clear();
        if delta::diff(old.state(), frame.buffer.state(), &mut self.delta) {
            self.untried_last = 0;
            Content::Delta(base)
        } else {
            // A compare for nothing costs as much as the digest: the longer a state changes as a whole, the more rarely.
            self.untried_last = (self.untried_last * 2 + 1).min(UNTRIED_MAX);
            self.untried = self.untried_last;
            Content::Full
        }
    }
}
