//! `cargo run --release -p fam-reference --example random -- FROM COUNT`: so many random projects of 20 programs and 20 charts each, with
//! totals.

use fam_reference::{chart, compare, session};

const PROGRAMS: usize = 20;
const CHARTS: usize = 20;
const CHART_SCANS: usize = 40;

fn main() -> std::process::ExitCode {
    let mut args = std::env::args()
        .skip(1)
        .filter_map(|a| a.parse::<u64>().ok());
    let (from, count) = (args.next().unwrap_or(0), args.next().unwrap_or(100));
    let engine = compare::engine();
    let mut all = session::Tally::default();
    let (mut failures, mut chart_scans) = (0, 0);
    for seed in from..from + count {
        match session::project(&engine, seed, PROGRAMS) {
            Ok(tally) => all.add(&tally),
            Err(text) => {
                failures += 1;
                println!("{text}\n");
            }
        }
        match chart::compare(&engine, seed, CHARTS, CHART_SCANS) {
            Ok(scans) => chart_scans += scans,
            Err(text) => {
                failures += 1;
                println!("{text}\n");
            }
        }
        if (seed - from + 1).is_multiple_of(250) {
            println!(
                "{} projects, {} programs, {failures} differ",
                seed - from + 1,
                all.programs
            );
        }
    }
    println!(
        "seeds {from} to {}: {} programs agreed over {} scans ({} ended in the same trap), {} skipped, {} refused by the checker, {failures} differ; {} charts agreed over {chart_scans} scans",
        from + count - 1,
        all.programs,
        all.scans,
        all.trapped,
        all.skipped,
        all.refused,
        chart_scans / CHART_SCANS as u64
    );
    for (feature, times) in &all.features {
        println!("  {times:>9}  {feature}");
    }
    if failures == 0 {
        std::process::ExitCode::SUCCESS
    } else {
        std::process::ExitCode::FAILURE
    }
}
