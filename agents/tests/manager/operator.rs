//! Operators' commands, and controllers that leave.

use crate::bench::{Bench, c, m, model};
use crate::start::running;
use fam_agents::monitor::Qualities;
use fam_proto::*;

#[test]
fn a_move_is_a_handover_and_answered_twice() {
    let mut bench = running();
    bench.script(&[
        (1_001, "move m1 c2", "client1 begun; c2 call m1"),
        (
            1_002,
            "bid c2.1 200",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2 award m1",
        ),
        (1_010, "image m1=released,c1.1,e3,c2.1,e4", ""),
        (1_012, "image m1=open,c2.1,e4", "client1 done"),
    ]);
    assert_eq!(bench.answer(), "m1 runs on c2");
    // A repetition of the same command gets the same answer and moves nothing.
    bench.operator_again(
        1,
        CommandKind::Move {
            mc: m("m1"),
            to: c("c2"),
            force: false,
        },
    );
    assert_eq!(bench.step(1_013, "tick"), "client1 done");
    assert_eq!(bench.replies.last(), bench.replies.iter().rev().nth(1));
}

#[test]
fn a_wish_waits_for_a_slow_controller_but_not_for_ever() {
    let mut bench = running();
    bench.script(&[
        (1_001, "move m1 c2", "client1 begun; c2 call m1"),
        (1_150, "tick", ""),
        (
            1_190,
            "bid c2.1 200",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2 award m1",
        ),
    ]);
    let mut bench = running();
    bench.script(&[
        (1_001, "move m1 c2", "client1 begun; c2 call m1"),
        (1_202, "tick", "client1 failed"),
    ]);
    let said = bench.answer();
    assert!(
        said.contains("c2 did not answer the call in time"),
        "{said}"
    );
}

#[test]
fn a_move_that_fails_says_why() {
    let mut bench = running();
    bench.script(&[
        (1_001, "move m1 c2", "client1 begun; c2 call m1"),
        (
            1_002,
            "bid c2.1 200",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2 award m1",
        ),
        (
            1_100,
            "notreleased c1.1 m1",
            "client1 failed; c1/m1 cancel e3; c2/m1 cancel e4",
        ),
    ]);
    assert_eq!(bench.answer(), "m1: critical all the time");
    bench.bid_refuses();
    assert!(
        bench.answer().contains("c2 has no room"),
        "{}",
        bench.answer()
    );
}

impl Bench {
    /// Another move of m1 to c2, which c2 declines in its bid.
    fn bid_refuses(&mut self) {
        self.step(1_200, "move m1 c2");
        self.bid("c2.1", 200, |bid| {
            bid.offers[0].unable = Some("has no room".to_owned());
        });
    }
}

#[test]
fn moves_that_make_no_sense_are_refused_in_words() {
    let mut bench = running();
    for (command, expected) in [
        ("move m9 c2", "there is no MC m9; the cell has m1, m2"),
        (
            "move m1 c9",
            "there is no controller c9; the cell has c1, c2",
        ),
        ("reset m1", "m1 runs on c1; `fam stop m1` first"),
        ("pin m1 c9", "c9 does not host m1"),
    ] {
        assert_eq!(bench.step(1_001, command), "client1 failed", "{command}");
        assert_eq!(bench.answer(), expected);
    }
    assert_eq!(bench.step(1_001, "move m1 c1"), "client1 done");
    assert_eq!(bench.answer(), "m1 runs on c1 already");
    bench.step(1_002, "killed c2.1");
    assert_eq!(bench.step(1_003, "move m1 c2"), "client1 failed");
    assert!(
        bench.answer().contains("c2 cannot take m1: it is lost"),
        "{}",
        bench.answer()
    );
}

#[test]
fn a_forced_move_does_not_ask_the_owner() {
    let mut bench = running();
    bench.script(&[
        (1_001, "force m1 c2", "client1 begun; c2 call m1"),
        (
            1_002,
            "bid c2.1 200",
            "c2/m1 activate e4 force; c2 award m1",
        ),
        // The owner is healthy, and that does not call it off.
        (1_005, "image m1=open,c1.1,e3", ""),
        (1_010, "image m1=open,c2.1,e4", "client1 done"),
    ]);
}

#[test]
fn a_drained_controller_is_emptied_and_gets_nothing_until_it_is_undrained() {
    let mut bench = running();
    bench.script(&[
        (1_001, "drain c1", "client1 begun; c2 call m1"),
        (
            1_002,
            "bid c2.1 200",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2 award m1",
        ),
        (1_010, "image m1=open,c2.1,e4", "client1 done"),
        (1_020, "works c1.1 0; works c2.1 800", ""),
        // Neither work balance nor a failover puts anything there.
        (5_000, "tick", ""),
        (5_001, "move m1 c1", "client1 failed"),
        (5_002, "killed c2.1", ""),
        (
            5_003,
            "undrain c1",
            "client1 begun; c1 call m1 m2; client1 done",
        ),
        (
            5_004,
            "bid c1.1 0",
            "c1/m1 activate e5; c1/m2 activate e4; c1 award m1 m2",
        ),
    ]);
    assert_eq!(bench.disk.drained.len(), 0);
    let unplaced = bench.texts(EventKind::McUnplaced);
    assert_eq!(unplaced.len(), 2);
    assert!(
        unplaced[0].contains("c1 is drained") && unplaced[0].contains("c2 is lost"),
        "{unplaced:?}"
    );
}

#[test]
fn a_drain_that_finds_no_place_says_so_and_goes_on_when_there_is_one() {
    let mut bench = Bench::new(model(2, 1));
    bench.script(&[
        (0, "up c1.1", "c1 registered"),
        (2, "image m1=open,c1.1,e3", ""),
        (1_000, "drain c1", "client1 begun; client1 failed"),
        (1_500, "up c2.1", "c2 registered; c2 call m1"),
        (
            1_501,
            "bid c2.1 0",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2 award m1",
        ),
    ]);
    assert!(
        bench
            .answer()
            .contains("m1 finds no place: c1 is drained; c2 has not registered"),
        "{}",
        bench.answer()
    );
}

#[test]
fn a_drain_is_remembered_across_a_restart_of_the_manager() {
    let mut bench = running();
    bench.step(1_001, "drain c1");
    bench.step(1_002, "pin m2");
    let mut again = Bench::restored(model(2, 2), bench.disk.clone(), Qualities::standard(), 2);
    again.script(&[
        (0, "image m1=open,c1.1,e3 m2=open,c2.1,e3", ""),
        (
            1,
            "up c1.1; up c2.1",
            "c1 registered m1; c2 registered m2; c2 call m1",
        ),
    ]);
    assert_eq!(again.agents.view().mcs[&m("m2")].pinned, Some(c("c2")));
}

#[test]
fn a_pinned_mc_stays_until_its_controller_is_lost() {
    let mut bench = Bench::new(model(2, 4));
    bench.script(&[
        (0, "up c1.1", "c1 registered"),
        (
            2,
            "image m1=open,c1.1,e3 m2=open,c1.1,e3 m3=open,c1.1,e3 m4=open,c1.1,e3",
            "",
        ),
        (
            1_000,
            "works c1.1 800; pin m1; pin m2; pin m3",
            "client1 begun; client1 done; client1 begun; client1 done; client1 begun; client1 done",
        ),
        (3_010, "up c2.1", "c2 registered"),
        (3_600, "tick", "c1 call m4; c2 call m4"),
        (
            3_601,
            "bid c1.1 800; bid c2.1 0",
            "c2/m4 activate e4 after c1; c1/m4 release e3 to c2 e4; c1 award; c2 award m4",
        ),
        (3_610, "image m4=open,c2.1,e4", ""),
        (3_700, "works c1.1 600; works c2.1 200", ""),
        (3_701, "move m1 c2", "client1 failed"),
        (3_702, "unpin m1", "client1 begun; client1 done"),
        (8_000, "tick", "c1 call m1 m4; c2 call m1 m4"),
        (9_000, "killed c1.1", "c2 call m1 m2 m3"),
        (
            9_001,
            "bid c2.1 200",
            "c2/m1 activate e4; c2/m2 activate e4; c2/m3 activate e4; c2 award m1 m2 m3",
        ),
    ]);
    assert!(bench.disk.pins.contains_key(&m("m2")) && !bench.disk.pins.contains_key(&m("m1")));
}

#[test]
fn a_pin_elsewhere_moves_the_mc() {
    let mut bench = running();
    bench.script(&[
        (1_001, "pin m1 c2", "client1 begun; c2 call m1"),
        (
            1_002,
            "bid c2.1 200",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2 award m1",
        ),
        (1_010, "image m1=open,c2.1,e4", "client1 done"),
    ]);
    assert_eq!(bench.disk.pins[&m("m1")], c("c2"));
}

#[test]
fn a_command_that_cannot_be_kept_says_so() {
    let mut bench = running();
    bench.script(&[
        (1_001, "disk full", ""),
        (1_002, "pin m1", "client1 begun; client1 failed"),
    ]);
    assert!(
        bench.answer().contains("no space left on device"),
        "{}",
        bench.answer()
    );
}

#[test]
fn a_stopped_mc_stays_down_until_it_is_reset() {
    let mut bench = running();
    bench.script(&[
        (1_001, "stop m1", "client1 begun; c1/m1 stop e3"),
        (1_200, "image m1=stopped,c1.1,e3", "client1 done"),
        (4_000, "tick", ""),
        (4_001, "move m1 c2", "client1 failed"),
        (4_002, "killed c1.1", ""),
        (4_003, "reset m1", "client1 begun; c2 call m1"),
        (4_004, "bid c2.1 200", "c2/m1 activate e4 Cold; c2 award m1"),
        (4_010, "image m1=opening,c2.1,e4", ""),
        (4_012, "image m1=open,c2.1,e4", "client1 done"),
        (8_000, "tick", ""),
    ]);
    assert!(bench.disk.stopped.is_empty());
}

#[test]
fn an_mc_that_was_stopped_is_not_brought_back_by_a_new_manager() {
    let mut bench = running();
    bench.step(1_001, "stop m1");
    let mut again = Bench::restored(model(2, 2), bench.disk.clone(), Qualities::standard(), 2);
    // It still ran its stop POU: the order is given again. Then it stays down, fail-safe or not.
    again.script(&[
        (0, "image m1=open,c1.1,e3 m2=open,c2.1,e3", ""),
        (1, "up c1.1; up c2.1", "c1 registered m1; c2 registered m2"),
        (101, "tick", "c1/m1 stop e3"),
        (200, "image m1=failsafe,c1.1,e3", ""),
        (5_000, "tick", ""),
    ]);
}

#[test]
fn a_faulted_mc_is_brought_back_by_a_reset_only() {
    let mut bench = running();
    bench.script(&[
        (1_001, "image m1=faulted,c1.1,e3", ""),
        (4_000, "tick", ""),
        (4_003, "reset m1", "client1 begun; c1 call m1; c2 call m1"),
        (4_004, "bid c1.1 0", ""),
        (
            4_005,
            "bid c2.1 200",
            "c1/m1 activate e4 Cold; c1 award m1; c2 award",
        ),
        (4_012, "image m1=open,c1.1,e4", "client1 done"),
    ]);
}

#[test]
fn a_node_that_leaves_hands_over_first() {
    let mut bench = running();
    bench.script(&[
        (1_001, "leaving c1.1", "c2 call m1"),
        (
            1_002,
            "bid c2.1 200",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2 award m1",
        ),
        (1_003, "leaving c1.1", ""),
        (1_010, "image m1=open,c2.1,e4", "c1 may leave"),
        (1_011, "leaving c1.1", "c1 may leave"),
        (1_012, "killed c1.1", ""),
        (3_000, "up c1.2", "c1 registered"),
    ]);
    let kinds = bench.kinds();
    assert!(!kinds.contains(&EventKind::ControllerLost), "{kinds:?}");
    assert_eq!(
        kinds
            .iter()
            .filter(|k| **k == EventKind::ControllerStopped)
            .count(),
        2
    );
    assert!(!bench.agents.view().controllers[&c("c1")].is_emptied());
}

#[test]
fn the_last_node_may_leave_and_the_loss_is_named() {
    let mut bench = Bench::new(model(1, 1));
    bench.script(&[
        (0, "up c1.1", "c1 registered"),
        (2, "image m1=open,c1.1,e3", ""),
        (1_000, "leaving c1.1", "c1 may leave m1 behind"),
    ]);
    let alarm = bench.texts(EventKind::McUnplaced);
    assert!(
        alarm[0].contains("c1 leaves although nobody can take m1"),
        "{alarm:?}"
    );
}

/// A new version of m1 is made ready on both controllers, and runs where m1 runs.
#[test]
fn a_new_version_is_made_ready_everywhere_and_brought_in_by_its_owner() {
    let mut bench = running();
    bench.script(&[
        (1_001, "reload", "c1 stage; c2 stage; client1 begun"),
        (1_010, "staged c1.1 m1 60", ""),
        // An answer that got lost is asked for again.
        (1_302, "tick", "c2 stage"),
        (1_310, "staged c2.1 m1 60", "client1 done"),
    ]);
    assert_eq!(bench.answer(), "m1: changed");
    bench.script(&[
        (
            1_320,
            "reload 1",
            "client1 begun; c1/m1 release e3 to c1 e4",
        ),
        (
            1_330,
            "image m1=released,c1.1,e3,c1.1,e4",
            "c1/m1 renew e4 v60",
        ),
        (
            1_340,
            "image m1=open,c1.1,e4",
            "c2/m1 adopt v60; client1 done",
        ),
    ]);
    assert_eq!(bench.answer(), "the new version is in force: m1");
    let not = |bench: &Bench, who: &str| {
        let view = bench.agents.view();
        view.controllers[&c(who)].ineligible.get(&m("m1")).cloned()
    };
    assert!(not(&bench, "c2").unwrap().contains("than those in force"));
    for who in ["c1.1", "c2.1"] {
        let mut registration = bench.registration(who);
        registration.mcs[0].hash = 60;
        registration.mcs[0].layout = LayoutHash(77);
        bench.register(registration);
        assert_eq!(not(&bench, &who[..2]), None, "{who} has it now");
    }
    // A manager that starts now learns the version from who drives.
    assert_eq!(bench.agents.view().version_of(&m("m1")).unwrap().0, 60);
}

#[test]
fn a_new_version_that_finds_no_moment_leaves_the_old_one_and_says_so() {
    let mut bench = running();
    bench.script(&[
        (1_001, "reload", "c1 stage; c2 stage; client1 begun"),
        (1_010, "staged c1.1 m1 60", ""),
        (1_020, "staged c2.1 m1 60", "client1 done"),
        (
            1_320,
            "reload 1",
            "client1 begun; c1/m1 release e3 to c1 e4",
        ),
    ]);
    bench.step(1_330, "notreleased c1.1 m1");
    assert_eq!(
        bench.answer(),
        "m1: critical all the time; it goes on with the version that it has. No MC has its new version yet; `fam reload` tries again"
    );
    let in_force = bench.agents.view().version_of(&m("m1")).map(|v| v.0);
    assert_ne!(in_force, Some(60));
}

#[test]
fn controllers_that_have_read_different_files_bring_nothing_in() {
    let mut bench = running();
    bench.script(&[
        (1_001, "reload", "c1 stage; c2 stage; client1 begun"),
        (1_010, "staged c1.1 m1 60", ""),
        (1_020, "staged c2.1 m1 61", "client1 failed"),
    ]);
    let answer = bench.answer();
    assert!(answer.contains("different versions of m1"), "{answer}");
    assert_eq!(bench.step(1_030, "reload 1"), "client1 failed");
    assert_eq!(bench.step(1_031, "reload 9"), "client1 failed");
    let answer = bench.answer();
    assert!(answer.contains("begin anew"), "{answer}");
}
