//! From the loss of a controller to the first frame of the new one applied.

use super::rig::Rig;
use super::stats::Stats;
use super::{FailoverKind, relay};
use crate::demo::Stretch;
use crate::observe::monotonic_us;
use anyhow::{Context, Result, anyhow};
use fam_gateway_core::recorder;
use fam_proto::McId;
use nix::sys::signal::Signal;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

const PAIR: [&str; 2] = ["controller1", "controller2"];
const WAIT: Duration = Duration::from_secs(20);

/// Runs the trials: the two controllers lose their MCs to each other in turn.
pub fn run(
    cell: Option<&Path>,
    kind: FailoverKind,
    cycle_ms: u32,
    trials: usize,
    fence_off: bool,
) -> Result<Map<String, Value>> {
    let mut cuts = BTreeMap::new();
    let mut rig = Rig::start_with(cell, cycle_ms, fence_off, |manager, gateway| {
        let mut detour = BTreeMap::new();
        if kind == FailoverKind::Cut {
            for controller in PAIR {
                let cut = relay::Cut::default();
                let near = |endpoint: &str| {
                    anyhow::Ok(format!("tcp/{}", relay::start(address(endpoint)?, &cut)?))
                };
                detour.insert(controller.to_owned(), vec![near(manager)?, near(gateway)?]);
                cuts.insert(controller.to_owned(), cut);
            }
        }
        Ok(detour)
    })?;
    rig.join(PAIR[0])?;
    rig.join(PAIR[1])?;
    let (mut first_ms, mut all_ms, mut stalled) = (Vec::new(), Vec::new(), 0);
    for trial in 0..trials {
        let (lost, mcs) = rig.busiest()?;
        let at_us = monotonic_us();
        match kind {
            FailoverKind::Kill => rig.cell.kill_node(&lost)?,
            FailoverKind::Freeze => rig.cell.signal_node(&lost, Signal::SIGSTOP)?,
            FailoverKind::Cut => cuts
                .get(&lost)
                .ok_or_else(|| anyhow!("no relay before {lost}"))?
                .set(true),
        }
        let times = rig
            .eye
            .wait(
                &format!("the MCs of {lost} driven by the other controller"),
                WAIT,
                |seen| first_frames(&seen.applied, &mcs, &lost, at_us),
            )
            .with_context(|| format!("trial {}; logs in {}", trial + 1, rig.logs().display()))?;
        let end_us = times.iter().copied().max().unwrap_or(at_us);
        if rig.witness.stalled_between_us(at_us, end_us) {
            stalled += 1;
        } else {
            first_ms.push(ms(times.iter().copied().min().unwrap_or(at_us) - at_us));
            all_ms.push(ms(end_us - at_us));
        }
        // A frozen or cut controller lets its late frames go before it is started afresh.
        match kind {
            FailoverKind::Kill => {}
            FailoverKind::Freeze => {
                rig.cell.signal_node(&lost, Signal::SIGCONT)?;
                rig.rest()?;
                rig.cell.kill_node(&lost)?;
            }
            FailoverKind::Cut => {
                cuts.get(&lost)
                    .ok_or_else(|| anyhow!("no relay before {lost}"))?
                    .set(false);
                rig.rest()?;
                rig.cell.kill_node(&lost)?;
            }
        }
        rig.rest()?;
        rig.join(&lost)?;
    }
    let seen = rig.eye.seen();
    let stretch = Stretch::between(&seen.applied, &rig.cycles_us, 0, u64::MAX);
    let behind = stretch
        .takeovers
        .iter()
        .map(|t| t.scans_behind)
        .max()
        .unwrap_or(0);
    let (first, all) = (Stats::new(first_ms), Stats::new(all_ms));
    let mut figures = Map::new();
    figures.insert("n".into(), json!(first.n()));
    figures.insert("stalled".into(), json!(stalled));
    figures.insert("p50_ms".into(), json!(first.ms(50.0)));
    figures.insert("p99_ms".into(), json!(first.ms(99.0)));
    figures.insert("max_ms".into(), json!(first.ms(100.0)));
    figures.insert("all_mcs_p50_ms".into(), json!(all.ms(50.0)));
    figures.insert("all_mcs_p99_ms".into(), json!(all.ms(99.0)));
    figures.insert("scans_behind_max".into(), json!(behind));
    figures.insert(
        "double_driven_scans".into(),
        json!(recorder::double_driven_scans(&seen.applied)),
    );
    drop(seen);
    rig.cell.stop()?;
    Ok(figures)
}

/// When each of the MCs got its first frame from another controller than the lost one after the loss.
fn first_frames(
    applied: &[fam_proto::Applied],
    mcs: &[McId],
    lost: &str,
    after_us: u64,
) -> Option<Vec<u64>> {
    let recent = applied.partition_point(|a| a.at_us < after_us);
    mcs.iter()
        .map(|mc| {
            applied[recent..]
                .iter()
                .find(|a| &a.mc == mc && a.owner.controller.as_str() != lost)
                .map(|a| a.at_us)
        })
        .collect()
}

#[allow(clippy::cast_precision_loss)]
fn ms(us: u64) -> f64 {
    us as f64 / 1_000.0
}

fn address(endpoint: &str) -> Result<SocketAddr> {
    endpoint
        .trim_start_matches("tcp/")
        .parse()
        .with_context(|| format!("{endpoint} is no TCP endpoint"))
}
