//! Hundreds of seeded schedules of faults hold the safety contract, planted bugs are found, and a seed says everything.
//!
//! A failing seed prints its event log. It is repeated with
//! `cargo run -p fam-simulation --example seeds -- <seed> 1 log`.

use fam_gateway_core::recorder::{Takeover, takeovers};
use fam_proto::{Applied, CommandKind, ControllerId, McId, Phase};
use fam_simulation::simulator::{Canary, Fault, Options, Outcome, Pid, cell, explain, run};
use std::collections::BTreeMap;

/// Schedules of the test; the planned long runs take millions.
const SEEDS: u64 = 240;
/// Schedules with larger cells and more trouble.
const HARSH_SEEDS: u64 = 16;
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
        "slow link",
        "lost images",
    ] {
        assert!(
            faults.get(kind).is_some_and(|n| *n >= 5),
            "{kind}: {faults:?}"
        );
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
fn the_contract_holds_in_larger_cells_under_more_faults() {
    let options = Options::harsh();
    hold(&all(10_000, HARSH_SEEDS, &options), &options);
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

/// Moves to and fro while images get lost: only then an epoch could begin on inputs older than its state.
fn moves_while_images_get_lost() -> Vec<(u64, Fault)> {
    let lost = |node| Fault::LostImages {
        node,
        permille: 600,
        us: 2_000_000,
    };
    let ask = |n: u64| {
        let mc = McId::new(&format!("Mc{}", 1 + n / 2 % 3)).unwrap();
        let to = ControllerId::new(&format!("controller{}", 1 + n % 2)).unwrap();
        let force = false;
        Fault::Command(CommandKind::Move { mc, to, force })
    };
    let moves = (0..12).map(|n| (1_000_000 + n * 150_000, ask(n)));
    let lost = [(900_000, lost(0)), (900_000, lost(1))];
    lost.into_iter().chain(moves).collect()
}

#[test]
fn planted_bugs_are_found() {
    let mut missed = Vec::new();
    for (canary, invariant, seeds) in Canary::ALL {
        let script = (canary == Canary::OldInputs).then(moves_while_images_get_lost);
        let options = Options {
            canary: Some(canary),
            script,
            ..Options::default()
        };
        let found = (0..seeds).find(|seed| {
            let violations = run(*seed, &options).violations;
            violations.iter().any(|v| v.invariant == invariant)
        });
        match found {
            Some(seed) => println!(
                "{canary:?}: found by `{invariant}` after {} seeds",
                seed + 1
            ),
            None => missed.push((canary, seeds)),
        }
    }
    assert!(
        missed.is_empty(),
        "planted bugs not found within so many seeds: {missed:?}"
    );
}

/// Without other trouble a crash is answered fast: time from the scan that is missed to the first frame of the new owner.
#[test]
fn a_crash_in_calm_weather_is_answered_within_the_bound() {
    const BOUND_US: u64 = 20_000;
    let mut gaps_us = Vec::new();
    for seed in 0..40 {
        let crash = |node| Fault::Crash {
            pid: Pid::Node(node),
            after_outputs: None,
            down_us: Some(300_000),
        };
        let options = Options {
            script: Some(vec![
                (1_000_000 + seed * 137, crash(0)),
                (2_000_000 + seed * 137, crash(1)),
            ]),
            log: true,
            ..Options::default()
        };
        let outcome = run(seed, &options);
        let cell = cell(seed, &options);
        assert_eq!(outcome.violations, [], "seed {seed}");
        let crossed = |t: &Takeover| t.from.1.controller != t.to.1.controller && !t.released;
        for takeover in takeovers(&outcome.applied).iter().filter(|t| crossed(t)) {
            let stopped = |a: &Applied| {
                (&a.mc, a.at_us, a.phase) == (&takeover.mc, takeover.last_us, Phase::Stopped)
            };
            if outcome.applied.iter().any(stopped) {
                continue; // it had stopped safely, and an operator has reset it
            }
            assert_eq!(takeover.scans_behind, 0, "seed {seed}: {takeover:?}");
            let cycle_us = u64::from(cell.model.mc(&takeover.mc).unwrap().cycle_us);
            gaps_us.push((takeover.first_us - takeover.last_us).saturating_sub(cycle_us));
        }
    }
    gaps_us.sort_unstable();
    let of = |permille: usize| gaps_us[gaps_us.len() * permille / 1_000];
    println!(
        "{} takeovers: p50 {} us, p99 {} us, longest {} us",
        gaps_us.len(),
        of(500),
        of(990),
        of(999)
    );
    assert!(gaps_us.len() > 50, "{}", gaps_us.len());
    assert!(of(990) <= BOUND_US, "p99 {} us", of(990));
}

/// A planned move misses no scan: the first frame of the new owner follows within a cycle and a little.
#[test]
fn a_planned_move_in_calm_weather_misses_no_scan() {
    let mut moves = 0;
    for seed in 0..40 {
        let to = |n: usize| ControllerId::new(&format!("controller{n}")).unwrap();
        let mc = McId::new("Mc1").unwrap();
        let ask = |n, force| {
            Fault::Command(CommandKind::Move {
                mc: mc.clone(),
                to: to(n),
                force,
            })
        };
        let options = Options {
            script: Some(vec![
                (1_000_000, ask(1, false)),
                (1_300_000, ask(2, false)),
                (1_600_000, ask(1, false)),
            ]),
            log: true,
            ..Options::default()
        };
        let outcome = run(seed, &options);
        assert_eq!(outcome.violations, [], "seed {seed}");
        let cell = cell(seed, &options);
        for takeover in takeovers(&outcome.applied).iter().filter(|t| t.released) {
            assert_eq!(takeover.scans_behind, 0, "seed {seed}: {takeover:?}");
            let gap_us = takeover.first_us - takeover.last_us;
            let bound_us = 2 * u64::from(cell.model.mc(&takeover.mc).unwrap().cycle_us);
            assert!(
                gap_us < bound_us,
                "seed {seed}: {gap_us} us of {bound_us}: {takeover:?}"
            );
            moves += 1;
        }
    }
    assert!(moves > 40, "{moves}");
}
