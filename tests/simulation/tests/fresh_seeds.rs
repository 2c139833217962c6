//! Seeds that nobody has run before: each day others, for as long as `FAM_SIMULATION_SECONDS` says (30 s if it says nothing).
//!
//! The first seed is printed; `FAM_SIMULATION_FROM` repeats a run. A failure is shrunk and written to the directory of test results.

#![allow(clippy::disallowed_methods)] // the day chooses the seeds, a clock ends the run; no schedule reads either

use fam_simulation::campaign::{Record, Tally};
use fam_simulation::simulator::{Options, Profile, run};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

const SECONDS: u64 = 30;
const SECONDS_A_DAY: u64 = 86_400;
/// More than are run in a day.
const SEEDS_A_DAY: u64 = 10_000_000;
const THREADS: usize = 2;

fn number(variable: &str) -> Option<u64> {
    let text = std::env::var(variable).ok()?;
    Some(
        text.parse()
            .unwrap_or_else(|_| panic!("{variable} is `{text}`, expected a number")),
    )
}

#[test]
fn the_contract_holds_for_seeds_of_today() {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    let today = now.as_secs() / SECONDS_A_DAY * SEEDS_A_DAY;
    let from = number("FAM_SIMULATION_FROM").unwrap_or(today);
    let seconds = number("FAM_SIMULATION_SECONDS").unwrap_or(SECONDS);
    println!("seeds from {from} for {seconds} s");
    let ends = Instant::now() + Duration::from_secs(seconds);
    let (next, all) = (AtomicU64::new(from), Mutex::new(Tally::default()));
    let options = Options::of(Profile::Default);
    std::thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                while Instant::now() < ends {
                    let outcome = run(next.fetch_add(1, Ordering::Relaxed), &options);
                    all.lock().unwrap().add(&outcome);
                }
            });
        }
    });
    let tally = all.into_inner().unwrap();
    println!(
        "{} schedules, {} faults",
        tally.schedules,
        tally.faults.values().sum::<u64>()
    );
    let Some((seed, violation)) = tally.violations.first() else {
        return;
    };
    let record = Record::of(&run(*seed, &options), Profile::Default).expect("it fails again");
    let path = format!("{}/default-{seed}.toml", env!("CARGO_TARGET_TMPDIR"));
    let text = record.shrunk(&options).write().unwrap();
    std::fs::write(&path, text).unwrap();
    panic!("seed {seed}: {violation}; shrunk to {path}, `fam simulate --replay` runs it again");
}
