//! The Controller Agent and the composite, driven by tables of input, time and expected outputs.

use crate::controller::{
    LEAVING_IDLE_US, LEAVING_REPEAT_US, LEAVING_WAIT_US, OVERLOAD_REPORTS, REFUSED_REPEAT_US,
    REGISTER_REPEAT_US,
};
use crate::node::{McTotals, NodeAct, NodeAgents, NodeConfig, NodeLocal, NodeOutput, NodeSample};
use fam_proto::access::{McAct, McNews};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::diagnosis::Diagnosis;
use fam_proto::model::{ControllerModel, McModel, Settings};
use fam_proto::{
    AgentId, BootId, CallForProposals, Cause, ControllerId, Envelope, Epoch, GatewayId,
    ImageNumber, InputImage, LayoutHash, McId, Message, Now, Opened, Order, OrderId, OrderKind,
    Owner, ProcessId, Registered, Scan,
};
use std::sync::Arc;

const MANAGER: BootId = BootId(50);

fn mc(name: &str) -> McId {
    McId::new(name).unwrap()
}

fn gateway() -> GatewayId {
    GatewayId::new("gateway1").unwrap()
}

fn me() -> ControllerId {
    ControllerId::new("controller2").unwrap()
}

fn model(name: &str) -> Arc<McModel> {
    Arc::new(McModel {
        mc: mc(name),
        gateway: gateway(),
        hosts: vec![me()],
        criticality: 1,
        cycle_us: 5_000,
        worst_case_us: 300,
        memory_kb: 100,
        watchdog_us: 1_000_000,
        suspect_us: 50_000,
        hash: 1,
        layout: LayoutHash(5),
        diagnosis: Diagnosis {
            state_offset: 0,
            checkpoint_len: 0,
            intervals: Vec::new(),
            stop_action: None,
        },
        inputs: Vec::new(),
        inputs_len: 0,
        outputs: Vec::new(),
        fail_safe: Vec::new(),
    })
}

fn node() -> NodeAgents {
    let config = NodeConfig {
        owner: Owner {
            controller: me(),
            boot: BootId(7),
        },
        model: ControllerModel {
            controller: me(),
            description: "second".to_owned(),
            cpu_factor_permille: 500,
            memory_kb: 1_000,
            limit_permille: 600,
            tick_us: 5_000,
        },
        mcs: vec![model("Station1"), model("Station2")],
        settings: Settings::default(),
        real_time: Vec::new(),
        criteria: vec![("watts".to_owned(), 12)],
    };
    NodeAgents::new(config, Now(0))
}

fn outputs(node: &mut NodeAgents) -> Vec<NodeOutput> {
    std::iter::from_fn(|| node.poll_output()).collect()
}

fn bodies(node: &mut NodeAgents) -> Vec<Message> {
    let sent = |o| match o {
        Output::Send(envelope) => Some(envelope.body),
        _ => None,
    };
    outputs(node).into_iter().filter_map(sent).collect()
}

fn kinds(node: &mut NodeAgents) -> String {
    let words = outputs(node).into_iter().map(|o| match o {
        Output::Send(envelope) => match envelope.body {
            Message::Register(_) => "register",
            Message::Report(_) => "report",
            Message::Qos(event) => match event.cause {
                Cause::Imbalance(_) => "imbalance",
                Cause::Overload(_) => "overload",
                other => panic!("{other:?}"),
            },
            Message::Leaving => "leaving",
            Message::Bid(_) => "bid",
            Message::Holding(_) => "holding",
            Message::OrderReceived(_) => "received",
            Message::McReport(_) => "mc-report",
            Message::Open(_) => "open",
            other => panic!("{other:?}"),
        },
        Output::Act(NodeAct::Leave { left }) if left.is_empty() => "LEAVE",
        Output::Act(NodeAct::Leave { .. }) => "LEAVE BEHIND",
        Output::Act(NodeAct::Mc {
            act: McAct::Activate(_),
            ..
        }) => "RUN",
        Output::Act(_) => "ACT",
        Output::Event(_) => "event",
        Output::Persist { .. } => unreachable!("a node persists nothing"),
    });
    words.collect::<Vec<_>>().join(" ")
}

fn from_manager(to: AgentId, body: Message) -> Input<NodeLocal> {
    Input::Message(Envelope {
        from: AgentId::Manager,
        boot: MANAGER,
        to,
        body,
    })
}

fn to_ca(body: Message) -> Input<NodeLocal> {
    from_manager(AgentId::Controller(me()), body)
}

fn registered() -> Input<NodeLocal> {
    to_ca(Message::Registered(Registered {
        assigned: Vec::new(),
        ineligible: Vec::new(),
    }))
}

fn manager(boot: u64, alive: bool) -> Input<NodeLocal> {
    Input::Peer {
        process: ProcessId::Manager,
        boot: BootId(boot),
        alive,
    }
}

fn an_image() -> Input<NodeLocal> {
    Input::Image(Arc::new(InputImage {
        gateway: gateway(),
        boot: BootId(1),
        number: ImageNumber(3),
        sent_at_us: 0,
        inputs: Vec::new(),
        records: Vec::new(),
        exports: Vec::new(),
    }))
}

fn sample(scans: u64, us_each: u64) -> Input<NodeLocal> {
    Input::Local(NodeLocal::Sample(NodeSample {
        mcs: vec![McTotals {
            mc: mc("Station1"),
            cycle_us: 5_000,
            scans,
            cpu_ns: scans * us_each * 1_000,
            worst_us: u32::try_from(us_each + 40).unwrap(),
            lag_us: 0,
        }],
        ..NodeSample::default()
    }))
}

/// Registered at 0, with its first report and event said.
fn joined() -> NodeAgents {
    let mut n = node();
    n.handle(manager(50, true), Now(0));
    n.handle(registered(), Now(0));
    assert_eq!(kinds(&mut n), "register report imbalance");
    n
}

/// Station1 runs under epoch 5.
fn active(n: &mut NodeAgents) {
    let to = AgentId::Component(me(), mc("Station1"));
    let order = Order {
        id: OrderId(1),
        mc: mc("Station1"),
        kind: OrderKind::Activate {
            epoch: Epoch(5),
            after: None,
            force: false,
            reset: None,
            within_us: 500_000,
        },
    };
    n.handle(from_manager(to.clone(), Message::Order(order)), Now(1));
    let opened = Message::Opened(Opened {
        mc: mc("Station1"),
        epoch: Epoch(5),
        base: None,
        checkpoint: None,
        outputs: Vec::new(),
        phase: None,
        interrupted: true,
        fail_safe: false,
        next_scan: Scan(1),
        reset: None,
        owner: Owner {
            controller: me(),
            boot: BootId(7),
        },
    });
    let envelope = Envelope {
        from: AgentId::Gateway(gateway()),
        boot: BootId(1),
        to,
        body: opened,
    };
    n.handle(Input::Message(envelope), Now(2));
    let news = McNews::Started { epoch: Epoch(5) };
    n.handle(
        Input::Local(NodeLocal::Mc {
            mc: mc("Station1"),
            news,
        }),
        Now(3),
    );
    assert_eq!(kinds(n), "received open RUN mc-report");
}

fn word_of(boot: u64) -> Input<NodeLocal> {
    Input::Message(Envelope {
        from: AgentId::Manager,
        boot: BootId(boot),
        to: AgentId::Controller(me()),
        body: Message::Registered(Registered {
            assigned: Vec::new(),
            ineligible: Vec::new(),
        }),
    })
}

/// Its wall clock was set back, or a second manager has come and gone: the highest boot id is not the one that lives.
#[test]
fn a_manager_with_a_lower_boot_is_heeded_once_the_one_before_is_gone() {
    let mut n = joined();
    // Both live: the later one counts.
    n.handle(manager(40, true), Now(10));
    n.handle(word_of(40), Now(11));
    assert_eq!(kinds(&mut n), "");
    n.handle(manager(50, false), Now(20));
    assert_eq!(kinds(&mut n), "");
    n.handle(word_of(40), Now(30));
    assert_eq!(kinds(&mut n), "register report");
    assert!(n.controller().is_registered());
    // Late words of the one that is gone change nothing.
    n.handle(word_of(50), Now(40));
    assert_eq!(kinds(&mut n), "");
    // It was only out of sight: the later one counts again.
    n.handle(manager(50, true), Now(50));
    assert_eq!(kinds(&mut n), "register");
    n.handle(word_of(40), Now(60));
    assert_eq!(kinds(&mut n), "");
}

#[test]
fn it_registers_until_answered_and_again_with_each_new_manager() {
    let mut n = node();
    for at in [0, REGISTER_REPEAT_US, 2 * REGISTER_REPEAT_US] {
        assert_eq!(n.poll_timeout(), Some((Now(at), "register")));
        n.handle_timeout(Now(at));
        assert_eq!(kinds(&mut n), "register");
    }
    n.handle(registered(), Now(250_000));
    // the word came from a manager that was not known: it is asked anew, and its word taken
    assert_eq!(kinds(&mut n), "register report imbalance");
    assert_eq!(n.poll_timeout(), Some((Now(350_000), "report")));
    n.handle_timeout(Now(350_000));
    n.handle_timeout(Now(350_001));
    assert_eq!(kinds(&mut n), "report");

    n.handle(manager(50, false), Now(360_000));
    n.handle_timeout(Now(460_000));
    assert_eq!(kinds(&mut n), "register");
    active(&mut n);
    n.handle(manager(60, true), Now(470_000));
    let sent = bodies(&mut n);
    let [Message::Register(registration)] = sent.as_slice() else {
        panic!("{sent:?}");
    };
    assert_eq!(registration.active, [(mc("Station1"), Epoch(5))]);
    assert_eq!(registration.mcs.len(), 2);
    // late words of the manager that was before
    n.handle(manager(50, true), Now(480_000));
    n.handle(registered(), Now(481_000));
    assert_eq!(kinds(&mut n), "");
    assert!(!n.controller().is_registered());
}

#[test]
fn a_refusal_is_told_once_and_the_node_keeps_trying() {
    let mut n = node();
    n.handle(manager(50, true), Now(0));
    let refused = || {
        to_ca(Message::RegistrationRefused(
            "another controller2 is up".to_owned(),
        ))
    };
    n.handle(refused(), Now(10));
    assert_eq!(kinds(&mut n), "register event");
    assert_eq!(n.controller().refusal(), Some("another controller2 is up"));
    n.handle_timeout(Now(10 + REFUSED_REPEAT_US));
    n.handle(refused(), Now(20 + REFUSED_REPEAT_US));
    assert_eq!(kinds(&mut n), "register");
}

#[test]
fn a_stall_is_no_workload_and_what_lasts_is() {
    // CPU time of the 20 scans of each interval, in microseconds each, and the workload then said: 300 us of 5 ms at a limit of
    // 60 % are 100 permille.
    let intervals = [
        (300, 100..=100),
        (300, 100..=100),
        (700, 130..=136), // 8 ms in which the machine did something else
        (300, 120..=130),
        (300, 115..=120),
        (600, 130..=145),
        (600, 145..=165),
        (600, 155..=175),
        (600, 165..=185),
        (600, 170..=195),
    ];
    let mut n = joined();
    let (mut scans, mut total_us) = (0, 0);
    for (at, (us_each, expected)) in (1..).zip(intervals) {
        scans += 20;
        total_us += 20 * us_each;
        let mut sample = sample(scans, 0);
        if let Input::Local(NodeLocal::Sample(sample)) = &mut sample {
            sample.mcs[0].cpu_ns = total_us * 1_000;
        }
        n.handle(sample, Now(at * 100_000 - 10_000));
        n.handle_timeout(Now(at * 100_000));
        let Some(Message::Report(report)) = bodies(&mut n).pop() else {
            panic!("no report at {at}");
        };
        let said = report.workload_permille;
        assert!(expected.contains(&said), "interval {at}: {said}");
    }
}

#[test]
fn a_report_tells_the_workload_of_the_interval() {
    let mut n = joined();
    // 300 us of 5 ms are 6 %; the limit is 60 %
    n.handle(sample(20, 300), Now(90_000));
    n.handle_timeout(Now(100_000));
    let sent = bodies(&mut n);
    let [Message::Report(report)] = sent.as_slice() else {
        panic!("{sent:?}");
    };
    assert_eq!(report.workload_permille, 100);
    assert_eq!(
        (
            report.mcs[0].scan_us_mean,
            report.mcs[0].scan_us_worst,
            report.mcs[0].scans
        ),
        (300, 340, 20)
    );
    assert_eq!(report.image_age_us, u64::MAX);
    // nothing has run since: the mean stands
    n.handle_timeout(Now(200_000));
    let Some(Message::Report(report)) = bodies(&mut n).pop() else {
        panic!();
    };
    assert_eq!((report.workload_permille, report.mcs[0].scans), (100, 0));
}

#[test]
fn an_overload_that_lasts_is_told_once_until_it_is_over() {
    let mut n = joined();
    let mut told = Vec::new();
    let mut scans = 0;
    let mut cpu = 0;
    for round in 1..=8u64 {
        // 3.2 ms of 5 ms against 60 %; in round 6 only 1 ms
        let us = if round == 6 { 1_000 } else { 3_200 };
        scans += 20;
        cpu += 20 * us * 1_000;
        let Input::Local(NodeLocal::Sample(mut s)) = sample(scans, 0) else {
            unreachable!()
        };
        s.mcs[0].cpu_ns = cpu;
        n.handle(Input::Local(NodeLocal::Sample(s)), Now(round * 100_000));
        n.handle_timeout(Now(round * 100_000));
        if kinds(&mut n).contains("overload") {
            told.push(round);
        }
    }
    assert_eq!(told, [u64::from(OVERLOAD_REPORTS)]);
}

#[test]
fn a_bid_says_what_is_true_now() {
    let mut n = joined();
    let call = || {
        Input::Message(Envelope {
            from: AgentId::Decision,
            boot: MANAGER,
            to: AgentId::Controller(me()),
            body: Message::CallForProposals(CallForProposals {
                negotiation: 4,
                mcs: vec![mc("Station1"), mc("Station2"), mc("Lid")],
                criteria: vec!["watts".to_owned()],
                within_us: 20_000,
            }),
        })
    };
    let bid = |n: &mut NodeAgents| {
        let sent = bodies(n);
        assert_eq!(
            sent.iter()
                .filter(|m| matches!(m, Message::Holding(h) if h.negotiation == 4))
                .count(),
            2
        );
        match sent.into_iter().find(|m| matches!(m, Message::Bid(_))) {
            Some(Message::Bid(bid)) => bid,
            _ => panic!("no bid"),
        }
    };
    n.handle(call(), Now(1_000));
    let blind = bid(&mut n);
    let unable: Vec<_> = blind
        .offers
        .iter()
        .map(|o| o.unable.clone().unwrap())
        .collect();
    assert_eq!(
        unable,
        [
            "controller2 has had no input image of gateway1",
            "controller2 has had no input image of gateway1",
            "controller2 does not host it"
        ]
    );
    assert_eq!(blind.criteria, [("watts".to_owned(), 12)]);
    // declared 300 us at factor 1.0 are 600 us at 0.5
    assert_eq!(blind.offers[0].worst_case_us, 600);

    n.handle(an_image(), Now(2_000));
    n.handle(sample(20, 300), Now(3_000));
    active(&mut n);
    n.handle(call(), Now(4_000));
    let able = bid(&mut n);
    assert_eq!(able.offers[0].unable, None);
    assert_eq!(able.offers[0].worst_case_us, 340);
    assert_eq!((able.workload_permille, able.memory_free_kb), (100, 900));
    assert_eq!(able.image_age_us, 2_000);

    n.handle(call(), Now(200_000));
    assert_eq!(
        bid(&mut n).offers[1].unable.as_deref(),
        Some("controller2's newest input image of gateway1 is 198 ms old")
    );
    n.handle(an_image(), Now(200_000));
    n.handle(
        to_ca(Message::Registered(Registered {
            assigned: Vec::new(),
            ineligible: vec![(mc("Station2"), "another hash is in force".to_owned())],
        })),
        Now(200_000),
    );
    n.handle(call(), Now(200_001));
    // which may have been the answer to the life before
    assert_eq!(bid(&mut n).offers[1].unable, None);
}

fn may_leave(behind: &[&str]) -> Message {
    Message::MayLeave {
        behind: behind.iter().map(|name| mc(name)).collect(),
    }
}

#[test]
fn it_leaves_when_it_may_and_nothing_runs() {
    let mut n = joined();
    active(&mut n);
    n.handle(Input::Local(NodeLocal::Terminate), Now(10));
    n.handle(Input::Local(NodeLocal::Terminate), Now(11));
    assert_eq!(kinds(&mut n), "leaving");
    // an order has crossed the word: what runs has to go first
    n.handle(to_ca(may_leave(&[])), Now(12));
    assert_eq!(kinds(&mut n), "");
    n.handle_timeout(Now(10 + LEAVING_REPEAT_US));
    assert_eq!(kinds(&mut n), "report leaving");
    let news = McNews::Released {
        epoch: Epoch(5),
        scan: Scan(3),
    };
    n.handle(
        Input::Local(NodeLocal::Mc {
            mc: mc("Station1"),
            news,
        }),
        Now(200_000),
    );
    n.handle(to_ca(may_leave(&[])), Now(200_001));
    assert_eq!(kinds(&mut n), "mc-report LEAVE");
    n.handle(to_ca(may_leave(&[])), Now(200_002));
    n.handle_timeout(Now(LEAVING_WAIT_US * 2));
    assert_eq!(kinds(&mut n), "report");
}

#[test]
fn what_nobody_else_can_take_is_left_behind_at_once() {
    let mut n = joined();
    active(&mut n);
    n.handle(Input::Local(NodeLocal::Terminate), Now(10));
    n.handle(to_ca(may_leave(&["Station2"])), Now(11));
    assert_eq!(kinds(&mut n), "leaving", "Station1 has a place elsewhere");
    n.handle(to_ca(may_leave(&["Station1", "Station2"])), Now(12));
    assert!(outputs(&mut n).contains(&Output::Act(NodeAct::Leave {
        left: vec![mc("Station1")]
    })));
}

#[test]
fn a_leave_that_nobody_answers_is_bounded_and_says_what_is_left() {
    let mut idle = node();
    idle.handle(Input::Local(NodeLocal::Terminate), Now(0));
    idle.handle_timeout(Now(LEAVING_IDLE_US));
    assert!(kinds(&mut idle).ends_with("LEAVE"));

    let mut n = joined();
    active(&mut n);
    n.handle(Input::Local(NodeLocal::Terminate), Now(10));
    n.handle_timeout(Now(LEAVING_IDLE_US + 10));
    assert!(!kinds(&mut n).contains("LEAVE"));
    n.handle_timeout(Now(LEAVING_WAIT_US + 10));
    let said = outputs(&mut n);
    let text = said.iter().find_map(|o| match o {
        Output::Event(event) => Some(event.text.clone()),
        _ => None,
    });
    let seconds = LEAVING_WAIT_US / 1_000_000;
    assert_eq!(
        text,
        Some(format!(
            "controller2 leaves Station1 behind: not handed over within {seconds} s; the gateway will set the fail-safe values"
        ))
    );
    assert!(said.contains(&Output::Act(NodeAct::Leave {
        left: vec![mc("Station1")]
    })));
}

#[test]
fn messages_for_others_or_from_the_wrong_sender_change_nothing() {
    let mut n = joined();
    let before = n.clone();
    let component = AgentId::Component(me(), mc("Station1"));
    let order = || {
        Message::Order(Order {
            id: OrderId(9),
            mc: mc("Station1"),
            kind: OrderKind::Stop { epoch: Epoch(1) },
        })
    };
    let stranger = AgentId::Gateway(GatewayId::new("gateway2").unwrap());
    for (from, to, body) in [
        (stranger, component.clone(), order()),
        (AgentId::Client(1), component, order()),
        (
            AgentId::Manager,
            AgentId::Component(me(), mc("Lid")),
            order(),
        ),
        (
            AgentId::Manager,
            AgentId::Component(me(), mc("Station2")),
            order(),
        ),
        (
            AgentId::Manager,
            AgentId::Controller(ControllerId::new("controller1").unwrap()),
            may_leave(&[]),
        ),
    ] {
        let envelope = Envelope {
            from,
            boot: MANAGER,
            to,
            body,
        };
        n.handle(Input::Message(envelope), Now(5));
        assert_eq!(kinds(&mut n), "");
        assert!(n == before);
    }
}
