//! The story of the demo, step by step: the case study of the flexible assembly cell.

use super::aim::stop_at_work;
use super::gaps::Stretch;
use super::stage::{Stage, WAIT};
use anyhow::Result;
use fam_proto::{CommandKind, ControllerId, EventKind, McId};
use nix::sys::signal::Signal;
use std::time::Duration;

/// Number of steps, for the progress display.
pub const STEPS: u64 = 10;

fn names(mcs: &[McId]) -> String {
    if mcs.is_empty() {
        "nothing".to_owned()
    } else {
        mcs.iter().map(McId::as_str).collect::<Vec<_>>().join(", ")
    }
}

/// Points of workload that two reports of the same work may differ by.
const NOISE_PERCENT: f64 = 8.0;
/// How often controllers report their workload.
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Plays the whole story. Errors end it; checks that fail do not.
pub fn play(s: &mut Stage) -> Result<()> {
    alone(s)?;
    join(s, "controller2")?;
    crash(s, "controller2")?;
    join(s, "controller3")?;
    freeze(s, "controller3")?;
    drain(s, "controller1")?;
    join(s, "controller4")?;
    manager_restart(s)?;
    gateway_restart(s)?;
    s.step("Finish", "the last sets of the order are assembled", |s| {
        s.produce(2)?;
        Ok("production goes on to the end".to_owned())
    })?;
    Ok(())
}

fn alone(s: &mut Stage) -> Result<()> {
    s.step(
        "Controller 1 alone",
        "controller1 starts and takes all MCs",
        |s| {
            s.cell.start_node("controller1")?;
            let driven = s.wait_driven("controller1 drives all MCs", &["controller1"])?;
            s.produce(1)?;
            Ok(format!(
                "controller1 starts with all {} MCs active; the first set is finished",
                driven.len()
            ))
        },
    )?;
    Ok(())
}

fn join(s: &mut Stage, controller: &'static str) -> Result<()> {
    let factor = s
        .model
        .controllers
        .iter()
        .find(|c| c.controller.as_str() == controller)
        .map_or(1000, |c| c.cpu_factor_permille);
    let mut moved = Vec::new();
    let stretch = s.step(
        &format!("{controller} joins"),
        &format!("{controller} joins and work is balanced"),
        |s| {
            let after = s.last_event();
            s.cell.start_node(controller)?;
            let (plan, why) = s.wait_balanced(controller, after)?;
            moved = s.driven_by(controller);
            Ok(format!(
                "CPU factor {:.1}; plan {plan}: {why}; it drives {}",
                f64::from(factor) / 1000.0,
                names(&moved)
            ))
        },
    )?;
    s.check(
        &format!("{controller} gets its share of the work"),
        !moved.is_empty(),
        names(&moved),
    );
    planned_gaps(s, controller, &stretch);
    let peak = peak_workload(s);
    let before = s.steps.last().map_or(0.0, |step| {
        step.before.iter().map(|(_, p)| *p).fold(0.0, f64::max)
    });
    // Workloads are measured over a tenth of a second each: a few points are noise.
    s.check(
        &format!("the highest workload does not grow when {controller} joins"),
        peak < before + NOISE_PERCENT,
        format!("from {before:.0} % to {peak:.0} % of the limit"),
    );
    Ok(())
}

/// The highest workload, as the median of what the controllers report one after the other: a single report is of a tenth of a
/// second, and the machine may have been busy with something else in it.
fn peak_workload(s: &Stage) -> f64 {
    const REPORTS: usize = 5;
    let mut peaks: Vec<f64> = (0..REPORTS)
        .map(|_| {
            std::thread::sleep(REPORT_EVERY);
            let loads = s.eye.seen().workloads();
            loads
                .iter()
                .map(|(_, percent)| *percent)
                .fold(0.0, f64::max)
        })
        .collect();
    peaks.sort_by(f64::total_cmp);
    peaks[REPORTS / 2]
}

/// In a planned move no MC misses a scan: no gap of two cycles or more, the machine's own stalls apart.
fn planned_gaps(s: &mut Stage, what: &str, stretch: &Stretch) {
    let missed = stretch.missed(&s.witness, |g| g.epochs.0 != g.epochs.1);
    s.check(
        &format!("no MC misses a scan while it is moved ({what})"),
        missed.scans == 0,
        missed.to_string(),
    );
}

fn crash(s: &mut Stage, controller: &'static str) -> Result<()> {
    let mut orphans = Vec::new();
    let stretch = s.step(
        &format!("{controller} is killed"),
        &format!("SIGKILL to {controller}"),
        |s| {
            orphans = s.driven_by(controller);
            s.cell.kill_node(controller)?;
            s.wait_driven("controller1 drives all MCs", &["controller1"])?;
            Ok(format!(
                "{} go on at controller1 from the state applied last",
                names(&orphans)
            ))
        },
    )?;
    unbroken(
        s,
        &format!("after the crash of {controller}"),
        &orphans,
        &stretch,
    );
    s.produce(1)
}

/// The first scan of each new epoch follows the last applied one and names it as its base.
fn unbroken(s: &mut Stage, when: &str, mcs: &[McId], stretch: &Stretch) {
    let broken: Vec<String> = stretch
        .takeovers
        .iter()
        .filter(|t| mcs.contains(&t.mc) && t.scans_behind > 0)
        .map(|t| format!("{} is {} scan(s) behind", t.mc, t.scans_behind))
        .collect();
    let seen = if broken.is_empty() {
        format!("checked for {}", names(mcs))
    } else {
        broken.join("; ")
    };
    s.check(
        &format!("the first scan follows the last applied one {when}"),
        broken.is_empty(),
        seen,
    );
}

/// A freeze leaves a late frame only if it hits the controller between the beginning of a scan and the frame's departure:
/// any other time it resumes with an input image that is too old, and does not scan. So the freeze is aimed, and tried again.
const FREEZES_MAX: u32 = 12;
/// A controller that drives something scans within this time.
const AIM_WITHIN: Duration = Duration::from_millis(500);
/// Late frames come within this time or not at all.
const LATE_WITHIN: Duration = Duration::from_millis(700);

fn freeze(s: &mut Stage, controller: &'static str) -> Result<()> {
    let mut orphans = Vec::new();
    let mut late = 0;
    for attempt in 1..=FREEZES_MAX {
        let again = if attempt == 1 {
            String::new()
        } else {
            format!(" ({attempt}. time)")
        };
        s.eye
            .wait(&format!("{controller} drives something"), WAIT, |seen| {
                seen.newest
                    .values()
                    .any(|a| a.owner.controller.as_str() == controller)
                    .then_some(())
            })?;
        let stretch = s.step(
            &format!("{controller} is frozen{again}"),
            &format!("SIGSTOP to {controller}"),
            |s| {
                orphans = s.driven_by(controller);
                stop_at_work(s.cell.node(controller)?, "fam-scan", AIM_WITHIN)?;
                s.wait_driven("controller1 drives all MCs", &["controller1"])?;
                Ok(format!("{} taken over by controller1", names(&orphans)))
            },
        )?;
        unbroken(
            s,
            &format!("after the freeze of {controller}"),
            &orphans,
            &stretch,
        );
        let before = s.rejected();
        s.step(
            &format!("{controller} is resumed{again}"),
            &format!("SIGCONT to {controller}"),
            |s| {
                s.cell.signal_node(controller, Signal::SIGCONT)?;
                let rejected = s.eye.wait("late frames", LATE_WITHIN, |seen| {
                    let now: u64 = seen.status()?.mcs.iter().map(|m| m.rejected).sum();
                    (now > before).then_some(now - before)
                });
                late += rejected.as_ref().copied().unwrap_or(0);
                Ok(match rejected {
                    Ok(n) => format!("{n} late frame(s) rejected by the fence"),
                    Err(_) => {
                        "it was not frozen in the middle of a scan and has sent no late frame"
                            .to_owned()
                    }
                })
            },
        )?;
        if late > 0 {
            break;
        }
    }
    s.check(
        "late frames of a resumed controller are rejected",
        late > 0,
        format!("{late} rejected"),
    );
    Ok(())
}

fn drain(s: &mut Stage, controller: &'static str) -> Result<()> {
    let stretch = s.step(
        &format!("{controller} is drained"),
        &format!("fam drain {controller}"),
        |s| {
            let words = s
                .eye
                .command(CommandKind::Drain(ControllerId::new(controller)?))?;
            let empty = s.eye.wait(
                "no frame of the drained controller",
                Duration::from_secs(1),
                |seen| {
                    seen.newest
                        .values()
                        .all(|a| a.owner.controller.as_str() != controller)
                        .then_some(())
                },
            );
            s.check(
                "a drained controller drives nothing",
                empty.is_ok(),
                names(&s.driven_by(controller)),
            );
            s.cell.stop_node(controller)?;
            Ok(format!("{words}; its node ended cleanly on SIGTERM"))
        },
    )?;
    planned_gaps(s, &format!("drain of {controller}"), &stretch);
    s.produce(1)
}

fn manager_restart(s: &mut Stage) -> Result<()> {
    let owners = s.eye.seen().newest.clone();
    let stretch = s.step(
        "The manager is killed and started again",
        "SIGKILL to the manager",
        |s| {
            s.cell.kill_manager()?;
            s.pause(Duration::from_millis(1_500));
            let after = s.last_event();
            s.cell.start_manager()?;
            s.eye.wait(
                "the manager is back and knows all controllers",
                WAIT,
                |seen| {
                    let back = seen
                        .events
                        .iter()
                        .any(|e| e.seq > after && e.kind == EventKind::ManagerStarted);
                    let up = seen.status()?.controllers.iter().filter(|c| c.up).count();
                    (back && up >= 2).then_some(())
                },
            )?;
            Ok("1.5 s without a manager; the plant goes on".to_owned())
        },
    )?;
    let missed = stretch.missed(&s.witness, |_| true);
    s.check(
        "no scan is missed without a manager",
        missed.scans == 0,
        missed.to_string(),
    );
    let changed: Vec<McId> = {
        let seen = s.eye.seen();
        seen.newest
            .values()
            .filter(|a| owners.get(&a.mc).is_some_and(|o| o.epoch != a.epoch))
            .map(|a| a.mc.clone())
            .collect()
    };
    s.check(
        "the manager takes the plant as it finds it",
        changed.is_empty(),
        format!("MCs with a new epoch: {}", names(&changed)),
    );
    Ok(())
}

fn gateway_restart(s: &mut Stage) -> Result<()> {
    let mut recovered = Vec::new();
    let mcs: Vec<McId> = s.model.mcs.iter().map(|m| m.mc.clone()).collect();
    let stretch = s.step(
        "The gateway is killed and started again",
        "SIGKILL to the gateway",
        |s| {
            let after = s.last_event();
            s.cell.kill_gateway()?;
            s.pause(Duration::from_millis(500));
            s.cell.start_gateway()?;
            let controllers: Vec<String> = s
                .model
                .controllers
                .iter()
                .map(|c| c.controller.to_string())
                .collect();
            let controllers: Vec<&str> = controllers.iter().map(String::as_str).collect();
            s.wait_driven(
                "all MCs are active again, each from its record",
                &controllers,
            )?;
            s.settle()?;
            recovered = s
                .eye
                .seen()
                .events
                .iter()
                .filter(|e| e.seq > after && e.kind == EventKind::McRecovering)
                .map(|e| e.text.clone())
                .collect();
            let text = if recovered.is_empty() {
                "no MC was in a critical interval".to_owned()
            } else {
                recovered.join("; ")
            };
            Ok(format!("the cell comes back from its records; {text}"))
        },
    )?;
    // The journal of a killed gateway ends a tick early: a base beyond its end is one that the observer has not seen.
    let broken: Vec<String> = stretch
        .takeovers
        .iter()
        .filter(|t| t.base_scan < t.last_scan)
        .map(|t| {
            format!(
                "{} goes on from scan {}, scan {} was applied",
                t.mc, t.base_scan, t.last_scan
            )
        })
        .collect();
    let seen = if broken.is_empty() {
        format!("checked for {}", names(&mcs))
    } else {
        broken.join("; ")
    };
    s.check(
        "no applied scan is lost with the gateway",
        broken.is_empty() && stretch.takeovers.len() >= mcs.len(),
        seen,
    );
    s.produce(1)
}
