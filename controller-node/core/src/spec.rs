//! What a node knows of an MC beside its code.

use fam_proto::diagnosis::{Diagnosis, IntervalKind};
use fam_proto::{GatewayId, LayoutHash, McId, Phase};
use std::ops::Range;

/// Where the Control program's variables lie in the checkpoint. Each is a 4-byte cell, little endian.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ControlOffsets {
    /// `isActive : BOOL`.
    pub is_active: usize,
    /// `wasActive : BOOL`.
    pub was_active: usize,
    /// `recoveryAction : INT`.
    pub recovery_action: usize,
    /// The instances of the recovery actions and of the stop POU.
    pub actions: Range<usize>,
}

/// What a node knows of an MC.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct McSpec {
    /// Its place among the MCs of this node.
    pub index: usize,
    /// The MC.
    pub mc: McId,
    /// Its gateway.
    pub gateway: GatewayId,
    /// Layout of its checkpoint.
    pub layout: LayoutHash,
    /// Its cycle, in microseconds.
    pub cycle_us: u32,
    /// Its diagnosis file.
    pub diagnosis: Diagnosis,
    /// Its control variables.
    pub control: ControlOffsets,
    /// The checkpoint of an MC that has never run: control variables, actions, serialized initial state.
    pub initial: Vec<u8>,
    /// Retained variables, as ranges of the checkpoint.
    pub retained: Vec<Range<usize>>,
    /// Length of its input image, in bytes.
    pub inputs_len: usize,
    /// Length of its output image, in bytes.
    pub outputs_len: usize,
}

/// Why a spec cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{mc}: {what} lies outside its checkpoint of {len} bytes; generate the project anew")]
pub struct SpecError {
    mc: McId,
    what: &'static str,
    len: usize,
}

impl McSpec {
    /// Checks once that all places lie in the checkpoint, so that nothing has to be checked in a scan.
    ///
    /// # Errors
    /// [`SpecError`] names the first that does not.
    pub fn check(&self) -> Result<(), SpecError> {
        let len = self.initial.len();
        let cell = |at: usize| at.checked_add(4).is_some_and(|end| end <= len);
        let range = |r: &Range<usize>| r.start <= r.end && r.end <= len;
        let control = &self.control;
        let checks = [
            (
                len == self.diagnosis.checkpoint_len as usize,
                "the checkpoint's own end",
            ),
            (
                self.diagnosis.state_offset as usize <= len,
                "the serialized state",
            ),
            (cell(control.is_active), "isActive"),
            (cell(control.was_active), "wasActive"),
            (cell(control.recovery_action), "recoveryAction"),
            (range(&control.actions), "a recovery action"),
            (self.retained.iter().all(range), "a retained variable"),
            (self.cycle_us > 0, "its cycle of 0"),
        ];
        match checks.into_iter().find(|(good, _)| !good) {
            None => Ok(()),
            Some((_, what)) => Err(SpecError {
                mc: self.mc.clone(),
                what,
                len,
            }),
        }
    }

    /// Sets the control variables for an activation: active now, not before, with this recovery.
    pub(crate) fn activate(&self, checkpoint: &mut [u8], recovery: u16, keep_action: bool) {
        let control = &self.control;
        write_cell(checkpoint, control.is_active, 1);
        write_cell(checkpoint, control.was_active, 0);
        write_cell(checkpoint, control.recovery_action, i32::from(recovery));
        if !keep_action {
            let actions = control.actions.clone();
            checkpoint[actions.clone()].copy_from_slice(&self.initial[actions]);
        }
    }

    /// The phase that the control variables show after a scan.
    pub(crate) fn phase(&self, checkpoint: &[u8]) -> Phase {
        let control = &self.control;
        if read_cell(checkpoint, control.is_active) == 0 {
            return Phase::Stopped;
        }
        if read_cell(checkpoint, control.was_active) != 0 {
            return Phase::Running;
        }
        let action =
            u16::try_from(read_cell(checkpoint, control.recovery_action)).unwrap_or(u16::MAX);
        self.phase_of(action)
    }

    /// The phase in which an action runs.
    pub(crate) fn phase_of(&self, action: u16) -> Phase {
        match self.diagnosis.interval_of_action(action) {
            Some(interval) if interval.kind == IntervalKind::Checkpoint => {
                Phase::Recovering(action)
            }
            _ => Phase::Stopping(action),
        }
    }
}

fn read_cell(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn write_cell(bytes: &mut [u8], at: usize, value: i32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}
