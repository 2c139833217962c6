//! Time and memory from the model of a large cell to all its files, in a process of its own.

use anyhow::{Context, Result};
use fam_engineering::generate::Target;
use fam_engineering::{large_cell, output};
use serde_json::{Map, Value, json};
use std::time::Instant;

pub fn run(mcs: usize, variables: usize) -> Result<Map<String, Value>> {
    let dir = tempfile::tempdir()?;
    let model = large_cell::write(dir.path(), mcs, variables)?;
    let began = Instant::now();
    let (files, built) = output::write(&model, Target::Fam, &dir.path().join("out"))?;
    let seconds = began.elapsed().as_secs_f64();
    let state: usize = built.mcs.iter().map(|m| m.state_variables.len()).sum();
    anyhow::ensure!(
        state >= mcs * variables,
        "the cell has {state} variables, {} were asked for",
        mcs * variables
    );
    let mut figures = Map::new();
    figures.insert("seconds".into(), json!((seconds * 1000.0).round() / 1000.0));
    figures.insert("peak_mb".into(), json!(peak_mb()?));
    figures.insert("mcs".into(), json!(mcs));
    figures.insert("variables".into(), json!(variables));
    figures.insert("files".into(), json!(files.len()));
    Ok(figures)
}

/// Most memory that this process has had.
fn peak_mb() -> Result<u64> {
    let status = std::fs::read_to_string("/proc/self/status")?;
    let line = status
        .lines()
        .find_map(|l| l.strip_prefix("VmHWM:"))
        .context("the system does not say how much memory was used")?;
    let kb: u64 = line.trim().trim_end_matches("kB").trim().parse()?;
    Ok(kb / 1024)
}
