//! Work balance: handovers, cancelled releases, hold time, pause, hysteresis, a new controller, Controller Agents' own events.

use crate::bench::{Bench, c, m, model};
use fam_proto::*;

/// c1 runs m1 to m4, c2 has just joined and is idle.
fn lopsided() -> Bench {
    let mut bench = Bench::new(model(2, 4));
    bench.script(&[
        (0, "up c1.1", "c1 registered"),
        (
            2,
            "image m1=open,c1.1,e3 m2=open,c1.1,e3 m3=open,c1.1,e3 m4=open,c1.1,e3",
            "",
        ),
        (3_000, "works c1.1 800", ""),
        (3_010, "up c2.1", "c2 registered"),
    ]);
    bench.events.clear();
    bench
}

/// The handover of two MCs is ordered.
fn handing_over() -> Bench {
    let mut bench = lopsided();
    bench.script(&[
        (3_599, "tick", ""),
        (3_600, "tick", "c1 call m1 m2 m3 m4; c2 call m1 m2 m3 m4"),
        (3_601, "bid c1.1 800", ""),
        (
            3_602,
            "bid c2.1 0",
            "c2/m1 activate e4 after c1; c1/m1 release e3 to c2 e4; c2/m2 activate e4 after c1; c1/m2 release e3 to c2 e4; c1 award; c2 award m1 m2",
        ),
    ]);
    bench
}

#[test]
fn a_controller_that_joins_gets_its_share_by_handover() {
    let mut bench = handing_over();
    bench.script(&[
        (3_610, "image m1=released,c1.1,e3,c2.1,e4", ""),
        (3_612, "image m1=open,c2.1,e4", ""),
        (3_620, "image m2=open,c2.1,e4", ""),
        (3_700, "works c1.1 400; works c2.1 400", ""),
        (9_000, "tick", ""),
    ]);
    use EventKind::*;
    let expected = [
        ControllerJoined,
        QosEvent,
        PlanDecided,
        MoveOrdered,
        MoveOrdered,
        McActivated,
        McActivated,
        PlanDone,
    ];
    let kinds = bench.kinds();
    assert_eq!(kinds, expected[1..].to_vec());
    let plan = &bench.plans[0];
    assert_eq!(plan.peak_permille, (800, 400));
    assert!(plan.moves.iter().all(|m| m.kind == MoveKind::Handover));
    assert!(
        plan.why.contains("c2 has joined and is at 0.0 %"),
        "{}",
        plan.why
    );
    assert_eq!(bench.disk.assignment[&m("m1")], c("c2"));
}

#[test]
fn a_slow_controller_gets_its_fair_share() {
    let mut cell = model(2, 6);
    cell.controllers[1].cpu_factor_permille = 500;
    let mut bench = Bench::new(cell);
    let all: Vec<String> = (1..=6).map(|n| format!("m{n}=open,c1.1,e3")).collect();
    bench.step(0, "up c1.1");
    bench.step(2, &format!("image {}", all.join(" ")));
    bench.step(3_000, "works c1.1 1200");
    bench.step(3_010, "up c2.1");
    bench.step(3_600, "tick");
    bench.step(3_601, "bid c1.1 1200; bid c2.1 0");
    let to_slow = bench.plans[0]
        .moves
        .iter()
        .filter(|m| m.to == c("c2"))
        .count();
    assert_eq!((to_slow, bench.plans[0].peak_permille), (2, (1_200, 800)));
}

#[test]
fn a_release_that_is_cancelled_leaves_the_mc_where_it_is() {
    let mut bench = handing_over();
    bench.script(&[
        (3_610, "image m1=open,c2.1,e4", ""),
        (
            4_000,
            "notreleased c1.1 m2",
            "c1/m2 cancel e3; c2/m2 cancel e4",
        ),
        (4_010, "works c1.1 600; works c2.1 200", ""),
        // The pause after the plan.
        (5_990, "tick", ""),
    ]);
    assert_eq!(bench.disk.assignment[&m("m2")], c("c1"));
    let off = bench.texts(EventKind::MoveCancelled);
    assert!(off[0].contains("critical all the time"), "{off:?}");
    let said = bench.step(7_000, "tick");
    assert_eq!(
        said,
        "c1 call m2 m3 m4 m1; c2 call m2 m3 m4 m1".replace("m2 m3 m4 m1", "m1 m2 m3 m4")
    );
}

#[test]
fn a_release_without_an_answer_is_cancelled_at_its_deadline() {
    let mut bench = handing_over();
    bench.script(&[
        (3_610, "image m1=open,c2.1,e4", ""),
        (9_101, "tick", ""),
        (9_102, "tick", "c1/m2 cancel e3; c2/m2 cancel e4"),
    ]);
}

#[test]
fn a_successor_that_does_not_start_is_replaced_under_a_new_epoch() {
    let mut bench = handing_over();
    bench.script(&[
        (
            3_610,
            "image m1=open,c2.1,e4 m2=released,c1.1,e3,c2.1,e4",
            "",
        ),
        (4_109, "tick", ""),
        // Back to the old one.
        (4_110, "tick", "c2/m2 cancel e4; c1 call m2"),
        (4_111, "bid c1.1 600", "c1/m2 activate e5; c1 award m2"),
        (4_120, "image m2=open,c1.1,e5", ""),
    ]);
}

#[test]
fn an_owner_that_dies_in_the_middle_of_a_handover_has_failed() {
    let mut bench = handing_over();
    bench.script(&[
        (
            3_603,
            "killed c1.1",
            "c1/m1 cancel e3; c2/m1 cancel e4; c1/m2 cancel e3; c2/m2 cancel e4; c2 call m1 m2 m3 m4",
        ),
        (
            3_604,
            "bid c2.1 0",
            "c2/m1 activate e5; c2/m2 activate e5; c2/m3 activate e4; c2/m4 activate e4; c2 award m1 m2 m3 m4",
        ),
    ]);
}

#[test]
fn a_target_that_dies_before_the_release_changes_nothing() {
    let mut bench = handing_over();
    bench.script(&[
        (
            3_603,
            "killed c2.1",
            "c1/m1 cancel e3; c2/m1 cancel e4; c1/m2 cancel e3; c2/m2 cancel e4",
        ),
        (9_000, "tick", ""),
    ]);
}

#[test]
fn an_imbalance_that_passes_is_no_reason() {
    let mut bench = lopsided();
    bench.script(&[
        (3_400, "works c1.1 120; works c2.1 100", ""),
        (4_000, "works c1.1 800", ""),
        (4_400, "works c1.1 120", ""),
        (9_000, "tick", ""),
    ]);
}

#[test]
fn within_the_threshold_nothing_happens() {
    let mut bench = Bench::new(model(2, 4));
    bench.script(&[
        (0, "up c1.1; up c2.1", "c1 registered; c2 registered"),
        (
            2,
            "image m1=open,c1.1,e3 m2=open,c1.1,e3 m3=open,c1.1,e3 m4=open,c2.1,e3",
            "",
        ),
        (300, "works c1.1 400; works c2.1 380", ""),
        (5_000, "works c1.1 440; works c2.1 200", ""),
        (9_000, "tick", ""),
    ]);
}

#[test]
fn an_overload_is_answered_and_what_cannot_be_bettered_is_not_asked_again() {
    let mut bench = Bench::new(model(2, 1));
    bench.script(&[
        (0, "up c1.1; up c2.1", "c1 registered; c2 registered"),
        (2, "image m1=open,c1.1,e3", ""),
        (300, "works c1.1 1100; works c2.1 0", ""),
        // The first hold time runs from the first reports.
        (800, "tick", "c1 call m1; c2 call m1"),
        // The one MC is the whole load: nothing is gained.
        (801, "bid c1.1 200; bid c2.1 0", "c1 award; c2 award"),
        (20_000, "tick", ""),
    ]);
    let declined = bench.texts(EventKind::PlanRefused);
    assert!(
        declined[0].contains("c1 is at 110.0 % of its limit"),
        "{declined:?}"
    );
    // Something has changed: it is asked again.
    let said = bench.step(20_001, "works c1.1 1400");
    assert_eq!(said, "");
    assert_eq!(bench.step(20_600, "tick"), "c1 call m1; c2 call m1");
}

#[test]
fn a_controller_agents_own_event_need_not_last() {
    let mut bench = lopsided();
    let event = QosEvent {
        qos: "work balance".to_owned(),
        cause: Cause::Imbalance(c("c2")),
        detail: "below its limit".to_owned(),
    };
    bench.step(3_020, "works c2.1 0");
    bench.handle(fam_proto::agent::Input::Message(Envelope {
        from: AgentId::Controller(c("c2")),
        boot: BootId(1),
        to: AgentId::Decision,
        body: Message::Qos(event),
    }));
    assert_eq!(
        bench.step(3_021, "tick"),
        "c1 call m1 m2 m3 m4; c2 call m1 m2 m3 m4"
    );
}

#[test]
fn a_failure_goes_before_work_balance() {
    let mut bench = Bench::new(model(3, 4));
    bench.script(&[
        (0, "up c1.1; up c3.1", "c1 registered; c3 registered"),
        (
            2,
            "image m1=open,c1.1,e3 m2=open,c1.1,e3 m3=open,c1.1,e3 m4=open,c3.1,e3",
            "",
        ),
        (3_000, "works c1.1 600; works c3.1 600", ""),
        (3_010, "up c2.1", "c2 registered"),
        (
            3_600,
            "tick",
            "c1 call m1 m2 m3 m4; c2 call m1 m2 m3 m4; c3 call m1 m2 m3 m4",
        ),
        (3_601, "killed c3.1", "c1 call m4; c2 call m4"),
        (
            3_602,
            "bid c1.1 600; bid c2.1 0",
            "c2/m4 activate e4; c1 award; c2 award m4",
        ),
    ]);
}

#[test]
fn a_plan_made_from_another_generation_is_refused() {
    let bench = lopsided();
    let manager = bench.agents.manager();
    let generation = bench.agents.view().generation;
    let plan = |id: u64, parent: u64, to: &str, kind: MoveKind| Plan {
        id: PlanId(id),
        parent: PlanId(parent),
        event: QosEvent {
            qos: "work balance".to_owned(),
            cause: Cause::Imbalance(c("c2")),
            detail: String::new(),
        },
        moves: vec![Move {
            mc: m("m1"),
            from: Some(c("c1")),
            to: c(to),
            kind,
        }],
        left_out: Vec::new(),
        why: String::new(),
        peak_permille: (0, 0),
    };
    let now = generation.0;
    let next = now + 1;
    let check = |plan: &Plan| manager.check(plan, bench.now).map_err(|e| e.to_string());
    assert_eq!(check(&plan(next, now, "c2", MoveKind::Handover)), Ok(()));
    for (plan, expected) in [
        (
            plan(next + 1, next, "c2", MoveKind::Handover),
            "was made from generation",
        ),
        (
            plan(next + 1, now, "c2", MoveKind::Handover),
            "does not follow generation",
        ),
        (
            plan(next, now, "c1", MoveKind::Handover),
            "it runs there already",
        ),
        (
            plan(next, now, "c2", MoveKind::Activate),
            "its owner drives it",
        ),
        (
            plan(next, now, "c9", MoveKind::Handover),
            "does not host it",
        ),
    ] {
        let refusal = check(&plan).unwrap_err();
        assert!(refusal.contains(expected), "{refusal}");
    }
}
