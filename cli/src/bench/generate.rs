//! Time and memory from the model of a large cell to all its files, in a process of its own.

use anyhow::{Context, Result};
use fam_engineering::generate::Target;
use fam_engineering::output;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;

/// One controller for so many MCs; each MC is hosted on two.
const MCS_OF_A_CONTROLLER: usize = 10;

pub fn run(mcs: usize, variables: usize) -> Result<Map<String, Value>> {
    let dir = tempfile::tempdir()?;
    let model = write_model(dir.path(), mcs, variables)?;
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

fn write_model(dir: &Path, mcs: usize, variables: usize) -> Result<std::path::PathBuf> {
    let controllers = (mcs / MCS_OF_A_CONTROLLER).max(2);
    let mut cell = String::from(
        "format = 1\n[cell]\nname = \"large\"\ntick_ms = 10\n[[gateway]]\nname = \"gateway1\"\ndriver = \"image\"\n",
    );
    for n in 0..controllers {
        writeln!(cell, "[[controller]]\nname = \"c{n}\"\nmemory_mb = 4096")?;
    }
    std::fs::create_dir_all(dir.join("logic"))?;
    for n in 0..mcs {
        let (one, two) = (n % controllers, (n + 1) % controllers);
        writeln!(
            cell,
            "[[mc]]\nname = \"Mc{n}\"\nlogic = [\"logic/mc{n}.st\"]\ngateway = \"gateway1\"\nhosts = [\"c{one}\", \"c{two}\"]\nworst_case_us = 50\n\
             [mc.inputs]\nGo = \"image:Go{n}\"\n[mc.outputs]\nDone = {{ field = \"image:Done{n}\", fail_safe = false }}\n\
             [[mc.critical_interval]]\nname = \"Busy\"\ncondition = \"step >= 10 AND step < 20\"\nkind = \"checkpoint\"\nrecovery = \"Back\"\n\
             [mc.critical_interval.checkpoint_state]\nstep = 0"
        )?;
        std::fs::write(dir.join(format!("logic/mc{n}.st")), logic(n, variables))
            .context("logic of the benchmark")?;
    }
    let model = dir.join("cell.toml");
    std::fs::write(&model, cell)?;
    Ok(model)
}

/// A program with variables of all common types, some of which it computes with.
fn logic(n: usize, variables: usize) -> String {
    const TYPES: [&str; 6] = ["BOOL", "INT", "DINT", "REAL", "LREAL", "TIME"];
    let mut text = format!(
        "VAR_GLOBAL\n    Go AT %IX0.0 : BOOL;\n    Done AT %QX0.0 : BOOL;\nEND_VAR\nPROGRAM Mc{n}\nVAR_EXTERNAL\n    Go, Done : BOOL;\nEND_VAR\nVAR\n    step : INT;\n"
    );
    for v in 1..variables {
        let _ = writeln!(text, "    v{v} : {};", TYPES[v % TYPES.len()]);
    }
    text.push_str("END_VAR\n    IF Go THEN step := (step + 1) MOD 30; END_IF;\n");
    for v in (1..variables).filter(|v| v % TYPES.len() == 2).take(50) {
        let _ = writeln!(text, "    v{v} := v{v} + step;");
    }
    text.push_str(
        "    Done := step = 0;\nEND_PROGRAM\nFUNCTION_BLOCK Back\nVAR_OUTPUT end : BOOL; END_VAR\n    end := TRUE;\nEND_FUNCTION_BLOCK\n",
    );
    text
}
