//! What reaches the record file, how a head is chosen at a restart, and records in memory for simulation and tests.
//!
//! A record is written in two parts: the small *ledger* (epoch, owner, state; synced before an open is answered) and the
//! *head* (checkpoint and outputs of each applied frame; into the mapped file without a sync, so that a kill of the
//! gateway loses nothing). Each part has two slots, so that a torn write falls back to the one before.

use fam_proto::{Checkpoint, Epoch, HeadMeta, Ledger, McId, RecordState, Scan};
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// The head of a chain with its bytes, shared rather than copied.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StoredHead {
    /// Which checkpoint, and what goes with it.
    pub meta: HeadMeta,
    /// The outputs applied.
    pub outputs: Arc<[u8]>,
    /// The checkpoint's bytes.
    pub state: Arc<Vec<u8>>,
}

// The digest in the id stands for the bytes of the state.
impl Hash for StoredHead {
    fn hash<H: Hasher>(&self, to: &mut H) {
        self.meta.hash(to);
        self.outputs.hash(to);
    }
}

impl StoredHead {
    /// The checkpoint as it is sent to an MC Agent that does not hold it.
    #[must_use]
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint {
            id: self.meta.id,
            layout: self.meta.layout,
            mc_time_us: self.meta.mc_time_us,
            phase: self.meta.phase,
            image: self.meta.image,
            state: self.state.as_ref().clone(),
        }
    }
}

/// What the gateway wants written.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum RecordWrite {
    /// A frame is about to be applied: its checkpoint and outputs. Has to survive a kill of the process; no sync.
    Head {
        /// The MC.
        mc: McId,
        /// The new head.
        head: StoredHead,
    },
    /// An epoch is about to be granted. Has to survive a power failure before it is answered. If that fails, the ledger on disk has to
    /// be the one of before: the owner of before goes on, and his heads belong to his ledger.
    Opened {
        /// The MC.
        mc: McId,
        /// The ledger with the new epoch and owner.
        ledger: Ledger,
    },
    /// The state of the record has changed. It is in force whether or not the sync succeeds, and has to survive a kill in any case.
    Changed {
        /// The MC.
        mc: McId,
        /// The ledger as it is now.
        ledger: Ledger,
        /// Whether it has to survive a power failure.
        sync: bool,
    },
}

impl RecordWrite {
    /// The MC whose record is written.
    #[must_use]
    pub fn mc(&self) -> &McId {
        match self {
            RecordWrite::Head { mc, .. }
            | RecordWrite::Opened { mc, .. }
            | RecordWrite::Changed { mc, .. } => mc,
        }
    }
    /// Whether it has to survive a power failure.
    #[must_use]
    pub fn is_synced(&self) -> bool {
        match self {
            RecordWrite::Head { .. } => false,
            RecordWrite::Opened { .. } => true,
            RecordWrite::Changed { sync, .. } => *sync,
        }
    }
}

/// A record as the gateway gets it back at its start.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct StoredRecord {
    /// The MC.
    pub mc: McId,
    /// Its ledger.
    pub ledger: Ledger,
    /// Its head.
    pub head: Option<StoredHead>,
}

/// The ledger of an MC that was never opened.
#[must_use]
pub fn never() -> Ledger {
    Ledger {
        epoch: Epoch(0),
        owner: None,
        state: RecordState::Never,
        base: None,
        driven: false,
        fail_safe: true,
        last_scan: Scan(0),
        head_lost: false,
    }
}

impl StoredRecord {
    /// Chooses the head among what the slots hold (whole ones only, any order): the highest scan of the ledger's epoch,
    /// else the head that the epoch started from. Where the ledger knows of a head and none is there, it is lost.
    #[must_use]
    pub fn choose(mc: McId, mut ledger: Ledger, mut slots: Vec<StoredHead>) -> StoredRecord {
        slots.sort_by_key(|head| head.meta.id.scan);
        let head = slots
            .iter()
            .rev()
            .find(|head| head.meta.id.epoch == ledger.epoch && ledger.epoch > Epoch(0))
            .or_else(|| slots.iter().find(|head| Some(head.meta.id) == ledger.base))
            .cloned();
        if head.is_none() && (ledger.base.is_some() || ledger.driven) {
            ledger.head_lost = true;
        }
        StoredRecord { mc, ledger, head }
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct MemoryRecord {
    ledger: Ledger,
    durable: Ledger,
    /// Newest last, at most two, as in the file.
    heads: Vec<StoredHead>,
}

/// Records in memory, with the failures of a disk: for simulation and tests.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct MemoryRecords(BTreeMap<McId, MemoryRecord>);

impl MemoryRecords {
    /// Carries out a write.
    pub fn write(&mut self, write: RecordWrite) {
        let record = self
            .0
            .entry(write.mc().clone())
            .or_insert_with(|| MemoryRecord {
                ledger: never(),
                durable: never(),
                heads: Vec::new(),
            });
        let sync = write.is_synced();
        match write {
            RecordWrite::Head { head, .. } => {
                if record.heads.len() == 2 {
                    record.heads.remove(0);
                }
                record.heads.push(head);
            }
            RecordWrite::Opened { ledger, .. } | RecordWrite::Changed { ledger, .. } => {
                record.ledger = ledger;
                if sync {
                    record.durable = record.ledger.clone();
                }
            }
        }
    }

    /// What a gateway finds that was killed and started again.
    #[must_use]
    pub fn after_kill(&self) -> Vec<StoredRecord> {
        self.0
            .iter()
            .map(|(mc, r)| StoredRecord::choose(mc.clone(), r.ledger.clone(), r.heads.clone()))
            .collect()
    }

    /// The machine lost its power: what was not synced is gone, both heads torn.
    pub fn lose_power(&mut self) {
        for record in self.0.values_mut() {
            record.ledger = record.durable.clone();
            record.heads.clear();
        }
    }

    /// The kill came in the middle of the write of a head: the slot that was being written is torn.
    pub fn tear_head(&mut self, mc: &McId) {
        if let Some(record) = self.0.get_mut(mc) {
            record.heads.pop();
        }
    }
}
