//! What the manager's agents cannot do themselves: write, tell, know the wall clock, keep spans open.

use crate::spans::Spans;
use crate::store::Store;
use fam_agents::manager::ManagerAct;
use fam_driver::{Link, Shell, now, wall_us};
use fam_proto::{Envelope, Event, Message, Now, QueryReply, RepoWrite};

pub(crate) struct ManagerShell {
    link: Link,
    store: Store,
    spans: Spans,
}

impl ManagerShell {
    pub(crate) fn new(link: Link, store: Store) -> ManagerShell {
        ManagerShell {
            link,
            store,
            spans: Spans::default(),
        }
    }
}

/// The wall clock of an event of this life that was noted before the agents knew it.
fn date(event: &mut Event) {
    if event.wall_us == 0 {
        event.wall_us = wall_us().saturating_sub(now().since_us(Now(event.at_us)));
    }
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
            ManagerAct::PlanBegan(plan) => self.spans.begin(&plan),
            ManagerAct::PlanEnded {
                plan,
                summary,
                complete,
            } => self.spans.end(plan, &summary, complete),
        }
    }

    fn log(&mut self, event: &Event) {
        self.spans.log(event);
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
