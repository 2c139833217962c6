//! One job for each MC on its way: an activation, a handover, or a stop.
//!
//! ```text
//!             epoch durable                      record driven
//!  Reserving ---------------> Activating ----------------------------> done
//!      |                        ^   |  deadline, refused, target lost -> failed: left out there, planned anew
//!      |                        |   |  the owner is healthy after all -> dropped
//!      | handover               | record released
//!      +-----------------> Releasing --------------------------------> cancelled: no non-critical state in time
//!      |                            |  owner or target lost            -> cancelled, planned anew if it has no owner
//!      | stop
//!      +-----------------> Stopping ---- record not open -------------> done
//! ```
//!
//! Only the gateway's record moves a job on; what MC Agents report can only end it earlier.

mod standing;

use self::standing::Standing;
use super::MiddlewareManager;
use crate::cell_view::{HEALTHY_CYCLES, LeftOut, UnderWay};
use fam_proto::{
    AgentId, Epoch, Event, EventKind, LayoutHash, McId, McOutcome, McReport, Move, MoveKind, Now,
    OrderId, OrderKind, Owner, PlanId, RecordState, Reset, Severity, Successor,
};

/// A stop POU may take this long, in microseconds.
const STOP_US: u64 = 30_000_000;
/// A cancelled order is repeated no longer than this, in microseconds.
const CANCEL_US: u64 = 2_000_000;
/// First time that a controller is left out after a failed activation, doubled with each further failure, in microseconds.
const LEFT_OUT_US: u64 = 100_000;
/// Doubled no further than to this, in microseconds.
const LEFT_OUT_MAX_US: u64 = 5_000_000;
/// An MCA ends a release by itself; its word may take this long, in microseconds.
const RELEASE_GRACE_US: u64 = 500_000;

/// What is to come of the MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) enum Aim {
    /// Opened at once by this owner.
    Activate(Owner),
    /// Handed over to this owner.
    Handover(Owner),
    /// Released by its owner to itself, and run with a new version.
    Renew(Owner, u64, LayoutHash),
    /// Stopped.
    Stop,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Step {
    Reserving,
    Activating {
        epoch: Epoch,
        order: OrderId,
        deadline: Now,
    },
    Releasing {
        epoch: Epoch,
        /// The order to the successor; a new version gets it when the old one has released.
        activate: Option<OrderId>,
        release: OrderId,
        deadline: Now,
    },
    Stopping {
        order: OrderId,
        deadline: Now,
    },
}

/// An MC on its way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Job {
    plan: Option<PlanId>,
    aim: Aim,
    /// Who drives (or drove) it, and under which epoch.
    from: Option<Owner>,
    from_epoch: Epoch,
    force: bool,
    reset: Option<Reset>,
    step: Step,
    began: Now,
}

// When it began is told to people.
impl std::hash::Hash for Job {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (self.plan, &self.aim, &self.from, self.from_epoch).hash(state);
        (self.force, self.reset, self.step).hash(state);
    }
}

impl Job {
    /// Whether it waits for this order to be carried out.
    pub(super) fn awaits(&self, id: OrderId) -> bool {
        match self.step {
            Step::Reserving => false,
            Step::Activating { order, .. } | Step::Stopping { order, .. } => order == id,
            Step::Releasing {
                activate, release, ..
            } => activate == Some(id) || release == id,
        }
    }

    fn target(&self) -> Option<&Owner> {
        match &self.aim {
            Aim::Activate(owner) | Aim::Handover(owner) | Aim::Renew(owner, ..) => Some(owner),
            Aim::Stop => None,
        }
    }

    fn deadline(&self) -> Option<(Now, &'static str)> {
        match &self.step {
            Step::Reserving => None,
            Step::Activating { deadline, .. } => Some((*deadline, "an activation is due")),
            Step::Releasing { deadline, .. } => Some((*deadline, "a release is due")),
            Step::Stopping { deadline, .. } => Some((*deadline, "a stop is due")),
        }
    }
}

impl MiddlewareManager {
    /// Begins a move of a plan.
    pub(super) fn begin_move(&mut self, plan: PlanId, wanted: &Move, now: Now) {
        let Some(target) = self
            .view
            .controllers
            .get(&wanted.to)
            .and_then(|c| c.owner())
            .cloned()
        else {
            return;
        };
        let aim = match wanted.kind {
            MoveKind::Activate => Aim::Activate(target),
            MoveKind::Handover => Aim::Handover(target),
        };
        let force = wanted.kind == MoveKind::Activate && self.view.runs_on(&wanted.mc).is_some();
        self.begin(Some(plan), &wanted.mc, aim, force, now);
    }

    /// Begins to bring a new version in.
    pub(super) fn begin_renew(
        &mut self,
        mc: &McId,
        owner: Owner,
        version: u64,
        layout: LayoutHash,
        now: Now,
    ) {
        self.begin(None, mc, Aim::Renew(owner, version, layout), false, now);
    }

    /// Begins to stop an MC that runs.
    pub(super) fn begin_stop(&mut self, plan: Option<PlanId>, mc: &McId, now: Now) {
        self.begin(plan, mc, Aim::Stop, false, now);
    }

    fn begin(&mut self, plan: Option<PlanId>, mc: &McId, aim: Aim, force: bool, now: Now) {
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return;
        };
        let Some(record) = &view.record else { return };
        view.under_way = Some(match &aim {
            Aim::Activate(owner) | Aim::Handover(owner) | Aim::Renew(owner, ..) => {
                UnderWay::To(owner.controller.clone())
            }
            Aim::Stop => UnderWay::Stop,
        });
        let job = Job {
            plan,
            from: record.owner.clone(),
            from_epoch: record.epoch,
            force,
            // What a plan stopped for want of room goes on from its record.
            reset: view.reset.or(view.shed.then_some(Reset::Resume)),
            aim,
            step: Step::Reserving,
            began: now,
        };
        self.jobs.insert(mc.clone(), job);
        self.order_if_possible(mc, now);
    }

    /// Gives the orders of a job, as soon as it has its epoch.
    fn order_if_possible(&mut self, mc: &McId, now: Now) {
        let settings = self.view.model.settings.clone();
        let Some(job) = self.jobs.get_mut(mc) else {
            return;
        };
        if job.step != Step::Reserving {
            return;
        }
        let component = |owner: &Owner| AgentId::Component(owner.controller.clone(), mc.clone());
        match &job.aim {
            Aim::Stop => {
                let Some(from) = &job.from else { return };
                let kind = OrderKind::Stop {
                    epoch: job.from_epoch,
                };
                let order = self.orders.give(component(from), mc, kind, now, None);
                job.step = Step::Stopping {
                    order,
                    deadline: now.plus_us(STOP_US),
                };
            }
            Aim::Activate(target) => {
                let Some(epoch) = self.epochs.take(mc) else {
                    return;
                };
                let kind = OrderKind::Activate {
                    epoch,
                    after: None,
                    force: job.force,
                    reset: job.reset,
                    within_us: settings.activation_us,
                };
                let order = self.orders.give(component(target), mc, kind, now, None);
                job.step = Step::Activating {
                    epoch,
                    order,
                    deadline: now.plus_us(settings.activation_us),
                };
            }
            Aim::Handover(target) | Aim::Renew(target, ..) => {
                let Some(from) = job.from.clone() else { return };
                let Some(epoch) = self.epochs.take(mc) else {
                    return;
                };
                let waits = matches!(job.aim, Aim::Handover(_));
                let activate = OrderKind::Activate {
                    epoch,
                    after: Some(from.clone()),
                    force: false,
                    reset: None,
                    within_us: settings.release_us + settings.activation_us,
                };
                let release = OrderKind::Release {
                    epoch: job.from_epoch,
                    successor: Successor {
                        epoch,
                        owner: target.clone(),
                    },
                    within_us: settings.release_us,
                };
                // The successor hears first, so that it is ready when the last frame comes.
                let mut give = |kind| self.orders.give(component(target), mc, kind, now, None);
                let activate = waits.then(|| give(activate));
                let release = self.orders.give(component(&from), mc, release, now, None);
                job.step = Step::Releasing {
                    epoch,
                    activate,
                    release,
                    deadline: now.plus_us(settings.release_us + RELEASE_GRACE_US),
                };
            }
        }
    }

    /// Looks at all jobs.
    pub(super) fn review_jobs(&mut self, now: Now) {
        let mcs: Vec<McId> = self.jobs.keys().cloned().collect();
        for mc in mcs {
            let standing = self.standing(&mc, now);
            self.settle_job(&mc, standing, now);
            self.order_if_possible(&mc, now);
        }
    }

    pub(super) fn jobs_deadline(&self) -> Option<(Now, &'static str)> {
        self.jobs.values().filter_map(Job::deadline).min()
    }

    /// What is on its way, in words.
    pub(super) fn jobs_in_words(&self) -> Vec<String> {
        self.jobs
            .iter()
            .map(|(mc, job)| {
                let step = match &job.step {
                    Step::Reserving => "waits for the repository to make an epoch durable",
                    Step::Activating { .. } => "is being activated",
                    Step::Releasing { .. } => "waits for a non-critical state",
                    Step::Stopping { .. } => "is being stopped",
                };
                match job.target() {
                    Some(target) => format!("{mc} to {}: {step}", target.controller),
                    None => format!("{mc}: {step}"),
                }
            })
            .collect()
    }

    fn settle_job(&mut self, mc: &McId, standing: Standing, now: Now) {
        match standing {
            Standing::Wait => {}
            Standing::Released => self.now_activating(mc, now),
            Standing::Done => self.end_done(mc, now),
            Standing::Dropped(why) => self.end_badly(mc, &why, false, now),
            Standing::Failed { why, leave_out } => {
                // Lost to the manager alone: the gateway sees the owner drive, so it is left alone.
                if leave_out && self.gateway_contradicts(mc) {
                    self.end_badly(mc, "the gateway sees its owner drive", false, now);
                } else {
                    self.end_badly(mc, &why, leave_out, now);
                }
            }
        }
    }

    fn now_activating(&mut self, mc: &McId, now: Now) {
        let wait_us = self.view.model.settings.activation_us;
        if let Some(job) = self.jobs.get_mut(mc)
            && let Step::Releasing {
                epoch,
                activate,
                release,
                ..
            } = job.step
        {
            self.orders.withdraw(release);
            let order = match (activate, &job.aim) {
                (None, Aim::Renew(target, version, _)) => {
                    let kind = OrderKind::Renew {
                        epoch,
                        version: *version,
                        within_us: wait_us,
                    };
                    let to = AgentId::Component(target.controller.clone(), mc.clone());
                    self.orders.give(to, mc, kind, now, None)
                }
                (None, _) => return,
                (Some(activate), _) => activate,
            };
            job.step = Step::Activating {
                epoch,
                order,
                deadline: now.plus_us(wait_us),
            };
            let standing = self.standing(mc, now);
            if !matches!(standing, Standing::Released) {
                self.settle_job(mc, standing, now);
            }
        }
    }

    /// An owner is lost to the manager, but the gateway has its frames: remembers to leave it alone under this epoch.
    fn gateway_contradicts(&mut self, mc: &McId) -> bool {
        let Some(job) = self.jobs.get(mc) else {
            return false;
        };
        if job.force || !matches!(job.aim, Aim::Activate(_)) {
            return false;
        }
        let from_epoch = job.from_epoch;
        let cycle_us = self.view.model.mc(mc).map_or(0, |m| u64::from(m.cycle_us));
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return false;
        };
        let drives = view.record.as_ref().is_some_and(|r| {
            r.state == RecordState::Open
                && r.epoch == from_epoch
                && r.driven
                && !r.suspect
                && r.silent_us <= HEALTHY_CYCLES * cycle_us
        });
        if drives {
            view.left_alone = Some(from_epoch);
        }
        drives
    }

    fn end_done(&mut self, mc: &McId, now: Now) {
        let Some(job) = self.jobs.remove(mc) else {
            return;
        };
        self.withdraw_orders(&job);
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return;
        };
        view.under_way = None;
        let took_ms = now.since_us(job.began) / 1_000;
        let record = view.record.clone();
        if let Some(target) = job.target() {
            view.reset = None;
            view.shed = false;
            view.left_out.remove(&target.controller);
            let text = match &job.from {
                Some(from) if matches!(job.aim, Aim::Handover(_)) => format!(
                    "{mc} runs on {}, handed over by {} within {took_ms} ms",
                    target.controller, from.controller
                ),
                _ => format!(
                    "{mc} runs on {}, {took_ms} ms after the order",
                    target.controller
                ),
            };
            let mut event = Event::new(Severity::Info, EventKind::McActivated, text)
                .mc(mc)
                .controller(&target.controller);
            if let Some(record) = &record {
                event = event.epoch(record.epoch).scan(record.scan());
            }
            event.plan = job.plan;
            self.event(event, now);
        }
        if let Aim::Renew(owner, version, layout) = &job.aim {
            self.now_in_force(mc, *version, *layout, Some(owner), now);
        }
        self.job_ended(job.plan, mc, None, now);
    }

    fn end_badly(&mut self, mc: &McId, why: &str, leave_out: bool, now: Now) {
        let Some(job) = self.jobs.remove(mc) else {
            return;
        };
        self.withdraw_orders(&job);
        self.call_off(mc, &job, now);
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return;
        };
        view.under_way = None;
        let kind = match (&job.aim, leave_out) {
            (Aim::Stop, _) => EventKind::McStopped,
            (_, true) => EventKind::ActivationFailed,
            (_, false) => EventKind::MoveCancelled,
        };
        let mut event;
        if let Some(target) = job.target() {
            let controller = &target.controller;
            if leave_out {
                let failures = view.left_out.get(controller).map_or(0, |l| l.failures) + 1;
                let pause_us = (LEFT_OUT_US << (failures - 1).min(10)).min(LEFT_OUT_MAX_US);
                view.left_out.insert(
                    controller.clone(),
                    LeftOut {
                        until: now.plus_us(pause_us),
                        failures,
                        cleared: false,
                        why: why.to_owned(),
                    },
                );
            }
            let text = if leave_out {
                format!(
                    "{mc} could not be activated on {controller}: {why}; it is left out there for now"
                )
            } else if matches!(job.aim, Aim::Renew(..)) {
                format!("the new version of {mc} is not taken on {controller}: {why}")
            } else {
                format!("the move of {mc} to {controller} is off: {why}")
            };
            event = Event::new(Severity::Warning, kind, text).controller(controller);
        } else {
            event = Event::new(
                Severity::Warning,
                kind,
                format!("{mc} could not be stopped: {why}"),
            );
        }
        event.plan = job.plan;
        self.event(event.mc(mc).epoch(job.from_epoch), now);
        // The assignment follows what is.
        let on = self.view.runs_on(mc).cloned();
        if let Some(view) = self.view.mcs.get_mut(mc)
            && view.assigned != on
        {
            view.assigned = on;
            self.new_generation(self.view.generation.next());
        }
        self.job_ended(job.plan, mc, Some(why), now);
    }

    fn withdraw_orders(&mut self, job: &Job) {
        match job.step {
            Step::Reserving => {}
            Step::Activating { order, .. } | Step::Stopping { order, .. } => {
                self.orders.withdraw(order);
            }
            Step::Releasing {
                activate, release, ..
            } => {
                if let Some(activate) = activate {
                    self.orders.withdraw(activate);
                }
                self.orders.withdraw(release);
            }
        }
    }

    /// Tells those who were ordered that it is off.
    fn call_off(&mut self, mc: &McId, job: &Job, now: Now) {
        let expires = Some(now.plus_us(CANCEL_US));
        let mut cancel = |owner: &Owner, epoch: Epoch| {
            let to = AgentId::Component(owner.controller.clone(), mc.clone());
            let kind = OrderKind::CancelRelease { epoch };
            self.orders.give(to, mc, kind, now, expires);
        };
        match (&job.step, job.target()) {
            (Step::Activating { epoch, .. }, Some(target)) => cancel(target, *epoch),
            (Step::Releasing { epoch, .. }, Some(target)) => {
                if let Some(from) = &job.from {
                    cancel(from, job.from_epoch);
                }
                cancel(target, *epoch);
            }
            _ => {}
        }
    }

    /// An order has failed: no need to wait for its deadline.
    pub(super) fn heed(&mut self, mc: &McId, report: &McReport, now: Now) {
        let (Some(job), Some(answered)) = (self.jobs.get(mc), report.order) else {
            return;
        };
        let standing = match (&job.step, &report.outcome) {
            (
                Step::Activating {
                    order: activate, ..
                }
                | Step::Releasing {
                    activate: Some(activate),
                    ..
                },
                McOutcome::NotOpened(why),
            ) if *activate == answered => Standing::Failed {
                why: why.clone(),
                // A controller that cannot run a new version can still run the old one.
                leave_out: !matches!(job.aim, Aim::Renew(..)),
            },
            (Step::Releasing { release, .. }, McOutcome::ReleaseCancelled(why))
                if *release == answered =>
            {
                Standing::Failed {
                    why: why.clone(),
                    leave_out: false,
                }
            }
            _ => return,
        };
        self.settle_job(mc, standing, now);
    }
}
