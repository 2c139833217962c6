//! What a gateway does because time passes: ticks and images, silence, watchdogs, reports; and its end.

use super::{Gateway, GatewayAct, Why};
use crate::place;
use crate::stored::RecordWrite;
use fam_proto::agent::Output;
use fam_proto::model::InputSource;
use fam_proto::{
    AgentId, Event, EventKind, InputImage, McExports, McId, McInputs, Message, Now, RecordState,
    Severity,
};
use std::sync::Arc;

/// Rejected frames of one MC, and all messages that do not read, are reported at most once in this time, in microseconds.
pub const REPORT_REJECTED_US: u64 = 1_000_000;

impl Gateway {
    pub(super) fn timers(&mut self, now: Now) {
        let due = |at: Option<Now>| at.is_some_and(|at| at <= now);
        let mut silent = Vec::new();
        let mut suspect = Vec::new();
        for (mc, gate) in &self.gates {
            if due(gate.watchdog_at()) {
                silent.push(mc.clone());
            } else if due(gate.suspect_at()) {
                suspect.push(mc.clone());
            }
        }
        for mc in silent {
            self.watchdog(&mc, now);
        }
        for mc in suspect {
            self.suspect(&mc, now);
        }
        self.report_rejected(now);
        let bad = self.bad_messages();
        if bad > 0
            && self
                .bad_told
                .is_none_or(|at| now.since_us(at) >= REPORT_REJECTED_US)
        {
            self.bad_told = Some(now);
            self.send(AgentId::Manager, Message::BadMessages(bad));
        }
    }

    fn watchdog(&mut self, mc: &McId, now: Now) {
        let Some(gate) = self.gates.get(mc) else {
            return;
        };
        let text = format!(
            "{mc}: no valid frame for {} ms while {}; its outputs stand at their fail-safe values until it is activated anew",
            gate.silent_us(now) / 1_000,
            gate.ledger().state.word(),
        );
        self.set_fail_safe(
            mc,
            RecordState::FailSafe,
            Event::new(Severity::Alarm, EventKind::McFailSafe, text),
            false,
            now,
        );
    }

    pub(super) fn set_fail_safe(
        &mut self,
        mc: &McId,
        state: RecordState,
        event: Event,
        sync: bool,
        now: Now,
    ) {
        let Some(gate) = self.gates.get_mut(mc) else {
            return;
        };
        gate.fail_safe(state);
        let ledger = gate.ledger().clone();
        let outputs = Arc::clone(gate.outputs());
        // The record says so first, so that a kill in between does not leave safe values at the field that it knows nothing of. But
        // no disk may delay them: what has to survive a power failure is synced behind them.
        let changed = |sync| RecordWrite::Changed {
            mc: mc.clone(),
            ledger: ledger.clone(),
            sync,
        };
        self.persist(changed(false), super::Pending::Note { mc: mc.clone() });
        self.out.push_back(Output::Act(GatewayAct::ApplyOutputs {
            mc: mc.clone(),
            outputs,
            why: Why::FailSafe,
        }));
        let mut event = event.mc(mc).epoch(ledger.epoch).scan(ledger.last_scan);
        event.controller = ledger.owner.as_ref().map(|o| o.controller.clone());
        self.event(now, event);
        if sync {
            self.persist(changed(true), super::Pending::Note { mc: mc.clone() });
        }
    }

    fn suspect(&mut self, mc: &McId, now: Now) {
        let Some(gate) = self.gates.get_mut(mc) else {
            return;
        };
        gate.set_suspect();
        let ledger = gate.ledger();
        let owner = ledger
            .owner
            .as_ref()
            .map_or_else(String::new, |owner| format!(" of {owner}"));
        let mut event = Event::new(
            Severity::Warning,
            EventKind::McSuspect,
            format!(
                "{mc}: no valid frame{owner} for {} ms",
                gate.silent_us(now) / 1_000
            ),
        )
        .mc(mc)
        .epoch(ledger.epoch)
        .scan(ledger.last_scan);
        event.controller = ledger.owner.as_ref().map(|o| o.controller.clone());
        self.event(now, event);
    }

    pub(super) fn report_rejected(&mut self, now: Now) {
        let mut events = Vec::new();
        for (mc, reported) in &mut self.reported {
            let due = reported
                .at
                .is_none_or(|at| now.since_us(at) >= REPORT_REJECTED_US);
            if reported.waiting.is_empty() || !due {
                continue;
            }
            reported.at = Some(now);
            let all: u64 = reported.waiting.values().sum();
            let reasons = std::mem::take(&mut reported.waiting)
                .into_iter()
                .map(|(why, count)| format!("{count} × {why}"))
                .collect::<Vec<_>>()
                .join(", ");
            let owner = reported.owner.take();
            let of = owner
                .as_ref()
                .map_or_else(String::new, |o| format!(" of {o}"));
            let text = format!("{mc}: {all} frames{of} rejected: {reasons}");
            let mut event = Event::new(Severity::Warning, EventKind::FramesRejected, text).mc(mc);
            event.controller = owner.map(|owner| owner.controller);
            events.push(event);
        }
        for event in events {
            self.event(now, event);
        }
    }

    pub(super) fn tick(&mut self, now: Now) {
        if now < self.next_tick {
            return;
        }
        self.next_tick = self.next_tick.plus_us(self.tick_us);
        if self.next_tick <= now {
            // The machine stalled: ticks that are over are not made up for.
            let missed = now.since_us(self.next_tick) / self.tick_us + 1;
            self.next_tick = self.next_tick.plus_us(missed * self.tick_us);
        }
        if self.reading {
            // The field has not answered for a whole tick. Acknowledgements go out all the same.
            for gate in self.gates.values_mut() {
                gate.inputs_late();
            }
            self.publish(now);
        } else {
            self.reading = true;
            self.out.push_back(Output::Act(GatewayAct::ReadField));
        }
    }

    pub(super) fn publish(&mut self, now: Now) {
        self.image = self.image.next();
        let inputs = self
            .gates
            .iter()
            .map(|(mc, gate)| {
                let (bytes, fresh) = gate.inputs();
                let mut bytes = bytes.to_vec();
                for input in &gate.model().inputs {
                    if let InputSource::Export { mc: from, place } = &input.source
                        && let Some(outputs) = self.outputs_of(from, now)
                        && let Some(value) = place::get(outputs, *place)
                    {
                        place::set(&mut bytes, input.place, value);
                    }
                }
                McInputs {
                    mc: mc.clone(),
                    bytes,
                    fresh,
                }
            })
            .collect();
        let image = InputImage {
            gateway: self.id.clone(),
            boot: self.boot,
            number: self.image,
            sent_at_us: now.0,
            inputs,
            records: self.gates.values().map(|gate| gate.summary(now)).collect(),
            exports: self
                .exported
                .iter()
                .filter_map(|mc| {
                    Some(McExports {
                        mc: mc.clone(),
                        outputs: self.gates.get(mc)?.outputs().to_vec(),
                    })
                })
                .collect(),
        };
        for gate in self.gates.values_mut() {
            gate.image_sent(now);
        }
        self.out
            .push_back(Output::Act(GatewayAct::PublishImage(Arc::new(image))));
    }

    /// The outputs that stand at the field, here or at another gateway.
    fn outputs_of(&self, mc: &McId, now: Now) -> Option<&[u8]> {
        match self.gates.get(mc) {
            Some(gate) => Some(gate.outputs()),
            None => Some(self.foreign.get(mc)?.outputs(now)),
        }
    }

    pub(super) fn leave(&mut self, now: Now) {
        let driven: Vec<McId> = self
            .gates
            .iter()
            .filter(|(_, gate)| gate.watchdog_at().is_some())
            .map(|(mc, _)| mc.clone())
            .collect();
        for mc in &driven {
            let text = format!(
                "{mc}: gateway {} ends; its outputs stand at their fail-safe values",
                self.id
            );
            let event = Event::new(Severity::Warning, EventKind::McFailSafe, text);
            self.set_fail_safe(mc, RecordState::FailSafe, event, false, now);
        }
        self.publish(now);
        self.out.push_back(Output::Act(GatewayAct::Left));
    }
}
