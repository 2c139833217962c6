//! The full table: every state with every event.

use super::diagnose::tests::{a_checkpoint, a_diagnosis, a_grant};
use super::*;
use fam_proto::access::{Start, StateSource};
use fam_proto::agent::Output;
use fam_proto::{
    ControllerId, ImageNumber, OpenRefusal, OpenRefused, OrderKind, Phase, RecordState,
    RecordSummary, Scan,
};

pub(super) const MANAGER: BootId = BootId(50);

pub(super) fn owner(name: &str, boot: u64) -> Owner {
    Owner {
        controller: ControllerId::new(name).unwrap(),
        boot: BootId(boot),
    }
}

pub(super) fn me() -> Owner {
    owner("controller2", 7)
}

pub(super) fn agent(stop: bool) -> McAgent {
    McAgent::new(ComponentConfig {
        owner: me(),
        mc: McId::new("Station1").unwrap(),
        gateway: GatewayId::new("gateway1").unwrap(),
        version: 50,
        layout: LayoutHash(5),
        diagnosis: a_diagnosis(stop),
    })
}

/// Version 60 of the same MC: another layout.
pub(super) fn next_version() -> ComponentConfig {
    ComponentConfig {
        owner: me(),
        mc: McId::new("Station1").unwrap(),
        gateway: GatewayId::new("gateway1").unwrap(),
        version: 60,
        layout: LayoutHash(6),
        diagnosis: a_diagnosis(true),
    }
}

pub(super) fn order(id: u64, kind: OrderKind) -> Order {
    Order {
        id: OrderId(id),
        mc: McId::new("Station1").unwrap(),
        kind,
    }
}

pub(super) fn activate(id: u64, epoch: u64, after: Option<Owner>) -> Order {
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

pub(super) fn release(id: u64, epoch: u64) -> Order {
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

pub(super) fn trap() -> TrapInfo {
    TrapInfo {
        pou: "Station1".to_owned(),
        file: "station1.st".to_owned(),
        line: 12,
        message: "division by zero".to_owned(),
    }
}

pub(super) fn record(epoch: u64, owner: Owner, state: RecordState) -> RecordSummary {
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

pub(super) fn image(record: RecordSummary) -> InputImage {
    InputImage {
        gateway: GatewayId::new("gateway1").unwrap(),
        boot: BootId(1),
        number: ImageNumber(9),
        sent_at_us: 0,
        inputs: Vec::new(),
        records: vec![record],
        exports: Vec::new(),
    }
}

/// What has come out, in short words.
pub(super) fn words(agent: &mut McAgent) -> String {
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
                    "RUN{} {}{}{}",
                    if a.renew.is_some() { " NEW" } else { "" },
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
                McAct::Adopt { .. } => "ADOPT".to_owned(),
            },
            other => panic!("unexpected {other:?}"),
        });
    }
    words.join(" ")
}

pub(super) fn grant(step: i32, phase: Phase, interrupted: bool) -> Message {
    Message::Opened(a_grant(Some(&a_checkpoint(step, phase)), interrupted))
}

pub(super) fn refusal(why: OpenRefusal) -> Message {
    Message::OpenRefused(OpenRefused {
        mc: McId::new("Station1").unwrap(),
        epoch: Epoch(5),
        why,
        record: None,
    })
}

pub(super) const E: Epoch = Epoch(5);

/// An agent in the state named, under epoch 5, with nothing left to be said.
pub(super) fn in_state(name: &str) -> McAgent {
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
        "cancel 4" => a.order(
            MANAGER,
            order(8, OrderKind::CancelRelease { epoch: Epoch(4) }),
            soon,
        ),
        "force 5" | "force 6" => {
            let mut forced = activate(8, if event == "force 5" { 5 } else { 6 }, None);
            if let OrderKind::Activate { force, .. } = &mut forced.kind {
                *force = true;
            }
            a.order(MANAGER, forced, soon);
        }
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
        "renew 6" | "renew 6 unknown" => {
            if event == "renew 6" {
                a.stage(next_version());
            }
            let kind = OrderKind::Renew {
                epoch: Epoch(6),
                version: 60,
                within_us: 500_000,
            };
            a.order(MANAGER, order(8, kind), soon);
        }
        "adopt" => {
            a.stage(next_version());
            a.order(MANAGER, order(8, OrderKind::Adopt { version: 60 }), soon);
        }
        "adopt other" => {
            a.stage(next_version());
            a.order(MANAGER, order(8, OrderKind::Adopt { version: 70 }), soon);
        }
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
cancel 4        | passive <changed #8> | opening <changed #8> | active <changed #8> | releasing <cancelled #8> | recovering <changed #8> | stopped <changed #8> | faulted <changed #8>
force 5         | opening open | opening <not opened #8> | active <not opened #8> | releasing <not opened #8> | recovering <not opened #8> | opening open | opening open
force 6         | opening open | opening open | opening OFF open | opening OFF open | opening OFF open | opening open | opening open
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
renew 6         | opening open | opening <not opened #8> | active <not opened #8> | = | recovering <not opened #8> | stopped <not opened #8> | faulted <not opened #8>
renew 6 unknown | passive <not opened #8> | opening <not opened #8> | active <not opened #8> | releasing <not opened #8> | recovering <not opened #8> | stopped <not opened #8> | faulted <not opened #8>
adopt           | passive ADOPT <changed #8> | opening <changed #8> | active <changed #8> | releasing <changed #8> | recovering <changed #8> | stopped ADOPT <changed #8> | faulted ADOPT <changed #8>
adopt other     | passive <changed #8> | opening <changed #8> | active <changed #8> | releasing <changed #8> | recovering <changed #8> | stopped <changed #8> | faulted <changed #8>
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
    assert_eq!(events, 34);
}

#[test]
fn what_would_be_lost_with_the_node_is_busy() {
    let busy = ["opening", "active", "releasing", "recovering"];
    for name in STATES {
        assert_eq!(in_state(name).is_busy(), busy.contains(&name), "{name}");
    }
}
