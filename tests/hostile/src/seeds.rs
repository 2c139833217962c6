//! Where fuzzers and property tests begin: the golden bytes, and one good input of each kind.

use crate::cell::{gateway_id, mc_id, owner};
use crate::wire::good_frame;
use fam_proto::codec::{Wire, encode};
use fam_proto::{
    AgentId, Award, Bid, BootId, CallForProposals, Cause, CellStatus, CheckpointId, Close, Command,
    CommandKind, CommandReply, Envelope, Epoch, Event, EventKind, Holding, Hosted, ImageNumber,
    InputImage, McLoad, McOffer, McOutcome, McReport, McaState, Message, Open, OpenRefusal,
    OpenRefused, Opened, Order, OrderId, OrderKind, PieceHeader, PlanId, ProcessId, QosEvent,
    Query, QueryReply, RecordState, RecordSummary, Registered, Registration, Reset, ResourceReport,
    Scan, Severity, Successor, TrapInfo, encode_frame, encode_piece,
};

const GOLDEN: [(&str, &str); 9] = [
    (
        "envelope",
        include_str!("../../../proto/tests/golden/envelope.hex"),
    ),
    (
        "event",
        include_str!("../../../proto/tests/golden/event.hex"),
    ),
    (
        "frame_header",
        include_str!("../../../proto/tests/golden/frame_header.hex"),
    ),
    (
        "input_image",
        include_str!("../../../proto/tests/golden/input_image.hex"),
    ),
    (
        "piece_header",
        include_str!("../../../proto/tests/golden/piece_header.hex"),
    ),
    (
        "piece_taken",
        include_str!("../../../proto/tests/golden/piece_taken.hex"),
    ),
    (
        "record",
        include_str!("../../../proto/tests/golden/record.hex"),
    ),
    (
        "repository_block",
        include_str!("../../../proto/tests/golden/repository_block.hex"),
    ),
    (
        "repository_state",
        include_str!("../../../proto/tests/golden/repository_state.hex"),
    ),
];

/// A diagnosis file as the engineering tool writes it.
#[cfg(feature = "diagnosis-file")]
mod models;

const DIAGNOSIS: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<diagnosis xmlns="urn:fam:diagnosis:1" mc="Station1" stateOffset="16" stateLength="24" checkpointLength="40" stopAction="4">
  <state><variable name="Step" type="DINT" offset="16"/></state>
  <criticalInterval name="Carry" kind="checkpoint" action="1" pou="RecoverCarry" repeatable="true">
    <condition>Step = 3</condition>
    <row><mask offset="16" type="i32" operator="eq" value="3"/><mask offset="0" type="u8" bits="1" operator="ne" otherOffset="1" otherType="u8"/></row>
    <row><mask offset="8" type="f64" operator="gt" realBits="3ff0000000000000" shown="1.0"/></row>
  </criticalInterval>
</diagnosis>
"#;

fn golden(name: &str) -> Vec<u8> {
    let hex = GOLDEN.iter().find(|(n, _)| *n == name).map_or("", |g| g.1);
    let digits: Vec<u8> = hex.bytes().filter(u8::is_ascii_hexdigit).collect();
    digits
        .chunks_exact(2)
        .filter_map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok())
        .collect()
}

fn checkpoint_id() -> CheckpointId {
    good_frame(1, 1).0.checkpoint_id()
}

fn trap() -> TrapInfo {
    TrapInfo {
        pou: "Main".to_owned(),
        file: "main.st".to_owned(),
        line: 3,
        message: "division by zero".to_owned(),
    }
}

fn summary() -> RecordSummary {
    RecordSummary {
        mc: mc_id(),
        epoch: Epoch(1),
        owner: Some(owner(1)),
        state: RecordState::Open,
        head: Some(checkpoint_id()),
        phase: None,
        driven: true,
        silent_us: 0,
        suspect: false,
        rejected: 0,
    }
}

fn registration(n: u64) -> Registration {
    let model = &crate::cell().mcs[0];
    Registration {
        owner: owner(n),
        description: "PLC".to_owned(),
        cpu_factor_permille: 1_000,
        memory_kb: 10_000,
        limit_permille: 700,
        tick_us: 5_000,
        mcs: vec![Hosted {
            mc: mc_id(),
            hash: model.hash,
            layout: model.layout,
            memory_kb: 100,
            worst_case_us: 100,
        }],
        active: vec![(mc_id(), Epoch(1))],
        real_time: vec!["mlock".to_owned()],
    }
}

fn report(n: u64) -> ResourceReport {
    ResourceReport {
        owner: owner(n),
        workload_permille: 10,
        mcs: vec![McLoad {
            mc: mc_id(),
            scan_us_mean: 10,
            scan_us_worst: 20,
            cycle_us: 5_000,
            scans: 20,
            lag_us: 0,
        }],
        host_cpu_permille: 10,
        process_cpu_permille: 10,
        process_memory_kb: 10_000,
        late_ticks: 0,
        overruns: 0,
        image_age_us: 1_000,
        bad_messages: 0,
    }
}

fn order(kind: OrderKind) -> Message {
    Message::Order(Order {
        id: OrderId(1),
        mc: mc_id(),
        kind,
    })
}

/// One message of each kind, from its usual sender to its usual receiver.
#[must_use]
pub fn envelopes() -> Vec<Envelope> {
    let manager = || AgentId::Manager;
    let ca = || AgentId::Controller(owner(2).controller);
    let mca = |n| AgentId::Component(owner(n).controller, mc_id());
    let gateway = || AgentId::Gateway(gateway_id());
    let successor = Successor {
        epoch: Epoch(3),
        owner: owner(1),
    };
    let activate = OrderKind::Activate {
        epoch: Epoch(2),
        after: None,
        force: false,
        reset: None,
        within_us: 500_000,
    };
    let opened = Opened {
        mc: mc_id(),
        epoch: Epoch(2),
        base: None,
        checkpoint: None,
        outputs: vec![0; 9],
        phase: None,
        interrupted: false,
        fail_safe: true,
        next_scan: Scan(1),
        reset: Some(Reset::Cold),
        owner: owner(1),
    };
    let outcome = |outcome| {
        Message::McReport(McReport {
            mc: mc_id(),
            owner: owner(2),
            state: McaState::Active,
            epoch: Some(Epoch(2)),
            order: Some(OrderId(1)),
            outcome,
        })
    };
    let all = [
        (ca(), manager(), Message::Register(registration(2))),
        (
            manager(),
            ca(),
            Message::Registered(Registered {
                assigned: vec![mc_id()],
                ineligible: vec![],
            }),
        ),
        (
            manager(),
            ca(),
            Message::RegistrationRefused("no".to_owned()),
        ),
        (ca(), manager(), Message::Leaving),
        (manager(), ca(), Message::MayLeave { behind: Vec::new() }),
        (ca(), manager(), Message::Report(report(2))),
        (
            ca(),
            AgentId::Decision,
            Message::Qos(QosEvent {
                qos: "work balance".to_owned(),
                cause: Cause::Overload(owner(2).controller),
                detail: "d".to_owned(),
            }),
        ),
        (
            AgentId::Decision,
            ca(),
            Message::CallForProposals(CallForProposals {
                negotiation: 1,
                mcs: vec![mc_id()],
                criteria: vec!["c".to_owned()],
                within_us: 20_000,
            }),
        ),
        (
            ca(),
            AgentId::Decision,
            Message::Bid(Bid {
                negotiation: 1,
                owner: owner(2),
                offers: vec![McOffer {
                    mc: mc_id(),
                    unable: None,
                    worst_case_us: 100,
                }],
                workload_permille: 0,
                memory_free_kb: 9_000,
                image_age_us: 100,
                criteria: vec![("c".to_owned(), 1)],
            }),
        ),
        (
            mca(2),
            AgentId::Decision,
            Message::Holding(Holding {
                negotiation: 1,
                mc: mc_id(),
                owner: owner(2),
                held: Some(checkpoint_id()),
            }),
        ),
        (
            AgentId::Decision,
            ca(),
            Message::Award(Award {
                negotiation: 1,
                mcs: vec![mc_id()],
            }),
        ),
        (manager(), mca(2), order(activate)),
        (
            manager(),
            mca(2),
            order(OrderKind::Release {
                epoch: Epoch(2),
                successor,
                within_us: 5_000_000,
            }),
        ),
        (
            manager(),
            mca(2),
            order(OrderKind::CancelRelease { epoch: Epoch(2) }),
        ),
        (
            manager(),
            mca(2),
            order(OrderKind::Stop { epoch: Epoch(2) }),
        ),
        (mca(2), manager(), Message::OrderReceived(OrderId(1))),
        (
            mca(2),
            manager(),
            outcome(McOutcome::Activated {
                base: None,
                recovery: 0,
                interval: None,
            }),
        ),
        (
            mca(2),
            manager(),
            outcome(McOutcome::NotOpened("why".to_owned())),
        ),
        (mca(2), manager(), outcome(McOutcome::Faulted(trap()))),
        (
            mca(1),
            gateway(),
            Message::Open(Open {
                mc: mc_id(),
                epoch: Epoch(1),
                owner: owner(1),
                layout: crate::cell().mcs[0].layout,
                held: None,
                force: false,
                reset: None,
            }),
        ),
        (gateway(), mca(2), Message::Opened(opened)),
        (
            gateway(),
            mca(2),
            Message::OpenRefused(OpenRefused {
                mc: mc_id(),
                epoch: Epoch(2),
                why: OpenRefusal::OwnerFresh,
                record: Some(summary()),
            }),
        ),
        (
            mca(1),
            gateway(),
            Message::Close(Close {
                mc: mc_id(),
                epoch: Epoch(1),
                owner: owner(1),
                trap: trap(),
            }),
        ),
        (
            ca(),
            manager(),
            Message::Event(Event::new(Severity::Info, EventKind::McActivated, "e")),
        ),
        (
            AgentId::Client(1),
            manager(),
            Message::Command(Command {
                id: 1,
                what: CommandKind::Move {
                    mc: mc_id(),
                    to: owner(2).controller,
                    force: true,
                },
            }),
        ),
        (
            AgentId::Client(1),
            manager(),
            Message::Command(Command {
                id: 2,
                what: CommandKind::Reset {
                    mc: mc_id(),
                    how: Reset::Warm,
                },
            }),
        ),
        (
            AgentId::Client(1),
            manager(),
            Message::Command(Command {
                id: 3,
                what: CommandKind::Drain(owner(1).controller),
            }),
        ),
        (
            manager(),
            AgentId::Client(1),
            Message::CommandReply(CommandReply {
                id: 1,
                result: Ok("done".to_owned()),
                done: true,
            }),
        ),
        (
            AgentId::Client(1),
            manager(),
            Message::Query(Query::Events {
                after: 0,
                limit: 10,
            }),
        ),
        (
            manager(),
            AgentId::Client(1),
            Message::QueryReply(Box::new(QueryReply::Status(CellStatus {
                cell: "cell".to_owned(),
                manager_boot: BootId(7),
                at_us: 1,
                generation: PlanId(1),
                controllers: vec![],
                mcs: vec![],
                gateways: vec![],
                in_progress: None,
                alarms: 0,
                bad_messages: 0,
            }))),
        ),
    ];
    all.into_iter()
        .map(|(from, to, body)| {
            let boot = match &from {
                AgentId::Controller(c) | AgentId::Component(c, _) => {
                    if *c == owner(1).controller {
                        owner(1).boot
                    } else {
                        owner(2).boot
                    }
                }
                AgentId::Gateway(_) => BootId(9),
                AgentId::Client(_) => BootId(11),
                _ => BootId(7),
            };
            Envelope {
                from,
                boot,
                to,
                body,
            }
        })
        .collect()
}

/// An input image whose record says that controller 1 drives, or that nobody does.
#[must_use]
pub fn input_image(number: u64, driven: bool) -> InputImage {
    let mut record = summary();
    if !driven {
        record.state = RecordState::Closed;
    }
    InputImage {
        gateway: gateway_id(),
        boot: BootId(9),
        number: ImageNumber(number),
        sent_at_us: 1,
        inputs: vec![fam_proto::McInputs {
            mc: mc_id(),
            bytes: vec![0; 4],
            fresh: true,
        }],
        records: vec![record],
        exports: Vec::new(),
    }
}

fn body<T: Wire>(of: &T) -> Vec<u8> {
    encode(of).map(|b| b[4..].to_vec()).unwrap_or_default()
}

fn piece(bytes: &[u8]) -> Vec<u8> {
    let len = u16::try_from(bytes.len()).unwrap_or(u16::MAX);
    [&len.to_le_bytes()[..], bytes].concat()
}

/// Inputs to begin with, for the target of this name.
#[must_use]
pub fn of(target: &str) -> Vec<Vec<u8>> {
    let (header, outputs, state) = good_frame(1 << 32 | 1, 1);
    let frame = encode_frame(&header, &outputs, &state).unwrap_or_default();
    match target {
        "message" => {
            let mut seeds: Vec<Vec<u8>> = GOLDEN.iter().map(|(name, _)| golden(name)).collect();
            seeds.extend(envelopes().iter().map(body));
            seeds
        }
        "frame" => vec![
            golden("frame_header"),
            frame,
            vec![0b0100_0000; 4],
            vec![0b0110_0000, 0b0100_1001, 4, 0, 20, 0, 1, 9, 0b0110_0000],
            [
                &[0b0100_0000, 0b0100_1100],
                &piece(&[16, 0, 0, 0, 1, 0, 0, 0, 5])[..],
            ]
            .concat(),
        ],
        "checkpoint" => vec![
            [
                piece(&[0; 100]),
                piece(&[1; 100]),
                vec![8, 0, 0, 0, 2, 0, 0, 0, 1, 1],
            ]
            .concat(),
            [
                piece(&[0; 300]),
                piece(&[[0; 200], [7; 200]].concat()[..300]),
            ]
            .concat(),
        ],
        "image" => vec![
            golden("input_image"),
            body(&input_image(1, true)),
            body(&input_image(1, false)),
        ],
        "piece" => {
            let header = PieceHeader {
                from: ProcessId::Node(owner(1).controller),
                boot: BootId(1),
                message: 1,
                message_bytes: 3,
                index: 0,
            };
            vec![
                encode_piece(&header, b"abc").unwrap_or_default(),
                golden("piece_header"),
                vec![0, 0x20, 0, 0x21, 0, 0x22, 0, 0x22, 0, 0x30],
                vec![
                    0, 0x20, 1, 0x20, 1, 0x21, 0, 0x21, 2, 0x10, 0, 0x22, 2, 0x11, 1, 0x22,
                ],
            ]
        }
        "records" => vec![
            vec![0],
            vec![0x10, 0, 0, 24, 0, 0, 200],
            vec![0x11, 0, 0, 34, 0, 3, 1, 2, 3],
            vec![0x35, 0, 1, 44, 0, 3, 1, 2, 3],
            vec![8, 0, 40],
        ],
        "repository" => {
            let row = |how: u8, key: &str, value: &[u8]| {
                let how = how | u8::try_from(key.len() << 4).unwrap_or(0);
                [&[0, how], key.as_bytes(), &piece(value)[..]].concat()
            };
            vec![
                row(1, "", &golden("event")),
                row(2, "pins", &golden("repository_block")),
                row(0, "Station1", &[255; 8]),
                row(0b1111, "x", &golden("repository_block")[4..]),
                vec![1, 0, 40, 0, 1, 255],
                vec![1, 1, 4, 0, 1, 255],
            ]
        }
        "diagnosis" => vec![
            [&[1], DIAGNOSIS.as_bytes()].concat(),
            vec![
                0, 8, 0, 1, 2, 3, 4, 5, 6, 7, 8, 0, 1, 1, 1, 0x44, 0, 1, 0, 3,
            ],
        ],
        "agents" => {
            let mut seeds = Vec::new();
            let mut all = Vec::new();
            for envelope in envelopes() {
                let step = [&[0][..], &piece(&body(&envelope))].concat();
                seeds.push(step.clone());
                if all.len() < 3_000 {
                    all.extend_from_slice(&step);
                }
            }
            let image = |driven| [&[4][..], &piece(&body(&input_image(1 << 33, driven)))].concat();
            seeds.push(
                [
                    image(true),
                    vec![7, 255, 15],
                    image(false),
                    vec![7, 255, 15],
                ]
                .concat(),
            );
            seeds.push([image(false), all, vec![7, 255, 15], image(true)].concat());
            seeds.push([&[6][..], &piece(&frame)].concat());
            seeds.push(vec![5, 7, 0, 0x15, 1, 0, 7, 255, 255, 13, 1, 0]);
            seeds
        }
        #[cfg(feature = "diagnosis-file")]
        "caex" | "amlx" | "plcopen" | "diagnosis_file" => models::of(target),
        _ => Vec::new(),
    }
}
