//! Everything that can happen next in a state.

use crate::state::{Body, Flight, PIDS, Packet, Pid, State};
use crate::step::World;
use fam_proto::{BootId, McaState};

/// Something that can happen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// A packet arrives, by its place.
    Deliver(usize),
    /// A packet takes its time.
    Hold(usize),
    /// A packet never arrives.
    Lose(usize),
    /// A packet arrives, and once more later.
    Repeat(usize),
    /// A packet arrives, and the receiver dies after its first output.
    DeliverAndCrash(usize),
    /// The image on its way to the manager arrives.
    Image,
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

impl World<'_> {
    /// Everything that can happen.
    #[must_use]
    pub fn actions(&self, state: &State) -> Vec<Action> {
        let mut actions = Vec::new();
        if let Some(fresh) = state.flights.iter().position(|f| !f.held) {
            self.fresh(state, fresh, &mut actions);
            self.disturbances(state, &mut actions);
            return actions;
        }
        self.arrivals(state, &mut actions);
        for observer in [Pid::Manager, Pid::Gateway] {
            for subject in PIDS {
                if self.token_differs(state, observer, subject) {
                    actions.push(Action::Token(observer, subject));
                }
            }
        }
        for (_, pid, why) in self.deadlines(state) {
            if !self.is_idle(state, pid, why) {
                actions.push(Action::Time(pid));
                if pid == Pid::Manager && state.may_crash(pid) {
                    actions.push(Action::TimeAndCrash(pid));
                }
            }
        }
        self.disturbances(state, &mut actions);
        actions
    }

    /// What was sent in the step before arrives, or takes its time, or is lost where nobody is.
    fn fresh(&self, state: &State, n: usize, actions: &mut Vec<Action>) {
        let flight = &state.flights[n];
        if self.arrives(state, flight) {
            self.arrival(state, n, actions);
        } else {
            actions.push(Action::Lose(n));
        }
        let held = |f: &&Flight| f.held && matches!(*f.packet, Packet::Message(_));
        if state.flights.iter().filter(held).count() < state.faults.held {
            actions.push(Action::Hold(n));
        }
    }

    fn arrives(&self, state: &State, flight: &Flight) -> bool {
        state.process(flight.to).is_some() && state.connected(flight.from, flight.to)
    }

    fn arrival(&self, state: &State, n: usize, actions: &mut Vec<Action>) {
        let flight = &state.flights[n];
        actions.push(Action::Deliver(n));
        if state.faults.repeats > 0 && matches!(*flight.packet, Packet::Message(_)) {
            actions.push(Action::Repeat(n));
        }
        if state.may_crash(flight.to) && !matches!(flight.to, Pid::Node(_)) {
            actions.push(Action::DeliverAndCrash(n));
        }
    }

    fn arrivals(&self, state: &State, actions: &mut Vec<Action>) {
        for (n, flight) in state.flights.iter().enumerate() {
            // A late frame holds back the next scan of its MC: that it never comes is that it is late for ever.
            if matches!(*flight.packet, Packet::Message(_)) {
                actions.push(Action::Lose(n));
            }
            if self.arrives(state, flight) {
                self.arrival(state, n, actions);
            }
        }
        if state.image.is_some()
            && state.process(Pid::Manager).is_some()
            && state.connected(Pid::Gateway, Pid::Manager)
        {
            actions.push(Action::Image);
        }
    }

    fn disturbances(&self, state: &State, actions: &mut Vec<Action>) {
        for node in [0, 1] {
            let runs = state
                .node(node)
                .is_some_and(|(_, plc)| plc.active.is_some());
            if state.faults.late > 0 && runs && !state.late[node] {
                actions.push(Action::Late(node));
            }
        }
        let running = state.running().map(|(pid, _)| pid);
        actions.extend(
            running
                .filter(|pid| state.may_crash(*pid))
                .map(Action::Crash),
        );
        if state.faults.restarts > 0 {
            let down = PIDS.iter().filter(|pid| state.process(**pid).is_none());
            actions.extend(down.map(|pid| Action::Start(*pid)));
        }
        if state.faults.cuts > 0 && state.cut.is_none() {
            for (n, a) in PIDS.iter().enumerate() {
                for b in &PIDS[n + 1..] {
                    let link = (a.kind(), b.kind());
                    let meant = state.faults.between.is_none_or(|between| between == link);
                    // Two nodes say nothing to each other but frames, and those the gateway has.
                    if meant && !matches!((a, b), (Pid::Node(_), Pid::Node(_))) {
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
    }

    /// A node that registers again and again with a manager that it does not reach; and reports, which come when the manager's clock
    /// would miss them ([`crate::clocks`]).
    fn is_idle(&self, state: &State, pid: Pid, why: &str) -> bool {
        let Pid::Node(n) = pid else { return false };
        let reached = state.process(Pid::Manager).is_some() && state.connected(Pid::Manager, pid);
        let busy = state.node(n).is_some_and(|(agents, _)| {
            agents
                .components()
                .any(|mca| matches!(mca.state(), McaState::Opening | McaState::Releasing))
        });
        why == "report" || (why == "register" && !reached && !busy)
    }

    /// Whether an observer's view of a token is not what it will be.
    pub(crate) fn token_differs(&self, state: &State, observer: Pid, subject: Pid) -> bool {
        let watches = match observer {
            Pid::Manager => subject != Pid::Manager,
            // Of other tokens it takes no note.
            Pid::Gateway => matches!(subject, Pid::Node(_)),
            Pid::Node(_) => subject == Pid::Manager,
        };
        let Some(process) = state.process(observer).filter(|_| watches) else {
            return false;
        };
        let mut seen = process.tokens.iter().filter(|(pid, _)| *pid == subject);
        match self.boot_seen(state, observer, subject) {
            Some(boot) => !(seen.next() == Some(&(subject, boot)) && seen.next().is_none()),
            None => seen.next().is_some(),
        }
    }

    /// The life whose token an observer will see.
    pub(crate) fn boot_seen(&self, state: &State, observer: Pid, subject: Pid) -> Option<BootId> {
        let boot = state.boot(subject)?;
        state.connected(observer, subject).then_some(boot)
    }

    /// Whether the delivery of a packet can change nothing any more, now or later: it is as good as lost.
    pub(crate) fn is_dead(&self, state: &State, flight: &Flight) -> bool {
        use fam_proto::Message as M;
        let envelope = match &*flight.packet {
            // Frames of epochs that are over are refused for ever.
            Packet::Frame(frame) => {
                let epoch = self.record_epoch(state);
                return epoch.is_some_and(|epoch| frame.header.epoch < epoch);
            }
            Packet::Message(envelope) => envelope,
        };
        let opens = |node: Pid, epoch| {
            let Some(Body::Node(agents, ..)) = state.process(node).map(|p| &p.body) else {
                return false;
            };
            agents
                .components()
                .any(|mca| mca.state() == McaState::Opening && mca.epoch() == Some(epoch))
        };
        match &envelope.body {
            // An MCA opens an epoch once: whoever does not open this one now never will again.
            M::Opened(opened) => !opens(flight.to, opened.epoch),
            M::OpenRefused(refused) => !opens(flight.to, refused.epoch),
            // To be refused for ever, and nobody waits for the refusal.
            M::Open(open) => {
                let over = self
                    .record_epoch(state)
                    .is_some_and(|epoch| open.epoch <= epoch);
                over && !(opens(flight.from, open.epoch)
                    && state.boot(flight.from) == Some(open.owner.boot))
            }
            M::Order(order) => self.is_dead_order(state, flight, envelope.boot, order.id),
            // Which ends a job that has ended.
            M::McReport(report) => {
                let awaited = |id| state.manager().is_some_and(|m| m.manager().awaits(id));
                !report.order.is_some_and(awaited)
            }
            _ => false,
        }
    }

    /// An order that the node has had, of which the manager's life needs to hear nothing; or of a life that counts no more.
    fn is_dead_order(
        &self,
        state: &State,
        flight: &Flight,
        boot: BootId,
        id: fam_proto::OrderId,
    ) -> bool {
        let Pid::Node(n) = flight.to else {
            return false;
        };
        let Some((agents, _)) = state.node(n) else {
            return false;
        };
        let had = agents.components().any(|mca| {
            mca.newest_order()
                .is_some_and(|(life, newest)| life == boot && newest >= id)
        });
        match state.manager() {
            Some(manager) if manager.manager().boot() == boot => {
                let manager = manager.manager();
                had && !manager.awaits(id) && !manager.repeats(id)
            }
            _ => had || agents.controller().is_over(boot),
        }
    }

    fn record_epoch(&self, state: &State) -> Option<fam_proto::Epoch> {
        let gate = state.gateway()?.gate(&self.cell.mc)?;
        Some(gate.ledger().epoch)
    }
}
