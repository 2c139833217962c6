//! What a gateway keeps on disk beside the bytes of the heads, and what its recorder tells of the frames applied.

use super::checkpoint::{CheckpointId, Digest, LayoutHash, Phase};
use super::record::{Record, RecordState};
use crate::codec::Wire;
use crate::ids::{BootId, Epoch, GatewayId, ImageNumber, McId, Owner, Scan};
use serde::{Deserialize, Serialize};

/// The part of a record that is made durable before an open is answered: who may drive, and what he starts from.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Ledger {
    /// Highest epoch ever opened; 0 before the first.
    pub epoch: Epoch,
    /// Who opened it.
    pub owner: Option<Owner>,
    /// Whether it may drive.
    pub state: RecordState,
    /// Head that the epoch started from.
    pub base: Option<CheckpointId>,
    /// Whether a frame of the epoch has been applied; known to the disk at the latest with the first frame of an MC without base.
    pub driven: bool,
    /// Fail-safe values stood at the field when this was written; the first frame of the epoch ends it.
    pub fail_safe: bool,
    /// Highest scan applied when this was written: the numbering never falls below it, also after a cold reset.
    pub last_scan: Scan,
    /// The head was lost (power failure before it reached the disk): only a cold reset brings the MC back.
    pub head_lost: bool,
}

impl Wire for Ledger {
    const KIND: u8 = 8;
    const NAME: &'static str = "gateway ledger";
}

/// A head on disk without its bytes; outputs and state lie behind it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct HeadMeta {
    /// Which checkpoint.
    pub id: CheckpointId,
    /// Layout of the state.
    pub layout: LayoutHash,
    /// MC time, in microseconds.
    pub mc_time_us: u64,
    /// Phase of the MC.
    pub phase: Phase,
    /// Input image of the scan.
    pub image: ImageNumber,
}

impl Wire for HeadMeta {
    const KIND: u8 = 9;
    const NAME: &'static str = "gateway head";
}

/// An MC as it stands at its gateway, for whoever watches its variables: nothing of it comes from the controllers' time.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Watched {
    /// The record with its head: the checkpoint behind the outputs.
    pub record: Record,
    /// The MC's newest input image.
    #[serde(with = "serde_bytes")]
    pub inputs: Vec<u8>,
    /// When the newest input image was sent, on the gateway's clock, in microseconds.
    pub at_us: u64,
}

impl Wire for Watched {
    const KIND: u8 = 11;
    const NAME: &'static str = "watched MC";
}

/// One frame that was applied to the field.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Applied {
    /// The MC.
    pub mc: McId,
    /// The frame's epoch.
    pub epoch: Epoch,
    /// The frame's owner.
    pub owner: Owner,
    /// The frame's scan.
    pub scan: Scan,
    /// Digest of its checkpoint.
    pub digest: Digest,
    /// Base that the frame named.
    pub base: Option<CheckpointId>,
    /// Phase of the MC.
    pub phase: Phase,
    /// Whether the frame released the MC to a successor.
    pub released: bool,
    /// When it was applied, on the gateway's clock, in microseconds.
    pub at_us: u64,
}

impl Applied {
    /// The checkpoint behind the outputs.
    #[must_use]
    pub fn checkpoint_id(&self) -> CheckpointId {
        CheckpointId {
            epoch: self.epoch,
            scan: self.scan,
            digest: self.digest,
        }
    }
}

/// A piece of a gateway's journal of applied frames, in the order in which they were applied.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct AppliedBatch {
    /// The gateway.
    pub gateway: GatewayId,
    /// Its life.
    pub boot: BootId,
    /// What has to be added to `at_us` to get microseconds of the machine's monotonic clock, which all processes of one machine share.
    pub monotonic_offset_us: i64,
    /// Position of the first entry in the journal, counted from 0 since the gateway's start: a hole shows that entries were lost on the way.
    pub first: u64,
    /// The entries.
    pub entries: Vec<Applied>,
}

impl Wire for AppliedBatch {
    const KIND: u8 = 10;
    const NAME: &'static str = "journal of applied frames";
}
