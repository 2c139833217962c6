//! Prints what the link costs on this machine: `cargo run --release -p fam-driver --example round_trip`.
//!
//! Two sessions in one process, over TCP on the loopback: messages of 64 bytes there and back, at once one after the other
//! and paced at 10 ms, frames of 800 kB one way, and the time from a closed connection to the lost token.

use fam_driver::{Frames, Link, LinkEvent, LinkEvents, LinkOptions, Sinks};
use fam_proto::{AgentId, BootId, CellId, ControllerId, Envelope, McId, Message, ProcessId};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    fam_driver::runtime()?.block_on(measure())
}

async fn measure() -> Result<(), Box<dyn std::error::Error>> {
    let cell = CellId::new("measure")?;
    let controller = ControllerId::new("c1")?;
    let mc = McId::new("station1")?;
    let at = "tcp/127.0.0.1:17447".to_owned();
    let (arrived, arrivals) = mpsc::channel();
    let sinks = Sinks {
        frame: Some(Arc::new(move |_, bytes| {
            let _ = arrived.send((Instant::now(), bytes.len()));
        })),
        image: None,
    };
    let manager = LinkOptions {
        listen: vec![at.clone()],
        frames: Frames::All,
        peers: true,
        boot: BootId(1),
        ..LinkOptions::new(cell.clone(), ProcessId::Manager)
    };
    let (a, mut a_events) = Link::open_with(manager, sinks).await?;
    let node = LinkOptions {
        connect: vec![at],
        peers: true,
        boot: BootId(2),
        ..LinkOptions::new(cell, ProcessId::Node(controller.clone()))
    };
    let (b, mut b_events) = Link::open(node).await?;
    let up = |event| matches!(event, LinkEvent::Peer { alive: true, .. }).then_some(());
    until(&mut a_events, up).await;
    until(&mut b_events, up).await;

    let there = Envelope {
        from: AgentId::Manager,
        boot: a.boot(),
        to: AgentId::Controller(controller.clone()),
        body: Message::RegistrationRefused("x".repeat(20)),
    };
    let back = Envelope {
        from: AgentId::Controller(controller),
        boot: b.boot(),
        to: AgentId::Manager,
        body: Message::RegistrationRefused("x".repeat(20)),
    };
    let echo_link = b.clone();
    let echo = tokio::spawn(async move {
        loop {
            match b_events.recv().await {
                Some(LinkEvent::Message(_)) => echo_link.send(&back),
                Some(_) => {}
                None => return,
            }
        }
    });
    let message = |event| matches!(event, LinkEvent::Message(_)).then_some(());
    for (what, pause, rounds) in [
        (
            "message of 64 bytes, round trip, busy",
            Duration::ZERO,
            5_000,
        ),
        (
            "message of 64 bytes, round trip, every 10 ms",
            Duration::from_millis(10),
            300,
        ),
    ] {
        let mut took = Vec::new();
        for _ in 0..rounds {
            let start = Instant::now();
            a.send(&there);
            until(&mut a_events, message).await;
            took.push(start.elapsed());
            tokio::time::sleep(pause).await;
        }
        print(what, took);
    }

    for bytes in [10_000, 800_000] {
        let (mut one_way, mut puts) = (Vec::new(), Vec::new());
        let sender = b.sender();
        for _ in 0..200 {
            let frame = vec![7; bytes];
            let start = Instant::now();
            sender.put_frame(&mc, frame, false);
            puts.push(start.elapsed());
            match arrivals.recv_timeout(Duration::from_secs(1)) {
                Ok((at, len)) => {
                    assert_eq!(len, bytes);
                    one_way.push(at - start);
                }
                Err(_) => println!("a frame was lost"),
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        print(&format!("frame of {bytes} bytes, put"), puts);
        print(&format!("frame of {bytes} bytes, one way"), one_way);
    }

    let start = Instant::now();
    b.close().await;
    let gone = |event| matches!(event, LinkEvent::Peer { alive: false, .. }).then_some(());
    until(&mut a_events, gone).await;
    println!("close to lost token: {:?}", start.elapsed());
    echo.abort();
    a.close().await;
    Ok(())
}

async fn until(events: &mut LinkEvents, wanted: impl Fn(LinkEvent) -> Option<()>) {
    while let Some(event) = events.recv().await {
        if wanted(event).is_some() {
            return;
        }
    }
}

fn print(what: &str, mut took: Vec<Duration>) {
    took.sort();
    let at = |share: f64| {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            clippy::cast_precision_loss
        )]
        let index = ((took.len() - 1) as f64 * share) as usize;
        took[index].as_micros()
    };
    println!(
        "{what}: p50 {} us, p99 {} us, max {} us, n {}",
        at(0.5),
        at(0.99),
        at(1.0),
        took.len()
    );
}
