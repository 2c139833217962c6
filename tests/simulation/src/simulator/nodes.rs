//! A controller node's process: its agents, its scan thread, its replicas, its sender thread.

use super::canary::Canary;
use super::cell::TICK_US;
use super::gateway::worst;
use super::logic::SimMc;
use super::network::Pid;
use super::world::{Event, Packet, World};
use crate::invariants::Seen;
use fam_agents::node::{McTotals, NodeAct, NodeAgents, NodeConfig, NodeLocal, NodeSample};
use fam_node_core::{
    ActiveMc, FrameEncoder, Replica, ReplicaOutcome, ScanCommand, ScanCore, ScanHost, ScannedFrame,
};
use fam_proto::access::{Activation, McAct, McNews, Start, StateSource};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::{AgentId, BootId, Checkpoint, InputImage, McId, Now, Owner, RecordState};
use std::collections::VecDeque;
use std::sync::Arc;

/// How often the agents get the newest counters, in microseconds.
const SAMPLE_US: u64 = 50_000;
/// Ticks that wake a little late, in a thousand.
const LATE_PERMILLE: u64 = 4;

/// What leaves a scan thread.
pub(super) enum ScanOut {
    Frame(Box<ScannedFrame>),
    News(usize, McNews),
    Returned(Box<ActiveMc<SimMc>>),
}

impl ScanOut {
    pub(super) fn kind(&self) -> u64 {
        match self {
            ScanOut::Frame(frame) => 1 ^ (frame.scan.0 << 2),
            ScanOut::News(mc, _) => 2 ^ ((*mc as u64) << 2),
            ScanOut::Returned(_) => 3,
        }
    }
}

/// What a node has in memory.
pub(super) struct NodeBody {
    pub agents: NodeAgents,
    owner: Owner,
    scan: ScanCore<SimMc>,
    replicas: Vec<Replica<SimMc>>,
    encoders: Vec<FrameEncoder>,
    commands: VecDeque<ScanCommand<SimMc>>,
    /// Its MCs, by their place in the cell.
    mcs: Vec<usize>,
    /// CPU time of a scan of each, on the reference controller.
    costs_ns: Vec<u64>,
    /// What a scan takes longer now.
    slow_ns: u64,
    cpu_ns: u64,
    next_tick: Now,
    sample_at: Now,
    /// Until when a slow scan keeps the scan thread busy.
    busy_until_us: u64,
    /// When the last of what the scan thread handed on arrives: its queues are in order.
    left_us: u64,
    overruns: u64,
}

/// The scan thread's surroundings.
struct Thread<'a> {
    cpu_ns: &'a mut u64,
    costs_ns: &'a [u64],
    slow_ns: u64,
    out: Vec<ScanOut>,
}

impl ScanHost<SimMc> for Thread<'_> {
    fn cpu_ns(&mut self) -> u64 {
        *self.cpu_ns
    }
    fn scanning(&mut self, mc: Option<usize>) {
        if let Some(cost_ns) = mc.and_then(|mc| self.costs_ns.get(mc)) {
            *self.cpu_ns += cost_ns + self.slow_ns;
        }
    }
    fn spend_ns(&mut self, _ns: u64) {}
    fn frame(&mut self, frame: ScannedFrame) {
        self.out.push(ScanOut::Frame(Box::new(frame)));
    }
    fn news(&mut self, mc: usize, news: McNews) {
        self.out.push(ScanOut::News(mc, news));
    }
    fn returned(&mut self, mc: Box<ActiveMc<SimMc>>) {
        self.out.push(ScanOut::Returned(mc));
    }
}

impl World {
    pub(super) fn start_node(&mut self, n: usize) {
        let pid = Pid::Node(n);
        let now = self.local(pid);
        let owner = Owner {
            controller: self.cell.controllers[n].clone(),
            boot: self.boot_of(pid),
        };
        let mcs: Vec<usize> = (0..self.cell.mcs.len())
            .filter(|mc| self.cell.mcs[*mc].hosts.contains(&n))
            .collect();
        let model = self.cell.model.controllers[n].clone();
        let other: Vec<usize> = self
            .versions
            .values()
            .filter(|(node, _)| *node == n)
            .map(|(_, mc)| *mc)
            .collect();
        let replicas = mcs.iter().enumerate().map(|(place, mc)| {
            let mut spec = if other.contains(mc) {
                self.cell.other_version(*mc, place).0
            } else {
                self.cell.spec(*mc, place)
            };
            if self.options.canary == Some(Canary::ReleaseAnywhere) {
                for interval in &mut spec.diagnosis.intervals {
                    interval.rows.clear();
                }
            }
            let runtime = self.cell.mcs[*mc].logic.instance();
            Replica::new(Arc::new(spec), owner.clone(), runtime)
        });
        let body = NodeBody {
            replicas: replicas.collect(),
            agents: NodeAgents::new(
                NodeConfig {
                    owner: owner.clone(),
                    mcs: mcs
                        .iter()
                        .map(|mc| {
                            if other.contains(mc) {
                                Arc::new(self.cell.other_version(*mc, 0).1)
                            } else {
                                self.cell.mcs[*mc].model.clone()
                            }
                        })
                        .collect(),
                    settings: self.cell.model.settings.clone(),
                    real_time: Vec::new(),
                    criteria: Vec::new(),
                    model: model.clone(),
                },
                now,
            ),
            scan: ScanCore::new(
                owner.clone(),
                model.tick_us,
                model.cpu_factor_permille,
                mcs.len(),
            ),
            encoders: mcs.iter().map(|_| FrameEncoder::new()).collect(),
            commands: VecDeque::new(),
            costs_ns: mcs.iter().map(|mc| self.cell.mcs[*mc].cpu_ns).collect(),
            slow_ns: 0,
            cpu_ns: 0,
            next_tick: now,
            sample_at: now,
            busy_until_us: 0,
            left_us: 0,
            overruns: 0,
            mcs,
            owner,
        };
        self.nodes[n] = Some(body);
        let phase_us = self.dice(pid).below(u64::from(TICK_US));
        let boot = self.boot_of(pid);
        self.queue
            .push(self.now_us + phase_us, Event::Tick { node: n, boot });
        self.carry_out_node(n);
    }

    pub(super) fn node_input(&mut self, n: usize, input: Input<NodeLocal>) {
        let now = self.local(Pid::Node(n));
        if let Some(node) = &mut self.nodes[n] {
            node.agents.handle(input, now);
        }
        self.carry_out_node(n);
    }

    pub(super) fn node_image(&mut self, n: usize, image: Arc<InputImage>) {
        let now = self.local(Pid::Node(n));
        if let Some(node) = &mut self.nodes[n] {
            let shown = if self.options.canary == Some(Canary::DeposedOwnerDrives) {
                Arc::new(node.blind(&image))
            } else {
                image.clone()
            };
            node.scan.image(shown.clone(), now);
            self.node_input(n, Input::Image(shown));
        }
    }

    /// A frame of an MC that this node hosts.
    pub(super) fn node_frame(&mut self, n: usize, mc: usize, bytes: &[u8]) {
        let Some(node) = &mut self.nodes[n] else {
            return;
        };
        let Some(place) = node.mcs.iter().position(|m| *m == mc) else {
            return;
        };
        let Some(seen) = node.replicas[place].frame(bytes) else {
            return;
        };
        let name = self.cell.mcs[mc].mc.clone();
        if let Ok(id) = seen.held {
            let held = NodeLocal::Held {
                mc: name.clone(),
                id,
            };
            self.node_input(n, Input::Local(held));
        }
        if let Some(to) = seen.released_to {
            let news = McNews::Handed(to);
            self.node_input(n, Input::Local(NodeLocal::Mc { mc: name, news }));
        }
    }

    /// A command for the scan thread: MCs whose predecessor was interrupted begin at once.
    pub(super) fn ring(&mut self, n: usize, boot: BootId) {
        let ring = Event::Ring { node: n, boot };
        self.run_scan_thread(n, boot, ring, NodeBody::between_ticks);
    }

    /// A tick of the scan thread.
    pub(super) fn tick(&mut self, n: usize, boot: BootId) {
        let tick = Event::Tick { node: n, boot };
        let Some(now) = self.run_scan_thread(n, boot, tick, NodeBody::tick) else {
            return;
        };
        let pid = Pid::Node(n);
        let Some(node) = &mut self.nodes[n] else {
            return;
        };
        let tick_us = u64::from(TICK_US);
        node.next_tick = node.next_tick.plus_us(tick_us);
        if node.next_tick <= now {
            // What was missed is not made up for.
            let missed = now.since_us(node.next_tick) / tick_us + 1;
            node.next_tick = node.next_tick.plus_us(missed * tick_us);
            node.overruns += 1;
        }
        let (next, sampled) = (node.next_tick, node.sample(now));
        if let Some(sample) = sampled {
            self.node_input(n, Input::Local(NodeLocal::Sample(sample)));
        }
        let late_us = worst(&self.late, n);
        let dice = self.dice(pid);
        let late_us = match late_us {
            0 if dice.chance(LATE_PERMILLE) => dice.below(8_000),
            0 => dice.below(120),
            late_us => dice.below(late_us),
        };
        let at_us = self.global(pid, next) + late_us;
        self.queue.push(at_us, Event::Tick { node: n, boot });
    }

    /// Runs the scan thread, unless a slow scan still keeps it busy: then the event comes again when that ends. What it has for
    /// others reaches them a moment later, in order. Gives the node's clock if it ran.
    fn run_scan_thread(
        &mut self,
        n: usize,
        boot: BootId,
        event: Event,
        run: fn(&mut NodeBody, Now) -> Vec<ScanOut>,
    ) -> Option<Now> {
        let pid = Pid::Node(n);
        if !self.is_this(pid, boot) {
            return None;
        }
        let (now, now_us) = (self.local(pid), self.now_us);
        let slow_us = worst(&self.slow, n);
        let handed_on_us = self.dice(pid).between(15, 400);
        let node = self.nodes[n].as_mut()?;
        if node.busy_until_us > now_us {
            self.queue.push(node.busy_until_us, event);
            return None;
        }
        node.slow_ns = slow_us * 1_000;
        let out = run(node, now);
        let scans = out.iter().filter(|o| matches!(o, ScanOut::Frame(_)));
        node.busy_until_us = now_us + slow_us * scans.count() as u64;
        node.left_us = node.left_us.max(node.busy_until_us + handed_on_us);
        let left_us = node.left_us;
        for out in out {
            if let ScanOut::Frame(frame) = &out {
                let seen = Seen::Scanned(frame);
                self.invariants.see(&seen, self.now_us);
            }
            let inner = Event::Inner { node: n, boot, out };
            self.queue.push(left_us, inner);
        }
        Some(now)
    }

    /// What the scan thread has handed on reaches the node's other threads.
    pub(super) fn inner(&mut self, n: usize, boot: BootId, out: ScanOut) {
        let pid = Pid::Node(n);
        if !self.is_this(pid, boot) {
            return;
        }
        let now = self.local(pid);
        let Some(node) = &mut self.nodes[n] else {
            return;
        };
        match out {
            ScanOut::Frame(frame) => {
                let place = frame.spec.index;
                let mc = node.mcs[place];
                match node.encoders[place].encode(&frame, now) {
                    Ok(encoded) => self.publish(n, mc, encoded.bytes.into()),
                    Err(error) => self.defect(format!("a frame cannot be encoded: {error}")),
                }
            }
            ScanOut::News(place, news) => {
                let mc = self.cell.mcs[node.mcs[place]].mc.clone();
                let owner = node.owner.clone();
                self.note(|| format!("{pid:<8} {mc}: {news:?}"));
                if let McNews::Trapped { epoch, .. } = &news {
                    self.see(&Seen::Trapped {
                        mc: &mc,
                        owner: &owner,
                        epoch: *epoch,
                    });
                }
                self.node_input(n, Input::Local(NodeLocal::Mc { mc, news }));
            }
            ScanOut::Returned(active) => {
                let place = active.spec().index;
                node.encoders[place].clear();
                let outcome = node.replicas[place].returned(active);
                self.outcome(n, place, outcome);
            }
        }
    }

    fn publish(&mut self, n: usize, mc: usize, bytes: Arc<[u8]>) {
        let from = Pid::Node(n);
        let packet = Packet::Frame(mc, bytes);
        self.transmit(from, Pid::Gateway, packet.clone());
        let hosts = self.cell.mcs[mc].hosts.clone();
        for host in hosts.into_iter().filter(|host| *host != n) {
            let lost = worst(&self.lost_frames, host);
            if lost > 0 && self.dice(Pid::Node(host)).chance(lost) {
                continue;
            }
            self.transmit(from, Pid::Node(host), packet.clone());
        }
    }

    pub(super) fn carry_out_node(&mut self, n: usize) {
        let pid = Pid::Node(n);
        while let Some(output) = self.nodes[n]
            .as_mut()
            .and_then(|node| node.agents.poll_output())
        {
            if self.is_doomed(pid) {
                self.kill(pid);
                return;
            }
            match output {
                Output::Persist { write, .. } => match write {},
                Output::Send(envelope) => self.send(pid, envelope),
                Output::Act(NodeAct::Mc { mc, act }) => self.act(n, &mc, act),
                // The files of a simulated cell do not change while it runs.
                Output::Act(NodeAct::Stage { .. } | NodeAct::Renewed { .. }) => {}
                Output::Act(NodeAct::Leave { left }) => {
                    self.note(|| format!("{pid:<8} leaves, left behind: {left:?}"));
                    self.deed("left");
                    self.kill(pid);
                    return;
                }
                Output::Event(event) => {
                    self.note(|| format!("{pid:<8} EVENT {:?}: {}", event.kind, event.text));
                    let agent = AgentId::Controller(self.cell.controllers[n].clone());
                    self.report(pid, agent, event);
                }
            }
        }
        self.arm(pid);
    }

    fn act(&mut self, n: usize, mc: &McId, mut act: McAct) {
        let Some(index) = self.cell.index(mc) else {
            return;
        };
        self.note(|| format!("{:<8} {mc}: {}", Pid::Node(n), act_words(&act)));
        if let McAct::Activate(activation) = &mut act {
            self.plant_bug(mc, activation);
        }
        if let McAct::RunAction { action, .. } = &mut act
            && self.has(Canary::TrapPassedOn)
        {
            *action = 0; // normal logic goes on, and what made it trap is over
            self.field.traps.clear();
        }
        let Some(node) = &mut self.nodes[n] else {
            return;
        };
        let Some(place) = node.mcs.iter().position(|m| *m == index) else {
            return;
        };
        if let McAct::RunAction { epoch, .. } = act {
            let owner = &node.owner;
            let seen = Seen::Diverted { mc, owner, epoch };
            self.invariants.see(&seen, self.now_us);
        }
        let outcome = node.replicas[place].act(act);
        self.outcome(n, place, outcome);
    }

    fn outcome(&mut self, n: usize, place: usize, outcome: ReplicaOutcome<SimMc>) {
        let Some(node) = &mut self.nodes[n] else {
            return;
        };
        match outcome {
            ReplicaOutcome::Nothing => {}
            ReplicaOutcome::News(news) => {
                let mc = self.cell.mcs[node.mcs[place]].mc.clone();
                self.node_input(n, Input::Local(NodeLocal::Mc { mc, news }));
            }
            ReplicaOutcome::Activate(active) => {
                node.commands.push_back(ScanCommand::Activate(active));
                let boot = node.owner.boot;
                let at_us = self.now_us + self.dice(Pid::Node(n)).between(10, 300);
                self.queue.push(at_us, Event::Ring { node: n, boot });
            }
            ReplicaOutcome::PassOn(act) => {
                node.commands.push_back(ScanCommand::Act { mc: place, act });
            }
        }
    }

    /// Planted bugs in how an epoch begins.
    fn plant_bug(&self, mc: &McId, activation: &mut Activation) {
        let facts = self.invariants.facts().mcs.get(mc);
        let Some(facts) = facts else {
            return;
        };
        let of = |head: &crate::invariants::HeadFact| Checkpoint {
            id: head.id,
            layout: facts.model.layout,
            mc_time_us: head.mc_time_us,
            phase: head.phase,
            image: head.image,
            state: head.state.as_ref().clone(),
        };
        let own = activation.base.and_then(|id| facts.head_of(id)).map(of);
        let given = match (self.options.canary, own) {
            (Some(Canary::StaleStart), Some(_)) => facts.before.as_ref().map(of),
            (Some(Canary::McTimeRestarts), Some(checkpoint)) => Some(Checkpoint {
                mc_time_us: 0,
                ..checkpoint
            }),
            (Some(Canary::OldInputs), Some(checkpoint)) => Some(Checkpoint {
                image: fam_proto::ImageNumber(0),
                ..checkpoint
            }),
            (Some(Canary::StartsCold), _) => {
                activation.start = Start::Initial;
                activation.recovery = 0;
                None
            }
            (Some(Canary::RecoverySkipped), _) => {
                activation.recovery = 0;
                None
            }
            _ => None,
        };
        if let (Some(checkpoint), Start::From { source, .. }) = (given, &mut activation.start) {
            *source = StateSource::Given(Arc::new(checkpoint));
        }
    }
}

impl NodeBody {
    fn tick(&mut self, now: Now) -> Vec<ScanOut> {
        self.scan_thread(now, |core, now, thread| core.tick(now, thread))
    }

    fn between_ticks(&mut self, now: Now) -> Vec<ScanOut> {
        self.scan_thread(now, |core, now, thread| core.start_at_once(now, thread))
    }

    /// The scan thread takes what has come, then does this.
    fn scan_thread(
        &mut self,
        now: Now,
        run: impl FnOnce(&mut ScanCore<SimMc>, Now, &mut Thread<'_>),
    ) -> Vec<ScanOut> {
        let mut thread = Thread {
            cpu_ns: &mut self.cpu_ns,
            costs_ns: &self.costs_ns,
            slow_ns: self.slow_ns,
            out: Vec::new(),
        };
        while let Some(command) = self.commands.pop_front() {
            self.scan.command(command, now, &mut thread);
        }
        run(&mut self.scan, now, &mut thread);
        thread.out
    }

    fn sample(&mut self, now: Now) -> Option<NodeSample> {
        if now < self.sample_at {
            return None;
        }
        self.sample_at = now.plus_us(SAMPLE_US);
        let mcs = self.scan.loads(now).map(|(place, _, work, lag_us)| {
            let spec = self.replicas[place].spec();
            McTotals {
                mc: spec.mc.clone(),
                cycle_us: spec.cycle_us,
                scans: work.scans,
                cpu_ns: work.cpu_ns,
                worst_us: u32::try_from(work.worst_ns() / 1_000).unwrap_or(u32::MAX),
                lag_us,
            }
        });
        Some(NodeSample {
            mcs: mcs.collect(),
            overruns: self.overruns,
            ..NodeSample::default()
        })
    }

    /// Whether an instance is passive here and holds a checkpoint.
    pub(super) fn holds(&self, mc: usize) -> bool {
        let place = self.mcs.iter().position(|m| *m == mc);
        let replica = place.map(|place| &self.replicas[place]);
        replica.is_some_and(|r| r.runtime().is_some() && r.held().is_some())
    }

    /// The replica of an MC forgets all that it holds.
    pub(super) fn wipe(&mut self, mc: usize, runtime: SimMc) {
        if let Some(place) = self.mcs.iter().position(|m| *m == mc) {
            let spec = self.replicas[place].spec().clone();
            self.replicas[place] = Replica::new(spec, self.owner.clone(), runtime);
        }
    }

    /// Planted bug: an image that shows this node as the owner of all that it runs.
    fn blind(&self, image: &InputImage) -> InputImage {
        let mut image = image.clone();
        for record in &mut image.records {
            let place = self.replicas.iter().position(|r| r.spec().mc == record.mc);
            let epoch = place
                .and_then(|place| self.scan.active(place))
                .map(ActiveMc::epoch);
            if let Some(epoch) = epoch
                && record.epoch > epoch
            {
                record.epoch = epoch;
                record.owner = Some(self.owner.clone());
                record.state = RecordState::Open;
                record.head = None;
            }
        }
        image
    }
}

fn act_words(act: &McAct) -> String {
    match act {
        McAct::Activate(a) => format!(
            "activate epoch {} from {:?} with recovery {}{}",
            a.epoch,
            a.base.map(|b| (b.epoch.0, b.scan.0)),
            a.recovery,
            if a.keep_action { " going on" } else { "" }
        ),
        other => format!("{other:?}"),
    }
}
