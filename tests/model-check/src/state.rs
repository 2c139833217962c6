//! A state of the world: four processes, what the disks hold, what is on its way, and what has happened so far as the properties
//! need it. Parts that a step does not touch are shared with the state before.

use crate::canon::{Lens, Words, fingerprint};
use crate::plc::{Frame, Plc};
use fam_agents::manager::ManagerAgents;
use fam_agents::node::NodeAgents;
use fam_gateway_core::{Gateway, MemoryRecords};
use fam_proto::{
    BootId, CheckpointId, Envelope, Epoch, InputImage, Message, Now, Owner, RepoState,
};
use std::collections::BTreeSet;
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

impl Pid {
    /// Its place in [`PIDS`].
    #[must_use]
    pub fn at(self) -> usize {
        match self {
            Pid::Manager => 0,
            Pid::Gateway => 1,
            Pid::Node(n) => 2 + n,
        }
    }

    /// What it is.
    #[must_use]
    pub fn kind(self) -> Kind {
        match self {
            Pid::Manager => Kind::Manager,
            Pid::Gateway => Kind::Gateway,
            Pid::Node(_) => Kind::Node,
        }
    }
}

/// What a process is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// The manager.
    Manager,
    /// The gateway.
    Gateway,
    /// A controller.
    Node,
}

/// The agents of a process.
#[derive(Debug, Clone, Hash)]
#[allow(clippy::large_enum_variant)] // always behind an `Arc`
pub enum Body {
    /// Middleware Manager, monitors, D&D.
    Manager(ManagerAgents),
    /// The fence and its records.
    Gateway(Gateway),
    /// CA and MCA, and the MC beside them.
    Node(NodeAgents, Plc),
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

/// Ages that the manager's agents tell apart: anything, 100 ms and 300 ms (settling), 1 s (images, doubted tokens), 2.5 s (reports).
const MANAGER_PAST_US: &[u64] = &[0, 99_999, 299_999, 999_999, 2_499_999];
/// The gateway's clock stands at ticks and deadlines of its silence only; these are all distances that occur.
const GATEWAY_PAST_US: &[u64] = &[
    0, 99_999, 199_999, 299_999, 300_000, 330_001, 400_000, 460_000,
];
/// A node tells apart how old its newest image is.
const NODE_PAST_US: &[u64] = &[300_000, 2_000_000];

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
        let past_us = match &self.body {
            Body::Manager(_) => MANAGER_PAST_US,
            Body::Gateway(_) => GATEWAY_PAST_US,
            Body::Node(..) => NODE_PAST_US,
        };
        let lens = Lens {
            now: self.now,
            past_us,
        };
        self.words = Words::of(&(self.boot, &self.tokens, &self.body), lens);
    }

    /// What it is told from others by.
    #[must_use]
    pub fn words(&self) -> &Words {
        &self.words
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
                } else if let Message::McReport(report) = &envelope.body {
                    // Which order has failed; the words around it are for people.
                    let what = std::mem::discriminant(&report.outcome);
                    (2u8, report.order, &report.owner, what).hash(state);
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
    /// It takes its time: it may arrive at any later moment, or never. All others arrive before anything else happens.
    pub held: bool,
}

impl Flight {
    /// Order in which packets are kept: it must not hang on absolute numbers, but on their order only.
    #[must_use]
    pub fn key(&self) -> (Pid, Pid, u8, u64, u64, bool) {
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
        (self.to, self.from, kind, first, second, self.held)
    }
}

/// Faults that may still happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Faults {
    /// Crashes.
    pub crashes: u8,
    /// Of whom; of anybody if nothing is said.
    pub whom: Option<Kind>,
    /// Restarts of what has crashed.
    pub restarts: u8,
    /// Cuts of a connection in both directions.
    pub cuts: u8,
    /// Between whom; any if nothing is said.
    pub between: Option<(Kind, Kind)>,
    /// Messages that arrive twice.
    pub repeats: u8,
    /// Moves that an operator orders.
    pub moves: u8,
    /// Frames that do not arrive at once: late, after others, or never.
    pub late: u8,
    /// Messages that take their time, at once.
    pub held: usize,
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
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Facts {
    /// The newest grant.
    pub grant: Option<(Epoch, Owner)>,
    /// Head of the chain when it was granted.
    pub base: Option<CheckpointId>,
    /// Whether a frame of that epoch was applied.
    pub driven: bool,
    /// What was applied last.
    pub applied: Option<CheckpointId>,
    /// The highest epoch that was ordered, and for whom.
    pub ordered: Option<(Epoch, Owner)>,
}

// Where an epoch begins counts until it has begun.
impl Hash for Facts {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (&self.grant, self.driven, self.applied, &self.ordered).hash(state);
        (!self.driven).then_some(self.base).hash(state);
    }
}

/// The world.
#[derive(Debug, Clone)]
pub struct State {
    /// What runs, by [`Pid::at`].
    pub processes: [Option<Arc<Process>>; 4],
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
    /// The newest image on its way to the manager.
    pub image: Option<Arc<InputImage>>,
    /// A connection that is cut.
    pub cut: Option<(Pid, Pid)>,
    /// Faults that may still happen.
    pub faults: Faults,
    /// The past.
    pub facts: Arc<Facts>,
    /// The next frame of a node takes its time.
    pub late: [bool; 2],
    /// Epochs ordered so far.
    pub activations: u8,
}

impl State {
    /// The process, if it runs.
    #[must_use]
    pub fn process(&self, pid: Pid) -> Option<&Arc<Process>> {
        self.processes[pid.at()].as_ref()
    }

    /// What runs.
    pub fn running(&self) -> impl Iterator<Item = (Pid, &Arc<Process>)> {
        PIDS.into_iter()
            .filter_map(|pid| Some((pid, self.process(pid)?)))
    }

    /// The manager's agents, if it runs.
    #[must_use]
    pub fn manager(&self) -> Option<&ManagerAgents> {
        match self.process(Pid::Manager).map(|p| &p.body) {
            Some(Body::Manager(agents)) => Some(agents),
            _ => None,
        }
    }

    /// The gateway, if it runs.
    #[must_use]
    pub fn gateway(&self) -> Option<&Gateway> {
        match self.process(Pid::Gateway).map(|p| &p.body) {
            Some(Body::Gateway(gateway)) => Some(gateway),
            _ => None,
        }
    }

    /// A node's agents and its MC, if it runs.
    #[must_use]
    pub fn node(&self, n: usize) -> Option<(&NodeAgents, &Plc)> {
        match self.process(Pid::Node(n)).map(|p| &p.body) {
            Some(Body::Node(agents, plc)) => Some((agents, plc)),
            _ => None,
        }
    }

    /// The life of a process, if it runs.
    #[must_use]
    pub fn boot(&self, pid: Pid) -> Option<BootId> {
        self.process(pid).map(|p| p.boot)
    }

    /// Whether two processes hear each other, if they run.
    #[must_use]
    pub fn connected(&self, a: Pid, b: Pid) -> bool {
        self.cut.is_none_or(|cut| cut != (a, b) && cut != (b, a))
    }

    /// What each process, the disks, and what is on its way are told from others by, each for itself.
    #[must_use]
    pub fn parts(&self) -> Vec<(&'static str, u128)> {
        let alone = |words: &Words| fingerprint([words].into_iter());
        let name = |pid: Pid| match pid {
            Pid::Manager => "manager",
            Pid::Gateway => "gateway",
            Pid::Node(_) => "node",
        };
        let mut parts: Vec<(&'static str, u128)> = self
            .running()
            .map(|(pid, process)| (name(pid), alone(&process.words)))
            .collect();
        parts.push(("network", alone(&self.network())));
        parts.push(("past", alone(&Words::of(&self.facts, Lens::TIMELESS))));
        parts.push(("disks", alone(&self.disks())));
        parts
    }

    fn network(&self) -> Words {
        let image = self
            .image
            .as_ref()
            .map(|image| (image.boot, &image.records));
        Words::of(&(&self.flights, image), Lens::TIMELESS)
    }

    /// What is on a disk counts as long as somebody may yet read it.
    fn disks(&self) -> Words {
        let is_read = |pid: Pid| self.may_crash(pid) || self.process(pid).is_none();
        let repository = is_read(Pid::Manager).then(|| {
            let repository = &self.repository;
            (repository.generation, &repository.assignment)
        });
        let records = is_read(Pid::Gateway).then_some(&self.records);
        Words::of(&(repository, records), Lens::TIMELESS)
    }

    /// Whether a process may crash yet.
    #[must_use]
    pub fn may_crash(&self, pid: Pid) -> bool {
        self.faults.crashes > 0 && self.faults.whom.is_none_or(|kind| kind == pid.kind())
    }

    /// What the state is told from others by.
    #[must_use]
    pub fn fingerprint(&self) -> u128 {
        let rest = Words::of(
            &(
                (self.cut, self.faults, &self.facts),
                (self.late, self.activations),
            ),
            Lens::TIMELESS,
        );
        let (network, disks) = (self.network(), self.disks());
        let absent = Words::default();
        let parts: Vec<&Words> = self
            .processes
            .iter()
            .map(|process| process.as_ref().map_or(&absent, |p| &p.words))
            .chain([&network, &disks, &rest])
            .collect();
        fingerprint(parts.iter().copied())
    }
}
