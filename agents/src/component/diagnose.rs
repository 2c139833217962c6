//! Diagnosis of a grant: how an MC has to go on from the record that its epoch starts from (design, section 4, point 6).

use fam_proto::diagnosis::{CriticalInterval, Diagnosis, IntervalKind, Recovery};
use fam_proto::{Checkpoint, Opened, Phase, Reset};

/// How the MC begins its epoch.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Decision {
    /// Value of `recoveryAction`: 0 direct recovery.
    pub recovery: u16,
    /// Whether an interrupted action goes on where it was.
    pub keep_action: bool,
    /// Whether the action ends in a safe stop and not in normal logic.
    pub stopping: bool,
    /// The critical interval that is answered.
    pub interval: Option<String>,
    /// What the variables start from.
    pub variables: Variables,
}

/// What the variables of a new epoch start from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Variables {
    /// Initial values.
    Initial,
    /// The record's checkpoint.
    Checkpoint,
    /// Initial values, but retained variables from the record's checkpoint.
    RetainedOnly,
}

/// What comes of a diagnosis.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum Verdict {
    /// Run like this.
    Run(Decision),
    /// Nothing may be run: fail-safe values are all that is left. Why.
    NoWayBack(String),
}

/// Decides how to go on from a grant. `state` is the checkpoint that the grant names as base.
#[must_use]
pub fn diagnose(diagnosis: &Diagnosis, opened: &Opened, state: Option<&Checkpoint>) -> Verdict {
    let direct = |variables| {
        Verdict::Run(Decision {
            recovery: 0,
            keep_action: false,
            stopping: false,
            interval: None,
            variables,
        })
    };
    let Some(state) = state else {
        return direct(Variables::Initial);
    };
    match opened.reset {
        Some(Reset::Cold) => return direct(Variables::Initial),
        Some(Reset::Warm) => return direct(Variables::RetainedOnly),
        Some(Reset::Resume) | None => {}
    }
    // A release is only ever marked in normal logic and outside all critical intervals; anything else was interrupted.
    let running = state.phase == Phase::Running;
    if running && !opened.interrupted && !opened.fail_safe {
        return direct(Variables::Checkpoint);
    }
    match state.phase {
        Phase::Running | Phase::Stopped => match diagnosis.recovery(&state.state) {
            Recovery::Direct => direct(Variables::Checkpoint),
            Recovery::Checkpoint(interval) | Recovery::SafeStop(interval) => begin(interval),
        },
        Phase::Recovering(action) => match diagnosis.interval_of_action(action) {
            Some(interval) if interval.repeatable => go_on(action, Some(interval)),
            other => stop(diagnosis, other, state),
        },
        Phase::Stopping(action) => match diagnosis.interval_of_action(action) {
            Some(interval) if interval.repeatable => go_on(action, Some(interval)),
            None if diagnosis.stop_action == Some(action) => go_on(action, None),
            other => stop(diagnosis, other, state),
        },
    }
}

fn begin(interval: &CriticalInterval) -> Verdict {
    Verdict::Run(Decision {
        recovery: interval.action,
        keep_action: false,
        stopping: interval.kind == IntervalKind::Unrecoverable,
        interval: Some(interval.name.clone()),
        variables: Variables::Checkpoint,
    })
}

fn go_on(action: u16, interval: Option<&CriticalInterval>) -> Verdict {
    Verdict::Run(Decision {
        recovery: action,
        keep_action: true,
        stopping: interval.is_none_or(|i| i.kind == IntervalKind::Unrecoverable),
        interval: interval.map(|i| i.name.clone()),
        variables: Variables::Checkpoint,
    })
}

/// An action was interrupted that may not go on: the unrecoverable interval's own action if one holds, else the stop POU.
fn stop(
    diagnosis: &Diagnosis,
    interrupted: Option<&CriticalInterval>,
    state: &Checkpoint,
) -> Verdict {
    let serialized = state
        .state
        .get(diagnosis.state_offset as usize..)
        .unwrap_or(&[]);
    let unrecoverable = diagnosis.intervals.iter().find(|i| {
        i.kind == IntervalKind::Unrecoverable
            && interrupted.is_none_or(|was| was.action != i.action)
            && i.holds(serialized)
    });
    if let Some(interval) = unrecoverable {
        return begin(interval);
    }
    let name = interrupted.map_or("unknown", |i| i.name.as_str());
    match diagnosis.stop_action {
        Some(action) => Verdict::Run(Decision {
            recovery: action,
            keep_action: false,
            stopping: true,
            interval: interrupted.map(|i| i.name.clone()),
            variables: Variables::Checkpoint,
        }),
        None => Verdict::NoWayBack(format!(
            "the action of critical interval {name} was interrupted and may not be repeated, and the MC has no stop POU"
        )),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use fam_proto::diagnosis::{Mask, MaskOperand, MaskOperator, MaskType, MaskVariable};
    use fam_proto::{CheckpointId, Digest, Epoch, ImageNumber, LayoutHash, McId, Scan};

    pub(crate) const CARRY: u16 = 1;
    pub(crate) const PRESS: u16 = 2;
    pub(crate) const ONCE: u16 = 3;
    pub(crate) const STOP: u16 = 9;

    fn interval(
        name: &str,
        step: i128,
        kind: IntervalKind,
        action: u16,
        repeatable: bool,
    ) -> CriticalInterval {
        CriticalInterval {
            name: name.to_owned(),
            rows: vec![vec![Mask {
                left: MaskVariable {
                    offset: 0,
                    of: MaskType::Signed(4),
                },
                bits: u64::MAX,
                operator: MaskOperator::Equal,
                right: MaskOperand::Integer(step),
            }]],
            kind,
            action,
            pou: format!("Recover{name}"),
            repeatable,
        }
    }

    /// Twelve bytes of control variables, then `step : DINT`: 10 is in no critical interval.
    pub(crate) fn a_diagnosis(stop: bool) -> Diagnosis {
        Diagnosis {
            state_offset: 12,
            checkpoint_len: 16,
            intervals: vec![
                interval("Carry", 40, IntervalKind::Checkpoint, CARRY, true),
                interval("Press", 50, IntervalKind::Unrecoverable, PRESS, false),
                interval("Once", 60, IntervalKind::Checkpoint, ONCE, false),
            ],
            stop_action: stop.then_some(STOP),
        }
    }

    pub(crate) fn a_checkpoint(step: i32, phase: Phase) -> Checkpoint {
        let mut state = vec![0; 12];
        state.extend_from_slice(&step.to_le_bytes());
        Checkpoint {
            id: CheckpointId {
                epoch: Epoch(4),
                scan: Scan(77),
                digest: Digest::of(1_000, &state),
            },
            layout: LayoutHash(5),
            mc_time_us: 1_000,
            phase,
            image: ImageNumber(3),
            state,
        }
    }

    pub(crate) fn a_grant(checkpoint: Option<&Checkpoint>, interrupted: bool) -> Opened {
        Opened {
            mc: McId::new("Station1").unwrap(),
            epoch: Epoch(5),
            base: checkpoint.map(|c| c.id),
            checkpoint: checkpoint.cloned().map(Box::new),
            outputs: vec![1, 2],
            phase: checkpoint.map(|c| c.phase),
            interrupted,
            fail_safe: false,
            next_scan: Scan(78),
            reset: None,
            owner: crate::component::table_tests::me(),
        }
    }

    fn run(
        step: i32,
        phase: Phase,
        stop: bool,
        change: impl FnOnce(&mut Opened),
    ) -> (u16, bool, bool, Variables) {
        let checkpoint = a_checkpoint(step, phase);
        let mut grant = a_grant(Some(&checkpoint), true);
        change(&mut grant);
        match diagnose(&a_diagnosis(stop), &grant, Some(&checkpoint)) {
            Verdict::Run(d) => (d.recovery, d.keep_action, d.stopping, d.variables),
            Verdict::NoWayBack(why) => panic!("{why}"),
        }
    }

    #[test]
    fn each_phase_and_state_has_its_answer() {
        use Variables::Checkpoint as Kept;
        let as_is = |_: &mut Opened| {};
        let table = [
            // step, phase, expected: recovery, keep, stopping
            (10, Phase::Running, (0, false, false, Kept)),
            (40, Phase::Running, (CARRY, false, false, Kept)),
            (50, Phase::Running, (PRESS, false, true, Kept)),
            (60, Phase::Running, (ONCE, false, false, Kept)),
            (10, Phase::Stopped, (0, false, false, Kept)),
            (50, Phase::Stopped, (PRESS, false, true, Kept)),
            (40, Phase::Recovering(CARRY), (CARRY, true, false, Kept)),
            (60, Phase::Recovering(ONCE), (STOP, false, true, Kept)),
            // the interrupted action may not be repeated, and the state is in another interval that cannot be recovered
            (50, Phase::Recovering(ONCE), (PRESS, false, true, Kept)),
            (40, Phase::Recovering(99), (STOP, false, true, Kept)),
            (50, Phase::Stopping(PRESS), (STOP, false, true, Kept)),
            (10, Phase::Stopping(STOP), (STOP, true, true, Kept)),
        ];
        for (step, phase, expected) in table {
            assert_eq!(
                run(step, phase, true, as_is),
                expected,
                "step {step}, {phase:?}"
            );
        }
    }

    #[test]
    fn a_released_state_is_taken_directly_but_not_after_fail_safe() {
        assert_eq!(
            run(40, Phase::Running, true, |g| g.interrupted = false).0,
            0
        );
        assert_eq!(
            run(40, Phase::Running, true, |g| {
                g.interrupted = false;
                g.fail_safe = true;
            })
            .0,
            CARRY
        );
        // a release can never carry a recovery: whoever says so is not believed
        assert_eq!(
            run(60, Phase::Recovering(ONCE), true, |g| g.interrupted = false).0,
            STOP
        );
    }

    #[test]
    fn resets_choose_the_variables() {
        let with = |reset| move |g: &mut Opened| g.reset = Some(reset);
        assert_eq!(
            run(50, Phase::Stopped, true, with(Reset::Cold)),
            (0, false, false, Variables::Initial)
        );
        assert_eq!(
            run(50, Phase::Stopped, true, with(Reset::Warm)),
            (0, false, false, Variables::RetainedOnly)
        );
        assert_eq!(
            run(40, Phase::Stopped, true, with(Reset::Resume)),
            (CARRY, false, false, Variables::Checkpoint)
        );
        let first = a_grant(None, true);
        assert!(matches!(
            diagnose(&a_diagnosis(true), &first, None),
            Verdict::Run(Decision {
                recovery: 0,
                variables: Variables::Initial,
                ..
            })
        ));
    }

    #[test]
    fn without_a_stop_pou_there_may_be_no_way_back() {
        let checkpoint = a_checkpoint(60, Phase::Recovering(ONCE));
        let grant = a_grant(Some(&checkpoint), true);
        let Verdict::NoWayBack(why) = diagnose(&a_diagnosis(false), &grant, Some(&checkpoint))
        else {
            panic!("expected no way back");
        };
        assert!(why.contains("Once") && why.contains("no stop POU"), "{why}");
    }
}
