//! The fast version of the check: small faults in full, larger ones as far as a few seconds go, and planted bugs that it finds.

use fam_model_check::properties::{EPOCHS, HEALTHY_OWNER, LIVENESS, ONE_DRIVER, STATE};
use fam_model_check::{Bounds, Bug, Faults, Report, explore};

const NONE: Faults = Faults {
    crashes: 0,
    restarts: 0,
    cuts: 0,
    repeats: 0,
    moves: 0,
    late: 0,
};
const CRASH: Faults = Faults {
    crashes: 1,
    restarts: 1,
    ..NONE
};

fn check(faults: Faults, states: usize, bug: Option<Bug>) -> Report {
    let bounds = Bounds {
        activations: 2,
        states,
    };
    explore(faults, bounds, bug)
}

fn sound(report: &Report) {
    if let Some((violation, way)) = &report.violation {
        panic!("{violation}\n{}", way.join("\n"));
    }
}

#[test]
fn without_faults_the_owner_drives_in_every_state() {
    let report = check(NONE, 10_000, None);
    sound(&report);
    assert!(report.complete && report.at_bound == 0);
    assert_eq!(report.driven, report.states);
}

#[test]
fn one_crash_and_restart_at_any_moment() {
    let report = check(CRASH, 25_000, None);
    sound(&report);
    // Owners change in it: by failover, and after a restart of the gateway.
    assert!(
        report.grants.contains_key("after open"),
        "{:?}",
        report.grants
    );
    assert!(
        report.grants.contains_key("after closed"),
        "{:?}",
        report.grants
    );
}

#[test]
fn one_cut_or_one_move_at_any_moment() {
    for faults in [
        Faults { cuts: 1, ..NONE },
        Faults {
            moves: 1,
            late: 1,
            ..NONE
        },
    ] {
        let report = check(faults, 15_000, None);
        sound(&report);
        assert!(!report.grants.is_empty());
    }
}

fn finds(bug: Bug, faults: Faults, states: usize, expected: &[&str]) {
    let report = check(faults, states, Some(bug));
    let (violation, way) = report
        .violation
        .unwrap_or_else(|| panic!("{bug:?} is not found"));
    assert!(
        expected.contains(&violation.property),
        "{bug:?}: {violation}"
    );
    assert!(!way.is_empty());
}

#[test]
fn planted_bugs_are_found() {
    let cut = Faults { cuts: 1, ..NONE };
    let late = Faults { late: 1, ..CRASH };
    finds(
        Bug::RecordsForgotten,
        CRASH,
        60_000,
        &[EPOCHS, STATE, ONE_DRIVER],
    );
    finds(Bug::OwnerUnseen, cut, 60_000, &[HEALTHY_OWNER]);
    finds(Bug::StaleStart, late, 150_000, &[STATE]);
}

#[test]
fn a_gateway_that_is_never_started_again_is_seen_as_the_end() {
    let faults = Faults {
        restarts: 0,
        ..CRASH
    };
    let report = check(faults, 30_000, None);
    let (violation, _) = report
        .violation
        .expect("nothing drives without the gateway");
    assert_eq!(violation.property, LIVENESS);
}
