//! Planned moves while production goes on.

use super::rig::Rig;
use super::stats::Stats;
use crate::demo::Stretch;
use crate::observe::monotonic_us;
use anyhow::{Context, Result};
use fam_proto::{CommandKind, ControllerId};
use serde_json::{Map, Value, json};
use std::path::Path;
use std::time::Duration;

const PAIR: [&str; 2] = ["controller1", "controller2"];
/// The journal reaches the observer a tick later.
const JOURNAL: Duration = Duration::from_secs(2);

/// Moves one MC after the other to the other controller by the operator's command.
pub fn run(cell: Option<&Path>, cycle_ms: u32, trials: usize) -> Result<Map<String, Value>> {
    let mut rig = Rig::start(cell, cycle_ms)?;
    rig.join(PAIR[0])?;
    rig.join(PAIR[1])?;
    let (mut gap_ms, mut total_ms, mut missed, mut stalled) = (Vec::new(), Vec::new(), 0, 0);
    for trial in 0..trials {
        let mc = rig.model.mcs[trial % rig.model.mcs.len()].mc.clone();
        let from = rig.eye.seen().driver(&mc).unwrap_or_default().to_owned();
        let to = if from == PAIR[0] { PAIR[1] } else { PAIR[0] };
        let began_us = monotonic_us();
        rig.eye
            .command(CommandKind::Move {
                mc: mc.clone(),
                to: ControllerId::new(to)?,
                force: false,
            })
            .with_context(|| format!("trial {}; logs in {}", trial + 1, rig.logs().display()))?;
        rig.eye
            .wait(&format!("a frame of {mc} from {to}"), JOURNAL, |seen| {
                (seen.driver(&mc) == Some(to)).then_some(())
            })?;
        let stretch = Stretch::between(&rig.eye.seen().applied, &rig.cycles_us, began_us, u64::MAX);
        let Some(takeover) = stretch
            .takeovers
            .iter()
            .find(|t| t.mc == mc && t.to.1.controller.as_str() == to)
        else {
            continue;
        };
        if rig
            .witness
            .stalled_between_us(takeover.last_us, takeover.first_us)
        {
            stalled += 1;
            continue;
        }
        gap_ms.push(ms(takeover.first_us - takeover.last_us));
        total_ms.push(ms(takeover.first_us - began_us));
        missed += stretch
            .gaps
            .iter()
            .filter(|g| g.mc == mc && g.epochs.0 != g.epochs.1)
            .map(|g| g.missed_scans)
            .sum::<u64>();
    }
    let seen = rig.eye.seen();
    let behind = Stretch::between(&seen.applied, &rig.cycles_us, 0, u64::MAX)
        .takeovers
        .iter()
        .map(|t| t.scans_behind)
        .max()
        .unwrap_or(0);
    drop(seen);
    rig.cell.stop()?;
    let (gap, total) = (Stats::new(gap_ms), Stats::new(total_ms));
    let mut figures = Map::new();
    figures.insert("n".into(), json!(gap.n()));
    figures.insert("stalled".into(), json!(stalled));
    figures.insert("missed_scans".into(), json!(missed));
    figures.insert("gap_ms_p50".into(), json!(gap.ms(50.0)));
    figures.insert("gap_ms_p99".into(), json!(gap.ms(99.0)));
    figures.insert("total_ms_p99".into(), json!(total.ms(99.0)));
    figures.insert("scans_behind_max".into(), json!(behind));
    Ok(figures)
}

#[allow(clippy::cast_precision_loss)]
fn ms(us: u64) -> f64 {
    us as f64 / 1_000.0
}
