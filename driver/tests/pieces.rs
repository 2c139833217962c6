//! What is too long for one message goes in acknowledged pieces, over real sessions on the loopback.

mod common;

use common::*;
use fam_driver::{FrameBytes, Frames, Link, LinkEvent, LinkOptions, Sinks};
use fam_proto::codec::UNCUT_BYTES_MAX;
use fam_proto::{
    BootId, Checkpoint, CheckpointId, ControllerId, Envelope, Epoch, ImageNumber, LayoutHash, McId,
    Message, Opened, Owner, PIECE_BYTES, Phase, PieceHeader, ProcessId, Scan, encode_piece, keys,
};
use std::sync::Arc;
use tokio::sync::mpsc;

fn bytes(seed: usize) -> Vec<u8> {
    let len = UNCUT_BYTES_MAX + 3 * PIECE_BYTES + 17;
    (0..len)
        .map(|at| (at * 31 + at / 977 + seed) as u8)
        .collect()
}

/// What the gateway answers to an open by somebody who holds nothing.
fn grant(state: Vec<u8>) -> Opened {
    let id = CheckpointId {
        epoch: Epoch(3),
        scan: Scan(70),
        ..CheckpointId::default()
    };
    Opened {
        mc: mc(),
        epoch: Epoch(4),
        base: Some(id),
        checkpoint: Some(Box::new(Checkpoint {
            id,
            layout: LayoutHash(1),
            mc_time_us: 700_000,
            phase: Phase::Running,
            image: ImageNumber(9),
            state,
        })),
        outputs: vec![1],
        phase: Some(Phase::Running),
        interrupted: true,
        fail_safe: false,
        next_scan: Scan(71),
        reset: None,
        owner: Owner {
            controller: ControllerId::new("c1").unwrap(),
            boot: BootId(2),
        },
    }
}

struct Three {
    at: String,
    hub: Link,
    driver: Link,
    host: Link,
    host_events: fam_driver::LinkEvents,
    at_gateway: mpsc::UnboundedReceiver<(McId, Vec<u8>)>,
}

/// A gateway, the node that drives an MC, and a node that hosts it.
async fn three() -> Three {
    let at = endpoint();
    let (sink, at_gateway) = mpsc::unbounded_channel();
    let sinks = Sinks {
        frame: Some(Arc::new(move |mc: McId, bytes: FrameBytes| {
            let _ = sink.send((mc, bytes.contiguous().into_owned()));
        })),
        image: None,
    };
    let hub = LinkOptions {
        listen: vec![at.clone()],
        frames: Frames::All,
        ..options(gateway(), 1)
    };
    let (hub, mut hub_events) = Link::open_with(hub, sinks).await.unwrap();
    let host = LinkOptions {
        connect: vec![at.clone()],
        frames: Frames::Of(vec![mc()]),
        ..options(node("c1"), 2)
    };
    let (host, mut host_events) = Link::open(host).await.unwrap();
    let driver = LinkOptions {
        connect: vec![at.clone()],
        ..options(node("c2"), 3)
    };
    let (driver, mut driver_events) = Link::open(driver).await.unwrap();
    peers(&mut hub_events, &[node("c1"), node("c2")]).await;
    peers(&mut driver_events, &[gateway(), node("c1")]).await;
    peers(&mut host_events, &[gateway(), node("c2")]).await;
    Three {
        at,
        hub,
        driver,
        host,
        host_events,
        at_gateway,
    }
}

async fn frame_at_gateway(three: &mut Three) -> (McId, Vec<u8>) {
    let arrival = tokio::time::timeout(SOON, three.at_gateway.recv()).await;
    arrival.expect("the frame at the gateway").unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frame_that_is_too_long_for_one_message_comes_whole_to_gateway_and_host() {
    let mut three = three().await;
    assert!(three.driver.sender().put_frame(&mc(), bytes(1), false));
    let (seen, whole) = frame_at_gateway(&mut three).await;
    assert_eq!(seen, mc());
    assert!(whole == bytes(1), "the frame at the gateway is another");
    let (seen, whole) = until(&mut three.host_events, "the frame", |event| match event {
        LinkEvent::Frame { mc, bytes } => Some((mc, bytes)),
        _ => None,
    })
    .await;
    assert_eq!(seen, mc());
    assert!(
        *whole.contiguous() == *bytes(1),
        "the frame at the host is another"
    );
    assert_eq!(
        (three.hub.bad_messages(), three.host.bad_messages()),
        (0, 0)
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_host_that_acknowledges_nothing_holds_nobody_up() {
    let mut three = three().await;
    // Takes the questions, and never answers one: as a process does that is frozen.
    let config = serde_json::json!({
        "mode": "peer", "connect": { "endpoints": [three.at] },
        "scouting": { "multicast": { "enabled": false } },
    });
    let config = zenoh::Config::from_json5(&config.to_string()).unwrap();
    let frozen = zenoh::open(config).await.unwrap();
    let (kept, mut keeps) = mpsc::unbounded_channel();
    let key = keys::pieces(&keys::frame(three.hub.cell(), &mc()));
    let _silent = frozen
        .declare_queryable(key)
        .callback(move |query| {
            let _ = kept.send(query);
        })
        .await
        .unwrap();
    let mut held = Vec::new();
    while held.is_empty() {
        assert!(three.driver.sender().put_frame(&mc(), bytes(2), false));
        assert!(frame_at_gateway(&mut three).await.1 == bytes(2));
        while let Ok(query) = keeps.try_recv() {
            held.push(query);
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_grant_with_a_large_checkpoint_comes_whole() {
    let ((a, _a_events), (b, mut b_events)) =
        pair(options(gateway(), 1), options(node("c1"), 2)).await;
    let envelope = Envelope {
        body: Message::Opened(grant(bytes(3))),
        ..numbered(a.process(), b.process(), 1)
    };
    a.send(&envelope);
    let seen = common::message(&mut b_events).await;
    assert!(seen == envelope, "another grant than was sent");
    // A message of another agent that comes behind is not held up.
    a.send(&numbered(a.process(), b.process(), 2));
    assert_eq!(
        common::message(&mut b_events).await,
        numbered(a.process(), b.process(), 2)
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn broken_pieces_are_counted_and_the_next_good_message_comes() {
    let mut three = three().await;
    let key = keys::pieces(&keys::frame(three.hub.cell(), &mc()));
    let lie = PieceHeader {
        from: ProcessId::Manager,
        boot: three.hub.boot(),
        message: 1,
        message_bytes: u32::MAX,
        index: 0,
    };
    let late = PieceHeader {
        message_bytes: 2 * PIECE_BYTES as u32,
        index: 1,
        ..lie.clone()
    };
    for bad in [
        b"no piece".to_vec(),
        encode_piece(&lie, b"x").unwrap(),
        encode_piece(&late, &vec![0; PIECE_BYTES]).unwrap(),
    ] {
        let answer = three.driver.request(&key, bad, SOON).await;
        assert!(answer.is_err(), "{answer:?}");
    }
    assert!(three.driver.sender().put_frame(&mc(), bytes(4), false));
    assert!(frame_at_gateway(&mut three).await.1 == bytes(4));
    assert!(three.hub.bad_messages() + three.host.bad_messages() >= 3);
}
