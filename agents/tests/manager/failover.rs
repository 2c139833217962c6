//! Failures: tokens, silence, reports, false alarms, activations that fail, capacity that is short.

use crate::bench::{Bench, c, m, model};
use crate::start::running;
use fam_proto::*;

#[test]
fn a_crash_moves_the_mcs_at_once() {
    let mut bench = running();
    bench.script(&[
        (1_001, "killed c1.1", "c2 call m1"),
        (1_002, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (1_006, "image m1=opening,c2.1,e4", ""),
        (1_010, "image m1=open,c2.1,e4", ""),
        (3_000, "tick", ""),
    ]);
    use EventKind::*;
    let expected = [
        ControllerLost,
        QosEvent,
        PlanDecided,
        MoveOrdered,
        McActivated,
        PlanDone,
    ];
    assert_eq!(bench.kinds(), expected);
    assert_eq!(bench.disk.assignment[&m("m1")], c("c2"));
    let plan = &bench.plans[0];
    assert_eq!(plan.moves[0].from, Some(c("c1")));
    assert_eq!(plan.moves[0].kind, MoveKind::Activate);
    assert!(
        plan.why.contains("its liveliness token is gone"),
        "{}",
        plan.why
    );
}

#[test]
fn orders_are_repeated_until_they_are_received() {
    let mut bench = running();
    bench.script(&[
        (1_001, "mute; killed c1.1", "c2 call m1"),
        (1_002, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (
            1_023,
            "tick",
            "c2/m1 activate e4 again; c2/m1 activate e4 again; c2/m1 activate e4 again; c2/m1 activate e4 again",
        ),
        (1_071, "tick", ""),
        (1_073, "unmute", "c2/m1 activate e4 again"),
        (1_123, "tick", "c2/m1 activate e4 again"),
        (1_400, "tick", ""),
    ]);
}

#[test]
fn silence_moves_an_mc_though_its_controller_lives() {
    let mut bench = running();
    bench.script(&[
        (1_001, "image m1=silent,c1.1,e3", "c2 call m1"),
        (1_002, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (1_010, "image m1=open,c2.1,e4", ""),
        // It speaks again, as a controller like any other.
        (1_600, "tick", ""),
    ]);
    assert!(
        bench.plans[0].why.contains("30.0 ms"),
        "{}",
        bench.plans[0].why
    );
    assert!(bench.kinds().contains(&EventKind::McSuspect));
}

#[test]
fn missing_reports_move_only_what_the_gateway_misses_too() {
    let mut bench = running();
    // Its agents hang, its scan thread runs: the gateway is the witness.
    bench.script(&[(1_001, "frozen c1.1", ""), (3_000, "tick", "")]);
    assert_eq!(bench.kinds(), [EventKind::ControllerLost]);
    // A slow MC: silent for more than three cycles, its suspect time not reached yet.
    let mut cell = model(2, 2);
    cell.mcs[0].suspect_us = 10_000_000;
    cell.mcs[0].cycle_us = 500;
    cell.mcs[0].worst_case_us = 50;
    let mut bench = Bench::new(cell);
    bench.script(&[
        (0, "up c1.1; up c2.1", "c1 registered; c2 registered"),
        // Silent for 2 ms by its record: more than three cycles of 0.5 ms.
        (2, "image m1=open,c1.1,e3 m2=open,c2.1,e3", ""),
        (500, "works c1.1 100; works c2.1 100", ""),
        (501, "frozen c1.1", ""),
        (1_099, "tick", ""),
        (1_100, "tick", "c2 call m1"),
        (1_101, "bid c2.1 100", "c2/m1 activate e4; c2 award m1"),
    ]);
}

#[test]
fn a_false_alarm_is_called_off() {
    let mut bench = running();
    bench.script(&[
        (1_001, "image m1=silent,c1.1,e3", "c2 call m1"),
        (1_002, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (1_005, "image m1=open,c1.1,e3", "c2/m1 cancel e4"),
        (3_000, "tick", ""),
    ]);
    let off = bench.texts(EventKind::MoveCancelled);
    assert!(off[0].contains("healthy again"), "{off:?}");
    assert_eq!(bench.disk.assignment[&m("m1")], c("c1"));
}

#[test]
fn a_token_that_flickers_costs_nothing() {
    let mut bench = running();
    bench.script(&[
        (1_001, "gone c1.1", "c2 call m1"),
        (1_002, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (1_003, "token c1.1", "c2/m1 cancel e4"),
        (3_000, "tick", ""),
    ]);
}

#[test]
fn a_controller_whose_token_is_gone_for_good_but_that_reports_is_up() {
    let mut bench = running();
    // It drives on by the gateway's record; only the manager does not see its token any more.
    bench.script(&[
        (1_001, "gone c1.1", "c2 call m1"),
        (1_002, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (1_010, "image m1=open,c2.1,e4", ""),
        (1_900, "tick", ""),
    ]);
    let joined = |bench: &Bench| {
        let texts = bench.texts(EventKind::ControllerJoined);
        texts.iter().filter(|t| t.contains("heard again")).count()
    };
    assert_eq!(joined(&bench), 0, "a late report proves nothing");
    bench.script(&[(2_300, "tick", "")]);
    assert_eq!(joined(&bench), 1);
}

#[test]
fn an_owner_that_only_the_manager_has_lost_keeps_its_mc() {
    let mut bench = running();
    bench.script(&[
        (1_001, "killed c1.1", "c2 call m1"),
        (1_002, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        // The gateway goes on applying c1's frames and refuses c2.
        (1_500, "image m1=open,c1.1,e3", ""),
        (1_503, "tick", "c2/m1 cancel e4"),
        (9_000, "tick", ""),
        (9_001, "image m1=silent,c1.1,e3", "c2 call m1"),
    ]);
}

#[test]
fn a_failed_activation_goes_elsewhere_with_a_new_epoch() {
    let mut bench = Bench::new(model(3, 1));
    bench.script(&[
        (
            0,
            "up c1.1; up c2.1; up c3.1",
            "c1 registered; c2 registered; c3 registered",
        ),
        (2, "image m1=open,c1.1,e3", ""),
        (1_000, "works c2.1 100; works c3.1 300", ""),
        (1_001, "killed c1.1", "c2 call m1; c3 call m1"),
        (1_002, "bid c2.1 100", ""),
        (
            1_003,
            "bid c3.1 300",
            "c2/m1 activate e4; c2 award m1; c3 award",
        ),
        (1_004, "image m1=failsafe,c1.1,e3", ""),
        // The deadline passes without a frame.
        (1_503, "tick", "c2/m1 cancel e4; c3 call m1"),
        (1_504, "bid c3.1 300", "c3/m1 activate e5; c3 award m1"),
        // Refused: at once again; c2 has reported a fresh image meanwhile.
        (1_620, "notopened c3.1 m1", "c3/m1 cancel e5; c2 call m1"),
        (1_621, "bid c2.1 100", "c2/m1 activate e6; c2 award m1"),
        (1_630, "image m1=open,c2.1,e6", ""),
        (5_000, "tick", ""),
    ]);
    let failed = bench.texts(EventKind::ActivationFailed);
    assert_eq!(failed.len(), 2);
    assert!(
        failed[0].contains("c2") && failed[1].contains("refused by the gateway"),
        "{failed:?}"
    );
}

#[test]
fn a_controller_is_left_out_until_its_image_is_fresh() {
    let mut bench = Bench::new(model(1, 1));
    bench.script(&[
        (0, "up c1.1", "c1 registered"),
        (2, "image", ""),
        (101, "tick", "c1 call m1"),
        (102, "bid c1.1 0", "c1/m1 activate e1; c1 award m1"),
        (103, "frozen c1.1", ""),
        (104, "notopened c1.1 m1", "c1/m1 cancel e1"),
        (300, "stale c1.1 900000", ""),
        (500, "stale c1.1 900000", ""),
        (600, "stale c1.1 4000", ""),
    ]);
    let said = bench.step(2_000, "stale c1.1 4000");
    assert!(said.starts_with("c1 call m1"), "{said}");
}

#[test]
fn what_the_target_of_a_move_loses_is_planned_again() {
    let mut bench = Bench::new(model(3, 1));
    bench.script(&[
        (
            0,
            "up c1.1; up c2.1; up c3.1",
            "c1 registered; c2 registered; c3 registered",
        ),
        (2, "image m1=open,c1.1,e3", ""),
        (1_000, "works c2.1 100; works c3.1 300", ""),
        (1_001, "killed c1.1", "c2 call m1; c3 call m1"),
        (
            1_002,
            "bid c2.1 100; bid c3.1 300",
            "c2/m1 activate e4; c2 award m1; c3 award",
        ),
        (1_003, "killed c2.1", "c2/m1 cancel e4; c3 call m1"),
        (1_004, "bid c3.1 300", "c3/m1 activate e5; c3 award m1"),
        (1_010, "image m1=open,c3.1,e5", ""),
    ]);
}

#[test]
fn who_dies_during_a_negotiation_is_not_waited_for() {
    let mut bench = Bench::new(model(3, 1));
    bench.script(&[
        (
            0,
            "up c1.1; up c2.1; up c3.1",
            "c1 registered; c2 registered; c3 registered",
        ),
        (2, "image m1=open,c1.1,e3", ""),
        (1_001, "killed c1.1", "c2 call m1; c3 call m1"),
        (1_002, "bid c2.1 0", ""),
        (1_003, "killed c3.1", "c2/m1 activate e4; c2 award m1"),
    ]);
}

#[test]
fn bids_are_not_waited_for_longer_than_agreed() {
    let mut bench = Bench::new(model(3, 1));
    bench.script(&[
        (
            0,
            "up c1.1; up c2.1; up c3.1",
            "c1 registered; c2 registered; c3 registered",
        ),
        (2, "image m1=open,c1.1,e3", ""),
        (1_001, "killed c1.1", "c2 call m1; c3 call m1"),
        (1_002, "bid c3.1 0", ""),
        (1_020, "tick", ""),
        (1_021, "tick", "c3/m1 activate e4; c3 award m1"),
        (1_022, "bid c2.1 0", ""),
    ]);
}

#[test]
fn a_bid_that_contradicts_the_last_report_wins() {
    let mut bench = Bench::new(model(3, 1));
    bench.script(&[
        (
            0,
            "up c1.1; up c2.1; up c3.1",
            "c1 registered; c2 registered; c3 registered",
        ),
        (2, "image m1=open,c1.1,e3", ""),
        // By the reports c2 is idle and c3 is busy; by the bids it is the other way round.
        (1_000, "works c2.1 100; works c3.1 600", ""),
        (1_001, "killed c1.1", "c2 call m1; c3 call m1"),
        (1_002, "bid c2.1 800", ""),
        (
            1_003,
            "bid c3.1 200",
            "c3/m1 activate e4; c2 award; c3 award m1",
        ),
    ]);
    let why = &bench.plans[0].why;
    assert!(
        why.contains("c2 is at 80.0 % (its last report said 10.0 %)"),
        "{why}"
    );
}

#[test]
fn who_holds_the_state_goes_before_who_does_not() {
    for (blank, expected) in [("c2", "c3/m1 activate"), ("c3", "c2/m1 activate")] {
        let mut bench = Bench::new(model(3, 1));
        bench.blank = Some(c(blank));
        bench.step(0, "up c1.1; up c2.1; up c3.1");
        bench.step(2, "image m1=open,c1.1,e3");
        bench.step(1_001, "killed c1.1");
        let said = bench.step(1_002, "bid c2.1 0; bid c3.1 0");
        assert!(said.starts_with(expected), "{blank} holds nothing: {said}");
    }
}

#[test]
fn a_bid_that_cannot_take_it_or_has_no_input_image_is_passed_over() {
    let mut bench = Bench::new(model(4, 1));
    bench.step(0, "up c1.1; up c2.1; up c3.1; up c4.1");
    bench.step(2, "image m1=open,c1.1,e3");
    bench.step(1_000, "works c2.1 0; works c3.1 0; works c4.1 700");
    bench.step(1_001, "killed c1.1");
    bench.bid("c2.1", 0, |bid| {
        bid.offers[0].unable = Some("has no room".to_owned());
    });
    bench.bid("c3.1", 0, |bid| bid.image_age_us = 400_000);
    let said = bench.step(1_002, "bid c4.1 700");
    assert_eq!(said, "c4/m1 activate e4; c2 award; c3 award; c4 award m1");
}

#[test]
fn short_capacity_goes_by_criticality_and_names_those_left_out() {
    let mut cell = model(2, 4);
    // The whole cycle of c2 has room for two of these.
    for mc in &mut cell.mcs {
        mc.worst_case_us = 2_000;
    }
    cell.mcs[3].hosts = vec![c("c2")];
    let mut bench = Bench::new(cell);
    bench.script(&[
        (0, "up c1.1; up c2.1", "c1 registered; c2 registered"),
        (
            2,
            "image m1=open,c1.1,e3 m2=open,c1.1,e3 m3=open,c1.1,e3 m4=open,c2.1,e3",
            "",
        ),
        (400, "works c1.1 900; works c2.1 800", ""),
        (401, "killed c1.1", "c2 call m1 m2 m3"),
        // The least critical one that runs on c2 makes room: nothing goes there before it has stopped.
        (402, "bid c2.1 800", "c2/m4 stop e3; c2 award"),
        (450, "image m4=stopped,c2.1,e3", "c2 call m1 m2 m3 m4"),
        (
            451,
            "bid c2.1 0",
            "c2/m1 activate e4; c2/m2 activate e4; c2 award m1 m2",
        ),
        (460, "image m1=open,c2.1,e4 m2=open,c2.1,e4", ""),
    ]);
    let texts = bench.texts(EventKind::McUnplaced);
    let names: Vec<&str> = texts.iter().map(|t| &t[..2]).collect();
    assert!(names.contains(&"m3") && names.contains(&"m4"), "{texts:?}");
    assert!(texts.iter().any(|t| t.contains("c1 is lost")), "{texts:?}");
    // Capacity comes back. Only c2 hosts m4: m1 makes room for it by a handover, and m4 goes on from its record.
    let mut said = bench.step(800, "up c1.2");
    said.push_str(&bench.step(801, "bid c2.1 800"));
    said.push_str(&bench.step(802, "bid c1.2 0"));
    assert!(
        said.ends_with(
            "c1/m1 activate e5 after c2; c2/m1 release e4 to c1 e5; c1/m3 activate e4; c2/m4 activate e4 Resume; c1 award m1 m3; c2 award m4"
        ),
        "{said}"
    );
}

#[test]
fn an_mc_that_makes_room_goes_on_from_its_record_later() {
    let mut cell = model(2, 2);
    for mc in &mut cell.mcs {
        mc.worst_case_us = 3_000;
    }
    let mut bench = Bench::new(cell);
    bench.script(&[
        (0, "up c1.1; up c2.1", "c1 registered; c2 registered"),
        (2, "image m1=open,c1.1,e3 m2=open,c2.1,e3", ""),
        (400, "killed c1.1", "c2 call m1"),
        (401, "bid c2.1 900", "c2/m2 stop e3; c2 award"),
        (410, "image m2=stopped,c2.1,e3", "c2 call m1 m2"),
        (411, "bid c2.1 0", "c2/m1 activate e4; c2 award m1"),
        (420, "image m1=open,c2.1,e4", ""),
        (430, "up c1.2", "c1 registered; c1 call m2; c2 call m2"),
        (
            431,
            "bid c1.2 0; bid c2.1 900",
            "c1/m2 activate e4 Resume; c1 award m2; c2 award",
        ),
        (440, "image m2=open,c1.2,e4", ""),
        (600, "tick", ""),
    ]);
    assert_eq!(bench.agents.view().homeless(bench.now), []);
}

#[test]
fn fail_safe_faults_and_stops_are_alarms_once() {
    let mut bench = running();
    let told = Event::new(Severity::Alarm, EventKind::McFaulted, "told by the gateway")
        .mc(&m("m1"))
        .epoch(Epoch(3));
    bench.script(&[(1_001, "image m1=faulted,c1.1,e3", ""), (3_000, "tick", "")]);
    bench.handle(fam_proto::agent::Input::Message(Envelope {
        from: AgentId::Gateway(GatewayId::new("gw").unwrap()),
        boot: BootId(1),
        to: AgentId::Manager,
        body: Message::Event(told),
    }));
    assert_eq!(bench.kinds(), [EventKind::McFaulted]);
    bench.step(3_001, "ack");
    assert_eq!(bench.answer(), "1 alarms acknowledged");
    assert!(
        bench
            .disk
            .events
            .iter()
            .all(|e| e.acknowledged || e.severity != Severity::Alarm)
    );
}
