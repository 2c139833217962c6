//! What the manager's agents know of the cell: written by the Middleware Manager, read by the QoS Monitors and Diagnosis & Decision.
//!
//! Who drives an MC is told by its gateway's record alone. Whether a controller is there is told by its liveliness token and
//! its reports. What the manager wants is the assignment; what is on its way is in `under_way`.

use crate::unfit::Unfit;
use fam_proto::mark::{Mark, hash_marked};
use fam_proto::model::{CellModel, McModel};
use fam_proto::{
    BootId, ControllerId, Epoch, GatewayId, ImageNumber, LayoutHash, McId, McaState, Now, Owner,
    PlanId, RecordState, RecordSummary, Registration, Reset, ResourceReport,
};
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// After its token is seen a node has this long to register before the first start of an MC goes on without it, in microseconds.
pub const JOINING_US: u64 = 300_000;
/// Lives of one controller whose tokens are kept, at most.
pub const LIVES_MAX: usize = 16;
/// So many cycles without a valid frame, and the gateway no longer counts an owner as healthy.
pub const HEALTHY_CYCLES: u64 = 3;

/// Everything known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellView {
    /// The cell model in force.
    pub model: Arc<CellModel>,
    /// Generation of the assignment.
    pub generation: PlanId,
    /// Controllers of the model.
    pub controllers: BTreeMap<ControllerId, ControllerView>,
    /// MCs of the model.
    pub mcs: BTreeMap<McId, McView>,
    /// Gateways of the model.
    pub gateways: BTreeMap<GatewayId, GatewayView>,
    /// Grows whenever an MC that found no place might find one now.
    pub version: u64,
    /// The manager has been up long enough to know who is there.
    pub settled: bool,
}

// The model does not change.
impl Hash for CellView {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.generation.hash(state);
        self.controllers.hash(state);
        self.mcs.hash(state);
        self.gateways.hash(state);
        hash_marked(Mark::Count, self.version, state);
        self.settled.hash(state);
    }
}

/// Why a controller counts as lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Loss {
    /// Its liveliness token is gone.
    Token,
    /// Its reports stay away, though its token stands: frozen, cut off, or its agents hang.
    Reports,
}

impl std::fmt::Display for Loss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Loss::Token => "its liveliness token is gone",
            Loss::Reports => "its reports stay away",
        })
    }
}

/// One controller.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ControllerView {
    /// Registration of the life in force.
    pub registration: Option<Registration>,
    /// What the repository knew of it: for the status only.
    pub remembered: Option<Registration>,
    /// MCs that it may not run, with the reason.
    pub ineligible: BTreeMap<McId, String>,
    /// Lives whose liveliness tokens are seen.
    pub tokens: BTreeSet<BootId>,
    /// When the token of a life that has not registered yet was seen.
    pub expected_since: Option<Now>,
    /// When it was heard of last.
    pub heard: Now,
    /// Last report of the life in force.
    pub report: Option<ResourceReport>,
    /// Why it counts as lost; `None` while it is up.
    pub lost: Option<Loss>,
    /// Since when it counts as lost.
    pub lost_since: Now,
    /// Drained by an operator.
    pub drained: bool,
    /// It hands its MCs over and leaves.
    pub leaving: bool,
    /// It was told that it may leave.
    pub may_leave: bool,
    /// MCs that it may leave behind, because nobody else can take them.
    pub behind: BTreeSet<McId>,
}

// When it was heard counts only while it is up, since when it is lost only while it is. What it runs by its registration is for people.
impl Hash for ControllerView {
    fn hash<H: Hasher>(&self, state: &mut H) {
        if let Some(r) = &self.registration {
            (&r.owner, r.cpu_factor_permille, r.memory_kb).hash(state);
            (r.limit_permille, r.tick_us, &r.mcs).hash(state);
        }
        (self.registration.is_some(), &self.ineligible, &self.tokens).hash(state);
        (self.expected_since, &self.report, self.lost).hash(state);
        match (self.is_up(), self.lost) {
            (true, _) => self.heard.hash(state),
            (false, Some(_)) => self.lost_since.hash(state),
            (false, None) => {}
        }
        (self.drained, self.leaving, self.may_leave, &self.behind).hash(state);
    }
}

impl ControllerView {
    /// Whether it is there and heard.
    #[must_use]
    pub fn is_up(&self) -> bool {
        self.registration.is_some() && self.lost.is_none()
    }
    /// The life in force.
    #[must_use]
    pub fn owner(&self) -> Option<&Owner> {
        self.registration.as_ref().map(|r| &r.owner)
    }
    /// Whether one life of it may take the place of another: a later one, unless it is the earlier one that is seen to live; an
    /// earlier one only then. Boot ids come from wall clocks, and those may be set back.
    #[must_use]
    pub fn may_follow(&self, known: BootId, boot: BootId) -> bool {
        let seen = |life| self.tokens.contains(&life);
        if boot > known {
            seen(boot) || !seen(known)
        } else {
            seen(boot) && !seen(known)
        }
    }
    /// Whether its MCs are to go elsewhere.
    #[must_use]
    pub fn is_emptied(&self) -> bool {
        self.drained || self.leaving
    }
}

/// An activation on a controller failed: it is left out for this MC.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// Not before this moment, and not before a report says that its input image is fresh.
    pub until: Now,
    /// How often in succession.
    pub failures: u32,
    /// A report has cleared it.
    pub cleared: bool,
    /// What happened.
    pub why: String,
}

// How often it failed shows in the time; the reason is for people.
impl Hash for LeftOut {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.until, self.cleared).hash(state);
    }
}

/// What is being done about an MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum UnderWay {
    /// It goes to this controller.
    To(ControllerId),
    /// It is being stopped.
    Stop,
}

/// One MC.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct McView {
    /// Position of its model in the cell model.
    at: usize,
    /// Its record in the newest image.
    pub record: Option<RecordSummary>,
    /// Where it belongs by the assignment.
    pub assigned: Option<ControllerId>,
    /// Where an operator keeps it.
    pub pinned: Option<ControllerId>,
    /// An operator stopped it.
    pub stopped: bool,
    /// A plan stopped it because capacity was short.
    pub shed: bool,
    /// The next activation carries this reset.
    pub reset: Option<Reset>,
    /// What is being done about it.
    pub under_way: Option<UnderWay>,
    /// Controllers left out after failed activations.
    pub left_out: BTreeMap<ControllerId, LeftOut>,
    /// State that its owner's MCA reported last.
    pub state: Option<McaState>,
    /// Its owner under this epoch is lost to the manager, but the gateway sees it drive: left alone.
    pub left_alone: Option<Epoch>,
    /// Version and layout in force, where it was learned from who drives; else the model's.
    pub version: Option<(u64, LayoutHash)>,
}

// The state that its MCA reported is for people.
impl Hash for McView {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.at, &self.record, &self.assigned, &self.pinned).hash(state);
        (self.stopped, self.shed, self.reset, &self.under_way).hash(state);
        (&self.left_out, self.left_alone).hash(state);
    }
}

impl McView {
    fn is_before_its_first_start(&self) -> bool {
        self.record
            .as_ref()
            .is_some_and(|r| r.state == RecordState::Never)
    }
}

/// One gateway.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct GatewayView {
    /// Its life, from its images.
    pub boot: Option<BootId>,
    /// Its liveliness token, if one is seen.
    pub token: Option<BootId>,
    /// Newest image.
    pub image: ImageNumber,
    /// The last image that claimed to be of another life while this one's token was seen.
    pub doubtful: Option<(BootId, ImageNumber)>,
    /// What the gateway could not read, since its start.
    pub bad_messages: u64,
    /// When the newest image came.
    pub heard: Now,
    /// Token gone or images missing.
    pub down: bool,
}

// When it was heard counts only while it is up.
impl Hash for GatewayView {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.boot, self.token, self.image, self.doubtful, self.down).hash(state);
        if self.is_up() {
            self.heard.hash(state);
        }
    }
}

impl GatewayView {
    /// Whether its images come.
    #[must_use]
    pub fn is_up(&self) -> bool {
        self.boot.is_some() && !self.down
    }
}

/// Why an MC needs a controller.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Need {
    /// Its owner is lost.
    Lost(ControllerId, Loss),
    /// The gateway has had no valid frame for the MC's suspect time.
    Silent(u64),
    /// Nobody owns it; the word of the record's state.
    Unowned(&'static str),
}

impl CellView {
    /// What an empty manager knows.
    #[must_use]
    pub fn new(model: Arc<CellModel>) -> CellView {
        CellView {
            generation: PlanId(0),
            controllers: model
                .controllers
                .iter()
                .map(|c| (c.controller.clone(), ControllerView::default()))
                .collect(),
            mcs: model
                .mcs
                .iter()
                .enumerate()
                .map(|(at, m)| {
                    let view = McView {
                        at,
                        ..McView::default()
                    };
                    (m.mc.clone(), view)
                })
                .collect(),
            gateways: model
                .gateways
                .iter()
                .map(|g| (g.gateway.clone(), GatewayView::default()))
                .collect(),
            version: 0,
            settled: false,
            model,
        }
    }

    /// Model and view of an MC.
    #[must_use]
    pub fn mc(&self, mc: &McId) -> Option<(&McModel, &McView)> {
        let view = self.mcs.get(mc)?;
        Some((self.model.mcs.get(view.at)?, view))
    }

    /// Version of an MC in force, and the layout of its state: that of whoever drives it, else the model's.
    #[must_use]
    pub fn version_of(&self, mc: &McId) -> Option<(u64, LayoutHash)> {
        let (model, view) = self.mc(mc)?;
        Some(view.version.unwrap_or((model.hash, model.layout)))
    }

    /// Whether this life of a controller is the one in force and up.
    #[must_use]
    pub fn life_is_up(&self, owner: &Owner) -> bool {
        self.controllers
            .get(&owner.controller)
            .is_some_and(|c| c.is_up() && c.owner() == Some(owner))
    }

    /// The owner by the record, if the record is open.
    #[must_use]
    pub fn driver(&self, mc: &McId) -> Option<&Owner> {
        let record = self.mcs.get(mc)?.record.as_ref()?;
        (record.state == RecordState::Open).then_some(record.owner.as_ref())?
    }

    /// The controller that runs the MC in a healthy way as far as the manager can tell.
    #[must_use]
    pub fn runs_on(&self, mc: &McId) -> Option<&ControllerId> {
        let owner = self.driver(mc)?;
        (self.need(mc).is_none()).then_some(&owner.controller)
    }

    /// MCs that a life of a controller holds at its gateway.
    #[must_use]
    pub fn held_by(&self, owner: &Owner) -> Vec<McId> {
        self.mcs
            .iter()
            .filter(|(_, m)| {
                m.record.as_ref().is_some_and(|r| {
                    r.owner.as_ref() == Some(owner)
                        && matches!(r.state, RecordState::Open | RecordState::Released(_))
                })
            })
            .map(|(mc, _)| mc.clone())
            .collect()
    }

    /// Why the MC needs a controller now; `None` if it has one, may have none, or its gateway cannot be seen.
    #[must_use]
    pub fn need(&self, mc: &McId) -> Option<Need> {
        let (model, view) = self.mc(mc)?;
        if !self.gateways.get(&model.gateway)?.is_up() || view.stopped {
            return None;
        }
        let record = view.record.as_ref()?;
        match &record.state {
            RecordState::Never
            | RecordState::Closed
            | RecordState::FailSafe
            | RecordState::Released(_) => Some(Need::Unowned(record.state.word())),
            RecordState::Stopped | RecordState::Faulted(_) => {
                (view.reset.is_some() || view.shed).then(|| Need::Unowned(record.state.word()))
            }
            RecordState::Open => {
                if record.suspect {
                    return Some(Need::Silent(record.silent_us));
                }
                if view.left_alone == Some(record.epoch) {
                    return None;
                }
                self.lost_owner(model, record)
            }
        }
    }

    /// The owner's loss, as far as it justifies to take the MC from it: the gateway is asked as a witness where the token stands.
    fn lost_owner(&self, model: &McModel, record: &RecordSummary) -> Option<Need> {
        let owner = record.owner.as_ref()?;
        let controller = self.controllers.get(&owner.controller)?;
        let in_force = controller.owner()?;
        let loss = if in_force.boot == owner.boot {
            controller.lost?
        } else if controller.may_follow(owner.boot, in_force.boot) {
            Loss::Token // it drove in an earlier life
        } else {
            controller.lost?
        };
        let healthy = record.silent_us <= HEALTHY_CYCLES * u64::from(model.cycle_us);
        if loss == Loss::Reports && healthy {
            return None;
        }
        Some(Need::Lost(owner.controller.clone(), loss))
    }

    /// Whether a controller may be given an MC.
    ///
    /// # Errors
    /// Why not.
    pub fn may_take(&self, controller: &ControllerId, mc: &McId, now: Now) -> Result<(), Unfit> {
        let (model, view) = self.mc(mc).ok_or_else(|| Unfit::UnknownMc(mc.clone()))?;
        if !model.hosts.contains(controller) {
            return Err(Unfit::NoHost);
        }
        let there = self
            .controllers
            .get(controller)
            .ok_or(Unfit::UnknownController)?;
        let registration = there.registration.as_ref().ok_or(Unfit::NotRegistered)?;
        if let Some(loss) = there.lost {
            return Err(Unfit::Lost(loss));
        }
        if there.leaving {
            return Err(Unfit::Leaving);
        }
        if there.drained {
            return Err(Unfit::Drained);
        }
        if let Some(why) = there.ineligible.get(mc) {
            return Err(Unfit::Ineligible(why.clone()));
        }
        if !registration.mcs.iter().any(|h| &h.mc == mc) {
            return Err(Unfit::NoProject);
        }
        if let Some(record) = view.record.as_ref().filter(|r| r.suspect)
            && record.state == RecordState::Open
            && record.owner.as_ref() == Some(&registration.owner)
        {
            return Err(Unfit::Silent);
        }
        if let Some(left_out) = view.left_out.get(controller)
            && !(left_out.cleared && now >= left_out.until)
        {
            return Err(Unfit::LeftOut(left_out.why.clone()));
        }
        Ok(())
    }

    /// Until when a node whose token is seen is expected to register; `None` if none is expected.
    #[must_use]
    pub fn joining_until(&self, now: Now) -> Option<Now> {
        self.controllers
            .values()
            .filter_map(|c| c.expected_since)
            .map(|since| since.plus_us(JOINING_US))
            .filter(|until| now < *until)
            .max()
    }

    /// Whether an MC waits for nodes that are about to join: only before its very first start.
    #[must_use]
    pub fn waits_for_joining(&self, mc: &McId, now: Now) -> bool {
        self.mcs
            .get(mc)
            .is_some_and(McView::is_before_its_first_start)
            && self.joining_until(now).is_some()
    }

    /// MCs that need a controller, are not on their way and wait for nobody.
    #[must_use]
    pub fn homeless(&self, now: Now) -> Vec<(McId, Need)> {
        let joining = self.joining_until(now).is_some();
        self.mcs
            .iter()
            .filter(|(_, m)| m.under_way.is_none() && !(joining && m.is_before_its_first_start()))
            .filter_map(|(mc, _)| Some((mc.clone(), self.need(mc)?)))
            .collect()
    }

    /// Whether anything is on its way, or waits for a controller that could take it.
    #[must_use]
    pub fn is_busy(&self, now: Now) -> bool {
        self.mcs.iter().any(|(mc, m)| {
            m.under_way.is_some()
                || (self.need(mc).is_some()
                    && self
                        .controllers
                        .keys()
                        .any(|c| self.may_take(c, mc, now).is_ok()))
        })
    }
}
