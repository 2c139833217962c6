//! Processes that are frozen or killed: the others go on, and know.

mod common;

use common::*;
use fam_driver::{FrameBytes, Frames, Link, LinkEvents, LinkOptions, Sinks};
use fam_proto::{McId, ProcessId};
use std::process::{Child, Command};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::Notify;

const ENDPOINT: &str = "FAM_TEST_CHILD_ENDPOINT";
const FRAMES: u64 = 200;
const FRAME_BYTES: usize = 200_000;

/// Not a test of its own: with [`ENDPOINT`] set it is the other process of the tests below.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn child_process() {
    let Ok(at) = std::env::var(ENDPOINT) else {
        return;
    };
    let options = LinkOptions {
        connect: vec![at],
        frames: Frames::All,
        images: true,
        ..options(node("child"), 3)
    };
    let (_link, mut events) = Link::open(options).await.unwrap();
    while events.recv().await.is_some() {}
}

/// The child, killed at the end in any case.
struct Other(Child);

impl Other {
    fn start(endpoint: &str) -> Other {
        let child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "child_process"])
            .env(ENDPOINT, endpoint)
            .env(CELL, cell().as_str())
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        Other(child)
    }
    fn signal(&self, name: &str) {
        let id = self.0.id().to_string();
        let done = Command::new("kill").args([name, &id]).status().unwrap();
        assert!(done.success());
    }
}

impl Drop for Other {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

async fn hub() -> (String, Link, LinkEvents) {
    let at = endpoint();
    let (link, events) = Link::open(LinkOptions {
        listen: vec![at.clone()],
        ..options(ProcessId::Manager, 1)
    })
    .await
    .unwrap();
    (at, link, events)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_killed_process_loses_its_token() {
    let (at, link, mut events) = hub().await;
    let child = Other::start(&at);
    peer(&mut events, &node("child"), true).await;
    let start = Instant::now();
    child.signal("-KILL");
    peer(&mut events, &node("child"), false).await;
    println!("token lost {:?} after the signal", start.elapsed());
    link.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_frozen_receiver_holds_nobody_else_up() {
    let (at, link, mut events) = hub().await;
    let received = Arc::new(AtomicU64::new(0));
    let arrival = Arc::new(Notify::new());
    let (counter, arrived) = (received.clone(), arrival.clone());
    let sinks = Sinks {
        frame: Some(Arc::new(move |_: McId, bytes: FrameBytes| {
            assert_eq!(bytes.len(), FRAME_BYTES);
            counter.fetch_add(1, Ordering::Relaxed);
            arrived.notify_one();
        })),
        image: None,
    };
    let healthy = LinkOptions {
        connect: vec![at.clone()],
        frames: Frames::All,
        ..options(node("healthy"), 2)
    };
    let (healthy, _healthy_events) = Link::open_with(healthy, sinks).await.unwrap();
    peer(&mut events, &node("healthy"), true).await;
    let child = Other::start(&at);
    peer(&mut events, &node("child"), true).await;
    child.signal("-STOP");
    let sender = link.sender();
    let mut every = tokio::time::interval(Duration::from_millis(5));
    let mut took = Vec::new();
    for _ in 0..FRAMES {
        every.tick().await;
        let start = Instant::now();
        sender.put_frame(&mc(), vec![1; FRAME_BYTES], false);
        took.push(start.elapsed());
    }
    took.sort();
    let longest = took[took.len() - 1];
    // With congestion control `Block` a single put takes 5 s here.
    println!(
        "puts: median {:?}, longest {:?}",
        took[took.len() / 2],
        &took[took.len() - 4..]
    );
    assert!(longest < Duration::from_secs(1), "a put took {longest:?}");
    let arrived = async {
        while received.load(Ordering::Relaxed) < FRAMES * 9 / 10 {
            arrival.notified().await;
        }
    };
    tokio::time::timeout(SOON, arrived)
        .await
        .unwrap_or_else(|_| panic!("{} of {FRAMES} arrived", received.load(Ordering::Relaxed)));
    let start = Instant::now();
    link.close().await;
    assert!(start.elapsed() < Duration::from_secs(5));
    healthy.close().await;
}
