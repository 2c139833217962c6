//! Every process killed at every stage of every flow. A stage is seen in the manager's log, and the kill follows at once.

use crate::cell::{C1, C2, C3, Cell, GATEWAY, MANAGER};
use crate::journal::monotonic_us;
use std::time::Duration;

/// What is under way when the kill comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Flow {
    Move,
    Failover,
    Join,
    Leave,
    ManagerRestart,
    GatewayRestart,
}

/// Who is killed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Victim {
    /// The controller that hands over, joins, or drives.
    First,
    /// The controller that takes over.
    Second,
    Manager,
    Gateway,
}

use Victim::{First, Gateway, Manager, Second};

/// Stages of a flow, as kinds of events, and who is killed at each.
const TABLE: [(Flow, &[&str], &[Victim]); 6] = [
    (
        Flow::Move,
        &["move-ordered", "mc-released", "mc-activated"],
        &[First, Second, Manager, Gateway],
    ),
    (
        Flow::Failover,
        &["controller-lost", "plan-decided", "mc-activated"],
        &[Second, Manager, Gateway],
    ),
    (
        Flow::Join,
        &["controller-joined", "plan-decided"],
        &[First, Manager, Gateway],
    ),
    (
        Flow::Leave,
        &["plan-decided", "mc-released"],
        &[First, Second, Manager, Gateway],
    ),
    (
        Flow::ManagerRestart,
        &["manager-started", "gateway-joined", "controller-joined"],
        &[Manager, Gateway, First],
    ),
    (
        Flow::GatewayRestart,
        &[
            "gateway-joined",
            "plan-decided",
            "mc-recovering",
            "mc-activated",
        ],
        &[Gateway, Manager, First],
    ),
];

/// How long a stage is waited for. A flow may pass without it: work is balanced already, say.
const STAGE_WITHIN: Duration = Duration::from_millis(1_500);

#[test]
fn moves_and_leaves() {
    run(&[Flow::Move, Flow::Leave]);
}

#[test]
fn failovers_and_joins() {
    run(&[Flow::Failover, Flow::Join]);
}

#[test]
fn restarts_of_manager_and_gateway() {
    run(&[Flow::ManagerRestart, Flow::GatewayRestart]);
}

fn run(flows: &[Flow]) {
    let Some(mut cell) = Cell::start(&[C1, C2, C3]) else {
        return;
    };
    for (flow, stages, victims) in TABLE {
        if !flows.contains(&flow) {
            continue;
        }
        let mut reached = 0;
        for stage in stages {
            for victim in victims {
                reached += usize::from(case(&mut cell, flow, stage, *victim));
            }
        }
        let cases = stages.len() * victims.len();
        eprintln!("{flow:?}: {reached} of {cases} stages reached");
        assert!(
            reached * 2 >= cases,
            "{flow:?}: only {reached} of {cases} stages were seen: the table does not fit the events any more"
        );
    }
}

/// One flow, one kill; `true` if its stage was seen.
fn case(cell: &mut Cell, flow: Flow, stage: &str, victim: Victim) -> bool {
    let case = format!("{flow:?}: {victim:?} killed at {stage}");
    let (first, mcs) = cell.busiest();
    let second = [C1, C2, C3]
        .into_iter()
        .find(|c| *c != first)
        .expect("another one");
    let since_us = monotonic_us();
    let at = cell.log(MANAGER).len();
    let killed = match victim {
        First => first.as_str(),
        Second => second,
        Manager => MANAGER,
        Gateway => GATEWAY,
    };
    match flow {
        Flow::Move => cell.move_along(&mcs[0], second),
        Flow::Failover => cell.kill(&first),
        Flow::Join => {
            cell.kill(&first);
            cell.until_driven_without(&case, &[first.as_str()]);
            cell.run(&first);
        }
        Flow::Leave => cell.signal(&first, libc::SIGTERM),
        Flow::ManagerRestart => {
            cell.kill(MANAGER);
            cell.run(MANAGER);
        }
        Flow::GatewayRestart => {
            cell.kill(GATEWAY);
            cell.run(GATEWAY);
        }
    }
    let kind = format!("\"kind\":\"{stage}\"");
    let seen = cell.log(MANAGER).wait(at, &[&kind], STAGE_WITHIN).is_some();
    cell.kill(killed);
    if flow == Flow::Leave && victim != First {
        // It ends by itself when all is handed over, or is ended if nobody is there to take it.
        if !cell.leaves(&first) {
            cell.kill(&first);
        }
    }
    cell.run_all();
    cell.rest(&case);
    cell.judge(&case, since_us);
    eprintln!(
        "{:6.1} s  {case}{}",
        cell.seconds(),
        if seen { "" } else { " (not seen)" }
    );
    seen
}
