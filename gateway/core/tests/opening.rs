//! Who may open an epoch, and what he is told: a table of cases, then the flows around them.

mod common;
use common::*;
use fam_gateway_core::GatewayLocal;
use fam_gateway_core::{RecordWrite, Rejection};
use fam_proto::agent::{Agent, Input, Output};
use fam_proto::*;

fn trap() -> TrapInfo {
    TrapInfo {
        pou: "Station1".to_owned(),
        file: "station1.st".to_owned(),
        line: 12,
        message: "division by zero".to_owned(),
    }
}

fn close(bench: &mut Bench, n: u64, epoch: u64) {
    let owner = owner(n);
    bench.input(Input::Message(Envelope {
        from: AgentId::Component(owner.controller.clone(), mc_id()),
        boot: owner.boot,
        to: AgentId::Gateway(gateway_id()),
        body: Message::Close(Close {
            mc: mc_id(),
            epoch: Epoch(epoch),
            owner,
            trap: trap(),
        }),
    }));
}

fn release(bench: &mut Bench, driver: &mut Driver, n: u64, epoch: u64) {
    driver.header.released_to = Some(Successor {
        epoch: Epoch(epoch),
        owner: owner(n),
    });
    bench.scan(driver);
}

fn stop(bench: &mut Bench, driver: &mut Driver) {
    driver.header.phase = Phase::Stopped;
    bench.scan(driver);
}

type Prepare = fn(&mut Bench, &mut Driver);
type Want = Result<(), OpenRefusal>;

/// Controller 1 drives epoch 5; then something happens; then somebody asks.
#[test]
fn the_table_of_openings() {
    let later: Prepare = |bench, _| bench.pass(3 * TICK_US + 1);
    let nothing: Prepare = |_, _| {};
    let released: Prepare = |bench, driver| release(bench, driver, 2, 7);
    let stopped: Prepare = |bench, driver| stop(bench, driver);
    let forced = |mut open: Open| {
        open.force = true;
        open
    };
    let reset = |mut open: Open, how| {
        open.reset = Some(how);
        open
    };
    let mut other_layout = ask(2, 9);
    other_layout.layout = LayoutHash(1);
    let new_version = |n, epoch| {
        let mut open = ask(n, epoch);
        open.layout = LayoutHash(1);
        open
    };
    let mut unknown = ask(2, 9);
    unknown.mc = McId::new("Other").unwrap();
    let stale = Err(OpenRefusal::StaleEpoch);
    let table: Vec<(&str, Prepare, Open, Want)> = vec![
        ("unknown MC", later, unknown, Err(OpenRefusal::UnknownMc)),
        ("lower epoch", later, ask(2, 4), stale.clone()),
        ("same epoch, other owner", later, ask(2, 5), stale.clone()),
        ("same epoch, driven", later, ask(1, 5), stale.clone()),
        ("layout", later, other_layout, Err(OpenRefusal::Layout)),
        (
            "healthy owner",
            nothing,
            ask(2, 9),
            Err(OpenRefusal::OwnerFresh),
        ),
        (
            "healthy owner, 3 cycles",
            |bench, _| bench.pass(3 * TICK_US),
            ask(2, 9),
            Err(OpenRefusal::OwnerFresh),
        ),
        ("silent owner", later, ask(2, 9), Ok(())),
        (
            "token gone",
            |bench, _| bench.token(1, false),
            ask(2, 9),
            Ok(()),
        ),
        ("forced", nothing, forced(ask(2, 9)), Ok(())),
        (
            "forced, but stale",
            nothing,
            forced(ask(2, 5)),
            stale.clone(),
        ),
        ("successor", released, ask(2, 7), Ok(())),
        (
            "not the successor",
            released,
            ask(1, 7),
            Err(OpenRefusal::NotSuccessor),
        ),
        (
            "another layout, released to it",
            released,
            new_version(2, 7),
            Ok(()),
        ),
        (
            "another layout, released to another",
            released,
            new_version(1, 8),
            Err(OpenRefusal::Layout),
        ),
        ("below the successor", released, ask(2, 6), stale),
        ("above the successor", released, ask(1, 8), Ok(())),
        ("stopped", stopped, ask(2, 9), Err(OpenRefusal::NeedsReset)),
        (
            "stopped, reset",
            stopped,
            reset(ask(2, 9), Reset::Resume),
            Ok(()),
        ),
        (
            "faulted",
            |bench, _| close(bench, 1, 5),
            ask(2, 9),
            Err(OpenRefusal::NeedsReset),
        ),
        (
            "faulted, reset",
            |bench, _| close(bench, 1, 5),
            reset(ask(2, 9), Reset::Warm),
            Ok(()),
        ),
        (
            "fail-safe",
            |bench, _| bench.pass(WATCHDOG_US),
            ask(2, 9),
            Ok(()),
        ),
        (
            "restarted gateway",
            |bench, _| bench.restart(),
            ask(2, 9),
            Ok(()),
        ),
        (
            "restarted gateway, old epoch",
            |bench, _| bench.restart(),
            ask(1, 5),
            Err(OpenRefusal::StaleEpoch),
        ),
        (
            "full disk",
            |bench, _| {
                bench.pass(4 * TICK_US);
                bench.disk = Disk::NoSync;
            },
            ask(2, 9),
            Err(OpenRefusal::NotDurable(DISK_FULL.to_owned())),
        ),
    ];
    for (name, prepare, open, want) in table {
        let mut bench = Bench::new();
        let mut driver = bench.driver(1, 5);
        bench.scan(&mut driver);
        prepare(&mut bench, &mut driver);
        let before = bench.record();
        let asker = (open.epoch, open.owner.clone());
        match (bench.open(open), want) {
            (Message::Opened(opened), Ok(())) => {
                let record = bench.record();
                assert_eq!(opened.epoch, asker.0, "{name}");
                assert!(record.drives(&asker.1, asker.0) && !record.driven, "{name}");
                assert_eq!(opened.base, before.head, "{name}");
                assert_eq!(opened.next_scan, before.scan().next(), "{name}");
            }
            (Message::OpenRefused(refused), Err(want)) => {
                assert_eq!(refused.why, want, "{name}");
                let after = bench.record();
                assert_eq!(
                    (after.epoch, after.owner, after.state),
                    (before.epoch, before.owner, before.state),
                    "{name}"
                );
            }
            (answer, want) => panic!("{name}: {answer:?} instead of {want:?}"),
        }
    }
}

#[test]
fn an_open_asked_again_before_the_first_frame_gets_the_same_grant() {
    let mut bench = Bench::new();
    let first = bench.opened(ask(1, 5));
    bench.pass(2_000);
    let writes = bench.writes.len();
    assert_eq!(bench.opened(ask(1, 5)), first);
    assert_eq!(bench.writes.len(), writes, "it is durable already");
    let answer = bench.open(ask(2, 5));
    assert!(
        matches!(&answer, Message::OpenRefused(r) if r.why == OpenRefusal::StaleEpoch),
        "{answer:?}"
    );
}

#[test]
fn the_ledger_is_durable_before_the_answer() {
    let mut bench = Bench::new();
    bench.opened(ask(1, 5));
    let opened = bench.writes.iter().find_map(|write| match write {
        RecordWrite::Opened { ledger, .. } => Some(ledger.clone()),
        _ => None,
    });
    let ledger = opened.expect("the grant was written");
    assert_eq!((ledger.epoch, ledger.owner), (Epoch(5), Some(owner(1))));
    bench.records.lose_power();
    let stored = bench.records.after_kill();
    assert_eq!(stored[0].ledger.epoch, Epoch(5));
}

#[test]
fn the_answer_leaves_out_what_the_asker_holds() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    bench.token(1, false);
    let mut open = ask(2, 6);
    open.held = bench.record().head;
    let opened = bench.opened(open);
    assert_eq!(opened.checkpoint, None);
    assert_eq!(opened.outputs, driver.outputs);
    assert!(opened.interrupted && !opened.fail_safe);
}

#[test]
fn a_release_is_no_interruption_unless_something_came_between() {
    for (name, between, want) in [
        ("at once", 0, (false, false)),
        ("after the watchdog", WATCHDOG_US, (true, true)),
    ] {
        let mut bench = Bench::new();
        let mut driver = bench.driver(1, 5);
        bench.scan(&mut driver);
        release(&mut bench, &mut driver, 2, 7);
        let bytes = driver.encode();
        bench.frame(bytes); // the old owner repeats it until it is acknowledged
        assert!(matches!(bench.record().state, RecordState::Released(_)));
        bench.pass(between);
        let opened = bench.opened(ask(2, 7));
        assert_eq!((opened.interrupted, opened.fail_safe), want, "{name}");
    }
}

#[test]
fn the_first_open_starts_from_nothing_and_a_cold_reset_does_so_again() {
    let mut bench = Bench::new();
    let opened = bench.opened(ask(1, 5));
    assert_eq!((opened.base, opened.interrupted), (None, false));
    assert_eq!(opened.outputs, [0xF0, 0], "fail-safe values stand");
    let mut driver = Driver::of(1, &opened);
    for _ in 0..3 {
        bench.scan(&mut driver);
    }
    stop(&mut bench, &mut driver);
    assert_eq!(bench.record().state, RecordState::Stopped);
    let mut cold = ask(2, 6);
    cold.reset = Some(Reset::Cold);
    let opened = bench.opened(cold);
    assert_eq!((opened.base, opened.checkpoint.is_none()), (None, true));
    assert_eq!(opened.next_scan, Scan(5), "the numbering goes on");

    // The head of before does not come back with a restart, neither before nor after the first frame.
    bench.restart();
    assert_eq!(bench.record().head, None);
    let opened = bench.opened(ask(2, 7));
    assert_eq!((opened.base, opened.next_scan), (None, Scan(5)));
    let mut driver = Driver::of(2, &opened);
    bench.scan(&mut driver);
    bench.restart();
    assert_eq!(bench.record().head, Some(driver.header.checkpoint_id()));
}

#[test]
fn a_head_that_a_power_failure_took_is_not_invented() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    bench.records.lose_power();
    bench.restart();
    let state = bench.record().state;
    assert!(
        matches!(&state, RecordState::Faulted(t) if t.message.contains("--cold")),
        "{state:?}"
    );
    for reset in [None, Some(Reset::Warm), Some(Reset::Resume)] {
        let mut open = ask(1, 6);
        open.reset = reset;
        let answer = bench.open(open);
        assert!(
            matches!(&answer, Message::OpenRefused(r) if r.why == OpenRefusal::NeedsReset),
            "{reset:?}: {answer:?}"
        );
    }
    let mut open = ask(1, 6);
    open.reset = Some(Reset::Cold);
    assert_eq!(bench.opened(open).base, None);
}

#[test]
fn a_write_torn_by_a_kill_falls_back_to_what_was_applied() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    bench.scan(&mut driver);
    let before = driver.header.checkpoint_id();
    bench.scan(&mut driver);
    bench.records.tear_head(&mc_id());
    bench.restart();
    assert_eq!(bench.record().head, Some(before));
}

#[test]
fn a_stranger_opens_and_closes_nothing() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    let sent = bench.sent.len();
    for body in [
        Message::Open(ask(2, 9)),
        Message::Close(Close {
            mc: mc_id(),
            epoch: Epoch(5),
            owner: owner(1),
            trap: trap(),
        }),
        Message::Leaving,
    ] {
        bench.input(Input::Message(Envelope {
            from: AgentId::Controller(ControllerId::new("controller3").unwrap()),
            boot: BootId(1),
            to: AgentId::Gateway(gateway_id()),
            body,
        }));
    }
    assert_eq!(bench.gateway.misdirected(), 3);
    let answers = &bench.sent[sent..];
    assert!(
        answers.iter().all(|e| matches!(e, Message::BadMessages(_))),
        "only the manager hears of it: {answers:?}"
    );
    assert_eq!(bench.record().state, RecordState::Open);
}

#[test]
fn a_trap_sets_the_fail_safe_values_at_once_and_only_for_its_owner() {
    let mut bench = Bench::new();
    let mut driver = bench.driver(1, 5);
    bench.scan(&mut driver);
    close(&mut bench, 2, 5);
    close(&mut bench, 1, 4);
    assert_eq!(bench.record().state, RecordState::Open);
    close(&mut bench, 1, 5);
    assert_eq!(bench.record().state, RecordState::Faulted(trap()));
    assert_eq!(bench.outputs.last().unwrap().1, [0xF0, 0]);
    let event = bench.events.last().unwrap();
    assert_eq!(event.kind, EventKind::McFaulted);
    assert!(event.text.contains("station1.st line 12"), "{}", event.text);
    bench.restart();
    assert_eq!(bench.record().state, RecordState::Faulted(trap()));
}

/// A new version of the logic brings a longer state: from its first frame on the chain is of its layout, and until then the old
/// version may still go on.
#[test]
fn a_new_layout_begins_where_the_old_one_was_released() {
    for driven in [false, true] {
        let mut bench = Bench::new();
        let mut driver = bench.driver(1, 5);
        bench.scan(&mut driver);
        release(&mut bench, &mut driver, 2, 6);
        let mut open = ask(2, 6);
        open.layout = LayoutHash(1);
        let Message::Opened(opened) = bench.open(open) else {
            panic!("it was released to it")
        };
        let mut new = Driver::of(2, &opened);
        if driven {
            // A frame of the layout of before is nothing of this epoch.
            let rejected = bench.rejected(Rejection::Layout);
            let image = bench.newest_image();
            bench.frame(new.clone().frame(image));
            assert_eq!(bench.rejected(Rejection::Layout), rejected + 1);
            new.header.layout = LayoutHash(1);
            new.state.resize(STATE_LEN + 40, 7);
            new.header.state_len = new.state.len() as u32;
            let applied = bench.applied.len();
            bench.scan(&mut new);
            bench.pass(TICK_US);
            bench.scan(&mut new);
            assert_eq!(bench.applied.len(), applied + 2);
            // It has a length of its own now.
            let mut longer = new.clone();
            longer.state.push(0);
            longer.header.state_len += 1;
            let image = bench.newest_image();
            bench.frame(longer.frame(image));
            assert_eq!(bench.rejected(Rejection::StateLength), 1);
        }
        // The new controller dies: who goes on has to know the layout of the head.
        bench.token(2, false);
        bench.pass(4 * TICK_US);
        let mut next = ask(1, 7);
        next.layout = LayoutHash(1);
        let (new_layout, old_layout) = (next, ask(1, 8));
        let (refused, granted) = if driven {
            (old_layout, new_layout)
        } else {
            (new_layout, old_layout)
        };
        assert!(matches!(
            bench.open(refused),
            Message::OpenRefused(OpenRefused {
                why: OpenRefusal::Layout,
                ..
            })
        ));
        assert!(
            matches!(bench.open(granted), Message::Opened(_)),
            "{driven}"
        );
    }
}

fn asked(open: &Open) -> Input<GatewayLocal> {
    Input::Message(Envelope {
        from: AgentId::Component(open.owner.controller.clone(), open.mc.clone()),
        boot: open.owner.boot,
        to: AgentId::Gateway(gateway_id()),
        body: Message::Open(open.clone()),
    })
}

/// A slow disk may answer in another order than it was asked, and what comes meanwhile for an MC has to wait.
#[test]
fn each_answer_of_the_disk_belongs_to_its_own_write() {
    let mut bench = Bench::new();
    let opens = [mc_id(), importer_id()].map(|mc| Open { mc, ..ask(1, 5) });
    for open in &opens {
        bench.gateway.handle(asked(open), bench.now);
    }
    let mut tickets = Vec::new();
    while let Some(output) = bench.gateway.poll_output() {
        match output {
            Output::Persist { ticket, .. } => tickets.push(ticket),
            other => panic!("{other:?} before the answer of the disk"),
        }
    }
    assert_eq!(tickets.len(), 2);
    let other = Open {
        force: true,
        ..ask(2, 6)
    };
    bench.gateway.handle(asked(&other), bench.now);
    assert_eq!(
        bench.gateway.poll_output(),
        None,
        "its record is being written"
    );
    for (ticket, open) in tickets.into_iter().zip(&opens).rev() {
        let answer = Input::Persisted {
            ticket,
            result: Ok(()),
        };
        bench.gateway.handle(answer, bench.now);
        let mut opened = Vec::new();
        while let Some(output) = bench.gateway.poll_output() {
            if let Output::Send(Envelope {
                body: Message::Opened(opening),
                ..
            }) = output
            {
                opened.push(opening.mc);
            }
        }
        assert_eq!(opened, std::slice::from_ref(&open.mc));
    }
}

/// An epoch that nobody can have given out, from a damaged word, would lock everybody else out.
#[test]
fn an_epoch_far_ahead_is_refused() {
    let mut bench = Bench::new();
    bench.opened(ask(1, 5));
    bench.token(1, false);
    bench.pass(3 * TICK_US + 1);
    let far = 5 + fam_gateway_core::opening::EPOCHS_AHEAD_MAX;
    for ahead in [1, 2] {
        let answer = bench.open(ask(2, far + ahead));
        assert!(
            matches!(&answer, Message::OpenRefused(r) if r.why == OpenRefusal::StaleEpoch),
            "{answer:?}"
        );
    }
    bench.opened(ask(2, far));
}
