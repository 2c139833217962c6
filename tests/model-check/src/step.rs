//! A step: what comes of something that happens.

use crate::action::Action;
use crate::cell::Cell;
use crate::plc::Frame;
use crate::properties::Violation;
use crate::state::{Body, Bug, Flight, PIDS, Packet, Pid, Process, State};
use fam_agents::node::NodeLocal;
use fam_gateway_core::GatewayLocal;
use fam_proto::access::McNews;
use fam_proto::agent::{Agent, Input};
use fam_proto::{
    AgentId, BootId, Command, CommandKind, Envelope, InputImage, Message, ProcessId, encode_frame,
};
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

/// What the steps are taken in.
#[derive(Debug, Clone, Copy)]
pub struct World<'a> {
    /// The cell.
    pub cell: &'a Cell,
    /// A planted bug.
    pub bug: Option<Bug>,
}

/// A frame of one node on its way to the gateway, at most.
const FRAMES_MAX: usize = 1;

impl World<'_> {
    /// Whether the MC that runs on a node may scan: not while a frame of it is late.
    fn can_scan(&self, state: &State, node: usize) -> bool {
        let of_it =
            |f: &&Flight| f.from == Pid::Node(node) && matches!(*f.packet, Packet::Frame(_));
        let on_their_way = state.flights.iter().filter(of_it).count();
        state
            .node(node)
            .is_some_and(|(_, plc)| plc.active.is_some() && on_their_way < FRAMES_MAX)
    }

    /// The state to begin with, with the planted bug in it.
    #[must_use]
    pub fn prepared(&self, mut state: State) -> State {
        if self.bug == Some(Bug::OwnerUnseen)
            && let Some(process) = &mut state.processes[Pid::Gateway.at()]
        {
            let process = Arc::make_mut(process);
            let now = process.now;
            let tokens = process.tokens.clone();
            if let Body::Gateway(gateway) = &mut process.body {
                for (pid, boot) in tokens {
                    if let Pid::Node(n) = pid {
                        let id = ProcessId::Node(self.cell.controllers[n].clone());
                        gateway.handle(peer(id, boot, false), now);
                    }
                }
            }
            process.refresh();
        }
        state
    }

    /// What comes of an action.
    ///
    /// # Errors
    /// The promise that it breaks.
    pub fn step(&self, state: &State, action: &Action) -> Result<State, Violation> {
        let mut run = Run {
            world: *self,
            state: state.clone(),
            inbox: VecDeque::new(),
            dies_after: None,
            changed: BTreeSet::new(),
        };
        match *action {
            Action::Deliver(n) => {
                let flight = run.state.flights.remove(n);
                run.deliver(&flight)?;
            }
            Action::Hold(n) => run.state.flights[n].held = true,
            Action::Lose(n) => {
                run.state.flights.remove(n);
            }
            Action::Repeat(n) => {
                run.state.faults.repeats -= 1;
                run.state.flights[n].held = true;
                let flight = run.state.flights[n].clone();
                run.deliver(&flight)?;
            }
            Action::DeliverAndCrash(n) => {
                run.state.faults.crashes -= 1;
                let flight = run.state.flights.remove(n);
                run.dies_after = Some((flight.to, 1));
                run.deliver(&flight)?;
                run.crash(flight.to);
            }
            Action::Image => {
                if let Some(image) = run.state.image.take() {
                    run.image(Pid::Manager, image)?;
                }
            }
            Action::Time(pid) => run.time(pid)?,
            Action::TimeAndCrash(pid) => {
                run.state.faults.crashes -= 1;
                run.dies_after = Some((pid, 1));
                run.time(pid)?;
                run.crash(pid);
            }
            Action::Late(node) => {
                run.state.faults.late -= 1;
                run.state.late[node] = true;
            }
            Action::Token(observer, subject) => run.token(observer, subject)?,
            Action::Crash(pid) => {
                run.state.faults.crashes -= 1;
                run.crash(pid);
            }
            Action::Start(pid) => {
                run.state.faults.restarts = run.state.faults.restarts.saturating_sub(1);
                run.start(pid)?;
            }
            Action::Cut(a, b) => {
                run.state.faults.cuts -= 1;
                run.state.cut = Some((a, b));
            }
            Action::Mend => run.state.cut = None,
            Action::Move(node) => {
                run.state.faults.moves -= 1;
                run.operator(node)?;
            }
        }
        run.settle()?;
        Ok(run.state)
    }
}

/// A step while it is taken.
pub(crate) struct Run<'a> {
    pub(crate) world: World<'a>,
    pub(crate) state: State,
    /// Messages that are delivered within the step: what only keeps the books.
    pub(crate) inbox: VecDeque<(Pid, Envelope)>,
    /// Who dies in this step, after so many outputs.
    pub(crate) dies_after: Option<(Pid, u32)>,
    /// Processes whose words have to be taken anew.
    pub(crate) changed: BTreeSet<Pid>,
}

impl Run<'_> {
    pub(crate) fn cell(&self) -> &Cell {
        self.world.cell
    }

    pub(crate) fn process_id(&self, pid: Pid) -> ProcessId {
        match pid {
            Pid::Manager => ProcessId::Manager,
            Pid::Gateway => ProcessId::Gateway(self.cell().gateway.clone()),
            Pid::Node(n) => ProcessId::Node(self.cell().controllers[n].clone()),
        }
    }

    pub(crate) fn pid_of(&self, process: &ProcessId) -> Option<Pid> {
        PIDS.into_iter()
            .find(|pid| self.process_id(*pid) == *process)
    }

    pub(crate) fn change(&mut self, pid: Pid, change: impl FnOnce(&mut Process)) {
        if let Some(process) = &mut self.state.processes[pid.at()] {
            self.changed.insert(pid);
            change(Arc::make_mut(process));
        }
    }

    // ---- what comes in

    fn deliver(&mut self, flight: &Flight) -> Result<(), Violation> {
        match &*flight.packet {
            Packet::Message(envelope) => self.message(flight.to, (**envelope).clone()),
            Packet::Frame(frame) => self.frame(frame),
        }
    }

    pub(crate) fn message(&mut self, to: Pid, envelope: Envelope) -> Result<(), Violation> {
        self.change(to, |process| {
            let now = process.now;
            match &mut process.body {
                Body::Manager(agents) => agents.handle(Input::Message(envelope), now),
                Body::Gateway(gateway) => gateway.handle(Input::Message(envelope), now),
                Body::Node(agents, ..) => agents.handle(Input::Message(envelope), now),
            }
        });
        self.carry_out(to)
    }

    pub(crate) fn frame(&mut self, frame: &Frame) -> Result<(), Violation> {
        let outputs = [1; crate::plc::OUTPUTS_LEN];
        let Ok(bytes) = encode_frame(&frame.header, &outputs, &frame.state) else {
            return Ok(());
        };
        self.change(Pid::Gateway, |process| {
            let now = process.now;
            if let Body::Gateway(gateway) = &mut process.body {
                let frame = GatewayLocal::Frame(Arc::from(bytes));
                gateway.handle(Input::Local(frame), now);
            }
        });
        self.carry_out(Pid::Gateway)
    }

    pub(crate) fn image(&mut self, pid: Pid, mut image: Arc<InputImage>) -> Result<(), Violation> {
        let mc = self.cell().mc.clone();
        if pid == Pid::Manager {
            // It overtakes none, and none overtakes it: only that it is the newest counts.
            Arc::make_mut(&mut image).number = self.world.image_number(&self.state);
        }
        let mut news = None;
        let me = match pid {
            Pid::Node(n) => self
                .state
                .process(pid)
                .map(|p| self.cell().owner(n, p.boot)),
            _ => None,
        };
        self.change(pid, |process| {
            let now = process.now;
            match &mut process.body {
                Body::Manager(agents) => agents.handle(Input::Image(Arc::clone(&image)), now),
                Body::Gateway(_) => {}
                Body::Node(agents, plc) => {
                    if let Some(me) = &me {
                        news = plc.image(&image, &mc, me);
                    }
                    agents.handle(Input::Image(Arc::clone(&image)), now);
                }
            }
        });
        self.carry_out(pid)?;
        self.news(pid, news)?;
        // The scan thread takes each new image.
        match pid {
            Pid::Node(n) => self.scan(n, &image),
            _ => Ok(()),
        }
    }

    pub(crate) fn news(&mut self, pid: Pid, news: Option<McNews>) -> Result<(), Violation> {
        let Some(news) = news else { return Ok(()) };
        let mc = self.cell().mc.clone();
        self.local(pid, NodeLocal::Mc { mc, news })
    }

    pub(crate) fn local(&mut self, pid: Pid, local: NodeLocal) -> Result<(), Violation> {
        self.change(pid, |process| {
            let now = process.now;
            if let Body::Node(agents, ..) = &mut process.body {
                agents.handle(Input::Local(local), now);
            }
        });
        self.carry_out(pid)
    }

    /// The MC on a node scans, if it may.
    pub(crate) fn scan(&mut self, node: usize, image: &InputImage) -> Result<(), Violation> {
        if !self.world.can_scan(&self.state, node) {
            return Ok(());
        }
        let pid = Pid::Node(node);
        let mc = self.cell().mc.clone();
        let Some(boot) = self.state.process(pid).map(|p| p.boot) else {
            return Ok(());
        };
        let me = self.cell().owner(node, boot);
        let mut frame = None;
        self.change(pid, |process| {
            if let Body::Node(_, plc) = &mut process.body {
                frame = plc.scan(&mc, &me, image);
            }
        });
        let Some(frame) = frame else { return Ok(()) };
        // The other node has it at once, or not at all; the gateway gets it when it comes.
        let other = Pid::Node(1 - node);
        let mut held = None;
        if self.state.connected(pid, other) {
            self.change(other, |process| {
                if let Body::Node(_, plc) = &mut process.body {
                    held = plc.frame(&frame);
                }
            });
        }
        let late = std::mem::take(&mut self.state.late[node]);
        if late || !self.state.connected(pid, Pid::Gateway) {
            let packet = Arc::new(Packet::Frame(Box::new(frame.clone())));
            let to = Pid::Gateway;
            self.state.flights.push(Flight {
                from: pid,
                to,
                packet,
                held: true,
            });
        } else {
            self.frame(&frame)?;
        }
        if let Some(id) = held {
            self.local(other, NodeLocal::Held { mc: mc.clone(), id })?;
        }
        if self.state.connected(pid, other)
            && let Some(successor) = frame.header.released_to
        {
            self.news(other, Some(McNews::Handed(successor)))?;
        }
        Ok(())
    }

    fn operator(&mut self, node: usize) -> Result<(), Violation> {
        let command = Envelope {
            from: AgentId::Client(1),
            boot: BootId(1),
            to: AgentId::Manager,
            body: Message::Command(Command {
                id: 1,
                what: CommandKind::Move {
                    mc: self.cell().mc.clone(),
                    to: self.cell().controllers[node].clone(),
                    force: false,
                },
            }),
        };
        self.message(Pid::Manager, command)
    }
}

pub(crate) fn peer<L>(process: ProcessId, boot: BootId, alive: bool) -> Input<L> {
    Input::Peer {
        process,
        boot,
        alive,
    }
}
