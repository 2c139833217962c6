//! From the end of a scan on A until its checkpoint lies in B's instance, for a state that changes as a whole.

use super::stats::Stats;
use super::traced::{Point, Traced};
use super::witness::Witness;
use anyhow::Result;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Cycle of the MC: long enough that one frame is through before the next.
const CYCLE_MS: u32 = 20;

#[allow(clippy::cast_precision_loss)]
pub fn run(variables: usize, trials: usize) -> Result<Map<String, Value>> {
    let witness = Witness::start();
    let traced = Traced::start(variables, CYCLE_MS)?;
    let (pairs, bytes) = traced.wait("checkpoints held by the second controller", |points| {
        let mut scanned = BTreeMap::new();
        let mut pairs = Vec::new();
        let mut size = 0;
        for point in points {
            match *point {
                Point::Scanned {
                    epoch,
                    scan,
                    scan_end_ns,
                    bytes,
                    ..
                } => {
                    scanned.insert((epoch, scan), scan_end_ns);
                    size = size.max(bytes);
                }
                Point::Held { epoch, scan, at_ns } => pairs.push(((epoch, scan), at_ns)),
            }
        }
        let pairs: Vec<(u64, u64)> = pairs
            .into_iter()
            .filter_map(|(id, held)| Some((*scanned.get(&id)?, held)))
            .collect();
        (pairs.len() >= trials).then_some((pairs, size))
    })?;
    traced.stop()?;
    let (calm, stalled): (Vec<_>, Vec<_>) = pairs
        .iter()
        .take(trials)
        .partition(|(from, to)| !witness.stalled_between_us(from / 1_000, to / 1_000));
    let stats = Stats::new(
        calm.iter()
            .map(|(from, to)| to.saturating_sub(*from) as f64 / 1e6)
            .collect(),
    );
    let mut figures = Map::new();
    figures.insert("n".into(), json!(stats.n()));
    figures.insert("stalled".into(), json!(stalled.len()));
    figures.insert("bytes".into(), json!(bytes));
    figures.insert("p50_ms".into(), json!(stats.ms(50.0)));
    figures.insert("p99_ms".into(), json!(stats.ms(99.0)));
    figures.insert("max_ms".into(), json!(stats.ms(100.0)));
    Ok(figures)
}
