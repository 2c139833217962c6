//! The record that a gateway keeps for each MC: the head of the MC's chain of frames (design, section 4).

use super::checkpoint::{Checkpoint, CheckpointId, Phase};
use super::frame::Successor;
use crate::codec::Wire;
use crate::ids::{Epoch, McId, Owner, Scan};
use serde::{Deserialize, Serialize};

/// Where a trap happened.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct TrapInfo {
    /// Program organization unit.
    pub pou: String,
    /// Source file.
    pub file: String,
    /// Line in the source file, 1-based; 0 if unknown.
    pub line: u32,
    /// What went wrong.
    pub message: String,
}

impl std::fmt::Display for TrapInfo {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} in {}, {} line {}",
            self.message, self.pou, self.file, self.line
        )
    }
}

/// Whether the epoch of a record may drive outputs.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum RecordState {
    /// No epoch was ever opened.
    Never,
    /// The owner drives.
    Open,
    /// The owner released the MC to its successor; nobody drives until that one opens.
    Released(Successor),
    /// Closed without fail-safe: the gateway was restarted, or the owner gave up before its first frame.
    Closed,
    /// No valid frame came in time: fail-safe values are set, latched until a new activation.
    FailSafe,
    /// Stopped safely by its stop POU or a safe-stop action; opens again only with a reset.
    Stopped,
    /// The logic trapped and fail-safe values are set; opens again only with a reset.
    Faulted(TrapInfo),
}

impl RecordState {
    /// One word for people.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            RecordState::Never => "never",
            RecordState::Open => "open",
            RecordState::Released(_) => "released",
            RecordState::Closed => "closed",
            RecordState::FailSafe => "fail-safe",
            RecordState::Stopped => "stopped",
            RecordState::Faulted(_) => "faulted",
        }
    }
    /// Whether only a reset ends this state.
    #[must_use]
    pub fn needs_reset(&self) -> bool {
        matches!(self, RecordState::Stopped | RecordState::Faulted(_))
    }
}

/// What the plant has seen last of an MC: outputs and the checkpoint that produced them.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Head {
    /// The checkpoint behind the outputs.
    pub checkpoint: Checkpoint,
    /// The outputs applied.
    #[serde(with = "serde_bytes")]
    pub outputs: Vec<u8>,
}

/// The record of one MC, as the gateway keeps it on disk and answers an open with it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Record {
    /// The MC.
    pub mc: McId,
    /// Highest epoch ever opened; 0 before the first.
    pub epoch: Epoch,
    /// Who opened it.
    pub owner: Option<Owner>,
    /// Whether it may drive.
    pub state: RecordState,
    /// The last frame applied; `None` before the first, and after a cold reset until the first frame.
    pub head: Option<Head>,
}

impl Wire for Record {
    const KIND: u8 = 3;
    const NAME: &'static str = "gateway record";
}

/// A record without its bytes, as it stands in every input image.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct RecordSummary {
    /// The MC.
    pub mc: McId,
    /// Highest epoch ever opened.
    pub epoch: Epoch,
    /// Who opened it.
    pub owner: Option<Owner>,
    /// Whether it may drive.
    pub state: RecordState,
    /// The head of the chain: last checkpoint applied. Acknowledges it to its sender.
    pub head: Option<CheckpointId>,
    /// Phase of the head.
    pub phase: Option<Phase>,
    /// Whether the open epoch has had a frame applied yet.
    pub driven: bool,
    /// Time since the last valid frame (or the opening), by the gateway's clock, in microseconds; 0 unless open.
    pub silent_us: u64,
    /// Set when `silent_us` exceeds the MC's suspect time: the silence report.
    pub suspect: bool,
    /// Frames rejected by the fence since the gateway's start.
    pub rejected: u64,
}

impl RecordSummary {
    /// Scan of the head; 0 before the first.
    #[must_use]
    pub fn scan(&self) -> Scan {
        self.head.map_or(Scan(0), |h| h.scan)
    }
    /// Whether `owner` may drive under `epoch`.
    #[must_use]
    pub fn drives(&self, owner: &Owner, epoch: Epoch) -> bool {
        self.state == RecordState::Open && self.epoch == epoch && self.owner.as_ref() == Some(owner)
    }
}
