//! Messages between processes: which arrive at once, which take their time, and which are as good as lost.

use crate::properties::Violation;
use crate::state::{Flight, Packet, Pid, Process};
use crate::step::Run;
use fam_proto::{Envelope, McOutcome, Message};
use std::sync::Arc;

impl Run<'_> {
    pub(crate) fn send(&mut self, from: Pid, mut envelope: Envelope) {
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
            held: false,
        };
        // What is said again is as late as what was said before.
        let same = |f: &Flight| (f.from, f.to, &f.packet) == (from, to, &flight.packet);
        if !self.state.flights.iter().any(same) {
            self.state.flights.push(flight);
        }
    }

    /// What can change nothing any more is lost.
    fn prune(&mut self) {
        self.state.flights.sort_by_key(Flight::key);
        let mut flights = std::mem::take(&mut self.state.flights);
        flights.retain(|flight| !self.world.is_dead(&self.state, flight));
        self.state.flights = flights;
    }

    pub(crate) fn take_inbox(&mut self) -> Result<(), Violation> {
        while let Some((to, envelope)) = self.inbox.pop_front() {
            if self.dies_after.is_some_and(|(dying, _)| dying == to) {
                continue;
            }
            self.message(to, envelope)?;
        }
        Ok(())
    }

    pub(crate) fn settle(&mut self) -> Result<(), Violation> {
        self.take_inbox()?;
        // What a node hears of the manager's token makes it register again, and nothing else: at once.
        for node in [Pid::Node(0), Pid::Node(1)] {
            if self.world.token_differs(&self.state, node, Pid::Manager) {
                self.token(node, Pid::Manager)?;
                self.take_inbox()?;
            }
        }
        self.prune();
        for pid in std::mem::take(&mut self.changed) {
            self.change(pid, Process::refresh);
        }
        Ok(())
    }
}
