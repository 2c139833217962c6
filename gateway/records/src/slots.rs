//! The two slots of a ledger and of a head: where they lie, how they are written, which of them holds.
//!
//! Slot of a ledger: checksum (16), sequence (8), length (4), 0 (4), the encoded ledger.
//! Slot of a head: checksum (16), sequence (8), lengths of meta, outputs and state (4 each), 0 (4); at 256 the outputs, then the
//! state. The checksum covers everything but the state, which has its own digest in the meta data: it is not hashed twice.

use super::PAGE;
use fam_gateway_core::StoredHead;
use fam_proto::codec;
use fam_proto::{Digest, HeadMeta, Ledger};
use std::sync::Arc;

const CHECKSUM: usize = 16;
const SEQUENCE_AT: usize = 16;
const LENGTHS_AT: usize = 24;
const LEDGER_AT: usize = 32;
const META_AT: usize = 40;
const OUTPUTS_AT: usize = 256;

fn word(bytes: &[u8], at: usize) -> usize {
    bytes
        .get(at..at + 4)
        .and_then(|b| b.try_into().ok())
        .map_or(0, |b| u32::from_le_bytes(b) as usize)
}

fn sequence_of(slot: &[u8]) -> u64 {
    slot.get(SEQUENCE_AT..SEQUENCE_AT + 8)
        .and_then(|b| b.try_into().ok())
        .map_or(0, u64::from_le_bytes)
}

/// Fills in sequence and checksum; `checked` is where the checked part ends.
fn seal(slot: &mut [u8], sequence: u64, checked: usize) {
    slot[SEQUENCE_AT..SEQUENCE_AT + 8].copy_from_slice(&sequence.to_le_bytes());
    let checksum = Digest::of(sequence, &slot[SEQUENCE_AT..checked]).0;
    slot[..CHECKSUM].copy_from_slice(&checksum);
}

fn is_sealed(slot: &[u8], checked: usize) -> bool {
    let sequence = sequence_of(slot);
    sequence > 0
        && slot
            .get(SEQUENCE_AT..checked)
            .is_some_and(|part| Digest::of(sequence, part).0 == slot[..CHECKSUM])
}

fn pages(bytes: usize) -> usize {
    bytes.div_ceil(PAGE) * PAGE
}

/// Which slot holds what was written last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Newest {
    slot: usize,
    sequence: u64,
}

/// The slots of a ledger: a page each.
#[derive(Debug)]
pub(super) struct LedgerSlots {
    at: usize,
    newest: Newest,
}

impl LedgerSlots {
    pub(super) fn at(at: usize) -> LedgerSlots {
        LedgerSlots {
            at,
            newest: Newest {
                slot: 1,
                sequence: 0,
            },
        }
    }

    pub(super) fn bytes(&self) -> usize {
        2 * PAGE
    }

    /// Where the newest slot lies: offset and length.
    pub(super) fn newest_range(&self) -> (usize, usize) {
        (self.at + self.newest.slot * PAGE, PAGE)
    }

    pub(super) fn load(&mut self, map: &[u8]) -> Option<Ledger> {
        let mut found = None;
        for slot in 0..2 {
            let from = self.at + slot * PAGE;
            let bytes = &map[from..from + PAGE];
            let end = LEDGER_AT + word(bytes, LENGTHS_AT);
            if end > PAGE || !is_sealed(bytes, end) {
                continue;
            }
            let sequence = sequence_of(bytes);
            if sequence > self.newest.sequence
                && let Ok(ledger) = codec::decode(&bytes[LEDGER_AT..end])
            {
                self.newest = Newest { slot, sequence };
                found = Some(ledger);
            }
        }
        found
    }

    /// Writes into the older slot; returns what undoes it.
    pub(super) fn write(&mut self, map: &mut [u8], ledger: &Ledger) -> Result<Newest, String> {
        let bytes = codec::encode(ledger).map_err(|error| error.to_string())?;
        let end = LEDGER_AT + bytes.len();
        if end > PAGE {
            return Err(format!("a ledger of {} bytes has no room", bytes.len()));
        }
        let before = self.newest;
        self.newest = Newest {
            slot: 1 - before.slot,
            sequence: before.sequence.saturating_add(1),
        };
        let (from, len) = self.newest_range();
        let slot = &mut map[from..from + len];
        slot[LENGTHS_AT..LENGTHS_AT + 4].copy_from_slice(&(bytes.len() as u32).to_le_bytes());
        slot[LENGTHS_AT + 4..LEDGER_AT].fill(0);
        slot[LEDGER_AT..end].copy_from_slice(&bytes);
        seal(slot, self.newest.sequence, end);
        Ok(before)
    }

    /// Makes the newest slot unreadable, so that the one before holds again.
    pub(super) fn take_back(&mut self, map: &mut [u8], before: Newest) {
        let (from, _) = self.newest_range();
        map[from..from + LEDGER_AT].fill(0);
        self.newest = before;
    }
}

/// The slots of a head.
#[derive(Debug)]
pub(super) struct HeadSlots {
    at: usize,
    slot_bytes: usize,
    outputs_len: usize,
    /// Longest state that there is room for.
    room: usize,
    newest: Newest,
}

impl HeadSlots {
    pub(super) fn at(at: usize, outputs_len: usize, room: usize) -> HeadSlots {
        HeadSlots {
            at,
            slot_bytes: pages(OUTPUTS_AT + outputs_len + room),
            outputs_len,
            room,
            newest: Newest {
                slot: 1,
                sequence: 0,
            },
        }
    }

    pub(super) fn bytes(&self) -> usize {
        2 * self.slot_bytes
    }

    /// All heads that are whole.
    pub(super) fn load(&mut self, map: &[u8]) -> Vec<StoredHead> {
        let mut found = Vec::new();
        for slot in 0..2 {
            let from = self.at + slot * self.slot_bytes;
            let bytes = &map[from..from + self.slot_bytes];
            let Some(head) = self.read(bytes) else {
                continue;
            };
            let sequence = sequence_of(bytes);
            if sequence > self.newest.sequence {
                self.newest = Newest { slot, sequence };
            }
            found.push(head);
        }
        found
    }

    fn read(&self, slot: &[u8]) -> Option<StoredHead> {
        let [meta, outputs, state] = [0, 4, 8].map(|n| word(slot, LENGTHS_AT + n));
        let outputs_end = OUTPUTS_AT + outputs;
        if outputs != self.outputs_len
            || state > self.room
            || META_AT + meta > OUTPUTS_AT
            || !is_sealed(slot, outputs_end)
        {
            return None;
        }
        let meta: HeadMeta = codec::decode(&slot[META_AT..META_AT + meta]).ok()?;
        let state = &slot[outputs_end..outputs_end + state];
        if Digest::of(meta.mc_time_us, state) != meta.id.digest {
            return None;
        }
        Some(StoredHead {
            meta,
            outputs: slot[OUTPUTS_AT..outputs_end].into(),
            state: Arc::new(state.to_vec()),
        })
    }

    pub(super) fn write(&mut self, map: &mut [u8], head: &StoredHead) -> Result<(), String> {
        let meta = codec::encode(&head.meta).map_err(|error| error.to_string())?;
        if head.outputs.len() != self.outputs_len
            || head.state.len() > self.room
            || META_AT + meta.len() > OUTPUTS_AT
        {
            return Err(format!(
                "a head with {} bytes of outputs and {} of state does not fit its place",
                head.outputs.len(),
                head.state.len()
            ));
        }
        self.newest = Newest {
            slot: 1 - self.newest.slot,
            sequence: self.newest.sequence.saturating_add(1),
        };
        let from = self.at + self.newest.slot * self.slot_bytes;
        let slot = &mut map[from..from + self.slot_bytes];
        let outputs_end = OUTPUTS_AT + head.outputs.len();
        for (n, len) in [meta.len(), head.outputs.len(), head.state.len()]
            .into_iter()
            .enumerate()
        {
            let at = LENGTHS_AT + 4 * n;
            slot[at..at + 4].copy_from_slice(&(len as u32).to_le_bytes());
        }
        slot[META_AT..META_AT + meta.len()].copy_from_slice(&meta);
        slot[META_AT + meta.len()..OUTPUTS_AT].fill(0);
        slot[OUTPUTS_AT..outputs_end].copy_from_slice(&head.outputs);
        slot[outputs_end..outputs_end + head.state.len()].copy_from_slice(&head.state);
        seal(slot, self.newest.sequence, outputs_end);
        Ok(())
    }
}
