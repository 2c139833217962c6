//! The processes of `fam up`. One that fails is started again, so that the cell has its redundancy back while the others go
//! on; one that was told to end stays away, and one that fails again and again does, too.

use crate::processes::{Process, tail};
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What ends with an error so soon after the cell's start cannot run at all: its port is in use, or what it was given is wrong.
/// One that was killed can.
const STARTING: Duration = Duration::from_secs(3);
/// From a failure to the next start: a fault that stays shall not take the processors from those that run.
const PAUSE: Duration = Duration::from_secs(1);
/// So many failures within [`FAILURES_WITHIN`] are too many.
const FAILURES_MAX: usize = 5;
const FAILURES_WITHIN: Duration = Duration::from_secs(60);

/// How a process is started: `fam <args>`.
#[derive(Debug, Clone)]
pub struct Start {
    /// Name in messages and of its log.
    pub name: String,
    pub args: Vec<String>,
}

/// All processes of a cell.
pub struct Supervised {
    run_dir: PathBuf,
    began: Instant,
    list: Vec<One>,
}

struct One {
    start: Start,
    now: Now,
    failures: Vec<Instant>,
}

enum Now {
    Runs(Process),
    /// Failed; is started again then.
    Waits(Instant),
    Away,
}

impl Supervised {
    /// Starts them all, in this order.
    ///
    /// # Errors
    /// If one cannot be started; those that were are ended.
    pub fn start(starts: Vec<Start>, run_dir: &Path) -> Result<Self> {
        let mut list = Vec::new();
        for start in starts {
            let process = Process::start(&start.name, &start.args, run_dir)?;
            list.push(One {
                start,
                now: Now::Runs(process),
                failures: Vec::new(),
            });
        }
        Ok(Self {
            run_dir: run_dir.to_owned(),
            began: Instant::now(),
            list,
        })
    }

    /// Name and number in the system of those that run.
    pub fn running(&self) -> Vec<(&str, u32)> {
        let of = |one: &'_ One| match &one.now {
            Now::Runs(process) => Some(process.pid()),
            _ => None,
        };
        self.list
            .iter()
            .filter_map(|one| Some((one.start.name.as_str(), of(one)?)))
            .collect()
    }

    /// Looks after all; what there is to say of it.
    ///
    /// # Errors
    /// If processes end with an error while the cell is just starting, or the system refuses to start one again.
    pub fn look(&mut self) -> Result<Vec<String>> {
        let at = Instant::now();
        let (mut said, mut never_ran) = (Vec::new(), Vec::new());
        for one in &mut self.list {
            match &mut one.now {
                Now::Away => {}
                Now::Waits(until) if at < *until => {}
                Now::Waits(_) => {
                    let name = &one.start.name;
                    let process = Process::start(name, &one.start.args, &self.run_dir)
                        .with_context(|| format!("{name} cannot be started again"))?;
                    said.push(format!(
                        "{name} is started again, as process {}",
                        process.pid()
                    ));
                    one.now = Now::Runs(process);
                }
                Now::Runs(process) => {
                    let Some(status) = process.ended()? else {
                        continue;
                    };
                    let name = &one.start.name;
                    let log = process.log().to_owned();
                    let end_of_log = || format!("the end of {}:\n{}", log.display(), tail(&log));
                    let refused = status.code().is_some_and(|code| code != 0);
                    if refused && at - self.began < STARTING {
                        never_ran.push(format!(
                            "{name} ended by itself with {status}; {}",
                            end_of_log()
                        ));
                        one.now = Now::Away;
                    } else if status.success() {
                        said.push(format!(
                            "{name} has ended in order and stays away; to start it again: fam {}",
                            one.start.args.join(" ")
                        ));
                        one.now = Now::Away;
                    } else if let Some(next) = next_start(&mut one.failures, at) {
                        said.push(format!(
                            "{name} ended by itself with {status} and is started again in {PAUSE:?}; its log: {}",
                            log.display()
                        ));
                        one.now = Now::Waits(next);
                    } else {
                        said.push(format!(
                            "{name} ended by itself with {status}, for the {FAILURES_MAX}th time within a minute, and stays away; to start it again: fam {}; {}",
                            one.start.args.join(" "),
                            end_of_log()
                        ));
                        one.now = Now::Away;
                    }
                }
            }
        }
        if !never_ran.is_empty() {
            bail!("{}", never_ran.join("\n"));
        }
        Ok(said)
    }

    /// Ends them, the last one first.
    ///
    /// # Errors
    /// Those that did not end cleanly.
    pub fn end(mut self) -> Result<()> {
        let mut failed = Vec::new();
        while let Some(one) = self.list.pop() {
            if let Now::Runs(process) = one.now
                && let Err(error) = process.terminate()
            {
                failed.push(format!("{error:#}"));
            }
        }
        if !failed.is_empty() {
            bail!("{}", failed.join("\n"));
        }
        Ok(())
    }
}

/// Notes a failure: when to start again, `None` if it has failed too often.
fn next_start(failures: &mut Vec<Instant>, at: Instant) -> Option<Instant> {
    failures.push(at);
    failures.retain(|f| at - *f < FAILURES_WITHIN);
    (failures.len() < FAILURES_MAX).then(|| at + PAUSE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_fails_again_and_again_stays_away() {
        let begin = Instant::now();
        let seconds = |s: u64| begin + Duration::from_secs(s);
        let mut failures = Vec::new();
        for s in [0, 10, 20, 30] {
            assert_eq!(
                next_start(&mut failures, seconds(s)),
                Some(seconds(s) + PAUSE)
            );
        }
        assert_eq!(next_start(&mut failures, seconds(59)), None);
        // A failure now and then is none too many, however long the cell runs.
        let mut failures = Vec::new();
        for s in (0..10_000).step_by(15) {
            assert!(next_start(&mut failures, seconds(s)).is_some());
        }
    }
}
