//! How late scans begin: the scan thread's own histogram of a node that drives the whole cell.

use super::quiet::Load;
use super::rig::Rig;
use anyhow::{Context, Result};
use fam_driver::Client;
use fam_proto::ControllerId;
use hdrhistogram::Histogram;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

const CONTROLLER: &str = "controller1";
/// The node gives its histogram out so often, in seconds.
const PIECE_S: u64 = 10;
/// Upper ends of the classes that are printed, in microseconds.
const CLASSES_US: [u64; 8] = [50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000];

#[derive(Debug, Deserialize)]
#[serde(tag = "point", rename_all = "lowercase")]
enum Point {
    /// How late ticks were: upper ends of the buckets in nanoseconds, and how many.
    Late { buckets: Vec<(u64, u64)> },
    #[serde(other)]
    Other,
}

type Pieces = Arc<(Mutex<Vec<Vec<(u64, u64)>>>, Condvar)>;

pub fn run(cell: Option<&Path>, cycle_ms: u32, seconds: u64) -> Result<Map<String, Value>> {
    let mut figures = Map::new();
    figures.insert("cycle_ms".into(), json!(cycle_ms));
    figures.insert("seconds".into(), json!(seconds.div_ceil(PIECE_S) * PIECE_S));
    for (priority, name) in [("20", "real_time"), ("0", "normal")] {
        let mut rig = Rig::start(cell, cycle_ms)?;
        let endpoint = rig.cell.trace_node(CONTROLLER)?;
        rig.cell.node_options(CONTROLLER, &["--priority", priority]);
        rig.join(CONTROLLER)?;
        let pieces = Pieces::default();
        let sink = pieces.clone();
        let key = fam_controller_node::trace::key(&rig.model.cell, &ControllerId::new(CONTROLLER)?);
        let (client, subscription) = rig.eye.block_on(async {
            let client = Client::open(rig.model.cell.clone(), vec![endpoint]).await?;
            let subscription = client.link().subscribe(&key, move |_, bytes| {
                let late = bytes.split(|b| *b == b'\n').filter_map(|line| {
                    match serde_json::from_slice(line) {
                        Ok(Point::Late { buckets }) => Some(buckets),
                        _ => None,
                    }
                });
                if let Ok(mut pieces) = sink.0.lock() {
                    pieces.extend(late);
                    sink.1.notify_all();
                }
            })?;
            anyhow::Ok((client, subscription))
        })?;
        for loaded in [false, true] {
            let load = loaded.then(Load::start);
            let histogram = measure(&pieces, seconds.div_ceil(PIECE_S))?;
            drop(load);
            let which = format!("{name}_{}", if loaded { "loaded" } else { "idle" });
            figures.insert(which, summary(&histogram));
        }
        drop(subscription);
        rig.eye.block_on(client.close());
        figures.insert(
            format!("{name}_stalls_witnessed"),
            json!(rig.witness.stalls()),
        );
        rig.cell.stop()?;
    }
    Ok(figures)
}

/// Waits for so many whole pieces; the one under way now began before.
fn measure(pieces: &Pieces, wanted: u64) -> Result<Histogram<u64>> {
    let within = Duration::from_secs((wanted + 3) * PIECE_S);
    let deadline = Instant::now() + within;
    let lost = || anyhow::anyhow!("the pieces are lost");
    let mut seen = pieces.0.lock().map_err(|_| lost())?;
    seen.clear();
    let wanted = usize::try_from(wanted)? + 1;
    while seen.len() < wanted {
        let left = deadline.saturating_duration_since(Instant::now());
        anyhow::ensure!(
            !left.is_zero(),
            "waited {within:?} in vain for the node's histograms"
        );
        seen = pieces.1.wait_timeout(seen, left).map_err(|_| lost())?.0;
    }
    let mut all = Histogram::new_with_bounds(1, 10_000_000_000, 2).context("histogram")?;
    for (to_ns, n) in seen[1..wanted].iter().flatten() {
        all.record_n((*to_ns).max(1), *n)?;
    }
    Ok(all)
}

fn summary(late: &Histogram<u64>) -> Value {
    let us = |quantile: f64| late.value_at_quantile(quantile) / 1_000;
    let mut classes = Map::new();
    let mut below = 0;
    for to_us in CLASSES_US {
        let upto = late.count_between(0, to_us * 1_000);
        classes.insert(format!("to_{to_us}_us"), json!(upto - below));
        below = upto;
    }
    classes.insert("above".into(), json!(late.len().saturating_sub(below)));
    json!({
        "ticks": late.len(),
        "p50_us": us(0.5),
        "p99_us": us(0.99),
        "p999_us": us(0.999),
        "max_us": late.max() / 1_000,
        "histogram": classes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_tick_stands_in_one_class() {
        let mut late = Histogram::new_with_bounds(1, 10_000_000_000, 2).unwrap();
        for (us, n) in [(20, 7), (150, 2), (700, 1), (40_000, 1)] {
            late.record_n(us * 1_000, n).unwrap();
        }
        let told = summary(&late);
        let classes: u64 = told["histogram"]
            .as_object()
            .unwrap()
            .values()
            .map(|n| n.as_u64().unwrap())
            .sum();
        assert_eq!((classes, told["ticks"].as_u64()), (11, Some(11)));
        assert_eq!(told["histogram"]["to_50_us"], 7);
        assert_eq!(told["histogram"]["above"], 1);
    }
}
