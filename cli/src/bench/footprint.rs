//! What FAM takes of a machine: memory of its processes, CPU of a node beside its MCs' own scans, time of a node's start.

use super::rig::Rig;
use super::stats::Stats;
use crate::soak::holding;
use anyhow::{Context, Result};
use fam_proto::EventKind;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

const CYCLE_MS: u32 = 5;
const DRIVER: &str = "controller1";
const STARTED: &str = "controller2";
const WAIT: Duration = Duration::from_secs(30);

pub fn run(cell: Option<&Path>, starts: usize, seconds: u64) -> Result<Map<String, Value>> {
    let mut rig = Rig::start(cell, CYCLE_MS)?;
    rig.join(DRIVER)?;
    let active = rig.eye.seen().newest.len();
    let (cpu_percent, mcs_percent) = cpu(&rig, seconds)?;
    let mut figures = Map::new();
    let held: BTreeMap<String, u64> = rig
        .cell
        .pids()
        .into_iter()
        .filter_map(|(name, pid)| Some((name, holding(pid)?.rss_kb)))
        .collect();
    for (name, process) in [
        ("manager", "manager"),
        ("gateway", "gateway"),
        ("node", DRIVER),
    ] {
        let kb = held.get(process).copied();
        figures.insert(format!("{name}_mb"), json!(kb.map(megabytes)));
    }
    figures.insert("active_mcs".into(), json!(active));
    figures.insert("node_cpu_percent".into(), json!(round(cpu_percent)));
    figures.insert("mcs_cpu_percent".into(), json!(round(mcs_percent)));
    figures.insert(
        "node_cpu_beside_mcs_percent".into(),
        json!(round(cpu_percent - mcs_percent)),
    );
    let first_ms = start(&mut rig)?;
    let mut again_ms = Vec::new();
    for _ in 0..starts {
        again_ms.push(start(&mut rig)?);
    }
    let again = Stats::new(again_ms);
    figures.insert("first_start_ms".into(), json!(round(first_ms)));
    figures.insert("start_ms_p50".into(), json!(again.ms(50.0)));
    figures.insert("start_ms_max".into(), json!(again.ms(100.0)));
    rig.cell.stop()?;
    Ok(figures)
}

/// CPU of the driving node, and of its MCs' scans alone, in percent of a core.
fn cpu(rig: &Rig, seconds: u64) -> Result<(f64, f64)> {
    let pid = rig
        .cell
        .pids()
        .into_iter()
        .find(|(name, _)| name == DRIVER)
        .context("the node does not run")?
        .1;
    let from = (cpu_ticks(pid)?, std::time::Instant::now());
    let reported = rig.eye.seen().history.len();
    std::thread::sleep(Duration::from_secs(seconds));
    let ticks = cpu_ticks(pid)? - from.0;
    // SAFETY: asks for a constant of the system.
    let per_second = unsafe { libc::sysconf(libc::_SC_CLK_TCK) } as f64;
    let percent = ticks as f64 / per_second / from.1.elapsed().as_secs_f64() * 100.0;
    let seen = rig.eye.seen();
    let scans: Vec<f64> = seen.history[reported..]
        .iter()
        .filter_map(|(_, status)| {
            let node = status
                .controllers
                .iter()
                .find(|c| c.controller.as_str() == DRIVER)?;
            let mcs = &node.report.as_ref()?.mcs;
            Some(
                mcs.iter()
                    .map(|m| f64::from(m.scan_us_mean) / f64::from(m.cycle_us.max(1)) * 100.0)
                    .sum(),
            )
        })
        .collect();
    anyhow::ensure!(!scans.is_empty(), "the manager has told no workload");
    Ok((percent, scans.iter().sum::<f64>() / scans.len() as f64))
}

/// User and system time of a process, in ticks of the system's clock.
fn cpu_ticks(pid: u32) -> Result<u64> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat"))?;
    // The name stands in parentheses and may hold anything.
    let fields: Vec<&str> = stat
        .rsplit(')')
        .next()
        .unwrap_or_default()
        .split_whitespace()
        .collect();
    let field = |at: usize| -> Result<u64> { Ok(fields.get(at).context("short stat")?.parse()?) };
    Ok(field(11)? + field(12)?)
}

/// Starts a node and waits until the manager may give it MCs; returns how long that took, in milliseconds. Ends it again.
fn start(rig: &mut Rig) -> Result<f64> {
    let after = rig.eye.seen().events.last().map_or(0, |e| e.seq);
    let from = SystemTime::now();
    rig.cell.start_node(STARTED)?;
    let joined_us = rig
        .eye
        .wait(&format!("{STARTED} has joined"), WAIT, |seen| {
            seen.events
                .iter()
                .find(|e| {
                    e.seq > after
                        && e.kind == EventKind::ControllerJoined
                        && e.controller.as_ref().is_some_and(|c| c.as_str() == STARTED)
                })
                .map(|e| e.wall_us)
        })?;
    rig.rest()?;
    rig.cell.stop_node(STARTED)?;
    rig.rest()?;
    let joined = UNIX_EPOCH + Duration::from_micros(joined_us);
    let took = joined
        .duration_since(from)
        .context("the wall clock was set back meanwhile; repeat the benchmark")?;
    Ok(took.as_secs_f64() * 1_000.0)
}

fn megabytes(kb: u64) -> f64 {
    round(kb as f64 / 1_024.0)
}

fn round(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}
