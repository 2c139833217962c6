//! One span for each reconfiguration under way: it names event, decision and MCs, and what is logged about the plan stands in it.

use fam_driver::log_event;
use fam_proto::{Event, Plan, PlanId};
use std::collections::BTreeMap;
use tracing::Span;

/// The open spans.
#[derive(Debug, Default)]
pub(crate) struct Spans {
    open: BTreeMap<PlanId, Span>,
}

impl Spans {
    pub(crate) fn begin(&mut self, plan: &Plan) {
        let span = span(plan);
        span.in_scope(|| tracing::info!("reconfiguration {} begins", plan.id));
        self.open.insert(plan.id, span);
    }

    pub(crate) fn end(&mut self, plan: PlanId, summary: &str, complete: bool) {
        let span = self.open.remove(&plan).unwrap_or_else(Span::none);
        span.in_scope(|| {
            if complete {
                tracing::info!("reconfiguration {plan} is done: {summary}");
            } else {
                tracing::warn!("reconfiguration {plan} ended otherwise: {summary}");
            }
        });
    }

    /// Logs an event, in the span of its plan.
    pub(crate) fn log(&self, event: &Event) {
        match event.plan.and_then(|plan| self.open.get(&plan)) {
            Some(span) => span.in_scope(|| log_event(event)),
            None => log_event(event),
        }
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{
        Cause, ControllerId, EventKind, McId, Move, MoveKind, PlanId, QosEvent, Severity,
    };
    use std::io::Write;
    use std::sync::{Arc, Mutex};

    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().write(bytes)
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn what_is_logged_of_a_plan_stands_in_its_span() {
        let (c1, c2) = (
            ControllerId::new("c1").unwrap(),
            ControllerId::new("c2").unwrap(),
        );
        let plan = Plan {
            id: PlanId(4),
            parent: PlanId(3),
            event: QosEvent {
                qos: "availability".to_owned(),
                cause: Cause::ControllerLost(c1.clone()),
                detail: "c1 is gone".to_owned(),
            },
            moves: vec![Move {
                mc: McId::new("station1").unwrap(),
                from: Some(c1),
                to: c2,
                kind: MoveKind::Activate,
            }],
            left_out: Vec::new(),
            why: "c2 has room".to_owned(),
            peak_permille: (0, 10),
        };
        let lines = Lines::default();
        let writer = lines.clone();
        let subscriber = tracing_subscriber::fmt()
            .json()
            .with_writer(move || writer.clone())
            .finish();
        tracing::subscriber::with_default(subscriber, || {
            let mut spans = Spans::default();
            spans.begin(&plan);
            let event = Event::new(Severity::Info, EventKind::McActivated, "activated");
            spans.log(&event.clone().plan(PlanId(4)));
            spans.log(&event);
            spans.end(PlanId(4), "1 of 1 moved", true);
            spans.log(&event.plan(PlanId(4)));
        });
        let text = String::from_utf8(lines.0.lock().unwrap().clone()).unwrap();
        let in_span: Vec<bool> = text
            .lines()
            .map(|line| {
                let fields = [
                    r#""plan":4"#,
                    r#""qos":"availability""#,
                    r#""event":"c1 is gone""#,
                    r#""decision":"c2 has room""#,
                    r#""mcs":"station1 c1 -> c2""#,
                    r#""name":"reconfiguration""#,
                ];
                fields.iter().all(|field| line.contains(field))
            })
            .collect();
        assert_eq!(in_span, [true, true, false, true, false], "{text}");
    }
}
