//! A checkpoint told as a difference to an earlier one of the same length.
//!
//! Format: runs of `offset: u32 LE, len: u32 LE, bytes[len]`, ascending and not overlapping. What has not changed is skipped in
//! blocks of [`BLOCK_BYTES`], about as fast as a copy; around a change runs begin and end at words of [`WORD_BYTES`], so that
//! single variables spread over a large state do not drag their neighbours along.

/// Size of the blocks that are compared first, in bytes.
pub const BLOCK_BYTES: usize = 64;
/// Grain of a run's beginning and end, in bytes; the last word of a checkpoint may be shorter.
pub const WORD_BYTES: usize = 8;
/// Unchanged bytes between two changes that are cheaper to send than a second run.
const GAP_BYTES: usize = 16;
const RUN_HEAD_BYTES: usize = 8;

/// Why a delta could not be applied.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum DeltaError {
    /// The runs do not read.
    #[error("the delta is damaged at byte {at}")]
    Damaged {
        /// Where in the delta.
        at: usize,
    },
    /// A run leaves the checkpoint.
    #[error("the delta changes bytes up to {end}, the checkpoint has {len}")]
    Outside {
        /// End of the run.
        end: usize,
        /// Length of the checkpoint.
        len: usize,
    },
}

/// Appends to `out` what turns `old` into `new`. Returns `false`, with `out` as it was, if the lengths differ or the delta would be
/// longer than half of `new`: then the full checkpoint is the better message, since it is neither compared nor copied twice.
pub fn diff(old: &[u8], new: &[u8], out: &mut Vec<u8>) -> bool {
    if old.len() != new.len() {
        return false;
    }
    let start = out.len();
    let mut at = 0;
    while at < new.len() {
        let end = (at + BLOCK_BYTES).min(new.len());
        if old[at..end] == new[at..end] {
            at = end;
            continue;
        }
        while word(old, at) == word(new, at) {
            at += WORD_BYTES;
        }
        let run_end = run_end(old, new, at);
        if out.len() - start + RUN_HEAD_BYTES + (run_end - at) > new.len() / 2 {
            out.truncate(start);
            return false;
        }
        #[allow(clippy::cast_possible_truncation)]
        // a checkpoint is far below 4 GiB (`MESSAGE_BYTES_MAX`)
        out.extend_from_slice(&(at as u32).to_le_bytes());
        #[allow(clippy::cast_possible_truncation)]
        out.extend_from_slice(&((run_end - at) as u32).to_le_bytes());
        out.extend_from_slice(&new[at..run_end]);
        at = run_end;
    }
    true
}

/// Where the run that begins with a changed word at `at` ends.
fn run_end(old: &[u8], new: &[u8], at: usize) -> usize {
    let (mut end, mut next) = (at, at);
    while next < new.len() && next - end < GAP_BYTES {
        let after = (next + WORD_BYTES).min(new.len());
        if word(old, next) != word(new, next) {
            end = after;
        }
        next = after;
    }
    end
}

/// The word at `at`; the last bytes of a checkpoint may be fewer.
fn word(bytes: &[u8], at: usize) -> u64 {
    match bytes.get(at..at + WORD_BYTES) {
        Some(word) => u64::from_le_bytes(word.try_into().unwrap_or_default()),
        None => bytes[at..]
            .iter()
            .rev()
            .fold(0, |word, byte| word << 8 | u64::from(*byte)),
    }
}

/// Applies a delta to `state` in place. On an error `state` is unchanged.
///
/// # Errors
/// [`DeltaError`] if the delta does not read or leaves the checkpoint.
pub fn apply(state: &mut [u8], delta: &[u8]) -> Result<(), DeltaError> {
    for_each_run(delta, state.len(), |_, _| {})?;
    for_each_run(delta, state.len(), |at, bytes| {
        state[at..at + bytes.len()].copy_from_slice(bytes)
    })
}

fn for_each_run(
    delta: &[u8],
    len: usize,
    mut each: impl FnMut(usize, &[u8]),
) -> Result<(), DeltaError> {
    let mut at = 0;
    while at < delta.len() {
        let word = |from: usize| -> Option<usize> {
            Some(u32::from_le_bytes(delta.get(from..from + 4)?.try_into().ok()?) as usize)
        };
        let (Some(offset), Some(count)) = (word(at), word(at + 4)) else {
            return Err(DeltaError::Damaged { at });
        };
        let from = at + RUN_HEAD_BYTES;
        let Some(bytes) = delta.get(from..from + count) else {
            return Err(DeltaError::Damaged { at });
        };
        if offset + count > len {
            return Err(DeltaError::Outside {
                end: offset + count,
                len,
            });
        }
        each(offset, bytes);
        at = from + count;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_delta_leads_from_old_to_new(old in prop::collection::vec(any::<u8>(), 0..700), changes in prop::collection::vec((any::<usize>(), any::<u8>()), 0..20)) {
            let mut new = old.clone();
            for (at, value) in changes {
                if !new.is_empty() {
                    let at = at % new.len();
                    new[at] = value;
                }
            }
            let mut out = vec![9];
            if diff(&old, &new, &mut out) {
                let mut state = old.clone();
                apply(&mut state, &out[1..]).unwrap();
                prop_assert_eq!(state, new);
            } else {
                prop_assert_eq!(out, vec![9]);
            }
        }

        #[test]
        fn random_bytes_change_nothing_or_apply(state in prop::collection::vec(any::<u8>(), 0..100), delta in prop::collection::vec(any::<u8>(), 0..60)) {
            let mut copy = state.clone();
            if apply(&mut copy, &delta).is_err() {
                prop_assert_eq!(copy, state);
            }
        }
    }

    #[test]
    fn single_variables_cost_their_word_and_a_head_each() {
        let old = vec![0_u8; 8_003];
        for (changed, want) in [
            (&[16][..], 16),
            (&[16, 24], 24),
            (&[16, 32], 32),
            (&[16, 40], 32),
            (&[0, 4_000, 7_992], 48),
            // the last word has three bytes
            (&[8_002], 11),
        ] {
            let mut new = old.clone();
            for at in changed {
                new[*at] = 1;
            }
            let mut out = Vec::new();
            assert!(diff(&old, &new, &mut out));
            assert_eq!(out.len(), want, "{changed:?}");
        }
    }

    #[test]
    fn other_lengths_and_long_deltas_are_declined() {
        let mut out = Vec::new();
        assert!(!diff(&[0; 3], &[0; 4], &mut out));
        assert!(!diff(&[0; 100], &[1; 100], &mut out));
        assert!(diff(&[0; 100], &[0; 100], &mut out) && out.is_empty());
    }
}
