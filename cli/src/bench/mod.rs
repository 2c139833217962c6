//! `fam bench`: figures of this machine and this build, from normal processes with the settings of `fam up`.

mod checkpoint;
mod failover;
mod footprint;
mod frame;
mod generate;
mod jitter;
mod loss;
mod moves;
mod plan;
mod quiet;
pub(crate) mod relay;
mod rig;
mod scan;
mod state;
mod stats;
mod traced;
mod witness;

pub use witness::Witness;

use anyhow::Result;
use clap::{Args, Subcommand, ValueEnum};
use comfy_table::Cell;
use serde_json::{Map, Value};
use std::path::PathBuf;

/// `fam bench`
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// What to measure
    #[command(subcommand)]
    pub what: Bench,
    /// Print one JSON object instead of a table
    #[arg(long, global = true)]
    pub json: bool,
    /// Cell to run in place of the FMS-200
    #[arg(long, global = true, value_name = "FILE")]
    pub cell: Option<PathBuf>,
}

/// How the active controller is taken away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum FailoverKind {
    /// SIGKILL.
    Kill,
    /// SIGSTOP.
    Freeze,
    /// A link that goes silent without closing.
    Cut,
}

/// Whose loss is tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LossKind {
    /// The controller that drives most MCs is killed.
    Controller,
    /// The gateway is killed and started again.
    Gateway,
}

/// Benchmarks.
#[derive(Debug, Subcommand)]
pub enum Bench {
    /// From the loss of a controller to the first frame of the new one applied
    Failover {
        /// How it is lost
        #[arg(long, value_enum, default_value = "kill")]
        kind: FailoverKind,
        /// Cycle of the MCs and tick of all processes
        #[arg(long, default_value_t = 5)]
        cycle_ms: u32,
        /// Number of trials
        #[arg(long, default_value_t = 100)]
        trials: usize,
        /// Without the gateway's fence, to show what it is for
        #[cfg(feature = "fence-off")]
        #[arg(long)]
        fence_off: bool,
    },
    /// Planned moves: gap between the last frame of the old controller and the first of the new
    Move {
        /// Cycle of the MCs and tick of all processes
        #[arg(long, default_value_t = 5)]
        cycle_ms: u32,
        /// Number of moves
        #[arg(long, default_value_t = 200)]
        trials: usize,
    },
    /// A large state, all changed, from scan end on A to lying in B's instance
    State {
        /// LREAL variables
        #[arg(long, default_value_t = 100_000)]
        variables: usize,
        /// Number of frames
        #[arg(long, default_value_t = 200)]
        trials: usize,
    },
    /// Share of the cycle that checkpoints cost, sender thread included
    Checkpoint {
        /// LREAL variables
        #[arg(long, default_value_t = 10_000)]
        variables: usize,
        /// Cycle
        #[arg(long, default_value_t = 10)]
        cycle_ms: u32,
        /// Number of scans
        #[arg(long, default_value_t = 1_000)]
        trials: usize,
    },
    /// From the model of a large cell to all its files
    Generate {
        /// MCs
        #[arg(long, default_value_t = 1_000)]
        mcs: usize,
        /// Variables of each
        #[arg(long, default_value_t = 1_000)]
        variables: usize,
    },
    /// A work-balance plan for a large cell, against a planted optimum
    Plan {
        /// Controllers
        #[arg(long, default_value_t = 1_000)]
        controllers: usize,
        /// MCs
        #[arg(long, default_value_t = 10_000)]
        mcs: usize,
    },
    /// Whether anything that the plant has seen is lost when a process is killed at a random moment
    Loss {
        /// Number of kills
        #[arg(long, default_value_t = 1_000)]
        trials: usize,
        /// Whose
        #[arg(long, value_enum, default_value = "controller")]
        kind: LossKind,
        /// When
        #[arg(long, default_value_t = 1)]
        seed: u64,
    },
    /// What carrying the state in the frame costs, against outputs alone
    Frame {
        /// Scans for each size and share of change
        #[arg(long, default_value_t = 400)]
        scans: usize,
    },
    /// How late scans begin, with and without load, with and without real-time priority
    Jitter {
        /// Cycle of the MCs and tick of all processes
        #[arg(long, default_value_t = 5)]
        cycle_ms: u32,
        /// How long for each of the four
        #[arg(long, default_value_t = 30)]
        seconds: u64,
    },
    /// Memory of the processes, CPU of a node beside its MCs, and how fast a node starts
    Footprint {
        /// Number of starts
        #[arg(long, default_value_t = 10)]
        starts: usize,
        /// How long the CPU is measured
        #[arg(long, default_value_t = 10)]
        seconds: u64,
    },
    /// Scan time of programs of many kinds against C written by hand, built with `cc -O2`
    Scan {
        /// Statements of the large program
        #[arg(long, default_value_t = 10_000)]
        statements: usize,
    },
    /// False failovers with both cores loaded
    Quiet {
        /// How long
        #[arg(long, default_value_t = 60)]
        minutes: u64,
    },
}

/// Runs one benchmark and prints its figures.
///
/// # Errors
/// If it cannot be run.
pub fn run(args: &BenchArgs) -> Result<()> {
    let cell = args.cell.as_deref();
    let figures = match &args.what {
        Bench::Failover {
            kind,
            cycle_ms,
            trials,
            #[cfg(feature = "fence-off")]
            fence_off,
        } => {
            #[cfg(not(feature = "fence-off"))]
            let fence_off = &false;
            failover::run(cell, *kind, *cycle_ms, *trials, *fence_off)?
        }
        Bench::Move { cycle_ms, trials } => moves::run(cell, *cycle_ms, *trials)?,
        Bench::State { variables, trials } => state::run(*variables, *trials)?,
        Bench::Checkpoint {
            variables,
            cycle_ms,
            trials,
        } => checkpoint::run(*variables, *cycle_ms, *trials)?,
        Bench::Generate { mcs, variables } => generate::run(*mcs, *variables)?,
        Bench::Plan { controllers, mcs } => plan::run(*controllers, *mcs)?,
        Bench::Loss { trials, kind, seed } => loss::run(cell, *kind, *trials, *seed)?,
        Bench::Frame { scans } => frame::run(*scans)?,
        Bench::Jitter { cycle_ms, seconds } => jitter::run(cell, *cycle_ms, *seconds)?,
        Bench::Footprint { starts, seconds } => footprint::run(cell, *starts, *seconds)?,
        Bench::Scan { statements } => scan::run(&scan::pairs(*statements, &|_| true))?,
        Bench::Quiet { minutes } => quiet::run(cell, *minutes)?,
    };
    if args.json {
        println!("{}", Value::Object(figures));
    } else {
        print(&figures);
    }
    Ok(())
}

fn print(figures: &Map<String, Value>) {
    let mut table = crate::status::table(&["figure", "value"]);
    for (name, value) in figures {
        if let Value::Array(rows) = value {
            for row in rows {
                let text = |key: &str| row.get(key).map(crate::status::number);
                let label = row.get("name").and_then(Value::as_str).unwrap_or(name);
                let ratio = text("ratio").unwrap_or_else(|| Cell::new(""));
                table.add_row(vec![Cell::new(label), ratio]);
            }
            continue;
        }
        table.add_row(vec![Cell::new(name), crate::status::number(value)]);
    }
    println!("{table}");
}
