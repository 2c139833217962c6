//! Runs a range of seeds and says what came of them: `cargo run --release -p fam-simulation --example seeds -- 0 1000 [PROFILE]`.
//!
//! With a single seed and `log` the event log is printed: `... --example seeds -- 17 1 log`; `shrink` writes what is left of each failing
//! schedule to a file of its own. `fam simulate` does the same for users.

#![allow(clippy::disallowed_methods)] // how long it took is told to people

use fam_simulation::campaign::{Record, Tally};
use fam_simulation::simulator::{Options, Profile, explain, run};
use std::time::Instant;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize, or: u64| words.get(at).and_then(|w| w.parse().ok()).unwrap_or(or);
    let has = |word: &str| words.iter().any(|w| w == word);
    let (from, count) = (number(0, 0), number(1, 100));
    let profile = Profile::ALL.into_iter().find(|p| has(p.name()));
    let profile = profile.unwrap_or(Profile::Default);
    let options = Options::of(profile);
    if has("log") {
        print!("{}", explain(from, &options));
        return;
    }
    let began = Instant::now();
    let mut tally = Tally::default();
    for seed in from..from + count {
        let outcome = run(seed, &options);
        tally.add(&outcome);
        let Some(record) = Record::of(&outcome, profile) else {
            continue;
        };
        println!("seed {seed}: {}", record.violation);
        if has("shrink") {
            let record = record.shrunk(&options);
            let path = format!("seed{seed}.toml");
            println!("  {} faults left", record.faults.len());
            if let Ok(text) = record.write()
                && let Err(error) = std::fs::write(&path, text)
            {
                println!("  {path}: {error}");
            }
        }
    }
    let seconds = began.elapsed().as_secs_f64();
    println!(
        "{count} schedules in {seconds:.1} s ({:.0} a minute), {} with violations, {} events, {:.1} virtual s, shortest {:.1} s, at least {} faults, {} undisturbed, slowest recovery {:.3} s, {} products",
        count as f64 / seconds * 60.0,
        tally.violations.len(),
        tally.events,
        tally.virtual_us as f64 / 1e6,
        tally.virtual_us_min as f64 / 1e6,
        tally.faults_min,
        tally.undisturbed,
        tally.slowest_us as f64 / 1e6,
        tally.products
    );
    if count > 1 {
        println!("{}", tally.matrix_table());
        println!("deeds: {:?}", tally.deeds);
        println!("not reached: {:?}", tally.matrix.empty());
    }
    if !tally.violations.is_empty() {
        std::process::exit(1);
    }
}
