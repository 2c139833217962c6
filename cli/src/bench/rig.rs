//! The cell that benchmarks run: normal processes, the settings of `fam up`, all MCs of the FMS-200 active.

use super::Witness;
use crate::observe::{Observer, monotonic_us};
use crate::running::{Running, Setup};
use anyhow::{Context, Result, anyhow, bail};
use fam_proto::McId;
use fam_proto::model::CellModel;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How long the cell may take for anything that is waited for.
const WAIT: Duration = Duration::from_secs(30);
/// Without a plan for this long the cell is at rest.
const REST: Duration = Duration::from_millis(700);

/// A running cell with its observer.
pub struct Rig {
    pub cell: Running,
    pub eye: Observer,
    pub witness: Witness,
    pub model: CellModel,
    pub cycles_us: BTreeMap<McId, u64>,
    _run_dir: TempDir,
}

impl Rig {
    /// Starts plant, gateway, manager.
    pub fn start(cell: Option<&Path>, cycle_ms: u32) -> Result<Rig> {
        Rig::start_with(cell, cycle_ms, false, |_, _| Ok(BTreeMap::new()))
    }

    /// As [`Rig::start`]; `detour` gives endpoints that a controller connects to in place of the real ones.
    pub fn start_with(
        cell: Option<&Path>,
        cycle_ms: u32,
        fence_off: bool,
        detour: impl FnOnce(&str, &str) -> Result<BTreeMap<String, Vec<String>>>,
    ) -> Result<Rig> {
        let run_dir = tempfile::Builder::new().prefix("fam-bench-").tempdir()?;
        let path = match cell {
            Some(path) => path.to_owned(),
            None => crate::demo::find_cell()?,
        };
        let path = with_cycle(&path, cycle_ms, run_dir.path())?;
        let model = fam_engineering::build(&path)?.model;
        let gateway = model
            .gateways
            .first()
            .ok_or_else(|| anyhow!("{} has no gateway", path.display()))?
            .gateway
            .clone();
        let mut cell = Running::start(Setup {
            cell: path,
            gateway: gateway.to_string(),
            plant: true,
            seed: 1,
            run_dir: run_dir.path().to_owned(),
            detour: BTreeMap::new(),
            fence_off,
        })?;
        cell.detour(detour(cell.manager_endpoint(), cell.gateway_endpoint())?);
        let eye = Observer::start(
            &model.cell,
            &gateway,
            cell.manager_endpoint(),
            cell.gateway_endpoint(),
        )?;
        let cycles_us = model
            .mcs
            .iter()
            .map(|m| (m.mc.clone(), u64::from(m.cycle_us)))
            .collect();
        Ok(Rig {
            cell,
            eye,
            witness: Witness::start(),
            model,
            cycles_us,
            _run_dir: run_dir,
        })
    }

    /// Starts a node and waits until the manager has its reports and no plan is under way.
    pub fn join(&mut self, controller: &str) -> Result<()> {
        self.cell.start_node(controller)?;
        self.eye
            .wait(&format!("{controller} has joined"), WAIT, |seen| {
                let (_, status) = seen.history.last()?;
                status
                    .controllers
                    .iter()
                    .any(|c| c.controller.as_str() == controller && c.up && c.report.is_some())
                    .then_some(())
            })?;
        self.rest()
    }

    /// Waits until all MCs are driven and nothing has been planned for a while.
    pub fn rest(&mut self) -> Result<()> {
        let deadline = Instant::now() + WAIT;
        let mut quiet_since = Instant::now();
        let mut owners = Vec::new();
        loop {
            let (driven, now_owners, busy) = {
                let seen = self.eye.seen();
                let now_us = monotonic_us();
                let driven = self.model.mcs.iter().all(|m| {
                    seen.newest
                        .get(&m.mc)
                        .is_some_and(|a| now_us.saturating_sub(a.at_us) < 100_000)
                });
                let owners: Vec<_> = seen
                    .newest
                    .values()
                    .map(|a| (a.mc.clone(), a.epoch))
                    .collect();
                (
                    driven,
                    owners,
                    seen.status().is_none_or(|s| s.in_progress.is_some()),
                )
            };
            if !driven || busy || now_owners != owners {
                quiet_since = Instant::now();
                owners = now_owners;
            }
            if quiet_since.elapsed() >= REST {
                return Ok(());
            }
            if Instant::now() > deadline {
                let dead = self.cell.casualties()?;
                bail!(
                    "the cell does not come to rest within {WAIT:?}{}",
                    dead.iter().map(|d| format!("\n{d}")).collect::<String>()
                );
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    /// The controller that drives most MCs, and these.
    pub fn busiest(&self) -> Result<(String, Vec<McId>)> {
        let seen = self.eye.seen();
        let mut by: BTreeMap<String, Vec<McId>> = BTreeMap::new();
        for a in seen.newest.values() {
            by.entry(a.owner.controller.to_string())
                .or_default()
                .push(a.mc.clone());
        }
        by.into_iter()
            .max_by_key(|(_, mcs)| mcs.len())
            .ok_or_else(|| anyhow!("nothing is driven"))
    }

    /// Logs of the processes, for error messages.
    pub fn logs(&self) -> PathBuf {
        self.cell.run_dir().to_owned()
    }
}

/// The cell with another tick and cycle: a copy beside the logs, if it differs.
fn with_cycle(path: &Path, cycle_ms: u32, dir: &Path) -> Result<PathBuf> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut table: toml::Table = text.parse().with_context(|| path.display().to_string())?;
    let folder = path
        .canonicalize()?
        .parent()
        .map(Path::to_owned)
        .unwrap_or_default();
    let cycle = toml::Value::Integer(i64::from(cycle_ms));
    if let Some(cell) = table.get_mut("cell").and_then(toml::Value::as_table_mut) {
        cell.insert("tick_ms".into(), cycle.clone());
    }
    for mc in table
        .get_mut("mc")
        .and_then(toml::Value::as_array_mut)
        .into_iter()
        .flatten()
        .filter_map(toml::Value::as_table_mut)
    {
        mc.insert("cycle_ms".into(), cycle.clone());
        for file in mc
            .get_mut("logic")
            .and_then(toml::Value::as_array_mut)
            .into_iter()
            .flatten()
        {
            if let Some(name) = file.as_str() {
                *file = toml::Value::String(folder.join(name).display().to_string());
            }
        }
    }
    let copy = dir.join("cell.toml");
    std::fs::write(&copy, toml::to_string(&table)?)?;
    Ok(copy)
}
