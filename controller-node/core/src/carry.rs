//! How a new version of an MC's logic takes the state of the version of before: by copies of byte ranges, made once when the
//! version is made ready.

use crate::spec::McSpec;
use fam_proto::{Checkpoint, LayoutHash};
use std::ops::Range;

/// From the checkpoints of one version to those of the next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Carry {
    /// Layout that is carried over.
    pub from: LayoutHash,
    /// Length of its checkpoints, in bytes.
    pub from_len: usize,
    /// Ranges of the old checkpoint, and where they begin in the new one. What is in none starts from its initial value.
    pub copies: Vec<(Range<usize>, usize)>,
    /// Ranges of the new checkpoint that are zero before that: what lies behind a string that was shorter.
    pub zeros: Vec<Range<usize>>,
    /// Bits that share their bytes with others: byte and mask in the old checkpoint, byte and mask in the new one.
    pub bits: Vec<((usize, u8), (usize, u8))>,
}

impl Carry {
    /// The state of the new version.
    ///
    /// # Errors
    /// Why the old one cannot be taken, for people.
    pub fn apply(&self, to: &McSpec, checkpoint: &Checkpoint) -> Result<Vec<u8>, String> {
        if checkpoint.layout != self.from || checkpoint.state.len() != self.from_len {
            return Err(
                "the state is of another version than the one that this controller has read; reload once more"
                    .to_owned(),
            );
        }
        let mut state = to.initial.clone();
        for range in &self.zeros {
            if let Some(target) = state.get_mut(range.clone()) {
                target.fill(0);
            }
        }
        for (range, at) in &self.copies {
            let source = checkpoint.state.get(range.clone());
            let target = state.get_mut(*at..*at + range.len());
            if let (Some(source), Some(target)) = (source, target) {
                target.copy_from_slice(source);
            }
        }
        for ((from, mask), (at, to_mask)) in &self.bits {
            if let (Some(byte), Some(target)) = (checkpoint.state.get(*from), state.get_mut(*at)) {
                *target = *target & !to_mask | if byte & mask == 0 { 0 } else { *to_mask };
            }
        }
        match to.diagnosis.critical_interval(&state) {
            None => Ok(state),
            Some(interval) => Err(format!(
                "by the new version its state is in the critical interval {}; try again when it has left it",
                interval.name
            )),
        }
    }
}
