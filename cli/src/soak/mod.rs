//! `fam soak`: the cell with real processes for hours, a fault every few seconds, and a ledger of what came of it.
//!
//! It judges from outside: by the frames that were applied behind the gateway's fence, by the plant's own account, and by
//! what the system says of the processes. A takeover that no fault explains is a false failover.

mod chaos;
mod ledger;
mod meter;
mod report;

use crate::bench::Witness;
use crate::observe::{Observer, monotonic_us};
use crate::running::{Running, Setup};
use anyhow::{Context, Result, anyhow};
use chaos::{Chaos, cuttable};
use clap::Args;
use fam_plant::{PlantStatus, StatusClient};
use fam_proto::McId;
use ledger::Ledger;
use meter::Meter;
pub use meter::holding;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Pause between two looks at what has happened.
const LOOK: Duration = Duration::from_millis(50);
/// How long the cell may take to start.
const START: Duration = Duration::from_secs(30);
/// Pause between two measurements of the processes.
const MEASURE: Duration = Duration::from_secs(10);
/// Pause between two lines of progress.
const TELL: Duration = Duration::from_secs(60);
/// The faults end so long before the end, so that the cell is judged at rest.
const QUIET_END: Duration = Duration::from_secs(20);

/// `fam soak`
#[derive(Debug, Args)]
pub struct SoakArgs {
    /// How long, in hours
    #[arg(long, default_value_t = 0)]
    pub hours: u64,
    /// How long, in minutes, on top of the hours
    #[arg(long, default_value_t = 0)]
    pub minutes: u64,
    /// Which faults, when, on whom
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Print the ledger as one JSON object
    #[arg(long)]
    pub json: bool,
    /// Keep logs, records and repository here
    #[arg(long, value_name = "DIR")]
    pub keep: Option<PathBuf>,
    /// Cell to run in place of the FMS-200
    #[arg(long, value_name = "FILE", hide = true)]
    pub cell: Option<PathBuf>,
}

/// Runs the cell and prints the ledger; `true` if all that must be 0 is 0.
///
/// # Errors
/// If the cell cannot be run.
pub fn run(args: &SoakArgs) -> Result<bool> {
    let minutes = args.hours * 60 + args.minutes;
    anyhow::ensure!(minutes > 0, "say how long: --hours H or --minutes M");
    let temporary = tempfile::Builder::new().prefix("fam-soak-").tempdir()?;
    let run_dir = args
        .keep
        .clone()
        .unwrap_or_else(|| temporary.path().to_owned());
    let path = match &args.cell {
        Some(path) => path.clone(),
        None => crate::demo::find_cell()?,
    };
    let mut soak = Soak::start(&path, &run_dir, args.seed)?;
    // A run that breaks off has its ledger too.
    let went = soak.go(Duration::from_secs(minutes * 60));
    let plant = soak.plant()?;
    let ended = soak.cell.stop();
    let ledger = report::Report {
        minutes,
        seed: args.seed,
        faults: soak.chaos.counts(),
        commands_refused: soak.chaos.refused(),
        ledger: &soak.ledger,
        plant: &plant,
        meter: &soak.meter,
        stalls: soak.witness.stalls(),
        journal_holes: soak.holes,
    };
    if args.json {
        println!("{}", ledger.json());
    } else {
        ledger.print();
    }
    for trouble in soak.ledger.troubles() {
        eprintln!("{trouble}");
    }
    let held = ledger.held();
    if !held && args.keep.is_none() {
        eprintln!("logs are in {}", temporary.keep().display());
    }
    went?;
    ended?;
    Ok(held)
}

struct Soak {
    cell: Running,
    eye: Observer,
    plant: StatusClient,
    witness: Witness,
    chaos: Chaos,
    ledger: Ledger,
    meter: Meter,
    mcs: Vec<McId>,
    holes: u64,
}

impl Soak {
    fn start(path: &Path, run_dir: &Path, seed: u64) -> Result<Soak> {
        let model = fam_engineering::build(path)?.model;
        let gateway = model
            .gateways
            .first()
            .ok_or_else(|| anyhow!("{} has no gateway", path.display()))?
            .gateway
            .clone();
        let mut cell = Running::start(Setup {
            cell: path.to_owned(),
            gateway: gateway.to_string(),
            plant: true,
            seed,
            run_dir: run_dir.to_owned(),
            detour: BTreeMap::new(),
            fence_off: false,
        })?;
        let controllers: Vec<String> = model
            .controllers
            .iter()
            .map(|c| c.controller.to_string())
            .collect();
        let cuts = cuttable(&mut cell, &controllers)?;
        let eye = Observer::start(
            &model.cell,
            &gateway,
            cell.manager_endpoint(),
            cell.gateway_endpoint(),
        )?;
        let plant = StatusClient::new(cell.plant_status());
        let mcs: Vec<McId> = model.mcs.iter().map(|m| m.mc.clone()).collect();
        let mut soak = Soak {
            chaos: Chaos::new(seed, controllers.clone(), mcs.clone(), cuts),
            ledger: Ledger::new(mcs.clone()),
            meter: Meter::default(),
            witness: Witness::start(),
            holes: 0,
            cell,
            eye,
            plant,
            mcs,
        };
        for controller in &controllers {
            soak.cell.start_node(controller)?;
        }
        let mcs = soak.mcs.clone();
        soak.eye
            .wait("all MCs are driven at the start", START, |seen| {
                let status = seen.status()?;
                let up = status.controllers.iter().filter(|c| c.up).count();
                (up == controllers.len() && mcs.iter().all(|mc| seen.newest.contains_key(mc)))
                    .then_some(())
            })
            .with_context(|| format!("logs in {}", run_dir.display()))?;
        Ok(soak)
    }

    fn go(&mut self, how_long: Duration) -> Result<()> {
        let began = Instant::now();
        let end = began + how_long;
        let last_fault = end.checked_sub(QUIET_END).unwrap_or(began);
        let (mut measure, mut tell) = (began, began + TELL);
        loop {
            let now = Instant::now();
            self.look()?;
            if now >= end {
                break;
            }
            if now < last_fault {
                self.chaos.maybe_begin(&mut self.cell, &self.eye)?;
            }
            self.chaos.end_what_is_due(&mut self.cell, &self.eye)?;
            if now >= measure {
                self.meter.measure(&self.cell.pids());
                measure = now + MEASURE;
            }
            if now >= tell {
                tell = now + TELL;
                eprintln!(
                    "{:5.0} s  {} faults, {}",
                    began.elapsed().as_secs_f64(),
                    self.chaos.counts().values().sum::<u64>(),
                    self.ledger
                );
            }
            std::thread::sleep(LOOK);
        }
        self.chaos.heal(&mut self.cell, &self.eye)?;
        self.meter.measure(&self.cell.pids());
        Ok(())
    }

    /// Takes what the observer has seen, so that it does not grow, and judges it.
    fn look(&mut self) -> Result<()> {
        let (applied, events) = {
            let mut seen = self.eye.seen();
            self.holes = seen.holes;
            let keep_from = seen.history.len().saturating_sub(1);
            seen.history.drain(..keep_from);
            (
                std::mem::take(&mut seen.applied),
                std::mem::take(&mut seen.events),
            )
        };
        self.ledger
            .applied(&applied, self.chaos.faults(), &self.witness);
        self.ledger.events(&events);
        self.ledger
            .silence(monotonic_us(), self.chaos.calm_since_us());
        let dead = self.cell.casualties()?;
        anyhow::ensure!(
            dead.is_empty(),
            "a process has ended by itself, {}; logs in {}\n{}",
            self.ledger,
            self.cell.run_dir().display(),
            dead.join("\n")
        );
        Ok(())
    }

    fn plant(&self) -> Result<PlantStatus> {
        self.eye
            .block_on(self.plant.status())
            .context("the plant does not answer on its status port")
    }
}
