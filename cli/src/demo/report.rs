//! Final checks, totals, and the table at the end of the demo.

use super::stage::Stage;
use crate::report::{Check, Entry, Report, Sample, Totals};
use crate::status::{colours, number, percent, table};
use comfy_table::Cell;
use fam_gateway_core::recorder;
use fam_proto::Severity;
use std::path::Path;
use std::time::Duration;

/// What has to be true when the story is over.
pub fn final_checks(s: &mut Stage, seed: u64) {
    let doubles = recorder::double_driven_scans(&s.eye.seen().applied);
    s.check(
        "no scan was driven by two controllers",
        doubles == 0,
        format!("{doubles} of {} frames applied", s.eye.seen().applied.len()),
    );
    let holes = s.eye.seen().holes;
    s.check(
        "the journal of applied frames is whole",
        holes == 0,
        format!("{holes} entries lost on the way to the observer"),
    );
    let plant = match s.plant() {
        Ok(plant) => plant,
        Err(error) => return s.check("the plant gives its account", false, format!("{error:#}")),
    };
    let first = plant.incidents.first().map_or("none".to_owned(), |i| {
        format!("{} in all, the first: {i}", plant.incidents.len())
    });
    s.check(
        "the plant has noticed no incident",
        plant.incidents.is_empty(),
        first,
    );
    s.check(
        "no part is lost, doubled or damaged",
        plant.ledger.lost == 0 && plant.ledger.damaged == 0 && plant.ledger.balanced(),
        plant.ledger.to_string(),
    );
    // A pallet that missed its station goes round again: sets are compared by their order, not by their time.
    let mut got = plant.products;
    got.sort_by_key(|p| p.order);
    let mut expected = fam_simulation::undisturbed::products(seed, got.len());
    expected.sort_by_key(|p| p.order);
    let differ = expected
        .iter()
        .zip(&got)
        .find(|(a, b)| a.contents() != b.contents());
    let (held, seen) = match differ {
        None => (!got.is_empty(), format!("{} sets equal", got.len())),
        Some((expected, got)) => (false, format!("finished: {got}; undisturbed: {expected}")),
    };
    s.check(
        "the finished products equal those of an undisturbed run",
        held,
        seen,
    );
}

/// Puts everything together.
#[allow(clippy::cast_precision_loss)]
pub fn make(s: &Stage, seed: u64, started: String) -> Report {
    let seen = s.eye.seen();
    let now_us = crate::observe::monotonic_us();
    let now = std::time::Instant::now();
    let at_s = |at: std::time::Instant| s.seconds(now_us) - now.duration_since(at).as_secs_f64();
    let samples: Vec<Sample> = seen
        .history
        .iter()
        .flat_map(|(at, status)| {
            let at_s = at_s(*at);
            status
                .controllers
                .iter()
                .filter(|c| c.boot.is_some())
                .map(move |c| {
                    let report = c.report.as_ref();
                    Sample {
                        at_s,
                        controller: c.controller.to_string(),
                        workload_percent: report.map_or(0.0, |r| percent(r.workload_permille)),
                        active: c
                            .active
                            .iter()
                            .map(fam_proto::McId::as_str)
                            .collect::<Vec<_>>()
                            .join(" "),
                        process_cpu_percent: report
                            .map_or(0.0, |r| percent(r.process_cpu_permille)),
                        process_memory_mb: report
                            .map_or(0.0, |r| r.process_memory_kb as f64 / 1024.0),
                        up: c.up && report.is_some(),
                    }
                })
        })
        .collect();
    // The manager's clock restarts with it; the wall clock of events is this machine's.
    let wall_us = std::time::SystemTime::now()
        .duration_since(std::time::UNIX_EPOCH)
        .unwrap_or(Duration::ZERO)
        .as_micros() as f64;
    let events = seen
        .events
        .iter()
        .map(|e| Entry {
            at_s: s.seconds(now_us) - (wall_us - e.wall_us as f64) / 1e6,
            severity: match e.severity {
                Severity::Info => "info",
                Severity::Warning => "warning",
                Severity::Alarm => "alarm",
            }
            .to_owned(),
            kind: serde_json::to_value(e.kind)
                .ok()
                .and_then(|k| k.as_str().map(str::to_owned))
                .unwrap_or_default(),
            mc: e.mc.as_ref().map(ToString::to_string),
            controller: e.controller.as_ref().map(ToString::to_string),
            text: e.text.clone(),
        })
        .collect();
    drop(seen);
    let plant = s.plant().ok();
    let seen = s.eye.seen();
    let totals = Totals {
        products: plant.as_ref().map_or(0, |p| p.products.len() as u64),
        parts_lost: plant.as_ref().map_or(0, |p| p.ledger.lost),
        parts_damaged: plant.as_ref().map_or(0, |p| p.ledger.damaged),
        incidents: plant.as_ref().map_or(0, |p| p.incidents.len() as u64),
        frames_rejected: s.steps.iter().map(|step| step.rejected).sum(),
        frames_applied: seen.applied.len() as u64,
        double_driven_scans: recorder::double_driven_scans(&seen.applied),
        missed_scans: s.steps.iter().map(|step| step.missed_scans).sum(),
    };
    Report {
        cell: s.model.cell.to_string(),
        seed,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        started,
        seconds: s.seconds(now_us),
        passed: s.checks.iter().all(|c| c.held),
        steps: s.steps.clone(),
        checks: s.checks.clone(),
        totals,
        samples,
        events,
    }
}

/// The table at the end.
pub fn print(r: &Report, dir: &Path) {
    let mut steps = table(&[
        "s",
        "step",
        "workload before %",
        "after %",
        "longest gap ms",
        "missed scans",
        "rejected",
        "finished",
    ]);
    let loads = |loads: &[(String, f64)]| {
        loads
            .iter()
            .map(|(c, p)| format!("{} {p:.0}", c.trim_start_matches("controller")))
            .collect::<Vec<_>>()
            .join("  ")
    };
    for s in &r.steps {
        steps.add_row(vec![
            number(format!("{:.1}", s.at_s)),
            Cell::new(&s.name),
            Cell::new(loads(&s.before)),
            Cell::new(loads(&s.after)),
            number(s.gap_ms.map_or(String::new(), |ms| format!("{ms:.1}"))),
            number(s.missed_scans),
            number(s.rejected),
            number(s.products),
        ]);
    }
    println!("\n{steps}\n");
    for Check { name, held, seen } in &r.checks {
        let word = match (held, colours()) {
            (true, true) => "\x1b[32mheld  \x1b[0m",
            (true, false) => "held  ",
            (false, true) => "\x1b[31mFAILED\x1b[0m",
            (false, false) => "FAILED",
        };
        println!("{word}  {name}: {seen}");
    }
    let t = &r.totals;
    println!(
        "\n{} sets finished, {} parts lost, {} damaged, {} incidents; {} frames applied, {} rejected, {} double-driven scans; {:.1} s",
        t.products,
        t.parts_lost,
        t.parts_damaged,
        t.incidents,
        t.frames_applied,
        t.frames_rejected,
        t.double_driven_scans,
        r.seconds
    );
    println!("report: {}", dir.join("report.html").display());
}
