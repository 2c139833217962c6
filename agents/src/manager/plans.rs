//! Plans: checked against what is true now, then carried out, several moves at once.

use super::desk::Ticket;
use super::{ManagerAct, MiddlewareManager};
use crate::monitor::News;
use crate::unfit::Unfit;
use fam_proto::{
    Cause, ControllerId, Event, EventKind, McId, MoveKind, Now, Plan, PlanId, QosEvent, RepoWrite,
    Severity,
};
use std::collections::BTreeSet;

/// An MC that finds no place is an alarm after so many tries, or at once where nobody could be asked.
pub(super) const TRIES_BEFORE_ALARM: u32 = 3;
/// So many causes are remembered as told.
pub(super) const TOLD_MAX: usize = 256;

/// Why a plan is not carried out.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PlanRefusal {
    /// Made from another assignment.
    #[error(
        "plan {plan} was made from generation {parent}, the assignment is at {generation}; it has to be planned anew"
    )]
    Stale {
        /// The plan.
        plan: PlanId,
        /// What it was made from.
        parent: PlanId,
        /// What is in force.
        generation: PlanId,
    },
    /// Its number is not the next one.
    #[error("plan {plan} does not follow generation {generation}")]
    Number {
        /// The plan.
        plan: PlanId,
        /// What is in force.
        generation: PlanId,
    },
    /// An MC that is not there, or has no record yet.
    #[error("nothing is known of {mc}, or its gateway has not been seen")]
    Unknown {
        /// The MC.
        mc: McId,
    },
    /// An MC that is on its way already, or stands twice in the plan.
    #[error("{mc} is on its way already")]
    UnderWay {
        /// The MC.
        mc: McId,
    },
    /// A target that may not take the MC.
    #[error("{controller} cannot take {mc}: it {why}")]
    Target {
        /// The MC.
        mc: McId,
        /// The target.
        controller: ControllerId,
        /// Why not.
        why: Unfit,
    },
    /// A move that does not fit what the record says.
    #[error("{mc} cannot be moved like this: {why}")]
    Kind {
        /// The MC.
        mc: McId,
        /// Why not.
        why: &'static str,
    },
}

/// A plan that is being carried out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Running {
    open: BTreeSet<McId>,
    done: u32,
    failed: Vec<String>,
    began: Now,
}

// What has come of it so far is told to people.
impl std::hash::Hash for Running {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.open.hash(state);
    }
}

impl MiddlewareManager {
    /// Whether the plan fits what is true now.
    ///
    /// # Errors
    /// [`PlanRefusal`] says what does not fit.
    pub fn check(&self, plan: &Plan, now: Now) -> Result<(), PlanRefusal> {
        let generation = self.view.generation;
        if plan.parent != generation {
            return Err(PlanRefusal::Stale {
                plan: plan.id,
                parent: plan.parent,
                generation,
            });
        }
        if plan.id != generation.next() {
            return Err(PlanRefusal::Number {
                plan: plan.id,
                generation,
            });
        }
        let mut seen = BTreeSet::new();
        for wanted in &plan.moves {
            let mc = &wanted.mc;
            let Some((_, view)) = self.view.mc(mc) else {
                return Err(PlanRefusal::Unknown { mc: mc.clone() });
            };
            if view.record.is_none() {
                return Err(PlanRefusal::Unknown { mc: mc.clone() });
            }
            if view.under_way.is_some() || !seen.insert(mc) {
                return Err(PlanRefusal::UnderWay { mc: mc.clone() });
            }
            if let Err(why) = self.view.may_take(&wanted.to, mc, now) {
                return Err(PlanRefusal::Target {
                    mc: mc.clone(),
                    controller: wanted.to.clone(),
                    why,
                });
            }
            let runs = self.view.runs_on(mc);
            let why = match wanted.kind {
                MoveKind::Handover if runs.is_none() => "nobody is there to hand it over",
                MoveKind::Handover if runs == Some(&wanted.to) => "it runs there already",
                MoveKind::Activate if runs.is_some() && plan.event.cause != Cause::Operator => {
                    "its owner drives it"
                }
                MoveKind::Activate if runs.is_none() && self.view.need(mc).is_none() => {
                    "it is stopped"
                }
                MoveKind::Handover | MoveKind::Activate => continue,
            };
            return Err(PlanRefusal::Kind {
                mc: mc.clone(),
                why,
            });
        }
        Ok(())
    }

    /// Checks a plan and begins to carry it out.
    ///
    /// # Errors
    /// [`PlanRefusal`]; then nothing has happened but an entry in the history.
    pub fn accept(&mut self, plan: &Plan, now: Now) -> Result<(), PlanRefusal> {
        if let Err(refusal) = self.check(plan, now) {
            let event = Event::new(
                Severity::Warning,
                EventKind::PlanRefused,
                refusal.to_string(),
            );
            self.event(event.plan(plan.id), now);
            for wanted in &plan.moves {
                self.command_failed(&wanted.mc, &refusal.to_string(), false);
            }
            return Err(refusal);
        }
        let evicted: Vec<McId> = plan
            .left_out
            .iter()
            .map(|(mc, _)| mc)
            .filter(|mc| self.is_evicted(mc))
            .cloned()
            .collect();
        let mut open: BTreeSet<McId> = plan.moves.iter().map(|m| m.mc.clone()).collect();
        open.extend(evicted.iter().cloned());
        self.running.insert(
            plan.id,
            Running {
                open,
                done: 0,
                failed: Vec::new(),
                began: now,
            },
        );
        self.news.push(News::PlanBegan(plan.event.clone()));
        for wanted in &plan.moves {
            if let Some(view) = self.view.mcs.get_mut(&wanted.mc) {
                view.assigned = Some(wanted.to.clone());
            }
            self.begin_move(plan.id, wanted, now);
        }
        for mc in &evicted {
            if let Some(view) = self.view.mcs.get_mut(mc) {
                view.shed = true;
                view.assigned = None;
            }
            self.begin_stop(Some(plan.id), mc, now);
        }
        self.send_orders(now);
        // What the plant waits for goes out; now the books.
        self.new_generation(plan.id);
        self.desk.act(ManagerAct::PlanBegan(Box::new(plan.clone())));
        let decided = Event::new(Severity::Info, EventKind::PlanDecided, plan.why.clone());
        self.event(decided.plan(plan.id), now);
        for wanted in &plan.moves {
            let how = match wanted.kind {
                MoveKind::Activate => "is activated on",
                MoveKind::Handover => "is handed over to",
            };
            let text = format!("{} {how} {}", wanted.mc, wanted.to);
            let event = Event::new(Severity::Info, EventKind::MoveOrdered, text);
            self.event(
                event.plan(plan.id).mc(&wanted.mc).controller(&wanted.to),
                now,
            );
        }
        self.not_placed(&plan.left_out, true, now);
        Ok(())
    }

    /// A running MC that a plan leaves out has to make room; one on a controller that is to be emptied just stays.
    fn is_evicted(&self, mc: &McId) -> bool {
        self.view
            .runs_on(mc)
            .and_then(|c| self.view.controllers.get(c))
            .is_some_and(|c| !c.is_emptied())
            && self.view.mcs[mc].under_way.is_none()
    }

    /// A monitor's or an operator's event is about to be answered. `true` if that is news for the history.
    pub fn note(&mut self, event: &QosEvent, now: Now) -> bool {
        let now_at = (self.view.version, self.view.generation);
        if self.told.len() > TOLD_MAX {
            self.told.clear();
        }
        let news = self.told.insert(format!("{:?}", event.cause), now_at) != Some(now_at);
        if news {
            let text = format!("{}: {}", event.qos, event.detail);
            self.event(Event::new(Severity::Info, EventKind::QosEvent, text), now);
        }
        news
    }

    /// Diagnosis & Decision found nothing to do.
    pub fn nothing_decided(
        &mut self,
        event: &QosEvent,
        why: &str,
        left_out: &[(McId, String)],
        nobody: bool,
        now: Now,
    ) {
        let now_at = (self.view.version, self.view.generation);
        let key = format!("declined {:?}", event.cause);
        if self.told.insert(key, now_at) != Some(now_at) {
            let text = format!("no plan: {why}");
            self.event(
                Event::new(Severity::Info, EventKind::PlanRefused, text),
                now,
            );
        }
        self.not_placed(left_out, nobody, now);
        self.news.push(News::Declined(event.clone()));
    }

    /// MCs that find no place: an alarm each, by name; operators who wait for them hear it.
    fn not_placed(&mut self, left_out: &[(McId, String)], at_once: bool, now: Now) {
        for (mc, why) in left_out {
            self.command_failed(mc, &format!("{mc} finds no place: {why}"), true);
            let leaves: Option<ControllerId> = self
                .view
                .runs_on(mc)
                .filter(|c| self.view.controllers.get(*c).is_some_and(|c| c.leaving))
                .cloned();
            if let Some(controller) = leaves {
                let text = format!("{controller} leaves although nobody can take {mc}: {why}");
                let event = Event::new(Severity::Alarm, EventKind::McUnplaced, text);
                if self.leave_behind(&controller, mc) {
                    self.event(event.mc(mc).controller(&controller), now);
                }
                continue;
            }
            if self.view.need(mc).is_none() && !self.view.mcs.get(mc).is_some_and(|m| m.shed) {
                continue;
            }
            let (tries, told) = self.unplaced.entry(mc.clone()).or_insert((0, false));
            *tries += 1;
            if !*told && (at_once || *tries >= TRIES_BEFORE_ALARM) {
                *told = true;
                let text = format!("{mc} does not run, no controller can take it: {why}");
                let event = Event::new(Severity::Alarm, EventKind::McUnplaced, text);
                self.event(event.mc(mc), now);
            }
        }
    }

    /// A job of a plan has ended.
    pub(super) fn job_ended(
        &mut self,
        plan: Option<PlanId>,
        mc: &McId,
        failed: Option<&str>,
        now: Now,
    ) {
        if let Some(why) = failed {
            self.command_failed(mc, why, false);
        }
        let Some(id) = plan else { return };
        let Some(running) = self.running.get_mut(&id) else {
            return;
        };
        running.open.remove(mc);
        match failed {
            None => running.done += 1,
            Some(why) => running.failed.push(format!("{mc}: {why}")),
        }
        if !running.open.is_empty() {
            return;
        }
        let Some(ended) = self.running.remove(&id) else {
            return;
        };
        let took_ms = now.since_us(ended.began) / 1_000;
        let mut summary = format!(
            "{} of {} moves done",
            ended.done,
            ended.done as usize + ended.failed.len()
        );
        if !ended.failed.is_empty() {
            summary.push_str(&format!("; off: {}", ended.failed.join("; ")));
        }
        summary.push_str(&format!(", {took_ms} ms"));
        let event = Event::new(Severity::Info, EventKind::PlanDone, summary.clone());
        self.event(event.plan(id), now);
        self.desk.act(ManagerAct::PlanEnded {
            plan: id,
            complete: ended.failed.is_empty(),
            summary,
        });
        self.news.push(News::PlanEnded);
    }

    /// Keeps what an operator has set; the command ends when it is durable.
    pub(super) fn keep_for(&mut self, write: RepoWrite, client: u64, id: u64) {
        self.desk.persist(write, Ticket::Command(client, id));
    }
}
