//! The manager's process as one state machine: Middleware Manager, QoS Monitors, Diagnosis & Decision.
//!
//! They see the same cell and speak to each other here, within one step: news and events go round until nobody has
//! anything more to say.

use super::{ManagerAct, ManagerLocal, ManagerOutput, MiddlewareManager};
use crate::cell_view::CellView;
use crate::decision::{Decided, Decision};
use crate::monitor::Qualities;
use fam_proto::agent::{Input, Output};
use fam_proto::model::CellModel;
use fam_proto::{Agent, AgentId, BootId, Envelope, Message, Now, ProcessId, RepoState, RepoWrite};
use std::sync::Arc;

/// Rounds of one step at most: an exchange that goes on longer goes on with the next input.
const ROUNDS_MAX: u32 = 16;

/// The manager's agents.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ManagerAgents {
    manager: MiddlewareManager,
    qualities: Qualities,
    decision: Decision,
}

impl ManagerAgents {
    /// With availability, work balance and cycle time.
    #[must_use]
    pub fn new(
        model: Arc<CellModel>,
        restored: RepoState,
        boot: BootId,
        now: Now,
    ) -> ManagerAgents {
        Self::with_qualities(model, restored, boot, now, Qualities::standard())
    }

    /// With the given qualities of service.
    #[must_use]
    pub fn with_qualities(
        model: Arc<CellModel>,
        restored: RepoState,
        boot: BootId,
        now: Now,
        qualities: Qualities,
    ) -> ManagerAgents {
        ManagerAgents {
            manager: MiddlewareManager::new(model, restored, boot, now),
            qualities,
            decision: Decision::new(boot),
        }
    }

    /// What is known of the cell.
    #[must_use]
    pub fn view(&self) -> &CellView {
        self.manager.view()
    }

    /// The Middleware Manager.
    #[must_use]
    pub fn manager(&self) -> &MiddlewareManager {
        &self.manager
    }

    fn message(&mut self, envelope: Envelope, now: Now) {
        if envelope.to.process() != ProcessId::Manager {
            self.manager.count_bad();
            return;
        }
        // A message is believed only if its sender is who it speaks for.
        let signed = |controller| envelope.controller() == Some(controller);
        match &envelope.body {
            Message::Bid(bid) => {
                if signed(&bid.owner.controller) && envelope.boot == bid.owner.boot {
                    self.decision.bid(bid.clone(), now);
                } else {
                    self.manager.count_bad();
                }
            }
            Message::Holding(holding) => {
                let from = AgentId::Component(holding.owner.controller.clone(), holding.mc.clone());
                if envelope.from == from && envelope.boot == holding.owner.boot {
                    self.decision.holding(holding.clone());
                } else {
                    self.manager.count_bad();
                }
            }
            Message::Qos(event) => {
                let view = self.manager.view();
                let known = envelope
                    .controller()
                    .and_then(|c| view.controllers.get(c))
                    .and_then(|c| c.owner())
                    .is_some_and(|o| envelope.is_from(o));
                if known && self.qualities.admit(event, view, now) {
                    self.manager.note(event, now);
                    self.decision.event(event.clone());
                }
            }
            _ => {
                let in_progress = self.decision.in_progress();
                self.manager.message(envelope, in_progress, now);
            }
        }
    }

    /// Lets the agents talk until all is said.
    fn converse(&mut self, now: Now) {
        for _ in 0..ROUNDS_MAX {
            let mut said = false;
            self.manager.review(now);
            for news in self.manager.take_news() {
                said = true;
                self.qualities.told(&news, self.manager.view(), now);
            }
            for (wish, detail) in self.manager.take_wishes() {
                said = true;
                self.decision.wish(wish, detail);
            }
            for event in self.qualities.monitor(self.manager.view(), now) {
                said = true;
                self.manager.note(&event, now);
                self.decision.event(event);
            }
            self.decision
                .consider(self.manager.view(), &self.qualities, now);
            while let Some(decided) = self.decision.poll() {
                said = true;
                self.carry_out(decided, now);
            }
            if !said {
                return;
            }
        }
    }

    fn carry_out(&mut self, decided: Decided, now: Now) {
        match decided {
            Decided::Send(envelope) => self.manager.pass_on(envelope),
            Decided::Plan(plan) => match self.manager.accept(&plan, now) {
                Ok(()) => self.decision.accepted(&plan),
                Err(_) => self.decision.refused(),
            },
            Decided::Nothing {
                event,
                why,
                left_out,
                nobody,
            } => self
                .manager
                .nothing_decided(&event, &why, &left_out, nobody, now),
        }
    }
}

impl Agent for ManagerAgents {
    type Input = Input<ManagerLocal>;
    type Output = Output<RepoWrite, ManagerAct>;

    fn handle(&mut self, input: Self::Input, now: Now) {
        match input {
            Input::Message(envelope) => self.message(envelope, now),
            Input::Peer {
                process,
                boot,
                alive,
            } => self.manager.peer(&process, boot, alive, now),
            Input::Image(image) => self.manager.image(&image, now),
            Input::Persisted { ticket, result } => {
                if !self.manager.persisted(ticket, &result, now) {
                    return; // the books are kept: nothing waits for that
                }
            }
            Input::Local(local) => self.manager.local(&local, now),
        }
        self.converse(now);
    }

    fn handle_timeout(&mut self, now: Now) {
        self.converse(now);
    }

    fn poll_output(&mut self) -> Option<ManagerOutput> {
        self.manager.poll_output()
    }

    fn poll_timeout(&self) -> Option<(Now, &'static str)> {
        self.manager
            .deadline()
            .into_iter()
            .chain(self.qualities.deadline())
            .chain(self.decision.deadline())
            .min()
    }
}
