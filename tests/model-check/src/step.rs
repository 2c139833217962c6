//! What can happen next in a state, and what comes of it.

use crate::cell::Cell;
use crate::plc::Frame;
use crate::properties::Violation;
use crate::state::{Body, Bug, Flight, PIDS, Packet, Pid, Process, State};
use fam_agents::node::{NodeAct, NodeLocal};
use fam_gateway_core::{GatewayAct, GatewayLocal, MemoryRecords, RecordWrite, Why};
use fam_proto::access::{McAct, McNews, Start, StateSource};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{
    AgentId, BootId, Command, CommandKind, Envelope, Epoch, InputImage, McOutcome, Message, Now,
    OrderKind, ProcessId, RecordState, RepoWrite, encode_frame,
};
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

/// Something that can happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// A packet arrives, by its place.
    Deliver(usize),
    /// A packet arrives, and once more later.
    Repeat(usize),
    /// A packet arrives, and the receiver dies after its first output.
    DeliverAndCrash(usize),
    /// The image on its way to a process arrives.
    Image(Pid),
    /// The next deadline of a process comes, on its clock.
    Time(Pid),
    /// The same, and the process dies after its first output.
    TimeAndCrash(Pid),
    /// The next frame of a node will take its time.
    Late(usize),
    /// An observer's view of another process's liveliness token catches up.
    Token(Pid, Pid),
    /// A process dies.
    Crash(Pid),
    /// A process starts.
    Start(Pid),
    /// A connection is cut.
    Cut(Pid, Pid),
    /// It is mended.
    Mend,
    /// An operator orders a move to a node.
    Move(usize),
}

impl Action {
    /// Whether it takes a fault from the budget.
    #[must_use]
    pub fn is_fault(&self) -> bool {
        matches!(
            self,
            Action::Repeat(_)
                | Action::DeliverAndCrash(_)
                | Action::TimeAndCrash(_)
                | Action::Crash(_)
                | Action::Cut(..)
                | Action::Late(_)
                | Action::Move(_)
        )
    }
}

/// What the steps are taken in.
#[derive(Debug, Clone, Copy)]
pub struct World<'a> {
    /// The cell.
    pub cell: &'a Cell,
    /// A planted bug.
    pub bug: Option<Bug>,
}

/// A frame of one node on its way to the gateway, at most; a newer one takes the place of the older, which is then lost.
const FRAMES_MAX: usize = 1;

impl World<'_> {
    /// Everything that can happen.
    #[must_use]
    pub fn actions(&self, state: &State) -> Vec<Action> {
        let mut actions = Vec::new();
        for (n, flight) in state.flights.iter().enumerate() {
            let there = state.process(flight.to).is_some();
            if !there || !state.connected(flight.from, flight.to) {
                continue; // it waits, or never arrives
            }
            actions.push(Action::Deliver(n));
            if state.faults.repeats > 0 && matches!(*flight.packet, Packet::Message(_)) {
                actions.push(Action::Repeat(n));
            }
            if state.faults.crashes > 0 && !matches!(flight.to, Pid::Node(_)) {
                actions.push(Action::DeliverAndCrash(n));
            }
        }
        for pid in state.images.keys() {
            if state.process(*pid).is_some() && state.connected(Pid::Gateway, *pid) {
                actions.push(Action::Image(*pid));
            }
        }
        for observer in PIDS {
            for subject in PIDS {
                if self.token_differs(state, observer, subject) {
                    actions.push(Action::Token(observer, subject));
                }
            }
        }
        for node in [0, 1] {
            let runs = state
                .process(Pid::Node(node))
                .is_some_and(|p| matches!(&p.body, Body::Node(_, plc, _) if plc.active.is_some()));
            if state.faults.late > 0 && runs {
                actions.push(Action::Late(node));
            }
        }
        for (_, pid, why) in self.deadlines(state) {
            // The reports of a node that is heard come when the manager's clock would miss them.
            if matches!(pid, Pid::Node(n) if why == "report" && !self.is_missed(state, n)) {
                continue;
            }
            actions.push(Action::Time(pid));
            if state.faults.crashes > 0 && pid == Pid::Manager {
                actions.push(Action::TimeAndCrash(pid));
            }
        }
        if state.faults.crashes > 0 {
            actions.extend(state.processes.keys().map(|pid| Action::Crash(*pid)));
        }
        if state.faults.restarts > 0 {
            let down = PIDS.iter().filter(|pid| state.process(**pid).is_none());
            actions.extend(down.map(|pid| Action::Start(*pid)));
        }
        if state.faults.cuts > 0 && state.cut.is_none() {
            for (n, a) in PIDS.iter().enumerate() {
                for b in &PIDS[n + 1..] {
                    // Two nodes say nothing to each other but frames, and those the gateway has.
                    if !matches!((a, b), (Pid::Node(_), Pid::Node(_))) {
                        actions.push(Action::Cut(*a, *b));
                    }
                }
            }
        }
        if state.cut.is_some() {
            actions.push(Action::Mend);
        }
        if state.faults.moves > 0 && state.process(Pid::Manager).is_some() {
            actions.extend([Action::Move(0), Action::Move(1)]);
        }
        actions
    }

    /// The next deadline of each process that has one.
    pub fn deadlines<'s>(
        &self,
        state: &'s State,
    ) -> impl Iterator<Item = (Now, Pid, &'static str)> + 's {
        state.processes.iter().filter_map(|(pid, process)| {
            let deadline = match &process.body {
                Body::Manager(agents) => agents.poll_timeout(),
                Body::Gateway(gateway) => gateway.poll_timeout(),
                Body::Node(agents, ..) => agents.poll_timeout(),
            };
            deadline.map(|(at, why)| (at.max(process.now), *pid, why))
        })
    }

    /// Whether the manager does not hear a node that it could hear.
    fn is_missed(&self, state: &State, node: usize) -> bool {
        let Some(Body::Manager(agents)) = state.process(Pid::Manager).map(|p| &p.body) else {
            return false;
        };
        let there = agents.view().controllers.get(&self.cell.controllers[node]);
        let boot = state.process(Pid::Node(node)).map(|p| p.boot);
        let heard = there.is_some_and(|c| c.is_up() && c.owner().map(|o| o.boot) == boot);
        state.connected(Pid::Manager, Pid::Node(node)) && !heard
    }

    /// Whether the MC that runs on a node may scan.
    #[must_use]
    pub fn can_scan(&self, state: &State, node: usize) -> bool {
        let Some(process) = state.process(Pid::Node(node)) else {
            return false;
        };
        let Body::Node(_, plc, Some(image)) = &process.body else {
            return false;
        };
        let Some(active) = &plc.active else {
            return false;
        };
        let on_its_way = state
            .flights
            .iter()
            .filter(|f| f.from == Pid::Node(node) && matches!(*f.packet, Packet::Frame(_)))
            .count();
        // A scan on the image of the last one is a slow tick and nothing new.
        let newer = active
            .last
            .as_ref()
            .is_none_or(|f| f.header.released_to.is_some() || f.header.image < image.number);
        on_its_way < FRAMES_MAX && newer
    }

    /// The state to begin with, with the planted bug in it.
    #[must_use]
    pub fn prepared(&self, mut state: State) -> State {
        if self.bug == Some(Bug::OwnerUnseen)
            && let Some(process) = state.processes.get_mut(&Pid::Gateway)
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

    fn token_differs(&self, state: &State, observer: Pid, subject: Pid) -> bool {
        let watches = match observer {
            Pid::Manager | Pid::Gateway => observer != subject,
            Pid::Node(_) => subject == Pid::Manager,
        };
        let Some(process) = state.process(observer) else {
            return false;
        };
        if !watches {
            return false;
        }
        let is = self.boot_seen(state, observer, subject);
        let seen: Vec<BootId> = seen(process, subject);
        match is {
            Some(boot) => seen != [boot],
            None => !seen.is_empty(),
        }
    }

    fn boot_seen(&self, state: &State, observer: Pid, subject: Pid) -> Option<BootId> {
        let there = state.process(subject)?;
        state.connected(observer, subject).then_some(there.boot)
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
            Action::Repeat(n) => {
                run.state.faults.repeats -= 1;
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
            Action::Image(pid) => {
                if let Some(image) = run.state.images.remove(&pid) {
                    run.image(pid, image)?;
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

fn seen(process: &Process, subject: Pid) -> Vec<BootId> {
    let tokens = process.tokens.iter().filter(|(pid, _)| *pid == subject);
    tokens.map(|(_, boot)| *boot).collect()
}

/// A step while it is taken.
struct Run<'a> {
    world: World<'a>,
    state: State,
    /// Messages that are delivered within the step: what only keeps the books.
    inbox: VecDeque<(Pid, Envelope)>,
    /// Who dies in this step, after so many outputs.
    dies_after: Option<(Pid, u32)>,
    /// Processes whose words have to be taken anew.
    changed: BTreeSet<Pid>,
}

impl Run<'_> {
    fn cell(&self) -> &Cell {
        self.world.cell
    }

    fn process_id(&self, pid: Pid) -> ProcessId {
        match pid {
            Pid::Manager => ProcessId::Manager,
            Pid::Gateway => ProcessId::Gateway(self.cell().gateway.clone()),
            Pid::Node(n) => ProcessId::Node(self.cell().controllers[n].clone()),
        }
    }

    fn pid_of(&self, process: &ProcessId) -> Option<Pid> {
        PIDS.into_iter()
            .find(|pid| self.process_id(*pid) == *process)
    }

    fn change(&mut self, pid: Pid, change: impl FnOnce(&mut Process)) {
        if let Some(process) = self.state.processes.get_mut(&pid) {
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

    fn message(&mut self, to: Pid, envelope: Envelope) -> Result<(), Violation> {
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

    fn frame(&mut self, frame: &Frame) -> Result<(), Violation> {
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

    fn image(&mut self, pid: Pid, image: Arc<InputImage>) -> Result<(), Violation> {
        let mc = self.cell().mc.clone();
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
                Body::Manager(agents) => agents.handle(Input::Image(image), now),
                Body::Gateway(_) => {}
                Body::Node(agents, plc, newest) => {
                    if let Some(me) = &me {
                        news = plc.image(&image, &mc, me);
                    }
                    *newest = Some(Arc::clone(&image));
                    agents.handle(Input::Image(image), now);
                }
            }
        });
        self.carry_out(pid)?;
        self.news(pid, news)?;
        // The scan thread takes each new image.
        match pid {
            Pid::Node(n) => self.scan(n),
            _ => Ok(()),
        }
    }

    fn news(&mut self, pid: Pid, news: Option<McNews>) -> Result<(), Violation> {
        let Some(news) = news else { return Ok(()) };
        let mc = self.cell().mc.clone();
        self.local(pid, NodeLocal::Mc { mc, news })
    }

    fn local(&mut self, pid: Pid, local: NodeLocal) -> Result<(), Violation> {
        self.change(pid, |process| {
            let now = process.now;
            if let Body::Node(agents, ..) = &mut process.body {
                agents.handle(Input::Local(local), now);
            }
        });
        self.carry_out(pid)
    }

    fn time(&mut self, pid: Pid) -> Result<(), Violation> {
        let due = self
            .world
            .deadlines(&self.state)
            .find(|(_, p, _)| *p == pid);
        let Some((at, _, why)) = due else {
            return Ok(());
        };
        self.change(pid, |process| process.now = at);
        // Who is up and connected is not late by a multiple of its own period: it speaks before it is missed.
        match why {
            "an image is due" => self.hear_gateway()?,
            "a report is due" => self.hear_nodes()?,
            _ => {}
        }
        self.change(pid, |process| match &mut process.body {
            Body::Manager(agents) => agents.handle_timeout(at),
            Body::Gateway(gateway) => gateway.handle_timeout(at),
            Body::Node(agents, ..) => agents.handle_timeout(at),
        });
        self.carry_out(pid)
    }

    fn hear_gateway(&mut self) -> Result<(), Violation> {
        let up = self.state.process(Pid::Gateway).is_some();
        if !up || !self.state.connected(Pid::Manager, Pid::Gateway) {
            return Ok(());
        }
        self.time(Pid::Gateway)?;
        match self.state.images.remove(&Pid::Manager) {
            Some(image) => self.image(Pid::Manager, image),
            None => Ok(()),
        }
    }

    fn hear_nodes(&mut self) -> Result<(), Violation> {
        for n in [0, 1] {
            let pid = Pid::Node(n);
            let reports = self
                .world
                .deadlines(&self.state)
                .any(|(_, p, why)| p == pid && why == "report");
            if reports && self.state.connected(Pid::Manager, pid) {
                self.time(pid)?;
                self.take_inbox()?;
            }
        }
        Ok(())
    }

    /// The MC on a node scans, if it may.
    fn scan(&mut self, node: usize) -> Result<(), Violation> {
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
            if let Body::Node(_, plc, Some(image)) = &mut process.body {
                frame = plc.scan(&mc, &me, image);
            }
        });
        let Some(frame) = frame else { return Ok(()) };
        // The other node has it at once, or not at all; the gateway gets it when it comes.
        let other = Pid::Node(1 - node);
        let mut held = None;
        if self.state.connected(pid, other) {
            self.change(other, |process| {
                if let Body::Node(_, plc, _) = &mut process.body {
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

    fn token(&mut self, observer: Pid, subject: Pid) -> Result<(), Violation> {
        let is = self.world.boot_seen(&self.state, observer, subject);
        let Some(process) = self.state.process(observer) else {
            return Ok(());
        };
        let mut told: Vec<(BootId, bool)> = seen(process, subject)
            .into_iter()
            .filter(|boot| Some(*boot) != is)
            .map(|boot| (boot, false))
            .collect();
        if let Some(boot) = is
            && !seen(process, subject).contains(&boot)
        {
            told.push((boot, true));
        }
        for (boot, alive) in told {
            let id = self.process_id(subject);
            self.change(observer, |process| {
                if alive {
                    process.tokens.insert((subject, boot));
                } else {
                    process.tokens.remove(&(subject, boot));
                }
                let now = process.now;
                let (process_id, boot) = (id, boot);
                match &mut process.body {
                    Body::Manager(agents) => {
                        agents.handle(peer(process_id, boot, alive), now);
                    }
                    Body::Gateway(gateway) => {
                        gateway.handle(peer(process_id, boot, alive), now);
                    }
                    Body::Node(agents, ..) => {
                        agents.handle(peer(process_id, boot, alive), now);
                    }
                }
            });
            self.carry_out(observer)?;
        }
        Ok(())
    }

    fn crash(&mut self, pid: Pid) {
        self.state.processes.remove(&pid);
        // Images to it, and the newest of it, are gone with it.
        self.state.images.remove(&pid);
        if pid == Pid::Gateway && self.world.bug == Some(Bug::RecordsForgotten) {
            self.state.records = Arc::new(MemoryRecords::default());
        }
    }

    fn start(&mut self, pid: Pid) -> Result<(), Violation> {
        self.state.boots += 1;
        let boot = BootId(self.state.boots);
        if pid == Pid::Gateway {
            self.state.runs += 1;
        }
        let process = self.world.cell.start(
            pid,
            boot,
            &self.state.repository,
            &self.state.records,
            self.state.runs,
        );
        self.state.processes.insert(pid, Arc::new(process));
        self.carry_out(pid)
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

    // ---- what comes out

    fn is_dead(&mut self, pid: Pid) -> bool {
        match &mut self.dies_after {
            Some((dying, left)) if *dying == pid => {
                if *left == 0 {
                    return true;
                }
                *left -= 1;
                false
            }
            _ => false,
        }
    }

    fn carry_out(&mut self, pid: Pid) -> Result<(), Violation> {
        match pid {
            Pid::Manager => self.carry_out_manager(),
            Pid::Gateway => self.carry_out_gateway(),
            Pid::Node(n) => self.carry_out_node(n),
        }
    }

    fn carry_out_manager(&mut self) -> Result<(), Violation> {
        loop {
            let mut output = None;
            self.change(Pid::Manager, |process| {
                if let Body::Manager(agents) = &mut process.body {
                    output = agents.poll_output();
                }
            });
            let Some(output) = output else { return Ok(()) };
            match output {
                // The history and what is only remembered for people: nothing hangs on it.
                Output::Persist {
                    ticket,
                    write: RepoWrite::Event(_) | RepoWrite::Registered(_),
                } => self.manager_persisted(ticket),
                Output::Act(_) | Output::Event(_) => {}
                Output::Persist { ticket, write } => {
                    if self.is_dead(Pid::Manager) {
                        return Ok(());
                    }
                    Arc::make_mut(&mut self.state.repository).apply(&write);
                    self.manager_persisted(ticket);
                }
                Output::Send(envelope) => {
                    if self.is_dead(Pid::Manager) {
                        return Ok(());
                    }
                    self.ordered(&envelope)?;
                    self.send(Pid::Manager, envelope);
                }
            }
        }
    }

    fn manager_persisted(&mut self, ticket: u64) {
        self.change(Pid::Manager, |process| {
            let now = process.now;
            if let Body::Manager(agents) = &mut process.body {
                let result = Ok(());
                agents.handle(Input::Persisted { ticket, result }, now);
            }
        });
    }

    fn ordered(&mut self, envelope: &Envelope) -> Result<(), Violation> {
        let (Message::Order(order), AgentId::Component(to, _)) = (&envelope.body, &envelope.to)
        else {
            return Ok(());
        };
        let OrderKind::Activate { epoch, .. } = order.kind else {
            return Ok(());
        };
        let durable = self.state.repository.epochs.get(&order.mc).copied();
        let owner = fam_proto::Owner {
            controller: to.clone(),
            boot: BootId(0),
        };
        let new = Arc::make_mut(&mut self.state.facts).ordered(
            epoch,
            &owner,
            durable.unwrap_or(Epoch(0)),
        )?;
        self.state.activations += u8::from(new);
        Ok(())
    }

    fn carry_out_gateway(&mut self) -> Result<(), Violation> {
        loop {
            let mut output = None;
            self.change(Pid::Gateway, |process| {
                if let Body::Gateway(gateway) = &mut process.body {
                    output = gateway.poll_output();
                }
            });
            let Some(output) = output else { return Ok(()) };
            match output {
                Output::Act(GatewayAct::ReadField) => {
                    self.gateway_local(GatewayLocal::Field(vec![]))
                }
                Output::Act(GatewayAct::PublishImage(image)) => self.publish(&image)?,
                Output::Event(_) | Output::Act(GatewayAct::Left) => {}
                Output::Persist { ticket, write } => {
                    if self.is_dead(Pid::Gateway) {
                        return Ok(());
                    }
                    self.record(ticket, write)?;
                }
                Output::Act(GatewayAct::ApplyOutputs { why, .. }) => {
                    if self.is_dead(Pid::Gateway) {
                        return Ok(());
                    }
                    self.apply(&why)?;
                }
                Output::Send(envelope) => {
                    if self.is_dead(Pid::Gateway) {
                        return Ok(());
                    }
                    self.send(Pid::Gateway, envelope);
                }
            }
        }
    }

    fn gateway_local(&mut self, local: GatewayLocal) {
        self.change(Pid::Gateway, |process| {
            let now = process.now;
            if let Body::Gateway(gateway) = &mut process.body {
                gateway.handle(Input::Local(local), now);
            }
        });
    }

    fn record(&mut self, ticket: u64, write: RecordWrite) -> Result<(), Violation> {
        if let RecordWrite::Opened { ledger, .. } = &write
            && let Some(owner) = &ledger.owner
        {
            let healthy = self.owner_is_healthy();
            let facts = Arc::make_mut(&mut self.state.facts);
            facts.granted(ledger.epoch, owner, ledger.base, healthy, false)?;
        }
        if let RecordWrite::Head { head, .. } = &write {
            // Recorded is as good as applied: a gateway that dies now is started again from it.
            let frame = fam_proto::Applied {
                mc: self.cell().mc.clone(),
                epoch: head.meta.id.epoch,
                owner: self.head_owner(),
                scan: head.meta.id.scan,
                digest: head.meta.id.digest,
                base: self.state.facts.base,
                phase: head.meta.phase,
                released: false,
                at_us: 0,
            };
            let facts = Arc::make_mut(&mut self.state.facts);
            facts.applied(&frame, &head.state)?;
        }
        Arc::make_mut(&mut self.state.records).write(write);
        self.change(Pid::Gateway, |process| {
            let now = process.now;
            if let Body::Gateway(gateway) = &mut process.body {
                let result = Ok(());
                gateway.handle(Input::Persisted { ticket, result }, now);
            }
        });
        Ok(())
    }

    fn head_owner(&self) -> fam_proto::Owner {
        let gate = self.gate(|gate| gate.ledger().owner.clone()).flatten();
        gate.unwrap_or_else(|| self.cell().owner(0, BootId(0)))
    }

    fn gate<T>(&self, look: impl FnOnce(&fam_gateway_core::gate::Gate) -> T) -> Option<T> {
        let process = self.state.process(Pid::Gateway)?;
        let Body::Gateway(gateway) = &process.body else {
            return None;
        };
        gateway.gate(&self.cell().mc).map(look)
    }

    /// The owner of before drives in time, and the gateway has heard of its life and of no end of it.
    fn owner_is_healthy(&self) -> bool {
        let Some(process) = self.state.process(Pid::Gateway) else {
            return false;
        };
        let now = process.now;
        let fresh_us = 3 * u64::from(self.cell().model.mcs[0].cycle_us);
        let owner = self.gate(|gate| {
            let open = gate.ledger().state == RecordState::Open;
            let fresh = gate.silent_us(now) <= fresh_us;
            gate.ledger().owner.clone().filter(|_| open && fresh)
        });
        let Some(owner) = owner.flatten() else {
            return false;
        };
        let node = self
            .cell()
            .controllers
            .iter()
            .position(|c| *c == owner.controller);
        node.is_some_and(|n| process.tokens.contains(&(Pid::Node(n), owner.boot)))
    }

    fn apply(&mut self, why: &Why) -> Result<(), Violation> {
        let Why::Frame(applied) = why else {
            return Ok(());
        };
        // The record came first: what is applied is what was recorded last.
        let recorded = self.state.facts.applied == Some(applied.checkpoint_id())
            && self.state.facts.grant == Some((applied.epoch, applied.owner.clone()))
            && (self.state.facts.base == applied.base || applied.base.is_none());
        if recorded {
            return Ok(());
        }
        Err(Violation {
            property: crate::properties::ONE_DRIVER,
            text: format!(
                "scan {} of epoch {} is applied, and was not recorded as the head",
                applied.scan, applied.epoch
            ),
        })
    }

    /// An image goes out to all. One that says nothing new of the record comes at once, for it could as well have come later;
    /// one that does takes its time, and is overtaken by the next.
    fn publish(&mut self, image: &InputImage) -> Result<(), Violation> {
        let mut image = image.clone();
        // What only people look at, and ages in classes: fresh, stale, suspect.
        image.sent_at_us = 0;
        let cycle_us = u64::from(self.cell().model.mcs[0].cycle_us);
        let suspect_us = self.cell().model.mcs[0].suspect_us;
        for record in &mut image.records {
            record.rejected = 0;
            // An acknowledgement is for deltas, which are not modelled.
            (record.head, record.phase) = (None, None);
            record.silent_us = match record.silent_us {
                us if us <= 3 * cycle_us => 0,
                us if us <= suspect_us => 3 * cycle_us + 1,
                _ => suspect_us + 1,
            };
        }
        let image = Arc::new(image);
        for pid in [Pid::Manager, Pid::Node(0), Pid::Node(1)] {
            let Some(process) = self.state.process(pid) else {
                continue;
            };
            if !self.state.connected(Pid::Gateway, pid) {
                continue;
            }
            let known = match &process.body {
                Body::Manager(agents) => {
                    let view = agents.view().mcs.get(&self.cell().mc);
                    let up = agents.view().gateways.values().all(|g| g.is_up());
                    up && view.and_then(|v| v.record.as_ref()) == image.records.first()
                }
                Body::Node(.., newest) => newest.as_ref().is_some_and(|newest| {
                    newest.records == image.records && newest.boot == image.boot
                }),
                Body::Gateway(_) => false,
            };
            // A scan thread takes an image as soon as it comes; without late frames nobody sees a difference.
            let at_once = known || (self.state.faults.late == 0 && matches!(pid, Pid::Node(_)));
            if at_once && !self.state.images.contains_key(&pid) {
                self.image(pid, Arc::clone(&image))?;
            } else {
                self.state.images.insert(pid, Arc::clone(&image));
            }
        }
        Ok(())
    }

    fn carry_out_node(&mut self, n: usize) -> Result<(), Violation> {
        let pid = Pid::Node(n);
        loop {
            let mut output = None;
            self.change(pid, |process| {
                if let Body::Node(agents, ..) = &mut process.body {
                    output = agents.poll_output();
                }
            });
            match output {
                None => return Ok(()),
                Some(Output::Persist { write, .. }) => match write {},
                Some(Output::Send(envelope)) => self.send(pid, envelope),
                Some(
                    Output::Event(_)
                    | Output::Act(
                        NodeAct::Leave { .. } | NodeAct::Stage { .. } | NodeAct::Renewed { .. },
                    ),
                ) => {}
                Some(Output::Act(NodeAct::Mc { mut act, .. })) => {
                    if self.world.bug == Some(Bug::StaleStart) {
                        self.make_stale(pid, &mut act);
                    }
                    let mut news = None;
                    self.change(pid, |process| {
                        if let Body::Node(_, plc, _) = &mut process.body {
                            news = plc.act(act);
                        }
                    });
                    self.news(pid, news)?;
                }
            }
        }
    }

    /// Planted bug: whatever is held here is as good as what was granted.
    fn make_stale(&self, pid: Pid, act: &mut McAct) {
        if let McAct::Activate(activation) = act
            && let Some(process) = self.state.process(pid)
            && let Body::Node(_, plc, _) = &process.body
            && let Some(held) = &plc.held
            && let Start::From { source, .. } = &mut activation.start
        {
            *source = StateSource::Given(Arc::clone(&held.0));
        }
    }

    // ---- between processes

    fn send(&mut self, from: Pid, mut envelope: Envelope) {
        let Some(to) = self.pid_of(&envelope.to.process()) else {
            return; // to an operator
        };
        match &mut envelope.body {
            // What orders and grants are made of takes its time.
            Message::Order(_)
            | Message::Open(_)
            | Message::Opened(_)
            | Message::OpenRefused(_)
            | Message::Close(_) => {
                self.fly(from, to, envelope);
                return;
            }
            // These end a job; all other reports are for people.
            Message::McReport(report)
                if matches!(
                    report.outcome,
                    McOutcome::NotOpened(_) | McOutcome::ReleaseCancelled(_)
                ) =>
            {
                self.fly(from, to, envelope);
                return;
            }
            // The outcome of a negotiation is told to nobody who acts on it.
            Message::Award(_) | Message::Event(_) => return,
            Message::Report(report) => {
                report.image_age_us = if report.image_age_us <= 300_000 {
                    0
                } else {
                    u64::MAX
                };
            }
            Message::Bid(bid) => {
                bid.image_age_us = if bid.image_age_us <= 300_000 {
                    0
                } else {
                    u64::MAX
                };
            }
            _ => {}
        }
        // The rest keeps the books; it arrives at once, or not at all.
        if self.state.connected(from, to) && self.state.process(to).is_some() {
            self.inbox.push_back((to, envelope));
        }
    }

    fn fly(&mut self, from: Pid, to: Pid, envelope: Envelope) {
        let flight = Flight {
            from,
            to,
            packet: Arc::new(Packet::Message(Box::new(envelope))),
        };
        if !self.state.flights.contains(&flight) {
            self.state.flights.push(flight);
        }
    }

    fn take_inbox(&mut self) -> Result<(), Violation> {
        while let Some((to, envelope)) = self.inbox.pop_front() {
            if self.dies_after.is_some_and(|(dying, _)| dying == to) {
                continue;
            }
            self.message(to, envelope)?;
        }
        Ok(())
    }

    fn settle(&mut self) -> Result<(), Violation> {
        self.take_inbox()?;
        // What a node hears of the manager's token makes it register again, and nothing else: at once.
        for node in [Pid::Node(0), Pid::Node(1)] {
            if self.world.token_differs(&self.state, node, Pid::Manager) {
                self.token(node, Pid::Manager)?;
                self.take_inbox()?;
            }
        }
        // Frames of epochs that are over are refused for ever: the same as lost.
        let epoch = self.gate(|gate| gate.ledger().epoch);
        if let Some(epoch) = epoch {
            self.state.flights.retain(|flight| match &*flight.packet {
                Packet::Frame(frame) => frame.header.epoch >= epoch,
                Packet::Message(_) => true,
            });
        }
        self.state.flights.sort_by_key(Flight::key);
        for pid in std::mem::take(&mut self.changed) {
            self.change(pid, Process::refresh);
        }
        Ok(())
    }
}

fn peer<L>(process: ProcessId, boot: BootId, alive: bool) -> Input<L> {
    Input::Peer {
        process,
        boot,
        alive,
    }
}
