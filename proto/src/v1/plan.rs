//! Events of quality of service, and the plans that answer them.

use crate::ids::{ControllerId, McId, PlanId};
use serde::{Deserialize, Serialize};

/// What a QoS Monitor, a Controller Agent or an operator saw.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct QosEvent {
    /// Quality of service: `availability`, `work balance`, `cycle time`, `operator`, or one of the user's own.
    pub qos: String,
    /// What happened.
    pub cause: Cause,
    /// In words, for the event history: what was measured against which limit.
    pub detail: String,
}

/// Causes of a reconfiguration.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Cause {
    /// The controller's liveliness token is gone.
    ControllerLost(ControllerId),
    /// The gateway has had no valid frame of the MC for its suspect time.
    McSilent(McId),
    /// An MC has no owner (first start, gateway restart, fail-safe, failed activation).
    McUnowned(McId),
    /// A controller is above its limit.
    Overload(ControllerId),
    /// The spread of workloads is wider than the threshold, or a controller below its limit has joined.
    Imbalance(ControllerId),
    /// Scans of an MC take longer than its cycle allows.
    Overrun(ControllerId, McId),
    /// An operator's command: drain, undrain, move, pin, stop, reset.
    Operator,
    /// One of the user's own.
    Custom(String),
}

/// How an MC gets to where the plan wants it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum MoveKind {
    /// The MC has no (healthy) owner: the target opens it at once.
    Activate,
    /// A planned move: release at a non-critical state, then open.
    Handover,
}

/// One MC's way.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Move {
    /// The MC.
    pub mc: McId,
    /// Where it is now, if anywhere.
    pub from: Option<ControllerId>,
    /// Where it goes.
    pub to: ControllerId,
    /// How.
    pub kind: MoveKind,
}

/// What Diagnosis & Decision wants the Middleware Manager to carry out. It leaves no choice to whoever carries it out.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Plan {
    /// Number of the plan.
    pub id: PlanId,
    /// The generation of the assignment that it was made from: a plan made from another one is refused.
    pub parent: PlanId,
    /// What it answers.
    pub event: QosEvent,
    /// Moves, most critical MC first.
    pub moves: Vec<Move>,
    /// MCs that nobody can take, with the reason.
    pub left_out: Vec<(McId, String)>,
    /// What it saw and what it gains, in words.
    pub why: String,
    /// Highest normalised workload before and after, in permille of the limit.
    pub peak_permille: (u32, u32),
}
