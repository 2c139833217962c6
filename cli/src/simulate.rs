//! `fam simulate`: seeded schedules of faults against a whole simulated cell, and replays of recorded ones.

use anyhow::{Context, Result};
use clap::Args;
use fam_simulation::campaign::{Record, Tally};
use fam_simulation::invariants::Violation;
use fam_simulation::simulator::{Options, Profile, Stage, kinds, run};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How often progress is told.
const TELL_EVERY: Duration = Duration::from_secs(30);
/// Failures that are shrunk and written down; more of one run have mostly the same cause.
const RECORDED_MAX: usize = 10;

/// Seeded simulation of whole cells under faults
#[derive(Debug, Clone, Args)]
pub struct SimulateArgs {
    /// Number of schedules
    #[arg(long, default_value_t = 1_000, conflicts_with = "replay")]
    seeds: u64,
    /// First seed
    #[arg(long, default_value_t = 0, conflicts_with = "replay")]
    from: u64,
    /// Which cells, and how much goes wrong: default, harsh, large, plc, fms200, marking
    #[arg(long, default_value = "default", conflicts_with = "replay")]
    profile: Profile,
    /// Run one recorded schedule again and print its event log
    #[arg(long, value_name = "FILE")]
    replay: Option<PathBuf>,
    /// Where schedules that break a promise are written, shrunk
    #[arg(long, value_name = "DIRECTORY", default_value = "target/simulation")]
    failures: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// Runs them; `false` if a promise was broken, or a stage that could be hit was not.
///
/// # Errors
/// A record that does not read, a directory that cannot be written.
pub fn run_schedules(args: &SimulateArgs) -> Result<bool> {
    let began = Instant::now();
    let mut tally = Tally::default();
    let name = match &args.replay {
        Some(path) => {
            replay(path, args.json, &mut tally)?;
            "replay"
        }
        None => {
            campaign(args, began, &mut tally)?;
            args.profile.name()
        }
    };
    let gaps = match args.profile {
        Profile::Default if args.replay.is_none() => tally.gaps(),
        _ => Vec::new(),
    };
    let seconds = began.elapsed().as_secs_f64();
    if args.json {
        println!("{}", in_json(name, &tally, &gaps, seconds));
    } else {
        print_words(&tally, &gaps, seconds);
    }
    Ok(tally.violations.is_empty() && gaps.is_empty())
}

fn campaign(args: &SimulateArgs, began: Instant, tally: &mut Tally) -> Result<()> {
    let options = Options::of(args.profile);
    let mut told = began;
    for seed in args.from..args.from.saturating_add(args.seeds) {
        let outcome = run(seed, &options);
        tally.add(&outcome);
        if let Some(violation) = outcome.violations.first() {
            eprintln!("seed {seed}: {violation}");
        }
        if let Some(record) = Record::of(&outcome, args.profile)
            && tally.violations.len() <= RECORDED_MAX
        {
            let path = keep(&args.failures, &record.shrunk(&options))?;
            eprintln!("  shrunk to {}", path.display());
        }
        if told.elapsed() >= TELL_EVERY {
            told = Instant::now();
            eprintln!(
                "{} of {} schedules, {} with violations",
                tally.schedules,
                args.seeds,
                tally.violations.len()
            );
        }
    }
    Ok(())
}

fn keep(directory: &Path, record: &Record) -> Result<PathBuf> {
    std::fs::create_dir_all(directory)
        .with_context(|| format!("cannot make the directory {}", directory.display()))?;
    let name = format!("{}-{}.toml", record.profile.name(), record.seed);
    let path = directory.join(name);
    std::fs::write(&path, record.write()?)
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(path)
}

fn replay(path: &Path, quiet: bool, tally: &mut Tally) -> Result<()> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let record = Record::read(&text).with_context(|| path.display().to_string())?;
    let options = Options {
        log: !quiet,
        ..record.options()
    };
    let outcome = run(record.seed, &options);
    for line in &outcome.log {
        println!("{line}");
    }
    for violation in &outcome.violations {
        eprintln!("{violation}");
    }
    tally.add(&outcome);
    Ok(())
}

fn in_json(name: &str, tally: &Tally, gaps: &[(&str, Stage)], seconds: f64) -> Value {
    let violation =
        |(seed, violation): &(u64, Violation)| json!({"seed": seed, "text": violation.to_string()});
    let mut matrix = Map::new();
    for kind in kinds() {
        let row = Stage::ALL.map(|s| (s.words().to_owned(), json!(tally.matrix.hits(kind, s))));
        matrix.insert(kind.to_owned(), Value::Object(row.into_iter().collect()));
    }
    json!({
        "profile": name,
        "schedules": tally.schedules,
        "violations": tally.violations.len(),
        "violated": tally.violations.iter().map(violation).collect::<Vec<_>>(),
        "faults": tally.faults,
        "matrix": matrix,
        "not_reached": gaps.iter().map(|(kind, stage)| json!([kind, stage.words()])).collect::<Vec<_>>(),
        "events": tally.events,
        "virtual_seconds": tally.virtual_us as f64 / 1e6,
        "virtual_seconds_min": tally.virtual_us_min as f64 / 1e6,
        "faults_min": tally.faults_min,
        "nothing_in_flight": tally.undisturbed,
        "slowest_recovery_seconds": tally.slowest_us as f64 / 1e6,
        "products": tally.products,
        "seconds": seconds,
    })
}

fn print_words(tally: &Tally, gaps: &[(&str, Stage)], seconds: f64) {
    println!(
        "{} schedules in {seconds:.1} s ({:.0} a minute), {} with violations; {} faults, {:.0} virtual seconds, slowest recovery {:.3} s",
        tally.schedules,
        tally.schedules as f64 / seconds * 60.0,
        tally.violations.len(),
        tally.faults.values().sum::<u64>(),
        tally.virtual_us as f64 / 1e6,
        tally.slowest_us as f64 / 1e6
    );
    if tally.schedules > 1 {
        println!("\nHow often a fault has hit a stage of a flow:\n");
        println!("{}", tally.matrix_table());
    }
    for (kind, stage) in gaps {
        println!(
            "not reached: {kind} during {}; run more seeds, or aim better",
            stage.words()
        );
    }
}
