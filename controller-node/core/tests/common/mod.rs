//! A node of one or two model MCs without threads, and a gateway that believes every frame.
#![allow(dead_code)] // each test file uses its own part

use fam_node_core::model_mc::{INPUTS_LEN, ModelMc, OUTPUTS_LEN};
use fam_node_core::replica::FrameRefusal;
use fam_node_core::{
    ActiveMc, FrameEncoder, McRuntime, McSpec, Replica, ReplicaOutcome, ScanCommand, ScanCore,
    ScanHost, ScannedFrame,
};
use fam_proto::access::{Activation, McAct, McNews, Start, StateSource};
use fam_proto::*;
use std::collections::VecDeque;
use std::sync::Arc;

pub const TICK_US: u64 = 5_000;

pub fn owner(name: &str) -> Owner {
    Owner {
        controller: ControllerId::new(name).unwrap(),
        boot: BootId(1),
    }
}

pub fn gateway_id() -> GatewayId {
    GatewayId::new("gateway1").unwrap()
}

pub fn mc_id(index: usize) -> McId {
    McId::new(&format!("Model{index}")).unwrap()
}

pub struct Host<R> {
    pub frames: VecDeque<ScannedFrame>,
    pub news: Vec<(usize, McNews)>,
    pub returned: Vec<Box<ActiveMc<R>>>,
    pub cpu_ns: u64,
    pub spent_ns: u64,
}

impl<R> Default for Host<R> {
    fn default() -> Self {
        Host {
            frames: VecDeque::new(),
            news: Vec::new(),
            returned: Vec::new(),
            cpu_ns: 0,
            spent_ns: 0,
        }
    }
}

impl<R> ScanHost<R> for Host<R> {
    fn cpu_ns(&mut self) -> u64 {
        self.cpu_ns += 100_000;
        self.cpu_ns
    }
    fn scanning(&mut self, _: Option<usize>) {}
    fn spend_ns(&mut self, ns: u64) {
        self.spent_ns += ns;
    }
    fn frame(&mut self, frame: ScannedFrame) {
        self.frames.push_back(frame);
    }
    fn news(&mut self, mc: usize, news: McNews) {
        self.news.push((mc, news));
    }
    fn returned(&mut self, mc: Box<ActiveMc<R>>) {
        self.returned.push(mc);
    }
}

/// One node.
pub struct Node<R> {
    pub owner: Owner,
    pub core: ScanCore<R>,
    pub replicas: Vec<Replica<R>>,
    pub encoders: Vec<FrameEncoder>,
    pub host: Host<R>,
    pub full: usize,
    pub delta: usize,
}

pub fn model_node(name: &str, padding: usize) -> Node<ModelMc> {
    let mcs = (0..2).map(|index| {
        let spec = ModelMc::spec(index, mc_id(index), gateway_id(), TICK_US as u32, padding);
        (Arc::new(spec), ModelMc::new(padding))
    });
    Node::new(name, mcs.collect())
}

impl<R: McRuntime> Node<R> {
    pub fn new(name: &str, mcs: Vec<(Arc<McSpec>, R)>) -> Node<R> {
        let owner = owner(name);
        for (spec, _) in &mcs {
            spec.check().unwrap();
        }
        Node {
            core: ScanCore::new(owner.clone(), TICK_US as u32, 1_000, mcs.len()),
            encoders: mcs.iter().map(|_| FrameEncoder::new()).collect(),
            replicas: mcs
                .into_iter()
                .map(|(spec, runtime)| Replica::new(spec, owner.clone(), runtime))
                .collect(),
            owner,
            host: Host::default(),
            full: 0,
            delta: 0,
        }
    }

    pub fn act(&mut self, mc: usize, act: McAct, now: Now) {
        let outcome = self.replicas[mc].act(act);
        self.outcome(mc, outcome, now);
    }

    fn outcome(&mut self, mc: usize, outcome: ReplicaOutcome<R>, now: Now) {
        match outcome {
            ReplicaOutcome::Nothing => {}
            ReplicaOutcome::News(news) => self.host.news.push((mc, news)),
            ReplicaOutcome::Activate(active) => {
                self.core
                    .command(ScanCommand::Activate(active), now, &mut self.host);
            }
            ReplicaOutcome::PassOn(act) => {
                self.core
                    .command(ScanCommand::Act { mc, act }, now, &mut self.host);
            }
        }
        self.take_back(now);
    }

    fn take_back(&mut self, now: Now) {
        while let Some(active) = self.host.returned.pop() {
            let mc = active.spec().index;
            let outcome = self.replicas[mc].returned(active);
            self.outcome(mc, outcome, now);
        }
    }

    pub fn tick(&mut self, now: Now) {
        self.core.tick(now, &mut self.host);
        self.take_back(now);
    }

    /// Frames of this tick as they go over the wire.
    pub fn sent(&mut self, now: Now) -> Vec<Vec<u8>> {
        let mut sent = Vec::new();
        while let Some(frame) = self.host.frames.pop_front() {
            let encoded = self.encoders[frame.spec.index].encode(&frame, now).unwrap();
            if encoded.full {
                self.full += 1;
            } else {
                self.delta += 1;
            }
            sent.push(encoded.bytes);
        }
        sent
    }

    pub fn news(&mut self) -> Vec<McNews> {
        std::mem::take(&mut self.host.news)
            .into_iter()
            .map(|(_, n)| n)
            .collect()
    }
}

/// One MC's record and head.
pub struct Line {
    pub record: RecordSummary,
    pub head: Option<Checkpoint>,
    pub outputs: Vec<u8>,
    kept: VecDeque<Checkpoint>,
    pub applied: Vec<FrameHeader>,
}

pub struct Gateway {
    pub number: u64,
    pub inputs: Vec<Vec<u8>>,
    pub fresh: bool,
    pub lines: Vec<Line>,
}

impl Gateway {
    /// For these MCs, with their input images and the outputs that stand at the field.
    pub fn new(mcs: Vec<(McId, Vec<u8>, Vec<u8>)>) -> Gateway {
        let line = |(mc, _, outputs): &(McId, Vec<u8>, Vec<u8>)| Line {
            record: RecordSummary {
                mc: mc.clone(),
                epoch: Epoch(0),
                owner: None,
                state: RecordState::Never,
                head: None,
                phase: None,
                driven: false,
                silent_us: 0,
                suspect: false,
                rejected: 0,
            },
            head: None,
            outputs: outputs.clone(),
            kept: VecDeque::new(),
            applied: Vec::new(),
        };
        Gateway {
            number: 1,
            fresh: true,
            lines: mcs.iter().map(line).collect(),
            inputs: mcs.into_iter().map(|(_, inputs, _)| inputs).collect(),
        }
    }

    pub fn image(&mut self) -> Arc<InputImage> {
        self.number += 1;
        let inputs = self
            .inputs
            .iter()
            .zip(&self.lines)
            .map(|(bytes, line)| McInputs {
                mc: line.record.mc.clone(),
                bytes: bytes.clone(),
                fresh: self.fresh,
            });
        Arc::new(InputImage {
            gateway: gateway_id(),
            boot: BootId(1),
            number: ImageNumber(self.number),
            sent_at_us: 0,
            inputs: inputs.collect(),
            records: self.lines.iter().map(|l| l.record.clone()).collect(),
            exports: Vec::new(),
        })
    }

    /// Opens the next epoch for a node, and gives what its agent would hand to the MC.
    pub fn open(&mut self, mc: usize, owner: &Owner) -> Activation {
        let line = &mut self.lines[mc];
        line.record.epoch = line.record.epoch.next();
        line.record.owner = Some(owner.clone());
        line.record.state = RecordState::Open;
        line.record.driven = false;
        let start = line
            .head
            .clone()
            .map_or(Start::Initial, |head| Start::From {
                source: StateSource::Given(Arc::new(head)),
                retained_only: false,
            });
        Activation {
            epoch: line.record.epoch,
            base: line.head.as_ref().map(|h| h.id),
            start,
            recovery: 0,
            keep_action: false,
            outputs: line.outputs.clone(),
            next_scan: line.record.scan().next(),
            at_once: false,
            renew: None,
        }
    }

    /// Takes a frame as the fence and the chain would; the checkpoint that was applied.
    pub fn frame(&mut self, bytes: &[u8]) -> Checkpoint {
        let view = decode_frame(bytes).unwrap();
        let h = &view.header;
        let line = self.lines.iter_mut().find(|l| l.record.mc == h.mc).unwrap();
        assert_eq!(
            (h.epoch, Some(&h.owner)),
            (line.record.epoch, line.record.owner.as_ref())
        );
        if !line.record.driven {
            assert_eq!(h.base, line.record.head, "the first frame names its base");
        }
        let state = match h.content {
            Content::Full => view.content.to_vec(),
            Content::Delta(base) => {
                let old = line.kept.iter().find(|c| c.id == base).expect("base held");
                let mut state = old.state.clone();
                delta::apply(&mut state, view.content).unwrap();
                state
            }
        };
        let checkpoint = Checkpoint {
            id: h.checkpoint_id(),
            layout: h.layout,
            mc_time_us: h.mc_time_us,
            phase: h.phase,
            image: h.image,
            state,
        };
        assert!(checkpoint.is_intact());
        if h.scan > line.record.scan() {
            if line.kept.len() == 8 {
                line.kept.pop_front();
            }
            line.kept.push_back(checkpoint.clone());
            line.record.head = Some(checkpoint.id);
            line.record.phase = Some(h.phase);
            line.record.driven = true;
            line.head = Some(checkpoint.clone());
            line.outputs = view.outputs.to_vec();
            line.applied.push(h.clone());
            if let Some(to) = &h.released_to {
                line.record.state = RecordState::Released(to.clone());
            }
            if h.phase == Phase::Stopped {
                line.record.state = RecordState::Stopped;
            }
        }
        checkpoint
    }
}

/// A cell of a gateway and two nodes, with a clock.
pub struct Cell<R> {
    pub now: Now,
    pub gateway: Gateway,
    pub a: Node<R>,
    pub b: Node<R>,
}

pub fn model_cell(padding: usize) -> Cell<ModelMc> {
    Cell {
        now: Now(1_000_000),
        gateway: Gateway::new(
            (0..2)
                .map(|index| (mc_id(index), vec![0; INPUTS_LEN], vec![0; OUTPUTS_LEN]))
                .collect(),
        ),
        a: model_node("a", padding),
        b: model_node("b", padding),
    }
}

impl<R: McRuntime> Cell<R> {
    /// One tick: image to both, both tick, frames to the gateway and to the other node.
    pub fn tick(&mut self) {
        self.now = self.now.plus_us(TICK_US);
        let now = self.now;
        let image = self.gateway.image();
        for node in [&mut self.a, &mut self.b] {
            node.core.image(image.clone(), now);
            node.tick(now);
        }
        for bytes in self.a.sent(now) {
            self.gateway.frame(&bytes);
            receive(&mut self.b, &bytes);
        }
        for bytes in self.b.sent(now) {
            self.gateway.frame(&bytes);
            receive(&mut self.a, &bytes);
        }
    }

    pub fn activate_a(&mut self, mc: usize, change: impl FnOnce(&mut Activation)) {
        let mut activation = self.gateway.open(mc, &self.a.owner.clone());
        change(&mut activation);
        self.a
            .act(mc, McAct::Activate(Box::new(activation)), self.now);
    }

    pub fn activate_b(&mut self, mc: usize, change: impl FnOnce(&mut Activation)) {
        let mut activation = self.gateway.open(mc, &self.b.owner.clone());
        change(&mut activation);
        self.b
            .act(mc, McAct::Activate(Box::new(activation)), self.now);
    }

    pub fn head(&self, mc: usize) -> &Checkpoint {
        self.gateway.lines[mc].head.as_ref().unwrap()
    }
}

/// A frame of another node.
pub fn receive<R: McRuntime>(node: &mut Node<R>, bytes: &[u8]) {
    let mc = decode_frame(bytes).unwrap().header.mc;
    let replica = node
        .replicas
        .iter_mut()
        .find(|r| r.spec().mc == mc)
        .unwrap();
    if let Some(seen) = replica.frame(bytes) {
        match seen.held {
            Err(FrameRefusal::Layout(layout)) => assert!(replica.awaits(layout)),
            // A new version holds nothing until the first whole checkpoint.
            Err(FrameRefusal::NoBase(_)) if replica.held().is_none() => {}
            held => {
                held.unwrap();
            }
        }
    }
}
