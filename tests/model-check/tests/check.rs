//! The fast version of the check: every fault with no message late, moves and crashes of the gateway with one late, and planted bugs
//! that it finds. The full one is the command (`cargo run --release -p fam-model-check`).

use fam_model_check::properties::{EPOCHS, HEALTHY_OWNER, LIVENESS, ONE_DRIVER, STATE};
use fam_model_check::scenarios::{self, MOVE, NONE, crash, cut};
use fam_model_check::{Bounds, Bug, Faults, Kind, Report, explore};

/// A guard that no scenario comes near to.
const STATES: usize = 200_000;

fn check(faults: Faults, held: usize, activations: u8, bug: Option<Bug>) -> Report {
    let bounds = Bounds {
        activations,
        states: STATES,
        parts: false,
    };
    explore(Faults { held, ..faults }, bounds, bug)
}

/// Explored to the end, and no promise broken.
fn sound(name: &str, report: &Report) {
    if let Some((violation, way)) = &report.violation {
        panic!("{name}: {violation}\n{}", way.join("\n"));
    }
    assert!(report.complete, "{name}: {report:?}");
}

#[test]
fn without_faults_nothing_changes() {
    let report = check(NONE, 1, 2, None);
    sound("none", &report);
    assert_eq!((report.states, report.driven, report.at_bound), (1, 1, 0));
}

#[test]
fn each_fault_at_any_moment_with_no_message_late() {
    // Owners change in them: by a handover, by failover, after a restart of the gateway.
    let grants = [
        ("move", "after released"),
        ("crash-controller", "after open"),
        ("crash-gateway", "after closed"),
        ("cut-gateway-controller", "after fail-safe"),
    ];
    for (name, faults) in scenarios::ALL {
        let single = faults.moves + faults.crashes + faults.cuts == 1 && faults.late == 0;
        if !single {
            continue;
        }
        let report = check(faults, 0, 1, None);
        sound(name, &report);
        for (_, how) in grants.iter().filter(|(of, _)| *of == name) {
            assert!(report.grants.contains_key(*how), "{name}: {report:?}");
        }
    }
}

#[test]
fn a_move_with_a_message_late() {
    let report = check(MOVE, 1, 1, None);
    sound("move", &report);
    assert!(report.grants.contains_key("after fail-safe"), "{report:?}");
}

#[test]
fn a_move_with_a_frame_late() {
    let report = check(Faults { late: 1, ..MOVE }, 0, 1, None);
    sound("move-late", &report);
}

/// After how many states.
fn finds(bug: Bug, faults: Faults, expected: &[&str]) -> usize {
    let report = check(faults, 0, 2, Some(bug));
    let Some((violation, way)) = &report.violation else {
        panic!("{bug:?} is not found: {report:?}");
    };
    assert!(
        expected.contains(&violation.property),
        "{bug:?}: {violation}"
    );
    assert!(!way.is_empty());
    report.states
}

#[test]
fn planted_bugs_are_found() {
    finds(
        Bug::RecordsForgotten,
        crash(Kind::Gateway),
        &[EPOCHS, STATE, ONE_DRIVER],
    );
    let blind = cut((Kind::Manager, Kind::Node));
    finds(Bug::OwnerUnseen, blind, &[HEALTHY_OWNER]);
    // The same without the bug breaks nothing, as far as it takes to find it.
    let late = Faults {
        late: 1,
        ..crash(Kind::Node)
    };
    let found = finds(Bug::StaleStart, late, &[STATE]);
    let bounds = Bounds {
        activations: 2,
        states: found + 1_000,
        parts: false,
    };
    let report = explore(late, bounds, None);
    assert_eq!(report.violation, None);
}

#[test]
fn a_gateway_that_is_never_started_again_is_seen_as_the_end() {
    let faults = Faults {
        restarts: 0,
        ..crash(Kind::Gateway)
    };
    let report = check(faults, 0, 2, None);
    let (violation, _) = report
        .violation
        .expect("nothing drives without the gateway");
    assert_eq!(violation.property, LIVENESS);
}
