//! `fam demo`: the case study of the flexible assembly cell with real processes, judged from outside.

mod aim;
mod display;
mod gaps;
mod report;
mod stage;
mod story;

use crate::args::DemoArgs;
use crate::bench::Witness;
use crate::observe::{Observer, monotonic_us};
use crate::running::{Running, Setup};
use anyhow::{Context, Result, anyhow};
use display::Display;
use fam_proto::McId;
use stage::Stage;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use gaps::Stretch;

/// The cell in its plain form, which benchmarks change copies of, in the project's folder.
const CELL: &str = "deploy/fms200/cell.toml";
/// The AutomationML model of the same cell, from which the demo generates what runs.
const MODEL: &str = "fms200.aml";

/// Runs the demo; `true` if all that it asserts held.
///
/// # Errors
/// If the cell cannot be run or the report not be written.
pub fn run(args: &DemoArgs) -> Result<bool> {
    let path = match &args.cell {
        Some(path) => path.clone(),
        None => find_cell()?.with_file_name(MODEL),
    };
    let built = fam_engineering::build(&path)?;
    let model = built.model;
    let gateway = model
        .gateways
        .first()
        .ok_or_else(|| anyhow!("{} has no gateway", path.display()))?
        .gateway
        .clone();
    let run_dir = tempfile::Builder::new().prefix("fam-demo-").tempdir()?;
    let started = humantime::format_rfc3339_seconds(std::time::SystemTime::now()).to_string();
    let display = Display::new(story::STEPS, args.headless, args.json);
    display.doing("starting plant, gateway and manager");
    let began_us = monotonic_us();
    let cell = Running::start(Setup {
        cell: path.clone(),
        gateway: gateway.to_string(),
        plant: true,
        seed: args.seed,
        run_dir: run_dir.path().to_owned(),
        detour: BTreeMap::new(),
        fence_off: false,
    })?;
    let eye = Observer::start(
        &model.cell,
        &gateway,
        cell.manager_endpoint(),
        cell.gateway_endpoint(),
    )?;
    let plant = fam_plant::StatusClient::new(cell.plant_status());
    let cycles_us: BTreeMap<McId, u64> = model
        .mcs
        .iter()
        .map(|m| (m.mc.clone(), u64::from(m.cycle_us)))
        .collect();
    let mut stage = Stage {
        cell,
        eye,
        plant,
        model,
        cycles_us,
        witness: Witness::start(),
        began_us,
        steps: Vec::new(),
        checks: Vec::new(),
        display,
    };
    let played = story::play(&mut stage);
    if let Err(error) = &played {
        stage.check(
            "the story can be played to its end",
            false,
            format!("{error:#}"),
        );
        keep_logs(stage.cell.run_dir(), &args.report)?;
    }
    report::final_checks(&mut stage, args.seed);
    stage.display.end();
    let report = report::make(&stage, args.seed, started);
    let ended = stage.cell.stop();
    crate::report::write(&report, &args.report)?;
    if args.json {
        println!("{}", serde_json::to_string(&report)?);
    } else {
        report::print(&report, &args.report);
    }
    ended?;
    Ok(report.passed)
}

/// The cell model: beside the program's sources, or below the current folder.
pub fn find_cell() -> Result<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(CELL);
    [PathBuf::from(CELL), beside]
        .into_iter()
        .find(|p| p.is_file())
        .with_context(|| {
            format!("the cell model {CELL} was not found; run `fam demo` in the project's folder")
        })
}

/// Logs of a failed run stay beside the report.
fn keep_logs(run_dir: &Path, report: &Path) -> Result<()> {
    let to = report.join("logs");
    std::fs::create_dir_all(&to)?;
    for entry in std::fs::read_dir(run_dir)?.flatten() {
        if entry.path().extension().is_some_and(|e| e == "log") {
            std::fs::copy(entry.path(), to.join(entry.file_name()))?;
        }
    }
    Ok(())
}
