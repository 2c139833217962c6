//! The Middleware Manager's desk: its outputs in order, its tickets at the repository, and the event history.
//!
//! Two queues: what a running plant waits for (orders, epochs, answers) goes out before what only has to be written down.

use super::{ManagerAct, ManagerOutput};
use crate::epochs::Block;
use fam_proto::agent::Output;
use fam_proto::{
    AgentId, BootId, EVENTS_LOADED_MAX, Envelope, Event, EventKind, Message, Now, RepoWrite,
    Severity,
};
use std::collections::{BTreeMap, VecDeque};
use std::hash::{Hash, Hasher};

/// What a ticket at the repository stands for.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) enum Ticket {
    /// A block of epochs.
    Epochs(Block),
    /// Something that an operator asked for: client and number of the command that ends with it.
    Command(u64, u64),
    /// Something that nothing waits for.
    Kept,
    /// An entry of the history.
    Event,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Desk {
    boot: BootId,
    first: VecDeque<ManagerOutput>,
    later: VecDeque<ManagerOutput>,
    last_ticket: u64,
    tickets: BTreeMap<u64, Ticket>,
    events: VecDeque<Event>,
    last_seq: u64,
    /// Wall clock in microseconds since 1970 at a moment.
    wall: Option<(Now, u64)>,
    /// What the repository said when it failed; `None` while it writes.
    pub(super) repository_failed: Option<String>,
}

// The history is told and not acted on: it is no part of the state, and neither is how often the repository was asked.
impl Hash for Desk {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.boot.hash(state);
        self.first.hash(state);
        self.later.hash(state);
        self.tickets.hash(state);
        self.repository_failed.hash(state);
    }
}

impl Desk {
    pub(super) fn new(boot: BootId, events: Vec<Event>, last_seq: u64) -> Desk {
        Desk {
            boot,
            first: VecDeque::new(),
            later: VecDeque::new(),
            last_ticket: 0,
            tickets: BTreeMap::new(),
            events: events.into(),
            last_seq,
            wall: None,
            repository_failed: None,
        }
    }

    pub(super) fn poll(&mut self) -> Option<ManagerOutput> {
        self.first.pop_front().or_else(|| self.later.pop_front())
    }

    pub(super) fn boot(&self) -> BootId {
        self.boot
    }

    /// The history never tells a time before this life's boot id: the next life takes its own above the history.
    pub(super) fn wall_is(&mut self, now: Now, unix_us: u64) {
        self.wall = Some((now, unix_us.max(self.boot.0)));
    }

    /// Sends as the Middleware Manager.
    pub(super) fn send(&mut self, to: AgentId, body: Message) {
        self.pass_on(Envelope {
            from: AgentId::Manager,
            boot: self.boot,
            to,
            body,
        });
    }

    /// Sends what another agent of this process has signed.
    pub(super) fn pass_on(&mut self, envelope: Envelope) {
        self.first.push_back(Output::Send(envelope));
    }

    pub(super) fn act(&mut self, act: ManagerAct) {
        self.later.push_back(Output::Act(act));
    }

    /// Asks the repository; `Ticket::Epochs` and commands go first.
    pub(super) fn persist(&mut self, write: RepoWrite, ticket: Ticket) {
        self.last_ticket += 1;
        let output = Output::Persist {
            ticket: self.last_ticket,
            write,
        };
        match ticket {
            Ticket::Epochs(_) | Ticket::Command(..) => self.first.push_back(output),
            Ticket::Kept | Ticket::Event => self.later.push_back(output),
        }
        self.tickets.insert(self.last_ticket, ticket);
    }

    /// What the answered ticket stood for; `None` for one that is not open.
    pub(super) fn answered(&mut self, ticket: u64) -> Option<Ticket> {
        self.tickets.remove(&ticket)
    }

    /// An entry of the history.
    pub(super) fn event(&mut self, mut event: Event, now: Now) {
        self.last_seq += 1;
        event.seq = self.last_seq;
        event.at_us = now.0;
        event.wall_us = self
            .wall
            .map_or(0, |(at, unix_us)| unix_us.saturating_add(now.since_us(at)));
        self.events.push_back(event.clone());
        if self.events.len() > EVENTS_LOADED_MAX {
            self.events.pop_front();
        }
        self.persist(RepoWrite::Event(event.clone()), Ticket::Event);
        self.later.push_back(Output::Event(event));
    }

    /// The repository has failed or works again: told once each.
    pub(super) fn repository(&mut self, result: &Result<(), String>, now: Now) {
        match (result, &self.repository_failed) {
            (Err(why), None) => {
                self.repository_failed = Some(why.clone());
                let text = format!(
                    "the repository cannot be written: {why}. Epochs in reserve are used up first, then no order goes out; make room on the disk"
                );
                self.event(
                    Event::new(Severity::Alarm, EventKind::RepositoryFailed, text),
                    now,
                );
            }
            (Ok(()), Some(_)) => {
                self.repository_failed = None;
                let text = "the repository can be written again";
                self.event(
                    Event::new(Severity::Info, EventKind::RepositoryFailed, text),
                    now,
                );
            }
            _ => {}
        }
    }

    /// Events after a position, oldest first, and whether more follow.
    pub(super) fn events_after(&self, after: u64, limit: usize) -> (Vec<Event>, bool) {
        let from = self.events.partition_point(|e| e.seq <= after);
        let events: Vec<Event> = self.events.range(from..).take(limit).cloned().collect();
        let more = from + events.len() < self.events.len();
        (events, more)
    }

    /// Alarms that nobody has acknowledged.
    pub(super) fn alarms(&self) -> usize {
        self.events.iter().filter(|e| is_open_alarm(e)).count()
    }

    /// Acknowledges one alarm or all. How many were open.
    pub(super) fn acknowledge(&mut self, seq: Option<u64>) -> usize {
        let mut acknowledged = Vec::new();
        for event in &mut self.events {
            if is_open_alarm(event) && seq.is_none_or(|s| s == event.seq) {
                event.acknowledged = true;
                acknowledged.push(event.clone());
            }
        }
        let count = acknowledged.len();
        for event in acknowledged {
            self.persist(RepoWrite::Event(event), Ticket::Event);
        }
        count
    }
}

fn is_open_alarm(event: &Event) -> bool {
    event.severity == Severity::Alarm && !event.acknowledged
}
