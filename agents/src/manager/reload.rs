//! A new version of the cell's logic while the cell runs.
//!
//! ```text
//!  fam reload       Stage          Staged (what changed, per MC)        confirmed         Renew       record driven
//!  ----------> MM ---------> CAs ------------------------------> MM ------------> release ------> run ------------> Adopt, to all others
//! ```
//!
//! Which version of an MC is in force is told by who drives it: a controller that registers while it runs an MC brings the
//! version along. A controller with another version is not eligible for that MC, by name, until it has the one in force.

use super::MiddlewareManager;
use crate::cell_view::UnderWay;
use fam_proto::{
    AgentId, ControllerId, Envelope, Epoch, Event, EventKind, LayoutHash, McId, Message, Now,
    OrderKind, Owner, Registration, Severity, Staged, StagedMc,
};
use std::collections::BTreeMap;

/// How often a request is repeated until it is answered, in microseconds.
const ASK_AGAIN_US: u64 = 300_000;
/// Compiling a cell may take this long, in microseconds.
pub(super) const STAGE_US: u64 = 120_000_000;
/// All changed MCs have to run within this time, in microseconds.
pub(super) const RENEW_US: u64 = 30_000_000;
/// An order to hold a version is repeated no longer than this, in microseconds.
const ADOPT_US: u64 = 5_000_000;
/// Longest text that is kept of a controller's answer, in bytes.
const CHANGES_BYTES_MAX: usize = 256 * 1_024;

/// A new version that is being made ready.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Reload {
    /// Number of the request: that of the operator's command.
    id: u64,
    /// Controllers that have been asked, with their answers.
    answers: BTreeMap<Owner, Option<Staged>>,
    again: Now,
}

impl Reload {
    pub(super) fn deadline(&self) -> Option<(Now, &'static str)> {
        let waits = self.answers.values().any(Option::is_none);
        waits.then_some((self.again, "controllers make a new version ready"))
    }
}

impl MiddlewareManager {
    /// Asks all controllers that are up to make the new version ready.
    ///
    /// # Errors
    /// If there is none.
    pub(super) fn stage(&mut self, id: u64, now: Now) -> Result<String, String> {
        let up = self.view.controllers.values().filter(|c| c.is_up());
        let answers: BTreeMap<Owner, Option<Staged>> = up
            .filter_map(|c| Some((c.owner()?.clone(), None)))
            .collect();
        if answers.is_empty() {
            return Err("no controller is up; they read the cell anew when they start".to_owned());
        }
        let text = format!("{} controllers read the cell again", answers.len());
        self.reload = Some(Reload {
            id,
            answers,
            again: now,
        });
        self.review_reload(now);
        Ok(text)
    }

    /// Asks again those that have not answered; forgets those that are gone.
    pub(super) fn review_reload(&mut self, now: Now) {
        let Some(reload) = &mut self.reload else {
            return;
        };
        let view = &self.view;
        reload.answers.retain(|owner, _| view.life_is_up(owner));
        if reload.again <= now {
            reload.again = now.plus_us(ASK_AGAIN_US);
            let waiting = reload.answers.iter().filter(|(_, a)| a.is_none());
            for (owner, _) in waiting {
                let to = AgentId::Controller(owner.controller.clone());
                self.desk.send(to, Message::Stage(reload.id));
            }
        }
    }

    pub(super) fn take_staged(&mut self, envelope: &Envelope, staged: &Staged) -> bool {
        let mcs_max = self.view.model.mcs.len();
        if staged.changes.len() > CHANGES_BYTES_MAX || staged.mcs.len() > mcs_max {
            return false;
        }
        let Some(reload) = self.reload.as_mut().filter(|r| r.id == staged.id) else {
            return true; // of a request before
        };
        let asked = reload
            .answers
            .iter_mut()
            .find(|(owner, _)| envelope.is_from(owner));
        if let Some((_, answer)) = asked {
            *answer = Some(staged.clone());
        }
        true
    }

    /// What all controllers say of the new version; `None` while some are still at it.
    pub(super) fn staged_text(&self, id: u64) -> Option<Result<String, String>> {
        let Some(reload) = self.reload.as_ref().filter(|r| r.id == id) else {
            return Some(Err("another reload has come between".to_owned()));
        };
        if reload.answers.values().any(Option::is_none) {
            return None;
        }
        Some(self.agreed(reload).map(|_| {
            // All read the same files: the longest answer is that of the controller that hosts most.
            let texts = reload
                .answers
                .values()
                .flatten()
                .map(|s| s.changes.as_str());
            texts.max_by_key(|t| t.len()).unwrap_or_default().to_owned()
        }))
    }

    /// The versions that all controllers agree on.
    fn agreed(&self, reload: &Reload) -> Result<BTreeMap<McId, StagedMc>, String> {
        let mut all: BTreeMap<McId, (StagedMc, &ControllerId)> = BTreeMap::new();
        for (owner, answer) in &reload.answers {
            let Some(staged) = answer else { continue };
            if let Some(why) = &staged.refused {
                return Err(format!("{}: {why}", owner.controller));
            }
            for mc in &staged.mcs {
                match all.get(&mc.mc) {
                    Some((other, from)) if other != mc => {
                        return Err(format!(
                            "{from} and {} have read different versions of {}; give all controllers the same files",
                            owner.controller, mc.mc
                        ));
                    }
                    Some(_) => {}
                    None => {
                        all.insert(mc.mc.clone(), (mc.clone(), &owner.controller));
                    }
                }
            }
        }
        if reload.answers.is_empty() {
            return Err("no controller has the new version ready; begin anew".to_owned());
        }
        Ok(all
            .into_iter()
            .map(|(mc, (staged, _))| (mc, staged))
            .collect())
    }

    /// Brings what is ready into force; gives the versions that are to run.
    ///
    /// # Errors
    /// Why nothing was begun.
    pub(super) fn renew_all(&mut self, id: u64, now: Now) -> Result<BTreeMap<McId, u64>, String> {
        let Some(reload) = self.reload.as_ref().filter(|r| r.id == id) else {
            return Err(
                "nothing is ready under this number; begin anew with `fam reload`".to_owned(),
            );
        };
        let mut wanted = self.agreed(reload)?;
        wanted.retain(|mc, staged| self.view.version_of(mc).map(|v| v.0) != Some(staged.version));
        for mc in wanted.keys() {
            let busy = self.view.mcs.get(mc).is_some_and(|m| m.under_way.is_some());
            if busy {
                return Err(format!(
                    "{mc} is on its way; try again when it has arrived (`fam status`)"
                ));
            }
        }
        let ready: Vec<Owner> = reload.answers.keys().cloned().collect();
        for (mc, staged) in &wanted {
            let driver = self.view.driver(mc).cloned();
            match driver.filter(|owner| ready.contains(owner)) {
                Some(owner) => self.begin_renew(mc, owner, staged.version, staged.layout, now),
                // Nobody drives it: whoever does next takes the new version.
                None => self.now_in_force(mc, staged.version, staged.layout, None, now),
            }
        }
        Ok(wanted.into_iter().map(|(mc, s)| (mc, s.version)).collect())
    }

    /// A version is in force: the other controllers are to hold it too.
    pub(super) fn now_in_force(
        &mut self,
        mc: &McId,
        version: u64,
        layout: LayoutHash,
        on: Option<&Owner>,
        now: Now,
    ) {
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return;
        };
        view.version = Some((version, layout));
        self.view.version += 1;
        let text = match on {
            Some(owner) => format!(
                "{mc} runs its new version {version:016x} on {}",
                owner.controller
            ),
            None => format!("{mc} has the new version {version:016x}; it does not run now"),
        };
        let event = Event::new(Severity::Info, EventKind::McRenewed, text);
        self.event(event.mc(mc), now);
        let ready = self.reload.iter().flat_map(|r| r.answers.keys());
        let others: Vec<Owner> = ready.filter(|owner| Some(*owner) != on).cloned().collect();
        for owner in others {
            let to = AgentId::Component(owner.controller.clone(), mc.clone());
            let expires = Some(now.plus_us(ADOPT_US));
            self.orders
                .give(to, mc, OrderKind::Adopt { version }, now, expires);
        }
        self.judge_registrations();
    }

    /// Whoever drives an MC brings the version in force along.
    pub(super) fn learn_versions(&mut self, registration: &Registration) {
        for (mc, epoch) in &registration.active {
            let hosted = registration.mcs.iter().find(|h| &h.mc == mc);
            let (Some(hosted), Some(view)) = (hosted, self.view.mcs.get_mut(mc)) else {
                continue;
            };
            let drives = view.record.as_ref().is_none_or(|record| {
                record.epoch == *epoch && record.owner.as_ref() == Some(&registration.owner)
            });
            if drives && *epoch > Epoch(0) && view.under_way != Some(UnderWay::Stop) {
                view.version = Some((hosted.hash, hosted.layout));
            }
        }
    }
}
