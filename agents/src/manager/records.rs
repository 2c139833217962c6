//! What the gateways' images say: the truth about who drives.

use super::MiddlewareManager;
use fam_proto::{
    ControllerId, Event, EventKind, InputImage, McId, Now, RecordState, RecordSummary, Severity,
};

/// No gateway sends images faster than this, in microseconds.
const IMAGE_US_MIN: u64 = 500;
/// Longest text of an event that another process tells, in bytes.
const EVENT_TEXT_BYTES_MAX: usize = 1_000;
/// So many images may be missed at once beside those that time explains.
const IMAGES_AHEAD: u64 = 64;

impl MiddlewareManager {
    /// Takes an image, unless it is older than what is known or of an unknown gateway.
    pub(super) fn take_image(&mut self, image: &InputImage, now: Now) {
        let Some(gateway) = self.view.gateways.get_mut(&image.gateway) else {
            self.bad_messages += 1;
            return;
        };
        let name = &image.gateway;
        let known = gateway.boot;
        // Numbers grow over restarts, which boot ids need not do: they come from a wall clock.
        if known.is_some() && image.number <= gateway.image {
            return;
        }
        // One damaged number must not make the manager deaf to the images to come.
        let ahead = image.number.0.saturating_sub(gateway.image.0);
        let possible = IMAGES_AHEAD + now.since_us(gateway.heard) / IMAGE_US_MIN;
        if known == Some(image.boot) && ahead > possible {
            self.bad_messages += 1;
            return;
        }
        // Another life, while the token of this one is seen, is believed with its second image in succession.
        if known.is_some_and(|b| b != image.boot) && gateway.token == known {
            let before = gateway.doubtful.replace((image.boot, image.number));
            let second = before.is_some_and(|(boot, number)| {
                let steps = image.number.0.saturating_sub(number.0);
                boot == image.boot && (1..=IMAGES_AHEAD).contains(&steps)
            });
            if !second {
                self.bad_messages += 1;
                return;
            }
        }
        gateway.doubtful = None;
        let was_down = gateway.down;
        gateway.boot = Some(image.boot);
        gateway.image = image.number;
        gateway.heard = now;
        gateway.down = false;
        let text = match known {
            None => Some(format!("gateway {name} is there (boot {})", image.boot)),
            Some(boot) if boot != image.boot => Some(format!(
                "gateway {name} was restarted (boot {}): every epoch it had open is closed",
                image.boot
            )),
            Some(_) if was_down => Some(format!("gateway {name} is heard again")),
            Some(_) => None,
        };
        if let Some(text) = text {
            self.view.version += 1;
            self.event(
                Event::new(Severity::Info, EventKind::GatewayJoined, text),
                now,
            );
        }
        for record in &image.records {
            self.take_record(record, &image.gateway, now);
        }
    }

    fn take_record(&mut self, record: &RecordSummary, gateway: &fam_proto::GatewayId, now: Now) {
        let mc = &record.mc;
        if self.view.mc(mc).is_none_or(|(m, _)| &m.gateway != gateway) {
            return;
        }
        let Some(view) = self.view.mcs.get_mut(mc) else {
            return;
        };
        self.epochs.seen(mc, record.epoch);
        let before = view.record.replace(record.clone());
        if view
            .left_alone
            .is_some_and(|e| e != record.epoch || record.suspect)
        {
            view.left_alone = None;
        }
        let Some(before) = before else {
            return; // found as it is: told by `adopt`, or by whoever saw it happen
        };
        if before.owner != record.owner || before.epoch != record.epoch {
            view.state = None;
        }
        let changed = before.state != record.state || before.epoch != record.epoch;
        let owner = record.owner.as_ref().map(|o| o.controller.clone());
        match &record.state {
            RecordState::FailSafe if changed => {
                let text = format!(
                    "{mc}: no valid frame came in time, the gateway has set its fail-safe values"
                );
                self.mc_event(
                    Severity::Alarm,
                    EventKind::McFailSafe,
                    record,
                    owner,
                    text,
                    now,
                );
            }
            RecordState::Stopped if changed => {
                let text = format!("{mc} is stopped; `fam reset {mc}` brings it back");
                self.mc_event(
                    Severity::Info,
                    EventKind::McStopped,
                    record,
                    owner,
                    text,
                    now,
                );
            }
            RecordState::Faulted(trap) if changed => {
                let text =
                    format!("{mc} is stopped by a fault: {trap}; `fam reset {mc}` brings it back");
                self.mc_event(
                    Severity::Alarm,
                    EventKind::McFaulted,
                    record,
                    owner,
                    text,
                    now,
                );
            }
            RecordState::Open if record.suspect && !before.suspect => {
                let text = format!(
                    "{mc}: no valid frame for {}.{} ms",
                    record.silent_us / 1_000,
                    record.silent_us / 100 % 10
                );
                self.mc_event(
                    Severity::Warning,
                    EventKind::McSuspect,
                    record,
                    owner,
                    text,
                    now,
                );
            }
            RecordState::Never
            | RecordState::Open
            | RecordState::Released(_)
            | RecordState::Closed
            | RecordState::FailSafe
            | RecordState::Stopped
            | RecordState::Faulted(_) => {}
        }
    }

    /// An event about an MC that its gateway or its agent may tell, too: once is enough.
    pub(super) fn mc_event(
        &mut self,
        severity: Severity,
        kind: EventKind,
        record: &RecordSummary,
        controller: Option<ControllerId>,
        text: String,
        now: Now,
    ) {
        let scan = if kind == EventKind::McSuspect {
            record.scan().0
        } else {
            0
        };
        if !self.is_news(kind, &record.mc, record.epoch, scan) {
            return;
        }
        let mut event = Event::new(severity, kind, text)
            .mc(&record.mc)
            .epoch(record.epoch)
            .scan(record.scan());
        event.controller = controller;
        self.event(event, now);
    }

    /// An event that a node or a gateway tells.
    pub(super) fn foreign_event(&mut self, mut event: Event, now: Now) {
        cut(&mut event.text, EVENT_TEXT_BYTES_MAX);
        let told_twice = matches!(
            event.kind,
            EventKind::McFailSafe
                | EventKind::McStopped
                | EventKind::McFaulted
                | EventKind::McSuspect
        );
        if told_twice && let (Some(mc), Some(epoch)) = (&event.mc, event.epoch) {
            let scan = match event.kind {
                EventKind::McSuspect => event.scan.map_or(0, |s| s.0),
                _ => 0,
            };
            if !self.is_news(event.kind, &mc.clone(), epoch, scan) {
                return;
            }
        }
        self.event(event, now);
    }

    /// Takes the plant as it finds it: an MC that somebody drives belongs there, whatever was planned before.
    pub(super) fn adopt(&mut self, now: Now) {
        let found: Vec<(McId, ControllerId)> = self
            .view
            .mcs
            .iter()
            .filter(|(_, m)| m.under_way.is_none())
            .filter(|(_, m)| m.record.as_ref().is_some_and(|r| r.driven))
            .filter_map(|(mc, m)| {
                let on = self.view.runs_on(mc)?;
                (m.assigned.as_ref() != Some(on)).then(|| (mc.clone(), on.clone()))
            })
            .collect();
        if found.is_empty() {
            return;
        }
        for (mc, on) in &found {
            let Some(view) = self.view.mcs.get_mut(mc) else {
                continue;
            };
            view.assigned = Some(on.clone());
            let epoch = view
                .record
                .as_ref()
                .map_or(fam_proto::Epoch(0), |r| r.epoch);
            let text = format!("{mc} runs on {on}: taken as it is found");
            let event = Event::new(Severity::Info, EventKind::McActivated, text);
            self.event(event.mc(mc).controller(on).epoch(epoch), now);
        }
        self.new_generation(self.view.generation.next());
    }

    /// A manager that dies between an order and its outcome leaves an activation behind that the history does not tell; so does
    /// one that gets no image before the epoch is over: then the head tells of it.
    pub(super) fn tell_unseen_activations(&mut self, now: Now) {
        let unseen: Vec<Event> = self
            .view
            .mcs
            .iter()
            .filter_map(|(mc, m)| {
                let record = m.record.as_ref()?;
                let told = *self.activated.get(mc)?;
                let over = record.head.map(|head| head.epoch);
                if let Some(epoch) = over.filter(|e| told < *e && *e < record.epoch) {
                    let text = format!(
                        "{mc} was activated with epoch {epoch} and is so no more; no image of that time came through"
                    );
                    let event = Event::new(Severity::Info, EventKind::McActivated, text);
                    return Some(event.mc(mc).epoch(epoch));
                }
                let owner = record.owner.as_ref()?;
                let is_unseen = record.driven && m.under_way.is_none() && told < record.epoch;
                is_unseen.then(|| {
                    let on = &owner.controller;
                    let text = format!(
                        "{mc} was activated on {on} with epoch {} while no manager looked",
                        record.epoch
                    );
                    Event::new(Severity::Info, EventKind::McActivated, text)
                        .mc(mc)
                        .controller(on)
                        .epoch(record.epoch)
                })
            })
            .collect();
        for event in unseen {
            self.event(event, now);
        }
    }
}

/// Cuts a text at a character.
pub(super) fn cut(text: &mut String, bytes_max: usize) {
    if text.len() > bytes_max {
        text.truncate(text.floor_char_boundary(bytes_max));
    }
}
