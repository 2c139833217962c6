//! A checkpoint: the serialized state of one MC after one scan.

use crate::ids::{Epoch, Scan};
use crate::mark::{Mark, hash_marked};
use serde::{Deserialize, Serialize};

/// Digest of a checkpoint: xxh3-128 over MC time and state. Guards against mix-ups and damage, not against forgery.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
pub struct Digest(pub [u8; 16]);

impl std::hash::Hash for Digest {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        let (half, _) = self.0.split_at(8);
        let half = half.try_into().map_or(0, u64::from_le_bytes);
        hash_marked(Mark::Digest, half, state);
    }
}

impl Digest {
    /// Digest of a state at an MC time.
    #[must_use]
    pub fn of(mc_time_us: u64, state: &[u8]) -> Digest {
        Digest(xxhash_rust::xxh3::xxh3_128_with_seed(state, mc_time_us).to_le_bytes())
    }
}

impl std::fmt::Debug for Digest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for byte in &self.0[..4] {
            write!(f, "{byte:02x}")?;
        }
        Ok(())
    }
}

/// Hash of a state's layout (names, types, offsets): checkpoints of other layouts do not fit.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct LayoutHash(pub u64);

/// Names one checkpoint of an MC. Scans of two epochs may share a number: the one that was applied counts.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, Serialize, Deserialize,
)]
pub struct CheckpointId {
    /// Epoch of the frame that carried it.
    pub epoch: Epoch,
    /// Scan after which it was taken.
    pub scan: Scan,
    /// Digest of MC time and state.
    pub digest: Digest,
}

/// In what phase of its life the MC was when the checkpoint was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Phase {
    /// Normal logic.
    Running,
    /// A recovery action is under way; the number is `recoveryAction`.
    Recovering(u16),
    /// A stop POU or a safe-stop action is under way.
    Stopping(u16),
    /// Stopped safely: logic runs no more, outputs stand as in this frame.
    Stopped,
}

/// A checkpoint with its bytes.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Which one.
    pub id: CheckpointId,
    /// Layout of `state`.
    pub layout: LayoutHash,
    /// MC time: one cycle a scan, over the MC's whole life, in microseconds.
    pub mc_time_us: u64,
    /// Phase of the MC.
    pub phase: Phase,
    /// Newest input image that the scan, or one before it, has seen.
    pub image: crate::ids::ImageNumber,
    /// Control variables, recovery actions' variables, then the serialized state (design, section 7).
    #[serde(with = "serde_bytes")]
    pub state: Vec<u8>,
}

impl Checkpoint {
    /// Whether the bytes are the ones that the digest was made of.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        Digest::of(self.mc_time_us, &self.state) == self.id.digest
    }
}
