//! Kills at random moments: the first scan of each new epoch has to start from the state behind the outputs applied last.

use super::LossKind;
use super::rig::Rig;
use crate::chain::{Chain, starts_beyond_what_was_seen};
use anyhow::{Context, Result};
use fam_gateway::records::RecordFile;
use fam_gateway_core::recorder::Takeover;
use fam_proto::{CheckpointId, Epoch, GatewayId, McId};
use fam_simulation::simulator::Random;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

const CONTROLLERS: [&str; 3] = ["controller1", "controller2", "controller3"];
const CYCLE_MS: u32 = 5;
const WAIT: Duration = Duration::from_secs(30);
/// Longest pause before a kill, in milliseconds: longer than a plan takes, so that kills fall into moves and into calm.
const PAUSE_MS: u64 = 400;
/// Longest time that the gateway stays down, in milliseconds.
const DOWN_MS: u64 = 200;

/// What all kills together have shown.
#[derive(Default)]
struct Found {
    takeovers: u64,
    scans_behind_max: u64,
    states_unequal: u64,
    double_driven: u64,
}

impl Found {
    /// `applied_last` knows better than the journal what a killed gateway had applied.
    fn judge(&mut self, t: &Takeover, applied_last: Option<CheckpointId>) {
        self.takeovers += 1;
        let (behind, equal) = match applied_last {
            // A record can only be at or beyond what has been seen of it.
            Some(last) => (
                last.scan.max(t.last_scan).0.saturating_sub(t.base_scan.0),
                t.base_scan == last.scan && last.scan >= t.last_scan,
            ),
            None => (
                t.last_scan.0.saturating_sub(t.base_scan.0),
                t.scans_behind == 0,
            ),
        };
        self.scans_behind_max = self.scans_behind_max.max(behind);
        if !equal {
            self.states_unequal += 1;
            eprintln!(
                "{}: epoch {} starts from scan {}, applied last was scan {} of epoch {}",
                t.mc, t.to.0, t.base_scan, t.last_scan, t.from.0
            );
        }
    }
}

pub fn run(
    cell: Option<&Path>,
    kind: LossKind,
    trials: usize,
    seed: u64,
) -> Result<Map<String, Value>> {
    let mut rig = Rig::start(cell, CYCLE_MS)?;
    for controller in CONTROLLERS {
        rig.join(controller)?;
    }
    let mut random = Random::new(seed, 11);
    let (mut chain, mut found) = (Chain::default(), Found::default());
    for trial in 1..=trials {
        std::thread::sleep(Duration::from_micros(random.below(PAUSE_MS * 1_000)));
        let done = match kind {
            LossKind::Controller => controller(&mut rig, &mut chain, &mut found),
            LossKind::Gateway => {
                let down = Duration::from_micros(random.below(DOWN_MS * 1_000));
                gateway(&mut rig, &mut chain, &mut found, down)
            }
        };
        done.with_context(|| format!("trial {trial}; logs in {}", rig.logs().display()))?;
        if trial.is_multiple_of(50) {
            eprintln!(
                "{trial} kills, {} takeovers, {} scans behind at most, {} states unequal",
                found.takeovers, found.scans_behind_max, found.states_unequal
            );
        }
    }
    rig.rest()?;
    look(&rig, &mut chain, &mut found, &BTreeMap::new());
    let stalls = rig.witness.stalls();
    rig.cell.stop()?;
    let mut figures = Map::new();
    figures.insert("n".into(), json!(trials));
    figures.insert("takeovers".into(), json!(found.takeovers));
    figures.insert("scans_behind_max".into(), json!(found.scans_behind_max));
    figures.insert("states_unequal".into(), json!(found.states_unequal));
    figures.insert("double_driven_scans".into(), json!(found.double_driven));
    figures.insert("stalls_witnessed".into(), json!(stalls));
    Ok(figures)
}

/// Kills whoever drives most, and starts it again as soon as the others have taken over.
fn controller(rig: &mut Rig, chain: &mut Chain, found: &mut Found) -> Result<()> {
    let (lost, mcs) = rig.busiest()?;
    rig.cell.kill_node(&lost)?;
    rig.eye.wait(
        &format!("the MCs of {lost} driven by the others"),
        WAIT,
        |seen| {
            mcs.iter()
                .all(|mc| seen.driver(mc).is_some_and(|by| by != lost))
                .then_some(())
        },
    )?;
    look(rig, chain, found, &BTreeMap::new());
    rig.cell.start_node(&lost)?;
    rig.eye.wait(&format!("{lost} is back"), WAIT, |seen| {
        let back = |c: &fam_proto::ControllerStatus| {
            c.controller.as_str() == lost && c.up && c.report.is_some()
        };
        seen.status()?.controllers.iter().any(back).then_some(())
    })?;
    let dead = rig.cell.casualties()?;
    anyhow::ensure!(dead.is_empty(), "{}", dead.join("\n"));
    Ok(())
}

/// Kills the gateway, reads what its record file holds, and starts it again.
fn gateway(rig: &mut Rig, chain: &mut Chain, found: &mut Found, down: Duration) -> Result<()> {
    rig.cell.kill_gateway()?;
    let heads = heads(rig)?;
    std::thread::sleep(down);
    // What the old life has streamed is there by now, or never.
    look(rig, chain, found, &BTreeMap::new());
    let before: BTreeMap<McId, Epoch> = rig
        .model
        .mcs
        .iter()
        .filter_map(|m| Some((m.mc.clone(), chain.head(&m.mc)?.epoch)))
        .collect();
    rig.cell.start_gateway()?;
    rig.eye
        .wait("all MCs active again, each from its record", WAIT, |seen| {
            before
                .iter()
                .all(|(mc, epoch)| seen.newest.get(mc).is_some_and(|a| a.epoch > *epoch))
                .then_some(())
        })?;
    look(rig, chain, found, &heads);
    Ok(())
}

/// Judges what has been applied since the last look. `heads` hold for the first takeover of each MC.
fn look(
    rig: &Rig,
    chain: &mut Chain,
    found: &mut Found,
    heads: &BTreeMap<McId, Option<CheckpointId>>,
) {
    let piece = {
        let mut seen = rig.eye.seen();
        let keep_from = seen.history.len().saturating_sub(1);
        seen.history.drain(..keep_from);
        seen.events.clear();
        std::mem::take(&mut seen.applied)
    };
    let shown = chain.take(&piece);
    found.double_driven += shown.double_driven;
    let mut heads = heads.clone();
    for takeover in &shown.takeovers {
        let head = heads.remove(&takeover.mc).flatten();
        let equal_to_head = head.is_none_or(|head| {
            piece
                .iter()
                .find(|a| a.mc == takeover.mc && a.epoch == takeover.to.0)
                .is_some_and(|first| first.base == Some(head))
        });
        // Without a restart nothing can have been applied that was not seen.
        debug_assert!(head.is_some() || !starts_beyond_what_was_seen(takeover));
        found.judge(takeover, head);
        if !equal_to_head {
            found.states_unequal += 1;
        }
    }
}

/// What the record file of the killed gateway holds; a copy is read, so that the file itself stays as the kill has left it.
fn heads(rig: &Rig) -> Result<BTreeMap<McId, Option<CheckpointId>>> {
    let original = rig.logs().join("records.bin");
    let copy = rig.logs().join("records.copy");
    std::fs::copy(&original, &copy)
        .with_context(|| format!("cannot copy {}", original.display()))?;
    let gateway: GatewayId = rig.model.gateways[0].gateway.clone();
    let (_, stored) = RecordFile::open(&copy, &rig.model, &gateway)?;
    Ok(stored
        .into_iter()
        .map(|record| (record.mc, record.head.map(|h| h.meta.id)))
        .collect())
}
