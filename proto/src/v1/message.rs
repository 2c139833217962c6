//! Messages between agents. An order is repeated by its sender until it is answered; a repeated order has the same number.

use super::checkpoint::{Checkpoint, CheckpointId, LayoutHash};
use super::event::Event;
use super::frame::Successor;
use super::operator::{Command, CommandReply, Query, QueryReply};
use super::plan::QosEvent;
use super::record::{RecordSummary, TrapInfo};
use crate::codec::Wire;
use crate::ids::{AgentId, BootId, ControllerId, Epoch, McId, OrderId, Owner, Scan};
use serde::{Deserialize, Serialize};

/// A message with its sender and receiver.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Envelope {
    /// Who sends.
    pub from: AgentId,
    /// The life of the sender's process.
    pub boot: BootId,
    /// Who is meant.
    pub to: AgentId,
    /// What is said.
    pub body: Message,
}

impl Wire for Envelope {
    const KIND: u8 = 5;
    const NAME: &'static str = "message";
}

/// What agents say to each other.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Message {
    /// CA to MM, repeated until answered; again whenever the manager comes back.
    Register(Registration),
    /// MM to CA.
    Registered(Registered),
    /// MM to CA: this life of the controller is not taken; why. The CA reports it and keeps trying.
    RegistrationRefused(String),
    /// CA to MM: this controller hands over its MCs and leaves (SIGTERM). Answered by drained state in `Registered`.
    Leaving,
    /// MM to CA: nothing of you is active any more but what nobody else can take now; you may go.
    MayLeave {
        /// MCs that have no other place: their outputs will fall to the fail-safe values.
        behind: Vec<McId>,
    },
    /// CA to MM and monitors, at each report interval. Its absence tells of a freeze or cut.
    Report(ResourceReport),
    /// CA to D&D: an event that the CA raises itself (as in the work-balance case study).
    Qos(QosEvent),
    /// D&D to hosting CAs.
    CallForProposals(CallForProposals),
    /// CA to D&D.
    Bid(Bid),
    /// MCA to D&D: what it holds.
    Holding(Holding),
    /// D&D to CAs: which MCs they won.
    Award(Award),
    /// MM to MCA.
    Order(Order),
    /// MCA to MM: order received; its outcome comes as a `McReport`.
    OrderReceived(OrderId),
    /// MCA to MM, on each change and once for each order.
    McReport(McReport),
    /// MCA to gateway: make me the owner.
    Open(Open),
    /// Gateway to MCA.
    Opened(Opened),
    /// Gateway to MCA.
    OpenRefused(OpenRefused),
    /// MCA to gateway: my logic trapped and no stop POU can run; set the fail-safe values.
    Close(Close),
    /// Node or gateway to MM: something for the history.
    Event(Event),
    /// Operator's command to MM.
    Command(Command),
    /// MM to the operator's command.
    CommandReply(CommandReply),
    /// A question to the manager.
    Query(Query),
    /// Its answer.
    QueryReply(Box<QueryReply>),
    /// Gateway to MM, once a second if there are any: messages that it could not read or that were not for it, since its start.
    BadMessages(u64),
    /// MM to CA, repeated until answered: read the cell again and make its changed MCs ready, under this number.
    Stage(u64),
    /// CA to MM: they are ready, or why not.
    Staged(Box<Staged>),
}

/// What a controller hosts, as its CA registers it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Hosted {
    /// The MC.
    pub mc: McId,
    /// Hash of logic, layout and masks: a controller whose hash differs from the one in force is not eligible.
    pub hash: u64,
    /// Layout of its state.
    pub layout: LayoutHash,
    /// Memory that its instance takes, in kB.
    pub memory_kb: u64,
    /// Worst-case scan time at CPU factor 1.0, in microseconds, declared in the model.
    pub worst_case_us: u32,
}

/// A version of an MC that a controller has made ready beside the one that runs.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct StagedMc {
    /// The MC.
    pub mc: McId,
    /// Hash of logic, layout and masks.
    pub version: u64,
    /// Layout of its state.
    pub layout: LayoutHash,
}

/// What came of [`Message::Stage`].
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Staged {
    /// Number of the request.
    pub id: u64,
    /// Changed MCs that are hosted here.
    pub mcs: Vec<StagedMc>,
    /// What changed, and what becomes of the state of each MC; for people.
    pub changes: String,
    /// Why the new version cannot be taken while the cell runs; nothing is staged then.
    pub refused: Option<String>,
}

/// A controller's resources.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Registration {
    /// The controller in this life.
    pub owner: Owner,
    /// Description for people.
    pub description: String,
    /// Speed relative to the reference controller, in permille.
    pub cpu_factor_permille: u32,
    /// Memory for MCs, in kB.
    pub memory_kb: u64,
    /// Share of its cycle that it may spend on MCs, in permille.
    pub limit_permille: u32,
    /// Tick of its scan thread, in microseconds.
    pub tick_us: u32,
    /// What it hosts.
    pub mcs: Vec<Hosted>,
    /// MCs that it drives at this moment (it met a new manager while running).
    pub active: Vec<(McId, Epoch)>,
    /// Real-time means in force: `SCHED_FIFO`, `mlock`, `CPU n`; empty where none is allowed.
    pub real_time: Vec<String>,
}

/// What the manager answers to a registration.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Registered {
    /// Which MCs are assigned to this controller now.
    pub assigned: Vec<McId>,
    /// MCs that it hosts but may not run, with the reason.
    pub ineligible: Vec<(McId, String)>,
}

/// Load of one active MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct McLoad {
    /// The MC.
    pub mc: McId,
    /// Mean CPU time of a scan, smoothed over half a second, in microseconds.
    pub scan_us_mean: u32,
    /// Worst case: CPU time that scans reached in three stretches (of 2 s) of the last minute, in microseconds.
    pub scan_us_worst: u32,
    /// The MC's cycle, in microseconds.
    pub cycle_us: u32,
    /// Scans in the interval.
    pub scans: u32,
    /// Real time that MC time has fallen behind since activation, in microseconds.
    pub lag_us: u64,
}

/// What a CA reports at each interval.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ResourceReport {
    /// The controller in this life.
    pub owner: Owner,
    /// Workload: 100 x sum over active MCs of (scan CPU time / cycle) / limit, as permille (design, section 8).
    pub workload_permille: u32,
    /// Active MCs.
    pub mcs: Vec<McLoad>,
    /// CPU of the host, in permille of all its cores.
    pub host_cpu_permille: u32,
    /// CPU of this process, in permille of one core.
    pub process_cpu_permille: u32,
    /// Resident memory of this process, in kB.
    pub process_memory_kb: u64,
    /// Ticks that began later than half a tick after their time, since start.
    pub late_ticks: u64,
    /// Ticks whose work took longer than the tick, since start.
    pub overruns: u64,
    /// Age of the newest input image, in microseconds; `u64::MAX` if there has been none.
    pub image_age_us: u64,
    /// Messages that did not read, since start.
    pub bad_messages: u64,
}

/// Contract net: the call.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CallForProposals {
    /// Number of the negotiation.
    pub negotiation: u64,
    /// MCs to be placed.
    pub mcs: Vec<McId>,
    /// Criteria beside the built-in ones, by name of their quality of service.
    pub criteria: Vec<String>,
    /// How long bids are waited for, in microseconds.
    pub within_us: u64,
}

/// What a CA offers for one MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct McOffer {
    /// The MC.
    pub mc: McId,
    /// Why it cannot take it; `None` if it can.
    pub unable: Option<String>,
    /// Worst-case scan time of the MC on this controller, in microseconds: measured here, or declared and scaled.
    pub worst_case_us: u32,
}

/// Contract net: the bid. It holds what is true now and wins over the last report.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Bid {
    /// Number of the negotiation.
    pub negotiation: u64,
    /// The controller in this life.
    pub owner: Owner,
    /// Offers for the MCs called for.
    pub offers: Vec<McOffer>,
    /// Workload now, in permille of the limit.
    pub workload_permille: u32,
    /// Free memory for MCs, in kB.
    pub memory_free_kb: u64,
    /// Age of its newest input image, in microseconds.
    pub image_age_us: u64,
    /// Values for further criteria, by name.
    pub criteria: Vec<(String, i64)>,
}

/// What an MCA holds of its MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Holding {
    /// Number of the negotiation.
    pub negotiation: u64,
    /// The MC.
    pub mc: McId,
    /// On which controller.
    pub owner: Owner,
    /// Newest checkpoint in its passive instance.
    pub held: Option<CheckpointId>,
}

/// Contract net: the award.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Award {
    /// Number of the negotiation.
    pub negotiation: u64,
    /// MCs won by the receiver; empty: it lost.
    pub mcs: Vec<McId>,
}

/// How an MC is brought back from stopped or faulted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Reset {
    /// All variables take their initial values.
    Cold,
    /// Retained variables keep their values.
    Warm,
    /// Go on from the record, with its diagnosis.
    Resume,
}

/// What the manager wants of an MCA.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Order {
    /// Number; the same in each repetition.
    pub id: OrderId,
    /// The MC.
    pub mc: McId,
    /// What to do.
    pub kind: OrderKind,
}

/// Kinds of orders.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum OrderKind {
    /// Open `epoch` at the gateway and run.
    Activate {
        /// The new epoch, durable before this order left.
        epoch: Epoch,
        /// For a handover: wait until this owner has released to us; for a failover `None`: open at once.
        after: Option<Owner>,
        /// An operator forces it over a healthy owner.
        force: bool,
        /// Given with an operator's reset.
        reset: Option<Reset>,
        /// How long the MCA tries, in microseconds.
        within_us: u64,
    },
    /// Release at the next non-critical state.
    Release {
        /// The epoch that is to be released: an order for another one is stale.
        epoch: Epoch,
        /// Who goes on.
        successor: Successor,
        /// After this long without a non-critical state the move is cancelled, in microseconds.
        within_us: u64,
    },
    /// The handover is off: if not yet released, go on.
    CancelRelease {
        /// The epoch meant.
        epoch: Epoch,
    },
    /// Run the stop POU and end.
    Stop {
        /// The epoch that is to be stopped.
        epoch: Epoch,
    },
    /// Open `epoch`, to which the MC was released, and run it with a version that was staged: its state is carried over.
    Renew {
        /// The new epoch, durable before this order left.
        epoch: Epoch,
        /// Hash of the version.
        version: u64,
        /// How long the MCA tries, in microseconds.
        within_us: u64,
    },
    /// Another controller runs this version now: hold it from now on.
    Adopt {
        /// Hash of the version.
        version: u64,
    },
}

/// State of an MCA (drawn in `agents::component`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum McaState {
    /// Hosts the MC, keeps the newest checkpoint.
    Passive,
    /// Asks the gateway for an epoch.
    Opening,
    /// Runs normal logic.
    Active,
    /// Waits for a non-critical state, or repeats the released frame.
    Releasing,
    /// Runs a recovery action.
    Recovering,
    /// Stopped safely.
    Stopped,
    /// Its logic trapped.
    Faulted,
}

/// What came of an order, or what happened by itself.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum McOutcome {
    /// The epoch is open and the scan thread runs it.
    Activated {
        /// Head that the epoch starts from.
        base: Option<CheckpointId>,
        /// `recoveryAction`: 0 direct recovery.
        recovery: u16,
        /// Name of the critical interval that the recovery answers.
        interval: Option<String>,
    },
    /// The gateway refused, or did not answer in time.
    NotOpened(String),
    /// The recovery action ended and normal logic runs.
    Recovered,
    /// The gateway has acknowledged the released frame.
    Released {
        /// The last scan.
        scan: Scan,
    },
    /// No non-critical state came in time, or the order was stale; it goes on.
    ReleaseCancelled(String),
    /// The stop POU ended.
    Stopped,
    /// The logic trapped.
    Faulted(TrapInfo),
    /// The record shows a higher epoch, or ours closed: outputs are no longer ours.
    Deposed(String),
    /// State change without further news.
    Changed,
}

/// Report of an MCA.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct McReport {
    /// The MC.
    pub mc: McId,
    /// On which controller.
    pub owner: Owner,
    /// State of the MCA now.
    pub state: McaState,
    /// Its epoch, if it has one.
    pub epoch: Option<Epoch>,
    /// The order that this answers.
    pub order: Option<OrderId>,
    /// What came of it.
    pub outcome: McOutcome,
}

/// An MCA asks to become owner.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Open {
    /// The MC.
    pub mc: McId,
    /// The new epoch.
    pub epoch: Epoch,
    /// Who asks.
    pub owner: Owner,
    /// Layout that it can run.
    pub layout: LayoutHash,
    /// Checkpoint that it holds: the answer leaves the bytes out if it is the head.
    pub held: Option<CheckpointId>,
    /// An operator forces it.
    pub force: bool,
    /// Reset given by an operator.
    pub reset: Option<Reset>,
}

/// The record that an epoch starts from.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Opened {
    /// The MC.
    pub mc: McId,
    /// The epoch granted.
    pub epoch: Epoch,
    /// Head of the chain, which the first frame names as base. `None` for an MC without history or after a cold reset.
    pub base: Option<CheckpointId>,
    /// The checkpoint, unless the asker holds it.
    pub checkpoint: Option<Box<Checkpoint>>,
    /// The outputs applied last (fail-safe values if those stand at the field).
    #[serde(with = "serde_bytes")]
    pub outputs: Vec<u8>,
    /// Phase of the head.
    pub phase: Option<super::checkpoint::Phase>,
    /// The epoch before ended without a release: the state has to be diagnosed as interrupted.
    pub interrupted: bool,
    /// The outputs stand at their fail-safe values.
    pub fail_safe: bool,
    /// Next scan number.
    pub next_scan: Scan,
    /// Reset to be carried out, as asked for.
    pub reset: Option<Reset>,
    /// Who asked: a late answer to the life before is nothing for the next one.
    pub owner: Owner,
}

/// Why the gateway refuses an open.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum OpenRefusal {
    /// The epoch is not above the record's (or equal with another owner).
    StaleEpoch,
    /// The owner is healthy: its frames are fresh and its token is seen. Ask again later.
    OwnerFresh,
    /// It was released to another successor.
    NotSuccessor,
    /// Stopped or faulted: needs a reset.
    NeedsReset,
    /// The asker's layout is not the record's.
    Layout,
    /// The gateway does not know the MC.
    UnknownMc,
    /// The gateway could not make the epoch durable.
    NotDurable(String),
}

impl std::fmt::Display for OpenRefusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            OpenRefusal::StaleEpoch => f.write_str("the epoch is not above the one on record"),
            OpenRefusal::OwnerFresh => f.write_str("the owner is healthy"),
            OpenRefusal::NotSuccessor => f.write_str("it was released to another controller"),
            OpenRefusal::NeedsReset => {
                f.write_str("it is stopped or faulted; `fam reset <MC>` brings it back")
            }
            OpenRefusal::Layout => f.write_str(
                "its checkpoint has another layout; generate all projects from one model",
            ),
            OpenRefusal::UnknownMc => f.write_str("the gateway does not serve this MC"),
            OpenRefusal::NotDurable(why) => write!(
                f,
                "the epoch could not be made durable at the gateway: {why}"
            ),
        }
    }
}

/// The refusal, with the record as it stands.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct OpenRefused {
    /// The MC.
    pub mc: McId,
    /// The epoch asked for.
    pub epoch: Epoch,
    /// Why.
    pub why: OpenRefusal,
    /// The record; `None` for an unknown MC.
    pub record: Option<RecordSummary>,
}

/// An owner gives up after a trap.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Close {
    /// The MC.
    pub mc: McId,
    /// The epoch.
    pub epoch: Epoch,
    /// The owner.
    pub owner: Owner,
    /// Where and why.
    pub trap: TrapInfo,
}

/// Convenience for senders.
impl Envelope {
    /// Whether the sender is (an agent of) this controller in this life.
    #[must_use]
    pub fn is_from(&self, owner: &Owner) -> bool {
        self.boot == owner.boot
            && matches!(&self.from, AgentId::Controller(c) | AgentId::Component(c, _) if c == &owner.controller)
    }
    /// The controller of the sender, if it is an agent of a node.
    #[must_use]
    pub fn controller(&self) -> Option<&ControllerId> {
        match &self.from {
            AgentId::Controller(c) | AgentId::Component(c, _) => Some(c),
            _ => None,
        }
    }
}
