//! Who is there: registrations, liveliness tokens, reports, and controllers that leave.

use super::{GATEWAY_LOST_US, MiddlewareManager};
use crate::cell_view::Loss;
use crate::decision::Wish;
use crate::monitor::{IMAGE_STALE_US, News};
use fam_proto::{
    AgentId, BootId, ControllerId, Envelope, Event, EventKind, Hosted, McId, Message, Now, Owner,
    ProcessId, Registered, Registration, RepoWrite, ResourceReport, Severity,
};
use std::collections::BTreeMap;

use super::desk::Ticket;

/// A controller that could not be emptied is tried again after this long, in microseconds.
const EMPTY_AGAIN_US: u64 = 1_000_000;
/// MCs that a node may register beyond those of the model: it may have been built from another one, and hears so.
const FOREIGN_MCS_MAX: usize = 64;
/// Longest text in a registration, in bytes.
const TEXT_BYTES_MAX: usize = 1_000;
/// Most real-time means in one.
const REAL_TIME_MAX: usize = 16;
/// A controller that still reports so long after its token has gone is there, in microseconds.
const TOKEN_DOUBTED_US: u64 = 1_000_000;

impl MiddlewareManager {
    pub(super) fn register(
        &mut self,
        envelope: &Envelope,
        registration: &Registration,
        now: Now,
    ) -> bool {
        let owner = &registration.owner;
        let name = &owner.controller;
        if envelope.from != AgentId::Controller(name.clone())
            || envelope.boot != owner.boot
            || !self.is_of_this_size(registration)
        {
            return false;
        }
        let Some(there) = self.view.controllers.get(name) else {
            let why = format!(
                "controller {name} is not in the model of cell {}; add it to cell.toml, or start the node under one of the names there: {}",
                self.view.model.cell,
                names(self.view.controllers.keys())
            );
            self.refuse(owner, why, now);
            return true;
        };
        let known = there.registration.as_ref();
        let new_life = known.is_none_or(|r| r.owner != *owner);
        if let Some(other) = known.filter(|r| r.owner.boot != owner.boot) {
            let other = other.owner.boot;
            let lives = there.lost.is_none();
            if lives || !there.may_follow(other, owner.boot) {
                // The answer to a late word of a life that is over would reach its successor: who lives is seen to, and asks again.
                if !there.tokens.is_empty() && !there.tokens.contains(&owner.boot) {
                    return true;
                }
                let why = if lives {
                    format!(
                        "controller {name} is registered already by another node that lives (boot {other}); stop that one, or give this one (boot {}) the name of another controller",
                        owner.boot
                    )
                } else {
                    format!(
                        "a later life of controller {name} (boot {other}) has registered; boot {} is over",
                        owner.boot
                    )
                };
                self.refuse(owner, why, now);
                return true;
            }
        }
        let back = there.lost.is_some();
        let changed = there.remembered.as_ref() != Some(registration);
        self.learn_versions(registration);
        let ineligible = self.ineligible(registration);
        let Some(there) = self.view.controllers.get_mut(name) else {
            return false;
        };
        let newly_ineligible: Vec<(McId, String)> = ineligible
            .iter()
            .filter(|(mc, why)| new_life || there.ineligible.get(*mc) != Some(*why))
            .map(|(mc, why)| (mc.clone(), why.clone()))
            .collect();
        there.registration = Some(registration.clone());
        there.remembered = Some(registration.clone());
        there.ineligible = ineligible;
        there.heard = now;
        there.lost = None;
        there.expected_since = None;
        if new_life {
            there.report = None;
            there.leaving = false;
            there.may_leave = false;
            there.behind.clear();
        }
        if changed {
            let write = RepoWrite::Registered(registration.clone());
            self.desk.persist(write, Ticket::Kept);
        }
        if new_life {
            for m in self.view.mcs.values_mut() {
                m.left_out.remove(name);
            }
        }
        self.answer(name);
        if new_life || back {
            let text = format!(
                "{name} {}: CPU factor {}, limit {} %, hosts {}",
                if new_life { "has joined" } else { "is back" },
                decimal(registration.cpu_factor_permille),
                registration.limit_permille / 10,
                names(registration.mcs.iter().map(|h| &h.mc))
            );
            self.joined(name, text, now);
        }
        for (mc, why) in newly_ineligible {
            let text = format!("{mc} cannot run on {name}: its project {why}");
            let event = Event::new(Severity::Warning, EventKind::McIneligible, text);
            self.event(event.mc(&mc).controller(name), now);
        }
        true
    }

    /// Whether a registration is no larger than this cell can make it: it is kept, on disk too.
    fn is_of_this_size(&self, registration: &Registration) -> bool {
        let mcs_max = self.view.model.mcs.len() + FOREIGN_MCS_MAX;
        registration.mcs.len() <= mcs_max
            && registration.active.len() <= mcs_max
            && registration.description.len() <= TEXT_BYTES_MAX
            && registration.real_time.len() <= REAL_TIME_MAX
            && registration
                .real_time
                .iter()
                .all(|t| t.len() <= TEXT_BYTES_MAX)
    }

    fn refuse(&mut self, owner: &Owner, why: String, now: Now) {
        let name = &owner.controller;
        // Repeated every second by the node: told once for each life.
        let key = format!("refused {owner}");
        if self.told.len() > super::plans::TOLD_MAX {
            self.told.clear();
        }
        let to = AgentId::Controller(name.clone());
        if self.told.insert(key, (0, fam_proto::PlanId(0))).is_none()
            && self.tellers.admit_stranger(now)
        {
            let event = Event::new(Severity::Warning, EventKind::ControllerRefused, why.clone());
            self.event(event.controller(name), now);
        }
        self.desk.send(to, Message::RegistrationRefused(why));
    }

    /// MCs that the node may not run, with the reason.
    fn ineligible(&self, registration: &Registration) -> BTreeMap<McId, String> {
        let objection = |hosted: &Hosted| -> Option<String> {
            let Some(model) = self.view.model.mc(&hosted.mc) else {
                return Some("holds an MC that the cell model does not know".to_owned());
            };
            if !model.hosts.contains(&registration.owner.controller) {
                return Some("holds it although the cell model does not host it there".to_owned());
            }
            let (version, layout) = self.view.version_of(&hosted.mc)?;
            if hosted.hash != version {
                return Some(format!(
                    "has other logic, layout or masks (hash {:016x}) than those in force ({:016x}); if they are newer, `fam reload` brings them in; otherwise generate all projects from one model",
                    hosted.hash, version
                ));
            }
            (hosted.layout != layout).then(|| {
                "has another checkpoint layout than the one in force; generate all projects from one model".to_owned()
            })
        };
        registration
            .mcs
            .iter()
            .filter_map(|hosted| Some((hosted.mc.clone(), objection(hosted)?)))
            .collect()
    }

    /// A version in force has changed: who may run it has too.
    pub(super) fn judge_registrations(&mut self) {
        let names: Vec<ControllerId> = self.view.controllers.keys().cloned().collect();
        for name in names {
            let registration = self.view.controllers[&name].registration.clone();
            let Some(registration) = registration else {
                continue;
            };
            let ineligible = self.ineligible(&registration);
            if let Some(there) = self.view.controllers.get_mut(&name) {
                there.ineligible = ineligible;
            }
        }
    }

    /// Tells a controller what concerns it.
    fn answer(&mut self, controller: &ControllerId) {
        let there = &self.view.controllers[controller];
        let mut assigned = there.owner().map_or(Vec::new(), |o| self.view.held_by(o));
        for (mc, m) in &self.view.mcs {
            let on_its_way = matches!(&m.under_way, Some(crate::cell_view::UnderWay::To(to)) if to == controller);
            if on_its_way && !assigned.contains(mc) {
                assigned.push(mc.clone());
            }
        }
        let ineligible = there
            .ineligible
            .iter()
            .map(|(mc, why)| (mc.clone(), why.clone()))
            .collect();
        let body = Message::Registered(Registered {
            assigned,
            ineligible,
        });
        self.desk
            .send(AgentId::Controller(controller.clone()), body);
    }

    fn joined(&mut self, controller: &ControllerId, text: String, now: Now) {
        self.view.version += 1;
        let event = Event::new(Severity::Info, EventKind::ControllerJoined, text);
        self.event(event.controller(controller), now);
        self.news.push(News::Joined(controller.clone()));
    }

    pub(super) fn report(
        &mut self,
        envelope: &Envelope,
        report: &ResourceReport,
        now: Now,
    ) -> bool {
        let name = &report.owner.controller;
        if envelope.from != AgentId::Controller(name.clone()) || envelope.boot != report.owner.boot
        {
            return false;
        }
        if report.mcs.len() > self.view.model.mcs.len() {
            return false;
        }
        let Some(there) = self.view.controllers.get_mut(name) else {
            return false;
        };
        if there.owner() != Some(&report.owner) {
            // A late answer to its predecessor, or of the manager before, may have told it that it is registered. A life that is
            // over is left alone: the answer would reach its successor.
            if there.owner().is_none_or(|o| {
                o.boot < report.owner.boot || there.may_follow(o.boot, report.owner.boot)
            }) {
                let why = format!(
                    "this life of controller {name} (boot {}) has not registered",
                    report.owner.boot
                );
                let to = AgentId::Controller(name.clone());
                self.desk.send(to, Message::RegistrationRefused(why));
            }
            return true;
        }
        there.heard = now;
        there.report = Some(report.clone());
        // A crashed node's last report may come after its token has gone, but not so much later: it is the token that was lost,
        // as happens when a connection is made anew before the old one is given up.
        let back = match there.lost {
            Some(Loss::Reports) => true,
            Some(Loss::Token) => now.since_us(there.lost_since) >= TOKEN_DOUBTED_US,
            None => false,
        };
        if back {
            there.lost = None;
        }
        if report.image_age_us <= IMAGE_STALE_US {
            for m in self.view.mcs.values_mut() {
                if let Some(left_out) = m.left_out.get_mut(name) {
                    left_out.cleared = true;
                }
            }
        }
        if back {
            self.joined(name, format!("{name} is heard again"), now);
        }
        true
    }

    pub(super) fn token(&mut self, process: &ProcessId, boot: BootId, alive: bool, now: Now) {
        match process {
            ProcessId::Node(name) => self.node_token(name, boot, alive, now),
            ProcessId::Gateway(name) => {
                if let Some(gateway) = self.view.gateways.get_mut(name) {
                    if alive {
                        gateway.token = Some(gateway.token.map_or(boot, |b| b.max(boot)));
                    } else if gateway.token == Some(boot) {
                        gateway.token = None;
                    }
                }
                if let Some(gateway) = self.view.gateways.get_mut(name)
                    && !alive
                    && gateway.boot == Some(boot)
                    && !gateway.down
                {
                    gateway.down = true;
                    let text = format!("gateway {name} is lost: its liveliness token is gone");
                    self.event(
                        Event::new(Severity::Alarm, EventKind::GatewayLost, text),
                        now,
                    );
                }
            }
            ProcessId::Manager => {
                if alive && boot != self.desk.boot() {
                    let text = format!(
                        "another manager of this cell is up (boot {boot}, this one is {}); stop one of the two",
                        self.desk.boot()
                    );
                    self.event(
                        Event::new(Severity::Alarm, EventKind::ManagerStarted, text),
                        now,
                    );
                }
            }
            ProcessId::Client(_) => {}
        }
    }

    fn node_token(&mut self, name: &ControllerId, boot: BootId, alive: bool, now: Now) {
        let Some(there) = self.view.controllers.get_mut(name) else {
            return;
        };
        let in_force = there.owner().is_some_and(|o| o.boot == boot);
        if alive {
            there.tokens.insert(boot);
            if there.tokens.len() > crate::cell_view::LIVES_MAX {
                let own = there.owner().map(|o| o.boot);
                let spare = there
                    .tokens
                    .iter()
                    .copied()
                    .find(|b| Some(*b) != own && *b != boot);
                there.tokens.retain(|b| Some(*b) != spare);
            }
            if in_force {
                if there.lost == Some(Loss::Token) {
                    there.lost = None;
                    there.heard = now;
                    self.joined(name, format!("{name} is seen again"), now);
                }
            } else {
                there.expected_since.get_or_insert(now);
            }
            return;
        }
        there.tokens.remove(&boot);
        if !in_force {
            there.expected_since = None;
            return;
        }
        if there.lost != Some(Loss::Token) {
            let already = there.lost.is_some();
            there.lost = Some(Loss::Token);
            there.lost_since = now;
            let clean = there.may_leave;
            if clean {
                let text = format!("{name} has left");
                let event = Event::new(Severity::Info, EventKind::ControllerStopped, text);
                self.event(event.controller(name), now);
            } else if !already {
                self.tell_loss(name, Loss::Token, now);
            }
        }
    }

    fn tell_loss(&mut self, name: &ControllerId, loss: Loss, now: Now) {
        let text = format!("{name} is lost: {loss}");
        let event = Event::new(Severity::Warning, EventKind::ControllerLost, text);
        self.event(event.controller(name), now);
    }

    pub(super) fn miss_reports(&mut self, now: Now) {
        let lost_us = self.view.model.settings.report_lost_us;
        let silent: Vec<ControllerId> = self
            .view
            .controllers
            .iter()
            .filter(|(_, c)| c.is_up() && now >= c.heard.plus_us(lost_us))
            .map(|(name, _)| name.clone())
            .collect();
        for name in silent {
            if let Some(there) = self.view.controllers.get_mut(&name) {
                there.lost = Some(Loss::Reports);
                there.lost_since = now;
                self.tell_loss(&name, Loss::Reports, now);
            }
        }
    }

    pub(super) fn miss_images(&mut self, now: Now) {
        let silent: Vec<_> = self
            .view
            .gateways
            .iter()
            .filter(|(_, g)| g.is_up() && now >= g.heard.plus_us(GATEWAY_LOST_US))
            .map(|(name, _)| name.clone())
            .collect();
        for name in silent {
            if let Some(gateway) = self.view.gateways.get_mut(&name) {
                gateway.down = true;
                let text = format!("gateway {name} is lost: no input image for 1 s");
                self.event(
                    Event::new(Severity::Alarm, EventKind::GatewayLost, text),
                    now,
                );
            }
        }
    }

    pub(super) fn leaving(&mut self, envelope: &Envelope, now: Now) -> bool {
        let AgentId::Controller(name) = &envelope.from else {
            return false;
        };
        let Some(there) = self.view.controllers.get_mut(name) else {
            return false;
        };
        if there.owner().map(|o| o.boot) != Some(envelope.boot) {
            return true; // of another life
        }
        there.heard = now;
        if there.may_leave {
            self.may_leave(name);
        } else if !there.leaving {
            there.leaving = true;
            let text = format!("{name} hands over its MCs and leaves");
            let event = Event::new(Severity::Info, EventKind::ControllerStopped, text);
            self.event(event.controller(name), now);
        }
        true
    }

    /// Controllers that are drained or leaving: what runs there is to go elsewhere; who is empty may go.
    pub(super) fn review_emptying(&mut self, now: Now) {
        let mut still = BTreeMap::new();
        let names: Vec<ControllerId> = self.view.controllers.keys().cloned().collect();
        for name in names {
            let there = &self.view.controllers[&name];
            let Some(owner) = there
                .owner()
                .filter(|_| there.is_up() && there.is_emptied())
            else {
                continue;
            };
            let held = self.view.held_by(owner);
            let coming = self.view.mcs.values().any(
                |m| matches!(&m.under_way, Some(crate::cell_view::UnderWay::To(to)) if *to == name),
            );
            if held.is_empty() && !coming {
                if there.leaving && !there.may_leave {
                    self.may_leave(&name);
                }
                continue;
            }
            let waits = held.iter().any(|mc| {
                self.view.mcs[mc].under_way.is_none() && self.view.runs_on(mc) == Some(&name)
            });
            if !waits {
                continue;
            }
            let now_at = (self.view.version, self.view.generation);
            match self.emptying.get(&name) {
                Some((version, generation, again))
                    if (*version, *generation) == now_at && now < *again =>
                {
                    still.insert(name, (*version, *generation, *again));
                }
                _ => {
                    let why = if there.leaving {
                        "leaves"
                    } else {
                        "is drained"
                    };
                    let detail = format!("{name} {why}; it runs {}", names_of(&held));
                    still.insert(
                        name.clone(),
                        (now_at.0, now_at.1, now.plus_us(EMPTY_AGAIN_US)),
                    );
                    self.wishes.push((Wish::Empty(name), detail));
                }
            }
        }
        self.emptying = still;
    }

    pub(super) fn may_leave(&mut self, name: &ControllerId) {
        if let Some(there) = self.view.controllers.get_mut(name) {
            there.may_leave = true;
            let behind = there.behind.iter().cloned().collect();
            self.desk.send(
                AgentId::Controller(name.clone()),
                Message::MayLeave { behind },
            );
        }
    }

    /// A controller that leaves may leave this MC behind. Returns whether that is new.
    pub(super) fn leave_behind(&mut self, name: &ControllerId, mc: &McId) -> bool {
        let new = self
            .view
            .controllers
            .get_mut(name)
            .is_some_and(|there| there.behind.insert(mc.clone()));
        if new {
            self.may_leave(name);
        }
        new
    }
}

fn names<'a, T: std::fmt::Display + 'a>(items: impl Iterator<Item = &'a T>) -> String {
    let names: Vec<String> = items.map(ToString::to_string).collect();
    if names.is_empty() {
        "nothing".to_owned()
    } else {
        names.join(", ")
    }
}

pub(super) fn names_of(mcs: &[McId]) -> String {
    names(mcs.iter())
}

fn decimal(permille: u32) -> String {
    let text = format!("{}.{:03}", permille / 1_000, permille % 1_000);
    let short = text.trim_end_matches('0');
    if short.ends_with('.') {
        format!("{short}0")
    } else {
        short.to_owned()
    }
}
