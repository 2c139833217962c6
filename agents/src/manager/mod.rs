//! The Middleware Manager (MM): registers controllers and MCs, owns the assignment and the epochs, orders activations.
//!
//! It decides nothing about placement (that is Diagnosis & Decision's) and nothing about recovery (the MC Agents'): it checks plans,
//! carries them out, and keeps the books. Its parts: the desk with outputs, tickets and history; the registry of controllers; the
//! records of the gateways; jobs (one for each MC on its way) with their orders; plans; operators' commands; the status.

mod agents;
mod desk;
mod jobs;
mod mc_reports;
mod operator;
mod orders;
mod plans;
mod records;
mod registry;
mod reload;
mod status;
mod tellers;

pub use agents::ManagerAgents;
pub use orders::{REPEAT_FAST, REPEAT_FAST_US, REPEAT_SLOW_US};
pub use plans::PlanRefusal;

use crate::cell_view::CellView;
use crate::decision::Wish;
use crate::epochs::Epochs;
use crate::monitor::News;
use desk::{Desk, Ticket};
use fam_proto::agent::Output;
use fam_proto::mark::{Mark, hash_marked};
use fam_proto::model::CellModel;
use fam_proto::{
    AgentId, BootId, ControllerId, Envelope, Epoch, Event, EventKind, InputImage, McId, Message,
    Now, OrderId, Plan, PlanId, ProcessId, RepoState, RepoWrite, Severity,
};
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// What the manager's process feeds in.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum ManagerLocal {
    /// Wall clock now, in microseconds since 1970: at the start, and again from time to time. For the history only.
    Wall {
        /// Microseconds since 1970.
        unix_us: u64,
    },
    /// Messages that did not read, since the start.
    BadMessages(u64),
}

/// What the manager's process does beside sending and storing.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum ManagerAct {
    /// A reconfiguration begins: event, decision and MCs stand in the plan.
    PlanBegan(Box<Plan>),
    /// It has ended.
    PlanEnded {
        /// The plan.
        plan: PlanId,
        /// What came of it.
        summary: String,
        /// Whether all moves went as planned.
        complete: bool,
    },
}

/// What the manager's agents put out.
pub type ManagerOutput = Output<RepoWrite, ManagerAct>;

/// From its start the manager waits this long for nodes to register before it plans; less if all that are seen have, in microseconds.
pub const SETTLE_US: u64 = 300_000;
/// It waits at least this long, in microseconds.
pub const SETTLE_MIN_US: u64 = 100_000;
/// A gateway without an image for this long counts as lost, in microseconds.
pub const GATEWAY_LOST_US: u64 = 1_000_000;
/// A repository that has failed is asked again after this long, in microseconds.
pub const REPOSITORY_RETRY_US: u64 = 1_000_000;

/// How far above its history a manager begins whose clock was set back, at most, in microseconds.
const DRAWN_US: u64 = 1_000_000;

/// The boot id of a manager that starts with what its repository holds: the wall clock, but above all lives of before, also if the
/// clock was set back in between. Otherwise nobody would heed it. `drawn` is a number that another life would not have: of two
/// lives that begin with one copy of a repository, behind a clock that was set back, each would take the other's orders for its own.
#[must_use]
pub fn boot_after(wall_us: u64, restored: &RepoState, drawn: u64) -> BootId {
    let before = restored.events.iter().map(|e| e.wall_us).max();
    let above = |us: u64| us.saturating_add(1 + drawn % DRAWN_US);
    BootId(wall_us.max(before.map_or(0, above)))
}

/// The agent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MiddlewareManager {
    view: CellView,
    started: Now,
    desk: Desk,
    epochs: Epochs,
    epochs_again: Option<Now>,
    jobs: BTreeMap<McId, jobs::Job>,
    orders: orders::Orders,
    running: BTreeMap<PlanId, plans::Running>,
    commands: operator::Commands,
    news: Vec<News>,
    wishes: Vec<(Wish, String)>,
    /// A new version of the cell that is being made ready, or is.
    reload: Option<reload::Reload>,
    /// When a controller that is to be emptied was tried last: version, generation, and when it is tried again.
    emptying: BTreeMap<ControllerId, (u64, PlanId, Now)>,
    /// Events of an MC that two sides may tell: the newest told.
    marks: BTreeMap<(EventKind, McId), (Epoch, u64)>,
    /// Newest activation of each MC that the history tells.
    activated: BTreeMap<McId, Epoch>,
    /// MCs without a place: how often tried, and whether the alarm was raised.
    unplaced: BTreeMap<McId, (u32, bool)>,
    /// Quality-of-service events told last, by cause.
    told: BTreeMap<String, (u64, PlanId)>,
    /// How much each process has told of late.
    tellers: tellers::Tellers,
    bad_messages: u64,
    bad_messages_link: u64,
}

// What was told or will be (the alarm of an MC without a place), and what is only counted, is no part of the state.
impl Hash for MiddlewareManager {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.view.hash(state);
        // When it began counts until it has settled.
        (!self.view.settled).then_some(self.started).hash(state);
        self.desk.hash(state);
        self.epochs.hash(state);
        self.epochs_again.hash(state);
        self.jobs.hash(state);
        self.orders.hash(state);
        self.running.hash(state);
        self.commands.hash(state);
        self.news.hash(state);
        self.wishes.hash(state);
        self.reload.hash(state);
        for (controller, (version, generation, again)) in &self.emptying {
            (controller, generation, again).hash(state);
            hash_marked(Mark::Count, *version, state);
        }
    }
}

impl MiddlewareManager {
    /// Takes up its work with what the repository holds.
    #[must_use]
    pub fn new(model: Arc<CellModel>, restored: RepoState, boot: BootId, now: Now) -> Self {
        let mut view = CellView::new(model);
        view.generation = restored.generation;
        for (mc, m) in &mut view.mcs {
            m.assigned = restored.assignment.get(mc).cloned();
            m.pinned = restored.pins.get(mc).cloned();
            m.stopped = restored.stopped.contains(mc);
        }
        for (controller, c) in &mut view.controllers {
            c.drained = restored.drained.contains(controller);
            c.remembered = restored.registrations.get(controller).cloned();
        }
        let mut activated = BTreeMap::new();
        for event in &restored.events {
            note_activation(&mut activated, event);
        }
        let mut manager = MiddlewareManager {
            started: now,
            activated,
            desk: Desk::new(boot, restored.events, restored.last_event_seq),
            epochs: Epochs::new(view.mcs.keys(), &restored.epochs),
            epochs_again: None,
            jobs: BTreeMap::new(),
            orders: orders::Orders::new(boot),
            running: BTreeMap::new(),
            commands: operator::Commands::default(),
            news: Vec::new(),
            wishes: Vec::new(),
            reload: None,
            emptying: BTreeMap::new(),
            marks: BTreeMap::new(),
            unplaced: BTreeMap::new(),
            told: BTreeMap::new(),
            tellers: tellers::Tellers::default(),
            bad_messages: 0,
            bad_messages_link: 0,
            view,
        };
        manager.desk.wall_is(now, boot.0);
        let text = format!(
            "manager of cell {} is up (boot {boot}), generation {}",
            manager.view.model.cell, manager.view.generation
        );
        manager.event(
            Event::new(Severity::Info, EventKind::ManagerStarted, text),
            now,
        );
        manager.reserve_epochs();
        manager
    }

    /// Its life.
    #[must_use]
    pub fn boot(&self) -> BootId {
        self.desk.boot()
    }

    /// What it knows.
    #[must_use]
    pub fn view(&self) -> &CellView {
        &self.view
    }

    /// Whether a job waits for what comes of this order.
    #[must_use]
    pub fn awaits(&self, id: OrderId) -> bool {
        self.jobs.values().any(|job| job.awaits(id))
    }

    /// Whether this order is repeated until it is received.
    #[must_use]
    pub fn repeats(&self, id: OrderId) -> bool {
        self.orders.is_out(id)
    }

    /// A message. `false`: it contradicts itself or is not for the manager, and was counted and dropped.
    pub fn message(&mut self, envelope: Envelope, in_progress: Option<String>, now: Now) -> bool {
        let good = match &envelope.body {
            Message::Register(registration) => self.register(&envelope, registration, now),
            Message::Leaving => self.leaving(&envelope, now),
            Message::Report(report) => self.report(&envelope, report, now),
            Message::OrderReceived(id) => {
                self.orders.received(*id, &envelope.from);
                true
            }
            Message::McReport(report) => self.mc_report(&envelope, report, now),
            Message::Event(event) => {
                let good = !matches!(envelope.from, AgentId::Client(_))
                    && self
                        .tellers
                        .admit(&envelope.from, event.mc.as_ref(), &self.view, now);
                if good {
                    self.foreign_event(event.clone(), now);
                }
                good
            }
            Message::BadMessages(count) => match &envelope.from {
                AgentId::Gateway(name) => match self.view.gateways.get_mut(name) {
                    Some(gateway) => {
                        gateway.bad_messages = *count;
                        true
                    }
                    None => false,
                },
                _ => false,
            },
            Message::Staged(staged) => self.take_staged(&envelope, staged),
            Message::Command(command) => self.command(&envelope, command, now),
            Message::Query(query) => self.query(&envelope, query, in_progress, now),
            Message::Registered(_)
            | Message::RegistrationRefused(_)
            | Message::MayLeave { .. }
            | Message::Stage(_)
            | Message::Qos(_)
            | Message::CallForProposals(_)
            | Message::Bid(_)
            | Message::Holding(_)
            | Message::Award(_)
            | Message::Order(_)
            | Message::Open(_)
            | Message::Opened(_)
            | Message::OpenRefused(_)
            | Message::Close(_)
            | Message::CommandReply(_)
            | Message::QueryReply(_) => false,
        };
        if !good {
            self.bad_messages += 1;
        }
        good
    }

    /// A message of another agent of this process was bad.
    pub fn count_bad(&mut self) {
        self.bad_messages += 1;
    }

    /// A gateway's image.
    pub fn image(&mut self, image: &InputImage, now: Now) {
        self.take_image(image, now);
    }

    /// A liveliness token appeared or is gone.
    pub fn peer(&mut self, process: &ProcessId, boot: BootId, alive: bool, now: Now) {
        self.token(process, boot, alive, now);
    }

    /// From the process itself.
    pub fn local(&mut self, local: &ManagerLocal, now: Now) {
        match local {
            ManagerLocal::Wall { unix_us } => self.desk.wall_is(now, *unix_us),
            ManagerLocal::BadMessages(count) => {
                if *count > self.bad_messages_link {
                    let more = count - self.bad_messages_link;
                    self.bad_messages_link = *count;
                    let text = format!("{more} messages to the manager did not read");
                    self.event(
                        Event::new(Severity::Warning, EventKind::BadMessages, text),
                        now,
                    );
                }
            }
        }
    }

    /// The repository has answered. `true` if something may have waited for that.
    pub fn persisted(&mut self, ticket: u64, result: &Result<(), String>, now: Now) -> bool {
        let Some(ticket) = self.desk.answered(ticket) else {
            return false;
        };
        let awaited = matches!(ticket, Ticket::Epochs(_) | Ticket::Command(..));
        if result.is_err() || ticket != Ticket::Event {
            self.desk.repository(result, now);
        }
        match ticket {
            Ticket::Epochs(block) => {
                self.epochs.answered(&block, result.is_ok());
                if result.is_err() {
                    self.epochs_again = Some(now.plus_us(REPOSITORY_RETRY_US));
                }
            }
            Ticket::Command(client, id) => self.command_written(client, id, result),
            Ticket::Kept | Ticket::Event => {}
        }
        awaited
    }

    /// Brings everything in line with what is known now. To be called after each input and at each deadline.
    pub fn review(&mut self, now: Now) {
        self.settle(now);
        self.miss_reports(now);
        self.miss_images(now);
        if self.epochs_again.is_none_or(|at| at <= now) {
            self.epochs_again = None;
            self.reserve_epochs();
        }
        self.review_jobs(now);
        self.adopt(now);
        self.tell_unseen_activations(now);
        self.send_orders(now);
        self.review_emptying(now);
        self.review_reload(now);
        self.review_commands(now);
        let view = &self.view;
        self.unplaced
            .retain(|mc, _| view.mcs[mc].under_way.is_none() && view.need(mc).is_some());
    }

    /// The next deadline, and why.
    #[must_use]
    pub fn deadline(&self) -> Option<(Now, &'static str)> {
        let settings = &self.view.model.settings;
        let settle = (!self.view.settled).then(|| {
            let min = self.started.plus_us(SETTLE_MIN_US);
            let max = self.started.plus_us(SETTLE_US);
            if self.all_registered() {
                (min, "all that are seen have registered")
            } else {
                (max, "nodes may still register")
            }
        });
        let reports = self
            .view
            .controllers
            .values()
            .filter(|c| c.is_up())
            .map(|c| (c.heard.plus_us(settings.report_lost_us), "a report is due"));
        let images = self
            .view
            .gateways
            .values()
            .filter(|g| g.is_up())
            .map(|g| (g.heard.plus_us(GATEWAY_LOST_US), "an image is due"));
        let epochs = self
            .epochs_again
            .map(|at| (at, "the repository is asked again"));
        let emptying = self
            .emptying
            .values()
            .map(|(_, _, at)| (*at, "a controller is to be emptied"));
        settle
            .into_iter()
            .chain(reports)
            .chain(images)
            .chain(epochs)
            .chain(emptying)
            .chain(self.orders.deadline())
            .chain(self.jobs_deadline())
            .chain(self.commands.deadline())
            .chain(self.reload.iter().filter_map(reload::Reload::deadline))
            .min()
    }

    /// The next output.
    pub fn poll_output(&mut self) -> Option<ManagerOutput> {
        self.desk.poll()
    }

    /// What the other agents of this process have not heard yet.
    pub fn take_news(&mut self) -> Vec<News> {
        std::mem::take(&mut self.news)
    }

    /// What Diagnosis & Decision is asked for.
    pub fn take_wishes(&mut self) -> Vec<(Wish, String)> {
        std::mem::take(&mut self.wishes)
    }

    /// Sends what another agent of this process has signed.
    pub fn pass_on(&mut self, envelope: Envelope) {
        self.desk.pass_on(envelope);
    }

    fn event(&mut self, event: Event, now: Now) {
        note_activation(&mut self.activated, &event);
        self.desk.event(event, now);
    }

    fn send_orders(&mut self, now: Now) {
        for (to, order) in self.orders.due(now) {
            self.desk.send(to, order);
        }
    }

    fn reserve_epochs(&mut self) {
        if self.epochs_again.is_some() {
            return;
        }
        for block in self.epochs.wanted() {
            let write = RepoWrite::EpochBlock {
                mc: block.mc.clone(),
                upto: block.upto,
            };
            self.desk.persist(write, Ticket::Epochs(block));
        }
    }

    fn settle(&mut self, now: Now) {
        let all = now >= self.started.plus_us(SETTLE_MIN_US) && self.all_registered();
        if !self.view.settled && (all || now >= self.started.plus_us(SETTLE_US)) {
            self.view.settled = true;
            self.view.version += 1;
            self.stop_again(now);
        }
    }

    /// Every node whose token is seen has registered, at least one, and every gateway has sent an image.
    fn all_registered(&self) -> bool {
        let mut seen = false;
        for controller in self.view.controllers.values() {
            for boot in &controller.tokens {
                seen = true;
                if controller.owner().map(|o| o.boot) != Some(*boot) {
                    return false;
                }
            }
        }
        seen && self.view.gateways.values().all(|g| g.boot.is_some())
    }

    /// The assignment has changed: a new generation, kept in the repository.
    fn new_generation(&mut self, generation: PlanId) {
        self.view.generation = generation;
        let assignment = self
            .view
            .mcs
            .iter()
            .filter_map(|(mc, m)| Some((mc.clone(), m.assigned.clone()?)))
            .collect();
        let write = RepoWrite::Assignment {
            generation,
            assignment,
        };
        self.desk.persist(write, Ticket::Kept);
    }

    /// Whether an event of this kind is news for this MC: two sides may tell the same.
    fn is_news(&mut self, kind: EventKind, mc: &McId, epoch: Epoch, scan: u64) -> bool {
        let mark = (epoch, scan);
        let known = self.marks.insert((kind, mc.clone()), mark);
        known != Some(mark)
    }
}

fn note_activation(activated: &mut BTreeMap<McId, Epoch>, event: &Event) {
    if event.kind == EventKind::McActivated
        && let (Some(mc), Some(epoch)) = (&event.mc, event.epoch)
    {
        let newest = activated.entry(mc.clone()).or_default();
        *newest = epoch.max(*newest);
    }
}
