//! What two and three processes tell each other over real sessions on the loopback.

mod common;

use common::*;
use fam_driver::{FrameBytes, Frames, Link, LinkError, LinkEvent, LinkOptions, Sinks};
use fam_proto::{Event, EventKind, McId, ProcessId, Severity, codec, keys};
use std::sync::Arc;
use tokio::sync::mpsc;

/// A dropped frame is put again after this long.
const AGAIN: std::time::Duration = std::time::Duration::from_millis(300);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_go_both_ways_and_to_oneself() {
    let ((a, mut a_events), (b, mut b_events)) =
        pair(options(ProcessId::Manager, 1), options(node("c1"), 2)).await;
    for number in 0..50 {
        a.send(&numbered(a.process(), b.process(), number));
        let seen = message(&mut b_events).await;
        assert_eq!(seen, numbered(a.process(), b.process(), number));
        b.send(&numbered(b.process(), a.process(), number));
        assert_eq!(
            message(&mut a_events).await,
            numbered(b.process(), a.process(), number)
        );
    }
    b.send(&numbered(b.process(), b.process(), 7));
    assert_eq!(
        message(&mut b_events).await,
        numbered(b.process(), b.process(), 7)
    );
    assert_eq!((a.bad_messages(), b.bad_messages()), (0, 0));
    a.close().await;
    b.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_token_tells_life_and_end() {
    let ((a, mut a_events), (b, _b_events)) =
        pair(options(ProcessId::Manager, 1), options(node("c1"), 2)).await;
    b.close().await;
    assert_eq!(peer(&mut a_events, &node("c1"), false).await.0, 2);
    // A second life of the same controller, and one that ends without a word.
    let listen = vec![endpoint()];
    let (c, mut c_events) = Link::open(LinkOptions {
        listen: listen.clone(),
        ..options(node("c1"), 3)
    })
    .await
    .unwrap();
    let (d, d_events) = Link::open(LinkOptions {
        connect: listen,
        ..options(node("c2"), 4)
    })
    .await
    .unwrap();
    peer(&mut c_events, &node("c2"), true).await;
    drop((d, d_events));
    assert_eq!(peer(&mut c_events, &node("c2"), false).await.0, 4);
    a.close().await;
    c.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn images_and_large_frames_arrive_whole() {
    let at = endpoint();
    let (sink, mut taken) = mpsc::unbounded_channel();
    let image_sink = sink.clone();
    let sinks = Sinks {
        frame: Some(Arc::new(move |mc: McId, bytes: FrameBytes| {
            let _ = sink.send(format!(
                "{mc} {} {:?}",
                bytes.len(),
                bytes.to_arc()[700_000]
            ));
        })),
        image: Some(Arc::new(move |image| {
            let _ = image_sink.send(format!("image {}", image.number));
        })),
    };
    let hub = LinkOptions {
        listen: vec![at.clone()],
        images: true,
        frames: Frames::All,
        ..options(gateway(), 1)
    };
    let (hub, mut hub_events) = Link::open_with(hub, sinks).await.unwrap();
    let host = LinkOptions {
        connect: vec![at.clone()],
        images: true,
        frames: Frames::Of(vec![mc()]),
        ..options(node("c1"), 2)
    };
    let (host, mut host_events) = Link::open(host).await.unwrap();
    let driver = LinkOptions {
        connect: vec![at],
        frames: Frames::All,
        ..options(node("c2"), 3)
    };
    let (driver, mut driver_events) = Link::open(driver).await.unwrap();
    peers(&mut hub_events, &[node("c1"), node("c2")]).await;
    peers(&mut driver_events, &[gateway(), node("c1")]).await;
    peers(&mut host_events, &[gateway(), node("c2")]).await;

    let mut frame = vec![9_u8; 800_000];
    frame[700_000] = 42;
    // Put from a plain thread, as a node does. One that meets a busy link is dropped and made good by the next.
    let sender = driver.sender();
    let mut put_until = async |name: &str, bytes: &[u8]| {
        let mc = McId::new(name).unwrap();
        let putting = async {
            loop {
                let (sender, mc, bytes) = (sender.clone(), mc.clone(), bytes.to_vec());
                let put = std::thread::spawn(move || sender.put_frame(&mc, bytes, false));
                assert!(put.join().unwrap());
                let arrival = tokio::time::timeout(AGAIN, taken.recv()).await;
                // A late copy of an earlier one is passed over.
                if let Ok(Some(text)) = arrival
                    && text.starts_with(name)
                {
                    return text;
                }
            }
        };
        let arrived = tokio::time::timeout(SOON, putting).await;
        arrived.unwrap_or_else(|_| panic!("the frame of {name} did not come"))
    };
    assert_eq!(put_until("station1", &frame).await, "station1 800000 42");
    let (seen_mc, bytes) = until(&mut host_events, "the frame", |event| match event {
        LinkEvent::Frame { mc, bytes } => Some((mc, bytes)),
        _ => None,
    })
    .await;
    assert_eq!(seen_mc, mc());
    assert_eq!(bytes.contiguous(), frame);
    assert_eq!(bytes.pieces().map(<[u8]>::len).sum::<usize>(), bytes.len());
    // Frames of other MCs do not come to `c1`, its own do not come back to the sender.
    assert_eq!(put_until("station2", &frame).await, "station2 800000 42");

    hub.publish_image(&image(5));
    let seen = until(&mut host_events, "the image", |event| match event {
        LinkEvent::Image(image) => Some(image),
        LinkEvent::Frame { mc: other, .. } => {
            assert_eq!(other, mc());
            None
        }
        _ => None,
    })
    .await;
    assert_eq!(*seen, image(5));
    // The hub subscribes to images too: sink and event.
    let at_hub = tokio::time::timeout(SOON, async {
        while taken.recv().await.unwrap() != "image 5" {}
    });
    at_hub.await.expect("the image at the hub");
    while let Some(event) = driver_events.try_recv() {
        assert!(!matches!(event, LinkEvent::Frame { .. }), "{event:?}");
    }
    for link in [hub, host, driver] {
        link.close().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_does_not_read_is_counted_and_survived() {
    let receiver = LinkOptions {
        images: true,
        ..options(ProcessId::Manager, 1)
    };
    let ((a, mut a_events), (b, _b_events)) = pair(receiver, options(node("c1"), 2)).await;
    let good = codec::encode(&numbered(b.process(), a.process(), 1)).unwrap();
    let mut newer = good.clone();
    newer[1] = 77;
    let image_bytes = codec::encode(&image(1)).unwrap();
    let to = keys::to(&cell(), a.process());
    let image_key = format!("fam/{}/image/gw", cell());
    let broken: [(&str, Vec<u8>); 8] = [
        (&to, Vec::new()),
        (&to, vec![0xff; 3_000]),
        (&to, good[..good.len() - 1].to_vec()),
        (&to, newer),
        (&to, image_bytes.clone()),
        (&image_key, vec![1, 2, 3]),
        (&image_key, good.clone()),
        (&image_key, image_bytes[..image_bytes.len() - 2].to_vec()),
    ];
    for (key, bytes) in &broken {
        b.put_raw(key, bytes.clone());
    }
    b.send(&numbered(b.process(), a.process(), 2));
    assert_eq!(
        message(&mut a_events).await,
        numbered(b.process(), a.process(), 2)
    );
    // Images have a queue of their own: wait for a good one behind the broken ones.
    b.publish_image(&image(3));
    until(&mut a_events, "the image", |event| {
        matches!(event, LinkEvent::Image(_)).then_some(())
    })
    .await;
    assert_eq!(a.bad_messages(), broken.len() as u64);
    a.close().await;
    b.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nodes_reach_each_other_when_the_manager_is_gone_and_find_it_again() {
    let at = endpoint();
    let manager = || LinkOptions {
        listen: vec![at.clone()],
        ..options(ProcessId::Manager, 1)
    };
    let (hub, hub_events) = Link::open(manager()).await.unwrap();
    let connected = |name, boot| LinkOptions {
        connect: vec![at.clone()],
        ..options(node(name), boot)
    };
    let (b, mut b_events) = Link::open(connected("c1", 2)).await.unwrap();
    let (c, mut c_events) = Link::open(connected("c2", 3)).await.unwrap();
    peer(&mut b_events, &node("c2"), true).await;
    peer(&mut c_events, &node("c1"), true).await;
    hub.close().await;
    drop(hub_events);
    peer(&mut b_events, &ProcessId::Manager, false).await;
    b.send(&numbered(b.process(), c.process(), 1));
    assert_eq!(
        message(&mut c_events).await,
        numbered(b.process(), c.process(), 1)
    );
    let (hub, mut hub_events) = Link::open(LinkOptions {
        boot: fam_proto::BootId(9),
        ..manager()
    })
    .await
    .unwrap();
    assert_eq!(peer(&mut b_events, &ProcessId::Manager, true).await.0, 9);
    peers(&mut hub_events, &[node("c1"), node("c2")]).await;
    for link in [hub, b, c] {
        link.close().await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_port_in_use_and_a_wrong_endpoint_are_named() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let at = format!("tcp/127.0.0.1:{}", taken.local_addr().unwrap().port());
    let open = |listen: &str| {
        Link::open(LinkOptions {
            listen: vec![listen.to_owned()],
            ..options(ProcessId::Manager, 1)
        })
    };
    let text = open(&at).await.unwrap_err().to_string();
    assert_eq!(
        text,
        format!(
            "cannot listen at {at}: the port is in use. Another process (an earlier run of the manager?) listens there: end it, or give another endpoint"
        )
    );
    let error = open("tcp/192.0.2.1:7447").await.unwrap_err();
    assert!(matches!(error, LinkError::Listen { .. }), "{error}");
    assert!(error.to_string().contains("tcp/192.0.2.1:7447"), "{error}");
    let error = open("7447").await.unwrap_err().to_string();
    assert!(error.contains("7447"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_endpoint_without_connection_is_known_and_tried_until_it_answers() {
    // Bound, so that it is nobody else's, but never listened at.
    let bound = tokio::net::TcpSocket::new_v4().unwrap();
    bound.bind("127.0.0.1:0".parse().unwrap()).unwrap();
    let never = format!("tcp/{}", bound.local_addr().unwrap());
    let at = endpoint();
    let (b, _b_events) = Link::open(LinkOptions {
        connect: vec![at.clone(), never.clone()],
        ..options(node("c1"), 2)
    })
    .await
    .unwrap();
    assert_eq!(b.check_reach().await, [at.clone(), never.clone()]);
    assert_eq!(b.unreachable(), [at.clone(), never.clone()]);
    let (a, mut a_events) = Link::open(LinkOptions {
        listen: vec![at],
        ..options(ProcessId::Manager, 1)
    })
    .await
    .unwrap();
    peer(&mut a_events, &node("c1"), true).await;
    assert_eq!(b.check_reach().await, [never]);
    a.close().await;
    b.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn streams_requests_and_events() {
    let ((a, _a_events), (b, _b_events)) =
        pair(options(gateway(), 1), options(node("c1"), 2)).await;
    let (sender, mut seen) = mpsc::unbounded_channel();
    let of_stream = sender.clone();
    let _stream = b
        .subscribe(&format!("fam/{}/applied/*", cell()), move |key, bytes| {
            of_stream.send(format!("{key} {bytes:?}")).unwrap();
        })
        .unwrap();
    let _events = b
        .follow_events(move |event| sender.send(event.text).unwrap())
        .unwrap();
    let io = format!("fam/{}/io/gw", cell());
    let _server = a
        .serve(&io, |asked| match asked {
            b"get" => Ok(b"value".to_vec()),
            other => Err(format!(
                "unknown request `{}`",
                String::from_utf8_lossy(other)
            )),
        })
        .unwrap();
    let topic = a.topic(&format!("fam/{}/applied/gw", cell())).unwrap();
    let ask = |what: &'static [u8]| b.request(&io, what.to_vec(), SOON);
    assert_eq!(ask(b"get").await.unwrap(), b"value");
    assert_eq!(
        ask(b"put").await.unwrap_err().to_string(),
        "unknown request `put`"
    );
    tokio::time::timeout(SOON, async {
        while !topic.has_listeners() {
            tokio::task::yield_now().await;
        }
    })
    .await
    .unwrap();
    topic.put(vec![4, 5]);
    assert_eq!(
        seen.recv().await.unwrap(),
        format!("fam/{}/applied/gw [4, 5]", cell())
    );
    a.publish_event(&Event::new(Severity::Info, EventKind::PlanDone, "done"));
    assert_eq!(seen.recv().await.unwrap(), "done");
    let nobody = b
        .request(
            &format!("{io}2"),
            Vec::new(),
            std::time::Duration::from_millis(120),
        )
        .await;
    let text = nobody.unwrap_err().to_string();
    assert!(text.contains("/io/gw2"), "{text}");
    a.close().await;
    b.close().await;
}
