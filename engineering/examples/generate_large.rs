//! Times `fam generate` on a large cell without the rest of the command:
//! `cargo run --release -p fam-engineering --example generate_large -- 1000 1000`.

use fam_engineering::generate::Target;
use fam_engineering::{large_cell, output};
use std::time::Instant;

// A measuring program may look at the clock; the crate may not.
#[allow(clippy::disallowed_methods)]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut numbers = std::env::args().skip(1).map(|n| n.parse::<usize>());
    let mut next = || numbers.next().unwrap_or(Ok(100));
    let (mcs, variables) = (next()?, next()?);
    let dir = tempfile::tempdir()?;
    let model = large_cell::write(dir.path(), mcs, variables)?;
    let began = Instant::now();
    let (files, built) = output::write(&model, Target::Fam, &dir.path().join("out"))?;
    let seconds = began.elapsed().as_secs_f64();
    let status = std::fs::read_to_string("/proc/self/status")?;
    let peak = status.lines().find(|l| l.starts_with("VmHWM:"));
    println!(
        "{} MCs, {} files: {seconds:.2} s, {}",
        built.mcs.len(),
        files.len(),
        peak.unwrap_or_default()
    );
    Ok(())
}
