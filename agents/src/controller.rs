//! The Controller Agent (CA): registers its controller, reports its workload, bids in negotiations, raises events of
//! its own (as in the work-balance case study), and hands over before it leaves.
//!
//! It registers again whenever a manager with another boot id speaks or appears; reports flow while it is registered.

use crate::node::{NodeAct, NodeConfig, NodeOutput, NodeSample};
use fam_proto::model::McModel;
use fam_proto::{
    AgentId, Award, Bid, BootId, CallForProposals, Cause, ControllerId, Envelope, Epoch, Event,
    EventKind, GatewayId, Hosted, InputImage, LayoutHash, McId, McLoad, McOffer, Message, Now,
    QosEvent, Registration, ResourceReport, Severity, Staged,
};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// How often a registration is repeated until it is answered, in microseconds.
pub const REGISTER_REPEAT_US: u64 = 100_000;
/// How often it is repeated after a refusal, in microseconds.
pub const REFUSED_REPEAT_US: u64 = 1_000_000;
/// How often a leave is repeated, in microseconds.
pub const LEAVING_REPEAT_US: u64 = 100_000;
/// How long a leaving controller waits until its MCs are handed over, in microseconds.
pub const LEAVING_WAIT_US: u64 = 6_000_000;
/// How long a leaving controller without active MCs waits for the manager's word, in microseconds.
pub const LEAVING_IDLE_US: u64 = 1_000_000;
/// An MC can only be taken if its gateway's newest image is at most this many ticks old.
pub const IMAGE_TICKS_MAX: u64 = 20;
/// Reports above the limit, one after the other, until the overload is told.
pub const OVERLOAD_REPORTS: u32 = 3;
/// Fewer scans than this in an interval make no mean of their own.
const SCANS_MIN: u64 = 4;
/// The newest interval counts for a quarter of the mean: a stall of the machine in one tenth of a second is no workload, what lasts
/// shows within half a second.
const SMOOTHING: u64 = 4;

/// How long after an MC ran here the worst case seen counts more than the declared one, in microseconds. Slow scans must not keep
/// the MC away for good.
pub const MEASURED_KEPT_US: u64 = 3_000_000;

const FULL_PERMILLE: u32 = 1_000;
const OVERLOAD_ENDS_PERMILLE: u32 = 950;

/// Managers' lives that are kept in mind as gone.
const GONE_MAX: usize = 16;

/// What the CA knows of a manager.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Manager {
    /// The life whose words count: the newest one that lives, as far as is known.
    boot: Option<BootId>,
    /// It has taken our registration.
    registered: bool,
    /// It has refused, with these words.
    refused: Option<String>,
}

/// Counts of an MC at the last report, and the smoothed mean that came of them.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
struct Interval {
    scans: u64,
    cpu_ns: u64,
    mean_ns: u64,
}

/// A leave under way.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Leaving {
    again: Now,
    idle_until: Now,
    until: Now,
    done: bool,
}

/// The Controller Agent.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ControllerAgent {
    config: Arc<NodeConfig>,
    manager: Manager,
    /// Managers' lives whose liveliness tokens are seen.
    seen: BTreeSet<BootId>,
    /// Managers' lives whose liveliness tokens are gone. Boot ids come from wall clocks, which may be set back, and a second manager
    /// may have come and gone: so the highest one is not always the one that lives.
    gone: BTreeSet<BootId>,
    register_at: Now,
    report_at: Option<Now>,
    leaving: Option<Leaving>,
    /// The event of a new controller below its limit has been raised.
    joined: bool,
    overloads: u32,
    /// When each gateway's newest image came.
    images: BTreeMap<GatewayId, Now>,
    sample: NodeSample,
    intervals: BTreeMap<McId, Interval>,
    /// Worst case seen here, in microseconds, and when the MC ran here last.
    measured_us: BTreeMap<McId, (u32, Now)>,
    /// MCs that run here, with their epochs.
    active: Vec<(McId, Epoch)>,
    /// Whether an MC is being opened here.
    opening: bool,
    won: Option<Award>,
    /// Version and layout of each MC that runs here, or would.
    versions: BTreeMap<McId, (u64, LayoutHash)>,
    out: VecDeque<NodeOutput>,
}

impl ControllerAgent {
    /// A CA that registers at once.
    #[must_use]
    pub fn new(config: Arc<NodeConfig>, now: Now) -> ControllerAgent {
        let versions = config.mcs.iter();
        ControllerAgent {
            versions: versions
                .map(|m| (m.mc.clone(), (m.hash, m.layout)))
                .collect(),
            config,
            manager: Manager::default(),
            seen: BTreeSet::new(),
            gone: BTreeSet::new(),
            register_at: now,
            report_at: None,
            leaving: None,
            joined: false,
            overloads: 0,
            images: BTreeMap::new(),
            sample: NodeSample::default(),
            intervals: BTreeMap::new(),
            measured_us: BTreeMap::new(),
            active: Vec::new(),
            opening: false,
            won: None,
            out: VecDeque::new(),
        }
    }

    /// Whether a manager has taken the registration.
    #[must_use]
    pub fn is_registered(&self) -> bool {
        self.manager.registered
    }

    /// Why the manager refuses the registration, if it does.
    #[must_use]
    pub fn refusal(&self) -> Option<&str> {
        self.manager.refused.as_deref()
    }

    /// What was won in the last negotiation.
    #[must_use]
    pub fn won(&self) -> Option<&Award> {
        self.won.as_ref()
    }

    /// An MC runs here in this version, or would: if that is new, the controller registers again.
    pub(crate) fn renewed(
        &mut self,
        mc: &McId,
        version: u64,
        layout: LayoutHash,
        now: Now,
    ) -> bool {
        let is_known = self.versions.get(mc) == Some(&(version, layout));
        if !is_known {
            self.versions.insert(mc.clone(), (version, layout));
            self.manager.registered = false;
            self.register(now);
        }
        !is_known
    }

    /// A new version of the cell is ready here, or cannot be.
    pub(crate) fn send_staged(&mut self, staged: Staged) {
        self.send(AgentId::Manager, Message::Staged(Box::new(staged)));
    }

    /// What runs here now; told by the composite before anything else of a step.
    pub(crate) fn facts(&mut self, active: Vec<(McId, Epoch)>, opening: bool) {
        self.active = active;
        self.opening = opening;
    }

    /// Whether the words of this life of a manager count no more: another one does.
    #[must_use]
    pub fn is_over(&self, manager: BootId) -> bool {
        self.manager
            .boot
            .is_some_and(|known| manager != known && !self.follows(manager, known))
    }

    /// Whether a life of the manager takes the place of the one that is known: it is newer, or that one is gone; and itself is
    /// not. A token is more than a word: whose token is seen gives way to no word alone, for one damaged boot id could
    /// otherwise make the node deaf to every manager to come.
    fn follows(&self, boot: BootId, known: BootId) -> bool {
        let (seen, known_seen) = (self.seen.contains(&boot), self.seen.contains(&known));
        let newer = boot > known && (seen || !known_seen);
        !self.gone.contains(&boot) && (newer || (seen && !known_seen) || self.gone.contains(&known))
    }

    /// A manager's liveliness token has appeared or gone.
    pub fn manager_token(&mut self, boot: BootId, alive: bool, now: Now) {
        if alive {
            self.gone.remove(&boot);
            if self.seen.len() == GONE_MAX {
                self.seen.pop_first();
            }
            self.seen.insert(boot);
            self.manager_speaks(boot, now);
            return;
        }
        self.seen.remove(&boot);
        if self.gone.len() == GONE_MAX {
            self.gone.pop_first();
        }
        self.gone.insert(boot);
        if self.manager.boot == Some(boot) {
            self.manager.registered = false;
            self.register_at = now.plus_us(REGISTER_REPEAT_US);
        }
    }

    /// A life of the manager is there.
    pub fn manager_speaks(&mut self, boot: BootId, now: Now) {
        let new = match self.manager.boot {
            None => !self.gone.contains(&boot),
            Some(known) => boot != known && self.follows(boot, known),
        };
        if new {
            self.manager = Manager {
                boot: Some(boot),
                ..Manager::default()
            };
            self.register(now);
        }
    }

    /// A gateway's image has come.
    pub fn image(&mut self, image: &InputImage, now: Now) {
        match self.images.get_mut(&image.gateway) {
            Some(at) => *at = now,
            // Of gateways that serve nothing here nothing is kept, whatever names a peer makes up.
            None if self.config.mcs.iter().any(|m| m.gateway == image.gateway) => {
                self.images.insert(image.gateway.clone(), now);
            }
            None => {}
        }
    }

    /// Newest counters of the scan thread and the host.
    pub fn sample(&mut self, sample: NodeSample, now: Now) {
        for mc in &sample.mcs {
            self.measured_us.insert(mc.mc.clone(), (mc.worst_us, now));
        }
        self.sample = sample;
    }

    /// SIGTERM: hand over, then go.
    pub fn leave(&mut self, now: Now) {
        if self.leaving.is_some() {
            return;
        }
        self.leaving = Some(Leaving {
            again: now.plus_us(LEAVING_REPEAT_US),
            idle_until: now.plus_us(LEAVING_IDLE_US),
            until: now.plus_us(LEAVING_WAIT_US),
            done: false,
        });
        self.send(AgentId::Manager, Message::Leaving);
    }

    /// A message for the CA.
    pub fn message(&mut self, envelope: Envelope, now: Now) {
        match envelope.body {
            Message::Registered(_) => self.registered(now),
            Message::RegistrationRefused(why) => self.refused(why, now),
            Message::CallForProposals(call) => self.bid(&call, now),
            Message::Award(award) => self.won = Some(award),
            Message::MayLeave { behind } => self.may_leave(&behind),
            _ => {}
        }
    }

    /// Deadlines that have come.
    pub fn handle_timeout(&mut self, now: Now) {
        if !self.manager.registered && self.register_at <= now {
            self.register(now);
        }
        if let Some(at) = self.report_at
            && at <= now
        {
            self.report_at = None;
            if self.manager.registered {
                self.report(now);
                let every = self.config.settings.report_us.max(1);
                // Kept on its own beat, but reports that were missed in a stall are not made up for.
                let next = at.plus_us(every);
                self.report_at = Some(if next > now { next } else { now.plus_us(every) });
            }
        }
        self.leaving_timeout(now);
    }

    /// The next deadline, and why.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<(Now, &'static str)> {
        let register = (!self.manager.registered).then_some((self.register_at, "register"));
        let report = self.report_at.map(|at| (at, "report"));
        let leaving = self
            .leaving
            .as_ref()
            .filter(|l| !l.done)
            .map(|l| (l.again.min(l.until), "leave"));
        [register, report, leaving].into_iter().flatten().min()
    }

    /// The next output.
    pub fn poll_output(&mut self) -> Option<NodeOutput> {
        self.out.pop_front()
    }

    fn register(&mut self, now: Now) {
        self.register_at = now.plus_us(if self.manager.refused.is_some() {
            REFUSED_REPEAT_US
        } else {
            REGISTER_REPEAT_US
        });
        let config = self.config.clone();
        let model = &config.model;
        let versions = &self.versions;
        let version_of = |m: &McModel| versions.get(&m.mc).copied().unwrap_or((m.hash, m.layout));
        let mcs = config.mcs.iter().map(|m| Hosted {
            mc: m.mc.clone(),
            hash: version_of(m).0,
            layout: version_of(m).1,
            memory_kb: m.memory_kb,
            worst_case_us: m.worst_case_us,
        });
        let registration = Registration {
            owner: config.owner.clone(),
            description: model.description.clone(),
            cpu_factor_permille: model.cpu_factor_permille,
            memory_kb: model.memory_kb,
            limit_permille: model.limit_permille,
            tick_us: model.tick_us,
            mcs: mcs.collect(),
            active: self.active.clone(),
            real_time: config.real_time.clone(),
        };
        self.send(AgentId::Manager, Message::Register(registration));
    }

    /// Which MCs may not run here is the manager's to heed: a late answer, to a life before this one or to an earlier registration,
    /// would have this controller refuse what it may run.
    fn registered(&mut self, now: Now) {
        self.manager.refused = None;
        if !self.manager.registered {
            self.manager.registered = true;
            self.report(now);
            self.report_at = Some(now.plus_us(self.config.settings.report_us.max(1)));
        }
    }

    fn refused(&mut self, why: String, now: Now) {
        self.manager.registered = false;
        self.register_at = now.plus_us(REFUSED_REPEAT_US);
        if self.manager.refused.as_ref() != Some(&why) {
            let me = &self.config.owner.controller;
            let text = format!("the manager refuses the registration of {me}: {why}");
            let event = Event::new(Severity::Warning, EventKind::ControllerRefused, text);
            self.out.push_back(NodeOutput::Event(event.controller(me)));
        }
        self.manager.refused = Some(why);
    }

    fn report(&mut self, now: Now) {
        let mcs = self.close_interval();
        let workload_permille = self.workload_permille();
        let report = ResourceReport {
            owner: self.config.owner.clone(),
            workload_permille,
            mcs,
            host_cpu_permille: self.sample.host_cpu_permille,
            process_cpu_permille: self.sample.process_cpu_permille,
            process_memory_kb: self.sample.process_memory_kb,
            late_ticks: self.sample.late_ticks,
            overruns: self.sample.overruns,
            image_age_us: self.image_age_us(now),
            bad_messages: self.sample.bad_messages,
        };
        self.send(AgentId::Manager, Message::Report(report));
        self.own_events(workload_permille);
    }

    /// The case study's event: a controller that has joined is below its limit. And an overload that lasts.
    fn own_events(&mut self, workload_permille: u32) {
        let me = self.config.owner.controller.clone();
        let percent = f64::from(workload_permille) / 10.0;
        if !self.joined {
            self.joined = true;
            if workload_permille < FULL_PERMILLE && self.leaving.is_none() {
                let detail = format!("{me} has registered and is at {percent:.1} % of its limit");
                self.raise(Cause::Imbalance(me.clone()), detail);
            }
        }
        if workload_permille > FULL_PERMILLE {
            self.overloads += 1;
            if self.overloads == OVERLOAD_REPORTS {
                let detail =
                    format!("{me} is at {percent:.1} % of its limit in {OVERLOAD_REPORTS} reports");
                self.raise(Cause::Overload(me), detail);
            }
        } else if workload_permille < OVERLOAD_ENDS_PERMILLE {
            self.overloads = 0;
        }
    }

    fn raise(&mut self, cause: Cause, detail: String) {
        let event = QosEvent {
            qos: "work balance".to_owned(),
            cause,
            detail,
        };
        self.send(AgentId::Decision, Message::Qos(event));
    }

    /// Loads since the last report; a new interval begins.
    fn close_interval(&mut self) -> Vec<McLoad> {
        let mut loads = Vec::with_capacity(self.sample.mcs.len());
        let mut intervals = BTreeMap::new();
        for mc in &self.sample.mcs {
            let mut interval = self.intervals.remove(&mc.mc).unwrap_or_default();
            if mc.scans < interval.scans {
                interval = Interval::default(); // it was activated anew
            }
            let scans = mc.scans - interval.scans;
            let newest_ns = mc.cpu_ns.saturating_sub(interval.cpu_ns) / scans.max(1);
            if scans > 0 && interval.scans < SCANS_MIN {
                interval.mean_ns = newest_ns;
            } else if scans >= SCANS_MIN {
                interval.mean_ns = (interval.mean_ns * (SMOOTHING - 1) + newest_ns) / SMOOTHING;
            }
            interval.scans = mc.scans;
            interval.cpu_ns = mc.cpu_ns;
            loads.push(McLoad {
                mc: mc.mc.clone(),
                scan_us_mean: u32::try_from(interval.mean_ns / 1_000).unwrap_or(u32::MAX),
                scan_us_worst: mc.worst_us,
                cycle_us: mc.cycle_us,
                scans: u32::try_from(scans).unwrap_or(u32::MAX),
                lag_us: mc.lag_us,
            });
            intervals.insert(mc.mc.clone(), interval);
        }
        self.intervals = intervals;
        loads
    }

    /// Workload of what runs now: 100 x sum of (mean scan CPU time / cycle) / limit, in permille (design, section 8).
    fn workload_permille(&self) -> u32 {
        let limit = u64::from(self.config.model.limit_permille.max(1));
        let sum: u64 = self
            .sample
            .mcs
            .iter()
            .map(|mc| {
                let known = self.intervals.get(&mc.mc).filter(|i| i.scans <= mc.scans);
                let known_ns = known.map_or(0, |interval| interval.mean_ns);
                let mean_ns = if known_ns > 0 {
                    known_ns
                } else {
                    mc.cpu_ns / mc.scans.max(1)
                };
                mean_ns * 1_000 / (u64::from(mc.cycle_us.max(1)) * limit)
            })
            .sum();
        u32::try_from(sum).unwrap_or(u32::MAX)
    }

    fn image_age_us(&self, now: Now) -> u64 {
        self.images
            .values()
            .max()
            .map_or(u64::MAX, |at| now.since_us(*at))
    }

    fn bid(&mut self, call: &CallForProposals, now: Now) {
        let offers = call.mcs.iter().map(|mc| self.offer(mc, now)).collect();
        let used: u64 = self
            .config
            .mcs
            .iter()
            .filter(|m| self.active.iter().any(|(mc, _)| mc == &m.mc))
            .map(|m| m.memory_kb)
            .sum();
        let criteria = self
            .config
            .criteria
            .iter()
            .filter(|(name, _)| call.criteria.contains(name))
            .cloned()
            .collect();
        let bid = Bid {
            negotiation: call.negotiation,
            owner: self.config.owner.clone(),
            offers,
            workload_permille: self.workload_permille(),
            memory_free_kb: self.config.model.memory_kb.saturating_sub(used),
            image_age_us: self.image_age_us(now),
            criteria,
        };
        self.send(AgentId::Decision, Message::Bid(bid));
    }

    fn offer(&self, mc: &McId, now: Now) -> McOffer {
        let me = &self.config.owner.controller;
        let Some(model) = self.config.mcs.iter().find(|m| &m.mc == mc) else {
            return McOffer {
                mc: mc.clone(),
                unable: Some(format!("{me} does not host it")),
                worst_case_us: 0,
            };
        };
        let factor = u64::from(self.config.model.cpu_factor_permille.max(1));
        let declared =
            u32::try_from(u64::from(model.worst_case_us) * 1_000 / factor).unwrap_or(u32::MAX);
        let age_us = self
            .images
            .get(&model.gateway)
            .map_or(u64::MAX, |at| now.since_us(*at));
        let stale_us = IMAGE_TICKS_MAX * u64::from(self.config.model.tick_us);
        let unable = if self.leaving.is_some() {
            Some(format!("{me} is leaving"))
        } else if age_us == u64::MAX {
            Some(format!("{me} has had no input image of {}", model.gateway))
        } else if age_us > stale_us {
            Some(format!(
                "{me}'s newest input image of {} is {} ms old",
                model.gateway,
                age_us / 1_000
            ))
        } else {
            None
        };
        let measured = self.measured_us.get(mc);
        let measured = measured.filter(|(us, at)| *us > 0 && now.since_us(*at) <= MEASURED_KEPT_US);
        McOffer {
            mc: mc.clone(),
            unable,
            worst_case_us: measured.map_or(declared, |(us, _)| *us),
        }
    }

    fn may_leave(&mut self, behind: &[McId]) {
        let Some(leaving) = &mut self.leaving else {
            return;
        };
        // An order may have crossed the manager's word: what runs here and has a place elsewhere goes first.
        let waits = self.active.iter().any(|(mc, _)| !behind.contains(mc)) || self.opening;
        if !leaving.done && !waits {
            leaving.done = true;
            self.go("nobody else can take it now");
        }
    }

    /// Leaves, and says what is left behind.
    fn go(&mut self, why: &str) {
        let left: Vec<McId> = self.active.iter().map(|(mc, _)| mc.clone()).collect();
        if !left.is_empty() {
            self.left_behind(&left, why);
        }
        self.out.push_back(NodeOutput::Act(NodeAct::Leave { left }));
    }

    fn leaving_timeout(&mut self, now: Now) {
        let idle = self.active.is_empty() && !self.opening;
        let Some(leaving) = self.leaving.as_mut().filter(|l| !l.done) else {
            return;
        };
        if leaving.until <= now || (idle && leaving.idle_until <= now) {
            leaving.done = true;
            let seconds = LEAVING_WAIT_US / 1_000_000;
            self.go(&format!("not handed over within {seconds} s"));
        } else if leaving.again <= now {
            leaving.again = now.plus_us(LEAVING_REPEAT_US);
            self.send(AgentId::Manager, Message::Leaving);
        }
    }

    fn left_behind(&mut self, left: &[McId], why: &str) {
        let me: &ControllerId = &self.config.owner.controller;
        let names: Vec<&str> = left.iter().map(McId::as_str).collect();
        let text = format!(
            "{me} leaves {} behind: {why}; the gateway will set the fail-safe values",
            names.join(", "),
        );
        let event = Event::new(Severity::Alarm, EventKind::ControllerStopped, text);
        self.out.push_back(NodeOutput::Event(event.controller(me)));
    }

    fn send(&mut self, to: AgentId, body: Message) {
        self.out.push_back(NodeOutput::Send(Envelope {
            from: AgentId::Controller(self.config.owner.controller.clone()),
            boot: self.config.owner.boot,
            to,
            body,
        }));
    }
}
