//! A second opinion: what an MC's logic has to do from a state, and how an epoch has to begin by the contract.
//!
//! Written against the words of design, section 4, point 6, and not against the agents' code. Each scan is run from the bytes of the
//! checkpoint before it alone, in an instance that has forgotten everything else.

use super::{Ended, Grant, HeadFact};
use crate::simulator::{McInfo, SimMc};
use fam_node_core::McRuntime;
use fam_proto::diagnosis::{Diagnosis, IntervalKind};
use fam_proto::{McId, Phase, Reset};
use std::collections::BTreeMap;

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
        let state = base.state.get(diagnosis.state_offset as usize..)?;
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
            let stop = diagnosis.stop_action == Some(action);
            let repeatable = interval.map_or(stop, |i| i.repeatable);
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

/// The checkpoint that an epoch begins with.
pub(super) fn begin(info: &McInfo, base: Option<&[u8]>, how: &Beginning) -> Vec<u8> {
    let spec = &info.spec;
    let mut checkpoint = spec.initial.clone();
    match (base, how.initial) {
        (Some(base), None) if base.len() == checkpoint.len() => checkpoint.copy_from_slice(base),
        (Some(base), Some(Reset::Warm)) if base.len() == checkpoint.len() => {
            for range in &spec.retained {
                checkpoint[range.clone()].copy_from_slice(&base[range.clone()]);
            }
        }
        _ => {}
    }
    activate(info, &mut checkpoint, how.recovery, how.keep_action);
    checkpoint
}

/// The checkpoint from which normal logic is left for the stop POU; `None`: there is none.
pub(super) fn stop(info: &McInfo, good: &[u8]) -> Option<Vec<u8>> {
    let how = Beginning {
        initial: None,
        recovery: info.spec.diagnosis.stop_action?,
        keep_action: false,
    };
    Some(begin(info, Some(good), &how))
}

/// The checkpoint from which an instance that remembers nothing does what the one that has just made it does next.
pub(super) fn go_on(info: &McInfo, state: &[u8]) -> Vec<u8> {
    let control = &info.spec.control;
    let mut state = state.to_vec();
    if cell(&state, control.is_active) != 0 && cell(&state, control.was_active) != 0 {
        set(&mut state, control.was_active, 0);
        set(&mut state, control.recovery_action, 0);
    }
    state
}

fn activate(info: &McInfo, checkpoint: &mut [u8], recovery: u16, keep_action: bool) {
    let control = &info.spec.control;
    set(checkpoint, control.is_active, 1);
    set(checkpoint, control.was_active, 0);
    set(checkpoint, control.recovery_action, i32::from(recovery));
    if !keep_action {
        let actions = control.actions.clone();
        checkpoint[actions.clone()].copy_from_slice(&info.spec.initial[actions]);
    }
}

fn cell(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn set(bytes: &mut [u8], at: usize, value: i32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

/// What a scan is given.
pub(super) struct Given<'a> {
    pub inputs: &'a [u8],
    pub outputs: &'a [u8],
    pub mc_time_us: u64,
}

/// An instance of each MC, to run scans in.
#[derive(Default)]
pub(super) struct Reference {
    instances: BTreeMap<McId, SimMc>,
}

impl Reference {
    /// One scan from a checkpoint: state and outputs after it. `None`: it traps.
    pub(super) fn scan(
        &mut self,
        info: &McInfo,
        checkpoint: &[u8],
        given: &Given<'_>,
    ) -> Option<(&[u8], &[u8])> {
        if !self.instances.contains_key(&info.mc) {
            let instance = info.logic.instance();
            self.instances.insert(info.mc.clone(), instance);
        }
        let instance = self.instances.get_mut(&info.mc)?;
        let fits = instance.inputs_mut().len() == given.inputs.len()
            && instance.outputs().len() == given.outputs.len()
            && instance.checkpoint().len() == checkpoint.len();
        if !fits {
            return None;
        }
        instance.reset();
        instance.checkpoint_mut().copy_from_slice(checkpoint);
        instance.inputs_mut().copy_from_slice(given.inputs);
        instance.outputs_mut().copy_from_slice(given.outputs);
        instance.scan(given.mc_time_us).ok()?;
        Some((instance.checkpoint(), instance.outputs()))
    }
}
