//! Compiled and interpreted runs of random programs and charts agree.

use fam_reference::{chart, compare, session};

/// Programs in each project; they share its types, functions and function blocks.
const PROGRAMS: usize = 20;
/// Projects and groups of charts, unless somebody asks for more.
const PROJECTS: u64 = 60;

fn from_environment(name: &str, otherwise: u64) -> u64 {
    std::env::var(name)
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(otherwise)
}

fn seeds() -> std::ops::Range<u64> {
    let first = from_environment("FAM_RANDOM_FROM", 0);
    first..first + from_environment("FAM_RANDOM_PROJECTS", PROJECTS)
}

#[test]
fn compiled_and_interpreted_programs_agree() {
    let engine = compare::engine();
    let mut all = session::Tally::default();
    for seed in seeds() {
        match session::project(&engine, seed, PROGRAMS) {
            Ok(tally) => all.add(&tally),
            Err(failure) => panic!("{failure}"),
        }
    }
    // Most programs run to the end, and some are stopped by the same trap.
    let expected = seeds().count() as u64 * PROGRAMS as u64;
    assert!(all.programs > expected / 2, "{all:?}");
    assert!(
        expected < 200 || (all.trapped > 0 && all.trapped < all.programs / 3),
        "{all:?}"
    );
}

#[test]
fn compiled_charts_follow_the_rules_of_evolution_and_action_control() {
    let engine = compare::engine();
    for seed in seeds() {
        let scans =
            chart::compare(&engine, seed, 40, 40).unwrap_or_else(|failure| panic!("{failure}"));
        assert_eq!(scans, 40 * 40);
    }
}
