//! The stage of the demo: the running cell, the observer, the plant's own account, and the notes taken on the way.

use super::display::Display;
use super::gaps::Stretch;
use crate::bench::Witness;
use crate::observe::{Observer, monotonic_us};
use crate::report::{Check, Step};
use crate::running::Running;
use anyhow::{Context, Result, bail};
use fam_plant::{PlantStatus, StatusClient};
use fam_proto::model::CellModel;
use fam_proto::{EventKind, McId, PlanId};
use std::collections::BTreeMap;
use std::time::Duration;

/// How long the cell may take for anything that is waited for.
pub const WAIT: Duration = Duration::from_secs(25);
/// How long a workload needs to show in the reports after a change.
const SETTLE: Duration = Duration::from_millis(1_200);

/// Everything that the story uses.
pub struct Stage {
    /// The processes.
    pub cell: Running,
    /// The observer.
    pub eye: Observer,
    /// The plant's own account.
    pub plant: StatusClient,
    /// Model of the cell.
    pub model: CellModel,
    /// Cycle of each MC, in microseconds.
    pub cycles_us: BTreeMap<McId, u64>,
    /// Tells stalls of the machine apart.
    pub witness: Witness,
    /// Beginning, on the machine's monotonic clock.
    pub began_us: u64,
    /// What was done.
    pub steps: Vec<Step>,
    /// What was asserted.
    pub checks: Vec<Check>,
    /// What people see meanwhile.
    pub display: Display,
}

impl Stage {
    /// Seconds since the beginning.
    #[allow(clippy::cast_precision_loss)]
    pub fn seconds(&self, at_us: u64) -> f64 {
        at_us.saturating_sub(self.began_us) as f64 / 1e6
    }

    /// Does one step of the story and writes down what came of it.
    pub fn step(
        &mut self,
        name: &str,
        doing: &str,
        action: impl FnOnce(&mut Stage) -> Result<String>,
    ) -> Result<Stretch> {
        self.display.doing(doing);
        let at_us = monotonic_us();
        let before = self.eye.seen().workloads();
        let rejected_before = self.rejected();
        let text = action(self).with_context(|| format!("step \"{name}\""))?;
        let ended_us = monotonic_us();
        self.settle()?;
        let stretch = Stretch::between(
            &self.eye.seen().applied,
            &self.cycles_us,
            at_us,
            monotonic_us(),
        );
        // One look after the other: each holds what has been seen for its statement.
        let after = self.eye.seen().workloads();
        let rejected = self.rejected().saturating_sub(rejected_before);
        let step = Step {
            at_s: self.seconds(at_us),
            name: name.to_owned(),
            text,
            before,
            after,
            gap_ms: stretch.longest_takeover_ms(),
            missed_scans: stretch
                .missed(&self.witness, |g| g.epochs.0 == g.epochs.1)
                .scans,
            rejected,
            products: self.plant()?.products.len() as u64,
        };
        self.display.done(&step, self.seconds(ended_us));
        self.steps.push(step);
        Ok(stretch)
    }

    /// Writes an assertion down.
    pub fn check(&mut self, name: &str, held: bool, seen: impl Into<String>) {
        let check = Check {
            name: name.to_owned(),
            held,
            seen: seen.into(),
        };
        self.display.checked(&check);
        self.checks.push(check);
    }

    /// The plant's account.
    pub fn plant(&self) -> Result<PlantStatus> {
        self.eye
            .block_on(self.plant.status())
            .context("the plant does not answer on its status port")
    }

    /// Frames rejected by the gateway, in all.
    pub fn rejected(&self) -> u64 {
        self.eye
            .seen()
            .status()
            .map_or(0, |s| s.mcs.iter().map(|m| m.rejected).sum())
    }

    /// Waits until every MC is driven by one of the controllers, and returns who drives what.
    pub fn wait_driven(&self, what: &str, controllers: &[&str]) -> Result<BTreeMap<McId, String>> {
        let since_us = monotonic_us();
        let mcs: Vec<McId> = self.model.mcs.iter().map(|m| m.mc.clone()).collect();
        self.eye.wait(what, WAIT, |seen| {
            mcs.iter()
                .map(|mc| {
                    let a = seen.newest.get(mc)?;
                    let by = a.owner.controller.as_str();
                    (a.at_us > since_us && controllers.contains(&by))
                        .then(|| (mc.clone(), by.to_owned()))
                })
                .collect()
        })
    }

    /// MCs that a controller drives now.
    pub fn driven_by(&self, controller: &str) -> Vec<McId> {
        let seen = self.eye.seen();
        seen.newest
            .values()
            .filter(|a| a.owner.controller.as_str() == controller)
            .map(|a| a.mc.clone())
            .collect()
    }

    /// Waits until a plan made after event `after` is done, and at least one MC is driven by the controller.
    pub fn wait_balanced(&self, controller: &str, after: u64) -> Result<(PlanId, String)> {
        self.eye.wait(
            &format!("a work-balance plan that gives {controller} its share"),
            WAIT,
            |seen| {
                let plan = seen
                    .events
                    .iter()
                    .filter(|e| e.seq > after && e.kind == EventKind::PlanDone)
                    .find_map(|e| e.plan)?;
                let why = seen
                    .events
                    .iter()
                    .find(|e| e.kind == EventKind::PlanDecided && e.plan == Some(plan))
                    .map(|e| e.text.clone())?;
                seen.newest
                    .values()
                    .any(|a| a.owner.controller.as_str() == controller)
                    .then_some((plan, why))
            },
        )
    }

    /// Position in the event history.
    pub fn last_event(&self) -> u64 {
        self.eye.seen().events.last().map_or(0, |e| e.seq)
    }

    /// Waits until the plant has finished so many more sets.
    pub fn produce(&self, more: usize) -> Result<()> {
        let goal = self.plant()?.products.len() + more;
        let deadline = std::time::Instant::now() + WAIT;
        loop {
            let have = self.plant()?.products.len();
            if have >= goal {
                return Ok(());
            }
            if std::time::Instant::now() > deadline {
                bail!(
                    "production does not go on: {have} sets finished, waited {WAIT:?} for {goal}"
                );
            }
            self.pause(Duration::from_millis(100));
        }
    }

    /// Lets the reports show what has changed.
    pub fn settle(&mut self) -> Result<()> {
        self.pause(SETTLE);
        let dead = self.cell.casualties()?;
        if !dead.is_empty() {
            bail!("{}", dead.join("\n"));
        }
        Ok(())
    }

    /// Lets the cell run for a while.
    pub fn pause(&self, how_long: Duration) {
        std::thread::sleep(how_long);
    }
}
