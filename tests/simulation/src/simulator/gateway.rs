//! The gateway's process: its core, its record file, the field.

use super::canary::Canary;
use super::network::Pid;
use super::world::{Event, Packet, World};
use crate::invariants::{Ended, Seen};
use fam_gateway_core::{
    Gateway, GatewayAct, GatewayInput, GatewayLocal, GatewayOutput, MemoryRecords, RecordWrite,
    Why, opening,
};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{
    AgentId, Applied, BootId, Envelope, McId, Message, Owner, RecordState, decode_frame,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// When answers begin to get lost, with the planted bug.
const ANSWERS_LOST_FROM_US: u64 = 700_000;

/// The worst of the faults of a kind that hit a node now; 0 if none does.
pub(super) fn worst(faults: &BTreeMap<usize, (usize, u64)>, node: usize) -> u64 {
    let hit = faults.values().filter(|(n, _)| *n == node);
    hit.map(|(_, much)| *much).max().unwrap_or(0)
}

fn is_head(output: &GatewayOutput) -> bool {
    matches!(
        output,
        Output::Persist {
            write: RecordWrite::Head { .. },
            ..
        }
    )
}

impl World {
    pub(super) fn start_gateway(&mut self) {
        self.gateway_runs += 1;
        if self.has(Canary::GatewayForgetsRecords) {
            self.records = MemoryRecords::default();
        }
        if self.has(Canary::GatewayLosesNewestHead) {
            for mc in &self.cell.mcs {
                self.records.tear_head(&mc.mc);
            }
        }
        let gateway = Gateway::new(
            &self.cell.model,
            &self.cell.gateway,
            self.boot_of(Pid::Gateway),
            self.gateway_runs,
            self.records.after_kill(),
            self.local(Pid::Gateway),
        );
        match gateway {
            Ok(gateway) => self.gateway = Some(gateway),
            Err(error) => self.defect(format!("the gateway does not start: {error}")),
        }
        self.see(&Seen::GatewayUp { restarted: true });
        self.carry_out_gateway();
    }

    pub(super) fn gateway_input(&mut self, input: GatewayInput) {
        let now = self.local(Pid::Gateway);
        if let Some(gateway) = &mut self.gateway {
            gateway.handle(input, now);
        }
        self.carry_out_gateway();
    }

    pub(super) fn gateway_message(&mut self, mut envelope: Envelope) {
        if let Message::Open(open) = &mut envelope.body {
            if open.force {
                self.forced.insert((open.mc.clone(), open.epoch));
            }
            if self.has(Canary::GatewayForcesOpens) {
                open.force = true;
            }
            if self.has(Canary::OrderDoubled) && self.grant_falsely(&envelope) {
                return;
            }
        }
        self.gateway_input(Input::Message(envelope));
    }

    pub(super) fn gateway_frame(&mut self, bytes: Arc<[u8]>) {
        if self.has(Canary::DeposedOwnerDrives) {
            self.let_through(&bytes);
        }
        self.gateway_input(Input::Local(GatewayLocal::Frame(bytes)));
    }

    /// The field has been read.
    pub(super) fn field(&mut self, boot: BootId) {
        if !self.is_this(Pid::Gateway, boot) {
            return;
        }
        let fresh = self.field_silent == 0;
        let inputs = self.field.read(&self.cell, fresh, self.now_us);
        self.gateway_input(Input::Local(GatewayLocal::Field(inputs)));
    }

    pub(super) fn carry_out_gateway(&mut self) {
        while let Some(output) = self.gateway.as_mut().and_then(Agent::poll_output) {
            let torn = self.gateway_tears && is_head(&output);
            if torn || self.is_doomed(Pid::Gateway) {
                self.gateway_tears = false;
                self.die_in(output, torn);
                return;
            }
            match output {
                Output::Persist { ticket, write } => {
                    let result = self.record(write);
                    let now = self.local(Pid::Gateway);
                    if let Some(gateway) = &mut self.gateway {
                        gateway.handle(Input::Persisted { ticket, result }, now);
                    }
                }
                Output::Send(envelope) => self.gateway_sends(envelope),
                Output::Act(act) => self.gateway_acts(act),
                Output::Event(event) => {
                    self.note(|| format!("gateway  EVENT {:?}: {}", event.kind, event.text));
                    let agent = AgentId::Gateway(self.cell.gateway.clone());
                    self.report(Pid::Gateway, agent, event);
                }
            }
        }
        self.arm(Pid::Gateway);
    }

    /// The process dies while it carries this out: a head may be written, half written or not.
    fn die_in(&mut self, output: GatewayOutput, torn: bool) {
        if let Output::Persist {
            write: RecordWrite::Head { mc, head },
            ..
        } = output
        {
            match if torn {
                1
            } else {
                self.dice(Pid::Gateway).below(3)
            } {
                0 => {}
                1 => {
                    let torn = mc.clone();
                    self.records.write(RecordWrite::Head { mc, head });
                    self.records.tear_head(&torn);
                    self.note(|| {
                        format!("gateway  dies in the middle of writing a head of {torn}")
                    });
                }
                _ => {
                    let _ = self.record(RecordWrite::Head { mc, head });
                    self.note(|| "gateway  dies with a head recorded and not applied".to_owned());
                }
            }
        }
        self.kill(Pid::Gateway);
    }

    fn record(&mut self, write: RecordWrite) -> Result<(), String> {
        let fails = self.gateway_disk_fails > 0 && write.is_synced();
        if fails && matches!(write, RecordWrite::Opened { .. }) {
            return Err("No space left on device".to_owned());
        }
        self.records.write(write.clone());
        match &write {
            RecordWrite::Head { mc, head } => self.see(&Seen::Recorded { mc, head }),
            RecordWrite::Changed { mc, ledger, .. } => match &ledger.state {
                RecordState::FailSafe => self.see(&Seen::Closed { mc, faulted: false }),
                RecordState::Faulted(_) => self.see(&Seen::Closed { mc, faulted: true }),
                _ => {}
            },
            RecordWrite::Opened { mc, ledger } => self.see(&Seen::Opened { mc, ledger }),
        }
        if fails {
            Err("No space left on device".to_owned())
        } else {
            Ok(())
        }
    }

    fn gateway_acts(&mut self, act: GatewayAct) {
        match act {
            GatewayAct::ReadField => {
                let at_us = self.now_us + self.dice(Pid::Gateway).between(80, 700);
                let boot = self.boot_of(Pid::Gateway);
                self.queue.push(at_us, Event::Field { boot });
            }
            GatewayAct::PublishImage(image) => {
                self.see(&Seen::Image(&image));
                self.transmit(Pid::Gateway, Pid::Manager, Packet::Image(image.clone()));
                for n in 0..self.nodes.len() {
                    let lost = worst(&self.lost_images, n);
                    if lost > 0 && self.dice(Pid::Node(n)).chance(lost) {
                        continue;
                    }
                    let packet = Packet::Image(image.clone());
                    match worst(&self.stale_images, n) {
                        0 => self.transmit(Pid::Gateway, Pid::Node(n), packet),
                        by_us => self.send_late(Pid::Gateway, Pid::Node(n), packet, by_us),
                    }
                }
            }
            GatewayAct::ApplyOutputs { mc, outputs, why } => {
                self.write_field(&mc, &outputs);
                self.outputs_applied(&mc, &outputs, why);
            }
            GatewayAct::Left => self.kill(Pid::Gateway),
        }
    }

    /// The gateway's one writer puts it on its way to the field.
    fn write_field(&mut self, mc: &McId, outputs: &Arc<[u8]>) {
        let Some(mc) = self.cell.index(mc) else {
            return;
        };
        let at_us = self.now_us + self.dice(Pid::Gateway).between(50, 400);
        self.field_busy_us = self.field_busy_us.max(at_us);
        let name = self.cell.mcs[mc].mc.clone();
        self.see(&Seen::WriteBegun {
            gateway: self.boot_of(Pid::Gateway),
            mc: &name,
            outputs,
        });
        let write = Event::Write {
            boot: self.boot_of(Pid::Gateway),
            mc,
            outputs: Arc::clone(outputs),
        };
        // The planted bug: somebody else writes it once more, in his own time.
        if self.has(Canary::TwoWriters) {
            let again = Event::Write {
                boot: self.boot_of(Pid::Gateway),
                mc,
                outputs: Arc::clone(outputs),
            };
            self.queue.push(at_us + 30_000, again);
        }
        self.queue.push(self.field_busy_us, write);
    }

    /// A write has reached the field.
    pub(super) fn written(&mut self, boot: BootId, mc: usize, outputs: &[u8]) {
        let name = self.cell.mcs[mc].mc.clone();
        self.see(&Seen::Written {
            gateway: boot,
            mc: &name,
            outputs,
        });
        let cell = self.cell.clone();
        if let Err(error) = self.field.write(&cell.mcs[mc], outputs, self.now_us) {
            self.defect(format!("the field refuses a write: {error}"));
        }
        if let Some((total, last)) = self.field.incidents() {
            self.see(&Seen::Plant {
                incidents: total,
                last: last.as_deref(),
            });
        }
    }

    fn outputs_applied(&mut self, mc: &McId, outputs: &Arc<[u8]>, why: Why) {
        match why {
            Why::Frame(applied) => {
                self.note(|| {
                    format!(
                        "field    {mc}: epoch {} scan {} of {} ({:?}{})",
                        applied.epoch,
                        applied.scan,
                        applied.owner.controller,
                        applied.phase,
                        if applied.released { ", released" } else { "" }
                    )
                });
                self.see(&Seen::Applied {
                    applied: &applied,
                    outputs,
                });
                if self.options.log {
                    self.applied.push(applied);
                }
            }
            Why::FailSafe => {
                self.note(|| format!("field    {mc}: fail-safe values"));
                self.deed("fail-safe");
                self.see(&Seen::FailSafe { mc });
            }
            Why::Kept => self.see(&Seen::Kept { mc, outputs }),
        }
    }

    fn gateway_sends(&mut self, mut envelope: Envelope) {
        let to = envelope.to.clone();
        if let Message::Opened(opened) = &mut envelope.body {
            if self.options.canary == Some(Canary::FailSafeForgotten) {
                opened.fail_safe = false;
            }
            if self.options.canary == Some(Canary::ResetForgotten) {
                opened.reset = None;
            }
            let gate = self.gateway.as_ref().and_then(|g| g.gate(&opened.mc));
            let owner = gate.and_then(|g| g.ledger().owner.clone());
            if let Some(owner) = owner {
                let before = self
                    .invariants
                    .facts()
                    .mcs
                    .get(&opened.mc)
                    .and_then(|mc| mc.grant.as_ref())
                    .map(|grant| grant.owner.clone());
                let opened = opened.clone();
                let first = before.as_ref() != Some(&owner);
                let seen = Seen::Granted {
                    force: self.forced.contains(&(opened.mc.clone(), opened.epoch)),
                    token_seen: before.is_some_and(|o| self.gateway_sees(&o)),
                    opened: &opened,
                    owner: &owner,
                };
                self.see(&seen);
                if first {
                    self.deed("owner changed");
                }
            }
        }
        let answer = matches!(envelope.body, Message::Opened(_) | Message::OpenRefused(_));
        if self.has(Canary::AnswersLost) && answer && self.now_us > ANSWERS_LOST_FROM_US {
            self.note(|| format!("gateway  loses its answer to {to}"));
            return;
        }
        self.send(Pid::Gateway, envelope);
    }

    fn gateway_sees(&self, owner: &Owner) -> bool {
        let node = self.cell.node(&owner.controller);
        let tokens = self.lives.get(&Pid::Gateway).map(|l| &l.tokens);
        node.zip(tokens)
            .is_some_and(|(n, tokens)| tokens.contains(&(Pid::Node(n), owner.boot)))
    }

    /// Planted bug: a frame of a deposed owner reaches the field.
    fn let_through(&mut self, bytes: &[u8]) {
        let Ok(frame) = decode_frame(bytes) else {
            return;
        };
        let header = &frame.header;
        let deposed = self
            .gateway
            .as_ref()
            .and_then(|g| g.gate(&header.mc))
            .is_some_and(|g| g.ledger().epoch > header.epoch);
        if deposed {
            let applied = Applied {
                mc: header.mc.clone(),
                epoch: header.epoch,
                owner: header.owner.clone(),
                scan: header.scan,
                digest: header.digest,
                base: header.base,
                phase: header.phase,
                released: false,
                at_us: self.now_us,
            };
            self.see(&Seen::Applied {
                applied: &applied,
                outputs: frame.outputs,
            });
        }
    }

    /// Planted bug: whoever asks for the epoch of a release gets it. Whether it was so.
    fn grant_falsely(&mut self, envelope: &Envelope) -> bool {
        let Message::Open(open) = &envelope.body else {
            return false;
        };
        let facts = self.invariants.facts().mcs.get(&open.mc);
        let ended = facts.and_then(|mc| mc.grant.as_ref()?.ended.clone());
        let Some(Ended::Released(to)) = ended else {
            return false;
        };
        let Some(gate) = self.gateway.as_ref().and_then(|g| g.gate(&open.mc)) else {
            return false;
        };
        if to.epoch != open.epoch || to.owner == open.owner {
            return false;
        }
        let mut opened = opening::answer(gate, open);
        opened.epoch = open.epoch;
        self.see(&Seen::Granted {
            opened: &opened,
            owner: &open.owner,
            force: false,
            token_seen: false,
        });
        true
    }
}
