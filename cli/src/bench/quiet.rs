//! False alarms: a cell at rest with both cores loaded must not fail over.

use super::rig::Rig;
use anyhow::Result;
use serde_json::{Map, Value, json};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Keeps every core busy until dropped.
pub(super) struct Load(Arc<AtomicBool>);

impl Load {
    pub(super) fn start() -> Load {
        let stop = Arc::new(AtomicBool::new(false));
        for _ in 0..std::thread::available_parallelism().map_or(2, usize::from) {
            let stop = stop.clone();
            std::thread::spawn(move || {
                let mut x = 1_u64;
                while !stop.load(Ordering::Relaxed) {
                    for _ in 0..10_000 {
                        x = std::hint::black_box(
                            x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1),
                        );
                    }
                }
            });
        }
        Load(stop)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Lets the cell run under load and counts takeovers that nobody asked for.
pub fn run(cell: Option<&Path>, minutes: u64) -> Result<Map<String, Value>> {
    let mut rig = Rig::start(cell, 5)?;
    rig.join("controller1")?;
    rig.join("controller2")?;
    let load = Load::start();
    let before = epochs(&rig);
    let began = Instant::now();
    while began.elapsed() < Duration::from_secs(minutes * 60) {
        std::thread::sleep(Duration::from_millis(500));
        let dead = rig.cell.casualties()?;
        anyhow::ensure!(dead.is_empty(), "{}", dead.join("\n"));
    }
    drop(load);
    let stalls = rig.witness.stalls();
    // Work balance may move an MC under load; that is a released handover, not a failover.
    let seen = rig.eye.seen();
    let takeovers = fam_gateway_core::recorder::takeovers(&seen.applied);
    let after_start = takeovers.iter().filter(|t| {
        before
            .iter()
            .any(|(mc, epoch)| mc == &t.mc && t.to.0 > *epoch)
    });
    let (mut false_failovers, mut moves) = (0, 0);
    for takeover in after_start {
        if takeover.released {
            moves += 1;
        } else {
            false_failovers += 1;
        }
    }
    drop(seen);
    rig.cell.stop()?;
    let mut figures = Map::new();
    figures.insert("minutes".into(), json!(minutes));
    figures.insert("false_failovers".into(), json!(false_failovers));
    figures.insert("planned_moves".into(), json!(moves));
    figures.insert("stalls_witnessed".into(), json!(stalls));
    Ok(figures)
}

fn epochs(rig: &Rig) -> Vec<(fam_proto::McId, fam_proto::Epoch)> {
    rig.eye
        .seen()
        .newest
        .values()
        .map(|a| (a.mc.clone(), a.epoch))
        .collect()
}
