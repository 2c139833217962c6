//! The passive side of an MC: the newest checkpoints that frames have brought, and its instance ready to run the next scan.
//!
//! There is one instance of each MC on a node. It is here while the MC is passive, and in the [`ActiveMc`] while it is active.

use crate::active::{ActiveMc, Mode};
use crate::buffers::{Buffer, Pool};
use crate::carry::Carry;
use crate::runtime::McRuntime;
use crate::sender::RING;
use crate::spec::McSpec;
use crate::workload::Workload;
use fam_proto::access::{Activation, McAct, McNews, Start, StateSource};
use fam_proto::codec::CodecError;
use fam_proto::delta::{self, DeltaError};
use fam_proto::{
    Checkpoint, CheckpointId, Content, Digest, FrameView, ImageNumber, LayoutHash, Owner, Phase,
    Scan, Successor, decode_frame,
};
use std::collections::VecDeque;
use std::sync::Arc;

/// Why a frame was not kept.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum FrameRefusal {
    /// It does not read.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// It is another MC's, or of another layout.
    #[error("a checkpoint of another layout; generate all projects from one model")]
    Layout(LayoutHash),
    /// A newer one is held.
    #[error("a newer checkpoint is held")]
    Late,
    /// The checkpoint that its delta is told against is not held.
    #[error("the checkpoint of scan {0} that its delta is told against is not held")]
    NoBase(Scan),
    /// Its delta does not read.
    #[error(transparent)]
    Delta(#[from] DeltaError),
    /// The rebuilt checkpoint is not the one that was sent.
    #[error("the rebuilt checkpoint has another digest")]
    Digest,
}

/// What a frame has brought.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameSeen {
    /// The checkpoint that is held now, or why this one is not.
    pub held: Result<CheckpointId, FrameRefusal>,
    /// The frame releases the MC.
    pub released_to: Option<Successor>,
}

/// What comes of an act.
pub enum ReplicaOutcome<R> {
    /// Nothing for now.
    Nothing,
    /// For the MC's agent.
    News(McNews),
    /// For the scan thread.
    Activate(Box<ActiveMc<R>>),
    /// Not the replica's: for the scan thread.
    PassOn(McAct),
}

/// The instance while it is here.
struct Passive<R> {
    runtime: R,
    pool: Pool,
    /// The checkpoint that lies in it.
    loaded: Option<CheckpointId>,
}

/// A new version of the MC's logic, ready beside the one that runs.
pub struct StagedVersion<R> {
    /// Hash of logic, layout and masks.
    pub version: u64,
    /// What the node has to know of it.
    pub spec: Arc<McSpec>,
    /// An instance with its initial values.
    pub runtime: R,
    /// How it takes the state of the version of before.
    pub carry: Carry,
}

/// The passive side of one MC.
pub struct Replica<R> {
    spec: Arc<McSpec>,
    owner: Owner,
    passive: Option<Passive<R>>,
    /// Oldest first.
    ring: VecDeque<Checkpoint>,
    /// Where the next checkpoint is rebuilt: memory of the oldest one, once the ring is full.
    scratch: Vec<u8>,
    /// An activation that came before the instance was back.
    waiting: Option<Box<Activation>>,
    /// A version that is ready beside this one.
    staged: Option<Box<StagedVersion<R>>>,
    /// The staged version is to be held as soon as the instance is back.
    adopts: Option<u64>,
    /// Frames that were not kept, since start.
    refused: u64,
}

impl<R: McRuntime> Replica<R> {
    /// The replica of an MC that has not been seen yet; `runtime` holds its initial values.
    #[must_use]
    pub fn new(spec: Arc<McSpec>, owner: Owner, runtime: R) -> Replica<R> {
        let pool = Pool::new(spec.initial.len(), spec.outputs_len);
        Replica {
            spec,
            owner,
            passive: Some(Passive {
                runtime,
                pool,
                loaded: None,
            }),
            ring: VecDeque::with_capacity(RING),
            scratch: Vec::new(),
            waiting: None,
            staged: None,
            adopts: None,
            refused: 0,
        }
    }

    /// A version is ready beside the one that runs; it takes the place of one that was before.
    pub fn stage(&mut self, version: Box<StagedVersion<R>>) {
        self.staged = Some(version);
        self.adopts = None;
    }

    /// Another controller runs the staged version: its checkpoints are held from now on.
    fn adopt(&mut self, version: u64) {
        if self.staged.as_ref().is_none_or(|s| s.version != version) {
            return;
        }
        self.adopts = Some(version);
        if self.passive.take().is_some() {
            self.adopt_now();
        }
    }

    /// The staged version takes the place of the passive instance, if that is wanted.
    fn adopt_now(&mut self) -> bool {
        let Some(staged) = self.staged.take_if(|s| Some(s.version) == self.adopts) else {
            return false;
        };
        self.adopts = None;
        let staged = *staged;
        if staged.spec.layout != self.spec.layout {
            self.ring.clear();
            self.scratch = Vec::new();
        }
        let mut passive = Passive {
            pool: Pool::new(staged.spec.initial.len(), staged.spec.outputs_len),
            runtime: staged.runtime,
            loaded: None,
        };
        self.spec = staged.spec;
        if let Some(newest) = self.ring.back() {
            passive.load(newest);
        }
        self.passive = Some(passive);
        true
    }

    /// Whether frames of this layout are those of a version that is ready here.
    #[must_use]
    pub fn awaits(&self, layout: LayoutHash) -> bool {
        self.staged
            .as_ref()
            .is_some_and(|s| s.spec.layout == layout)
    }

    /// What the node knows of the MC.
    #[must_use]
    pub fn spec(&self) -> &Arc<McSpec> {
        &self.spec
    }

    /// Newest checkpoint.
    #[must_use]
    pub fn held(&self) -> Option<CheckpointId> {
        self.ring.back().map(|c| c.id)
    }

    /// Frames that were not kept, since start; late ones are not counted.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// The instance, while it is passive.
    #[must_use]
    pub fn runtime(&self) -> Option<&R> {
        self.passive.as_ref().map(|p| &p.runtime)
    }

    /// A frame of the MC, from whoever drives it. `None`: it is this node's own, and nothing new.
    pub fn frame(&mut self, bytes: &[u8]) -> Option<FrameSeen> {
        let view = match decode_frame(bytes) {
            Ok(view) => view,
            Err(error) => {
                self.refused += 1;
                return Some(FrameSeen {
                    held: Err(error.into()),
                    released_to: None,
                });
            }
        };
        if view.header.mc == self.spec.mc && view.header.owner == self.owner {
            return None;
        }
        let held = self.take(&view);
        if let Err(refusal) = &held
            && *refusal != FrameRefusal::Late
        {
            self.refused += 1;
        }
        Some(FrameSeen {
            held,
            released_to: view.header.released_to,
        })
    }

    fn take(&mut self, view: &FrameView<'_>) -> Result<CheckpointId, FrameRefusal> {
        let header = &view.header;
        let len = self.spec.initial.len();
        if header.mc != self.spec.mc
            || header.layout != self.spec.layout
            || header.state_len as usize != len
        {
            return Err(FrameRefusal::Layout(header.layout));
        }
        let id = header.checkpoint_id();
        if self
            .held()
            .is_some_and(|held| (id.epoch, id.scan) <= (held.epoch, held.scan))
        {
            return Err(FrameRefusal::Late);
        }
        self.scratch.clear();
        match header.content {
            Content::Full => self.scratch.extend_from_slice(view.content),
            Content::Delta(base) => {
                let old = self.ring.iter().find(|c| c.id == base);
                let old = old.ok_or(FrameRefusal::NoBase(base.scan))?;
                self.scratch.extend_from_slice(&old.state);
                delta::apply(&mut self.scratch, view.content)?;
            }
        }
        if Digest::of(header.mc_time_us, &self.scratch) != id.digest {
            return Err(FrameRefusal::Digest);
        }
        self.keep(id, header.mc_time_us, header.phase, header.image);
        Ok(id)
    }

    /// The scratch memory holds a checkpoint that is to be kept.
    fn keep(&mut self, id: CheckpointId, mc_time_us: u64, phase: Phase, image: ImageNumber) {
        let checkpoint = Checkpoint {
            id,
            layout: self.spec.layout,
            mc_time_us,
            phase,
            image,
            state: std::mem::take(&mut self.scratch),
        };
        if let Some(passive) = &mut self.passive {
            passive.load(&checkpoint);
        }
        if self.ring.len() == RING
            && let Some(oldest) = self.ring.pop_front()
        {
            self.scratch = oldest.state;
        }
        self.ring.push_back(checkpoint);
    }

    /// What the MC's agent wants.
    pub fn act(&mut self, act: McAct) -> ReplicaOutcome<R> {
        match act {
            McAct::ReadState { id } => {
                let held = self.ring.iter().find(|c| c.id == id);
                let checkpoint = held.map(|c| Arc::new(c.clone()));
                ReplicaOutcome::News(McNews::State { id, checkpoint })
            }
            McAct::Activate(activation) => self.activate(activation),
            McAct::Adopt { version } => {
                self.adopt(version);
                ReplicaOutcome::Nothing
            }
            McAct::Deactivate { epoch } => {
                if self.waiting.as_ref().is_some_and(|w| w.epoch == epoch) {
                    self.waiting = None;
                }
                ReplicaOutcome::PassOn(McAct::Deactivate { epoch })
            }
            act @ (McAct::Release { .. }
            | McAct::CancelRelease { .. }
            | McAct::RunAction { .. }) => ReplicaOutcome::PassOn(act),
        }
    }

    /// The scan thread gives the instance back, boxed as it came over its queue.
    #[allow(clippy::boxed_local)]
    pub fn returned(&mut self, active: Box<ActiveMc<R>>) -> ReplicaOutcome<R> {
        let ActiveMc {
            mut runtime,
            pool,
            good,
            scanned,
            phase,
            image,
            epoch,
            ..
        } = *active;
        runtime.reset();
        self.passive = Some(Passive {
            runtime,
            pool,
            loaded: None,
        });
        // What was run here last is the base of the successor's first delta.
        if let Some((scan, mc_time_us)) = scanned {
            let id = CheckpointId {
                epoch,
                scan,
                digest: Digest::of(mc_time_us, good.state()),
            };
            let newer = self
                .held()
                .is_none_or(|held| (id.epoch, id.scan) > (held.epoch, held.scan));
            if newer {
                self.scratch.clear();
                self.scratch.extend_from_slice(good.state());
                self.keep(id, mc_time_us, phase, image);
            }
        }
        if let (Some(passive), Some(newest)) = (&mut self.passive, self.ring.back())
            && passive.loaded != Some(newest.id)
        {
            passive.load(newest);
        }
        if self.adopts.is_some() {
            self.adopt_now();
        }
        match self.waiting.take() {
            Some(activation) => self.activate(activation),
            None => ReplicaOutcome::Nothing,
        }
    }

    /// Runs the staged version, from the state that the version of before has released.
    fn renew(&mut self, activation: Activation, version: u64) -> ReplicaOutcome<R> {
        let epoch = activation.epoch;
        match self.renewed(activation, version) {
            Ok(active) => ReplicaOutcome::Activate(active),
            Err(why) => ReplicaOutcome::News(McNews::NotStarted { epoch, why }),
        }
    }

    fn renewed(
        &mut self,
        mut activation: Activation,
        version: u64,
    ) -> Result<Box<ActiveMc<R>>, String> {
        let staged = self.staged.as_ref().filter(|s| s.version == version);
        let Some(staged) = staged else {
            return Err("this version is not ready here".to_owned());
        };
        let carried = match &activation.start {
            Start::Initial => None,
            Start::From {
                source: StateSource::Given(old),
                ..
            } => {
                let state = staged.carry.apply(&staged.spec, old)?;
                Some(Checkpoint {
                    layout: staged.spec.layout,
                    state,
                    ..(**old).clone()
                })
            }
            Start::From { .. } => return Err("the state was not given along".to_owned()),
        };
        let before = (self.spec.clone(), self.passive.take());
        self.adopts = Some(version);
        self.adopt_now();
        if let Some(carried) = carried {
            activation.start = Start::From {
                source: StateSource::Given(Arc::new(carried)),
                retained_only: false,
            };
        }
        let Some(mut passive) = self.passive.take() else {
            (self.spec, self.passive) = before;
            return Err("the instance is not here".to_owned());
        };
        passive.loaded = None;
        match self.prepare(passive, activation) {
            Ok(mut active) => {
                // What was carried over was never applied: no delta may be told against it.
                active.base_bytes = None;
                Ok(active)
            }
            Err((_, why)) => {
                (self.spec, self.passive) = before;
                Err(why)
            }
        }
    }

    fn activate(&mut self, activation: Box<Activation>) -> ReplicaOutcome<R> {
        if let (Some(version), true) = (activation.renew, self.passive.is_some()) {
            return self.renew(*activation, version);
        }
        let Some(passive) = self.passive.take() else {
            self.waiting = Some(activation);
            return ReplicaOutcome::Nothing;
        };
        let epoch = activation.epoch;
        match self.prepare(passive, *activation) {
            Ok(active) => ReplicaOutcome::Activate(active),
            Err((passive, why)) => {
                self.passive = Some(passive);
                ReplicaOutcome::News(McNews::NotStarted { epoch, why })
            }
        }
    }

    #[allow(clippy::result_large_err)] // the instance has to come back
    fn prepare(
        &self,
        mut passive: Passive<R>,
        activation: Activation,
    ) -> Result<Box<ActiveMc<R>>, (Passive<R>, String)> {
        let spec = &self.spec;
        let begin = match self.begin(&activation.start) {
            Ok(begin) => begin,
            Err(why) => return Err((passive, why)),
        };
        if activation.outputs.len() != spec.outputs_len {
            let why = format!(
                "the gateway's output image has {} bytes, {} here has {}; generate all projects from one model",
                activation.outputs.len(),
                spec.mc,
                spec.outputs_len
            );
            return Err((passive, why));
        }
        let mut merged = Vec::new();
        let state: &[u8] = match &begin {
            Begin::Initial => &spec.initial,
            Begin::From(checkpoint) => &checkpoint.state,
            Begin::Retained(checkpoint) => {
                merged.extend_from_slice(&spec.initial);
                for range in &spec.retained {
                    merged[range.clone()].copy_from_slice(&checkpoint.state[range.clone()]);
                }
                &merged
            }
        };
        let Some(good) = passive.pool.fill(state, &activation.outputs) else {
            return Err((
                passive,
                "all its buffers are still on their way to the gateway".to_owned(),
            ));
        };
        let whole = match &begin {
            Begin::From(checkpoint) => Some(checkpoint.id),
            _ => None,
        };
        if whole.is_none() || passive.loaded != whole {
            passive.runtime.checkpoint_mut().copy_from_slice(state);
        }
        spec.activate(
            passive.runtime.checkpoint_mut(),
            activation.recovery,
            activation.keep_action,
        );
        passive
            .runtime
            .outputs_mut()
            .copy_from_slice(&activation.outputs);
        let (mc_time_us, image) = begin.clocks();
        let base_bytes: Option<Arc<Buffer>> =
            (whole.is_some() && whole == activation.base).then(|| good.clone());
        Ok(Box::new(ActiveMc {
            spec: spec.clone(),
            runtime: passive.runtime,
            pool: passive.pool,
            owner: self.owner.clone(),
            epoch: activation.epoch,
            base: activation.base,
            base_bytes,
            next_scan: activation.next_scan,
            mc_time_us,
            image,
            phase: if activation.recovery == 0 {
                Phase::Running
            } else {
                spec.phase_of(activation.recovery)
            },
            good,
            mode: Mode::Scans,
            release: None,
            last: None,
            scanned: None,
            acknowledged: None,
            due: 0,
            at_once: activation.at_once,
            work: Workload::default(),
        }))
    }

    fn begin<'a>(&'a self, start: &'a Start) -> Result<Begin<'a>, String> {
        let Start::From {
            source,
            retained_only,
        } = start
        else {
            return Ok(Begin::Initial);
        };
        let checkpoint = match source {
            StateSource::Given(checkpoint) => checkpoint.as_ref(),
            StateSource::Held(id) => {
                let held = self.ring.iter().find(|c| c.id == *id);
                held.ok_or_else(|| format!("the checkpoint of scan {} is held no more", id.scan))?
            }
        };
        let fits =
            |layout: LayoutHash, len| layout == self.spec.layout && len == self.spec.initial.len();
        if !fits(checkpoint.layout, checkpoint.state.len()) {
            return Err(
                "the checkpoint has another layout; generate all projects from one model"
                    .to_owned(),
            );
        }
        Ok(if *retained_only {
            Begin::Retained(checkpoint)
        } else {
            Begin::From(checkpoint)
        })
    }
}

/// What the variables of an epoch start from.
enum Begin<'a> {
    Initial,
    From(&'a Checkpoint),
    Retained(&'a Checkpoint),
}

impl Begin<'_> {
    /// MC time goes on wherever the MC has one; images must not be older than the checkpoint's.
    fn clocks(&self) -> (u64, ImageNumber) {
        match self {
            Begin::Initial => (0, ImageNumber(0)),
            Begin::From(c) | Begin::Retained(c) => (c.mc_time_us, c.image),
        }
    }
}

impl<R: McRuntime> Passive<R> {
    fn load(&mut self, checkpoint: &Checkpoint) {
        self.runtime
            .checkpoint_mut()
            .copy_from_slice(&checkpoint.state);
        self.loaded = Some(checkpoint.id);
    }
}
