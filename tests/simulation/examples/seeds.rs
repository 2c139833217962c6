//! Runs a range of seeds and says what came of them: `cargo run --release -p fam-simulation --example seeds -- 0 1000`.
//!
//! With a single seed and `log` the event log is printed: `... --example seeds -- 17 1 log`. `harsh` takes larger cells and more trouble.

use fam_simulation::simulator::{Options, explain, run};
use std::collections::BTreeMap;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize, or: u64| words.get(at).and_then(|w| w.parse().ok()).unwrap_or(or);
    let has = |word: &str| words.iter().any(|w| w == word);
    let (from, count) = (number(0, 0), number(1, 100));
    let options = if has("harsh") {
        Options::harsh()
    } else {
        Options::default()
    };
    if has("log") {
        print!("{}", explain(from, &options));
        return;
    }
    let mut faults: BTreeMap<&str, u64> = BTreeMap::new();
    let mut deeds: BTreeMap<&str, u64> = BTreeMap::new();
    let (mut events, mut virtual_us, mut slowest_us, mut broken) = (0, 0, 0, 0);
    for seed in from..from + count {
        let outcome = run(seed, &options);
        for (kind, n) in &outcome.faults {
            *faults.entry(kind).or_default() += n;
        }
        for (kind, n) in &outcome.deeds {
            *deeds.entry(kind).or_default() += n;
        }
        events += outcome.events;
        virtual_us += outcome.virtual_us;
        slowest_us = slowest_us.max(outcome.recovered_us);
        if let Some(violation) = outcome.violations.first() {
            broken += 1;
            println!("seed {seed}: {violation}");
        }
    }
    println!(
        "{count} seeds, {broken} with violations, {events} events, {:.1} virtual s, slowest recovery {:.3} s",
        virtual_us as f64 / 1e6,
        slowest_us as f64 / 1e6
    );
    println!("faults: {faults:?}");
    println!("deeds: {deeds:?}");
    if broken > 0 {
        std::process::exit(1);
    }
}
