//! Hundreds of seeded schedules of faults hold the safety contract, planted bugs are found, a seed says everything, and what was found
//! once stays mended.
//!
//! A failing seed prints its event log. It is repeated with
//! `cargo run -p fam-simulation --example seeds -- <seed> 1 log`.

use fam_gateway_core::recorder::{Takeover, takeovers};
use fam_proto::{Applied, CommandKind, ControllerId, McId, Phase};
use fam_simulation::campaign::{Record, Tally};
use fam_simulation::simulator::{
    Canary, Fault, Options, Outcome, Pid, Profile, cell, explain, kinds, run,
};

/// Schedules of the test; the long runs take hundreds of thousands (RECORD.md).
const SEEDS: u64 = 240;
/// Schedules of each other profile.
const OTHER_SEEDS: [(Profile, u64); 5] = [
    (Profile::Harsh, 10),
    (Profile::Plc, 12),
    (Profile::Fms200, 4),
    (Profile::Marking, 4),
    (Profile::Large, 1),
];
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

#[test]
fn the_contract_holds_under_faults() {
    let options = Options::default();
    let outcomes = all(0, SEEDS, &options);
    hold(&outcomes, &options);
    let mut tally = Tally::default();
    outcomes.iter().for_each(|o| tally.add(o));
    // A simulation in which nothing happens would hold, too.
    for kind in kinds() {
        let n = tally.faults.get(kind).copied().unwrap_or(0);
        assert!(n >= 5, "{kind}: {n}");
    }
    for (kind, at_least) in [
        ("owner changed", 8 * SEEDS),
        ("MC released", SEEDS),
        ("MC recovering", SEEDS),
        ("fail-safe", SEEDS),
        ("controller lost", SEEDS),
    ] {
        let n = tally.deeds.get(kind).copied().unwrap_or(0);
        assert!(n >= at_least, "{kind}: {n} of {at_least}");
    }
    assert!(tally.faults_min >= 5, "{} faults", tally.faults_min);
    assert!(tally.virtual_us_min >= 10_000_000);
    let calm: Vec<u64> = outcomes
        .iter()
        .filter(|o| o.in_flight == 0)
        .map(|o| o.seed)
        .collect();
    assert!(
        calm.is_empty(),
        "nothing was in flight under a fault: seeds {calm:?}"
    );
    let empty = tally.matrix.empty();
    assert!(empty.len() < 60, "stages not hit: {empty:?}");
}

#[test]
fn the_contract_holds_in_other_cells() {
    for (profile, seeds) in OTHER_SEEDS {
        let options = Options::of(profile);
        let outcomes = all(10_000, seeds, &options);
        hold(&outcomes, &options);
        let products: u64 = outcomes.iter().map(|o| o.products).sum();
        let has_plant = matches!(profile, Profile::Fms200 | Profile::Marking);
        assert_eq!(has_plant, products > 0, "{profile:?}");
    }
}

/// What is written down of a schedule makes the same run again.
#[test]
fn a_recorded_schedule_replays() {
    let logged = |options: Options| Options {
        log: true,
        ..options
    };
    for seed in [5, 6, 7] {
        let first = run(seed, &logged(Options::default()));
        let record = Record {
            seed,
            profile: Profile::Default,
            violation: String::new(),
            cause: String::new(),
            quiet_us: first.quiet_us,
            faults: first.carried_as_recorded(),
            log: Vec::new(),
        };
        let read = Record::read(&record.write().unwrap()).unwrap();
        assert_eq!(read, record);
        let again = run(seed, &logged(read.options()));
        // The first line tells how many faults were planned.
        let differs = (1..first.log.len()).find(|n| first.log.get(*n) != again.log.get(*n));
        assert_eq!(
            differs.map(|n| (&first.log[n], again.log.get(n))),
            None,
            "seed {seed}"
        );
        assert_eq!(first.carried, again.carried);
    }
}

/// A gateway that dies at any step of setting fail-safe values knows of them afterwards.
#[test]
fn a_gateway_that_dies_while_it_sets_fail_safe_values_knows_of_them() {
    let seed = 1;
    let cell = cell(seed, &Options::default());
    let crash = |pid, after_outputs, down_us| Fault::Crash {
        pid,
        after_outputs,
        down_us: Some(down_us),
    };
    let mut died_after = 0;
    for outputs in 0..30 {
        let watchdog_us = cell.mcs[0].model.watchdog_us;
        let nodes = (0..cell.controllers.len()).map(Pid::Node);
        // They are back before the watchdog strikes once more.
        let mut script: Vec<(u64, Fault)> = nodes
            .map(|pid| (1_000_000, crash(pid, None, watchdog_us + 120_000)))
            .collect();
        let gateway = crash(Pid::Gateway, Some(outputs), 100_000);
        script.push((1_000_000 + watchdog_us - 12_000, gateway));
        let options = Options {
            script: Some(script),
            ..Options::default()
        };
        let outcome = run(seed, &options);
        assert_eq!(outcome.violations, [], "after {outputs} outputs");
        died_after += outcome.deeds.get("fail-safe").copied().unwrap_or(0);
    }
    assert!(died_after > 0);
}

/// A planted bug is shrunk to a schedule that is smaller and still finds it.
#[test]
fn a_failure_is_shrunk() {
    let options = Options {
        canary: Some(Canary::GatewayForgetsRecords),
        ..Options::default()
    };
    let found = (0..20).find_map(|seed| Record::of(&run(seed, &options), Profile::Default));
    let record = found.expect("a planted bug is found");
    let shrunk = record.shrunk(&options);
    assert!(shrunk.faults.len() <= 3, "{:?}", shrunk.faults);
    assert!(!shrunk.log.is_empty());
    let with = Options {
        canary: options.canary,
        ..shrunk.options()
    };
    assert!(!run(shrunk.seed, &with).violations.is_empty());
}

/// Each bug that the simulation has found is kept as the schedule that found it.
#[test]
fn recorded_failures_stay_mended() {
    let directory = concat!(env!("CARGO_MANIFEST_DIR"), "/regressions");
    let mut replayed = 0;
    for entry in std::fs::read_dir(directory).expect("the recorded schedules") {
        let path = entry.expect("an entry").path();
        let text = std::fs::read_to_string(&path).expect("a file");
        let record = Record::read(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let outcome = record.replay();
        assert_eq!(outcome.violations, [], "{}", path.display());
        assert!(!outcome.carried.is_empty(), "{}", path.display());
        replayed += 1;
    }
    assert!(replayed >= 5, "{replayed}");
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
        let profile = match canary {
            Canary::StartsCold => Profile::Fms200,
            _ => Profile::Default,
        };
        let options = Options {
            canary: Some(canary),
            only: Some(invariant),
            script,
            ..Options::of(profile)
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
