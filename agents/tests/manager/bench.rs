//! A bench for the manager's agents: scripts of (time, input, expected outputs) in words.
//!
//! Controllers that have registered report every 100 ms and the gateway sends an image as often, unless the script silences them.
//! Orders are received at once unless the script says `mute`. The repository answers at once.

pub use crate::cell::{c, gw, m, model, owner, record, split};
use fam_agents::manager::{ManagerAct, ManagerAgents, ManagerLocal};
use fam_agents::monitor::Qualities;
use fam_proto::agent::{Input, Output};
use fam_proto::model::CellModel;
use fam_proto::*;
use std::collections::BTreeMap;
use std::sync::Arc;

pub const AUTO_US: u64 = 100_000;

pub struct Bench {
    pub agents: ManagerAgents,
    pub model: Arc<CellModel>,
    pub now: Now,
    pub disk: RepoState,
    pub disk_full: bool,
    pub events: Vec<Event>,
    pub plans: Vec<Plan>,
    pub replies: Vec<CommandReply>,
    /// Number of the newest request to make a new version ready.
    pub stage: u64,
    pub last_status: Option<CellStatus>,
    pub last_page: (Vec<Event>, bool),
    /// A controller whose MCAs hold nothing.
    pub blank: Option<ControllerId>,
    pub records: BTreeMap<McId, RecordSummary>,
    gateway_boot: u64,
    image: u64,
    pub gateway_up: bool,
    /// Controllers that report, with boot and workload.
    pub alive: BTreeMap<ControllerId, (u64, u32)>,
    memory_kb: u64,
    image_age_us: u64,
    muted: bool,
    pub call: Option<CallForProposals>,
    pub orders: BTreeMap<(ControllerId, McId), Vec<Order>>,
    /// Who was ordered to open which epoch: once given, never again to another.
    epochs: BTreeMap<(McId, Epoch), (Owner, OrderId)>,
    /// Life of each controller that was registered last.
    boots: BTreeMap<ControllerId, u64>,
    command: u64,
    next_auto: Now,
    /// What the manager's outputs were, in words, since the last row.
    said: Vec<String>,
}

impl Bench {
    pub fn new(model: CellModel) -> Bench {
        Bench::restored(model, RepoState::default(), Qualities::standard(), 1)
    }

    pub fn restored(model: CellModel, disk: RepoState, qualities: Qualities, boot: u64) -> Bench {
        let model = Arc::new(model);
        let agents = ManagerAgents::with_qualities(
            model.clone(),
            disk.clone(),
            BootId(boot),
            Now(0),
            qualities,
        );
        let records = model
            .mcs
            .iter()
            .map(|mc| (mc.mc.clone(), record(&mc.mc, "never")))
            .collect();
        let mut bench = Bench {
            agents,
            model,
            now: Now(0),
            disk,
            disk_full: false,
            events: Vec::new(),
            plans: Vec::new(),
            replies: Vec::new(),
            stage: 0,
            last_status: None,
            last_page: (Vec::new(), false),
            blank: None,
            records,
            gateway_boot: 1,
            image: 0,
            gateway_up: true,
            alive: BTreeMap::new(),
            memory_kb: 1_000,
            image_age_us: 5_000,
            muted: false,
            call: None,
            orders: BTreeMap::new(),
            epochs: BTreeMap::new(),
            boots: BTreeMap::new(),
            command: 0,
            next_auto: Now(AUTO_US),
            said: Vec::new(),
        };
        bench.drain();
        bench
    }

    /// The manager dies and comes back with what is on the disk.
    pub fn restart(&mut self) {
        let boot = self.agents.manager().boot().0 + 1_000_000;
        self.agents = ManagerAgents::new(
            self.model.clone(),
            self.disk.clone(),
            BootId(boot),
            self.now,
        );
        self.call = None;
        self.drain();
    }

    /// Runs a script: at so many milliseconds this input has to lead to these outputs (separated by `; `).
    /// Outputs of deadlines that came since the row before belong to the row.
    #[track_caller]
    pub fn script(&mut self, rows: &[(u64, &str, &str)]) {
        for (at, input, expected) in rows {
            let said = self.step(*at, input);
            assert_eq!(said, *expected, "at {at} ms after: {input}");
        }
    }

    /// One row; what the outputs were.
    pub fn step(&mut self, at_ms: u64, input: &str) -> String {
        self.advance(Now(at_ms * 1_000));
        for part in input.split("; ") {
            self.input(part);
        }
        let said = std::mem::take(&mut self.said);
        said.join("; ")
    }

    /// Lets time pass.
    pub fn advance(&mut self, to: Now) {
        assert!(to >= self.now, "time goes forward");
        loop {
            let due = self.agents.poll_timeout().map_or(to, |(at, _)| at);
            let next = due.min(self.next_auto);
            if next > to || (next == to && due > to && self.next_auto > to) {
                break;
            }
            self.now = self.now.max(next);
            if self.next_auto <= self.now {
                self.next_auto = self.next_auto.plus_us(AUTO_US);
                self.auto();
            } else {
                let before = self.agents.poll_timeout();
                self.agents.handle_timeout(self.now);
                self.drain();
                let after = self.agents.poll_timeout();
                assert!(
                    after.is_none_or(|(at, _)| at > self.now),
                    "a deadline stands still: {before:?} then {after:?} at {}",
                    self.now
                );
            }
            if next == to {
                break;
            }
        }
        self.now = to;
    }

    fn auto(&mut self) {
        if self.gateway_up {
            self.send_image();
        }
        for (controller, (boot, workload)) in self.alive.clone() {
            self.report(&controller, boot, workload);
        }
    }

    pub fn handle(&mut self, input: Input<ManagerLocal>) {
        self.agents.handle(input, self.now);
        self.drain();
    }

    fn message(&mut self, from: AgentId, boot: u64, to: AgentId, body: Message) {
        self.handle(Input::Message(Envelope {
            from,
            boot: BootId(boot),
            to,
            body,
        }));
    }

    fn drain(&mut self) {
        while let Some(output) = self.agents.poll_output() {
            match output {
                Output::Persist { ticket, write } => {
                    let result = if self.disk_full {
                        Err("no space left on device".to_owned())
                    } else {
                        self.disk.apply(&write);
                        Ok(())
                    };
                    self.agents
                        .handle(Input::Persisted { ticket, result }, self.now);
                }
                Output::Send(envelope) => self.sent(envelope),
                Output::Act(ManagerAct::PlanBegan(plan)) => self.plans.push(*plan),
                Output::Act(ManagerAct::PlanEnded { .. }) => {}
                Output::Event(event) => self.events.push(event),
            }
        }
    }

    fn sent(&mut self, envelope: Envelope) {
        let list = |mcs: &[McId]| mcs.iter().map(|m| format!(" {m}")).collect::<String>();
        let words = match &envelope.body {
            Message::Registered(r) => {
                let mut words = format!("registered{}", list(&r.assigned));
                for (mc, _) in &r.ineligible {
                    words.push_str(&format!(" not:{mc}"));
                }
                words
            }
            Message::RegistrationRefused(why) => {
                self.replies.push(CommandReply {
                    id: 0,
                    result: Err(why.clone()),
                    done: true,
                });
                "refused".to_owned()
            }
            Message::MayLeave { behind } if behind.is_empty() => "may leave".to_owned(),
            Message::MayLeave { behind } => format!(
                "may leave {} behind",
                behind
                    .iter()
                    .map(McId::as_str)
                    .collect::<Vec<_>>()
                    .join(",")
            ),
            Message::CallForProposals(call) => {
                self.call = Some(call.clone());
                format!("call{}", list(&call.mcs))
            }
            Message::Award(award) => format!("award{}", list(&award.mcs)),
            Message::Order(order) => {
                let AgentId::Component(controller, mc) = &envelope.to else {
                    panic!("an order to {}", envelope.to)
                };
                if let OrderKind::Activate { epoch, .. } = &order.kind {
                    self.check_epoch(controller, mc, *epoch, order.id);
                }
                let key = (controller.clone(), mc.clone());
                let known = self.orders.entry(key).or_default();
                let repeated = known.iter().any(|o| o.id == order.id);
                known.push(order.clone());
                if !self.muted {
                    self.agents.handle(
                        Input::Message(Envelope {
                            from: envelope.to.clone(),
                            boot: BootId(1),
                            to: AgentId::Manager,
                            body: Message::OrderReceived(order.id),
                        }),
                        self.now,
                    );
                }
                let again = if repeated { " again" } else { "" };
                match &order.kind {
                    OrderKind::Activate {
                        epoch,
                        after,
                        force,
                        reset,
                        ..
                    } => {
                        let mut words = format!("activate e{epoch}");
                        if let Some(after) = after {
                            words.push_str(&format!(" after {}", after.controller));
                        }
                        if *force {
                            words.push_str(" force");
                        }
                        if let Some(reset) = reset {
                            words.push_str(&format!(" {reset:?}"));
                        }
                        words + again
                    }
                    OrderKind::Release {
                        epoch, successor, ..
                    } => format!(
                        "release e{epoch} to {} e{}{again}",
                        successor.owner.controller, successor.epoch
                    ),
                    OrderKind::CancelRelease { epoch } => format!("cancel e{epoch}{again}"),
                    OrderKind::Stop { epoch } => format!("stop e{epoch}{again}"),
                    OrderKind::Renew { epoch, version, .. } => {
                        format!("renew e{epoch} v{version}{again}")
                    }
                    OrderKind::Adopt { version } => format!("adopt v{version}{again}"),
                }
            }
            Message::Stage(id) => {
                self.stage = *id;
                "stage".to_owned()
            }
            Message::CommandReply(reply) => {
                self.replies.push(reply.clone());
                match (&reply.result, reply.done) {
                    (Ok(_), false) => "begun".to_owned(),
                    (Ok(_), true) => "done".to_owned(),
                    (Err(_), _) => "failed".to_owned(),
                }
            }
            Message::QueryReply(reply) => {
                match &**reply {
                    QueryReply::Status(status) => self.last_status = Some(status.clone()),
                    QueryReply::Events { events, more } => {
                        self.last_page = (events.clone(), *more);
                    }
                }
                "reply".to_owned()
            }
            other => panic!("the manager sends {other:?}"),
        };
        let to = match &envelope.to {
            AgentId::Controller(c) => c.to_string(),
            AgentId::Component(c, m) => format!("{c}/{m}"),
            AgentId::Client(n) => format!("client{n}"),
            other => panic!("the manager sends to {other}"),
        };
        self.said.push(format!("{to} {words}"));
    }

    /// An epoch that leaves is durable, new, and given to one owner only.
    fn check_epoch(&mut self, controller: &ControllerId, mc: &McId, epoch: Epoch, id: OrderId) {
        let durable = self.disk.epochs.get(mc).copied().unwrap_or_default();
        assert!(
            epoch <= durable,
            "{mc}: epoch {epoch} leaves, {durable} is durable"
        );
        let boot = self.boots.get(controller).copied().unwrap_or_default();
        let given = (owner(controller.as_str(), boot), id);
        let key = (mc.clone(), epoch);
        if let Some(before) = self.epochs.get(&key) {
            assert_eq!(before, &given, "{mc}: epoch {epoch} is given twice");
            return;
        }
        let newest = self
            .epochs
            .range((mc.clone(), Epoch(0))..)
            .rfind(|((m, _), _)| m == mc);
        if let Some(((_, newest), _)) = newest {
            assert!(epoch > *newest, "{mc}: epoch {epoch} after {newest}");
        }
        self.epochs.insert(key, given);
    }

    fn report(&mut self, controller: &ControllerId, boot: u64, workload: u32) {
        let report = ResourceReport {
            owner: owner(controller.as_str(), boot),
            workload_permille: workload,
            mcs: Vec::new(),
            host_cpu_permille: 0,
            process_cpu_permille: 0,
            process_memory_kb: 0,
            late_ticks: 0,
            overruns: 0,
            image_age_us: self.image_age_us,
            bad_messages: 0,
        };
        let from = AgentId::Controller(controller.clone());
        self.message(from, boot, AgentId::Manager, Message::Report(report));
    }

    pub fn send_image(&mut self) {
        self.image += 1;
        let image = InputImage {
            gateway: gw(),
            boot: BootId(self.gateway_boot),
            number: ImageNumber((self.gateway_boot << 32) + self.image),
            sent_at_us: 0,
            inputs: Vec::new(),
            records: self.records.values().cloned().collect(),
            exports: Vec::new(),
        };
        self.handle(Input::Image(Arc::new(image)));
    }

    pub fn registration(&self, who: &str) -> Registration {
        let (name, boot) = split(who);
        let known = self.model.controller(&c(name));
        Registration {
            owner: owner(name, boot),
            description: String::new(),
            cpu_factor_permille: known.map_or(1_000, |k| k.cpu_factor_permille),
            memory_kb: self.memory_kb,
            limit_permille: known.map_or(500, |k| k.limit_permille),
            tick_us: 5_000,
            mcs: self
                .model
                .mcs
                .iter()
                .filter(|mc| known.is_some_and(|k| mc.hosts.contains(&k.controller)))
                .map(|mc| Hosted {
                    mc: mc.mc.clone(),
                    hash: mc.hash,
                    layout: mc.layout,
                    memory_kb: mc.memory_kb,
                    worst_case_us: mc.worst_case_us,
                })
                .collect(),
            active: Vec::new(),
            real_time: Vec::new(),
        }
    }

    pub fn register(&mut self, registration: Registration) {
        let owner = registration.owner.clone();
        let from = AgentId::Controller(owner.controller.clone());
        let body = Message::Register(registration);
        self.message(from, owner.boot.0, AgentId::Manager, body);
        let taken = self.agents.view().controllers.get(&owner.controller);
        if taken.is_some_and(|t| t.owner() == Some(&owner)) {
            self.boots.insert(owner.controller.clone(), owner.boot.0);
            self.alive
                .entry(owner.controller)
                .or_insert((owner.boot.0, 0))
                .0 = owner.boot.0;
        }
    }

    /// A bid for all that was called for, after what the MCAs hold.
    pub fn bid(&mut self, who: &str, workload: u32, change: impl Fn(&mut Bid)) {
        let (name, boot) = split(who);
        let Some(call) = self.call.clone() else {
            panic!("nothing was called for")
        };
        for mc in &call.mcs {
            let holding = Holding {
                negotiation: call.negotiation,
                mc: mc.clone(),
                owner: owner(name, boot),
                held: self.records[mc]
                    .head
                    .filter(|_| self.blank != Some(c(name))),
            };
            let from = AgentId::Component(c(name), mc.clone());
            self.message(from, boot, AgentId::Decision, Message::Holding(holding));
        }
        let model = self.model.clone();
        let mut bid = Bid {
            negotiation: call.negotiation,
            owner: owner(name, boot),
            offers: call
                .mcs
                .iter()
                .map(|mc| McOffer {
                    mc: mc.clone(),
                    unable: None,
                    worst_case_us: model.mc(mc).unwrap().worst_case_us * 1_000
                        / model.controller(&c(name)).unwrap().cpu_factor_permille,
                })
                .collect(),
            workload_permille: workload,
            memory_free_kb: 10_000,
            image_age_us: 1_000,
            criteria: Vec::new(),
        };
        change(&mut bid);
        let from = AgentId::Controller(c(name));
        self.message(from, boot, AgentId::Decision, Message::Bid(bid));
    }

    /// The last order that an MCA got, chosen by its kind.
    pub fn order_of(&self, controller: &str, mc: &str, which: fn(&OrderKind) -> bool) -> Order {
        self.orders[&(c(controller), m(mc))]
            .iter()
            .rev()
            .find(|o| which(&o.kind))
            .cloned()
            .unwrap()
    }

    fn mc_report(&mut self, who: &str, mc: &str, order: Option<OrderId>, outcome: McOutcome) {
        let (name, boot) = split(who);
        let report = McReport {
            mc: m(mc),
            owner: owner(name, boot),
            state: McaState::Passive,
            epoch: None,
            order,
            outcome,
        };
        let from = AgentId::Component(c(name), m(mc));
        self.message(from, boot, AgentId::Manager, Message::McReport(report));
    }

    pub fn operator(&mut self, what: CommandKind) {
        self.command += 1;
        let id = self.command;
        self.operator_again(id, what);
    }

    pub fn operator_again(&mut self, id: u64, what: CommandKind) {
        let body = Message::Command(Command { id, what });
        self.message(AgentId::Client(1), 1, AgentId::Manager, body);
    }

    /// One input in words.
    pub fn input(&mut self, text: &str) {
        let words: Vec<&str> = text.split(' ').collect();
        match words.as_slice() {
            ["tick"] => {
                self.agents.handle_timeout(self.now);
                self.drain();
            }
            ["token", who] => self.peer(who, true),
            ["gone", who] => self.peer(who, false),
            // Killed: token and reports at once.
            ["killed", who] => {
                self.alive.remove(&c(split(who).0));
                self.peer(who, false);
            }
            // Stopped by a signal: silent, its token stands.
            ["frozen", who] => {
                self.alive.remove(&c(split(who).0));
            }
            ["resumed", who] => {
                let (name, boot) = split(who);
                self.alive.insert(c(name), (boot, 0));
                self.report(&c(name), boot, 0);
            }
            ["register", who] => self.register(self.registration(who)),
            ["up", who] => {
                self.peer(who, true);
                self.register(self.registration(who));
            }
            ["works", who, workload] => {
                let (name, boot) = split(who);
                let workload = workload.parse().unwrap();
                self.alive.insert(c(name), (boot, workload));
                self.report(&c(name), boot, workload);
            }
            ["stale", who, age_us] => {
                let (name, boot) = split(who);
                let fresh = std::mem::replace(&mut self.image_age_us, age_us.parse().unwrap());
                self.report(&c(name), boot, 0);
                self.image_age_us = fresh;
            }
            ["leaving", who] => {
                let (name, boot) = split(who);
                let from = AgentId::Controller(c(name));
                self.message(from, boot, AgentId::Manager, Message::Leaving);
            }
            ["bid", who, workload] => self.bid(who, workload.parse().unwrap(), |_| {}),
            ["image"] => self.send_image(),
            ["image", records @ ..] => {
                for record_text in records {
                    let (mc, state) = record_text.split_once('=').unwrap();
                    self.records.insert(m(mc), record(&m(mc), state));
                }
                self.send_image();
            }
            ["gateway", "restarts"] => {
                self.gateway_boot += 1;
                for record in self.records.values_mut() {
                    if record.state == RecordState::Open {
                        record.state = RecordState::Closed;
                    }
                }
                self.send_image();
            }
            ["gateway", "lost"] => {
                self.gateway_up = false;
                self.handle(Input::Peer {
                    process: ProcessId::Gateway(gw()),
                    boot: BootId(self.gateway_boot),
                    alive: false,
                });
            }
            ["gateway", "back"] => {
                self.gateway_up = true;
                self.input("gateway restarts");
            }
            ["notopened", who, mc] => {
                let order = self.order_of(split(who).0, mc, |k| {
                    matches!(k, OrderKind::Activate { .. })
                });
                let why = McOutcome::NotOpened("refused by the gateway".to_owned());
                self.mc_report(who, mc, Some(order.id), why);
            }
            ["notreleased", who, mc] => {
                let order =
                    self.order_of(split(who).0, mc, |k| matches!(k, OrderKind::Release { .. }));
                let why = McOutcome::ReleaseCancelled("critical all the time".to_owned());
                self.mc_report(who, mc, Some(order.id), why);
            }
            ["mute"] => self.muted = true,
            ["unmute"] => self.muted = false,
            ["disk", "full"] => self.disk_full = true,
            ["disk", "ok"] => self.disk_full = false,
            ["move", mc, to] => self.operator(CommandKind::Move {
                mc: m(mc),
                to: c(to),
                force: false,
            }),
            ["force", mc, to] => self.operator(CommandKind::Move {
                mc: m(mc),
                to: c(to),
                force: true,
            }),
            ["drain", who] => self.operator(CommandKind::Drain(c(who))),
            ["undrain", who] => self.operator(CommandKind::Undrain(c(who))),
            ["pin", mc] => self.operator(CommandKind::Pin {
                mc: m(mc),
                to: None,
            }),
            ["pin", mc, to] => self.operator(CommandKind::Pin {
                mc: m(mc),
                to: Some(c(to)),
            }),
            ["unpin", mc] => self.operator(CommandKind::Unpin(m(mc))),
            ["stop", mc] => self.operator(CommandKind::Stop(m(mc))),
            ["reset", mc] => self.operator(CommandKind::Reset {
                mc: m(mc),
                how: Reset::Cold,
            }),
            ["reload"] => self.operator(CommandKind::Reload(None)),
            ["reload", look] => self.operator(CommandKind::Reload(Some(look.parse().unwrap()))),
            ["staged", who, mc, version] => {
                let (name, boot) = split(who);
                let staged = Staged {
                    id: self.stage,
                    mcs: vec![StagedMc {
                        mc: m(mc),
                        version: version.parse().unwrap(),
                        layout: LayoutHash(77),
                    }],
                    changes: format!("{mc}: changed"),
                    refused: None,
                };
                let from = AgentId::Controller(c(name));
                self.message(
                    from,
                    boot,
                    AgentId::Manager,
                    Message::Staged(Box::new(staged)),
                );
            }
            ["ack"] => self.operator(CommandKind::Acknowledge(None)),
            ["events", after, limit] => {
                let body = Message::Query(Query::Events {
                    after: after.parse().unwrap(),
                    limit: limit.parse().unwrap(),
                });
                self.message(AgentId::Client(1), 1, AgentId::Manager, body);
            }
            ["status"] => {
                let body = Message::Query(Query::Status);
                self.message(AgentId::Client(1), 1, AgentId::Manager, body);
            }
            other => panic!("unknown input {other:?}"),
        }
    }

    fn peer(&mut self, who: &str, alive: bool) {
        let (name, boot) = split(who);
        self.handle(Input::Peer {
            process: ProcessId::Node(c(name)),
            boot: BootId(boot),
            alive,
        });
    }

    /// Kinds of the events since the start or the last call, without the manager's own start.
    pub fn kinds(&mut self) -> Vec<EventKind> {
        std::mem::take(&mut self.events)
            .iter()
            .map(|e| e.kind)
            .collect()
    }

    /// Texts of the events of a kind.
    pub fn texts(&self, kind: EventKind) -> Vec<&str> {
        self.events
            .iter()
            .filter(|e| e.kind == kind)
            .map(|e| e.text.as_str())
            .collect()
    }

    /// The text of the last command's answer.
    pub fn answer(&self) -> &str {
        match &self.replies.last().unwrap().result {
            Ok(text) | Err(text) => text,
        }
    }
}
