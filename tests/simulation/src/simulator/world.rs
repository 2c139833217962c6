//! The cell while it runs: the processes, what is to happen next, and who hears of whom.

use super::canary::Canary;
use super::cell::Cell;
use super::faults::{Fault, Target};
use super::field::Field;
use super::generate::{When, more, schedule};
use super::log::Log;
use super::manager::{Copy, Managing};
use super::network::{Network, Pid, stream};
use super::nodes::{NodeBody, ScanOut};
use super::quiet::Quiet;
use super::random::Random;
use super::stages::{Matrix, Stage};
use super::time::{Clock, Queue};
use super::{Options, Outcome};
use crate::invariants::{Invariants, Seen};
use fam_gateway_core::{Gateway, MemoryRecords};
use fam_proto::agent::{Agent, Input};
use fam_proto::{AgentId, Applied, BootId, Command, Envelope, InputImage, McId, Message};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Events at one moment: more is a loop that does not end.
const EVENTS_AT_ONCE_MAX: u32 = 20_000;
/// What a process that stands still has in its buffers at most; what comes later is lost.
const STALLED_MAX: usize = 3_000;
/// What wall clocks show at the beginning, in microseconds since 1970.
pub(super) const WALL_US: u64 = 1_700_000_000_000_000;
/// How often a manager's process tells its agents the wall clock, in microseconds.
pub(super) const TELL_WALL_US: u64 = 1_000_000;
/// When copies of the repository are put aside, in microseconds.
const COPIES_AT_US: [u64; 6] = [
    250_000, 1_000_000, 2_000_000, 3_500_000, 5_000_000, 6_500_000,
];
/// How often a schedule in which too little has happened goes on, and in which steps, in microseconds.
const EXTENSIONS_MAX: u32 = 30;
const EXTENSION_US: u64 = 500_000;

/// What a link carries.
#[derive(Debug, Clone)]
pub(super) enum Packet {
    Message(Box<Envelope>),
    Frame(usize, Arc<[u8]>),
    Image(Arc<InputImage>),
}

/// What happens.
pub(super) enum Event {
    /// A deadline of a process's agents.
    Timer { pid: Pid, boot: BootId },
    /// A tick of a node's scan thread.
    Tick { node: usize, boot: BootId },
    /// A node's scan thread is rung for between its ticks: a command has come.
    Ring { node: usize, boot: BootId },
    /// Something from a node's scan thread reaches its other threads.
    Inner {
        node: usize,
        boot: BootId,
        out: ScanOut,
    },
    /// Something arrives.
    Deliver { to: Pid, packet: Packet },
    /// The field has answered the gateway.
    Field { boot: BootId },
    /// Outputs that the gateway has written reach the field.
    Write {
        boot: BootId,
        mc: usize,
        outputs: Arc<[u8]>,
    },
    /// A manager's process tells its agents the wall clock.
    Wall { pid: Pid, boot: BootId },
    /// Somebody puts a copy of the repository aside.
    Copy,
    /// An observer looks whether it still hears of a process.
    Tokens { observer: Pid, subject: Pid },
    /// A process starts.
    Start(Pid),
    /// A fault of the schedule begins.
    Fault(usize),
    /// A fault begins to wait for its stage.
    Aim(usize),
    /// It ends.
    Ends(usize),
    /// Whether enough has happened.
    Extend,
    /// The operator repeats a command that was not answered.
    Ask { id: u64 },
    /// The quiet time begins.
    Quiet,
    /// The operator looks after stopped MCs.
    Operator,
    /// Whether all is well again.
    Check,
}

/// What all processes have.
pub(super) struct Life {
    pub boot: BootId,
    pub clock: Clock,
    /// How often it was started, this time included.
    pub starts: u32,
    pub started_us: u64,
    /// Since when it stands still.
    pub frozen_us: Option<u64>,
    /// When its agents' next deadline is due.
    pub scheduled_us: Option<u64>,
    pub stalled: Vec<Event>,
    /// Whose liveliness tokens it sees.
    pub tokens: BTreeSet<(Pid, BootId)>,
    /// It dies after so many outputs more.
    pub doomed: Option<u32>,
    /// When it was killed last.
    pub died_us: u64,
}

/// The cell.
pub(super) struct World {
    pub options: Options,
    pub seed: u64,
    pub now_us: u64,
    pub queue: Queue<Event>,
    pub random: Random,
    /// Chances of each process: what happens elsewhere does not change them.
    pub dice: BTreeMap<Pid, Random>,
    pub cell: Arc<Cell>,
    pub network: Network,
    pub lives: BTreeMap<Pid, Life>,
    pub managing: Managing,
    /// The second manager.
    pub rival: Managing,
    /// Copies of the repository, oldest first.
    pub copies: Vec<Copy>,
    /// The manager's machine is about to lose its power: whether what was not synced may be torn.
    pub manager_power: Option<bool>,
    /// How much the wall clock of a process's machine was set forward.
    pub wall_steps_us: BTreeMap<Pid, i64>,
    pub gateway: Option<Gateway>,
    pub records: MemoryRecords,
    pub gateway_runs: u32,
    /// Opens that reached the gateway: whether one of the epoch was forced.
    pub forced: BTreeSet<(McId, fam_proto::Epoch)>,
    pub nodes: Vec<Option<NodeBody>>,
    pub field: Field,
    /// When the last write reaches the field.
    pub field_busy_us: u64,
    /// The gateway dies in the middle of its next write of a head.
    pub gateway_tears: bool,
    pub schedule: Vec<(When, Fault)>,
    /// Faults that wait for their stage: which, which stage, at whom, how long after.
    pub aimed: Vec<(usize, Stage, Target, u64)>,
    /// What was carried out, and when.
    pub carried: Vec<(u64, Fault)>,
    pub last_end_us: u64,
    pub quiet_us: u64,
    pub extensions: u32,
    pub extras: Random,
    pub matrix: Matrix,
    /// Faults that came while a failover or a move was under way.
    pub in_flight: u64,
    pub storms: Vec<(usize, super::network::Weather)>,
    pub manager_disk_fails: u32,
    pub gateway_disk_fails: u32,
    pub field_silent: u32,
    /// How many images to a node get lost, in a thousand, by fault.
    pub lost_images: BTreeMap<usize, (usize, u64)>,
    /// How late images to a node come, by fault.
    pub stale_images: BTreeMap<usize, (usize, u64)>,
    /// How many frames to a node's replicas get lost, in a thousand, by fault.
    pub lost_frames: BTreeMap<usize, (usize, u64)>,
    /// How late scan threads wake, by fault.
    pub late: BTreeMap<usize, (usize, u64)>,
    /// How much longer scans take, by fault.
    pub slow: BTreeMap<usize, (usize, u64)>,
    /// MCs of which a node has another version, by fault.
    pub versions: BTreeMap<usize, (usize, usize)>,
    /// Nodes that were asked to end, and how long they are to be down then.
    pub terminated: BTreeMap<usize, u64>,
    pub boots: BTreeSet<BootId>,
    pub commands: u64,
    /// Commands that nobody has answered yet.
    pub open_commands: BTreeMap<u64, Command>,
    /// Frames applied, if the log is written.
    pub applied: Vec<Applied>,
    pub invariants: Invariants,
    pub log: Log,
    pub faults: BTreeMap<&'static str, u64>,
    pub deeds: BTreeMap<&'static str, u64>,
    pub quiet: Option<Quiet>,
    pub finished: bool,
    pub events: u64,
}

impl World {
    pub(super) fn new(seed: u64, options: &Options) -> World {
        let mut choice = Random::new(seed, 1);
        let cell = options.profile.cell(&mut choice);
        let lease_us = 1_000 * choice.between(150, 900);
        let schedule = match &options.script {
            Some(script) => script
                .iter()
                .map(|(at_us, fault)| (When::At(*at_us), fault.clone()))
                .collect(),
            None => schedule(&cell, &options.profile.trouble(), &mut choice),
        };
        let cell = Arc::new(cell);
        let mut world = World {
            options: options.clone(),
            seed,
            now_us: 0,
            queue: Queue::new(),
            random: Random::new(seed, 2),
            dice: BTreeMap::new(),
            network: Network::new(seed, lease_us),
            lives: BTreeMap::new(),
            managing: Managing::new(&cell.model.cell),
            rival: Managing::new(&cell.model.cell),
            copies: Vec::new(),
            manager_power: None,
            wall_steps_us: BTreeMap::new(),
            gateway: None,
            records: MemoryRecords::default(),
            gateway_runs: 0,
            forced: BTreeSet::new(),
            nodes: (0..cell.controllers.len()).map(|_| None).collect(),
            field: options.profile.field(seed),
            field_busy_us: 0,
            gateway_tears: false,
            schedule,
            aimed: Vec::new(),
            carried: Vec::new(),
            last_end_us: 0,
            quiet_us: 0,
            extensions: 0,
            extras: Random::new(seed, 3),
            matrix: Matrix::default(),
            in_flight: 0,
            storms: Vec::new(),
            manager_disk_fails: 0,
            gateway_disk_fails: 0,
            field_silent: 0,
            lost_images: BTreeMap::new(),
            stale_images: BTreeMap::new(),
            lost_frames: BTreeMap::new(),
            late: BTreeMap::new(),
            slow: BTreeMap::new(),
            versions: BTreeMap::new(),
            terminated: BTreeMap::new(),
            boots: BTreeSet::new(),
            commands: 0,
            open_commands: BTreeMap::new(),
            applied: Vec::new(),
            invariants: Invariants::new(cell.clone(), options.only),
            log: Log::new(options.log),
            faults: BTreeMap::new(),
            deeds: BTreeMap::new(),
            quiet: None,
            finished: false,
            events: 0,
            cell,
        };
        world.begin();
        world
    }

    fn begin(&mut self) {
        for pid in self.pids() {
            let dice = self.dice(pid);
            let at_us = if dice.chance(300) {
                dice.below(250_000)
            } else {
                dice.below(5_000)
            };
            self.queue.push(at_us, Event::Start(pid));
        }
        let mut extend_us = 0;
        for n in 0..self.schedule.len() {
            extend_us = extend_us.max(self.plan(n));
        }
        if self.options.script.is_none() {
            extend_us = self.options.profile.trouble().to_us;
        }
        self.queue.push(extend_us, Event::Extend);
        for at_us in COPIES_AT_US {
            self.queue.push(at_us, Event::Copy);
        }
        let (cell, schedule) = (&self.cell, &self.schedule);
        self.log.line(0, || {
            let mcs: Vec<String> = cell
                .mcs
                .iter()
                .map(|m| {
                    format!(
                        "{} on {:?} every {} ms (watchdog {} ms)",
                        m.mc,
                        m.hosts.iter().map(|h| h + 1).collect::<Vec<_>>(),
                        m.model.cycle_us / 1_000,
                        m.model.watchdog_us / 1_000
                    )
                })
                .collect();
            format!(
                "{} controllers; {}; {} faults",
                cell.controllers.len(),
                mcs.join(", "),
                schedule.len()
            )
        });
    }

    /// Lets a fault of the schedule come in its time; which time.
    fn plan(&mut self, n: usize) -> u64 {
        match self.schedule[n].0 {
            When::At(at_us) => {
                self.queue.push_first(at_us, Event::Fault(n));
                at_us
            }
            When::Aimed { from_us, .. } => {
                self.queue.push(from_us, Event::Aim(n));
                from_us
            }
        }
    }

    /// The schedule has come to its end: what waits for its stage waits no longer, and if too little has happened, more comes.
    fn extend(&mut self) {
        let trouble = self.options.profile.trouble();
        let enough = self.carried.len() as u64 >= trouble.faults.0 && self.in_flight > 0;
        if enough || self.options.script.is_some() || self.extensions >= EXTENSIONS_MAX {
            self.aimed.clear();
            self.quiet_us = match self.options.quiet_us {
                Some(quiet_us) => quiet_us.max(self.now_us),
                None => self.last_end_us.max(self.now_us) + 50_000,
            };
            self.queue.push(self.quiet_us, Event::Quiet);
            return;
        }
        self.extensions += 1;
        for fault in more(&self.cell, &trouble, self.now_us, &mut self.extras) {
            self.schedule.push(fault);
            self.plan(self.schedule.len() - 1);
        }
        self.queue.push(self.now_us + EXTENSION_US, Event::Extend);
    }

    /// The chances of a process.
    pub(super) fn dice(&mut self, pid: Pid) -> &mut Random {
        let seed = self.seed;
        self.dice
            .entry(pid)
            .or_insert_with(|| Random::new(seed, 1_000 + stream(pid)))
    }

    /// All processes of the cell.
    pub(super) fn pids(&self) -> Vec<Pid> {
        let nodes = (0..self.nodes.len()).map(Pid::Node);
        let rival = self.lives.contains_key(&Pid::Rival).then_some(Pid::Rival);
        [Pid::Manager, Pid::Gateway]
            .into_iter()
            .chain(nodes)
            .chain(rival)
            .collect()
    }

    pub(super) fn run(mut self) -> Outcome {
        let mut at_once = 0;
        while !self.finished && self.invariants.violations().is_empty() {
            let Some((at_us, event)) = self.queue.pop() else {
                break;
            };
            at_once = if at_us == self.now_us { at_once + 1 } else { 0 };
            if at_once > EVENTS_AT_ONCE_MAX {
                self.defect("time does not go on: a deadline that is always due".to_owned());
                break;
            }
            self.now_us = at_us;
            self.events += 1;
            self.dispatch(event);
        }
        let recovered_us = self.quiet.as_ref().map_or(0, Quiet::recovered_us);
        Outcome {
            seed: self.seed,
            violations: self.invariants.violations().to_vec(),
            faults: self.faults,
            deeds: self.deeds,
            carried: self.carried,
            quiet_us: self.quiet_us,
            matrix: self.matrix,
            in_flight: self.in_flight,
            products: self.field.products(),
            events: self.events,
            virtual_us: self.now_us,
            recovered_us,
            digest: self.log.digest(),
            applied: self.applied,
            log: self.log.into_lines(),
        }
    }

    pub(super) fn defect(&mut self, text: String) {
        self.invariants.defect(self.now_us, text);
    }

    pub(super) fn see(&mut self, seen: &Seen<'_>) {
        self.invariants.see(seen, self.now_us);
    }

    pub(super) fn deed(&mut self, kind: &'static str) {
        *self.deeds.entry(kind).or_default() += 1;
    }

    pub(super) fn has(&self, canary: Canary) -> bool {
        self.options.canary == Some(canary)
    }

    pub(super) fn note(&mut self, text: impl FnOnce() -> String) {
        self.log.line(self.now_us, text);
    }

    fn dispatch(&mut self, event: Event) {
        let event = match self.held_back(event) {
            Some(event) => event,
            None => return,
        };
        let (kind, detail) = mark(&event);
        self.log.mark(self.now_us, kind, detail);
        let aims = matches!(
            event,
            Event::Timer { .. }
                | Event::Inner {
                    out: ScanOut::News(..),
                    ..
                }
                | Event::Deliver {
                    packet: Packet::Message(_),
                    ..
                }
                | Event::Start(_)
                | Event::Aim(_)
        );
        match event {
            Event::Timer { pid, boot } => self.timer(pid, boot),
            Event::Tick { node, boot } => self.tick(node, boot),
            Event::Ring { node, boot } => self.ring(node, boot),
            Event::Inner { node, boot, out } => self.inner(node, boot, out),
            Event::Deliver { to, packet } => self.deliver(to, packet),
            Event::Field { boot } => self.field(boot),
            Event::Write { boot, mc, outputs } => self.written(boot, mc, &outputs),
            Event::Wall { pid, boot } => self.tell_wall(pid, boot),
            Event::Copy => self.copy_repository(),
            Event::Aim(n) => self.wait_for_stage(n),
            Event::Extend => self.extend(),
            Event::Tokens { observer, subject } => self.tokens(observer, subject),
            Event::Start(pid) => self.start(pid),
            Event::Fault(n) => self.fault(n),
            Event::Ends(n) => self.ends(n),
            Event::Ask { id } => self.ask_again(id),
            Event::Quiet => self.begin_quiet(),
            Event::Operator => self.operator(),
            Event::Check => self.check(),
        }
        if aims && !self.aimed.is_empty() {
            self.take_aim();
        }
    }

    /// What happens to a process that stands still waits until it goes on.
    fn held_back(&mut self, event: Event) -> Option<Event> {
        let pid = match &event {
            Event::Timer { pid, .. } | Event::Wall { pid, .. } => *pid,
            Event::Tick { node, .. } | Event::Ring { node, .. } | Event::Inner { node, .. } => {
                Pid::Node(*node)
            }
            Event::Deliver { to, .. } => *to,
            Event::Field { .. } => Pid::Gateway,
            Event::Tokens { observer, .. } => *observer,
            _ => return Some(event),
        };
        match self.lives.get_mut(&pid) {
            Some(life) if life.frozen_us.is_some() => {
                if life.stalled.len() < STALLED_MAX || !matches!(event, Event::Deliver { .. }) {
                    life.stalled.push(event);
                }
                None
            }
            _ => Some(event),
        }
    }

    // ---- time of the agents

    fn timer(&mut self, pid: Pid, boot: BootId) {
        if !self.is_this(pid, boot) {
            return;
        }
        let now_us = self.now_us;
        let Some(life) = self.lives.get_mut(&pid) else {
            return;
        };
        if life.scheduled_us.is_none_or(|at| at > now_us) {
            return; // an earlier deadline has replaced this one
        }
        life.scheduled_us = None;
        let now = self.local(pid);
        match pid {
            Pid::Manager | Pid::Rival => {
                if let Some(manager) = &mut self.side(pid).agents {
                    manager.handle_timeout(now);
                }
                self.carry_out_manager(pid);
            }
            Pid::Gateway => {
                if let Some(gateway) = &mut self.gateway {
                    gateway.handle_timeout(now);
                }
                self.carry_out_gateway();
            }
            Pid::Node(n) => {
                if let Some(node) = &mut self.nodes[n] {
                    node.agents.handle_timeout(now);
                }
                self.carry_out_node(n);
            }
            Pid::Operator => {}
        }
    }

    /// Looks after a process's next deadline; after each input.
    pub(super) fn arm(&mut self, pid: Pid) {
        let deadline = match pid {
            Pid::Manager => self.managing.agents.as_ref().and_then(Agent::poll_timeout),
            Pid::Rival => self.rival.agents.as_ref().and_then(Agent::poll_timeout),
            Pid::Gateway => self.gateway.as_ref().and_then(Agent::poll_timeout),
            Pid::Node(n) => self.nodes[n].as_ref().and_then(|b| b.agents.poll_timeout()),
            Pid::Operator => None,
        };
        let Some((at, _)) = deadline else {
            return;
        };
        let at_us = self.global(pid, at);
        if let Some(life) = self.lives.get_mut(&pid)
            && life.scheduled_us.is_none_or(|s| at_us < s)
        {
            life.scheduled_us = Some(at_us);
            let boot = life.boot;
            self.queue.push(at_us, Event::Timer { pid, boot });
        }
    }

    /// Whether the process dies before its next output.
    pub(super) fn is_doomed(&mut self, pid: Pid) -> bool {
        match self.lives.get_mut(&pid).and_then(|l| l.doomed.as_mut()) {
            Some(0) => true,
            Some(left) => {
                *left -= 1;
                false
            }
            None => false,
        }
    }

    // ---- network

    /// Sends a message where it is addressed to.
    pub(super) fn send(&mut self, from: Pid, envelope: Envelope) {
        let Some(to) = self.pid_of(&envelope.to.process()) else {
            return;
        };
        self.note(|| format!("{from:<8} to {to}: {}", words(&envelope)));
        self.transmit(from, to, Packet::Message(Box::new(envelope)));
    }

    /// Both managers of a cell listen at the same place.
    pub(super) fn transmit(&mut self, from: Pid, to: Pid, packet: Packet) {
        if to == Pid::Manager && self.rival.agents.is_some() {
            self.put_on_link(from, Pid::Rival, packet.clone());
        }
        self.put_on_link(from, to, packet);
    }

    /// As [`World::transmit`], and later.
    pub(super) fn send_late(&mut self, from: Pid, to: Pid, packet: Packet, by_us: u64) {
        let arrivals = self.network.arrivals(from, to, self.now_us);
        for at_us in arrivals.into_iter().flatten() {
            let packet = packet.clone();
            self.queue
                .push(at_us + by_us, Event::Deliver { to, packet });
        }
    }

    fn put_on_link(&mut self, from: Pid, to: Pid, packet: Packet) {
        let arrivals = self.network.arrivals(from, to, self.now_us);
        for at_us in arrivals.into_iter().flatten() {
            let packet = packet.clone();
            self.queue.push(at_us, Event::Deliver { to, packet });
        }
    }

    fn deliver(&mut self, to: Pid, packet: Packet) {
        if !self.is_up(to) {
            return;
        }
        match (to, packet) {
            (Pid::Manager | Pid::Rival, Packet::Message(m)) => {
                self.manager_input(to, Input::Message(*m));
            }
            (Pid::Manager | Pid::Rival, Packet::Image(i)) => {
                self.manager_input(to, Input::Image(i));
            }
            (Pid::Gateway, Packet::Message(m)) => self.gateway_message(*m),
            (Pid::Gateway, Packet::Frame(_, bytes)) => self.gateway_frame(bytes),
            (Pid::Node(n), Packet::Message(m)) => self.node_input(n, Input::Message(*m)),
            (Pid::Node(n), Packet::Image(i)) => self.node_image(n, i),
            (Pid::Node(n), Packet::Frame(mc, bytes)) => self.node_frame(n, mc, &bytes),
            (Pid::Operator, Packet::Message(m)) => {
                self.note(|| format!("operator hears: {}", words(&m)));
                self.answered(&m);
            }
            (Pid::Manager | Pid::Rival, Packet::Frame(..))
            | (Pid::Gateway, Packet::Image(_))
            | (Pid::Operator, _) => {}
        }
    }

    /// An event of a process on its way to the manager.
    pub(super) fn report(&mut self, from: Pid, agent: AgentId, event: fam_proto::Event) {
        let envelope = Envelope {
            from: agent,
            boot: self.boot_of(from),
            to: AgentId::Manager,
            body: Message::Event(event),
        };
        self.send(from, envelope);
    }
}

/// What an event adds to the digest.
fn mark(event: &Event) -> (u64, u64) {
    let pid = |pid: &Pid| match pid {
        Pid::Manager => 1,
        Pid::Gateway => 2,
        Pid::Operator => 3,
        Pid::Rival => 4,
        Pid::Node(n) => 5 + *n as u64,
    };
    match event {
        Event::Timer { pid: p, boot } => (1, pid(p) ^ boot.0),
        Event::Tick { node, boot } => (2, *node as u64 ^ boot.0),
        Event::Ring { node, boot } => (19, *node as u64 ^ boot.0),
        Event::Inner { node, out, .. } => (3, *node as u64 ^ (out.kind() << 8)),
        Event::Deliver { to, packet } => match packet {
            Packet::Message(m) => (4, pid(to) ^ m.boot.0),
            Packet::Frame(mc, bytes) => (
                5,
                pid(to) ^ ((*mc as u64) << 8) ^ ((bytes.len() as u64) << 16),
            ),
            Packet::Image(image) => (6, pid(to) ^ image.number.0),
        },
        Event::Field { boot } => (7, boot.0),
        Event::Tokens { observer, subject } => (8, pid(observer) ^ (pid(subject) << 8)),
        Event::Start(p) => (9, pid(p)),
        Event::Fault(n) => (10, *n as u64),
        Event::Ends(n) => (11, *n as u64),
        Event::Quiet => (12, 0),
        Event::Operator => (13, 0),
        Event::Check => (14, 0),
        Event::Ask { id } => (15, *id),
        Event::Write { boot, mc, .. } => (16, boot.0 ^ *mc as u64),
        Event::Wall { pid: p, boot } => (17, pid(p) ^ boot.0),
        Event::Copy => (18, 0),
        // Not in a recorded schedule.
        Event::Aim(_) | Event::Extend => (0, 0),
    }
}

/// A message in one line.
pub(super) fn words(envelope: &Envelope) -> String {
    let mut text = format!("{:?}", envelope.body);
    if text.len() > 400 {
        let mut end = 400;
        while !text.is_char_boundary(end) {
            end -= 1;
        }
        text.truncate(end);
        text.push('…');
    }
    text
}
