//! What can happen to an MC Agent, and how the gateway's record is read.

use super::{McAgent, State};
use fam_proto::access::McNews;
use fam_proto::{
    Checkpoint, CheckpointId, Epoch, OpenRefusal, Opened, Order, OrderId, OrderKind, Owner,
    RecordState, RecordSummary, Reset, Scan, Successor, TrapInfo,
};
use std::sync::Arc;

/// An order to activate.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct ActivateOrder {
    pub id: OrderId,
    pub epoch: Epoch,
    pub after: Option<Owner>,
    pub force: bool,
    pub reset: Option<Reset>,
    pub within_us: u64,
    /// With this staged version.
    pub renew: Option<u64>,
}

/// An order to release.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct ReleaseOrder {
    pub id: OrderId,
    pub epoch: Epoch,
    pub successor: Successor,
    pub within_us: u64,
}

/// Events of the state machine, about the epoch of the state.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) enum Event {
    Activate(ActivateOrder),
    /// With a staged version.
    Renew(ActivateOrder),
    /// Another controller runs a staged version.
    Adopt {
        id: OrderId,
        version: u64,
    },
    Release(ReleaseOrder),
    CancelRelease {
        id: OrderId,
        epoch: Epoch,
    },
    Stop {
        id: OrderId,
        epoch: Epoch,
    },
    Opened(Box<Opened>),
    Refused(OpenRefusal),
    /// A checkpoint was read from the passive instance.
    State {
        id: CheckpointId,
        checkpoint: Option<Arc<Checkpoint>>,
    },
    /// A frame or the record shows a release to this controller.
    Handed(Successor),
    /// The record shows that the epoch cannot drive (any more).
    Lost {
        why: String,
        /// By a higher epoch.
        overtaken: bool,
    },
    /// The record shows our fault.
    FaultOnRecord,
    Started,
    NotStarted(String),
    Recovered,
    Released(Scan),
    ReleaseCancelled(String),
    Stopped,
    Trapped(TrapInfo),
    Deposed(String),
    Timeout,
}

impl Event {
    pub(super) fn from_order(order: Order) -> Event {
        let id = order.id;
        match order.kind {
            OrderKind::Activate {
                epoch,
                after,
                force,
                reset,
                within_us,
            } => Event::Activate(ActivateOrder {
                id,
                epoch,
                after,
                force,
                reset,
                within_us,
                renew: None,
            }),
            OrderKind::Renew {
                epoch,
                version,
                within_us,
            } => Event::Renew(ActivateOrder {
                id,
                epoch,
                after: None,
                force: false,
                reset: None,
                within_us,
                renew: Some(version),
            }),
            OrderKind::Adopt { version } => Event::Adopt { id, version },
            OrderKind::Release {
                epoch,
                successor,
                within_us,
            } => Event::Release(ReleaseOrder {
                id,
                epoch,
                successor,
                within_us,
            }),
            OrderKind::CancelRelease { epoch } => Event::CancelRelease { id, epoch },
            OrderKind::Stop { epoch } => Event::Stop { id, epoch },
        }
    }

    /// `None` for a release to somebody else.
    pub(super) fn from_news(news: McNews, me: &Owner) -> Option<Event> {
        Some(match news {
            McNews::State { id, checkpoint } => Event::State { id, checkpoint },
            McNews::Handed(successor) if &successor.owner == me => Event::Handed(successor),
            McNews::Handed(_) => return None,
            McNews::Started { .. } => Event::Started,
            McNews::NotStarted { why, .. } => Event::NotStarted(why),
            McNews::Recovered { .. } => Event::Recovered,
            McNews::Released { scan, .. } => Event::Released(scan),
            McNews::ReleaseCancelled { why, .. } => Event::ReleaseCancelled(why),
            McNews::Stopped { .. } => Event::Stopped,
            McNews::Trapped { trap, .. } => Event::Trapped(trap),
            McNews::Deposed { why, .. } => Event::Deposed(why),
        })
    }
}

impl McAgent {
    /// What a record means for this MCA; `None`: nothing new. A record of an epoch before ours is a late word.
    ///
    /// The acknowledgement of a released or stopped frame is left to the scan thread, which repeats that frame until then.
    pub(super) fn judge(&self, record: &RecordSummary) -> Option<Event> {
        let me = &self.config.owner;
        if let RecordState::Released(successor) = &record.state
            && &successor.owner == me
            && self.handed.as_ref() != Some(successor)
        {
            return Some(Event::Handed(successor.clone()));
        }
        let own = self.epoch()?;
        if record.epoch < own {
            return None;
        }
        let lost = |why: String| {
            Some(Event::Lost {
                why,
                overtaken: record.epoch > own,
            })
        };
        let other = || {
            record
                .owner
                .as_ref()
                .map_or_else(|| "nobody".to_owned(), ToString::to_string)
        };
        if record.epoch > own {
            // The successor has opened: the scan thread knows whether our release led there.
            if let State::Releasing { .. } = self.state {
                return None;
            }
            return lost(format!(
                "epoch {} of {} is on record",
                record.epoch,
                other()
            ));
        }
        if record.owner.as_ref() != Some(me) {
            return lost(format!("epoch {own} is on record for {}", other()));
        }
        match &record.state {
            RecordState::Open
            | RecordState::Released(_)
            | RecordState::Stopped
            | RecordState::Never => None,
            RecordState::Closed => {
                lost(format!("epoch {own} is closed: the gateway was restarted"))
            }
            RecordState::FailSafe => lost(format!(
                "epoch {own} is closed: the fail-safe values are set"
            )),
            RecordState::Faulted(_) => Some(Event::FaultOnRecord),
        }
    }
}
