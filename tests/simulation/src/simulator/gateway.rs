//! The gateway's process: its core, its record file, the field.

use super::canary::Canary;
use super::network::Pid;
use super::world::{Event, Packet, World};
use crate::invariants::{Ended, Seen};
use fam_gateway_core::{
    Gateway, GatewayAct, GatewayInput, GatewayLocal, MemoryRecords, RecordWrite, Why, opening,
};
use fam_node_core::model_mc::INPUTS_LEN;
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{
    AgentId, Applied, BootId, Envelope, McInputs, Message, Owner, RecordState, decode_frame,
};
use std::sync::Arc;

/// When answers begin to get lost, with the planted bug.
const ANSWERS_LOST_FROM_US: u64 = 700_000;

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
        self.plant.reads += 1;
        let fresh = self.field_silent == 0;
        let inputs = self.cell.mcs.iter().enumerate().map(|(n, mc)| {
            let mut bytes = vec![0; INPUTS_LEN];
            let value = self.plant.reads.wrapping_mul(7) + n as u64;
            bytes[0] = u8::try_from(value % 200).unwrap_or(0);
            bytes[1] = u8::try_from(value / 200 % 256).unwrap_or(0);
            if let Some(trap) = self.plant.traps.get(&n) {
                bytes[0] = *trap;
            }
            McInputs {
                mc: mc.mc.clone(),
                bytes,
                fresh,
            }
        });
        let inputs = inputs.collect();
        self.gateway_input(Input::Local(GatewayLocal::Field(inputs)));
    }

    pub(super) fn carry_out_gateway(&mut self) {
        while let Some(output) = self.gateway.as_mut().and_then(Agent::poll_output) {
            if self.is_doomed(Pid::Gateway) {
                self.die_in(output);
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
    fn die_in(&mut self, output: fam_gateway_core::GatewayOutput) {
        if let Output::Persist {
            write: RecordWrite::Head { mc, head },
            ..
        } = output
        {
            match self.random.below(3) {
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
            RecordWrite::Opened { .. } => {}
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
                let at_us = self.now_us + self.random.between(80, 700);
                let boot = self.boot_of(Pid::Gateway);
                self.queue.push(at_us, Event::Field { boot });
            }
            GatewayAct::PublishImage(image) => {
                self.see(&Seen::Image(&image));
                self.transmit(Pid::Gateway, Pid::Manager, Packet::Image(image.clone()));
                for n in 0..self.nodes.len() {
                    let faults = self.lost_images.values().filter(|(node, _)| *node == n);
                    let lost = faults.map(|(_, permille)| *permille).max().unwrap_or(0);
                    if !self.random.chance(lost) {
                        self.transmit(Pid::Gateway, Pid::Node(n), Packet::Image(image.clone()));
                    }
                }
            }
            GatewayAct::ApplyOutputs { mc, outputs, why } => match why {
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
                        outputs: &outputs,
                    });
                    if self.options.log {
                        self.applied.push(applied);
                    }
                }
                Why::FailSafe => {
                    self.note(|| format!("field    {mc}: fail-safe values"));
                    self.deed("fail-safe");
                    self.see(&Seen::FailSafe { mc: &mc });
                }
                Why::Kept => {}
            },
            GatewayAct::Left => self.kill(Pid::Gateway),
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
