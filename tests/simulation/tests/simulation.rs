//! Hundreds of seeded schedules of faults hold the safety contract, planted bugs are found, and a seed says everything.
//!
//! A failing seed prints its event log. It is repeated with
//! `cargo run -p fam-simulation --example seeds -- <seed> 1 log`.

use fam_simulation::simulator::{Canary, Options, Outcome, explain, run};
use std::collections::BTreeMap;

/// Schedules of the test; the planned long runs take millions.
const SEEDS: u64 = 240;
/// Of these, so many run with the real repository on a simulated disk.
const DISK_SEEDS: u64 = 12;
/// Threads that share the seeds.
const THREADS: u64 = 2;
/// Lines of a log that are printed: what comes last before the violation.
const LINES_MAX: usize = 400;

fn all(from: u64, count: u64, options: &Options) -> Vec<Outcome> {
    std::thread::scope(|scope| {
        let share = |n: u64| {
            (from..from + count)
                .filter(|seed| seed % THREADS == n)
                .map(|seed| run(seed, options))
                .collect::<Vec<_>>()
        };
        let threads: Vec<_> = (0..THREADS)
            .map(|n| scope.spawn(move || share(n)))
            .collect();
        threads
            .into_iter()
            .flat_map(|thread| thread.join().expect("a run does not panic"))
            .collect()
    })
}

fn hold(outcomes: &[Outcome], options: &Options) {
    let broken: Vec<&Outcome> = outcomes
        .iter()
        .filter(|o| !o.violations.is_empty())
        .collect();
    if let Some(first) = broken.first() {
        let text = explain(first.seed, options);
        let lines: Vec<&str> = text.lines().collect();
        let from = lines.len().saturating_sub(LINES_MAX);
        println!("{}", lines[from..].join("\n"));
        let seeds: Vec<u64> = broken.iter().map(|o| o.seed).collect();
        panic!(
            "{} of {} schedules break the contract, seeds {seeds:?}; the first: seed {}: {}",
            broken.len(),
            outcomes.len(),
            first.seed,
            first.violations[0]
        );
    }
}

fn sums(
    outcomes: &[Outcome],
    of: impl Fn(&Outcome) -> &BTreeMap<&'static str, u64>,
) -> BTreeMap<&'static str, u64> {
    let mut sums = BTreeMap::new();
    for outcome in outcomes {
        for (kind, n) in of(outcome) {
            *sums.entry(*kind).or_default() += n;
        }
    }
    sums
}

#[test]
fn the_contract_holds_under_faults() {
    let options = Options::default();
    let outcomes = all(0, SEEDS, &options);
    hold(&outcomes, &options);
    // A simulation in which nothing happens would hold, too.
    let faults = sums(&outcomes, |o| &o.faults);
    for kind in [
        "node crash",
        "node freeze",
        "node SIGTERM",
        "manager crash",
        "manager freeze",
        "gateway crash",
        "gateway freeze",
        "one-way cut",
        "two-way cut",
        "isolation",
        "delay",
        "reordering",
        "loss",
        "duplication",
        "move",
        "drain",
        "trap",
        "silent field",
        "manager's disk fails",
        "late ticks",
    ] {
        assert!(faults.get(kind).is_some_and(|n| *n >= 5), "{kind}: {faults:?}");
    }
    let deeds = sums(&outcomes, |o| &o.deeds);
    for (kind, at_least) in [
        ("owner changed", 5 * SEEDS),
        ("MC released", SEEDS / 4),
        ("MC recovering", SEEDS / 8),
        ("fail-safe", SEEDS / 8),
        ("controller lost", SEEDS / 4),
    ] {
        let n = deeds.get(kind).copied().unwrap_or(0);
        assert!(n >= at_least, "{kind}: {n} of {at_least}; {deeds:?}");
    }
}

#[test]
fn the_contract_holds_with_the_real_repository() {
    let options = Options {
        disk: true,
        ..Options::default()
    };
    hold(&all(10_000, DISK_SEEDS, &options), &options);
}

#[test]
fn a_seed_says_everything() {
    let options = Options {
        log: true,
        ..Options::default()
    };
    for seed in [3, 4] {
        let (one, two) = (run(seed, &options), run(seed, &options));
        assert!(one.log.len() > 100, "seed {seed}: {} lines", one.log.len());
        assert_eq!(one, two, "seed {seed}");
    }
    assert_ne!(run(3, &options).digest, run(4, &options).digest);
}

/// Each planted bug is found by its invariant within this many seeds.
const CANARY_SEEDS: u64 = 60;

#[test]
fn planted_bugs_are_found() {
    let mut missed = Vec::new();
    for (canary, invariant) in Canary::ALL {
        let options = Options {
            canary: Some(canary),
            ..Options::default()
        };
        let found = (0..CANARY_SEEDS).find_map(|seed| {
            let violations = run(seed, &options).violations;
            violations
                .iter()
                .any(|v| v.invariant == invariant)
                .then_some(seed)
        });
        match found {
            Some(seed) => println!("{canary:?}: found by `{invariant}` after {} seeds", seed + 1),
            None => missed.push(canary),
        }
    }
    assert!(missed.is_empty(), "not found within {CANARY_SEEDS} seeds: {missed:?}");
}
