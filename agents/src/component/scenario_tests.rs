//! Ways through the state machine: the sub-states of an opening, handover, repetitions, traps, resets, stops.

use super::diagnose::tests::{CARRY, PRESS, STOP, a_checkpoint, a_grant};
use super::table_tests::{
    E, MANAGER, activate, agent, grant, image, in_state, me, next_version, order, owner, record,
    refusal, release, trap, words,
};
use super::*;
use fam_proto::agent::Output;
use fam_proto::{OpenRefusal, OrderKind, Phase, RecordState, Reset, Scan};

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
    // a new manager counts anew, whatever its boot id says: whose words count was decided before
    for boot in [60, 40] {
        let mut b = a.clone();
        b.order(BootId(boot), activate(1, 9, None), Now(3));
        assert_eq!((received(&mut b), b.epoch()), ((1, 1), Some(Epoch(9))));
        b.order(BootId(boot), activate(1, 9, None), Now(4));
        assert_eq!(received(&mut b).0, 1);
    }
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

#[test]
fn a_new_version_starts_from_a_released_state_and_from_no_other() {
    let renew = |id| {
        order(
            id,
            OrderKind::Renew {
                epoch: Epoch(6),
                version: 60,
                within_us: 500_000,
            },
        )
    };
    let grant = |interrupted| {
        let mut opened = a_grant(Some(&a_checkpoint(10, Phase::Running)), interrupted);
        opened.epoch = Epoch(6);
        Message::Opened(opened)
    };
    for interrupted in [false, true] {
        // The record shows the release before the scan thread does.
        let mut a = in_state("releasing");
        a.stage(next_version());
        a.order(MANAGER, renew(8), Now(1));
        assert_eq!(words(&mut a), "");
        a.news(
            McNews::Released {
                epoch: E,
                scan: Scan(9),
            },
            Now(2),
        );
        assert_eq!(words(&mut a), "<released #2> open");
        a.gateway_message(grant(interrupted), Now(3));
        if interrupted {
            assert_eq!(words(&mut a), "<not opened #8>");
            assert_eq!((a.state(), a.config().version), (McaState::Passive, 50));
            continue;
        }
        assert_eq!(words(&mut a), "RUN NEW 0 given");
        assert_eq!(a.config().version, 50, "until it runs");
        a.news(McNews::Started { epoch: Epoch(6) }, Now(4));
        assert_eq!(words(&mut a), "<activated 0 #8>");
        assert_eq!((a.config().version, a.config().layout), (60, LayoutHash(6)));
    }
    // The release is off after all.
    let mut a = in_state("releasing");
    a.stage(next_version());
    a.order(MANAGER, renew(8), Now(1));
    let why = "critical".to_owned();
    a.news(McNews::ReleaseCancelled { epoch: E, why }, Now(2));
    assert_eq!(words(&mut a), "<cancelled #2> <not opened #8>");
}

#[test]
fn a_stop_that_is_heard_of_before_its_start_is_a_stop() {
    let mut a = in_state("opening");
    let ended = || McNews::Stopped {
        epoch: E,
        scan: Scan(80),
    };
    a.news(ended(), Now(1));
    assert_eq!(a.state(), McaState::Opening, "nothing runs yet");
    a.gateway_message(grant(50, Phase::Running, true), Now(2));
    words(&mut a);
    a.news(ended(), Now(3));
    assert_eq!(
        (words(&mut a).as_str(), a.state()),
        ("<stopped #1>", McaState::Stopped)
    );
    a.news(McNews::Started { epoch: E }, Now(4));
    assert_eq!((words(&mut a).as_str(), a.state()), ("", McaState::Stopped));
}

#[test]
fn an_answer_to_the_life_before_is_nothing_for_this_one() {
    let mut a = in_state("opening");
    let mut late = a_grant(Some(&a_checkpoint(10, Phase::Running)), true);
    late.owner.boot = BootId(late.owner.boot.0 - 1);
    a.gateway_message(Message::Opened(late), Now(1));
    assert_eq!((words(&mut a).as_str(), a.state()), ("", McaState::Opening));
    a.gateway_message(grant(10, Phase::Running, true), Now(2));
    assert_eq!(words(&mut a), "RUN 0 given");
}
