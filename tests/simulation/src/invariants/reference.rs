//! A second opinion: what the model MC has to do from a state, and how an epoch has to begin by the contract.
//!
//! Written against the words of design, section 4, point 6, and not against the agents' code.

use super::{Ended, Grant, HeadFact};
use fam_node_core::McRuntime;
use fam_node_core::model_mc::{ModelMc, STOP};
use fam_proto::diagnosis::{Diagnosis, IntervalKind};
use fam_proto::{Phase, Reset};

const IS_ACTIVE: usize = 0;
const WAS_ACTIVE: usize = 4;
const RECOVERY: usize = 8;
const ACTION: usize = 12;
const STATE: usize = 16;
/// `count`, the retained variable.
const RETAINED: std::ops::Range<usize> = STATE..STATE + 8;

/// How an epoch begins.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Beginning {
    /// Initial values, but for retained variables if there are any to take.
    pub initial: Option<Reset>,
    /// Value of `recoveryAction`.
    pub recovery: u16,
    /// An interrupted action goes on.
    pub keep_action: bool,
}

/// How the contract wants an epoch to begin; `None`: not at all.
pub(super) fn beginning(
    grant: &Grant,
    base: Option<&HeadFact>,
    diagnosis: &Diagnosis,
) -> Option<Beginning> {
    let from = |recovery, keep_action| {
        Some(Beginning {
            initial: None,
            recovery,
            keep_action,
        })
    };
    let (Some(base), None | Some(Reset::Resume)) = (base, grant.reset) else {
        return Some(Beginning {
            initial: Some(grant.reset.unwrap_or(Reset::Cold)),
            recovery: 0,
            keep_action: false,
        });
    };
    let released = matches!(grant.after, Some(Ended::Released(_)));
    if released && base.phase == Phase::Running {
        return from(0, false);
    }
    let unrecoverable = |but: Option<u16>| {
        let state = base.state.get(STATE..)?;
        let found = diagnosis.intervals.iter().find(|i| {
            i.kind == IntervalKind::Unrecoverable && Some(i.action) != but && i.holds(state)
        })?;
        Some(found.action)
    };
    match base.phase {
        Phase::Running | Phase::Stopped => {
            let interval = diagnosis.critical_interval(&base.state);
            from(interval.map_or(0, |i| i.action), false)
        }
        Phase::Recovering(action) | Phase::Stopping(action) => {
            let interval = diagnosis.interval_of_action(action);
            let repeatable = interval.map_or(action == STOP, |i| i.repeatable);
            if repeatable {
                from(action, true)
            } else {
                from(
                    unrecoverable(Some(action)).unwrap_or(diagnosis.stop_action?),
                    false,
                )
            }
        }
    }
}

/// An instance that begins an epoch.
pub(super) fn begin(padding: usize, base: Option<&[u8]>, how: &Beginning) -> ModelMc {
    let mut model = ModelMc::new(padding);
    let checkpoint = model.checkpoint_mut();
    match (base, how.initial) {
        (Some(base), None) if base.len() == checkpoint.len() => checkpoint.copy_from_slice(base),
        (Some(base), Some(Reset::Warm)) if base.len() == checkpoint.len() => {
            checkpoint[RETAINED].copy_from_slice(&base[RETAINED]);
        }
        _ => {}
    }
    activate(checkpoint, how.recovery, how.keep_action);
    model
}

/// An instance that leaves normal logic for the stop POU.
pub(super) fn stop(padding: usize, good: &[u8]) -> ModelMc {
    let how = Beginning {
        initial: None,
        recovery: STOP,
        keep_action: false,
    };
    begin(padding, Some(good), &how)
}

/// One scan; `None`: it traps.
pub(super) fn scan(model: &mut ModelMc, inputs: &[u8], mc_time_us: u64) -> Option<()> {
    let image = model.inputs_mut();
    if image.len() != inputs.len() {
        return None;
    }
    image.copy_from_slice(inputs);
    model.scan(mc_time_us).ok()
}

fn activate(checkpoint: &mut [u8], recovery: u16, keep_action: bool) {
    let mut cell = |at: usize, value: i32| {
        checkpoint[at..at + 4].copy_from_slice(&value.to_le_bytes());
    };
    cell(IS_ACTIVE, 1);
    cell(WAS_ACTIVE, 0);
    cell(RECOVERY, i32::from(recovery));
    if !keep_action {
        cell(ACTION, 0);
    }
}
