//! What a demo run has seen, and the report folder made from it.

mod html;
mod svg;

use anyhow::{Context, Result};
use serde::Serialize;
use std::path::Path;

pub use svg::workload_svg;

/// Everything of one run.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Name of the cell.
    pub cell: String,
    /// Seed of the plant.
    pub seed: u64,
    /// Version of `fam`.
    pub version: String,
    /// When it began, for people.
    pub started: String,
    /// How long it took, in seconds.
    pub seconds: f64,
    /// Whether all checks held.
    pub passed: bool,
    /// What was done to the cell, in order.
    pub steps: Vec<Step>,
    /// What was asserted.
    pub checks: Vec<Check>,
    /// Totals.
    pub totals: Totals,
    /// Workload over time; in `metrics.csv` rather than `timeline.json`.
    #[serde(skip)]
    pub samples: Vec<Sample>,
    /// The manager's event history.
    pub events: Vec<Entry>,
}

/// One step of the story.
#[derive(Debug, Clone, Serialize)]
pub struct Step {
    /// Seconds since the beginning.
    pub at_s: f64,
    /// Short name, as at the mark in the plot.
    pub name: String,
    /// What happened, in a sentence.
    pub text: String,
    /// Workload of each controller before, in percent of its limit.
    pub before: Vec<(String, f64)>,
    /// Workload after.
    pub after: Vec<(String, f64)>,
    /// Longest time without an applied frame of an MC that changed its controller: failover time or gap of the move, in ms.
    pub gap_ms: Option<f64>,
    /// Missed scans: gaps of two cycles or more between applied frames of MCs that were not failed over.
    pub missed_scans: u64,
    /// Frames rejected by the fence in this step.
    pub rejected: u64,
    /// Products finished at its end.
    pub products: u64,
}

/// One assertion.
#[derive(Debug, Clone, Serialize)]
pub struct Check {
    /// What was to hold.
    pub name: String,
    /// Whether it held.
    pub held: bool,
    /// What was seen.
    pub seen: String,
}

/// Totals of the run.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Totals {
    /// Sets finished and stored.
    pub products: u64,
    /// Parts lost.
    pub parts_lost: u64,
    /// Parts damaged.
    pub parts_damaged: u64,
    /// Incidents that the plant noticed.
    pub incidents: u64,
    /// Frames rejected by the fence.
    pub frames_rejected: u64,
    /// Frames applied.
    pub frames_applied: u64,
    /// Scans of two owners applied in turn, or an epoch falling: has to be 0.
    pub double_driven_scans: u64,
    /// Scans missed in all, outside failovers and the gateway's own restart.
    pub missed_scans: u64,
}

/// Workload of one controller at one moment.
#[derive(Debug, Clone, Serialize)]
pub struct Sample {
    /// Seconds since the beginning.
    pub at_s: f64,
    /// Controller.
    pub controller: String,
    /// Workload in percent of its limit.
    pub workload_percent: f64,
    /// Active MCs.
    pub active: String,
    /// CPU of the process, in percent of one core.
    pub process_cpu_percent: f64,
    /// Memory of the process, in MB.
    pub process_memory_mb: f64,
    /// Whether it was up.
    pub up: bool,
}

/// One line of the history.
#[derive(Debug, Clone, Serialize)]
pub struct Entry {
    /// Seconds since the beginning.
    pub at_s: f64,
    /// Severity.
    pub severity: String,
    /// Kind.
    pub kind: String,
    /// MC.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mc: Option<String>,
    /// Controller.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub controller: Option<String>,
    /// Words.
    pub text: String,
}

/// Writes `report.html`, `workload.svg`, `timeline.json` and `metrics.csv`.
///
/// # Errors
/// If the folder cannot be written, with its name.
pub fn write(report: &Report, dir: &Path) -> Result<()> {
    std::fs::create_dir_all(dir)
        .with_context(|| format!("cannot make the report folder {}", dir.display()))?;
    let put = |name: &str, text: String| {
        let path = dir.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    let plot = workload_svg(report)?;
    put("report.html", html::page(report, &plot))?;
    put("workload.svg", plot)?;
    put(
        "timeline.json",
        serde_json::to_string_pretty(report)? + "\n",
    )?;
    put("metrics.csv", csv(report))
}

fn csv(report: &Report) -> String {
    let mut text = String::from(
        "at_s,controller,up,workload_percent,active_mcs,process_cpu_percent,process_memory_mb\n",
    );
    for s in &report.samples {
        text += &format!(
            "{:.3},{},{},{:.1},{},{:.1},{:.1}\n",
            s.at_s,
            s.controller,
            u8::from(s.up),
            s.workload_percent,
            s.active,
            s.process_cpu_percent,
            s.process_memory_mb
        );
    }
    text
}

impl Report {
    /// Controllers in the order of their first sample.
    pub fn controllers(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for s in &self.samples {
            if !names.contains(&s.controller) {
                names.push(s.controller.clone());
            }
        }
        names.sort();
        names
    }
}
