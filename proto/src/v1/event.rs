//! The event history: what happened, to whom, and why, for people and for reports.

use crate::codec::Wire;
use crate::ids::{ControllerId, Epoch, McId, PlanId, Scan};
use serde::{Deserialize, Serialize};

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// Normal life.
    Info,
    /// Something to look at.
    Warning,
    /// Somebody has to act; stands until acknowledged.
    Alarm,
}

/// What kind of thing happened; the words that `fam events` prints and `timeline.json` holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EventKind {
    ManagerStarted,
    GatewayJoined,
    GatewayLost,
    ControllerJoined,
    ControllerRefused,
    ControllerLost,
    ControllerStopped,
    QosEvent,
    PlanDecided,
    PlanRefused,
    PlanDone,
    MoveOrdered,
    MoveCancelled,
    McActivated,
    McReleased,
    McRecovering,
    McStopped,
    McFaulted,
    McFailSafe,
    McSuspect,
    McUnplaced,
    McIneligible,
    ActivationFailed,
    OperatorCommand,
    RepositoryFailed,
    BadMessages,
    FieldDeviceLost,
    FieldDeviceBack,
    FramesRejected,
    McRenewed,
}

/// One entry of the history.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Event {
    /// Position in the history, given by the manager; 0 until then.
    pub seq: u64,
    /// On the clock of whoever saw it, in microseconds (the manager's `Now` in the history).
    pub at_us: u64,
    /// Wall clock in microseconds since 1970, put in by the manager's process; for people only.
    pub wall_us: u64,
    /// How bad.
    pub severity: Severity,
    /// What kind.
    pub kind: EventKind,
    /// Which MC.
    pub mc: Option<McId>,
    /// Which controller.
    pub controller: Option<ControllerId>,
    /// Which plan.
    pub plan: Option<PlanId>,
    /// Which epoch.
    pub epoch: Option<Epoch>,
    /// Which scan.
    pub scan: Option<Scan>,
    /// In words.
    pub text: String,
    /// For alarms: whether an operator has acknowledged it.
    pub acknowledged: bool,
}

impl Event {
    /// An entry with kind, severity and words; the rest is filled by `..` or the setters below.
    #[must_use]
    pub fn new(severity: Severity, kind: EventKind, text: impl Into<String>) -> Event {
        Event {
            seq: 0,
            at_us: 0,
            wall_us: 0,
            severity,
            kind,
            mc: None,
            controller: None,
            plan: None,
            epoch: None,
            scan: None,
            text: text.into(),
            acknowledged: false,
        }
    }
    /// Names the MC.
    #[must_use]
    pub fn mc(mut self, mc: &McId) -> Event {
        self.mc = Some(mc.clone());
        self
    }
    /// Names the controller.
    #[must_use]
    pub fn controller(mut self, controller: &ControllerId) -> Event {
        self.controller = Some(controller.clone());
        self
    }
    /// Names the plan.
    #[must_use]
    pub fn plan(mut self, plan: PlanId) -> Event {
        self.plan = Some(plan);
        self
    }
    /// Names the epoch.
    #[must_use]
    pub fn epoch(mut self, epoch: Epoch) -> Event {
        self.epoch = Some(epoch);
        self
    }
    /// Names the scan.
    #[must_use]
    pub fn scan(mut self, scan: Scan) -> Event {
        self.scan = Some(scan);
        self
    }
}

impl Wire for Event {
    const KIND: u8 = 4;
    const NAME: &'static str = "event";
}
