//! The MC Agent (MCA): manages the execution of one MC on one controller.
//!
//! ```text
//!                       Activate                        Started, recovery 0
//!            +---------------------------> Opening ---------------------------+
//!            |     refused, deadline,      |  |                               |
//!            |     overtaken, cancelled    |  | Started, recovery > 0         v
//!        Passive <-------------------------+  +--> Recovering -- Recovered -> Active
//!         ^ ^ ^                            |         |  |  ^                  |  | ^
//!         | | |      no way back           |         |  |  +--- Trapped, Stop-+  | | ReleaseCancelled
//!         | | |  +-------------------------+         |  |   (stop POU runs)      | |
//!         | | |  |                                   |  |   Release              v |
//!         | | |  |                          Stopped  |  +-------------------> Releasing
//!         | | |  |      Trapped without a stop POU   |                           |
//!         | | |  |      (from any running state)     |                           | Released
//!         | | |  v                                   v                           v
//!         | | +-Faulted <----------(after a trap)-- Stopped                   Passive
//!         | +------------------------------------------+
//!         |      a higher epoch on record; Activate leads back to Opening
//!         +-- Lost, Deposed: from Active, Recovering and Releasing
//! ```
//!
//! It reaches its MC through [`McAct`] and hears of it through [`McNews`] only. It diagnoses the checkpoint of a
//! grant itself ([`diagnose`]). Whether it may drive is told by the gateway's record and by nothing else.

mod diagnose;
mod events;
mod opening;
mod renewing;
mod running;
#[cfg(test)]
mod scenario_tests;
#[cfg(test)]
mod table_tests;

pub use diagnose::{Decision, Variables, Verdict, diagnose};

use crate::node::{NodeAct, NodeOutput};
use events::{ActivateOrder, Event};
use fam_proto::access::{McAct, McNews};
use fam_proto::diagnosis::Diagnosis;
use fam_proto::{
    AgentId, BootId, CheckpointId, Close, Envelope, Epoch, GatewayId, Holding, InputImage,
    LayoutHash, McId, McOutcome, McReport, McaState, Message, Now, Order, OrderId, Owner,
    Successor, TrapInfo,
};
use opening::Opening;
use std::collections::VecDeque;
use std::sync::Arc;

/// How often an open is repeated until it is answered, in microseconds.
pub const OPEN_REPEAT_US: u64 = 2_000;
/// How often the gateway is told of a fault until its record shows it, in microseconds.
pub const CLOSE_REPEAT_US: u64 = 20_000;
/// How long after a release's own deadline the scan thread is asked again whether it is off, in microseconds.
pub const RELEASE_GRACE_US: u64 = 100_000;
/// An order whose number is further ahead than this is carried out when it comes for the second time.
pub const ORDERS_AHEAD: u64 = 1_000;

/// What an MCA is made for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ComponentConfig {
    /// The controller in this life.
    pub owner: Owner,
    /// The MC.
    pub mc: McId,
    /// Its gateway.
    pub gateway: GatewayId,
    /// Hash of logic, layout and masks.
    pub version: u64,
    /// Layout of its checkpoints here.
    pub layout: LayoutHash,
    /// Its diagnosis file.
    pub diagnosis: Diagnosis,
}

/// What the action under way is for.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Action {
    /// It ends in a safe stop.
    stopping: bool,
    /// It is the stop POU itself: nothing is left to be tried after it.
    stop_pou: bool,
    /// It answers this trap.
    trap: Option<TrapInfo>,
    /// It answers this order.
    order: Option<OrderId>,
}

/// The state, with what each needs (drawn above).
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum State {
    Passive,
    Opening(Box<Opening>),
    Active {
        epoch: Epoch,
    },
    Releasing {
        epoch: Epoch,
        order: OrderId,
        /// When the scan thread is asked again.
        until: Now,
        /// A recovery that is still under way.
        recovering: Option<Action>,
    },
    Recovering {
        epoch: Epoch,
        action: Action,
    },
    Stopped {
        epoch: Epoch,
    },
    Faulted {
        epoch: Epoch,
        trap: TrapInfo,
        /// When the gateway is told again; `None` once it knows.
        close_at: Option<Now>,
    },
}

/// State after an event, and what the manager is told.
struct Next {
    state: State,
    report: Option<(Option<OrderId>, McOutcome)>,
}

impl State {
    fn silent(self) -> Next {
        Next {
            state: self,
            report: None,
        }
    }
    fn report(self, order: Option<OrderId>, outcome: McOutcome) -> Next {
        Next {
            state: self,
            report: Some((order, outcome)),
        }
    }
}

/// The MC Agent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct McAgent {
    config: Arc<ComponentConfig>,
    state: State,
    /// Newest order, with the life of the manager that gave it: a repetition is answered and not carried out again.
    order: Option<(BootId, OrderId)>,
    /// An order with a number far ahead, seen once: orders are repeated as they are, damage is not.
    doubtful: Option<(BootId, Order)>,
    /// The report that answered it.
    answered: Option<McReport>,
    /// Newest checkpoint in the passive instance.
    held: Option<CheckpointId>,
    /// Newest release to this controller that was seen.
    handed: Option<Successor>,
    /// A version that is ready beside the one that runs.
    staged: Option<Arc<ComponentConfig>>,
    /// An order to run it that came before the scan thread said that the release is through.
    renewal: Option<ActivateOrder>,
    out: VecDeque<NodeOutput>,
}

// An answer is repeated as it was; which order it answers, and how, is all that others act on.
impl std::hash::Hash for McAgent {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (&self.config.owner, &self.config.mc).hash(state);
        (&self.state, self.order, &self.doubtful).hash(state);
        let answered = self.answered.as_ref();
        answered
            .map(|r| (r.order, std::mem::discriminant(&r.outcome)))
            .hash(state);
        (self.held, &self.handed, &self.out).hash(state);
    }
}

impl McAgent {
    /// A passive MCA.
    #[must_use]
    pub fn new(config: ComponentConfig) -> McAgent {
        McAgent {
            config: Arc::new(config),
            state: State::Passive,
            order: None,
            doubtful: None,
            answered: None,
            held: None,
            handed: None,
            staged: None,
            renewal: None,
            out: VecDeque::new(),
        }
    }

    /// The MC.
    #[must_use]
    pub fn mc(&self) -> &McId {
        &self.config.mc
    }

    /// The MC's gateway.
    #[must_use]
    pub fn gateway(&self) -> &GatewayId {
        &self.config.gateway
    }

    /// The newest order, and the life of the manager that gave it.
    #[must_use]
    pub fn newest_order(&self) -> Option<(BootId, OrderId)> {
        self.order
    }

    /// State as others see it.
    #[must_use]
    pub fn state(&self) -> McaState {
        match &self.state {
            State::Passive => McaState::Passive,
            State::Opening(_) => McaState::Opening,
            State::Active { .. } => McaState::Active,
            State::Releasing { .. } => McaState::Releasing,
            State::Recovering { .. } => McaState::Recovering,
            State::Stopped { .. } => McaState::Stopped,
            State::Faulted { .. } => McaState::Faulted,
        }
    }

    /// The epoch that it is about, if any.
    #[must_use]
    pub fn epoch(&self) -> Option<Epoch> {
        match &self.state {
            State::Passive => None,
            State::Opening(opening) => Some(opening.epoch),
            State::Active { epoch }
            | State::Releasing { epoch, .. }
            | State::Recovering { epoch, .. }
            | State::Stopped { epoch }
            | State::Faulted { epoch, .. } => Some(*epoch),
        }
    }

    /// The epoch under which the MC runs here now.
    #[must_use]
    pub fn active_epoch(&self) -> Option<Epoch> {
        match self.state() {
            McaState::Active | McaState::Releasing | McaState::Recovering => self.epoch(),
            McaState::Passive | McaState::Opening | McaState::Stopped | McaState::Faulted => None,
        }
    }

    /// Whether anything of it would be lost if the node ended now.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.active_epoch().is_some() || self.state() == McaState::Opening
    }

    /// The passive instance holds this checkpoint now.
    pub fn held(&mut self, id: CheckpointId) {
        self.held = Some(id);
    }

    /// An order of the manager in the life `boot`: acknowledged always, carried out once. Which life counts is told before
    /// (`ControllerAgent::is_over`).
    pub fn order(&mut self, boot: BootId, order: Order, now: Now) {
        // Numbers begin with the boot id and count on. One damaged number must not make the MCA deaf to the orders to come.
        let last = self.order.filter(|(known, _)| *known == boot);
        let last = last.map_or(boot.0, |(_, id)| id.0);
        if order.id.0 > last.saturating_add(ORDERS_AHEAD)
            && self.doubtful.as_ref() != Some(&(boot, order.clone()))
        {
            self.doubtful = Some((boot, order));
            return;
        }
        self.doubtful = None;
        self.send(AgentId::Manager, Message::OrderReceived(order.id));
        let this = (boot, order.id);
        if self
            .order
            .is_some_and(|(known, last)| known == boot && order.id <= last)
        {
            if let Some(report) = self.answered.clone()
                && report.order == Some(order.id)
                && self.order == Some(this)
            {
                self.send(AgentId::Manager, Message::McReport(report));
            }
            return;
        }
        self.order = Some(this);
        self.answered = None;
        self.step(Event::from_order(order), now);
    }

    /// The gateway's word.
    pub fn gateway_message(&mut self, body: Message, now: Now) {
        match body {
            Message::Opened(opened)
                if Some(opened.epoch) == self.epoch() && opened.owner == self.config.owner =>
            {
                self.step(Event::Opened(Box::new(opened)), now);
            }
            Message::OpenRefused(refused) if Some(refused.epoch) == self.epoch() => {
                self.step(Event::Refused(refused.why), now);
            }
            _ => {} // a late word about another epoch
        }
    }

    /// A negotiation asks what is held.
    pub fn call(&mut self, negotiation: u64) {
        let holding = Holding {
            negotiation,
            mc: self.config.mc.clone(),
            owner: self.config.owner.clone(),
            held: self.held,
        };
        self.send(AgentId::Decision, Message::Holding(holding));
    }

    /// A new image of the MC's gateway.
    pub fn image(&mut self, image: &InputImage, now: Now) {
        if let Some(record) = image.record_of(&self.config.mc)
            && let Some(event) = self.judge(record)
        {
            self.step(event, now);
        }
    }

    /// News of the MC.
    pub fn news(&mut self, news: McNews, now: Now) {
        if let Some(epoch) = news.epoch()
            && Some(epoch) != self.epoch()
        {
            return; // a late word about another epoch
        }
        if let Some(event) = Event::from_news(news, &self.config.owner) {
            self.step(event, now);
        }
    }

    /// The deadline has come.
    pub fn handle_timeout(&mut self, now: Now) {
        if self.poll_timeout().is_some_and(|(at, _)| at <= now) {
            self.step(Event::Timeout, now);
        }
    }

    /// The next deadline, and why.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<(Now, &'static str)> {
        match &self.state {
            State::Opening(opening) => opening.deadline(),
            State::Releasing { until, .. } => Some((*until, "release is overdue")),
            State::Faulted {
                close_at: Some(at), ..
            } => Some((*at, "tell the gateway of a fault again")),
            _ => None,
        }
    }

    /// The next output.
    pub fn poll_output(&mut self) -> Option<NodeOutput> {
        self.out.pop_front()
    }

    /// The whole state machine: every state with every event. Events about other epochs have been sorted out before.
    #[rustfmt::skip]
    fn step(&mut self, event: Event, now: Now) {
        use Event as E;
        use State as S;
        let state = std::mem::replace(&mut self.state, State::Passive);
        if let E::Handed(successor) = &event {
            self.handed = Some(successor.clone());
        }
        let next = match (state, event) {
            // --- New versions, in every state
            (s, E::Renew(order)) => self.renew(s, order, now),
            (s, E::Adopt { id, version }) => self.adopt(s, id, version),

            // --- Passive
            (S::Passive, E::Activate(order)) => self.begin(order, now),
            (s @ S::Passive, E::Release(order)) => s.report(Some(order.id), not_released("it is not active here")),
            (s @ S::Passive, E::CancelRelease { id, .. } | E::Stop { id, .. }) => s.report(Some(id), McOutcome::Changed),
            (s @ S::Passive, E::Opened(_) | E::Refused(_) | E::State { .. } | E::Handed(_) | E::Lost { .. } | E::FaultOnRecord
                | E::Started | E::NotStarted(_) | E::Recovered | E::Released(_) | E::ReleaseCancelled(_) | E::Stopped
                | E::Trapped(_) | E::Deposed(_) | E::Timeout) => s.silent(),

            // --- Opening
            (S::Opening(o), E::Activate(order)) => self.overtake(o, order, now),
            (s @ S::Opening(_), E::Release(order)) => s.report(Some(order.id), not_released("it is not active yet")),
            (S::Opening(o), E::CancelRelease { id, epoch }) => self.cancel_opening(o, id, epoch),
            (S::Opening(o), E::Stop { id, epoch }) => self.stop_opening(o, id, epoch),
            (S::Opening(o), E::Opened(grant)) => self.granted(o, grant, now),
            (S::Opening(o), E::Refused(why)) => self.refused(o, &why),
            (S::Opening(o), E::State { id, checkpoint }) => self.state_read(o, id, checkpoint, now),
            (S::Opening(o), E::Handed(successor)) => self.handed_over(o, &successor, now),
            (S::Opening(o), E::Lost { why, .. } | E::Deposed(why)) => self.give_up(o, why),
            (S::Opening(o), E::FaultOnRecord) => self.give_up(o, "the gateway's record shows a fault".to_owned()),
            (S::Opening(o), E::Started) => self.started(o, now),
            (S::Opening(o), E::NotStarted(why)) => self.give_up(o, why),
            (S::Opening(o), E::Timeout) => self.opening_timeout(o, now),
            (s @ S::Opening(_), E::Recovered | E::Released(_) | E::ReleaseCancelled(_) | E::Trapped(_)) => s.silent(),
            (S::Opening(o), E::Stopped) => self.stopped_before_started(o),

            // --- Active
            (s @ S::Active { .. }, E::Activate(order)) => self.activate_while_running(s, order, now),
            (S::Active { epoch }, E::Release(order)) => self.release(epoch, None, order, now),
            (s @ S::Active { .. }, E::CancelRelease { id, .. }) => s.report(Some(id), McOutcome::Changed),
            (S::Active { epoch }, E::Stop { id, epoch: meant }) => self.stop(epoch, S::Active { epoch }, id, meant, now),
            (S::Active { epoch }, E::Lost { why, .. } | E::Deposed(why)) => self.deposed(epoch, why),
            (S::Active { epoch }, E::FaultOnRecord) => self.deposed(epoch, "the gateway's record shows a fault".to_owned()),
            (S::Active { .. }, E::Released(scan)) => S::Passive.report(None, McOutcome::Released { scan }),
            (S::Active { epoch }, E::Stopped) => S::Stopped { epoch }.report(None, McOutcome::Stopped),
            (S::Active { epoch }, E::Trapped(trap)) => self.trapped(epoch, &Action::default(), trap, now),
            (s @ S::Active { .. }, E::Opened(_) | E::Refused(_) | E::State { .. } | E::Handed(_) | E::Started | E::NotStarted(_)
                | E::Recovered | E::ReleaseCancelled(_) | E::Timeout) => s.silent(),

            // --- Releasing
            (s @ S::Releasing { .. }, E::Activate(order)) => self.activate_while_running(s, order, now),
            (S::Releasing { epoch, recovering, .. }, E::Release(order)) => self.release(epoch, recovering, order, now),
            (s @ S::Releasing { .. }, E::CancelRelease { id, epoch }) => self.cancel_release(s, id, epoch),
            (s @ S::Releasing { epoch, .. }, E::Stop { id, epoch: meant }) => self.stop(epoch, s, id, meant, now),
            (S::Releasing { epoch, .. }, E::Lost { why, .. } | E::Deposed(why)) => self.deposed(epoch, why),
            (S::Releasing { epoch, .. }, E::FaultOnRecord) => self.deposed(epoch, "the gateway's record shows a fault".to_owned()),
            (S::Releasing { epoch, order, until, .. }, E::Recovered) =>
                S::Releasing { epoch, order, until, recovering: None }.report(None, McOutcome::Recovered),
            (S::Releasing { order, .. }, E::Released(scan)) => S::Passive.report(Some(order), McOutcome::Released { scan }),
            (S::Releasing { epoch, order, recovering, .. }, E::ReleaseCancelled(why)) =>
                running_on(epoch, recovering).report(Some(order), McOutcome::ReleaseCancelled(why)),
            (S::Releasing { epoch, order, .. }, E::Stopped) => S::Stopped { epoch }.report(Some(order), McOutcome::Stopped),
            (S::Releasing { epoch, recovering, .. }, E::Trapped(trap)) => self.trapped(epoch, &recovering.unwrap_or_default(), trap, now),
            (S::Releasing { epoch, order, recovering, .. }, E::Timeout) => {
                self.act(McAct::CancelRelease { epoch });
                S::Releasing { epoch, order, recovering, until: now.plus_us(RELEASE_GRACE_US) }.silent()
            }
            (s @ S::Releasing { .. }, E::Opened(_) | E::Refused(_) | E::State { .. } | E::Handed(_) | E::Started | E::NotStarted(_)) => s.silent(),

            // --- Recovering
            (s @ S::Recovering { .. }, E::Activate(order)) => self.activate_while_running(s, order, now),
            (s @ S::Recovering { action: Action { stopping: true, .. }, .. }, E::Release(order)) =>
                s.report(Some(order.id), not_released("it is being stopped safely")),
            (S::Recovering { epoch, action }, E::Release(order)) => self.release(epoch, Some(action), order, now),
            (s @ S::Recovering { .. }, E::CancelRelease { id, .. }) => s.report(Some(id), McOutcome::Changed),
            (S::Recovering { epoch, action }, E::Stop { id, epoch: meant }) => self.stop_recovering(epoch, action, id, meant, now),
            (S::Recovering { epoch, .. }, E::Lost { why, .. } | E::Deposed(why)) => self.deposed(epoch, why),
            (S::Recovering { epoch, .. }, E::FaultOnRecord) => self.deposed(epoch, "the gateway's record shows a fault".to_owned()),
            (S::Recovering { epoch, action }, E::Recovered) => S::Active { epoch }.report(action.order, McOutcome::Recovered),
            (S::Recovering { action, .. }, E::Released(scan)) => S::Passive.report(action.order, McOutcome::Released { scan }),
            (S::Recovering { epoch, action }, E::Stopped) => stopped(epoch, action),
            (S::Recovering { epoch, action }, E::Trapped(trap)) => self.trapped(epoch, &action, trap, now),
            (s @ S::Recovering { .. }, E::Opened(_) | E::Refused(_) | E::State { .. } | E::Handed(_) | E::Started | E::NotStarted(_)
                | E::ReleaseCancelled(_) | E::Timeout) => s.silent(),

            // --- Stopped
            (S::Stopped { .. }, E::Activate(order)) => self.begin(order, now),
            (s @ S::Stopped { .. }, E::Release(order)) => s.report(Some(order.id), not_released("it is stopped")),
            (s @ S::Stopped { .. }, E::CancelRelease { id, .. }) => s.report(Some(id), McOutcome::Changed),
            (s @ S::Stopped { .. }, E::Stop { id, .. }) => s.report(Some(id), McOutcome::Stopped),
            (S::Stopped { .. }, E::Lost { overtaken: true, .. }) => S::Passive.report(None, McOutcome::Changed),
            (s @ S::Stopped { .. }, E::Lost { overtaken: false, .. } | E::FaultOnRecord | E::Opened(_) | E::Refused(_) | E::State { .. }
                | E::Handed(_) | E::Started | E::NotStarted(_) | E::Recovered | E::Released(_) | E::ReleaseCancelled(_) | E::Stopped
                | E::Trapped(_) | E::Deposed(_) | E::Timeout) => s.silent(),

            // --- Faulted
            (S::Faulted { .. }, E::Activate(order)) => self.begin(order, now),
            (s @ S::Faulted { .. }, E::Release(order)) => s.report(Some(order.id), not_released("its logic has trapped")),
            (s @ S::Faulted { .. }, E::CancelRelease { id, .. } | E::Stop { id, .. }) => s.report(Some(id), McOutcome::Changed),
            (S::Faulted { .. }, E::Lost { overtaken: true, .. }) => S::Passive.report(None, McOutcome::Changed),
            (S::Faulted { epoch, trap, .. }, E::FaultOnRecord | E::Lost { overtaken: false, .. }) =>
                S::Faulted { epoch, trap, close_at: None }.silent(),
            (S::Faulted { epoch, trap, .. }, E::Timeout) => self.close(epoch, trap, now).silent(),
            (s @ S::Faulted { .. }, E::Opened(_) | E::Refused(_) | E::State { .. } | E::Handed(_) | E::Started | E::NotStarted(_)
                | E::Recovered | E::Released(_) | E::ReleaseCancelled(_) | E::Stopped | E::Trapped(_) | E::Deposed(_)) => s.silent(),
        };
        self.state = next.state;
        if let Some((order, outcome)) = next.report {
            self.report(order, outcome);
        }
        if !matches!(self.state, S::Releasing { .. })
            && let Some(order) = self.renewal.take()
        {
            self.step(E::Renew(order), now);
        }
    }

    fn report(&mut self, order: Option<OrderId>, outcome: McOutcome) {
        let report = McReport {
            mc: self.config.mc.clone(),
            owner: self.config.owner.clone(),
            state: self.state(),
            epoch: self.epoch(),
            order,
            outcome,
        };
        if order.is_some() {
            self.answered = Some(report.clone());
        }
        self.send(AgentId::Manager, Message::McReport(report));
    }

    fn send(&mut self, to: AgentId, body: Message) {
        self.out.push_back(NodeOutput::Send(Envelope {
            from: AgentId::Component(self.config.owner.controller.clone(), self.config.mc.clone()),
            boot: self.config.owner.boot,
            to,
            body,
        }));
    }

    fn send_gateway(&mut self, body: Message) {
        self.send(AgentId::Gateway(self.config.gateway.clone()), body);
    }

    fn act(&mut self, act: McAct) {
        self.out.push_back(NodeOutput::Act(NodeAct::Mc {
            mc: self.config.mc.clone(),
            act,
        }));
    }

    /// Tells the gateway to set the fail-safe values, until its record shows the fault.
    fn close(&mut self, epoch: Epoch, trap: TrapInfo, now: Now) -> State {
        let close = Close {
            mc: self.config.mc.clone(),
            epoch,
            owner: self.config.owner.clone(),
            trap: trap.clone(),
        };
        self.send_gateway(Message::Close(close));
        State::Faulted {
            epoch,
            trap,
            close_at: Some(now.plus_us(CLOSE_REPEAT_US)),
        }
    }
}

fn not_released(why: &str) -> McOutcome {
    McOutcome::ReleaseCancelled(why.to_owned())
}

fn running_on(epoch: Epoch, recovering: Option<Action>) -> State {
    match recovering {
        None => State::Active { epoch },
        Some(action) => State::Recovering { epoch, action },
    }
}

/// The stop action has ended: stopped on order or by diagnosis, faulted if a trap was its cause.
fn stopped(epoch: Epoch, action: Action) -> Next {
    let state = match action.trap {
        None => State::Stopped { epoch },
        Some(trap) => State::Faulted {
            epoch,
            trap,
            close_at: None,
        },
    };
    state.report(action.order, McOutcome::Stopped)
}
