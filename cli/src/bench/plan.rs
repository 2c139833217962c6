//! Planning time and quality for a cell too large for exact search.

use super::stats::Stats;
use anyhow::Result;
use fam_agents::planner::{plan, planted};
use serde_json::{Map, Value, json};
use std::time::Instant;

/// Seeds tried; the figures are the worst plan's gap and the median time.
const SEEDS: u64 = 5;

#[allow(clippy::cast_precision_loss)]
pub fn run(controllers: usize, mcs: usize) -> Result<Map<String, Value>> {
    let mut ms = Vec::new();
    let mut gap_percent = 0.0_f64;
    let mut bound_percent = 0.0_f64;
    for seed in 1..=SEEDS {
        let planted = planted(seed, controllers, mcs);
        let began = Instant::now();
        let solution = plan(&planted.problem);
        ms.push(began.elapsed().as_secs_f64() * 1_000.0);
        anyhow::ensure!(
            solution.left_out.is_empty(),
            "{} MCs were not placed (seed {seed})",
            solution.left_out.len()
        );
        let above = |floor: u64| (solution.peak_ppm as f64 / floor as f64 - 1.0) * 100.0;
        gap_percent = gap_percent.max(above(planted.optimum_ppm));
        bound_percent = bound_percent.max(above(solution.lower_bound_ppm));
    }
    let stats = Stats::new(ms);
    let mut figures = Map::new();
    figures.insert("ms".into(), json!(stats.ms(50.0)));
    figures.insert("ms_max".into(), json!(stats.ms(100.0)));
    figures.insert(
        "gap_percent".into(),
        json!((gap_percent * 1_000.0).round() / 1_000.0),
    );
    figures.insert(
        "gap_to_bound_percent".into(),
        json!((bound_percent * 1_000.0).round() / 1_000.0),
    );
    figures.insert("controllers".into(), json!(controllers));
    figures.insert("mcs".into(), json!(mcs));
    Ok(figures)
}
