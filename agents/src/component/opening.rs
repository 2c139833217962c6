//! From an order to activate to the first scan: wait for the release, ask the gateway, read the state, diagnose, start.

use super::events::ActivateOrder;
use super::{Action, McAgent, Next, OPEN_REPEAT_US, State, Variables, Verdict, diagnose};
use fam_proto::access::{Activation, McAct, Start, StateSource};
use fam_proto::{
    Checkpoint, CheckpointId, Epoch, McOutcome, Message, Now, Open, OpenRefusal, Opened, OrderId,
    Owner, Reset, Successor, TrapInfo,
};
use std::sync::Arc;

/// An activation under way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Opening {
    pub order: OrderId,
    pub epoch: Epoch,
    force: bool,
    reset: Option<Reset>,
    until: Now,
    within_us: u64,
    /// The staged version that is to run.
    renew: Option<u64>,
    /// The copy held here did not fit: the gateway's is wanted.
    send_bytes: bool,
    /// What the gateway said last.
    refusal: Option<OpenRefusal>,
    step: Step,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Step {
    /// Until this owner has released the MC to us.
    Waiting(Owner),
    /// Until the gateway answers; asked again at this time.
    Asking(Now),
    /// Until the passive instance has given the checkpoint that was granted.
    Reading(Box<Opened>),
    /// Until the scan thread has taken it over.
    Starting(Starting),
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Starting {
    base: Option<CheckpointId>,
    recovery: u16,
    stopping: bool,
    interval: Option<String>,
    /// An order to stop that came meanwhile.
    stop: Option<OrderId>,
}

// What the gateway said last is told to people.
impl std::hash::Hash for Opening {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (self.order, self.epoch, self.force, self.reset).hash(state);
        (self.until, self.send_bytes, &self.step).hash(state);
    }
}

impl Opening {
    pub(super) fn deadline(&self) -> Option<(Now, &'static str)> {
        match &self.step {
            Step::Waiting(_) => Some((self.until, "give up waiting for the release")),
            Step::Asking(again) if *again < self.until => Some((*again, "ask the gateway again")),
            Step::Asking(_) => Some((self.until, "give up opening")),
            Step::Reading(_) => Some((self.until, "give up reading the state")),
            Step::Starting(_) => None,
        }
    }
}

impl McAgent {
    /// Passive, stopped or faulted: the order is carried out.
    pub(super) fn begin(&mut self, order: ActivateOrder, now: Now) -> Next {
        let us = Successor {
            epoch: order.epoch,
            owner: self.config.owner.clone(),
        };
        let released = self.handed.as_ref() == Some(&us);
        let mut opening = Box::new(Opening {
            order: order.id,
            epoch: order.epoch,
            force: order.force,
            reset: order.reset,
            until: now.plus_us(order.within_us),
            within_us: order.within_us,
            renew: order.renew,
            send_bytes: false,
            refusal: None,
            step: Step::Asking(now),
        });
        match order.after {
            Some(owner) if !released => opening.step = Step::Waiting(owner),
            _ => self.ask(&mut opening, now),
        }
        State::Opening(opening).silent()
    }

    fn ask(&mut self, opening: &mut Opening, now: Now) {
        opening.step = Step::Asking(now.plus_us(OPEN_REPEAT_US));
        let staged = self.staged.as_ref().filter(|_| opening.renew.is_some());
        let runs = staged.unwrap_or(&self.config);
        // A new version asks for the bytes: what is held here is not in its layout.
        let held = self
            .held
            .filter(|_| !opening.send_bytes && staged.is_none());
        let open = Open {
            mc: self.config.mc.clone(),
            epoch: opening.epoch,
            owner: self.config.owner.clone(),
            layout: runs.layout,
            held,
            force: opening.force,
            reset: opening.reset,
        };
        self.send_gateway(Message::Open(open));
    }

    /// Another order to activate: a higher epoch replaces this one.
    pub(super) fn overtake(
        &mut self,
        opening: Box<Opening>,
        order: ActivateOrder,
        now: Now,
    ) -> Next {
        if order.epoch <= opening.epoch {
            let why = format!("epoch {} is being opened already", opening.epoch);
            return State::Opening(opening).report(Some(order.id), McOutcome::NotOpened(why));
        }
        self.withdraw(&opening);
        self.begin(order, now)
    }

    /// What the scan thread may have got of this epoch is taken back.
    fn withdraw(&mut self, opening: &Opening) {
        if matches!(opening.step, Step::Starting(_)) {
            self.act(McAct::Deactivate {
                epoch: opening.epoch,
            });
        }
    }

    pub(super) fn cancel_opening(
        &mut self,
        opening: Box<Opening>,
        id: OrderId,
        epoch: Epoch,
    ) -> Next {
        if epoch != opening.epoch || matches!(opening.step, Step::Starting(_)) {
            return State::Opening(opening).report(Some(id), McOutcome::Changed);
        }
        State::Passive.report(
            Some(opening.order),
            McOutcome::NotOpened("the manager has called it off".to_owned()),
        )
    }

    pub(super) fn stop_opening(
        &mut self,
        mut opening: Box<Opening>,
        id: OrderId,
        epoch: Epoch,
    ) -> Next {
        if epoch != opening.epoch {
            return State::Opening(opening).report(Some(id), McOutcome::Changed);
        }
        if let Step::Starting(starting) = &mut opening.step {
            starting.stop = Some(id);
            return State::Opening(opening).silent();
        }
        State::Passive.report(
            Some(id),
            McOutcome::NotOpened("an order to stop came before it was open".to_owned()),
        )
    }

    pub(super) fn handed_over(
        &mut self,
        mut opening: Box<Opening>,
        successor: &Successor,
        now: Now,
    ) -> Next {
        if successor.epoch == opening.epoch && matches!(opening.step, Step::Waiting(_)) {
            self.ask(&mut opening, now);
        }
        State::Opening(opening).silent()
    }

    pub(super) fn refused(&mut self, mut opening: Box<Opening>, why: &OpenRefusal) -> Next {
        if !matches!(opening.step, Step::Asking(_)) {
            return State::Opening(opening).silent();
        }
        match why {
            // The owner may be about to fall silent, or its released frame is still on the way.
            OpenRefusal::OwnerFresh => {
                opening.refusal = Some(why.clone());
                State::Opening(opening).silent()
            }
            OpenRefusal::StaleEpoch
            | OpenRefusal::NotSuccessor
            | OpenRefusal::NeedsReset
            | OpenRefusal::Layout
            | OpenRefusal::UnknownMc
            | OpenRefusal::NotDurable(_) => {
                let why = format!("gateway {} refuses: {why}", self.config.gateway);
                State::Passive.report(Some(opening.order), McOutcome::NotOpened(why))
            }
        }
    }

    pub(super) fn granted(
        &mut self,
        mut opening: Box<Opening>,
        mut grant: Box<Opened>,
        now: Now,
    ) -> Next {
        if !matches!(opening.step, Step::Asking(_)) {
            return State::Opening(opening).silent();
        }
        if opening.renew.is_some()
            && let Some(why) = super::renewing::objection(&grant)
        {
            return self.give_up(opening, why);
        }
        match (grant.base, grant.checkpoint.take()) {
            (None, _) => self.start(opening, &grant, None, now),
            (Some(base), Some(checkpoint)) => {
                if checkpoint.layout != self.config.layout {
                    return self.give_up(
                        opening,
                        "the record's checkpoint has another layout; generate all projects from one model"
                            .to_owned(),
                    );
                }
                if checkpoint.id != base || !checkpoint.is_intact() {
                    // Damaged on the way: the grant is repeated with the next open.
                    return State::Opening(opening).silent();
                }
                self.start(opening, &grant, Some((Arc::from(checkpoint), false)), now)
            }
            (Some(base), None) => {
                self.act(McAct::ReadState { id: base });
                opening.step = Step::Reading(grant);
                State::Opening(opening).silent()
            }
        }
    }

    pub(super) fn state_read(
        &mut self,
        mut opening: Box<Opening>,
        id: CheckpointId,
        checkpoint: Option<Arc<Checkpoint>>,
        now: Now,
    ) -> Next {
        let grant = match &opening.step {
            Step::Reading(grant) if grant.base == Some(id) => grant.clone(),
            _ => return State::Opening(opening).silent(),
        };
        match checkpoint {
            Some(checkpoint) if checkpoint.id == id && checkpoint.layout == self.config.layout => {
                self.start(opening, &grant, Some((checkpoint, true)), now)
            }
            _ => {
                opening.send_bytes = true;
                self.ask(&mut opening, now);
                State::Opening(opening).silent()
            }
        }
    }

    /// The state is known: diagnose, and hand over to the scan thread.
    fn start(
        &mut self,
        mut opening: Box<Opening>,
        grant: &Opened,
        checkpoint: Option<(Arc<Checkpoint>, bool)>,
        now: Now,
    ) -> Next {
        let state = checkpoint.as_ref().map(|(c, _)| c.as_ref());
        let decision = match diagnose(&self.config.diagnosis, grant, state) {
            Verdict::Run(decision) => decision,
            Verdict::NoWayBack(why) => {
                let trap = TrapInfo {
                    pou: format!("{}_Control", self.config.mc),
                    file: String::new(),
                    line: 0,
                    message: why,
                };
                let state = self.close(opening.epoch, trap.clone(), now);
                return state.report(Some(opening.order), McOutcome::Faulted(trap));
            }
        };
        let start = match (checkpoint, decision.variables) {
            (None, _) | (_, Variables::Initial) => Start::Initial,
            (Some((checkpoint, held)), variables) => Start::From {
                source: if held {
                    StateSource::Held(checkpoint.id)
                } else {
                    StateSource::Given(checkpoint)
                },
                retained_only: variables == Variables::RetainedOnly,
            },
        };
        self.act(McAct::Activate(Box::new(Activation {
            epoch: opening.epoch,
            base: grant.base,
            start,
            recovery: decision.recovery,
            keep_action: decision.keep_action,
            outputs: grant.outputs.clone(),
            next_scan: grant.next_scan,
            at_once: grant.interrupted,
            renew: opening.renew,
        })));
        opening.step = Step::Starting(Starting {
            base: grant.base,
            recovery: decision.recovery,
            stopping: decision.stopping,
            interval: decision.interval,
            stop: None,
        });
        State::Opening(opening).silent()
    }

    pub(super) fn started(&mut self, opening: Box<Opening>, now: Now) -> Next {
        let Step::Starting(starting) = opening.step else {
            return State::Opening(opening).silent();
        };
        let epoch = opening.epoch;
        if opening.renew.is_some() {
            self.change_version();
        }
        let action = Action {
            stopping: starting.stopping,
            stop_pou: self.config.diagnosis.stop_action == Some(starting.recovery),
            ..Action::default()
        };
        let recovering = (starting.recovery != 0).then_some(action);
        let outcome = McOutcome::Activated {
            base: starting.base,
            recovery: starting.recovery,
            interval: starting.interval,
        };
        let state = super::running_on(epoch, recovering);
        match starting.stop {
            None => state.report(Some(opening.order), outcome),
            Some(stop) => {
                self.state = state.clone();
                self.report(Some(opening.order), outcome);
                match state {
                    State::Recovering { epoch, action } => {
                        self.stop_recovering(epoch, action, stop, epoch, now)
                    }
                    other => self.stop(epoch, other, stop, epoch, now),
                }
            }
        }
    }

    /// The stop has ended, and the word that it began is still on the way.
    pub(super) fn stopped_before_started(&mut self, opening: Box<Opening>) -> Next {
        let Step::Starting(_) = opening.step else {
            return State::Opening(opening).silent();
        };
        if opening.renew.is_some() {
            self.change_version();
        }
        let epoch = opening.epoch;
        State::Stopped { epoch }.report(Some(opening.order), McOutcome::Stopped)
    }

    pub(super) fn give_up(&mut self, opening: Box<Opening>, why: String) -> Next {
        self.withdraw(&opening);
        State::Passive.report(Some(opening.order), McOutcome::NotOpened(why))
    }

    pub(super) fn opening_timeout(&mut self, mut opening: Box<Opening>, now: Now) -> Next {
        if now < opening.until || matches!(opening.step, Step::Starting(_)) {
            if matches!(opening.step, Step::Asking(again) if again <= now) {
                self.ask(&mut opening, now);
            }
            return State::Opening(opening).silent();
        }
        let gateway = &self.config.gateway;
        let within_ms = opening.within_us / 1_000;
        let why = match (&opening.step, &opening.refusal) {
            (Step::Waiting(owner), _) => {
                format!("{owner} has not released it within {within_ms} ms")
            }
            (Step::Reading(_), _) => {
                format!("the passive instance did not give its state within {within_ms} ms")
            }
            (_, Some(refusal)) => {
                format!("gateway {gateway} refused for {within_ms} ms: {refusal}")
            }
            (_, None) => format!("gateway {gateway} did not answer within {within_ms} ms"),
        };
        State::Passive.report(Some(opening.order), McOutcome::NotOpened(why))
    }
}
