//! Compiled and interpreted runs of random programs agree.

use fam_reference::{compare, generate};

/// Programs in each project; they share its types, functions and function blocks.
const PROGRAMS: usize = 20;

fn projects() -> u64 {
    std::env::var("FAM_RANDOM_PROJECTS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(120)
}

#[test]
fn compiled_and_interpreted_programs_agree() {
    let engine = compare::engine();
    let first = std::env::var("FAM_RANDOM_FROM")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(0);
    for seed in first..first + projects() {
        if let Err(failure) = fam_reference::session::project(&engine, seed, PROGRAMS) {
            panic!("{failure}");
        }
    }
    let _ = generate::project(0, 1);
}
