//! A real node process loop over Zenoh, against a gateway and a manager that the test plays.

#[path = "../core/tests/common/mod.rs"]
mod common;
mod faulty;

use common::Gateway;
use fam_controller_node::{NodeOptions, run};
use fam_driver::{Frames, Link, LinkEvent, LinkEvents, LinkOptions};
use fam_proto::model::CellModel;
use fam_proto::*;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::sync::oneshot;
use tokio::time::timeout;

const PATIENCE: Duration = Duration::from_secs(60);

fn cell_file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../engineering/tests/cells/two_stations/cell.toml")
}

fn free_endpoint() -> String {
    let port = std::net::TcpListener::bind("127.0.0.1:0")
        .and_then(|l| l.local_addr())
        .unwrap()
        .port();
    format!("tcp/127.0.0.1:{port}")
}

/// Manager and gateway on one link each.
struct Played {
    manager: Link,
    from_nodes: LinkEvents,
    gateway: Link,
    at_gateway: LinkEvents,
    fence: Gateway,
    /// What the manager has been told.
    told: Vec<Message>,
    next_order: u64,
}

impl Played {
    async fn start(model: &CellModel) -> (Played, Vec<String>) {
        let endpoints = vec![free_endpoint(), free_endpoint()];
        let open = |process: ProcessId, listen: &str, frames: Frames| {
            let mut options = LinkOptions::new(model.cell.clone(), process);
            options.listen = vec![listen.to_owned()];
            options.frames = frames;
            options.peers = true;
            Link::open(options)
        };
        let (manager, from_nodes) = open(ProcessId::Manager, &endpoints[0], Frames::None)
            .await
            .unwrap();
        let gateway_id = model.gateways[0].gateway.clone();
        let (gateway, at_gateway) =
            open(ProcessId::Gateway(gateway_id), &endpoints[1], Frames::All)
                .await
                .unwrap();
        let lines = model.mcs.iter().map(|mc| {
            let inputs = vec![0; mc.inputs_len as usize];
            (mc.mc.clone(), inputs, mc.fail_safe.clone())
        });
        let played = Played {
            manager,
            from_nodes,
            gateway,
            at_gateway,
            fence: Gateway::new(lines.collect()),
            told: Vec::new(),
            next_order: 0,
        };
        (played, endpoints)
    }

    /// A gateway's cycle, until the condition holds.
    async fn until(&mut self, what: &str, mut holds: impl FnMut(&mut Played) -> bool) {
        let mut tick = tokio::time::interval(Duration::from_millis(5));
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        let waiting = async {
            while !holds(self) {
                tokio::select! {
                    _ = tick.tick() => self.gateway.publish_image(&self.fence.image()),
                    event = self.at_gateway.recv() => self.at_gateway(event.unwrap()),
                    event = self.from_nodes.recv() => self.node_says(event.unwrap()),
                }
            }
        };
        if timeout(PATIENCE, waiting).await.is_err() {
            panic!("waited for: {what}; the manager was told {:?}", self.told);
        }
    }

    fn at_gateway(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::Frame { bytes, .. } => {
                let bytes = bytes.contiguous();
                let header = decode_frame(&bytes).unwrap().header;
                let line = self.fence.lines.iter();
                let line = line.map(|l| &l.record).find(|r| r.mc == header.mc).unwrap();
                if line.drives(&header.owner, header.epoch) {
                    self.fence.frame(&bytes);
                }
            }
            LinkEvent::Message(envelope) => {
                let Message::Open(open) = envelope.body else {
                    return;
                };
                let mcs = self.fence.lines.iter();
                let index = mcs
                    .map(|l| &l.record.mc)
                    .position(|mc| *mc == open.mc)
                    .unwrap();
                if self.fence.lines[index].record.epoch < open.epoch {
                    self.fence.open(index, &open.owner);
                }
                let line = &self.fence.lines[index];
                let head = line.head.clone();
                let opened = Opened {
                    mc: open.mc.clone(),
                    epoch: open.epoch,
                    base: head.as_ref().map(|h| h.id),
                    phase: head.as_ref().map(|h| h.phase),
                    outputs: line.outputs.clone(),
                    interrupted: true,
                    fail_safe: false,
                    next_scan: line.record.scan().next(),
                    reset: open.reset,
                    owner: open.owner.clone(),
                    checkpoint: head.filter(|h| open.held != Some(h.id)).map(Box::new),
                };
                self.gateway.send(&Envelope {
                    from: AgentId::Gateway(common::gateway_id()),
                    boot: self.gateway.boot(),
                    to: envelope.from,
                    body: Message::Opened(opened),
                });
            }
            _ => {}
        }
    }

    fn node_says(&mut self, event: LinkEvent) {
        let LinkEvent::Message(envelope) = event else {
            return;
        };
        if let Message::Register(_) = &envelope.body {
            let registered = Registered {
                assigned: Vec::new(),
                ineligible: Vec::new(),
            };
            self.say(envelope.from.clone(), Message::Registered(registered));
        }
        self.told.push(envelope.body);
    }

    fn say(&self, to: AgentId, body: Message) {
        self.manager.send(&Envelope {
            from: AgentId::Manager,
            boot: self.manager.boot(),
            to,
            body,
        });
    }

    fn order(&mut self, controller: &ControllerId, mc: usize, kind: OrderKind) {
        self.next_order += 1;
        let mc = self.fence.lines[mc].record.mc.clone();
        let order = Order {
            id: OrderId(self.next_order),
            mc: mc.clone(),
            kind,
        };
        self.say(
            AgentId::Component(controller.clone(), mc),
            Message::Order(order),
        );
    }

    fn activate(&mut self, controller: &ControllerId, mc: usize) {
        let epoch = self.fence.lines[mc].record.epoch.next();
        let kind = OrderKind::Activate {
            epoch,
            after: None,
            force: false,
            reset: None,
            within_us: 30_000_000,
        };
        self.order(controller, mc, kind);
    }

    fn has_heard(&self, what: impl Fn(&Message) -> bool) -> bool {
        self.told.iter().any(what)
    }

    fn scan(&self, mc: usize) -> u64 {
        self.fence.lines[mc].record.scan().0
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_node_registers_runs_follows_and_hands_over_before_it_ends() {
    let model = fam_engineering::build(&cell_file()).unwrap().model;
    let (mut played, connect) = Played::start(&model).await;
    let first = ControllerId::new("controller1").unwrap();
    let second = ControllerId::new("controller2").unwrap();
    let mut ends = Vec::new();
    let mut nodes = Vec::new();
    for controller in [&first, &second] {
        let mut options = NodeOptions::new(cell_file(), controller.clone());
        options.connect.clone_from(&connect);
        let (end, ended) = oneshot::channel::<()>();
        ends.push(Some(end));
        nodes.push(tokio::spawn(run(options, async move {
            let _ = ended.await;
        })));
    }
    for controller in [&first, &second] {
        played
            .until("registration and report", |p| {
                let registered = p.has_heard(|m| {
                    matches!(m, Message::Register(r) if r.owner.controller == *controller && r.mcs.len() == 2)
                });
                registered
                    && p.has_heard(|m| {
                        matches!(m, Message::Report(r) if r.owner.controller == *controller)
                    })
            })
            .await;
    }

    // both MCs on the first: frames at the gateway, loads in the reports
    played.activate(&first, 0);
    played.activate(&first, 1);
    played
        .until("50 scans of both", |p| p.scan(0) > 50 && p.scan(1) > 50)
        .await;
    assert!(played.has_heard(|m| {
        matches!(m, Message::McReport(r) if r.mc.as_str() == "Feeder" && matches!(r.outcome, McOutcome::Activated { recovery: 0, base: None, .. }))
    }));
    played.told.clear();
    played
        .until("a report with loads", |p| {
            p.has_heard(|m| {
                matches!(m, Message::Report(r) if r.mcs.len() == 2 && r.workload_permille > 0 && r.process_memory_kb > 0 && r.mcs.iter().all(|mc| mc.scans > 0))
            })
        })
        .await;

    // failover: the second opens a higher epoch and goes on from the very next scan; the first learns it from the record
    let before = played.fence.lines[0].applied.len();
    played.activate(&second, 0);
    played
        .until("the second drives", |p| {
            p.fence.lines[0].record.driven && p.fence.lines[0].record.epoch == Epoch(2)
        })
        .await;
    let applied = &played.fence.lines[0].applied;
    let at = (before - 1..applied.len())
        .find(|n| applied[*n].epoch == Epoch(2))
        .unwrap();
    assert_eq!(applied[at].scan, applied[at - 1].scan.next());
    assert_eq!(applied[at].base, Some(applied[at - 1].checkpoint_id()));
    assert_eq!(
        applied[at].content,
        Content::Delta(applied[at - 1].checkpoint_id()),
        "it went on from the replica that it held"
    );
    played
        .until("the first is deposed", |p| {
            p.has_heard(|m| {
                matches!(m, Message::McReport(r) if r.owner.controller == first && r.state == McaState::Passive)
            })
        })
        .await;

    // handover of the other MC on SIGTERM
    played.told.clear();
    ends[0].take().unwrap().send(()).unwrap();
    played
        .until("leaving", |p| {
            p.has_heard(|m| matches!(m, Message::Leaving))
        })
        .await;
    let successor = Successor {
        epoch: Epoch(2),
        owner: Owner {
            controller: second.clone(),
            boot: played.manager.boot(),
        },
    };
    let last = played.scan(1);
    played.order(
        &second.clone(),
        1,
        OrderKind::Activate {
            epoch: Epoch(2),
            after: Some(Owner {
                controller: first.clone(),
                boot: played.manager.boot(),
            }),
            force: false,
            reset: None,
            within_us: 30_000_000,
        },
    );
    played.order(
        &first.clone(),
        1,
        OrderKind::Release {
            epoch: Epoch(1),
            successor,
            within_us: 30_000_000,
        },
    );
    played
        .until("the second drives both", |p| {
            p.fence.lines[1].record.driven && p.fence.lines[1].record.epoch == Epoch(2)
        })
        .await;
    let scans: Vec<u64> = played.fence.lines[1]
        .applied
        .iter()
        .map(|h| h.scan.0)
        .filter(|s| *s > last)
        .collect();
    assert!(scans.windows(2).all(|w| w[0] + 1 == w[1]), "{scans:?}");
    played
        .until("released", |p| {
            p.has_heard(|m| {
                matches!(m, Message::McReport(r) if matches!(r.outcome, McOutcome::Released { .. }))
            })
        })
        .await;
    played.say(
        AgentId::Controller(first.clone()),
        Message::MayLeave { behind: Vec::new() },
    );
    let node = nodes.remove(0);
    played.until("the node ends", |_| node.is_finished()).await;
    node.await.unwrap().unwrap();

    // the second is told to end, and the manager does not answer: it says what it leaves behind, but does not hang
    ends[1].take().unwrap().send(()).unwrap();
    let node = nodes.remove(0);
    played
        .until("the second node ends", |_| node.is_finished())
        .await;
    node.await.unwrap().unwrap();
    assert!(played.has_heard(|m| {
        matches!(m, Message::Event(e) if e.text.contains("leaves Feeder, Press behind"))
    }));
}

#[tokio::test(flavor = "multi_thread")]
async fn an_endless_loop_is_ended_and_answered_by_the_stop_pou_while_the_other_mc_runs_on() {
    let folder = faulty::cell();
    let cell = folder.path().join("cell.toml");
    let model = fam_engineering::build(&cell).unwrap().model;
    let (mut played, connect) = Played::start(&model).await;
    // in every image from the first on: an MC may scan at once on an image from before its grant, and 100 / 0 traps
    played.fence.inputs[0][0] = 5;
    let controller = ControllerId::new("controller1").unwrap();
    let mut options = NodeOptions::new(cell, controller.clone());
    options.connect = connect;
    let (end, ended) = oneshot::channel::<()>();
    let node = tokio::spawn(run(options, async move {
        let _ = ended.await;
    }));
    played
        .until("registration", |p| {
            p.has_heard(|m| matches!(m, Message::Register(_)))
        })
        .await;
    played.activate(&controller, 0);
    played.activate(&controller, 1);
    played
        .until("both run", |p| p.scan(0) > 10 && p.scan(1) > 10)
        .await;
    played.fence.inputs[0][0] = faulty::LOOPS_FOR_EVER;
    played
        .until("stopped on record", |p| {
            p.fence.lines[0].record.state == RecordState::Stopped
        })
        .await;
    let outputs = &played.fence.lines[0].outputs;
    assert_eq!(outputs[..2], [0xff, 0xff], "the stop POU's");
    let trap = played.told.iter().find_map(|m| match m {
        Message::McReport(r) => match &r.outcome {
            McOutcome::Faulted(trap) => Some(trap.to_string()),
            _ => None,
        },
        _ => None,
    });
    let trap = trap.expect("a report of the fault");
    assert!(
        trap.contains("endless loop")
            && trap.contains("in Divider, ")
            && trap.contains("divider.st line "),
        "{trap}"
    );
    let scan = played.scan(1);
    played
        .until("the other runs on", |p| p.scan(1) > scan + 20)
        .await;
    end.send(()).unwrap();
    played
        .until("leaving", |p| {
            p.has_heard(|m| matches!(m, Message::Leaving))
        })
        .await;
    played.until("the node ends", |_| node.is_finished()).await;
    node.await.unwrap().unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_port_in_use_and_a_broken_cell_say_what_to_do() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/127.0.0.1:{}", taken.local_addr().unwrap().port());
    let mut options = NodeOptions::new(cell_file(), ControllerId::new("controller1").unwrap());
    options.listen = vec![endpoint.clone()];
    options.connect.clear();
    let error = run(options.clone(), std::future::pending())
        .await
        .unwrap_err();
    let text = format!("{error:#}");
    assert!(
        text.contains("controller1 cannot join cell two_stations")
            && text.contains(&endpoint)
            && text.contains("in use"),
        "{text}"
    );
    options.cell = PathBuf::from("/nowhere/cell.toml");
    let error = run(options, std::future::pending()).await.unwrap_err();
    assert!(error.to_string().contains("/nowhere/cell.toml"), "{error}");
}
