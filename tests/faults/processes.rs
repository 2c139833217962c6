//! Processes that are frozen and resumed.

use crate::cell::{C1, C2, Cell, GATEWAY, MANAGER, PLANT};
use crate::journal::monotonic_us;
use fam_proto::EventKind;
use std::time::Duration;

#[test]
fn whoever_is_frozen_and_resumed_drives_nothing_that_others_have_taken_over() {
    let Some(mut cell) = Cell::start(&[C1, C2]) else {
        return;
    };
    for (name, lasts_ms) in [
        (C1, 700),
        (C2, 700),
        (C1, 30),
        (MANAGER, 1_500),
        (GATEWAY, 300),
        (GATEWAY, 1_500),
        (PLANT, 200),
    ] {
        let case = format!("a freeze of {name} for {lasts_ms} ms");
        eprintln!("{:6.1} s  {case}", cell.seconds());
        let (seq, since_us) = (cell.last_event(), monotonic_us());
        let drove = cell.owners().values().any(|by| by == name);
        let lasts = Duration::from_millis(lasts_ms);
        cell.signal(name, libc::SIGSTOP);
        if name.starts_with("controller") && lasts_ms > 100 {
            cell.until_driven_without(&case, &[name]);
        }
        cell.run_for(lasts);
        cell.signal(name, libc::SIGCONT);
        cell.rest(&case);
        cell.judge(&case, since_us);
        if drove && lasts_ms > 100 {
            let kinds = [EventKind::ControllerLost, EventKind::McSuspect];
            cell.told(&case, seq, &kinds);
        }
        if name == MANAGER {
            let taken = cell.taken_since(since_us);
            assert!(
                taken.is_empty(),
                "{case} took MCs from their owners: {taken:?}\n{}",
                cell.report()
            );
        }
    }
}
