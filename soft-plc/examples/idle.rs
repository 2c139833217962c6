//! `cargo run --release -p fam-soft-plc --example idle`: what the call of a scan costs that does nothing, with the watchdog and
//! without it, and what 200 MCs of 1,000 variables cost whose Control POU finds them inactive, called in turn.

// The time of a call is what is measured here.
#![allow(clippy::disallowed_methods)]

use std::fmt::Write;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use fam_soft_plc::{
    CheckOptions, CompileSpec, CompiledMc, Engine, EngineOptions, Instance, Interruption,
    SourceFile, check, compile, parse_project,
};

const MCS: usize = 200;
/// Calls in a row, and how often: the least counts, because a machine can only be slowed.
const CALLS: usize = 20_000;
const ROUNDS: usize = 200;

fn compiled(text: String, entry: &str) -> Result<CompiledMc> {
    let (parsed, problems) = parse_project(&[SourceFile::new("idle.st", text)]);
    if let Some(problem) = problems.first() {
        bail!("{problem}");
    }
    let said = |list: Vec<fam_soft_plc::Diagnostic>| {
        let texts: Vec<String> = list.iter().map(ToString::to_string).collect();
        anyhow::anyhow!("{}", texts.join("\n"))
    };
    let typed = check(&parsed, CheckOptions::default()).map_err(said)?;
    let spec = CompileSpec {
        entry: entry.into(),
        ..CompileSpec::default()
    };
    compile(&typed, &spec).map_err(said)
}

/// An MC of 1,000 variables whose logic runs only while it is active.
fn inactive() -> String {
    let (mut vars, mut body) = (String::new(), String::new());
    for index in 0..998 {
        let _ = writeln!(vars, "v{index} : DINT := {index};");
        let _ = writeln!(body, "  v{index} := v{index} + scans;");
    }
    format!(
        "PROGRAM Control VAR isActive : BOOL; scans : DINT;\n{vars}END_VAR\nIF isActive THEN\n  scans := scans + 1;\n{body}END_IF;\nEND_PROGRAM\n"
    )
}

/// The least time of one call in nanoseconds, over all instances in turn.
fn least_ns(instances: &mut [Instance], calls: usize) -> Result<f64> {
    let mut least = f64::MAX;
    for _ in 0..ROUNDS {
        let mut fine = true;
        let start = Instant::now();
        for _ in 0..calls / instances.len() {
            for instance in &mut *instances {
                fine &= instance.scan(0, 2).is_ok();
            }
        }
        let calls = calls / instances.len() * instances.len();
        least = least.min(start.elapsed().as_nanos() as f64 / calls as f64);
        if !fine {
            bail!("a scan was stopped");
        }
    }
    Ok(least)
}

fn main() -> Result<()> {
    let nothing = "PROGRAM P VAR a : DINT; END_VAR\n;\nEND_PROGRAM\n";
    for (interruption, what) in [
        (Interruption::Epoch, "with the watchdog"),
        (Interruption::None, "without the watchdog"),
    ] {
        let engine = Engine::new(EngineOptions { interruption })?;
        let module = engine.prepare(&compiled(nothing.into(), "P")?)?;
        let mut one = [Instance::new(&engine, &module)?];
        let ns = least_ns(&mut one, CALLS)?;
        println!("an empty scan {what}: {ns:.1} ns");
    }
    let engine = Engine::new(EngineOptions::default())?;
    let module = engine.prepare(&compiled(inactive(), "Control")?)?;
    let mut hosted = Vec::new();
    for _ in 0..MCS {
        hosted.push(Instance::new(&engine, &module)?);
    }
    let ns = least_ns(&mut hosted, CALLS)?;
    let scans = hosted
        .first()
        .and_then(|i| i.read("Control.scans"))
        .context("the program has no variable `scans`")?;
    if scans.as_f64() != 0.0 {
        bail!("the MC was active");
    }
    println!("an inactive MC, {MCS} of 1,000 variables in turn: {ns:.1} ns a cycle");
    Ok(())
}
