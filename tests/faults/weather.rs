//! Networks that are bad rather than cut: slow, lossy, doubling, reordering.

use crate::cell::{C1, C2, Cell};
use crate::journal::monotonic_us;
use crate::net::fabric::Weather;
use std::time::Duration;

/// How long each kind of weather lasts.
const LASTS: Duration = Duration::from_secs(4);

#[test]
fn slow_lossy_doubling_and_reordering_networks_cost_time_and_nothing_else() {
    let Some(mut cell) = Cell::start(&[C1, C2]) else {
        return;
    };
    let calm = Weather::default();
    let weathers = [
        (
            "a delay of 200 ms",
            Weather {
                delay: Duration::from_millis(200),
                ..calm
            },
        ),
        (
            "10 % loss",
            Weather {
                loss_permille: 100,
                ..calm
            },
        ),
        (
            "every fifth packet twice",
            Weather {
                twice_permille: 200,
                ..calm
            },
        ),
        (
            "every fifth packet overtaken",
            Weather {
                overtaken_permille: 200,
                ..calm
            },
        ),
        (
            "all of it at once",
            Weather {
                delay: Duration::from_millis(30),
                loss_permille: 50,
                twice_permille: 100,
                overtaken_permille: 100,
                ..calm
            },
        ),
    ];
    for (name, weather) in weathers {
        let since_us = monotonic_us();
        let before = cell.fabric.packets();
        cell.fabric.set_all(weather);
        cell.run_for(LASTS);
        // What an operator wants in the worst moment: a move.
        let (from, mcs) = cell.busiest();
        cell.move_along(&mcs[0], if from == C1 { C2 } else { C1 });
        cell.run_for(LASTS / 4);
        let after = cell.fabric.packets();
        cell.fabric.mend();
        cell.rest(name);
        cell.journal.read();
        let takeovers = cell.journal.takeovers_since(since_us);
        eprintln!(
            "{:6.1} s  {name}: {} packets relayed, {} hindered, {} takeovers",
            cell.seconds(),
            after.0 - before.0,
            after.1 - before.1,
            takeovers.len()
        );
        assert!(after.1 - before.1 > 100, "{name} has hit nothing");
        cell.judge(name, since_us);
    }
}
