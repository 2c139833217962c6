//! The scan thread and the replica of the one MC, reduced to what the chain of frames needs.
//!
//! The state of the MC is the digest of the state before and the number of the scan, so that a state names its whole history.
//! There are no critical intervals and no traps: diagnosis always says direct recovery.

use fam_proto::access::{Activation, McAct, McNews, Start, StateSource};
use fam_proto::{
    Checkpoint, CheckpointId, Content, Digest, Epoch, FrameHeader, InputImage, McId, Owner, Phase,
    RecordState, Scan, Successor,
};
use std::sync::Arc;

/// Length of the state: digest before, scan, filled up.
pub const STATE_LEN: usize = 24;
/// Length of the outputs.
pub const OUTPUTS_LEN: usize = 1;

/// A frame on its way. The header says all of it that matters; the digest stands for the state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frame {
    /// The header.
    pub header: FrameHeader,
    /// The whole state.
    pub state: [u8; STATE_LEN],
}

impl std::hash::Hash for Frame {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.header.hash(state);
    }
}

impl Frame {
    /// The checkpoint in it.
    #[must_use]
    pub fn checkpoint(&self) -> Checkpoint {
        Checkpoint {
            id: self.header.checkpoint_id(),
            layout: self.header.layout,
            mc_time_us: 0,
            phase: self.header.phase,
            image: self.header.image,
            state: self.state.to_vec(),
        }
    }
}

/// The digest before, as a state carries it.
#[must_use]
pub fn parent(state: &[u8]) -> Digest {
    let mut digest = [0; 16];
    if let Some(bytes) = state.get(..16) {
        digest.copy_from_slice(bytes);
    }
    Digest(digest)
}

/// Names a held checkpoint; its bytes are what its digest says.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Held(pub Arc<Checkpoint>);

impl std::hash::Hash for Held {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (self.0.id, self.0.image).hash(state);
    }
}

/// The MC while it runs here.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Active {
    /// Its epoch.
    pub epoch: Epoch,
    base: Option<CheckpointId>,
    next_scan: Scan,
    /// Digest of the state that the next scan starts from.
    from: Digest,
    /// Oldest image that it may scan on.
    image: fam_proto::ImageNumber,
    /// What was sent last.
    pub last: Option<Frame>,
    release: Option<Successor>,
}

impl Active {
    /// The last frame that it sends, once that has gone out.
    fn last_word(&self) -> Option<&Successor> {
        self.last
            .as_ref()
            .and_then(|f| f.header.released_to.as_ref())
    }
}

/// The one MC on one node.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Plc {
    /// Newest checkpoint that frames have brought.
    pub held: Option<Held>,
    /// Set while the MC runs here.
    pub active: Option<Active>,
}

impl Plc {
    /// What the MC Agent wants, and the news that come of it.
    pub fn act(&mut self, act: McAct) -> Option<McNews> {
        match act {
            McAct::ReadState { id } => {
                let held = self.held.as_ref().filter(|h| h.0.id == id);
                let checkpoint = held.map(|h| Arc::clone(&h.0));
                Some(McNews::State { id, checkpoint })
            }
            McAct::Activate(activation) => Some(self.activate(&activation)),
            McAct::Release {
                epoch, successor, ..
            } => {
                let active = self.active.as_mut().filter(|a| a.epoch == epoch)?;
                if active.last_word().is_none() {
                    active.release = Some(successor);
                }
                None
            }
            McAct::CancelRelease { epoch } => {
                let active = self.active.as_mut().filter(|a| a.epoch == epoch)?;
                // What has gone out as released is irrevocable.
                active.release.take()?;
                let why = "called off".to_owned();
                Some(McNews::ReleaseCancelled { epoch, why })
            }
            McAct::Deactivate { epoch } => {
                self.active.take_if(|a| a.epoch == epoch);
                None
            }
            McAct::RunAction { .. } | McAct::Adopt { .. } => None,
        }
    }

    fn activate(&mut self, activation: &Activation) -> McNews {
        let epoch = activation.epoch;
        let checkpoint = match &activation.start {
            Start::Initial => None,
            Start::From {
                source: StateSource::Given(checkpoint),
                ..
            } => Some(Arc::clone(checkpoint)),
            Start::From {
                source: StateSource::Held(id),
                ..
            } => match self.held.as_ref().filter(|h| h.0.id == *id) {
                Some(held) => Some(Arc::clone(&held.0)),
                None => {
                    let why = "it is held no more".to_owned();
                    return McNews::NotStarted { epoch, why };
                }
            },
        };
        self.active = Some(Active {
            epoch,
            base: activation.base,
            next_scan: activation.next_scan,
            from: checkpoint
                .as_ref()
                .map_or(Digest::default(), |c| c.id.digest),
            image: checkpoint
                .as_ref()
                .map_or_else(Default::default, |c| c.image),
            last: None,
            release: None,
        });
        McNews::Started { epoch }
    }

    /// A frame of another node.
    pub fn frame(&mut self, frame: &Frame) -> Option<CheckpointId> {
        let id = frame.header.checkpoint_id();
        let newer = |held: &Held| (id.epoch, id.scan) > (held.0.id.epoch, held.0.id.scan);
        if !self.held.as_ref().is_none_or(newer) {
            return None;
        }
        self.held = Some(Held(Arc::new(frame.checkpoint())));
        Some(id)
    }

    /// What the gateway's record means for the MC that runs here (as `fam_node_core` reads it).
    pub fn image(&mut self, image: &InputImage, mc: &McId, me: &Owner) -> Option<McNews> {
        let record = image.record_of(mc)?;
        let active = self.active.as_ref()?;
        let epoch = active.epoch;
        if record.epoch < epoch {
            return None;
        }
        let released = active.last_word().cloned();
        let acknowledged = released.as_ref().is_some_and(|to| {
            let taken = to.epoch == record.epoch && record.owner.as_ref() == Some(&to.owner);
            let recorded = record.epoch == epoch
                && record.owner.as_ref() == Some(me)
                && record.state == RecordState::Released(to.clone());
            taken || recorded
        });
        let drives = record.epoch == epoch
            && record.owner.as_ref() == Some(me)
            && matches!(record.state, RecordState::Open);
        if drives {
            return None;
        }
        let scan = active.last.as_ref().map_or(Scan(0), |f| f.header.scan);
        // What was run here last stays as the newest checkpoint.
        let last = active.last.clone();
        self.active = None;
        if let Some(last) = last {
            self.frame(&last);
        }
        Some(if acknowledged {
            McNews::Released { epoch, scan }
        } else {
            let why = format!("the record is {}", record.state.word());
            McNews::Deposed { epoch, why }
        })
    }

    /// The next scan on this image; a released MC sends its last frame again and runs no logic.
    pub fn scan(&mut self, mc: &McId, me: &Owner, image: &InputImage) -> Option<Frame> {
        let active = self.active.as_mut()?;
        if active.last_word().is_some() {
            return active.last.clone();
        }
        if image.number < active.image {
            return None;
        }
        let mut state = [0; STATE_LEN];
        state[..16].copy_from_slice(&active.from.0);
        state[16..].copy_from_slice(&active.next_scan.0.to_le_bytes());
        let frame = Frame {
            header: FrameHeader {
                mc: mc.clone(),
                owner: me.clone(),
                epoch: active.epoch,
                scan: active.next_scan,
                image: image.number,
                base: active.base,
                // MC time would make each state new; the scan in the state stands for it.
                mc_time_us: 0,
                layout: crate::cell::LAYOUT,
                digest: Digest::of(0, &state),
                phase: Phase::Running,
                released_to: active.release.take(),
                scan_us: 0,
                content: Content::Full,
                outputs_len: OUTPUTS_LEN as u32,
                state_len: STATE_LEN as u32,
            },
            state,
        };
        active.next_scan = active.next_scan.next();
        active.from = frame.header.digest;
        active.image = image.number;
        active.last = Some(frame.clone());
        Some(frame)
    }
}
