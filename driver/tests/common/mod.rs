//! Sessions on the loopback for the tests of the link.
#![allow(dead_code)] // each test file uses its part

use fam_driver::{Link, LinkEvent, LinkEvents, LinkOptions};
use fam_proto::{
    AgentId, BootId, CellId, ControllerId, Envelope, GatewayId, ImageNumber, InputImage, McId,
    McInputs, Message, OrderId, ProcessId,
};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

pub const SOON: Duration = Duration::from_secs(20);

/// Tells a child process the cell of its test.
pub const CELL: &str = "FAM_TEST_CELL";

/// One for each test process, so that two of them never meet.
pub fn cell() -> CellId {
    let name = std::env::var(CELL).unwrap_or_else(|_| format!("test{}", std::process::id()));
    CellId::new(&name).unwrap()
}

pub fn mc() -> McId {
    McId::new("station1").unwrap()
}

pub fn node(name: &str) -> ProcessId {
    ProcessId::Node(ControllerId::new(name).unwrap())
}

pub fn gateway() -> ProcessId {
    ProcessId::Gateway(GatewayId::new("gw").unwrap())
}

pub fn agent(process: &ProcessId) -> AgentId {
    match process {
        ProcessId::Manager => AgentId::Manager,
        ProcessId::Node(c) => AgentId::Controller(c.clone()),
        ProcessId::Gateway(g) => AgentId::Gateway(g.clone()),
        ProcessId::Client(n) => AgentId::Client(*n),
    }
}

/// An endpoint of the loopback that nobody listens at, below the ports that the system gives out by itself: those may be
/// taken by any connection in the meantime.
pub fn endpoint() -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let first = std::process::id().wrapping_mul(61);
    loop {
        let port = 10_000 + (first + NEXT.fetch_add(1, Ordering::Relaxed)) % 20_000;
        if std::net::TcpListener::bind(format!("127.0.0.1:{port}")).is_ok() {
            return format!("tcp/127.0.0.1:{port}");
        }
    }
}

pub fn options(process: ProcessId, boot: u64) -> LinkOptions {
    // `FAM_LOG=zenoh=trace` shows what Zenoh does.
    fam_driver::init_logging(fam_driver::LogFormat::Plain, "off");
    LinkOptions {
        boot: BootId(boot),
        peers: true,
        ..LinkOptions::new(cell(), process)
    }
}

/// Two connected processes, each of which has seen the other.
pub async fn pair(
    first: LinkOptions,
    second: LinkOptions,
) -> ((Link, LinkEvents), (Link, LinkEvents)) {
    let at = endpoint();
    let (a, mut a_events) = Link::open(LinkOptions {
        listen: vec![at.clone()],
        ..first
    })
    .await
    .unwrap();
    let (b, mut b_events) = Link::open(LinkOptions {
        connect: vec![at],
        ..second
    })
    .await
    .unwrap();
    peer(&mut a_events, b.process(), true).await;
    peer(&mut b_events, a.process(), true).await;
    ((a, a_events), (b, b_events))
}

/// The first event that `wanted` takes; others are passed over.
pub async fn until<T>(
    events: &mut LinkEvents,
    what: &str,
    mut wanted: impl FnMut(LinkEvent) -> Option<T>,
) -> T {
    let found = tokio::time::timeout(SOON, async {
        loop {
            let event = events.recv().await.expect("the link is open");
            if let Some(found) = wanted(event) {
                return found;
            }
        }
    });
    found
        .await
        .unwrap_or_else(|_| panic!("{what} did not come"))
}

pub async fn peer(events: &mut LinkEvents, who: &ProcessId, up: bool) -> BootId {
    until(events, &format!("{who} alive: {up}"), |event| match event {
        LinkEvent::Peer {
            process,
            boot,
            alive,
        } if &process == who && alive == up => Some(boot),
        _ => None,
    })
    .await
}

/// Waits until all of these have been seen alive, in any order.
pub async fn peers(events: &mut LinkEvents, all: &[ProcessId]) {
    let mut missing: Vec<_> = all.to_vec();
    until(events, "everybody's token", |event| {
        if let LinkEvent::Peer {
            process,
            alive: true,
            ..
        } = event
        {
            missing.retain(|m| *m != process);
        }
        missing.is_empty().then_some(())
    })
    .await;
}

pub async fn message(events: &mut LinkEvents) -> Envelope {
    until(events, "a message", |event| match event {
        LinkEvent::Message(envelope) => Some(envelope),
        _ => None,
    })
    .await
}

/// A message that tells its number.
pub fn numbered(from: &ProcessId, to: &ProcessId, number: u64) -> Envelope {
    Envelope {
        from: agent(from),
        boot: BootId(1),
        to: agent(to),
        body: Message::OrderReceived(OrderId(number)),
    }
}

pub fn image(number: u64) -> InputImage {
    InputImage {
        gateway: GatewayId::new("gw").unwrap(),
        boot: BootId(1),
        number: ImageNumber(number),
        sent_at_us: 5,
        inputs: vec![McInputs {
            mc: mc(),
            bytes: vec![1, 2, 3],
            fresh: true,
        }],
        records: Vec::new(),
        exports: Vec::new(),
    }
}
