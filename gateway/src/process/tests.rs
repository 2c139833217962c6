//! The whole process over real links: a controller opens, drives, is fenced off; journal, io, restart, clean end.

use super::*;
use crate::io::{self, IoRequest};
use crate::recording;
use crate::testing::{self, Driver, ask, gateway_id, mc_id, owner};
use fam_driver::{LinkEvent, LinkEvents};
use fam_gateway_core::recorder;
use fam_proto::*;
use std::collections::BTreeMap;
use std::net::TcpListener;
use std::path::Path;
use tokio::sync::oneshot;
use tokio::time::timeout;

const LONG: Duration = Duration::from_secs(20);

fn free_endpoint() -> String {
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    format!("tcp/127.0.0.1:{port}")
}

fn cell(name: &str) -> CellModel {
    let mut cell = testing::cell();
    // Tests share the loopback: each has a cell of its own.
    cell.cell = CellId::new(name).unwrap();
    cell
}

fn options(folder: &Path, endpoint: &str) -> GatewayOptions {
    GatewayOptions {
        listen: vec![endpoint.to_owned()],
        connect: vec![],
        journal: Some(folder.join("applied.journal")),
        ..GatewayOptions::new(PathBuf::new(), folder.join("gateway1.records"))
    }
}

struct Running {
    stop: oneshot::Sender<()>,
    task: tokio::task::JoinHandle<anyhow::Result<()>>,
}

impl Running {
    fn start(model: &CellModel, options: GatewayOptions) -> Running {
        let (stop, stopped) = oneshot::channel();
        let model = model.clone();
        let task = tokio::spawn(async move {
            run_model(&model, options, async {
                let _ = stopped.await;
            })
            .await
        });
        Running { stop, task }
    }

    async fn end(self) {
        let _ = self.stop.send(());
        timeout(LONG, self.task).await.unwrap().unwrap().unwrap();
    }
}

/// A controller node, played by the test.
struct Node {
    link: Link,
    events: LinkEvents,
    n: u64,
    image: Option<Arc<InputImage>>,
}

impl Node {
    async fn start(cell: &CellModel, endpoint: &str, n: u64) -> Node {
        let owner = owner(n);
        let (link, events) = Link::open(LinkOptions {
            boot: owner.boot,
            connect: vec![endpoint.to_owned()],
            images: true,
            ..LinkOptions::new(cell.cell.clone(), ProcessId::Node(owner.controller))
        })
        .await
        .unwrap();
        Node {
            link,
            events,
            n,
            image: None,
        }
    }

    async fn next(&mut self) -> LinkEvent {
        let event = timeout(LONG, self.events.recv()).await.unwrap().unwrap();
        if let LinkEvent::Image(image) = &event {
            self.image = Some(Arc::clone(image));
        }
        event
    }

    /// Waits for an image whose record is as wanted.
    async fn until(&mut self, good: impl Fn(&RecordSummary) -> bool) -> RecordSummary {
        loop {
            self.next().await;
            if let Some(record) = self.image.as_ref().and_then(|i| i.record_of(&mc_id()))
                && good(record)
            {
                return record.clone();
            }
        }
    }

    /// Asks until there is an answer of the wanted kind.
    async fn open(&mut self, epoch: u64) -> Result<Opened, OpenRefused> {
        let owner = owner(self.n);
        loop {
            self.link.send(&Envelope {
                from: AgentId::Component(owner.controller.clone(), mc_id()),
                boot: owner.boot,
                to: AgentId::Gateway(gateway_id()),
                body: Message::Open(ask(self.n, epoch)),
            });
            let again = tokio::time::Instant::now() + Duration::from_millis(200);
            while let Ok(event) = tokio::time::timeout_at(again, self.next()).await {
                match event {
                    LinkEvent::Message(Envelope {
                        body: Message::Opened(opened),
                        ..
                    }) => return Ok(opened),
                    LinkEvent::Message(Envelope {
                        body: Message::OpenRefused(refused),
                        ..
                    }) => return Err(refused),
                    _ => {}
                }
            }
        }
    }

    async fn scan(&mut self, driver: &mut Driver) {
        let image = loop {
            match &self.image {
                Some(image) => break image.number,
                None => drop(self.next().await),
            }
        };
        let bytes = driver.frame(image);
        assert!(self.link.sender().put_frame(&mc_id(), bytes, false));
    }

    /// Scans until the gateway has acknowledged the last frame: the first ones may be lost while links are being made.
    async fn drive(&mut self, driver: &mut Driver) -> RecordSummary {
        loop {
            self.scan(driver).await;
            let id = driver.header.checkpoint_id();
            let image = self.image.as_ref().unwrap().number;
            let record = self.until(|record| record.epoch >= id.epoch).await;
            if record.head == Some(id) {
                return record;
            }
            // The acknowledgement comes with the next image but one at the latest.
            while self.image.as_ref().unwrap().number.0 < image.0 + 3 {
                self.next().await;
            }
            let image = self.image.as_ref().unwrap();
            let record = image.record_of(&mc_id()).unwrap();
            if record.head == Some(id) {
                return record.clone();
            }
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn a_controller_drives_another_takes_over_and_a_restart_goes_on_from_the_record() {
    let folder = tempfile::tempdir().unwrap();
    let cell = cell("takeover");
    let endpoint = free_endpoint();
    let gateway = Running::start(&cell, options(folder.path(), &endpoint));
    let mut first = Node::start(&cell, &endpoint, 1).await;
    let opened = first.open(5).await.unwrap();
    assert_eq!((opened.base, opened.next_scan), (None, Scan(1)));
    let mut driver = Driver::of(1, &opened);
    for _ in 0..5 {
        first.drive(&mut driver).await;
    }

    // What people see.
    let request = IoRequest::Get(vec!["Station1.Q".to_owned()]);
    let points = io::request(&first.link, &cell.cell, &gateway_id(), &request, LONG)
        .await
        .unwrap();
    assert_eq!(points[0].value, 1);
    let values = BTreeMap::from([("I".to_owned(), "16#0605".to_owned())]);
    io::request(
        &first.link,
        &cell.cell,
        &gateway_id(),
        &IoRequest::Set(values),
        LONG,
    )
    .await
    .unwrap();
    loop {
        let image = first.image.clone().unwrap();
        let inputs = image.inputs_of(&mc_id()).unwrap();
        if inputs.bytes[..2] == [5, 6] {
            assert!(inputs.fresh);
            break;
        }
        first.drive(&mut driver).await;
    }

    // The second controller gets it only when the first one's token is gone, or its frames are stale.
    let mut second = Node::start(&cell, &endpoint, 2).await;
    second.until(|record| record.driven).await;
    let head = first.drive(&mut driver).await.head;
    first.link.clone().close().await;
    let opened = loop {
        match second.open(6).await {
            Ok(opened) => break opened,
            Err(refused) => assert_eq!(refused.why, OpenRefusal::OwnerFresh),
        }
    };
    assert_eq!(opened.base, head);
    assert!(opened.interrupted);
    let mut next = Driver::of(2, &opened);
    for _ in 0..5 {
        second.drive(&mut next).await;
    }

    // The journal says the same.
    let batch = recording::fetch(&second.link, &cell.cell, &gateway_id(), 0, LONG)
        .await
        .unwrap();
    assert_eq!(batch.first, 0);
    recorder::check_chain(&batch.entries, true).unwrap();
    assert_eq!(recorder::double_driven_scans(&batch.entries), 0);
    let takeovers = recorder::takeovers(&batch.entries);
    assert_eq!((takeovers.len(), takeovers[0].scans_behind), (1, 0));
    let now = recording::monotonic_us() as i64;
    let at = batch.entries.last().unwrap().at_us as i64 + batch.monotonic_offset_us;
    assert!((0..10_000_000).contains(&(now - at)), "{at} against {now}");

    // A clean end leaves nothing driven, and the record is there again after it.
    let head = second.drive(&mut next).await.head;
    gateway.end().await;
    let last = second
        .until(|record| record.state == RecordState::FailSafe)
        .await;
    assert_eq!(last.head, head);
    let batches = recording::read_file(&folder.path().join("applied.journal")).unwrap();
    let written: Vec<_> = batches.into_iter().flat_map(|b| b.entries).collect();
    assert_eq!(written.last().map(Applied::checkpoint_id), head);
    let gateway = Running::start(&cell, options(folder.path(), &endpoint));
    let image = second.image.as_ref().unwrap().number;
    loop {
        second.next().await;
        if second.image.as_ref().unwrap().number > image {
            break;
        }
    }
    let opened = second.open(7).await.unwrap();
    assert_eq!(opened.base, head);
    assert!(opened.interrupted && opened.fail_safe);
    let mut next = Driver::of(2, &opened);
    second.drive(&mut next).await;
    gateway.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn frames_that_do_not_read_harm_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let cell = cell("garbage");
    let endpoint = free_endpoint();
    let gateway = Running::start(&cell, options(folder.path(), &endpoint));
    let mut node = Node::start(&cell, &endpoint, 1).await;
    let opened = node.open(5).await.unwrap();
    let mut driver = Driver::of(1, &opened);
    node.drive(&mut driver).await;
    let good = driver.encode();
    for len in [0, 1, 3, 4, 20, good.len() - 1] {
        let sender = node.link.sender();
        assert!(sender.put_frame(&mc_id(), good[..len].to_vec(), false));
        let mut bad = good.clone();
        bad[len] ^= 0xFF;
        assert!(sender.put_frame(&mc_id(), bad, false));
    }
    let key = keys::to(&cell.cell, &ProcessId::Gateway(gateway_id()));
    node.link.put_raw(&key, b"garbage".to_vec());
    let record = node.drive(&mut driver).await;
    assert_eq!(record.state, RecordState::Open);
    gateway.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn what_prevents_a_start_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let cell = cell("refused");
    let (_stop, never) = oneshot::channel::<()>();
    let mut never = Some(never);
    let mut start = async |model: &CellModel, options: GatewayOptions| {
        let stopped = never.take();
        let shutdown = async {
            match stopped {
                Some(stopped) => drop(stopped.await),
                None => std::future::pending().await,
            }
        };
        let error = timeout(LONG, run_model(model, options, shutdown))
            .await
            .unwrap()
            .unwrap_err();
        format!("{error:#}")
    };
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    let text = start(&cell, options(folder.path(), &endpoint)).await;
    assert!(
        text.contains(&endpoint) && text.contains("in use") && text.contains("end it"),
        "{text}"
    );

    let mut unknown = options(folder.path(), &endpoint);
    unknown.gateway = Some(GatewayId::new("gateway9").unwrap());
    let text = start(&cell, unknown).await;
    assert!(
        text.contains("gateway9") && text.contains("gateway1"),
        "{text}"
    );

    let mut foreign = options(folder.path(), &free_endpoint());
    foreign.records = folder.path().join("notes.txt");
    std::fs::write(&foreign.records, "my notes").unwrap();
    let text = start(&cell, foreign.clone()).await;
    assert!(
        text.contains("notes.txt") && text.contains("left untouched"),
        "{text}"
    );
    assert_eq!(
        std::fs::read_to_string(&foreign.records).unwrap(),
        "my notes"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn the_cell_file_is_read_and_its_problems_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let cell = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../engineering/tests/cells/two_stations/cell.toml");
    let model = fam_engineering::build_model(&cell).unwrap();
    let (name, id) = (model.cell, model.gateways[0].gateway.clone());
    let endpoint = free_endpoint();
    let (stop, stopped) = oneshot::channel::<()>();
    let running = tokio::spawn(run(
        GatewayOptions {
            cell,
            ..options(folder.path(), &endpoint)
        },
        async {
            let _ = stopped.await;
        },
    ));
    let (link, _events) = Link::open(LinkOptions {
        connect: vec![endpoint],
        ..LinkOptions::new(name.clone(), ProcessId::Client(1))
    })
    .await
    .unwrap();
    let points = io::request(&link, &name, &id, &IoRequest::Get(vec![]), LONG)
        .await
        .unwrap();
    assert!(
        points
            .iter()
            .any(|point| point.direction == io::Direction::Point),
        "{points:?}"
    );
    stop.send(()).unwrap();
    timeout(LONG, running).await.unwrap().unwrap().unwrap();

    let missing = GatewayOptions {
        cell: folder.path().join("cell.toml"),
        ..options(folder.path(), &free_endpoint())
    };
    let error = run(missing, std::future::pending()).await.unwrap_err();
    assert!(format!("{error:#}").contains("cell.toml"), "{error:#}");
}
