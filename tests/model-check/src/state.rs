//! A state of the world: four processes, what the disks hold, what is on its way, and what has happened so far as the properties
//! need it. Parts that a step does not touch are shared with the state before.

use crate::canon::{Words, fingerprint};
use crate::plc::{Frame, Plc};
use fam_agents::manager::ManagerAgents;
use fam_agents::node::NodeAgents;
use fam_gateway_core::{Gateway, MemoryRecords};
use fam_proto::{
    BootId, CheckpointId, Envelope, Epoch, InputImage, Message, Now, Owner, RepoState,
};
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// A process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Pid {
    /// The manager.
    Manager,
    /// The gateway.
    Gateway,
    /// Controller 1 or 2 (0 or 1).
    Node(usize),
}

/// All processes.
pub const PIDS: [Pid; 4] = [Pid::Manager, Pid::Gateway, Pid::Node(0), Pid::Node(1)];

/// The agents of a process.
#[derive(Debug, Clone, Hash)]
#[allow(clippy::large_enum_variant)] // always behind an `Arc`
pub enum Body {
    /// Middleware Manager, monitors, D&D.
    Manager(ManagerAgents),
    /// The fence and its records.
    Gateway(Gateway),
    /// CA and MCA, the MC beside them, and the newest image that has come.
    Node(NodeAgents, Plc, Option<Arc<InputImage>>),
}

/// A process that runs.
#[derive(Debug, Clone)]
pub struct Process {
    /// Its life.
    pub boot: BootId,
    /// Its clock.
    pub now: Now,
    /// Whose liveliness tokens it sees.
    pub tokens: BTreeSet<(Pid, BootId)>,
    /// Its agents.
    pub body: Body,
    words: Words,
}

impl Process {
    /// A process at its start.
    #[must_use]
    pub fn new(boot: BootId, body: Body) -> Process {
        let mut process = Process {
            boot,
            // Far enough from 0 that no age is cut off.
            now: Now(10_000_000),
            tokens: BTreeSet::new(),
            body,
            words: Words::default(),
        };
        process.refresh();
        process
    }

    /// To be called after each change.
    pub fn refresh(&mut self) {
        self.words = Words::of(&(self.boot, &self.tokens, &self.body), self.now);
    }
}

/// What a link carries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Packet {
    /// A message of the protocol.
    Message(Box<Envelope>),
    /// A frame on its way to the gateway.
    Frame(Box<Frame>),
}

impl Hash for Packet {
    fn hash<H: Hasher>(&self, state: &mut H) {
        match self {
            Packet::Frame(frame) => frame.hash(state),
            Packet::Message(envelope) => {
                // The bytes of a checkpoint are what its digest says.
                if let Message::Opened(opened) = &envelope.body
                    && opened.checkpoint.is_some()
                {
                    let mut bare = opened.clone();
                    bare.checkpoint = None;
                    (1u8, bare, envelope.boot, &envelope.to).hash(state);
                } else {
                    envelope.hash(state);
                }
            }
        }
    }
}

/// A packet between two processes.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Flight {
    /// Sender.
    pub from: Pid,
    /// Receiver.
    pub to: Pid,
    /// What.
    pub packet: Arc<Packet>,
}

impl Flight {
    /// Order in which packets are kept: it must not hang on absolute numbers, but on their order only.
    #[must_use]
    pub fn key(&self) -> (Pid, Pid, u8, u64, u64) {
        let (kind, first, second) = match &*self.packet {
            Packet::Frame(frame) => (0, frame.header.epoch.0, frame.header.scan.0),
            Packet::Message(envelope) => match &envelope.body {
                Message::Order(order) => (1, order.id.0, 0),
                Message::Open(open) => (2, open.epoch.0, open.owner.boot.0),
                Message::Opened(opened) => (3, opened.epoch.0, 0),
                Message::OpenRefused(refused) => (4, refused.epoch.0, 0),
                Message::McReport(report) => (
                    5,
                    report.order.map_or(0, |o| o.0),
                    report.epoch.map_or(0, |e| e.0),
                ),
                _ => (6, 0, 0),
            },
        };
        (self.to, self.from, kind, first, second)
    }
}

/// Faults that may still happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Faults {
    /// Crashes.
    pub crashes: u8,
    /// Restarts of what has crashed.
    pub restarts: u8,
    /// Cuts of a connection in both directions.
    pub cuts: u8,
    /// Messages that arrive twice.
    pub repeats: u8,
    /// Moves that an operator orders.
    pub moves: u8,
    /// Frames that do not arrive at once: late, after others, or never.
    pub late: u8,
}

/// A planted bug: the check has to find it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Bug {
    /// A gateway that is started again has forgotten its records.
    RecordsForgotten,
    /// An activation starts from the checkpoint held here, whatever the gateway has granted.
    StaleStart,
    /// The gateway does not know whose token it sees, and grants over a healthy owner.
    OwnerUnseen,
}

/// What has happened, as far as the properties need it.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Facts {
    /// The newest grant.
    pub grant: Option<(Epoch, Owner)>,
    /// Head of the chain when it was granted.
    pub base: Option<CheckpointId>,
    /// Whether a frame of that epoch was applied.
    pub driven: bool,
    /// What was applied last.
    pub applied: Option<CheckpointId>,
    /// Who was to have an epoch, by the newest order that carried one.
    pub ordered: BTreeMap<Epoch, Owner>,
}

/// The world.
#[derive(Debug, Clone)]
pub struct State {
    /// What runs.
    pub processes: BTreeMap<Pid, Arc<Process>>,
    /// The manager's repository.
    pub repository: Arc<RepoState>,
    /// The gateway's record file, and how often it was opened.
    pub records: Arc<MemoryRecords>,
    /// Starts of the gateway.
    pub runs: u32,
    /// Newest boot id.
    pub boots: u64,
    /// On its way, in the order of [`Flight::key`].
    pub flights: Vec<Flight>,
    /// The newest image on its way to each.
    pub images: BTreeMap<Pid, Arc<InputImage>>,
    /// A connection that is cut.
    pub cut: Option<(Pid, Pid)>,
    /// Faults that may still happen.
    pub faults: Faults,
    /// The past.
    pub facts: Arc<Facts>,
    /// The next frame of a node takes its time.
    pub late: [bool; 2],
    /// Orders to activate so far.
    pub activations: u8,
}

impl State {
    /// The process, if it runs.
    #[must_use]
    pub fn process(&self, pid: Pid) -> Option<&Arc<Process>> {
        self.processes.get(&pid)
    }

    /// Whether two processes hear each other.
    #[must_use]
    pub fn connected(&self, a: Pid, b: Pid) -> bool {
        self.cut.is_none_or(|cut| cut != (a, b) && cut != (b, a))
    }

    /// Whether everything that can be is well: no process down that could be started, no connection cut.
    #[must_use]
    pub fn is_mended(&self) -> bool {
        self.cut.is_none()
            && self.process(Pid::Manager).is_some()
            && self.process(Pid::Gateway).is_some()
    }

    /// What each process, the disks, and what is on its way are told from others by, each for itself.
    #[must_use]
    pub fn parts(&self) -> Vec<(&'static str, u128)> {
        let alone = |words: &Words| fingerprint([words].into_iter());
        let name = |pid: &Pid| match pid {
            Pid::Manager => "manager",
            Pid::Gateway => "gateway",
            Pid::Node(_) => "node",
        };
        let mut parts: Vec<(&'static str, u128)> = self
            .processes
            .iter()
            .map(|(pid, process)| (name(pid), alone(&process.words)))
            .collect();
        let on_its_way = Words::of(&(&self.flights, &self.images), Now(0));
        parts.push(("network", alone(&on_its_way)));
        parts.push(("past", alone(&Words::of(&self.facts, Now(0)))));
        let disks = (
            &self.repository.epochs,
            self.repository.generation,
            &self.repository.assignment,
            &self.records,
        );
        parts.push(("disks", alone(&Words::of(&disks, Now(0)))));
        parts
    }

    /// What the state is told from others by.
    #[must_use]
    pub fn fingerprint(&self) -> u128 {
        let rest = Words::of(
            &(
                (&self.repository.epochs, self.repository.generation),
                (&self.repository.assignment, &self.records),
                (&self.flights, &self.images),
                (
                    self.cut,
                    self.faults,
                    &self.facts,
                    self.activations,
                    self.late,
                ),
                (self.runs, BootId(self.boots)),
            ),
            Now(0),
        );
        let absent = Words::default();
        let processes: Vec<&Words> = PIDS
            .iter()
            .map(|pid| self.processes.get(pid).map_or(&absent, |p| &p.words))
            .chain([&rest])
            .collect();
        fingerprint(processes.iter().copied())
    }
}
