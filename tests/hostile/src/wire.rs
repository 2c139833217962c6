//! What crosses the wire: messages, frames, checkpoints and deltas, input images.

use crate::cell::{cell, gateway_id, instance, mc_id, owner, spec};
use crate::pieces::Pieces;
use fam_gateway_core::{
    Gateway, GatewayAct, GatewayLocal, GatewayOutput, MemoryRecords, RecordWrite, Why,
};
use fam_node_core::Replica;
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::codec::{Wire, decode, encode};
use fam_proto::{
    AgentId, Applied, AppliedBatch, Checkpoint, CommandReply, Content, Digest, Envelope, Epoch,
    Event, FrameHeader, HeadMeta, InputImage, Ledger, Message, Now, Open, PieceTaken, Query,
    Record, RepoState, RepoWrite, decode_frame, delta, encode_frame,
};
use std::sync::Arc;

/// Whatever reads is written as it reads: nothing is lost, invented, or read in two ways.
fn reads_as_written<T: Wire + PartialEq + std::fmt::Debug>(bytes: &[u8]) {
    if let Ok(body) = decode::<T>(bytes) {
        let again = encode(&body).expect("what was read is small enough to be written");
        assert_eq!(decode::<T>(&again).as_ref(), Ok(&body), "{}", T::NAME);
    }
}

/// Messages of agents, operators and gateways, and events.
pub fn message(bytes: &[u8]) {
    reads_as_written::<Envelope>(bytes);
    reads_as_written::<Event>(bytes);
    reads_as_written::<AppliedBatch>(bytes);
    reads_as_written::<Ledger>(bytes);
    reads_as_written::<HeadMeta>(bytes);
    reads_as_written::<Record>(bytes);
    reads_as_written::<RepoWrite>(bytes);
    reads_as_written::<RepoState>(bytes);
    reads_as_written::<PieceTaken>(bytes);
    // The same bytes behind a good head, so that mutations are spent on the bodies.
    let mut headed = vec![b'F', 1, Envelope::KIND, 0];
    headed.extend_from_slice(bytes);
    if let Ok(envelope) = decode::<Envelope>(&headed) {
        words(&envelope);
    }
    reads_as_written::<Envelope>(&headed);
}

/// What people would be shown of it.
fn words(envelope: &Envelope) {
    let _ = format!("{} {} {}", envelope.from, envelope.to, envelope.boot);
    match &envelope.body {
        Message::OpenRefused(refused) => {
            let _ = refused.why.to_string();
        }
        Message::Close(close) => {
            let _ = close.trap.to_string();
        }
        Message::CommandReply(CommandReply { .. }) | Message::Query(Query::Events { .. }) => {}
        _ => {}
    }
}

/// A gateway with an epoch open for controller 1, and what it has applied.
struct Bench {
    gateway: Gateway,
    records: MemoryRecords,
    now: Now,
    applied: Vec<Applied>,
    image: u64,
}

impl Bench {
    fn new() -> Bench {
        let gateway = Gateway::new(&cell(), &gateway_id(), owner(1).boot, 1, Vec::new(), Now(0))
            .expect("the cell fits the gateway");
        let mut bench = Bench {
            gateway,
            records: MemoryRecords::default(),
            now: Now(0),
            applied: Vec::new(),
            image: 0,
        };
        bench.drain();
        bench.tick();
        let open = Envelope {
            from: AgentId::Component(owner(1).controller, mc_id()),
            boot: owner(1).boot,
            to: AgentId::Gateway(gateway_id()),
            body: Message::Open(Open {
                mc: mc_id(),
                epoch: Epoch(1),
                owner: owner(1),
                layout: spec().layout,
                held: None,
                force: false,
                reset: None,
            }),
        };
        bench.gateway.handle(Input::Message(open), bench.now);
        bench.drain();
        bench
    }

    fn tick(&mut self) {
        self.now = self.now.plus_us(5_000);
        self.gateway.handle_timeout(self.now);
        self.drain();
        let inputs = fam_proto::McInputs {
            mc: mc_id(),
            bytes: vec![0; 4],
            fresh: true,
        };
        let field = Input::Local(GatewayLocal::Field(vec![inputs]));
        self.gateway.handle(field, self.now);
        self.drain();
    }

    fn drain(&mut self) {
        while let Some(output) = self.gateway.poll_output() {
            match output {
                GatewayOutput::Persist { ticket, write } => {
                    if let RecordWrite::Head { head, .. } = &write {
                        assert_eq!(
                            Digest::of(head.meta.mc_time_us, &head.state),
                            head.meta.id.digest
                        );
                    }
                    self.records.write(write);
                    let result = Ok(());
                    self.gateway
                        .handle(Input::Persisted { ticket, result }, self.now);
                }
                Output::Act(GatewayAct::ApplyOutputs {
                    why: Why::Frame(applied),
                    ..
                }) => self.applied.push(applied),
                Output::Act(GatewayAct::PublishImage(image)) => self.image = image.number.0,
                _ => {}
            }
        }
    }

    /// Throws a frame at the gateway; what it applies has to be the owner's, and to go on from the head.
    fn frame(&mut self, bytes: &[u8]) {
        let before = self.gateway.gate(&mc_id()).map(|g| g.ledger().clone());
        let before = before.expect("the MC is served");
        let count = self.applied.len();
        let frame = Input::Local(GatewayLocal::Frame(Arc::from(bytes)));
        self.gateway.handle(frame, self.now);
        self.drain();
        if let Some(applied) = self.applied.get(count) {
            assert_eq!(before.state, fam_proto::RecordState::Open);
            assert_eq!(applied.epoch, before.epoch);
            assert_eq!(Some(&applied.owner), before.owner.as_ref());
            assert!(applied.scan > before.last_scan);
            if !before.driven {
                assert_eq!(applied.base, before.base);
            }
        }
    }
}

/// The header of a good first frame, and its bytes.
pub(crate) fn good_frame(image: u64, scan: u64) -> (FrameHeader, Vec<u8>, Vec<u8>) {
    let spec = spec();
    let outputs = vec![1; spec.outputs_len];
    let state = spec.initial.clone();
    let mc_time_us = scan * 5_000;
    let header = FrameHeader {
        mc: mc_id(),
        owner: owner(1),
        epoch: Epoch(1),
        scan: fam_proto::Scan(scan),
        image: fam_proto::ImageNumber(image),
        base: None,
        mc_time_us,
        layout: spec.layout,
        digest: Digest::of(mc_time_us, &state),
        phase: fam_proto::Phase::Running,
        released_to: None,
        scan_us: 10,
        content: Content::Full,
        outputs_len: u32::try_from(outputs.len()).unwrap_or(0),
        state_len: u32::try_from(state.len()).unwrap_or(0),
    };
    (header, outputs, state)
}

/// Frames, at the gateway's fence and at a passive node.
pub fn frame(bytes: &[u8]) {
    if let Ok(view) = decode_frame(bytes) {
        let again = encode_frame(&view.header, view.outputs, view.content)
            .expect("what was read is small enough to be written");
        assert_eq!(decode_frame(&again).as_ref(), Ok(&view));
    }
    let mut bench = Bench::new();
    let mut replica = Replica::new(Arc::new(spec()), owner(2), instance());
    bench.frame(bytes);
    replica.frame(bytes);
    // Frames that are nearly right: good ones, changed in some places, some of them with a digest that fits again.
    let mut pieces = Pieces(bytes);
    let mut scan = 1;
    while !pieces.is_empty() {
        let how = pieces.byte();
        let (mut header, mut outputs, mut state) = good_frame(bench.image, scan);
        if how & 1 != 0 {
            Pieces(pieces.piece()).lay_over(&mut state);
        }
        if how & 2 != 0 {
            Pieces(pieces.piece()).lay_over(&mut outputs);
        }
        let head = bench.gateway.gate(&mc_id()).and_then(|g| g.head().cloned());
        if let (true, Some(head)) = (how & 4 != 0, head) {
            // A delta of the fuzzer's own against the head.
            header.content = Content::Delta(head.meta.id);
            let piece = pieces.piece();
            let mut rebuilt = head.state.to_vec();
            if delta::apply(&mut rebuilt, piece).is_ok() && how & 8 != 0 {
                header.digest = Digest::of(header.mc_time_us, &rebuilt);
            }
            state = piece.to_vec();
        } else if how & 8 != 0 {
            header.digest = Digest::of(header.mc_time_us, &state);
        }
        let mut sent = encode_frame(&header, &outputs, &state).expect("a small frame");
        if how & 16 != 0 {
            Pieces(pieces.piece()).lay_over(&mut sent);
        }
        bench.frame(&sent);
        replica.frame(&sent);
        if how & 32 != 0 {
            bench.tick();
        }
        scan += u64::from(how >> 6);
    }
}

/// Checkpoints and deltas.
pub fn checkpoint(bytes: &[u8]) {
    let mut pieces = Pieces(bytes);
    let old = pieces.piece().to_vec();
    let new = pieces.piece().to_vec();
    let told = pieces.0;
    // A delta of the fuzzer's own applies whole or not at all.
    let mut state = old.clone();
    match delta::apply(&mut state, told) {
        Ok(()) => assert_eq!(state.len(), old.len()),
        Err(_) => assert_eq!(state, old),
    }
    // A delta of ours leads from old to new.
    let mut out = Vec::new();
    if delta::diff(&old, &new, &mut out) {
        let mut state = old.clone();
        assert_eq!(delta::apply(&mut state, &out), Ok(()));
        assert_eq!(state, new);
        assert!(out.len() <= new.len());
    } else {
        assert!(out.is_empty());
    }
    // A checkpoint is intact or not; a damaged one is seen, whichever byte it is.
    let mut whole = Checkpoint {
        id: fam_proto::CheckpointId {
            digest: Digest::of(7, &old),
            ..Default::default()
        },
        layout: fam_proto::LayoutHash(1),
        mc_time_us: 7,
        phase: fam_proto::Phase::Running,
        image: fam_proto::ImageNumber(0),
        state: old,
    };
    assert!(whole.is_intact());
    if let Some(first) = whole.state.first_mut() {
        *first ^= 1;
        assert!(!whole.is_intact());
    }
}

/// Input images, as they come to a node's scan thread and agents, and to the manager.
pub fn image(bytes: &[u8]) {
    reads_as_written::<InputImage>(bytes);
    let mut headed = vec![b'F', 1, InputImage::KIND, 0];
    headed.extend_from_slice(bytes);
    for bytes in [bytes, &headed] {
        if let Ok(image) = decode::<InputImage>(bytes) {
            crate::agents::see_image(&image);
        }
    }
}
