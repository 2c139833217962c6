//! A checkpoint told as a difference to an earlier one of the same length.
//!
//! Format: runs of `offset: u32 LE, len: u32 LE, bytes[len]`, ascending and not overlapping. Compared in blocks of
//! [`BLOCK_BYTES`], neighbouring changed blocks joined to one run: a compare costs about what a copy costs.

/// Size of the blocks that are compared, in bytes.
pub const BLOCK_BYTES: usize = 64;
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

/// Appends to `out` what turns `old` into `new`. Returns `false`, with `out` as it was, if the lengths differ or the delta
/// would be longer than `new` itself: then the full checkpoint is the better message.
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
        let mut run_end = end;
        while run_end < new.len() {
            let next = (run_end + BLOCK_BYTES).min(new.len());
            if old[run_end..next] == new[run_end..next] {
                break;
            }
            run_end = next;
        }
        if out.len() - start + RUN_HEAD_BYTES + (run_end - at) > new.len() {
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
    fn other_lengths_and_long_deltas_are_declined() {
        let mut out = Vec::new();
        assert!(!diff(&[0; 3], &[0; 4], &mut out));
        assert!(!diff(&[0; 100], &[1; 100], &mut out));
        assert!(diff(&[0; 100], &[0; 100], &mut out) && out.is_empty());
    }
}
