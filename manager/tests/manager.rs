//! The real manager process over real sessions, against a gateway and controllers that are spoken by the test.

use fam_driver::{Client, Frames, Link, LinkEvent, LinkEvents, LinkOptions};
use fam_manager::{ManagerOptions, run, run_on};
use fam_proto::diagnosis::Diagnosis;
use fam_proto::model::{CellModel, ControllerModel, FieldDriver, GatewayModel, McModel, Settings};
use fam_proto::{
    AgentId, Bid, BootId, CellId, CellStatus, CheckpointId, CommandKind, ControllerId, Digest,
    Envelope, Epoch, Event, EventKind, GatewayId, Holding, Hosted, ImageNumber, InputImage,
    LayoutHash, McId, McInputs, McLoad, McOffer, McOutcome, McReport, McaState, Message, OrderKind,
    Owner, Phase, ProcessId, Query, QueryReply, RecordState, RecordSummary, Registration,
    RepoState, ResourceReport, Scan,
};
use fam_repository::Repository;
use fam_repository::disk::Disk;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::task::JoinHandle;

const SOON: Duration = Duration::from_secs(30);
const LAYOUT: LayoutHash = LayoutHash(7);
const HASH: u64 = 11;

/// One for each test process, so that two of them never meet.
/// A wall-clock time before any test was run, in microseconds: what boot ids are made of.
const LONG_AGO_US: u64 = 1_600_000_000_000_000;

fn cell() -> CellId {
    CellId::new(&format!("fake{}", std::process::id())).unwrap()
}
fn station() -> McId {
    McId::new("station1").unwrap()
}
fn controller(name: &str) -> ControllerId {
    ControllerId::new(name).unwrap()
}
fn gateway() -> GatewayId {
    GatewayId::new("gw").unwrap()
}

fn model() -> Arc<CellModel> {
    let controllers = ["c1", "c2"].map(|name| ControllerModel {
        controller: controller(name),
        description: String::new(),
        cpu_factor_permille: 1_000,
        memory_kb: 1_000,
        limit_permille: 800,
        tick_us: 5_000,
    });
    Arc::new(CellModel {
        cell: cell(),
        controllers: controllers.to_vec(),
        mcs: vec![McModel {
            mc: station(),
            gateway: gateway(),
            hosts: vec![controller("c1"), controller("c2")],
            criticality: 1,
            cycle_us: 5_000,
            worst_case_us: 100,
            memory_kb: 10,
            watchdog_us: 200_000,
            suspect_us: 50_000,
            hash: HASH,
            layout: LAYOUT,
            diagnosis: Diagnosis {
                state_offset: 0,
                checkpoint_len: 4,
                intervals: Vec::new(),
                stop_action: None,
            },
            inputs: Vec::new(),
            inputs_len: 0,
            outputs: Vec::new(),
            fail_safe: Vec::new(),
        }],
        gateways: vec![GatewayModel {
            gateway: gateway(),
            tick_us: 5_000,
            driver: FieldDriver::Image,
        }],
        settings: Settings::default(),
    })
}

/// An endpoint of the loopback that nobody listens at, below the ports that the system gives out by itself: those may be
/// taken by any connection in the meantime.
fn endpoint() -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let first = std::process::id().wrapping_mul(61);
    loop {
        let port = 10_000 + (first + NEXT.fetch_add(1, Ordering::Relaxed)) % 20_000;
        if std::net::TcpListener::bind(format!("127.0.0.1:{port}")).is_ok() {
            return format!("tcp/127.0.0.1:{port}");
        }
    }
}

/// A task that is ended with the test.
struct Task(JoinHandle<()>);

impl Drop for Task {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// The manager process.
struct Manager {
    end: oneshot::Sender<()>,
    process: JoinHandle<anyhow::Result<()>>,
}

impl Manager {
    fn start(at: &str, disk: &Disk, boot: u64) -> Manager {
        Manager::start_with(at, repository(disk), boot)
    }

    fn start_with(at: &str, (repository, restored): (Repository, RepoState), boot: u64) -> Manager {
        let (end, ended) = oneshot::channel();
        let options = ManagerOptions {
            cell_file: PathBuf::new(),
            repository: PathBuf::new(),
            listen: vec![at.to_owned()],
            connect: Vec::new(),
        };
        let process = tokio::spawn(run_on(
            model(),
            repository,
            restored,
            BootId(boot),
            options,
            async {
                let _ = ended.await;
            },
        ));
        Manager { end, process }
    }

    async fn stop(self) {
        let _ = self.end.send(());
        self.process.await.unwrap().unwrap();
    }
}

fn repository(disk: &Disk) -> (Repository, RepoState) {
    let disk = disk.clone();
    Repository::over(&cell(), move || Ok(disk.backend())).unwrap()
}

/// The record of the one MC, as gateway and controllers of the test share it.
#[derive(Clone)]
struct Record(Arc<Mutex<RecordSummary>>);

impl Record {
    fn never() -> Record {
        Record(Arc::new(Mutex::new(RecordSummary {
            mc: station(),
            epoch: Epoch(0),
            owner: None,
            state: RecordState::Never,
            head: None,
            phase: None,
            driven: false,
            silent_us: 0,
            suspect: false,
            rejected: 0,
        })))
    }

    fn get(&self) -> RecordSummary {
        self.0.lock().unwrap().clone()
    }

    /// What the gateway makes of an open that is followed by frames. A stale epoch changes nothing.
    fn open(&self, owner: &Owner, epoch: Epoch) -> bool {
        let mut record = self.0.lock().unwrap();
        if epoch <= record.epoch {
            return false;
        }
        let scan = record.scan().next();
        record.epoch = epoch;
        record.owner = Some(owner.clone());
        record.state = RecordState::Open;
        record.head = Some(CheckpointId {
            epoch,
            scan,
            digest: Digest::default(),
        });
        record.phase = Some(Phase::Running);
        record.driven = true;
        true
    }
}

/// A gateway that publishes an image each 5 ms.
async fn start_gateway(at: &str, record: Record) -> Task {
    let options = LinkOptions {
        connect: vec![at.to_owned()],
        boot: BootId(1),
        ..LinkOptions::new(cell(), ProcessId::Gateway(gateway()))
    };
    let (link, _events) = Link::open(options).await.unwrap();
    Task(tokio::spawn(async move {
        let _events = _events;
        let mut every = tokio::time::interval(Duration::from_millis(5));
        for number in 1.. {
            every.tick().await;
            link.publish_image(&InputImage {
                gateway: gateway(),
                boot: BootId(1),
                number: ImageNumber(number),
                sent_at_us: number * 5_000,
                inputs: vec![McInputs {
                    mc: station(),
                    bytes: Vec::new(),
                    fresh: true,
                }],
                records: vec![record.get()],
                exports: Vec::new(),
            });
        }
    }))
}

/// A controller that registers, reports, bids and obeys. What it was ordered to activate is told.
struct Node {
    _task: Task,
    orders: mpsc::UnboundedReceiver<Epoch>,
}

struct NodeAgents {
    link: Link,
    owner: Owner,
    record: Record,
    told: mpsc::UnboundedSender<Epoch>,
    registered_with: Option<BootId>,
}

impl Node {
    async fn start(at: &str, name: &str, boot: u64, record: Record) -> Node {
        let owner = Owner {
            controller: controller(name),
            boot: BootId(boot),
        };
        let options = LinkOptions {
            connect: vec![at.to_owned()],
            boot: owner.boot,
            peers: true,
            frames: Frames::None,
            ..LinkOptions::new(cell(), ProcessId::Node(owner.controller.clone()))
        };
        let (link, events) = Link::open(options).await.unwrap();
        let (told, orders) = mpsc::unbounded_channel();
        let agents = NodeAgents {
            link,
            owner,
            record,
            told,
            registered_with: None,
        };
        Node {
            _task: Task(tokio::spawn(agents.work(events))),
            orders,
        }
    }

    async fn ordered(&mut self) -> Epoch {
        let order = tokio::time::timeout(SOON, self.orders.recv()).await;
        order.expect("an order to activate").unwrap()
    }
}

impl NodeAgents {
    async fn work(mut self, mut events: LinkEvents) {
        let mut every = tokio::time::interval(Duration::from_millis(100));
        loop {
            tokio::select! {
                _ = every.tick() => {
                    if self.registered_with.is_none() {
                        self.say(AgentId::Manager, false, Message::Register(self.registration()));
                    }
                    let report = self.report();
                    for to in [AgentId::Manager, AgentId::Monitors] {
                        self.say(to, false, Message::Report(report.clone()));
                    }
                }
                event = events.recv() => match event {
                    Some(LinkEvent::Message(envelope)) => self.obey(envelope),
                    Some(LinkEvent::Peer { process: ProcessId::Manager, .. }) => self.registered_with = None,
                    Some(_) => {}
                    None => return,
                },
            }
        }
    }

    fn say(&self, to: AgentId, as_component: bool, body: Message) {
        let controller = self.owner.controller.clone();
        let from = match as_component {
            true => AgentId::Component(controller, station()),
            false => AgentId::Controller(controller),
        };
        self.link.send(&Envelope {
            from,
            boot: self.owner.boot,
            to,
            body,
        });
    }

    fn active(&self) -> Option<Epoch> {
        let record = self.record.get();
        (record.owner.as_ref() == Some(&self.owner)).then_some(record.epoch)
    }

    fn registration(&self) -> Registration {
        Registration {
            owner: self.owner.clone(),
            description: "a controller of the test".to_owned(),
            cpu_factor_permille: 1_000,
            memory_kb: 1_000,
            limit_permille: 800,
            tick_us: 5_000,
            mcs: vec![Hosted {
                mc: station(),
                hash: HASH,
                layout: LAYOUT,
                memory_kb: 10,
                worst_case_us: 100,
            }],
            active: self
                .active()
                .map(|epoch| (station(), epoch))
                .into_iter()
                .collect(),
            real_time: Vec::new(),
        }
    }

    fn report(&self) -> ResourceReport {
        let load = self.active().map(|_| McLoad {
            mc: station(),
            scan_us_mean: 50,
            scan_us_worst: 80,
            cycle_us: 5_000,
            scans: 20,
            lag_us: 0,
        });
        ResourceReport {
            owner: self.owner.clone(),
            workload_permille: if load.is_some() { 20 } else { 0 },
            mcs: load.into_iter().collect(),
            host_cpu_permille: 100,
            process_cpu_permille: 10,
            process_memory_kb: 1_000,
            late_ticks: 0,
            overruns: 0,
            image_age_us: 1_000,
            bad_messages: 0,
        }
    }

    fn obey(&mut self, envelope: Envelope) {
        match envelope.body {
            Message::Registered(_) => self.registered_with = Some(envelope.boot),
            Message::CallForProposals(call) => {
                let offers = call.mcs.iter().map(|mc| McOffer {
                    mc: mc.clone(),
                    unable: None,
                    worst_case_us: 80,
                });
                let bid = Bid {
                    negotiation: call.negotiation,
                    owner: self.owner.clone(),
                    offers: offers.collect(),
                    workload_permille: 0,
                    memory_free_kb: 900,
                    image_age_us: 1_000,
                    criteria: Vec::new(),
                };
                self.say(AgentId::Decision, false, Message::Bid(bid));
                let holding = Holding {
                    negotiation: call.negotiation,
                    mc: station(),
                    owner: self.owner.clone(),
                    held: self.record.get().head,
                };
                self.say(AgentId::Decision, true, Message::Holding(holding));
            }
            Message::Order(order) => {
                self.say(AgentId::Manager, true, Message::OrderReceived(order.id));
                if let OrderKind::Activate { epoch, .. } = order.kind
                    && self.record.open(&self.owner, epoch)
                {
                    self.say(
                        AgentId::Manager,
                        true,
                        Message::McReport(McReport {
                            mc: station(),
                            owner: self.owner.clone(),
                            state: McaState::Active,
                            epoch: Some(epoch),
                            order: Some(order.id),
                            outcome: McOutcome::Activated {
                                base: None,
                                recovery: 0,
                                interval: None,
                            },
                        }),
                    );
                    let _ = self.told.send(epoch);
                }
            }
            _ => {}
        }
    }
}

/// Asks until the status is as wanted.
async fn status(client: &mut Client, wanted: impl Fn(&CellStatus) -> bool) -> CellStatus {
    let asking = async {
        loop {
            if let QueryReply::Status(status) = client.ask(Query::Status, SOON).await.unwrap()
                && wanted(&status)
            {
                return status;
            }
        }
    };
    tokio::time::timeout(SOON, asking)
        .await
        .expect("the status does not become what is wanted")
}

async fn history(client: &mut Client) -> Vec<Event> {
    let all = Query::Events {
        after: 0,
        limit: 1_000,
    };
    let QueryReply::Events { events, .. } = client.ask(all, SOON).await.unwrap() else {
        panic!("no events")
    };
    events
}

fn owned_by(name: &'static str) -> impl Fn(&CellStatus) -> bool {
    move |status| status.mcs[0].owner == Some(controller(name)) && status.mcs[0].record == "open"
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cell_starts_loses_a_controller_and_gets_its_manager_back() {
    let (at, disk, record) = (endpoint(), Disk::default(), Record::never());
    let manager = Manager::start(&at, &disk, LONG_AGO_US + 100);
    let _gateway = start_gateway(&at, record.clone()).await;
    let mut first = Node::start(&at, "c1", 1, record.clone()).await;
    let epoch = first.ordered().await;
    let mut client = Client::open(cell(), vec![at.clone()]).await.unwrap();
    let seen = status(&mut client, owned_by("c1")).await;
    assert_eq!(
        (seen.mcs[0].epoch, seen.manager_boot),
        (epoch, BootId(LONG_AGO_US + 100))
    );

    // The token goes: the other controller gets it under a higher epoch.
    let mut second = Node::start(&at, "c2", 2, record.clone()).await;
    status(&mut client, |s| s.controllers.iter().all(|c| c.up)).await;
    drop(first);
    let next = second.ordered().await;
    assert!(next > epoch, "{next} after {epoch}");
    status(&mut client, owned_by("c2")).await;

    // A manager that comes back touches nothing and gives out higher epochs only.
    manager.stop().await;
    let (_, kept) = repository(&disk);
    assert!(kept.epochs[&station()] >= next);
    assert_eq!(kept.assignment[&station()], controller("c2"));
    assert!(kept.events.iter().all(|e| e.wall_us > LONG_AGO_US));
    assert!(
        kept.events
            .iter()
            .any(|e| e.kind == EventKind::ControllerLost)
    );
    let before = record.get();
    let manager = Manager::start(&at, &disk, LONG_AGO_US + 200);
    let seen = status(&mut client, |s| {
        owned_by("c2")(s)
            && s.manager_boot == BootId(LONG_AGO_US + 200)
            && s.controllers.iter().any(|c| c.up)
    })
    .await;
    assert_eq!(seen.mcs[0].epoch, next);
    assert_eq!(record.get(), before, "the running MC was touched");
    let mut first = Node::start(&at, "c1", 3, record.clone()).await;
    status(&mut client, |s| s.controllers.iter().all(|c| c.up)).await;
    drop(second);
    assert!(first.ordered().await > kept.epochs[&station()]);
    status(&mut client, owned_by("c1")).await;

    // The history of both lives is one, and the operator's words come through.
    let events = history(&mut client).await;
    let seqs: Vec<u64> = events.iter().map(|e| e.seq).collect();
    assert!(seqs.windows(2).all(|w| w[0] < w[1]), "{seqs:?}");
    let starts = events
        .iter()
        .filter(|e| e.kind == EventKind::ManagerStarted);
    assert_eq!(starts.count(), 2);
    assert!(events.iter().all(|e| e.wall_us > 1_600_000_000_000_000));
    let what = CommandKind::Drain(controller("nobody"));
    let refused = client.command(what, SOON, |_| {}).await.unwrap_err();
    assert!(refused.to_string().contains("nobody"), "{refused}");
    manager.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn with_a_full_disk_no_order_goes_out() {
    let (at, disk, record) = (endpoint(), Disk::default(), Record::never());
    let opened = repository(&disk);
    disk.set_capacity(Some(0));
    let manager = Manager::start_with(&at, opened, 100);
    let _gateway = start_gateway(&at, record.clone()).await;
    let mut node = Node::start(&at, "c1", 1, record.clone()).await;
    let mut client = Client::open(cell(), vec![at.clone()]).await.unwrap();
    status(&mut client, |s| {
        s.alarms > 0 && s.controllers.iter().any(|c| c.up)
    })
    .await;
    let events = history(&mut client).await;
    let alarm = events
        .iter()
        .find(|e| e.kind == EventKind::RepositoryFailed)
        .expect("an alarm");
    assert!(
        alarm.text.contains("no space left on device"),
        "{}",
        alarm.text
    );
    assert!(node.orders.try_recv().is_err(), "an order went out");
    assert_eq!(record.get().state, RecordState::Never);
    // Room again: the order comes, and its epoch is on the disk.
    disk.set_capacity(None);
    let epoch = node.ordered().await;
    manager.stop().await;
    let (_, kept) = repository(&disk);
    assert!(kept.epochs[&station()] >= epoch);
    assert_eq!(record.get().scan(), Scan(1));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_whole_process_runs_from_files_and_refuses_what_is_wrong_with_them() {
    let folder = tempfile::tempdir().unwrap();
    let cells = PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../engineering/tests/cells/two_stations/cell.toml"
    ));
    let at = endpoint();
    let options = |cell_file: PathBuf, repository: &str| ManagerOptions {
        listen: vec![at.clone()],
        connect: Vec::new(),
        ..ManagerOptions::new(cell_file, folder.path().join(repository))
    };
    let failed = async |options| {
        let error = run(options, std::future::pending()).await.unwrap_err();
        error.to_string()
    };

    let missing = folder.path().join("cell.toml");
    let text = failed(options(missing.clone(), "new.redb")).await;
    assert!(text.contains(missing.to_str().unwrap()), "{text}");
    std::fs::write(folder.path().join("foreign.redb"), "something else").unwrap();
    let text = failed(options(cells.clone(), "foreign.redb")).await;
    assert!(
        text.contains("foreign.redb is not a FAM repository"),
        "{text}"
    );

    let mut boots = Vec::new();
    for _ in 0..2 {
        let (end, ended) = oneshot::channel::<()>();
        let process = tokio::spawn(run(options(cells.clone(), "run/good.redb"), async {
            let _ = ended.await;
        }));
        let name = fam_engineering::build_model(&cells).unwrap().cell;
        let mut client = Client::open(name.clone(), vec![at.clone()]).await.unwrap();
        let seen = status(&mut client, |_| true).await;
        assert_eq!(seen.cell, name.to_string());
        let starts = history(&mut client).await;
        let starts = starts
            .iter()
            .filter(|e| e.kind == EventKind::ManagerStarted);
        boots.push(starts.count());
        drop(end);
        process.await.unwrap().unwrap();
        client.close().await;
    }
    assert_eq!(boots, [1, 2], "the history was not kept");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_port_in_use_is_an_error_that_says_what_to_do() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let at = format!("tcp/127.0.0.1:{}", taken.local_addr().unwrap().port());
    let error = Manager::start(&at, &Disk::default(), 1)
        .process
        .await
        .unwrap()
        .unwrap_err()
        .to_string();
    assert!(error.contains(&at) && error.contains("in use"), "{error}");
}
