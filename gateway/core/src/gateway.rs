//! The gateway as one state machine: tick and images, frames, openings, watchdogs, reports.

mod foreign;
mod interface;
mod time;

pub use interface::{GatewayAct, GatewayError, GatewayInput, GatewayLocal, GatewayOutput, Why};
pub use time::REPORT_REJECTED_US;

use self::foreign::Foreign;
use crate::fence::Rejection;
use crate::gate::{Accepted, Counters, Gate, Verdict};
use crate::opening::{self, Decision};
use crate::place;
use crate::stored::{RecordWrite, StoredRecord};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::model::{CellModel, InputSource};
use fam_proto::{
    AgentId, BootId, Close, Envelope, Event, EventKind, GatewayId, ImageNumber, Ledger, McId,
    Message, Now, Open, OpenRefusal, OpenRefused, Owner, ProcessId, RecordState, Severity,
    TrapInfo, decode_frame,
};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// Longest text of a trap that is kept, for each of its parts, in bytes: the ledger has a fixed place on disk.
pub const TRAP_TEXT_BYTES_MAX: usize = 256;
/// Lives of one controller whose tokens are kept, at most.
pub const LIVES_MAX: usize = 16;

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Pending {
    Frame {
        mc: McId,
        accepted: Box<Accepted>,
        /// When the frame was judged.
        at: Now,
    },
    Grant {
        open: Box<Open>,
        to: AgentId,
        ledger: Box<Ledger>,
    },
    /// A change of state that is in force already.
    Note { mc: McId },
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Reported {
    at: Option<Now>,
    waiting: BTreeMap<Rejection, u64>,
    /// Sender of the last one.
    owner: Option<Owner>,
}

/// The state machine of one gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Gateway {
    id: GatewayId,
    boot: BootId,
    tick_us: u64,
    fenced: bool,
    gates: BTreeMap<McId, Gate>,
    /// MCs here whose exported variables MCs of other gateways read.
    exported: BTreeSet<McId>,
    /// MCs of other gateways whose exported variables MCs here read.
    foreign: BTreeMap<McId, Foreign>,
    /// Rejections not yet reported, by MC.
    reported: BTreeMap<McId, Reported>,
    /// Frames that belong to no MC here.
    stray: BTreeMap<Rejection, u64>,
    /// Messages that were not for a gateway, or whose sender is not who asks.
    misdirected: u64,
    /// What the process could not read.
    unreadable: u64,
    /// When the manager was told of all these last.
    bad_told: Option<Now>,
    alive: BTreeSet<Owner>,
    image: ImageNumber,
    next_tick: Now,
    reading: bool,
    ticket: u64,
    pending: BTreeMap<u64, Pending>,
    out: VecDeque<GatewayOutput>,
}

// What is only counted or told is no part of the state.
impl Hash for Gateway {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.id.hash(state);
        self.boot.hash(state);
        self.gates.hash(state);
        self.foreign.hash(state);
        self.alive.hash(state);
        self.image.hash(state);
        self.next_tick.hash(state);
        self.reading.hash(state);
        self.pending.hash(state);
        self.out.hash(state);
    }
}

impl Gateway {
    /// A gateway at its start. `run` counts the starts on one record file and makes image numbers grow over restarts.
    ///
    /// # Errors
    /// [`GatewayError`] if the model does not fit.
    pub fn new(
        cell: &CellModel,
        id: &GatewayId,
        boot: BootId,
        run: u32,
        stored: Vec<StoredRecord>,
        now: Now,
    ) -> Result<Gateway, GatewayError> {
        let model = cell
            .gateways
            .iter()
            .find(|g| &g.gateway == id)
            .ok_or_else(|| GatewayError::UnknownGateway {
                cell: cell.cell.to_string(),
                gateway: id.clone(),
                known: cell
                    .gateways
                    .iter()
                    .map(|g| format!("`{}`", g.gateway))
                    .collect::<Vec<_>>()
                    .join(", "),
            })?;
        let image = ImageNumber(u64::from(run) << 32);
        let mut stored: BTreeMap<McId, StoredRecord> =
            stored.into_iter().map(|s| (s.mc.clone(), s)).collect();
        let gates: BTreeMap<McId, Gate> = cell
            .mcs
            .iter()
            .filter(|mc| &mc.gateway == id)
            .map(|mc| {
                let gate = Gate::new(Arc::new(mc.clone()), stored.remove(&mc.mc), image, now);
                (mc.mc.clone(), gate)
            })
            .collect();
        let (exported, foreign) = foreign::of(cell, id);
        check_places(&gates, &foreign)?;
        let mut gateway = Gateway {
            id: id.clone(),
            boot,
            tick_us: u64::from(model.tick_us.max(1)),
            fenced: true,
            reported: gates
                .keys()
                .map(|mc| (mc.clone(), Reported::default()))
                .collect(),
            gates,
            exported,
            foreign,
            stray: BTreeMap::new(),
            misdirected: 0,
            unreadable: 0,
            bad_told: None,
            alive: BTreeSet::new(),
            image,
            next_tick: now,
            reading: false,
            ticket: 0,
            pending: BTreeMap::new(),
            out: VecDeque::new(),
        };
        gateway.begin();
        Ok(gateway)
    }

    /// Takes the fence away, so that a benchmark can show that it is the fence that keeps two controllers from driving.
    #[cfg(feature = "fence-off")]
    #[must_use]
    pub fn without_fence(mut self) -> Gateway {
        self.fenced = false;
        self
    }

    /// The gate of an MC, for status and checks.
    #[must_use]
    pub fn gate(&self, mc: &McId) -> Option<&Gate> {
        self.gates.get(mc)
    }
    /// MCs served.
    pub fn mcs(&self) -> impl Iterator<Item = &McId> {
        self.gates.keys()
    }
    /// Counters of all MCs.
    pub fn counters(&self) -> impl Iterator<Item = (&McId, &Counters)> {
        self.gates.iter().map(|(mc, gate)| (mc, gate.counters()))
    }
    /// Frames that do not read or belong to no MC here, by reason.
    #[must_use]
    pub fn stray(&self) -> &BTreeMap<Rejection, u64> {
        &self.stray
    }
    /// Messages that were not for a gateway, or not signed by who asks.
    #[must_use]
    pub fn misdirected(&self) -> u64 {
        self.misdirected
    }
    /// All that could not be read or was not for this gateway, as the manager is told.
    #[must_use]
    pub fn bad_messages(&self) -> u64 {
        self.stray.values().sum::<u64>() + self.misdirected + self.unreadable
    }
    /// Number of the newest image.
    #[must_use]
    pub fn image(&self) -> ImageNumber {
        self.image
    }

    fn begin(&mut self) {
        let mut interrupted = Vec::new();
        for (mc, gate) in &self.gates {
            let closed = gate.ledger().state == RecordState::Closed;
            if closed {
                interrupted.push(mc.to_string());
            }
            let why = match (gate.fail_safe_stands(), closed) {
                (true, _) => Why::FailSafe,
                // The field holds what it got last until a new owner or the watchdog comes.
                (false, true) => continue,
                (false, false) => Why::Kept,
            };
            self.out.push_back(Output::Act(GatewayAct::ApplyOutputs {
                mc: mc.clone(),
                outputs: Arc::clone(gate.outputs()),
                why,
            }));
        }
        let records = if interrupted.is_empty() {
            "no epoch was open".to_owned()
        } else {
            format!(
                "epochs closed by the restart, to be activated from their records: {}",
                interrupted.join(", ")
            )
        };
        self.out.push_back(Output::Event(Event::new(
            Severity::Info,
            EventKind::GatewayJoined,
            format!(
                "gateway {} started with {} MCs; {records}",
                self.id,
                self.gates.len()
            ),
        )));
    }

    /// The token of a node that hosts an MC here; of others nothing is kept, and of one name only so many lives.
    fn seen(&mut self, owner: Owner) {
        let hosts = self
            .gates
            .values()
            .any(|gate| gate.model().hosts.contains(&owner.controller));
        if !hosts {
            return;
        }
        let lives = self
            .alive
            .iter()
            .filter(|o| o.controller == owner.controller);
        if lives.count() >= LIVES_MAX {
            // Owners stay: whoever drives must not be forgotten for a token that means nothing.
            let owns = |o: &Owner| {
                let records = self.gates.values();
                records
                    .into_iter()
                    .any(|gate| gate.ledger().owner.as_ref() == Some(o))
            };
            let spare = self
                .alive
                .iter()
                .find(|o| o.controller == owner.controller && !owns(o))
                .cloned();
            match spare {
                Some(spare) => self.alive.remove(&spare),
                None => return,
            };
        }
        self.alive.insert(owner);
    }

    fn persist(&mut self, write: RecordWrite, pending: Pending) {
        self.ticket += 1;
        self.pending.insert(self.ticket, pending);
        self.out.push_back(Output::Persist {
            ticket: self.ticket,
            write,
        });
    }

    fn send(&mut self, to: AgentId, body: Message) {
        self.out.push_back(Output::Send(Envelope {
            from: AgentId::Gateway(self.id.clone()),
            boot: self.boot,
            to,
            body,
        }));
    }

    fn event(&mut self, now: Now, mut event: Event) {
        event.at_us = now.0;
        self.out.push_back(Output::Event(event));
    }

    // ---- frames

    fn frame(&mut self, bytes: &[u8], now: Now) {
        let Ok(frame) = decode_frame(bytes) else {
            *self.stray.entry(Rejection::Unreadable).or_default() += 1;
            return;
        };
        let mc = frame.header.mc.clone();
        let Some(gate) = self.gates.get_mut(&mc) else {
            *self.stray.entry(Rejection::UnknownMc).or_default() += 1;
            return;
        };
        match gate.judge(&frame, self.fenced, now) {
            Err(why) => self.reject(&mc, why, &frame.header.owner, now),
            Ok(Verdict::Repetition) => gate.count_repeated(),
            Ok(Verdict::Accept(accepted)) => {
                gate.set_writing(true);
                let head = accepted.head.clone();
                self.persist(
                    RecordWrite::Head {
                        mc: mc.clone(),
                        head,
                    },
                    Pending::Frame {
                        mc,
                        accepted,
                        at: now,
                    },
                );
            }
        }
    }

    fn reject(&mut self, mc: &McId, why: Rejection, owner: &Owner, now: Now) {
        if let Some(gate) = self.gates.get_mut(mc) {
            gate.count_rejected(why);
        }
        if let Some(reported) = self.reported.get_mut(mc) {
            *reported.waiting.entry(why).or_default() += 1;
            reported.owner = Some(owner.clone());
        }
        self.report_rejected(now);
    }

    fn recorded(&mut self, mc: &McId, mut accepted: Accepted, judged_at: Now, now: Now) {
        let Some(gate) = self.gates.get_mut(mc) else {
            return;
        };
        let record = gate.ledger();
        if self.fenced
            && (record.state != RecordState::Open || record.epoch != accepted.applied.epoch)
        {
            // Only if something came between the write and its answer.
            self.reject(mc, Rejection::NotOpen, &accepted.applied.owner, now);
            return;
        }
        accepted.applied.at_us = now.0;
        let applied = accepted.applied.clone();
        let outputs = Arc::clone(&accepted.head.outputs);
        // The silence ends when the frame came, not when the disk was done with it.
        let committed = gate.commit(accepted, judged_at);
        let ledger = gate.ledger().clone();
        self.out.push_back(Output::Act(GatewayAct::ApplyOutputs {
            mc: mc.clone(),
            outputs,
            why: Why::Frame(applied),
        }));
        if committed.first || committed.stopped {
            self.persist(
                RecordWrite::Changed {
                    mc: mc.clone(),
                    ledger,
                    sync: committed.stopped || committed.from_nothing,
                },
                Pending::Note { mc: mc.clone() },
            );
        }
    }

    // ---- messages

    fn message(&mut self, envelope: Envelope, now: Now) {
        match &envelope.body {
            Message::Open(open) if envelope.is_from(&open.owner) => {
                self.open(open, &envelope.from, now);
            }
            Message::Close(close) if envelope.is_from(&close.owner) => self.close(close, now),
            _ => self.misdirected += 1,
        }
    }

    fn open(&mut self, open: &Open, from: &AgentId, now: Now) {
        let Some(gate) = self.gates.get_mut(&open.mc) else {
            self.refuse(open, from, OpenRefusal::UnknownMc, now);
            return;
        };
        if gate.is_writing() {
            return; // The asker repeats its open.
        }
        let owner_seen = gate
            .ledger()
            .owner
            .as_ref()
            .is_some_and(|owner| self.alive.contains(owner));
        match opening::decide(gate, open, owner_seen, now) {
            Decision::Refuse(why) => self.refuse(open, from, why, now),
            Decision::Again => {
                let answer = opening::answer(gate, open);
                self.send(from.clone(), Message::Opened(answer));
            }
            Decision::Grant(ledger) => {
                gate.set_writing(true);
                self.persist(
                    RecordWrite::Opened {
                        mc: open.mc.clone(),
                        ledger: ledger.clone(),
                    },
                    Pending::Grant {
                        open: Box::new(open.clone()),
                        to: from.clone(),
                        ledger: Box::new(ledger),
                    },
                );
            }
        }
    }

    fn refuse(&mut self, open: &Open, to: &AgentId, why: OpenRefusal, now: Now) {
        let record = self.gates.get(&open.mc).map(|gate| gate.summary(now));
        self.send(
            to.clone(),
            Message::OpenRefused(OpenRefused {
                mc: open.mc.clone(),
                epoch: open.epoch,
                why,
                record,
            }),
        );
    }

    fn granted(&mut self, open: &Open, to: &AgentId, ledger: Ledger, now: Now) {
        let Some(gate) = self.gates.get_mut(&open.mc) else {
            return;
        };
        gate.grant(ledger, open.layout, now);
        let answer = opening::answer(gate, open);
        self.send(to.clone(), Message::Opened(answer));
    }

    fn close(&mut self, close: &Close, now: Now) {
        let Some(gate) = self.gates.get(&close.mc) else {
            self.misdirected += 1;
            return;
        };
        let record = gate.ledger();
        // The watchdog, or a restart of the gateway, may have been faster than the word of the trap.
        let stands = matches!(
            record.state,
            RecordState::Open | RecordState::FailSafe | RecordState::Closed
        );
        if !stands || record.epoch != close.epoch || record.owner.as_ref() != Some(&close.owner) {
            return;
        }
        let trap = TrapInfo {
            pou: cut(&close.trap.pou),
            file: cut(&close.trap.file),
            line: close.trap.line,
            message: cut(&close.trap.message),
        };
        let event = Event::new(
            Severity::Alarm,
            EventKind::McFaulted,
            format!(
                "{}: {trap}; its outputs stand at their fail-safe values until `fam reset {}`",
                close.mc, close.mc
            ),
        );
        self.set_fail_safe(&close.mc, RecordState::Faulted(trap), event, true, now);
    }

    fn persisted(&mut self, ticket: u64, result: Result<(), String>, now: Now) {
        let Some(pending) = self.pending.remove(&ticket) else {
            return;
        };
        let blocked = match &pending {
            Pending::Frame { mc, .. } => Some(mc),
            Pending::Grant { open, .. } => Some(&open.mc),
            Pending::Note { .. } => None,
        };
        if let Some(gate) = blocked.and_then(|mc| self.gates.get_mut(mc)) {
            gate.set_writing(false);
        }
        match (pending, result) {
            (Pending::Frame { mc, accepted, at }, Ok(())) => self.recorded(&mc, *accepted, at, now),
            (Pending::Grant { open, to, ledger }, Ok(())) => self.granted(&open, &to, *ledger, now),
            (Pending::Note { .. }, Ok(())) => {}
            (Pending::Frame { mc, accepted, .. }, Err(_)) => {
                self.reject(&mc, Rejection::NotRecorded, &accepted.applied.owner, now);
            }
            (Pending::Grant { open, to, .. }, Err(why)) => {
                self.event(now, record_failed(&open.mc, &why).epoch(open.epoch));
                self.refuse(&open, &to, OpenRefusal::NotDurable(why), now);
            }
            (Pending::Note { mc }, Err(why)) => self.event(now, record_failed(&mc, &why)),
        }
    }
}

fn record_failed(mc: &McId, why: &str) -> Event {
    Event::new(
        Severity::Alarm,
        EventKind::RepositoryFailed,
        format!("{mc}: the gateway's record could not be written: {why}"),
    )
    .mc(mc)
}

fn cut(text: &str) -> String {
    let mut end = text.len().min(TRAP_TEXT_BYTES_MAX);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text[..end].to_owned()
}

fn check_places(
    gates: &BTreeMap<McId, Gate>,
    foreign: &BTreeMap<McId, Foreign>,
) -> Result<(), GatewayError> {
    for (mc, gate) in gates {
        let model = gate.model();
        let outside = |variable: &str| GatewayError::Place {
            mc: mc.clone(),
            variable: variable.to_owned(),
        };
        for output in &model.outputs {
            if place::end(output.place) > model.fail_safe.len() {
                return Err(outside(&output.name));
            }
        }
        for input in &model.inputs {
            if place::end(input.place) > model.inputs_len as usize {
                return Err(outside(&input.name));
            }
            if let InputSource::Export { mc: from, place } = &input.source {
                let len = match (gates.get(from), foreign.get(from)) {
                    (Some(gate), _) => Some(gate.outputs().len()),
                    (None, Some(foreign)) => Some(foreign.len()),
                    (None, None) => None,
                };
                let why = match len {
                    None => "the cell does not have",
                    Some(len) if place::end(*place) > len => "has no such place in its outputs",
                    Some(_) => continue,
                };
                return Err(GatewayError::Export {
                    mc: mc.clone(),
                    input: input.name.clone(),
                    from: from.clone(),
                    why,
                });
            }
        }
    }
    Ok(())
}

impl Agent for Gateway {
    type Input = GatewayInput;
    type Output = GatewayOutput;

    fn handle(&mut self, input: GatewayInput, now: Now) {
        // Timers run before anything that waited in a queue: a frame that comes too late does not count as in time.
        if !matches!(input, Input::Persisted { .. }) {
            self.timers(now);
        }
        match input {
            Input::Message(envelope) => self.message(envelope, now),
            Input::Peer {
                process: ProcessId::Node(controller),
                boot,
                alive,
            } => {
                let owner = Owner { controller, boot };
                if alive {
                    self.seen(owner);
                } else {
                    self.alive.remove(&owner);
                }
            }
            Input::Peer { .. } => {}
            Input::Image(image) => {
                for exports in &image.exports {
                    if let Some(foreign) = self.foreign.get_mut(&exports.mc) {
                        foreign.take(&image, &exports.outputs, now);
                    }
                }
            }
            Input::Persisted { ticket, result } => self.persisted(ticket, result, now),
            Input::Local(GatewayLocal::Frame(bytes)) => self.frame(&bytes, now),
            Input::Local(GatewayLocal::Field(inputs)) => {
                for input in inputs {
                    if let Some(gate) = self.gates.get_mut(&input.mc) {
                        gate.set_inputs(&input.bytes, input.fresh, now);
                    }
                }
                if std::mem::take(&mut self.reading) {
                    self.publish(now);
                }
            }
            Input::Local(GatewayLocal::FieldDeviceLost { device, why }) => {
                let text = format!(
                    "gateway {}: field device {device} does not answer: {why}; its inputs are not fresh, its MCs stand still until it is back",
                    self.id
                );
                self.event(
                    now,
                    Event::new(Severity::Alarm, EventKind::FieldDeviceLost, text),
                );
            }
            Input::Local(GatewayLocal::FieldDeviceBack { device }) => {
                let text = format!("gateway {}: field device {device} answers", self.id);
                self.event(
                    now,
                    Event::new(Severity::Info, EventKind::FieldDeviceBack, text),
                );
            }
            Input::Local(GatewayLocal::BadMessages(count)) => self.unreadable = count,
            Input::Local(GatewayLocal::Wake) => self.tick(now),
            Input::Local(GatewayLocal::Leave) => self.leave(now),
        }
    }

    fn handle_timeout(&mut self, now: Now) {
        self.timers(now);
        self.tick(now);
    }

    fn poll_output(&mut self) -> Option<GatewayOutput> {
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<(Now, &'static str)> {
        let mut next = (self.next_tick, "tick");
        for gate in self.gates.values() {
            for (at, why) in [
                (gate.watchdog_at(), "watchdog"),
                (gate.suspect_at(), "silence report"),
            ] {
                if let Some(at) = at.filter(|at| *at < next.0) {
                    next = (at, why);
                }
            }
        }
        Some(next)
    }
}
