//! One MC at the gateway: its record, what is applied of it, its inputs, and its silence.

use crate::ages::ImageAges;
use crate::chain::Ring;
use crate::fence::{self, Rejection};
use crate::stored::{StoredHead, StoredRecord, never};
use fam_proto::model::{InputSource, McModel, state_room};
use fam_proto::{
    Applied, CheckpointId, FrameView, HeadMeta, ImageNumber, LayoutHash, Ledger, Now, Phase,
    RecordState, RecordSummary, Scan, Successor, TrapInfo,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// What the fence lets through: everything that follows once the head is recorded.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Accepted {
    /// The new head.
    pub head: StoredHead,
    /// Set by a planned handover.
    pub released_to: Option<Successor>,
    /// The entry of the journal.
    pub applied: Applied,
}

/// What the fence says of a frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// Record it, then apply it.
    Accept(Box<Accepted>),
    /// It is the head already.
    Repetition,
}

/// What came of a frame that was applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Committed {
    /// First of its epoch: the ledger has to say so; with a sync if the epoch had no base.
    pub first: bool,
    /// The epoch had no base.
    pub from_nothing: bool,
    /// The MC has stopped.
    pub stopped: bool,
}

/// Counters of the frames of one MC since the gateway's start.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Counters {
    /// Applied.
    pub applied: u64,
    /// Arrived again.
    pub repeated: u64,
    /// Rejected, by reason.
    pub rejected: BTreeMap<Rejection, u64>,
}

// What is only counted is no part of the state.
impl std::hash::Hash for Counters {
    fn hash<H: std::hash::Hasher>(&self, _: &mut H) {}
}

impl Counters {
    /// All rejections.
    #[must_use]
    pub fn rejected_all(&self) -> u64 {
        self.rejected.values().sum()
    }
}

/// One MC at the gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gate {
    model: Arc<McModel>,
    ledger: Ledger,
    head: Option<StoredHead>,
    /// Layout of the states of this epoch: that of the head, until a new version of the logic brings its own.
    layout: LayoutHash,
    ring: Ring,
    /// The head was released by its owner at a non-critical state, and nothing has disturbed it since.
    clean: bool,
    outputs: Arc<[u8]>,
    /// Last valid frame, opening, or start of the gateway.
    armed_at: Now,
    suspect: bool,
    writing: bool,
    ages: ImageAges,
    inputs: Vec<u8>,
    inputs_read_at: Option<Now>,
    inputs_fresh: bool,
    reads_field: bool,
    counters: Counters,
}

// The model does not change.
impl std::hash::Hash for Gate {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (&self.model.mc, &self.ledger, &self.head, &self.ring).hash(state);
        (self.clean, &self.outputs, self.armed_at).hash(state);
        (self.suspect, self.writing, &self.ages, &self.counters).hash(state);
        (&self.inputs, self.inputs_read_at, self.inputs_fresh).hash(state);
    }
}

impl Gate {
    /// The gate of an MC at the gateway's start. An epoch that was open, or released, is closed: it was interrupted.
    /// `image` is the number below the first image that will be sent.
    #[must_use]
    pub fn new(
        model: Arc<McModel>,
        stored: Option<StoredRecord>,
        image: ImageNumber,
        now: Now,
    ) -> Gate {
        let (mut ledger, head) = match stored {
            Some(stored) => (stored.ledger, stored.head),
            None => (never(), None),
        };
        // A frame that was recorded and perhaps not written to the field: the ledger says so behind the write.
        let told_driven = ledger.driven;
        if let Some(head) = &head {
            ledger.last_scan = ledger.last_scan.max(head.meta.id.scan);
            ledger.driven |= head.meta.id.epoch == ledger.epoch;
        }
        let stopped = head.as_ref().is_some_and(|head| {
            head.meta.phase == Phase::Stopped && head.meta.id.epoch == ledger.epoch
        });
        if ledger.head_lost {
            ledger.state = RecordState::Faulted(TrapInfo {
                pou: "the gateway's record".to_owned(),
                file: "record file".to_owned(),
                line: 0,
                message: format!(
                    "the last state was lost before it reached the disk (power failure?); bring the plant into its initial state and run `fam reset {} --cold`",
                    model.mc
                ),
            });
        } else if matches!(ledger.state, RecordState::Open | RecordState::Released(_)) {
            ledger.state = if stopped {
                RecordState::Stopped
            } else {
                RecordState::Closed
            };
        }
        let mut ring = Ring::default();
        if let Some(head) = &head {
            ring.keep(head.meta.id, Arc::clone(&head.state));
        }
        let holds = matches!(ledger.state, RecordState::Closed | RecordState::Stopped);
        // Without a head nobody knows what stands at the field: the fail-safe values are set.
        ledger.fail_safe = !holds || head.is_none() || (ledger.fail_safe && !told_driven);
        let outputs = match &head {
            Some(head) if !ledger.fail_safe => Arc::clone(&head.outputs),
            _ => model.fail_safe.as_slice().into(),
        };
        let reads_field = model
            .inputs
            .iter()
            .any(|input| matches!(input.source, InputSource::Field(_)));
        Gate {
            ledger,
            layout: head.as_ref().map_or(model.layout, |head| head.meta.layout),
            head,
            ring,
            clean: false,
            outputs,
            armed_at: now,
            suspect: false,
            writing: false,
            ages: ImageAges::new(image, model.watchdog_us),
            inputs: vec![0; model.inputs_len as usize],
            inputs_read_at: None,
            inputs_fresh: !reads_field,
            reads_field,
            counters: Counters::default(),
            model,
        }
    }

    /// The MC's model.
    #[must_use]
    pub fn model(&self) -> &McModel {
        &self.model
    }
    /// Epoch, owner and state.
    #[must_use]
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }
    /// Head of the chain.
    #[must_use]
    pub fn head(&self) -> Option<&StoredHead> {
        self.head.as_ref()
    }
    /// Layout of the states of this epoch.
    #[must_use]
    pub fn layout(&self) -> LayoutHash {
        self.layout
    }
    /// Whether a state of this length fits: layouts that are known have their own length, others have what room there is.
    #[must_use]
    pub fn fits(&self, layout: LayoutHash, state_len: u32) -> bool {
        let head = self.head.as_ref().filter(|h| h.meta.layout == layout);
        match head {
            Some(head) => head.state.len() == state_len as usize,
            None if layout == self.model.layout => state_len == self.model.diagnosis.checkpoint_len,
            None => state_len as usize <= state_room(self.model.diagnosis.checkpoint_len as usize),
        }
    }
    /// Name of the head.
    #[must_use]
    pub fn head_id(&self) -> Option<CheckpointId> {
        self.head.as_ref().map(|head| head.meta.id)
    }
    /// The outputs that stand at the field, and that exports are copied from.
    #[must_use]
    pub fn outputs(&self) -> &Arc<[u8]> {
        &self.outputs
    }
    /// Whether those are the fail-safe values.
    #[must_use]
    pub fn fail_safe_stands(&self) -> bool {
        self.ledger.fail_safe
    }
    /// Ages of the images sent.
    #[must_use]
    pub fn ages(&self) -> &ImageAges {
        &self.ages
    }
    /// Counters.
    #[must_use]
    pub fn counters(&self) -> &Counters {
        &self.counters
    }
    /// Whether a write of the record is under way.
    #[must_use]
    pub fn is_writing(&self) -> bool {
        self.writing
    }
    /// Marks the beginning or end of a write that other inputs have to wait for.
    pub fn set_writing(&mut self, writing: bool) {
        self.writing = writing;
    }
    /// Whether a new owner has to diagnose the head as interrupted.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        self.head.is_some() && !self.clean
    }
    /// Time since the last valid frame, the opening, or the gateway's start, in microseconds.
    #[must_use]
    pub fn silent_us(&self, now: Now) -> u64 {
        now.since_us(self.armed_at)
    }

    /// What the fence says of a frame. `fenced` is `false` only in a test build.
    ///
    /// # Errors
    /// The first check that fails.
    pub fn judge(
        &self,
        frame: &FrameView<'_>,
        fenced: bool,
        now: Now,
    ) -> Result<Verdict, Rejection> {
        let header = &frame.header;
        if fence::is_repetition(self, header) {
            return Ok(Verdict::Repetition);
        }
        if fenced {
            for check in fence::AUTHORITY {
                check(self, header, now)?;
            }
        }
        for check in fence::SHAPE {
            check(self, header, now)?;
        }
        let state = self.ring.rebuild(frame)?;
        Ok(Verdict::Accept(Box::new(Accepted {
            head: StoredHead {
                meta: HeadMeta {
                    id: header.checkpoint_id(),
                    layout: header.layout,
                    mc_time_us: header.mc_time_us,
                    phase: header.phase,
                    image: header.image,
                },
                outputs: frame.outputs.into(),
                state: Arc::new(state),
            },
            released_to: header.released_to.clone(),
            applied: Applied {
                mc: header.mc.clone(),
                epoch: header.epoch,
                owner: header.owner.clone(),
                scan: header.scan,
                digest: header.digest,
                base: header.base,
                phase: header.phase,
                released: header.released_to.is_some(),
                at_us: now.0,
            },
        })))
    }

    /// The recorded frame becomes the head of the chain.
    pub fn commit(&mut self, accepted: Accepted, now: Now) -> Committed {
        let Accepted {
            head, released_to, ..
        } = accepted;
        let first = !self.ledger.driven;
        self.ledger.driven = true;
        self.ledger.last_scan = self.ledger.last_scan.max(head.meta.id.scan);
        self.clean = released_to.is_some();
        self.ring.keep(head.meta.id, Arc::clone(&head.state));
        self.outputs = Arc::clone(&head.outputs);
        self.ledger.fail_safe = false;
        self.armed_at = now;
        self.suspect = false;
        self.counters.applied += 1;
        let stopped = head.meta.phase == Phase::Stopped;
        if head.meta.id.epoch == self.ledger.epoch && self.ledger.state == RecordState::Open {
            if stopped {
                self.ledger.state = RecordState::Stopped;
            } else if let Some(to) = released_to {
                self.ledger.state = RecordState::Released(to);
            }
        }
        self.head = Some(head);
        Committed {
            first,
            from_nothing: self.ledger.base.is_none(),
            stopped,
        }
    }

    /// The ledger of a grant is durable: the epoch begins, with states of this layout.
    pub fn grant(&mut self, ledger: Ledger, layout: LayoutHash, now: Now) {
        self.layout = layout;
        if ledger.base.is_none() {
            self.head = None;
            self.ring.clear();
            self.clean = false;
        }
        self.ledger = ledger;
        self.armed_at = now;
        self.suspect = false;
    }

    /// Closes the epoch with fail-safe values.
    pub fn fail_safe(&mut self, state: RecordState) {
        self.ledger.state = state;
        self.outputs = self.model.fail_safe.as_slice().into();
        self.ledger.fail_safe = true;
        self.clean = false;
        self.suspect = false;
    }

    /// When the fail-safe values have to be set, if nothing valid comes before.
    #[must_use]
    pub fn watchdog_at(&self) -> Option<Now> {
        matches!(
            self.ledger.state,
            RecordState::Open | RecordState::Released(_) | RecordState::Closed
        )
        .then(|| self.armed_at.plus_us(self.model.watchdog_us))
    }

    /// When the silence has to be reported.
    #[must_use]
    pub fn suspect_at(&self) -> Option<Now> {
        (self.ledger.state == RecordState::Open && !self.suspect)
            .then(|| self.armed_at.plus_us(self.model.suspect_us + 1))
    }

    /// Marks the silence as reported.
    pub fn set_suspect(&mut self) {
        self.suspect = true;
    }

    /// Counts a rejected frame.
    pub fn count_rejected(&mut self, why: Rejection) {
        *self.counters.rejected.entry(why).or_default() += 1;
    }
    /// Counts a frame that arrived again.
    pub fn count_repeated(&mut self) {
        self.counters.repeated += 1;
    }

    /// Takes what was read of the field; `fresh: false` keeps the bytes of before.
    pub fn set_inputs(&mut self, bytes: &[u8], fresh: bool, now: Now) {
        if !self.reads_field {
            return;
        }
        self.inputs_fresh = fresh && bytes.len() == self.inputs.len();
        if self.inputs_fresh {
            self.inputs.copy_from_slice(bytes);
            self.inputs_read_at = Some(now);
        }
    }
    /// The field has not answered in this cycle.
    pub fn inputs_late(&mut self) {
        self.inputs_fresh = !self.reads_field;
    }
    /// The MC's inputs as they were read, without exported variables, and whether they are fresh.
    #[must_use]
    pub fn inputs(&self) -> (&[u8], bool) {
        (&self.inputs, self.inputs_fresh)
    }
    /// Notes that an image with these inputs goes out.
    pub fn image_sent(&mut self, now: Now) {
        let read_at = if self.reads_field {
            self.inputs_read_at
        } else {
            Some(now)
        };
        self.ages.push(read_at, now);
    }

    /// The record as it stands in images.
    #[must_use]
    pub fn summary(&self, now: Now) -> RecordSummary {
        let open = self.ledger.state == RecordState::Open;
        let silent_us = if open { self.silent_us(now) } else { 0 };
        RecordSummary {
            mc: self.model.mc.clone(),
            epoch: self.ledger.epoch,
            owner: self.ledger.owner.clone(),
            state: self.ledger.state.clone(),
            head: self.head_id(),
            phase: self.head.as_ref().map(|head| head.meta.phase),
            driven: self.ledger.driven,
            silent_us,
            suspect: silent_us > self.model.suspect_us,
            rejected: self.counters.rejected_all(),
        }
    }

    /// Highest scan ever applied.
    #[must_use]
    pub fn last_scan(&self) -> Scan {
        self.ledger.last_scan
    }
}
