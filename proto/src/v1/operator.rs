//! What operators ask of the manager, and what it answers: the status that `fam status` prints.

use super::checkpoint::Phase;
use super::event::Event;
use super::message::{McaState, Reset, ResourceReport};
use crate::ids::{BootId, ControllerId, Epoch, GatewayId, McId, PlanId, Scan};
use serde::{Deserialize, Serialize};

/// A command of an operator. Repeated with the same number until answered.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Command {
    /// Number chosen by the sender.
    pub id: u64,
    /// What to do.
    pub what: CommandKind,
}

/// Kinds of commands.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum CommandKind {
    /// Move an MC to a controller.
    Move {
        mc: McId,
        to: ControllerId,
        force: bool,
    },
    /// Take all MCs off a controller and give it no more.
    Drain(ControllerId),
    /// End a drain.
    Undrain(ControllerId),
    /// Keep an MC where it is (or on the given controller): plans do not move it while that controller lives.
    Pin { mc: McId, to: Option<ControllerId> },
    /// End a pin.
    Unpin(McId),
    /// Run the MC's stop POU.
    Stop(McId),
    /// Bring a stopped or faulted MC back.
    Reset { mc: McId, how: Reset },
    /// Acknowledge alarms: one by its position in the history, or all.
    Acknowledge(Option<u64>),
    /// Bring a new version of the cell's logic in: without a number, read it and say what would change; with the number of that
    /// command, do it.
    Reload(Option<u64>),
}

/// The answer.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CommandReply {
    /// Number of the command.
    pub id: u64,
    /// What was done or begun, or why not, for people.
    pub result: Result<String, String>,
    /// `true` when nothing more will follow; a command that takes time answers first with `false`, then with its end.
    pub done: bool,
}

/// A question.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Query {
    /// All of [`CellStatus`].
    Status,
    /// Events after this position, at most `limit`, oldest first.
    Events { after: u64, limit: u32 },
}

/// Its answer.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum QueryReply {
    /// The cell.
    Status(CellStatus),
    /// Events, and whether more follow.
    Events { events: Vec<Event>, more: bool },
}

/// The cell as the manager sees it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CellStatus {
    /// Name of the cell.
    pub cell: String,
    /// Life of the manager.
    pub manager_boot: BootId,
    /// Manager's clock, in microseconds.
    pub at_us: u64,
    /// Generation of the assignment.
    pub generation: PlanId,
    /// Controllers, by name.
    pub controllers: Vec<ControllerStatus>,
    /// MCs, by name.
    pub mcs: Vec<McStatus>,
    /// Gateways, by name.
    pub gateways: Vec<GatewayStatus>,
    /// Plan or negotiation under way, in words.
    pub in_progress: Option<String>,
    /// Alarms not yet acknowledged.
    pub alarms: u32,
    /// Messages that the manager could not read, since its start.
    pub bad_messages: u64,
}

/// One controller.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct ControllerStatus {
    /// Its name.
    pub controller: ControllerId,
    /// Its life; `None` if it has not registered with this manager.
    pub boot: Option<BootId>,
    /// Whether it is up (token and reports).
    pub up: bool,
    /// Being drained or drained.
    pub drained: bool,
    /// Speed relative to the reference, in permille.
    pub cpu_factor_permille: u32,
    /// Its last report.
    pub report: Option<ResourceReport>,
    /// MCs active on it.
    pub active: Vec<McId>,
    /// MCs that it hosts but may not run, with the reason.
    pub ineligible: Vec<(McId, String)>,
    /// Real-time means in force.
    pub real_time: Vec<String>,
}

/// One MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct McStatus {
    /// Its name.
    pub mc: McId,
    /// Who owns it by the record.
    pub owner: Option<ControllerId>,
    /// The record's epoch.
    pub epoch: Epoch,
    /// Last applied scan.
    pub scan: Scan,
    /// Word of the record's state.
    pub record: String,
    /// Phase of the head.
    pub phase: Option<Phase>,
    /// State of the MCA that was reported last by the owner.
    pub state: Option<McaState>,
    /// Pinned to a controller.
    pub pinned: Option<ControllerId>,
    /// Frames rejected.
    pub rejected: u64,
    /// Criticality: higher is placed first.
    pub criticality: u32,
}

/// One gateway.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct GatewayStatus {
    /// Its name.
    pub gateway: GatewayId,
    /// Its life, from its images.
    pub boot: Option<BootId>,
    /// Whether images come.
    pub up: bool,
    /// Number of the newest image.
    pub image: u64,
    /// Frames and messages that it could not read, or that were not for it, since its start.
    pub bad_messages: u64,
}
