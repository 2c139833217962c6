//! Every link cut in each direction, and cables pulled as a whole.

use crate::cell::{C1, C2, Cell, GATEWAY, MANAGER, PLANT};
use crate::journal::monotonic_us;
use crate::net::fabric::Weather;
use fam_proto::EventKind;
use std::time::Duration;

/// How long a link stays cut on which nobody's driving depends.
const HOLD: Duration = Duration::from_millis(600);
/// A cut of the field that is shorter than what fail-safe values wait for.
const FIELD_HOLD: Duration = Duration::from_millis(300);
/// Longer than Zenoh keeps a silent connection.
const LONG: Duration = Duration::from_secs(11);

#[test]
fn each_link_cut_in_each_direction_leaves_one_driver() {
    let Some(mut cell) = Cell::start(&[C1, C2]) else {
        return;
    };
    let links = [
        (C1, GATEWAY),
        (C2, GATEWAY),
        (C1, MANAGER),
        (C2, MANAGER),
        (C1, C2),
        (MANAGER, GATEWAY),
        (GATEWAY, PLANT),
    ];
    for (one, other) in links {
        for (from, to) in [(one, other), (other, one)] {
            let case = format!("a cut from {from} to {to}");
            eprintln!("{:6.1} s  {case}", cell.seconds());
            let (seq, since_us) = (cell.last_event(), monotonic_us());
            let cut = (cell.host(from).clone(), cell.host(to).clone());
            cell.fabric.set(&cut.0, &cut.1, Weather::CUT);
            let node = [from, to].into_iter().find(|n| n.starts_with("controller"));
            match node {
                Some(node) if [from, to].contains(&GATEWAY) => {
                    let drove = cell.owners().values().any(|by| by == node);
                    cell.until_driven_without(&case, &[node]);
                    if drove {
                        let kinds = [EventKind::McSuspect, EventKind::ControllerLost];
                        cell.told(&case, seq, &kinds);
                    }
                }
                _ if [from, to].contains(&PLANT) => cell.run_for(FIELD_HOLD),
                _ => {
                    cell.run_for(HOLD);
                    let taken = cell.taken_since(since_us);
                    assert!(
                        taken.is_empty(),
                        "{case} took MCs from healthy owners: {taken:?}\n{}",
                        cell.report()
                    );
                }
            }
            cell.fabric.mend();
            cell.rest(&case);
            cell.judge(&case, since_us);
        }
    }
}

#[test]
fn a_cable_out_in_the_middle_of_a_handover_leaves_one_driver() {
    let Some(mut cell) = Cell::start(&[C1, C2]) else {
        return;
    };
    // Pulled when the order leaves, and when the old owner has let go: from the old owner, from the new one.
    for stage in ["move-ordered", "mc-released"] {
        for old in [true, false] {
            let (from, mcs) = cell.busiest();
            let to = if from == C1 { C2 } else { C1 };
            let pulled = if old { from.as_str() } else { to };
            let case = format!("the cable of {pulled} out at {stage}, {from} to {to}");
            eprintln!("{:6.1} s  {case}", cell.seconds());
            let since_us = monotonic_us();
            let at = cell.log(MANAGER).len();
            cell.move_along(&mcs[0], to);
            let seen = cell.log(MANAGER).wait(at, &[stage], Duration::from_secs(5));
            let host = cell.host(pulled).clone();
            cell.fabric.set_host(&host, Weather::CUT);
            assert!(seen.is_some(), "{case}: not seen\n{}", cell.report());
            cell.until_driven_without(&case, &[pulled]);
            cell.fabric.mend();
            cell.rest(&case);
            cell.judge(&case, since_us);
        }
    }
}

#[test]
fn a_controller_that_was_cut_off_for_long_comes_back_passive() {
    let Some(mut cell) = Cell::start(&[C1, C2]) else {
        return;
    };
    let (seq, since_us) = (cell.last_event(), monotonic_us());
    let (lost, _) = cell.busiest();
    let host = cell.host(&lost).clone();
    cell.fabric.set_host(&host, Weather::CUT);
    cell.until_driven_without("a long cut", &[lost.as_str()]);
    cell.run_for(LONG);
    assert!(
        cell.owners().values().all(|by| by != &lost),
        "{}",
        cell.report()
    );
    cell.fabric.mend();
    cell.rest("after a long cut");
    cell.judge("a long cut", since_us);
    cell.told("a long cut", seq, &[EventKind::ControllerLost]);
}
