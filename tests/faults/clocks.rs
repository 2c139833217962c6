//! Steps of the wall clock, as one process sees them: nothing may depend on it.

use crate::cell::{C1, C2, Cell, GATEWAY, MANAGER};
use crate::journal::monotonic_us;
use std::time::Duration;

const HOUR: &str = "3600";
const HOUR_BACK: &str = "-3600";
const VARIABLE: &str = "FAM_TEST_CLOCK_STEP";

#[test]
fn a_step_of_the_wall_clock_changes_nothing() {
    let Some(mut cell) = Cell::prepare(&[C1, C2]) else {
        return;
    };
    for (name, by) in [
        (C1, HOUR_BACK),
        (C2, HOUR),
        (MANAGER, HOUR_BACK),
        (GATEWAY, HOUR),
    ] {
        cell.environment(name, &[(VARIABLE, &format!("6000:{by}"))]);
    }
    cell.begin();
    let since_us = monotonic_us();
    let before = cell.owners();
    cell.run_for(Duration::from_secs(7));
    cell.rest("after the steps");
    let taken = cell.taken_since(since_us);
    assert!(
        taken.is_empty(),
        "{taken:?} of {before:?}\n{}",
        cell.report()
    );
    cell.judge("steps of the wall clock", since_us);
}

#[test]
fn a_process_that_starts_again_with_its_clock_set_back_is_accepted_as_the_later_life() {
    let Some(mut cell) = Cell::start(&[C1, C2]) else {
        return;
    };
    for name in [C1, MANAGER, GATEWAY, C2] {
        let case = format!("{name} started again an hour earlier");
        eprintln!("{:6.1} s  {case}", cell.seconds());
        let since_us = monotonic_us();
        cell.kill(name);
        cell.environment(name, &[(VARIABLE, &format!("0:{HOUR_BACK}"))]);
        if name.starts_with("controller") {
            cell.until_driven_without(&case, &[name]);
        }
        cell.run(name);
        // Orders of the new life are obeyed, and the new life is given work.
        cell.rest(&case);
        let (from, mcs) = cell.busiest();
        let to = if from == C1 { C2 } else { C1 };
        cell.move_along(&mcs[0], to);
        let mc = mcs[0].clone();
        cell.until(&format!("{case}: {mc} moved to {to}"), |j| {
            j.takeovers_since(since_us)
                .iter()
                .any(|t| t.mc == mc && t.released && t.to.1.controller.as_str() == to)
        });
        cell.rest(&case);
        cell.judge(&case, since_us);
    }
}
