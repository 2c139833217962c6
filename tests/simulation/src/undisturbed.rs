//! The finished products of a run that nothing disturbs: what a disturbed run with the same seed is held against.

use crate::closed_loop::{Rig, Timing};
use fam_plant_core::{PlantConfig, Product};

/// A set takes about 4 s of simulated time; past this many seconds for each the cell stands still.
const SECONDS_A_SET: u64 = 30;

/// Runs the FMS-200 cell in virtual time until so many sets are finished.
///
/// # Panics
/// If the cell does not build or stands still: then there is nothing to compare with.
#[must_use]
pub fn products(seed: u64, count: usize) -> Vec<Product> {
    let config = PlantConfig {
        seed,
        ..PlantConfig::default()
    };
    let mut rig = Rig::new(config, Timing::PROMPT);
    rig.run_until(
        "the undisturbed run finishes its sets",
        SECONDS_A_SET * (count as u64 + 1),
        |rig| rig.plant.products().len() >= count,
    );
    rig.plant.products()[..count].to_vec()
}
