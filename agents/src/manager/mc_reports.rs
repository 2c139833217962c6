//! What MC Agents report: ends a job early, and goes into the history.

use super::MiddlewareManager;
use fam_proto::{
    AgentId, Envelope, Event, EventKind, McId, McOutcome, McReport, Now, RecordSummary, Severity,
};

impl MiddlewareManager {
    /// What an MC Agent says.
    pub(super) fn mc_report(&mut self, envelope: &Envelope, report: &McReport, now: Now) -> bool {
        let mc = &report.mc;
        let from = AgentId::Component(report.owner.controller.clone(), mc.clone());
        if envelope.from != from || envelope.boot != report.owner.boot {
            return false;
        }
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return false;
        };
        let record = view.record.clone();
        let owns = |r: &RecordSummary| {
            r.owner.as_ref() == Some(&report.owner) && report.epoch.is_none_or(|e| e == r.epoch)
        };
        if record.as_ref().is_some_and(owns) {
            view.state = Some(report.state);
        }
        self.heed(mc, report, now);
        if !self
            .tellers
            .admit(&envelope.from, Some(mc), &self.view, now)
        {
            return false;
        }
        self.tell(mc, report, record.as_ref(), now);
        true
    }

    fn tell(&mut self, mc: &McId, report: &McReport, record: Option<&RecordSummary>, now: Now) {
        let on = &report.owner.controller;
        let (severity, kind, text) = match &report.outcome {
            McOutcome::Activated {
                recovery,
                interval: Some(interval),
                ..
            } => (
                Severity::Warning,
                EventKind::McRecovering,
                format!(
                    "{mc} was interrupted in its critical interval {interval}; {on} recovers it (action {recovery})"
                ),
            ),
            McOutcome::Recovered => (
                Severity::Info,
                EventKind::McRecovering,
                format!("{mc} has recovered on {on} and runs"),
            ),
            McOutcome::Released { scan } => (
                Severity::Info,
                EventKind::McReleased,
                format!("{on} has released {mc} after scan {scan}"),
            ),
            McOutcome::Deposed(why) => (
                Severity::Info,
                EventKind::McReleased,
                format!("{on} drives {mc} no more: {why}"),
            ),
            McOutcome::Faulted(trap) => {
                if let Some(record) = record {
                    let text = format!(
                        "{mc} on {on} is stopped by a fault: {trap}; `fam reset {mc}` brings it back"
                    );
                    let mut marked = record.clone();
                    marked.epoch = report.epoch.unwrap_or(record.epoch);
                    self.mc_event(
                        Severity::Alarm,
                        EventKind::McFaulted,
                        &marked,
                        Some(on.clone()),
                        text,
                        now,
                    );
                }
                return;
            }
            McOutcome::Activated { interval: None, .. }
            | McOutcome::NotOpened(_)
            | McOutcome::ReleaseCancelled(_)
            | McOutcome::Stopped
            | McOutcome::Changed => return,
        };
        let mut event = Event::new(severity, kind, text).mc(mc).controller(on);
        event.epoch = report.epoch;
        self.event(event, now);
    }
}
