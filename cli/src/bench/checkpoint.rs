//! What checkpoints cost in the cycle: the copy on the scan thread, and the sender thread's work for the frame.

use super::stats::Stats;
use super::traced::{Point, Traced};
use anyhow::Result;
use serde_json::{Map, Value, json};

#[allow(clippy::cast_precision_loss)]
pub fn run(variables: usize, cycle_ms: u32, trials: usize) -> Result<Map<String, Value>> {
    let traced = Traced::start(variables, cycle_ms)?;
    let costs = traced.wait("frames sent by the first controller", |points| {
        let costs: Vec<(u64, u64, bool)> = points
            .iter()
            .filter_map(|p| match *p {
                Point::Scanned {
                    capture_cpu_ns,
                    sender_cpu_ns,
                    full,
                    ..
                } => Some((capture_cpu_ns, sender_cpu_ns, full)),
                Point::Held { .. } => None,
            })
            .collect();
        (costs.len() >= trials).then_some(costs)
    })?;
    traced.stop()?;
    let cycle_ns = f64::from(cycle_ms) * 1e6;
    let share = |ns: u64| ns as f64 / cycle_ns * 100.0;
    let all = Stats::new(costs.iter().map(|c| share(c.0 + c.1)).collect());
    let capture = Stats::new(costs.iter().map(|c| share(c.0)).collect());
    let mut figures = Map::new();
    figures.insert("share_percent_p50".into(), json!(all.ms(50.0)));
    figures.insert("share_percent_p99".into(), json!(all.ms(99.0)));
    figures.insert("scan_thread_percent_p50".into(), json!(capture.ms(50.0)));
    figures.insert("n".into(), json!(all.n()));
    figures.insert(
        "full_frames".into(),
        json!(costs.iter().filter(|c| c.2).count()),
    );
    Ok(figures)
}
