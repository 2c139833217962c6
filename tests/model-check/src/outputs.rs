//! What processes put out, carried out in its order: writes, messages, outputs to the field, images.

use crate::properties::{ONE_DRIVER, Violation};
use crate::state::{Body, Bug, Pid};
use crate::step::Run;
use fam_agents::node::NodeAct;
use fam_gateway_core::{GatewayAct, GatewayLocal, RecordWrite, Why};
use fam_proto::access::{McAct, Start, StateSource};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{
    AgentId, BootId, Envelope, Epoch, InputImage, Message, OrderKind, RecordState, RepoWrite,
};
use std::sync::Arc;

impl Run<'_> {
    fn dies(&mut self, pid: Pid) -> bool {
        match &mut self.dies_after {
            Some((dying, left)) if *dying == pid => {
                if *left == 0 {
                    return true;
                }
                *left -= 1;
                false
            }
            _ => false,
        }
    }

    pub(crate) fn carry_out(&mut self, pid: Pid) -> Result<(), Violation> {
        match pid {
            Pid::Manager => self.carry_out_manager(),
            Pid::Gateway => self.carry_out_gateway(),
            Pid::Node(n) => self.carry_out_node(n),
        }
    }

    fn carry_out_manager(&mut self) -> Result<(), Violation> {
        loop {
            let mut output = None;
            self.change(Pid::Manager, |process| {
                if let Body::Manager(agents) = &mut process.body {
                    output = agents.poll_output();
                }
            });
            let Some(output) = output else { return Ok(()) };
            match output {
                // The history and what is only remembered for people: nothing hangs on it.
                Output::Persist {
                    ticket,
                    write: RepoWrite::Event(_) | RepoWrite::Registered(_),
                } => self.manager_persisted(ticket),
                Output::Act(_) | Output::Event(_) => {}
                Output::Persist { ticket, write } => {
                    if self.dies(Pid::Manager) {
                        return Ok(());
                    }
                    Arc::make_mut(&mut self.state.repository).apply(&write);
                    self.manager_persisted(ticket);
                }
                Output::Send(envelope) => {
                    if self.dies(Pid::Manager) {
                        return Ok(());
                    }
                    self.ordered(&envelope)?;
                    self.send(Pid::Manager, envelope);
                }
            }
        }
    }

    fn manager_persisted(&mut self, ticket: u64) {
        self.change(Pid::Manager, |process| {
            let now = process.now;
            if let Body::Manager(agents) = &mut process.body {
                let result = Ok(());
                agents.handle(Input::Persisted { ticket, result }, now);
            }
        });
    }

    fn ordered(&mut self, envelope: &Envelope) -> Result<(), Violation> {
        let (Message::Order(order), AgentId::Component(to, _)) = (&envelope.body, &envelope.to)
        else {
            return Ok(());
        };
        let OrderKind::Activate { epoch, .. } = order.kind else {
            return Ok(());
        };
        let durable = self.state.repository.epochs.get(&order.mc).copied();
        let owner = fam_proto::Owner {
            controller: to.clone(),
            boot: BootId(0),
        };
        let durable = durable.unwrap_or(Epoch(0));
        let new = Arc::make_mut(&mut self.state.facts).ordered(epoch, &owner, durable)?;
        self.state.activations = self.state.activations.saturating_add(u8::from(new));
        Ok(())
    }

    fn carry_out_gateway(&mut self) -> Result<(), Violation> {
        loop {
            let mut output = None;
            self.change(Pid::Gateway, |process| {
                if let Body::Gateway(gateway) = &mut process.body {
                    output = gateway.poll_output();
                }
            });
            let Some(output) = output else { return Ok(()) };
            match output {
                Output::Act(GatewayAct::ReadField) => {
                    self.gateway_local(GatewayLocal::Field(vec![]))
                }
                Output::Act(GatewayAct::PublishImage(image)) => self.publish(&image)?,
                Output::Event(_) | Output::Act(GatewayAct::Left) => {}
                Output::Persist { ticket, write } => {
                    if self.dies(Pid::Gateway) {
                        return Ok(());
                    }
                    self.record(ticket, write)?;
                }
                Output::Act(GatewayAct::ApplyOutputs { why, .. }) => {
                    if self.dies(Pid::Gateway) {
                        return Ok(());
                    }
                    self.apply(&why)?;
                }
                Output::Send(envelope) => {
                    if self.dies(Pid::Gateway) {
                        return Ok(());
                    }
                    self.send(Pid::Gateway, envelope);
                }
            }
        }
    }

    fn gateway_local(&mut self, local: GatewayLocal) {
        self.change(Pid::Gateway, |process| {
            let now = process.now;
            if let Body::Gateway(gateway) = &mut process.body {
                gateway.handle(Input::Local(local), now);
            }
        });
    }

    fn record(&mut self, ticket: u64, write: RecordWrite) -> Result<(), Violation> {
        if let RecordWrite::Opened { ledger, .. } = &write
            && let Some(owner) = &ledger.owner
        {
            let healthy = self.owner_is_healthy();
            let facts = Arc::make_mut(&mut self.state.facts);
            facts.granted(ledger.epoch, owner, ledger.base, healthy, false)?;
        }
        if let RecordWrite::Head { head, .. } = &write {
            // Recorded is as good as applied: a gateway that dies now is started again from it.
            let frame = fam_proto::Applied {
                mc: self.cell().mc.clone(),
                epoch: head.meta.id.epoch,
                owner: self.head_owner(),
                scan: head.meta.id.scan,
                digest: head.meta.id.digest,
                base: self.state.facts.base,
                phase: head.meta.phase,
                released: false,
                at_us: 0,
            };
            let facts = Arc::make_mut(&mut self.state.facts);
            facts.applied(&frame, &head.state)?;
        }
        Arc::make_mut(&mut self.state.records).write(write);
        self.change(Pid::Gateway, |process| {
            let now = process.now;
            if let Body::Gateway(gateway) = &mut process.body {
                let result = Ok(());
                gateway.handle(Input::Persisted { ticket, result }, now);
            }
        });
        Ok(())
    }

    fn head_owner(&self) -> fam_proto::Owner {
        let gate = self.gate(|gate| gate.ledger().owner.clone()).flatten();
        gate.unwrap_or_else(|| self.cell().owner(0, BootId(0)))
    }

    pub(crate) fn gate<T>(
        &self,
        look: impl FnOnce(&fam_gateway_core::gate::Gate) -> T,
    ) -> Option<T> {
        let gateway = self.state.gateway()?;
        gateway.gate(&self.cell().mc).map(look)
    }

    /// The owner of before drives in time, and the gateway has heard of its life and of no end of it.
    fn owner_is_healthy(&self) -> bool {
        let Some(process) = self.state.process(Pid::Gateway) else {
            return false;
        };
        let now = process.now;
        let fresh_us = 3 * u64::from(self.cell().model.mcs[0].cycle_us);
        let owner = self.gate(|gate| {
            let open = gate.ledger().state == RecordState::Open;
            let fresh = gate.silent_us(now) <= fresh_us;
            gate.ledger().owner.clone().filter(|_| open && fresh)
        });
        let Some(owner) = owner.flatten() else {
            return false;
        };
        let node = self
            .cell()
            .controllers
            .iter()
            .position(|c| *c == owner.controller);
        node.is_some_and(|n| process.tokens.contains(&(Pid::Node(n), owner.boot)))
    }

    fn apply(&mut self, why: &Why) -> Result<(), Violation> {
        let Why::Frame(applied) = why else {
            return Ok(());
        };
        // The record came first: what is applied is what was recorded last.
        let recorded = self.state.facts.applied == Some(applied.checkpoint_id())
            && self.state.facts.grant == Some((applied.epoch, applied.owner.clone()))
            && (self.state.facts.base == applied.base || applied.base.is_none());
        if recorded {
            return Ok(());
        }
        Err(Violation {
            property: ONE_DRIVER,
            text: format!(
                "scan {} of epoch {} is applied, and was not recorded as the head",
                applied.scan, applied.epoch
            ),
        })
    }

    /// An image goes out to all. One that says nothing new of the record comes at once, for it could as well have come later;
    /// one that does takes its time, and is overtaken by the next.
    fn publish(&mut self, image: &InputImage) -> Result<(), Violation> {
        let mut image = image.clone();
        // What only people look at, and ages in classes: fresh, stale, suspect.
        image.sent_at_us = 0;
        let cycle_us = u64::from(self.cell().model.mcs[0].cycle_us);
        let suspect_us = self.cell().model.mcs[0].suspect_us;
        for record in &mut image.records {
            record.rejected = 0;
            // An acknowledgement is for deltas, which are not modelled.
            (record.head, record.phase) = (None, None);
            record.silent_us = match record.silent_us {
                us if us <= 3 * cycle_us => 0,
                us if us <= suspect_us => 3 * cycle_us + 1,
                _ => suspect_us + 1,
            };
        }
        let image = Arc::new(image);
        for pid in [Pid::Manager, Pid::Node(0), Pid::Node(1)] {
            let Some(process) = self.state.process(pid) else {
                continue;
            };
            if !self.state.connected(Pid::Gateway, pid) {
                continue;
            }
            // A scan thread takes an image as soon as it comes.
            let at_once = match &process.body {
                Body::Manager(agents) => {
                    let view = agents.view().mcs.get(&self.cell().mc);
                    let up = agents.view().gateways.values().all(|g| g.is_up());
                    let known = view.and_then(|v| v.record.as_ref()) == image.records.first();
                    up && known && self.state.image.is_none()
                }
                Body::Node(..) => true,
                Body::Gateway(_) => false,
            };
            if at_once {
                self.image(pid, Arc::clone(&image))?;
            } else {
                self.state.image = Some(Arc::clone(&image));
            }
        }
        Ok(())
    }

    fn carry_out_node(&mut self, n: usize) -> Result<(), Violation> {
        let pid = Pid::Node(n);
        loop {
            let mut output = None;
            self.change(pid, |process| {
                if let Body::Node(agents, ..) = &mut process.body {
                    output = agents.poll_output();
                }
            });
            match output {
                None => return Ok(()),
                Some(Output::Persist { write, .. }) => match write {},
                Some(Output::Send(envelope)) => self.send(pid, envelope),
                Some(
                    Output::Event(_)
                    | Output::Act(
                        NodeAct::Leave { .. } | NodeAct::Stage { .. } | NodeAct::Renewed { .. },
                    ),
                ) => {}
                Some(Output::Act(NodeAct::Mc { mut act, .. })) => {
                    if self.world.bug == Some(Bug::StaleStart) {
                        self.make_stale(pid, &mut act);
                    }
                    let mut news = None;
                    self.change(pid, |process| {
                        if let Body::Node(_, plc) = &mut process.body {
                            news = plc.act(act);
                        }
                    });
                    self.news(pid, news)?;
                }
            }
        }
    }

    /// Planted bug: whatever is held here is as good as what was granted.
    fn make_stale(&self, pid: Pid, act: &mut McAct) {
        if let McAct::Activate(activation) = act
            && let Some(process) = self.state.process(pid)
            && let Body::Node(_, plc) = &process.body
            && let Some(held) = &plc.held
            && let Start::From { source, .. } = &mut activation.start
        {
            *source = StateSource::Given(Arc::clone(&held.0));
        }
    }
}
