//! The full table: every state with every event, and the ways through the sub-states of an opening.

use super::diagnose::tests::{CARRY, PRESS, STOP, a_checkpoint, a_diagnosis, a_grant};
use super::*;
use fam_proto::access::{Start, StateSource};
use fam_proto::agent::Output;
use fam_proto::{
    ControllerId, ImageNumber, OpenRefusal, OpenRefused, OrderKind, Phase, RecordState,
    RecordSummary, Reset, Scan,
};

const MANAGER: BootId = BootId(50);

fn owner(name: &str, boot: u64) -> Owner {
    Owner {
        controller: ControllerId::new(name).unwrap(),
        boot: BootId(boot),
    }
}

fn me() -> Owner {
    owner("controller2", 7)
}

fn agent(stop: bool) -> McAgent {
    McAgent::new(ComponentConfig {
        owner: me(),
        mc: McId::new("Station1").unwrap(),
        gateway: GatewayId::new("gateway1").unwrap(),
        layout: LayoutHash(5),
        diagnosis: a_diagnosis(stop),
    })
}

fn order(id: u64, kind: OrderKind) -> Order {
    Order {
        id: OrderId(id),
        mc: McId::new("Station1").unwrap(),
        kind,
    }
}

fn activate(id: u64, epoch: u64, after: Option<Owner>) -> Order {
    order(
        id,
        OrderKind::Activate {
            epoch: Epoch(epoch),
            after,
            force: false,
            reset: None,
            within_us: 500_000,
        },
    )
}

fn release(id: u64, epoch: u64) -> Order {
    let successor = Successor {
        epoch: Epoch(epoch + 1),
        owner: owner("controller1", 3),
    };
    order(
        id,
        OrderKind::Release {
            epoch: Epoch(epoch),
            successor,
            within_us: 5_000_000,
        },
    )
}

fn trap() -> TrapInfo {
    TrapInfo {
        pou: "Station1".to_owned(),
        file: "station1.st".to_owned(),
        line: 12,
        message: "division by zero".to_owned(),
    }
}

fn record(epoch: u64, owner: Owner, state: RecordState) -> RecordSummary {
    RecordSummary {
        mc: McId::new("Station1").unwrap(),
        epoch: Epoch(epoch),
        owner: Some(owner),
        state,
        head: None,
        phase: None,
        driven: true,
        silent_us: 0,
        suspect: false,
        rejected: 0,
    }
}

fn image(record: RecordSummary) -> InputImage {
    InputImage {
        gateway: GatewayId::new("gateway1").unwrap(),
        boot: BootId(1),
        number: ImageNumber(9),
        sent_at_us: 0,
        inputs: Vec::new(),
        records: vec![record],
    }
}

/// What has come out, in short words.
fn words(agent: &mut McAgent) -> String {
    let mut words = Vec::new();
    while let Some(output) = agent.poll_output() {
        words.push(match output {
            Output::Send(envelope) => match envelope.body {
                Message::OrderReceived(_) => continue,
                Message::Open(open) if open.held.is_none() => "open".to_owned(),
                Message::Open(_) => "open(held)".to_owned(),
                Message::Close(_) => "close".to_owned(),
                Message::Holding(_) => "holding".to_owned(),
                Message::McReport(report) => {
                    let word = match report.outcome {
                        McOutcome::Activated { recovery, .. } => format!("activated {recovery}"),
                        McOutcome::NotOpened(_) => "not opened".to_owned(),
                        McOutcome::Recovered => "recovered".to_owned(),
                        McOutcome::Released { .. } => "released".to_owned(),
                        McOutcome::ReleaseCancelled(_) => "cancelled".to_owned(),
                        McOutcome::Stopped => "stopped".to_owned(),
                        McOutcome::Faulted(_) => "faulted".to_owned(),
                        McOutcome::Deposed(_) => "deposed".to_owned(),
                        McOutcome::Changed => "changed".to_owned(),
                    };
                    let order = report.order.map_or(String::new(), |o| format!(" #{o}"));
                    format!("<{word}{order}>")
                }
                other => panic!("unexpected {other:?}"),
            },
            Output::Act(NodeAct::Mc { act, .. }) => match act {
                McAct::ReadState { .. } => "READ".to_owned(),
                McAct::Activate(a) => format!(
                    "RUN {}{}{}",
                    a.recovery,
                    if a.keep_action { " kept" } else { "" },
                    match a.start {
                        Start::Initial => " initial",
                        Start::From {
                            retained_only: true,
                            ..
                        } => " retained",
                        Start::From {
                            source: StateSource::Held(_),
                            ..
                        } => " held",
                        Start::From { .. } => " given",
                    }
                ),
                McAct::Release { .. } => "RELEASE".to_owned(),
                McAct::CancelRelease { .. } => "CANCEL".to_owned(),
                McAct::RunAction { action, .. } => format!("ACTION {action}"),
                McAct::Deactivate { .. } => "OFF".to_owned(),
            },
            other => panic!("unexpected {other:?}"),
        });
    }
    words.join(" ")
}

fn grant(step: i32, phase: Phase, interrupted: bool) -> Message {
    Message::Opened(a_grant(Some(&a_checkpoint(step, phase)), interrupted))
}

fn refusal(why: OpenRefusal) -> Message {
    Message::OpenRefused(OpenRefused {
        mc: McId::new("Station1").unwrap(),
        epoch: Epoch(5),
        why,
        record: None,
    })
}

const E: Epoch = Epoch(5);

/// An agent in the state named, under epoch 5, with nothing left to be said.
fn in_state(name: &str) -> McAgent {
    let mut a = agent(name != "faulted");
    let now = Now(0);
    let run = |a: &mut McAgent, step| {
        a.order(MANAGER, activate(1, 5, None), now);
        a.gateway_message(grant(step, Phase::Running, true), now);
        a.news(McNews::Started { epoch: E }, now);
    };
    match name {
        "passive" => {}
        "opening" => a.order(MANAGER, activate(1, 5, None), now),
        "active" => run(&mut a, 10),
        "releasing" => {
            run(&mut a, 10);
            a.order(MANAGER, release(2, 5), now);
        }
        "recovering" => run(&mut a, 40),
        "stopped" => {
            run(&mut a, 50);
            a.news(
                McNews::Stopped {
                    epoch: E,
                    scan: Scan(90),
                },
                now,
            );
        }
        "faulted" => {
            run(&mut a, 10);
            a.news(
                McNews::Trapped {
                    epoch: E,
                    trap: trap(),
                },
                now,
            );
        }
        other => panic!("no state {other}"),
    }
    let state = format!("{:?}", a.state()).to_lowercase();
    assert_eq!(state, name);
    words(&mut a);
    a
}

const STATES: [&str; 7] = [
    "passive",
    "opening",
    "active",
    "releasing",
    "recovering",
    "stopped",
    "faulted",
];

fn apply(a: &mut McAgent, event: &str) {
    let now = Now(600_000_000);
    let soon = Now(1_000);
    let scan = Scan(91);
    let word = || "a reason".to_owned();
    match event {
        "activate 6" => a.order(MANAGER, activate(8, 6, None), soon),
        "release 5" => a.order(MANAGER, release(8, 5), soon),
        "release 4" => a.order(MANAGER, release(8, 4), soon),
        "cancel 5" => a.order(
            MANAGER,
            order(8, OrderKind::CancelRelease { epoch: E }),
            soon,
        ),
        "stop 5" => a.order(MANAGER, order(8, OrderKind::Stop { epoch: E }), soon),
        "opened 5" => a.gateway_message(grant(10, Phase::Running, true), soon),
        "refused 5" => a.gateway_message(refusal(OpenRefusal::StaleEpoch), soon),
        "fresh 5" => a.gateway_message(refusal(OpenRefusal::OwnerFresh), soon),
        "state" => a.news(
            McNews::State {
                id: a_checkpoint(10, Phase::Running).id,
                checkpoint: None,
            },
            soon,
        ),
        "handed 5" => a.news(
            McNews::Handed(Successor {
                epoch: E,
                owner: me(),
            }),
            soon,
        ),
        "open on record" => a.image(&image(record(5, me(), RecordState::Open)), soon),
        "late record" => a.image(
            &image(record(4, owner("controller1", 3), RecordState::FailSafe)),
            soon,
        ),
        "higher record" => a.image(
            &image(record(6, owner("controller1", 3), RecordState::Open)),
            soon,
        ),
        "other owner" => a.image(
            &image(record(5, owner("controller1", 3), RecordState::Open)),
            soon,
        ),
        "fail-safe" => a.image(&image(record(5, me(), RecordState::FailSafe)), soon),
        "closed" => a.image(&image(record(5, me(), RecordState::Closed)), soon),
        "fault on record" => a.image(&image(record(5, me(), RecordState::Faulted(trap()))), soon),
        "started" => a.news(McNews::Started { epoch: E }, soon),
        "not started" => a.news(
            McNews::NotStarted {
                epoch: E,
                why: word(),
            },
            soon,
        ),
        "recovered" => a.news(McNews::Recovered { epoch: E, scan }, soon),
        "released" => a.news(McNews::Released { epoch: E, scan }, soon),
        "cancelled" => a.news(
            McNews::ReleaseCancelled {
                epoch: E,
                why: word(),
            },
            soon,
        ),
        "ended" => a.news(McNews::Stopped { epoch: E, scan }, soon),
        "trapped" => a.news(
            McNews::Trapped {
                epoch: E,
                trap: trap(),
            },
            soon,
        ),
        "deposed" => a.news(
            McNews::Deposed {
                epoch: E,
                why: word(),
            },
            soon,
        ),
        "late news" => a.news(
            McNews::Deposed {
                epoch: Epoch(4),
                why: word(),
            },
            soon,
        ),
        "timeout" => a.handle_timeout(now),
        other => panic!("no event {other}"),
    }
}

/// Rows: events. Columns: passive, opening, active, releasing, recovering, stopped, faulted. A cell: the state after, then
/// what came out: messages to the gateway in small letters, acts on the MC in capitals, reports in angle brackets.
/// `=` stands for: nothing happens.
const TABLE: &str = "
activate 6      | opening open | opening open | active <not opened #8> | releasing <not opened #8> | recovering <not opened #8> | opening open | opening open
release 5       | passive <cancelled #8> | opening <cancelled #8> | releasing RELEASE | releasing RELEASE | releasing RELEASE | stopped <cancelled #8> | faulted <cancelled #8>
release 4       | passive <cancelled #8> | opening <cancelled #8> | active <cancelled #8> | active <cancelled #8> | recovering <cancelled #8> | stopped <cancelled #8> | faulted <cancelled #8>
cancel 5        | passive <changed #8> | passive <not opened #1> | active <changed #8> | releasing CANCEL | recovering <changed #8> | stopped <changed #8> | faulted <changed #8>
stop 5          | passive <changed #8> | passive <not opened #8> | recovering ACTION 9 <changed> | recovering ACTION 9 <changed> | recovering ACTION 9 <changed> | stopped <stopped #8> | faulted <changed #8>
opened 5        | = | opening RUN 0 given | = | = | = | = | =
refused 5       | = | passive <not opened #1> | = | = | = | = | =
fresh 5         | = | = | = | = | = | = | =
state           | = | = | = | = | = | = | =
handed 5        | = | = | = | = | = | = | =
open on record  | = | = | = | = | = | = | =
late record     | = | = | = | = | = | = | =
higher record   | = | passive <not opened #1> | passive OFF <deposed> | = | passive OFF <deposed> | passive <changed> | passive <changed>
other owner     | = | passive <not opened #1> | passive OFF <deposed> | passive OFF <deposed> | passive OFF <deposed> | = | =
fail-safe       | = | passive <not opened #1> | passive OFF <deposed> | passive OFF <deposed> | passive OFF <deposed> | = | =
closed          | = | passive <not opened #1> | passive OFF <deposed> | passive OFF <deposed> | passive OFF <deposed> | = | =
fault on record | = | passive <not opened #1> | passive OFF <deposed> | passive OFF <deposed> | passive OFF <deposed> | = | =
started         | = | = | = | = | = | = | =
not started     | = | passive <not opened #1> | = | = | = | = | =
recovered       | = | = | = | releasing <recovered> | active <recovered> | = | =
released        | = | = | passive <released> | passive <released #2> | passive <released> | = | =
cancelled       | = | = | = | active <cancelled #2> | = | = | =
ended           | = | = | stopped <stopped> | stopped <stopped #2> | stopped <stopped> | = | =
trapped         | = | = | recovering ACTION 9 <faulted> | recovering ACTION 9 <faulted> | recovering ACTION 9 <faulted> | = | =
deposed         | = | passive <not opened #1> | passive OFF <deposed> | passive OFF <deposed> | passive OFF <deposed> | = | =
late news       | = | = | = | = | = | = | =
timeout         | = | passive <not opened #1> | = | releasing CANCEL | = | = | faulted close
";

#[test]
fn every_state_answers_every_event() {
    let mut events = 0;
    for row in TABLE.lines().filter(|line| !line.trim().is_empty()) {
        let mut cells = row.split('|').map(str::trim);
        let event = cells.next().unwrap();
        events += 1;
        for name in STATES {
            let expected = cells.next().expect("a cell for each state");
            let mut a = in_state(name);
            let before = a.clone();
            apply(&mut a, event);
            let out = words(&mut a);
            let state = format!("{:?}", a.state()).to_lowercase();
            if expected == "=" {
                assert_eq!(
                    (state.as_str(), out.as_str()),
                    (name, ""),
                    "{event} in {name}"
                );
                if !matches!(event, "handed 5" | "fresh 5" | "fault on record") {
                    let (mut a, mut before) = (a, before);
                    (a.out, before.out) = Default::default();
                    if name != "faulted" {
                        assert_eq!(a.state, before.state, "{event} in {name}");
                    }
                }
            } else {
                let got = format!("{state} {out}");
                assert_eq!(got.trim(), expected, "{event} in {name}");
            }
        }
        assert_eq!(cells.next(), None, "{event}");
    }
    assert_eq!(events, 27);
}

#[test]
fn an_open_is_repeated_until_it_is_answered() {
    let mut a = agent(true);
    a.order(MANAGER, activate(1, 5, None), Now(10));
    assert_eq!(words(&mut a), "open");
    for repeat in 1..4 {
        let at = Now(10 + repeat * OPEN_REPEAT_US);
        assert_eq!(a.poll_timeout().unwrap().0, at);
        a.handle_timeout(at);
        assert_eq!(words(&mut a), "open");
        a.gateway_message(refusal(OpenRefusal::OwnerFresh), at);
    }
    // not before its time
    a.handle_timeout(Now(11 + 3 * OPEN_REPEAT_US));
    assert_eq!(words(&mut a), "");
    a.gateway_message(grant(10, Phase::Running, true), Now(9_000));
    a.gateway_message(grant(10, Phase::Running, true), Now(9_001));
    assert_eq!(words(&mut a), "RUN 0 given");
    a.news(McNews::Started { epoch: E }, Now(9_100));
    assert_eq!(words(&mut a), "<activated 0 #1>");
    // a refusal of a repetition that crossed the grant
    a.gateway_message(refusal(OpenRefusal::StaleEpoch), Now(9_200));
    assert_eq!(
        (words(&mut a), a.state()),
        (String::new(), McaState::Active)
    );
}

#[test]
fn the_deadline_names_what_it_waited_for() {
    let reason = |prepare: &dyn Fn(&mut McAgent)| {
        let mut a = agent(true);
        prepare(&mut a);
        words(&mut a);
        a.handle_timeout(Now(500_000));
        match a.answered.clone().unwrap().outcome {
            McOutcome::NotOpened(why) => why,
            other => panic!("{other:?}"),
        }
    };
    let silent = reason(&|a| a.order(MANAGER, activate(1, 5, None), Now(0)));
    assert_eq!(silent, "gateway gateway1 did not answer within 500 ms");
    let fresh = reason(&|a| {
        a.order(MANAGER, activate(1, 5, None), Now(0));
        a.gateway_message(refusal(OpenRefusal::OwnerFresh), Now(1));
    });
    assert_eq!(
        fresh,
        "gateway gateway1 refused for 500 ms: the owner is healthy"
    );
    let waiting = reason(&|a| {
        a.order(
            MANAGER,
            activate(1, 5, Some(owner("controller1", 3))),
            Now(0),
        );
    });
    assert_eq!(
        waiting,
        "controller1 (boot 3) has not released it within 500 ms"
    );
}

#[test]
fn a_handover_opens_when_the_release_is_seen_in_frame_or_record() {
    let us = Successor {
        epoch: E,
        owner: me(),
    };
    let waits = activate(1, 5, Some(owner("controller1", 3)));
    // by the frame
    let mut a = agent(true);
    a.held(a_checkpoint(10, Phase::Running).id);
    a.order(MANAGER, waits.clone(), Now(0));
    assert_eq!(words(&mut a), "");
    a.news(McNews::Handed(us.clone()), Now(5));
    assert_eq!(words(&mut a), "open(held)");
    // by the record
    let released = record(
        4,
        owner("controller1", 3),
        RecordState::Released(us.clone()),
    );
    let mut a = agent(true);
    a.order(MANAGER, waits.clone(), Now(0));
    a.image(&image(released.clone()), Now(5));
    a.image(&image(released.clone()), Now(6));
    assert_eq!(words(&mut a), "open");
    // seen before the order came
    let mut a = agent(true);
    a.image(&image(released), Now(1));
    a.order(MANAGER, waits.clone(), Now(2));
    assert_eq!(words(&mut a), "open");
    // released to somebody else: not ours to open
    let mut a = agent(true);
    a.order(MANAGER, waits, Now(0));
    a.news(
        McNews::Handed(Successor {
            epoch: E,
            owner: owner("controller3", 1),
        }),
        Now(5),
    );
    assert_eq!(words(&mut a), "");
}

#[test]
fn the_held_state_is_read_and_diagnosed_or_the_gateway_asked_for_its_copy() {
    let checkpoint = a_checkpoint(40, Phase::Running);
    let held_grant = || {
        let mut grant = a_grant(Some(&checkpoint), true);
        grant.checkpoint = None;
        Message::Opened(grant)
    };
    let mut a = agent(true);
    a.held(checkpoint.id);
    a.order(MANAGER, activate(1, 5, None), Now(0));
    a.gateway_message(held_grant(), Now(1));
    assert_eq!(words(&mut a), "open(held) READ");
    let mut gone = a.clone();
    let state = |checkpoint| McNews::State {
        id: a_checkpoint(40, Phase::Running).id,
        checkpoint,
    };
    a.news(state(Some(Arc::new(checkpoint.clone()))), Now(2));
    assert_eq!(words(&mut a), format!("RUN {CARRY} held"));
    a.news(McNews::Started { epoch: E }, Now(3));
    assert_eq!(words(&mut a), format!("<activated {CARRY} #1>"));
    assert_eq!(a.state(), McaState::Recovering);

    gone.news(state(None), Now(2));
    assert_eq!(words(&mut gone), "open");
    gone.gateway_message(grant(50, Phase::Running, true), Now(3));
    assert_eq!(words(&mut gone), format!("RUN {PRESS} given"));
}

#[test]
fn a_damaged_or_foreign_checkpoint_is_never_run() {
    let mut damaged = a_checkpoint(10, Phase::Running);
    damaged.state[3] ^= 1;
    let mut a = in_state("opening");
    a.gateway_message(Message::Opened(a_grant(Some(&damaged), true)), Now(1));
    assert_eq!((words(&mut a).as_str(), a.state()), ("", McaState::Opening));
    let mut foreign = a_checkpoint(10, Phase::Running);
    foreign.layout = LayoutHash(6);
    a.gateway_message(Message::Opened(a_grant(Some(&foreign), true)), Now(1));
    assert_eq!(words(&mut a), "<not opened #1>");
    match a.answered.unwrap().outcome {
        McOutcome::NotOpened(why) => assert!(why.contains("another layout"), "{why}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn repeated_and_stale_orders_are_answered_but_not_carried_out() {
    let received = |a: &mut McAgent| {
        let mut received = 0;
        let mut others = 0;
        while let Some(output) = a.poll_output() {
            match output {
                Output::Send(Envelope {
                    body: Message::OrderReceived(_),
                    ..
                }) => received += 1,
                _ => others += 1,
            }
        }
        (received, others)
    };
    let mut a = in_state("active");
    a.order(MANAGER, release(2, 5), Now(0));
    assert_eq!(received(&mut a), (1, 1));
    a.order(MANAGER, release(2, 5), Now(0));
    assert_eq!(received(&mut a), (1, 0));
    a.order(MANAGER, activate(1, 5, None), Now(0));
    assert_eq!(received(&mut a), (1, 0));
    let scan = Scan(80);
    a.news(McNews::Released { epoch: E, scan }, Now(1));
    assert_eq!(received(&mut a), (0, 1));
    // the outcome is told again
    a.order(MANAGER, release(2, 5), Now(2));
    assert_eq!(received(&mut a), (1, 1));
    // a new manager counts anew, and the old one is heard no more
    a.order(BootId(60), activate(1, 9, None), Now(3));
    assert_eq!((received(&mut a), a.epoch()), ((1, 1), Some(Epoch(9))));
    a.order(MANAGER, activate(70, 12, None), Now(4));
    assert_eq!((received(&mut a), a.epoch()), ((0, 0), Some(Epoch(9))));
}

#[test]
fn a_trap_is_answered_by_the_stop_pou_and_a_second_one_by_fail_safe() {
    let mut a = in_state("recovering");
    let trapped = || McNews::Trapped {
        epoch: E,
        trap: trap(),
    };
    a.news(trapped(), Now(1));
    assert_eq!(words(&mut a), format!("ACTION {STOP} <faulted>"));
    let mut ended = a.clone();
    ended.news(
        McNews::Stopped {
            epoch: E,
            scan: Scan(99),
        },
        Now(2),
    );
    assert_eq!(
        (words(&mut ended).as_str(), ended.state()),
        ("<stopped>", McaState::Faulted)
    );
    a.news(trapped(), Now(2));
    assert_eq!(words(&mut a), "OFF close <faulted>");
    assert_eq!(a.state(), McaState::Faulted);
    let at = Now(2 + CLOSE_REPEAT_US);
    assert_eq!(a.poll_timeout().unwrap().0, at);
    a.handle_timeout(at);
    assert_eq!(words(&mut a), "close");
    a.image(&image(record(5, me(), RecordState::Faulted(trap()))), at);
    assert_eq!(a.poll_timeout(), None);
}

#[test]
fn a_trap_in_an_unrecoverable_intervals_action_still_has_the_stop_pou() {
    let mut a = agent(true);
    a.order(MANAGER, activate(1, 5, None), Now(0));
    a.gateway_message(grant(50, Phase::Running, true), Now(0));
    a.news(McNews::Started { epoch: E }, Now(0));
    words(&mut a);
    a.order(MANAGER, release(2, 5), Now(1));
    assert_eq!(words(&mut a), "<cancelled #2>");
    a.news(
        McNews::Trapped {
            epoch: E,
            trap: trap(),
        },
        Now(1),
    );
    assert_eq!(words(&mut a), format!("ACTION {STOP} <faulted>"));
}

#[test]
fn resets_reach_the_variables() {
    for (reset, expected) in [
        (Reset::Cold, "RUN 0 initial"),
        (Reset::Warm, "RUN 0 retained"),
        (Reset::Resume, "RUN 1 given"),
    ] {
        let mut a = in_state("stopped");
        let kind = OrderKind::Activate {
            epoch: Epoch(6),
            after: None,
            force: false,
            reset: Some(reset),
            within_us: 500_000,
        };
        a.order(MANAGER, order(9, kind), Now(5));
        assert_eq!(words(&mut a), "open");
        let mut opened = a_grant(Some(&a_checkpoint(40, Phase::Stopped)), true);
        opened.epoch = Epoch(6);
        opened.reset = Some(reset);
        if reset == Reset::Cold {
            (opened.base, opened.checkpoint) = (None, None);
        }
        a.gateway_message(Message::Opened(opened), Now(6));
        assert_eq!(words(&mut a), expected);
    }
}

#[test]
fn no_way_back_means_fail_safe_values() {
    let mut a = agent(false);
    a.order(MANAGER, activate(1, 5, None), Now(0));
    a.gateway_message(grant(60, Phase::Recovering(3), true), Now(0));
    assert_eq!(words(&mut a), "open close <faulted #1>");
}

#[test]
fn stop_orders_find_their_way_in_every_running_state() {
    let stop = |id| order(id, OrderKind::Stop { epoch: E });
    // while the scan thread takes it over
    let mut a = in_state("opening");
    a.gateway_message(grant(10, Phase::Running, true), Now(1));
    a.order(MANAGER, stop(4), Now(2));
    assert_eq!(words(&mut a), "RUN 0 given");
    a.news(McNews::Started { epoch: E }, Now(3));
    assert_eq!(
        words(&mut a),
        format!("<activated 0 #1> ACTION {STOP} <changed>")
    );
    a.news(
        McNews::Stopped {
            epoch: E,
            scan: Scan(80),
        },
        Now(4),
    );
    assert_eq!(
        (words(&mut a).as_str(), a.state()),
        ("<stopped #4>", McaState::Stopped)
    );
    // an MC without a stop POU
    let mut a = agent(false);
    a.order(MANAGER, activate(1, 5, None), Now(0));
    a.gateway_message(grant(10, Phase::Running, true), Now(0));
    a.news(McNews::Started { epoch: E }, Now(0));
    words(&mut a);
    a.order(MANAGER, stop(4), Now(1));
    assert_eq!(words(&mut a), "OFF close <faulted #4>");
}

#[test]
fn a_higher_epoch_replaces_an_opening_and_takes_back_what_was_started() {
    let mut a = in_state("opening");
    a.gateway_message(grant(10, Phase::Running, true), Now(1));
    words(&mut a);
    a.order(MANAGER, activate(4, 6, None), Now(2));
    assert_eq!(words(&mut a), "OFF open");
    a.news(McNews::Started { epoch: E }, Now(3));
    assert_eq!((words(&mut a).as_str(), a.epoch()), ("", Some(Epoch(6))));
    a.order(MANAGER, activate(5, 6, None), Now(4));
    assert_eq!(words(&mut a), "<not opened #5>");
}
