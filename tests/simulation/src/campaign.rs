//! Many seeds in a row, what came of them, and what is kept of a failure: an event log that replays, shrunk to a small one.

use crate::invariants::Violation;
use crate::simulator::{Fault, Matrix, Options, Outcome, Profile, Stage, explain, kinds, run};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Fewest schedules of which every cell of the matrix has to be hit by one.
pub const MATRIX_FROM: u64 = 3_000;
/// Runs that shrinking may take.
const SHRINK_RUNS_MAX: u32 = 400;
/// Lines of an event log that are kept: what comes last before the violation, without the frames of every cycle,
const LINES_MAX: usize = 60;
/// and characters of each.
const LINE_MAX: usize = 220;

/// Sums over schedules.
#[derive(Debug, Clone, Default)]
pub struct Tally {
    /// Schedules run.
    pub schedules: u64,
    /// Seeds whose schedule broke a promise, with the first one broken.
    pub violations: Vec<(u64, Violation)>,
    /// Faults carried out, by kind.
    pub faults: BTreeMap<&'static str, u64>,
    /// What the cells did, by kind.
    pub deeds: BTreeMap<&'static str, u64>,
    /// Which stages the faults have hit.
    pub matrix: Matrix,
    /// Events handled.
    pub events: u64,
    /// Virtual time, in microseconds.
    pub virtual_us: u64,
    /// Fewest faults of a schedule.
    pub faults_min: u64,
    /// Shortest schedule, in microseconds of virtual time.
    pub virtual_us_min: u64,
    /// Schedules in which no fault came while a failover or a move was under way.
    pub undisturbed: u64,
    /// How long after the faults the slowest cell was well again, in microseconds.
    pub slowest_us: u64,
    /// Products of real plants.
    pub products: u64,
}

impl Tally {
    /// Adds what came of a schedule.
    pub fn add(&mut self, outcome: &Outcome) {
        if let Some(violation) = outcome.violations.first() {
            self.violations.push((outcome.seed, violation.clone()));
        } else {
            let first = self.schedules == self.violations.len() as u64;
            let faults = outcome.carried.len() as u64;
            self.faults_min = if first {
                faults
            } else {
                self.faults_min.min(faults)
            };
            let us = outcome.virtual_us;
            self.virtual_us_min = if first {
                us
            } else {
                self.virtual_us_min.min(us)
            };
            self.undisturbed += u64::from(outcome.in_flight == 0);
        }
        self.schedules += 1;
        for (kind, n) in &outcome.faults {
            *self.faults.entry(kind).or_default() += n;
        }
        for (kind, n) in &outcome.deeds {
            *self.deeds.entry(kind).or_default() += n;
        }
        self.matrix.add(&outcome.matrix);
        self.events += outcome.events;
        self.virtual_us += outcome.virtual_us;
        self.slowest_us = self.slowest_us.max(outcome.recovered_us);
        self.products += outcome.products;
    }

    /// Runs schedules, one after the other.
    #[must_use]
    pub fn of(seeds: impl Iterator<Item = u64>, options: &Options) -> Tally {
        let mut tally = Tally::default();
        for seed in seeds {
            tally.add(&run(seed, options));
        }
        tally
    }

    /// Cells of the matrix that could be reached and were not, if there were schedules enough to expect it.
    #[must_use]
    pub fn gaps(&self) -> Vec<(&'static str, Stage)> {
        if self.schedules < MATRIX_FROM {
            return Vec::new();
        }
        self.matrix.empty()
    }

    /// The matrix as a table in Markdown.
    #[must_use]
    pub fn matrix_table(&self) -> String {
        let mut text = "| fault | carried out |".to_owned();
        for stage in Stage::ALL {
            text.push_str(&format!(" {} |", stage.words()));
        }
        text.push_str("\n|---|---:|");
        text.push_str(&"---:|".repeat(Stage::ALL.len()));
        for kind in kinds() {
            let all = self.faults.get(kind).copied().unwrap_or(0);
            text.push_str(&format!("\n| {kind} | {all} |"));
            for stage in Stage::ALL {
                text.push_str(&format!(" {} |", self.matrix.hits(kind, stage)));
            }
        }
        text.push('\n');
        text
    }
}

/// A schedule that broke a promise, or once did: all that is needed to run it again.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// The seed: it chooses the cell and the chances of links and threads.
    pub seed: u64,
    /// The profile.
    pub profile: Profile,
    /// What was broken.
    pub violation: String,
    /// What was the cause, once it is known.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub cause: String,
    /// When the faults were over, in microseconds.
    pub quiet_us: u64,
    /// The faults.
    pub faults: Vec<Carried>,
    /// The end of the event log.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub log: Vec<String>,
}

/// A fault with its time.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Carried {
    /// When, in microseconds of virtual time.
    pub at_us: u64,
    /// What.
    pub fault: Fault,
}

impl Outcome {
    /// What was carried out, as it is written down.
    #[must_use]
    pub fn carried_as_recorded(&self) -> Vec<Carried> {
        let carried = self.carried.iter().map(|(at_us, fault)| Carried {
            at_us: *at_us,
            fault: fault.clone(),
        });
        carried.collect()
    }
}

/// Why a record cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// It does not read.
    #[error("this is no recorded schedule: {0}")]
    Read(#[from] toml::de::Error),
    /// It cannot be written.
    #[error("the schedule cannot be written down: {0}")]
    Write(#[from] toml::ser::Error),
}

impl Record {
    /// The record of a run that broke a promise; `None` if it broke none.
    #[must_use]
    pub fn of(outcome: &Outcome, profile: Profile) -> Option<Record> {
        let violation = outcome.violations.first()?;
        Some(Record {
            seed: outcome.seed,
            profile,
            violation: violation.to_string(),
            cause: String::new(),
            quiet_us: outcome.quiet_us,
            faults: outcome.carried_as_recorded(),
            log: Vec::new(),
        })
    }

    /// Reads a record.
    ///
    /// # Errors
    /// [`RecordError::Read`] with line and what was expected.
    pub fn read(text: &str) -> Result<Record, RecordError> {
        Ok(toml::from_str(text)?)
    }

    /// Writes it.
    ///
    /// # Errors
    /// [`RecordError::Write`].
    pub fn write(&self) -> Result<String, RecordError> {
        Ok(toml::to_string_pretty(self)?)
    }

    /// What runs it again.
    #[must_use]
    pub fn options(&self) -> Options {
        let faults = self.faults.iter();
        Options {
            script: Some(faults.map(|c| (c.at_us, c.fault.clone())).collect()),
            quiet_us: (self.quiet_us > 0).then_some(self.quiet_us),
            ..Options::of(self.profile)
        }
    }

    /// Runs it again.
    #[must_use]
    pub fn replay(&self) -> Outcome {
        run(self.seed, &self.options())
    }

    /// The smallest record found that breaks the same promise: faults are left out, in halves, quarters and one by one, and those that
    /// are left are made shorter. `options` carries a planted bug, if there is one.
    #[must_use]
    pub fn shrunk(&self, options: &Options) -> Record {
        let mut runs = 0;
        let mut breaks = |faults: &[Carried], quiet_us: u64| {
            runs += 1;
            let tried = Record {
                faults: faults.to_vec(),
                quiet_us,
                ..self.clone()
            };
            let with = Options {
                canary: options.canary,
                only: options.only,
                bound_us: options.bound_us,
                ..tried.options()
            };
            let outcome = run(self.seed, &with);
            let found = outcome.violations.first().cloned();
            let same = found.filter(|v| self.violation.contains(v.invariant));
            (same, runs < SHRINK_RUNS_MAX)
        };
        let mut best = self.clone();
        let mut size = best.faults.len().div_ceil(2);
        let mut more = true;
        while size >= 1 && more {
            let mut from = 0;
            let mut smaller = false;
            while from < best.faults.len() && more {
                let to = (from + size).min(best.faults.len());
                let mut faults = best.faults.clone();
                faults.drain(from..to);
                let (found, go_on) = breaks(&faults, best.quiet_us);
                more = go_on;
                if let Some(violation) = found {
                    best.violation = violation.to_string();
                    best.faults = faults;
                    smaller = true;
                } else {
                    from = to;
                }
            }
            if size == 1 && !smaller {
                break;
            }
            size = if size > 1 { size / 2 } else { 1 };
        }
        for at in 0..best.faults.len() {
            while more && let Some(half) = best.faults[at].fault.halved() {
                let mut faults = best.faults.clone();
                faults[at].fault = half;
                let (found, go_on) = breaks(&faults, best.quiet_us);
                more = go_on;
                let Some(violation) = found else { break };
                best.violation = violation.to_string();
                best.faults = faults;
            }
        }
        best.log = best.explained(options);
        best
    }

    /// The end of its event log.
    fn explained(&self, options: &Options) -> Vec<String> {
        let with = Options {
            canary: options.canary,
            only: options.only,
            bound_us: options.bound_us,
            ..self.options()
        };
        let text = explain(self.seed, &with);
        let told = |line: &&str| !line.contains("  field    ") && !line.contains("Register");
        let lines: Vec<&str> = text.lines().filter(told).collect();
        let from = lines.len().saturating_sub(LINES_MAX);
        let cut = |line: &&str| line.chars().take(LINE_MAX).collect();
        lines[from..].iter().map(cut).collect()
    }
}
