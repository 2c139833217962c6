//! The last checkpoints of an MC, so that a delta against one of them can be rebuilt.

use crate::fence::Rejection;
use fam_proto::{CheckpointId, Content, Digest, FrameView, delta};
use std::collections::VecDeque;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// How many checkpoints are kept for deltas.
pub const RING_LEN: usize = 8;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Held {
    id: CheckpointId,
    state: Arc<Vec<u8>>,
}

/// The last checkpoints applied.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Ring(VecDeque<Held>);

// The newest stands for those before it; how many there are decides only whether a delta has to be sent in full.
impl Hash for Ring {
    fn hash<H: Hasher>(&self, to: &mut H) {
        self.0.back().map(|held| held.id).hash(to);
    }
}

impl Ring {
    /// Keeps a checkpoint; the oldest of more than [`RING_LEN`] goes.
    pub fn keep(&mut self, id: CheckpointId, state: Arc<Vec<u8>>) {
        if self.0.len() == RING_LEN {
            self.0.pop_front();
        }
        self.0.push_back(Held { id, state });
    }

    /// Forgets all (cold reset: nothing builds on what was before).
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// The state that a frame carries, checked against its digest.
    ///
    /// # Errors
    /// [`Rejection::BaseNotHeld`], [`Rejection::DeltaDamaged`], [`Rejection::WrongDigest`].
    pub fn rebuild(&self, frame: &FrameView<'_>) -> Result<Vec<u8>, Rejection> {
        let header = &frame.header;
        let state = match header.content {
            Content::Full => frame.content.to_vec(),
            Content::Delta(base) => {
                let held = self
                    .0
                    .iter()
                    .rev()
                    .find(|held| held.id == base)
                    .ok_or(Rejection::BaseNotHeld)?;
                let mut state = held.state.as_ref().clone();
                delta::apply(&mut state, frame.content).map_err(|_| Rejection::DeltaDamaged)?;
                state
            }
        };
        if state.len() != header.state_len as usize {
            return Err(Rejection::StateLength);
        }
        if Digest::of(header.mc_time_us, &state) != header.digest {
            return Err(Rejection::WrongDigest);
        }
        Ok(state)
    }
}
