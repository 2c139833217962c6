//! What the manager's agents cannot do themselves: write, tell, know the wall clock, keep spans open.

use crate::store::Store;
use fam_agents::manager::ManagerAct;
use fam_driver::{Link, Shell, log_event, now, wall_us};
use fam_proto::{Envelope, Event, Message, Now, Plan, PlanId, QueryReply, RepoWrite};
use std::collections::BTreeMap;
use tracing::Span;

pub(crate) struct ManagerShell {
    link: Link,
    store: Store,
    /// One for each reconfiguration under way.
    spans: BTreeMap<PlanId, Span>,
}

impl ManagerShell {
    pub(crate) fn new(link: Link, store: Store) -> ManagerShell {
        ManagerShell {
            link,
            store,
            spans: BTreeMap::new(),
        }
    }
}

/// The wall clock of an event of this life that was noted before the agents knew it.
fn date(event: &mut Event) {
    if event.wall_us == 0 {
        event.wall_us = wall_us().saturating_sub(now().since_us(Now(event.at_us)));
    }
}

/// Names event, decision and MCs.
fn span(plan: &Plan) -> Span {
    let moves: Vec<_> = plan
        .moves
        .iter()
        .map(|m| match &m.from {
            Some(from) => format!("{} {from} -> {}", m.mc, m.to),
            None => format!("{} -> {}", m.mc, m.to),
        })
        .collect();
    tracing::info_span!(
        "reconfiguration",
        plan = plan.id.0,
        qos = plan.event.qos,
        event = plan.event.detail,
        decision = plan.why,
        mcs = moves.join(", "),
    )
}

impl Shell<RepoWrite, ManagerAct> for ManagerShell {
    fn persist(&mut self, mut write: RepoWrite) -> Result<(), String> {
        if let RepoWrite::Event(event) = &mut write {
            date(event);
        }
        self.store.store(write)
    }

    fn act(&mut self, action: ManagerAct, _now: Now) {
        match action {
            ManagerAct::PlanBegan(plan) => {
                let span = span(&plan);
                span.in_scope(|| tracing::info!("reconfiguration {} begins", plan.id));
                self.spans.insert(plan.id, span);
            }
            ManagerAct::PlanEnded {
                plan,
                summary,
                complete,
            } => {
                let span = self.spans.remove(&plan).unwrap_or_else(Span::none);
                span.in_scope(|| match complete {
                    true => tracing::info!("reconfiguration {plan} is done: {summary}"),
                    false => tracing::warn!("reconfiguration {plan} ended otherwise: {summary}"),
                });
            }
        }
    }

    fn log(&mut self, event: &Event) {
        match event.plan.and_then(|plan| self.spans.get(&plan)) {
            Some(span) => span.in_scope(|| log_event(event)),
            None => log_event(event),
        }
    }

    fn event(&mut self, mut event: Event) {
        date(&mut event);
        self.link.publish_event(&event);
    }

    fn outgoing(&mut self, envelope: &mut Envelope) {
        if let Message::QueryReply(reply) = &mut envelope.body
            && let QueryReply::Events { events, .. } = &mut **reply
        {
            events.iter_mut().for_each(date);
        }
    }
}
