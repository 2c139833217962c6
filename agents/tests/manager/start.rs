//! Join, first start, manager and gateway restart, the repository, and messages that do not fit.

use crate::bench::{Bench, c, m, model, owner};
use fam_agents::manager::boot_after;
use fam_agents::monitor::Qualities;
use fam_proto::agent::Input;
use fam_proto::*;
use std::hash::{DefaultHasher, Hash, Hasher};

/// c1 and c2 are up; m1 runs on c1, m2 on c2.
pub fn running() -> Bench {
    let mut bench = Bench::new(model(2, 2));
    bench.script(&[
        (0, "up c1.1", "c1 registered"),
        (1, "up c2.1", "c2 registered"),
        (2, "image m1=open,c1.1,e3 m2=open,c2.1,e3", ""),
        (1_000, "works c1.1 200; works c2.1 200", ""),
    ]);
    assert_eq!(bench.disk.assignment.len(), 2);
    bench.events.clear();
    bench
}

#[test]
fn the_first_controller_gets_all_after_the_settling_time() {
    let mut bench = Bench::new(model(2, 2));
    bench.script(&[
        (0, "token c1.1", ""),
        (1, "register c1.1", "c1 registered"),
        (2, "image", ""),
        (99, "tick", ""),
        (101, "tick", "c1 call m1 m2"),
        (
            102,
            "bid c1.1 0",
            "c1/m1 activate e1; c1/m2 activate e1; c1 award m1 m2",
        ),
        (108, "image m1=opening,c1.1,e1", ""),
        (112, "image m1=open,c1.1,e1 m2=open,c1.1,e1", ""),
        (3_000, "tick", ""),
    ]);
    assert_eq!(bench.disk.generation, PlanId(1));
    assert_eq!(
        bench.disk.assignment,
        [(m("m1"), c("c1")), (m("m2"), c("c1"))].into()
    );
    use EventKind::*;
    let expected = [
        ManagerStarted,
        ControllerJoined,
        GatewayJoined,
        QosEvent,
        QosEvent,
        PlanDecided,
        MoveOrdered,
        MoveOrdered,
        McActivated,
        McActivated,
        PlanDone,
    ];
    assert_eq!(bench.kinds(), expected);
}

#[test]
fn several_that_start_together_share_at_once() {
    let mut bench = Bench::new(model(2, 2));
    bench.script(&[
        (0, "token c1.1; token c2.1", ""),
        (1, "register c1.1", "c1 registered"),
        (2, "image", ""),
        (150, "tick", ""),
        (
            200,
            "register c2.1",
            "c2 registered; c1 call m1 m2; c2 call m1 m2",
        ),
        (201, "bid c1.1 0", ""),
        (
            202,
            "bid c2.1 0",
            "c1/m1 activate e1; c2/m2 activate e1; c1 award m1; c2 award m2",
        ),
    ]);
    assert_eq!(bench.plans[0].peak_permille, (0, 200));
    let why = &bench.plans[0].why;
    assert!(
        why.contains("m1 to c1, m2 to c2") && why.contains("20.0 %"),
        "{why}"
    );
}

#[test]
fn one_that_does_not_register_is_not_waited_for_longer_than_the_settling_time() {
    let mut bench = Bench::new(model(2, 1));
    bench.script(&[
        (0, "token c1.1; token c2.1", ""),
        (1, "register c1.1", "c1 registered"),
        (2, "image", ""),
        (299, "tick", ""),
        (300, "tick", "c1 call m1"),
    ]);
}

#[test]
fn no_order_goes_out_before_the_records_are_seen() {
    let mut bench = Bench::new(model(1, 1));
    bench.script(&[
        (0, "frozen gw.1", ""),
        (1, "gateway lost", ""),
        (2, "up c1.1", "c1 registered"),
        (5_000, "tick", ""),
        (5_001, "image m1=closed,c1.9,e70", "c1 call m1"),
        (5_002, "bid c1.1 0", "c1/m1 activate e71; c1 award m1"),
    ]);
    assert_eq!(bench.disk.epochs[&m("m1")], Epoch(134));
}

#[test]
fn a_manager_that_comes_back_touches_nothing() {
    let mut before = running();
    let again = before.step(1_001, "status");
    assert_eq!(again, "client1 reply");
    let mut bench = Bench::restored(model(2, 2), before.disk.clone(), Qualities::standard(), 2);
    bench.script(&[
        (0, "image m1=open,c1.1,e3 m2=open,c2.1,e3", ""),
        (10, "up c1.1; up c2.1", "c1 registered m1; c2 registered m2"),
        (5_000, "tick", ""),
    ]);
    assert_eq!(bench.disk.generation, before.disk.generation);
    assert!(bench.plans.is_empty());
    // Its epochs go on above the block of the life before.
    bench.script(&[
        (5_001, "killed c1.1", "c2 call m1"),
        (5_002, "bid c2.1 200", "c2/m1 activate e65; c2 award m1"),
    ]);
    assert_eq!(before.disk.epochs[&m("m1")], Epoch(64));
}

#[test]
fn a_manager_that_comes_back_finds_what_failed_without_it() {
    let disk = running().disk;
    let mut bench = Bench::restored(model(2, 2), disk, Qualities::standard(), 2);
    bench.script(&[
        (0, "image m1=failsafe,c1.1,e3 m2=open,c2.1,e3", ""),
        (10, "up c2.1", "c2 registered m2"),
        (100, "tick", "c2 call m1"),
        (101, "bid c2.1 200", "c2/m1 activate e65; c2 award m1"),
    ]);
}

#[test]
fn what_was_activated_while_no_manager_looked_is_told_once() {
    let disk = running().disk;
    let mut bench = Bench::restored(model(2, 2), disk, Qualities::standard(), 2);
    // m1 was activated anew where it was before, m2 goes on as the history has it.
    bench.script(&[
        (0, "image m1=open,c1.1,e5 m2=open,c2.1,e3", ""),
        (10, "up c1.1; up c2.1", "c1 registered m1; c2 registered m2"),
        (3_000, "tick", ""),
    ]);
    let told: Vec<_> = bench
        .events
        .iter()
        .filter(|e| e.kind == EventKind::McActivated)
        .map(|e| (e.mc.clone(), e.epoch))
        .collect();
    assert_eq!(told, [(Some(m("m1")), Some(Epoch(5)))]);
}

/// Images get lost: the manager sees epoch 6 only when it is over, by the head that it has left.
#[test]
fn what_was_activated_and_is_over_before_an_image_came_is_told_by_the_head() {
    let mut bench = running();
    bench.script(&[
        (1_010, "image m1=opening,c2.1,e8,e6 m2=open,c2.1,e3", ""),
        (1_020, "image m1=opening,c2.1,e8,e6 m2=open,c2.1,e3", ""),
    ]);
    let told: Vec<_> = bench
        .events
        .iter()
        .filter(|e| e.kind == EventKind::McActivated && e.epoch > Some(Epoch(3)))
        .map(|e| (e.mc.clone(), e.epoch))
        .collect();
    assert_eq!(told, [(Some(m("m1")), Some(Epoch(6)))]);
}

#[test]
fn an_owner_whom_the_manager_does_not_know_yet_is_left_alone() {
    let mut bench = Bench::new(model(2, 1));
    bench.script(&[
        (0, "up c2.1", "c2 registered"),
        (1, "image m1=open,c1.1,e3", ""),
        (2_000, "tick", ""),
        (2_001, "image m1=silent,c1.1,e3", "c2 call m1"),
    ]);
}

#[test]
fn a_gateway_restart_brings_every_mc_back() {
    let mut bench = running();
    bench.script(&[
        (1_001, "gateway lost", ""),
        (1_500, "tick", ""),
        (1_600, "gateway back", "c1 call m1 m2; c2 call m1 m2"),
        (1_601, "bid c1.1 0", ""),
        (
            1_602,
            "bid c2.1 0",
            "c1/m1 activate e4; c2/m2 activate e4; c1 award m1; c2 award m2",
        ),
        (1_610, "image m1=open,c1.1,e4 m2=open,c2.1,e4", ""),
        (4_000, "tick", ""),
    ]);
    let events = bench.kinds();
    assert!(events.contains(&EventKind::GatewayLost) && events.contains(&EventKind::GatewayJoined));
}

#[test]
fn a_full_disk_keeps_orders_back_until_there_is_room() {
    let mut bench = Bench::new(model(1, 1));
    bench.script(&[
        (0, "up c1.1; disk full", "c1 registered"),
        // The block reserved at the start does not reach above this record.
        (1, "image m1=closed,c1.9,e500", ""),
        (101, "tick", "c1 call m1"),
        (102, "bid c1.1 0", "c1 award m1"),
        (900, "tick", ""),
        (1_500, "disk ok", ""),
        (2_200, "tick", "c1/m1 activate e501"),
    ]);
    let alarms: Vec<&Event> = bench
        .events
        .iter()
        .filter(|e| e.kind == EventKind::RepositoryFailed)
        .collect();
    assert_eq!(alarms[0].severity, Severity::Alarm);
    assert!(
        alarms[0].text.contains("no space left on device"),
        "{}",
        alarms[0].text
    );
    assert_eq!((alarms.len(), alarms[1].severity), (2, Severity::Info));
}

#[test]
fn a_second_node_under_one_name_is_refused_while_the_first_lives() {
    let mut bench = running();
    bench.script(&[
        (1_001, "token c1.2; register c1.2", "c1 refused"),
        (1_002, "register c1.2", "c1 refused"),
    ]);
    let why = bench.answer();
    assert!(
        why.contains("controller c1 is registered already") && why.contains("boot 1"),
        "{why}"
    );
    assert_eq!(bench.texts(EventKind::ControllerRefused).len(), 1);
    // The first one dies: its MC goes to c2, and the second one is taken.
    bench.script(&[
        (1_010, "killed c1.1", "c2 call m1"),
        (1_011, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (1_012, "register c1.2", "c1 registered"),
        // A late word of a life that is over: an answer would reach its successor.
        (1_013, "register c1.1", ""),
        (1_014, "image m1=open,c2.1,e4", ""),
    ]);
}

/// Boot ids come from wall clocks. A life with a lower one is taken once the one before is seen to be gone and itself is seen.
#[test]
fn a_node_whose_clock_was_set_back_joins_again() {
    let mut bench = running();
    bench.script(&[
        (1_010, "killed c1.1", "c2 call m1"),
        (1_011, "bid c2.1 200", "c2/m1 activate e4; c2 award m1"),
        (1_012, "image m1=open,c2.1,e4", ""),
        (1_013, "register c1.0", "c1 refused"),
        (1_014, "token c1.0; register c1.0", "c1 registered"),
        (1_015, "register c1.1", ""),
    ]);
    let there = &bench.agents.view().controllers[&c("c1")];
    assert!(there.is_up());
    assert_eq!(there.owner().map(|o| o.boot), Some(BootId(0)));
}

/// The next life is above all before it, also if the clock was set back twice.
#[test]
fn a_manager_whose_clock_was_set_back_begins_above_its_history() {
    let mut disk = RepoState::default();
    for (wall_us, expected) in [(5_000, 5_000), (100, 5_001), (50, 5_002), (9_000, 9_000)] {
        let boot = boot_after(wall_us, &disk, 0);
        assert_eq!(boot, BootId(expected));
        let bench = Bench::restored(model(2, 2), disk, Qualities::standard(), boot.0);
        disk = bench.disk;
    }
}

/// Two lives that begin with the same copy of a repository are not one: orders of the second count as new.
#[test]
fn lives_with_one_copy_of_a_repository_have_different_numbers() {
    let disk = Bench::restored(
        model(2, 2),
        RepoState::default(),
        Qualities::standard(),
        5_000,
    )
    .disk;
    let lives = [3, 4, 999_999].map(|drawn| boot_after(100, &disk, drawn));
    assert_eq!(lives, [BootId(5_004), BootId(5_005), BootId(1_005_000)]);
    // A clock that is right tells them apart.
    assert_eq!(boot_after(9_000_000, &disk, 7), BootId(9_000_000));
}

/// A late answer to its predecessor has told it so. A report of a life that is over is not answered: its successor would hear it.
#[test]
fn a_node_that_believes_to_be_registered_is_told_to_register() {
    let mut bench = running();
    bench.script(&[
        (1_010, "works c2.3 0", "c2 refused"),
        (1_011, "killed c2.1", "c1 call m2"),
        (1_012, "bid c1.1 200", "c1/m2 activate e4; c1 award m2"),
        (1_013, "works c2.3 0", "c2 refused"),
        (1_014, "register c2.3", "c2 registered"),
        (1_015, "works c2.1 0", ""),
    ]);
}

#[test]
fn a_node_that_is_not_in_the_model_hears_what_to_do() {
    let mut bench = running();
    bench.script(&[(1_001, "register nobody.1", "nobody refused")]);
    let why = bench.answer();
    assert!(
        why.contains("nobody") && why.contains("cell.toml") && why.contains("c1, c2"),
        "{why}"
    );
}

#[test]
fn a_project_with_another_hash_is_not_eligible_by_name() {
    let mut bench = Bench::new(model(2, 2));
    let mut registration = bench.registration("c1.1");
    registration.mcs[0].hash = 8;
    registration.mcs[1].layout = LayoutHash(8);
    bench.register(registration);
    bench.script(&[
        (1, "image", "c1 registered not:m1 not:m2"),
        (300, "tick", ""),
        (400, "up c2.1", "c2 registered; c2 call m1 m2"),
        (
            401,
            "bid c2.1 0",
            "c2/m1 activate e1; c2/m2 activate e1; c2 award m1 m2",
        ),
    ]);
    let texts = bench.texts(EventKind::McIneligible);
    assert!(
        texts[0].contains("m1 cannot run on c1") && texts[0].contains("0000000000000008"),
        "{texts:?}"
    );
    assert!(
        texts[1].contains("m2") && texts[1].contains("layout"),
        "{texts:?}"
    );
    let unplaced = bench.texts(EventKind::McUnplaced);
    assert!(
        unplaced[0].contains("m1") && unplaced[0].contains("c2 has not registered"),
        "{unplaced:?}"
    );
    assert_eq!(bench.step(402, "move m1 c1"), "client1 failed");
}

#[test]
fn messages_that_do_not_fit_are_counted_and_change_nothing() {
    let mut bench = running();
    let own = AgentId::Controller(c("c1"));
    let envelope = |from: AgentId, boot, body| {
        Input::Message(Envelope {
            from,
            boot: BootId(boot),
            to: AgentId::Manager,
            body,
        })
    };
    let foreign = bench.registration("c2.1");
    let bid = Bid {
        negotiation: 999,
        owner: owner("c2", 1),
        offers: Vec::new(),
        workload_permille: 0,
        memory_free_kb: 0,
        image_age_us: 0,
        criteria: Vec::new(),
    };
    let report = McReport {
        mc: m("m1"),
        owner: owner("c2", 1),
        state: McaState::Active,
        epoch: None,
        order: None,
        outcome: McOutcome::Changed,
    };
    let before = bench.agents.view().clone();
    for (from, boot, body) in [
        (own.clone(), 1, Message::Register(foreign)),
        (own.clone(), 1, Message::Bid(bid.clone())),
        (own.clone(), 1, Message::McReport(report)),
        (AgentId::Manager, 1, Message::Leaving),
        (own.clone(), 1, Message::MayLeave { behind: Vec::new() }),
        (own.clone(), 1, Message::Query(Query::Status)),
    ] {
        bench.handle(envelope(from, boot, body));
    }
    // Late and unknown, but in order: not bad, and without effect.
    let c2 = AgentId::Controller(c("c2"));
    bench.handle(envelope(c2.clone(), 1, Message::Bid(bid)));
    bench.handle(envelope(c2, 1, Message::OrderReceived(OrderId(12_345))));
    bench.handle(envelope(own, 99, Message::Leaving));
    bench.handle(Input::Persisted {
        ticket: 4_711,
        result: Err("late".to_owned()),
    });
    assert_eq!(bench.agents.view(), &before);
    assert_eq!(bench.step(1_001, "status"), "client1 reply");
    assert_eq!(bench.last_status.as_ref().unwrap().bad_messages, 6);
}

#[test]
fn an_old_image_changes_nothing() {
    let mut bench = running();
    let before = bench.agents.view().clone();
    let image = |boot: u64, number: u64| {
        Input::Image(std::sync::Arc::new(InputImage {
            gateway: GatewayId::new("gw").unwrap(),
            boot: BootId(boot),
            number: ImageNumber(number),
            sent_at_us: 0,
            inputs: Vec::new(),
            records: Vec::new(),
            exports: Vec::new(),
        }))
    };
    // Numbers grow over restarts of the gateway, whatever its boot id says.
    bench.handle(image(9, 1));
    bench.handle(image(1, 1));
    assert_eq!(bench.agents.view(), &before);
}

#[test]
fn the_agents_are_values() {
    let bench = running();
    let copy = bench.agents.clone();
    let hash = |agents: &fam_agents::manager::ManagerAgents| {
        let mut hasher = DefaultHasher::new();
        agents.hash(&mut hasher);
        hasher.finish()
    };
    assert_eq!(copy, bench.agents);
    assert_eq!(hash(&copy), hash(&bench.agents));
    let mut other = bench;
    other.step(1_050, "works c1.1 900");
    assert_ne!(copy, other.agents);
}

#[test]
fn the_status_names_everything() {
    let mut bench = running();
    bench.step(1_001, "pin m1");
    bench.step(1_002, "drain c2");
    bench.step(1_003, "status");
    let status = bench.last_status.unwrap();
    assert_eq!(status.controllers[0].active, [m("m1")]);
    assert!(status.controllers[1].drained && status.controllers[1].up);
    assert_eq!(status.mcs[0].pinned, Some(c("c1")));
    assert_eq!(
        (status.mcs[1].record.as_str(), status.mcs[1].epoch),
        ("open", Epoch(3))
    );
    assert!(status.gateways[0].up);
    let doing = status.in_progress.unwrap();
    assert!(
        doing.contains("negotiation") && doing.contains("c2 is drained"),
        "{doing}"
    );
}

#[test]
fn the_history_is_read_on_after_a_position_and_survives_a_restart() {
    let bench = running();
    let disk = bench.disk.clone();
    let seqs: Vec<u64> = disk.events.iter().map(|e| e.seq).collect();
    assert_eq!(seqs, (1..=disk.last_event_seq).collect::<Vec<_>>());
    let mut again = Bench::restored(model(2, 2), disk.clone(), Qualities::standard(), 2);
    again.step(1, "events 2 3");
    let page: Vec<u64> = again.last_page.0.iter().map(|e| e.seq).collect();
    assert_eq!((page, again.last_page.1), (vec![3, 4, 5], true));
    again.step(2, &format!("events {} 10", disk.last_event_seq));
    let last = &again.last_page.0[0];
    assert_eq!(
        (last.kind, again.last_page.1),
        (EventKind::ManagerStarted, false)
    );
    assert_eq!(again.events[0].seq, disk.last_event_seq + 1);
    assert_eq!(again.disk.events.len(), disk.events.len() + 1);
}
