//! Where a checkpoint keeps its control variables, and how a host reads and writes them.
//!
//! A checkpoint is `isActive`, `wasActive`, `recoveryAction`, the variables of the action instances, then the serialized state.

use crate::generate::{Names, REGION_CHECKPOINT};
use fam_soft_plc::layout::{Layout, VariableInfo};
use std::ops::Range;

/// Places in a checkpoint, in bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ControlLayout {
    /// `isActive : BOOL`, a cell of 4 bytes.
    pub is_active: u32,
    /// `wasActive : BOOL`, a cell of 4 bytes.
    pub was_active: u32,
    /// `recoveryAction : INT`, a cell of 4 bytes.
    pub recovery_action: u32,
    /// All variables of the action instances.
    pub actions: Range<u32>,
    /// Their initial values.
    pub initial_actions: Vec<u8>,
    /// The serialized state.
    pub state: Range<u32>,
}

/// The control variables of a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ControlState {
    /// Whether the MC runs here.
    pub is_active: bool,
    /// Whether it has been through its first normal scan since the activation.
    pub was_active: bool,
    /// 0 for none, else the number of the recovery or stop action.
    pub recovery_action: u16,
}

const CELL_BYTES: usize = 4;

impl ControlLayout {
    /// Of the module of an MC.
    ///
    /// # Panics
    /// If the module has no generated Control POU; the generator makes one for each MC.
    #[must_use]
    pub fn of(mc: &str, layout: &Layout) -> ControlLayout {
        let names = Names::of(mc);
        let region = layout
            .region_index(REGION_CHECKPOINT)
            .expect("a generated module has a region for its checkpoint");
        let len = layout.regions[region].len;
        let control = |name: &str| -> VariableInfo {
            layout
                .find(&format!("{}.{name}", names.control))
                .expect("Control has its three variables")
        };
        let recovery_action = control("recoveryAction").offset;
        let state = layout.find(&names.state);
        let state = state.map_or(len..len, |s| s.offset..s.offset + state_bytes(&s));
        let actions = recovery_action + CELL_BYTES as u32..state.start;
        ControlLayout {
            is_active: control("isActive").offset,
            was_active: control("wasActive").offset,
            recovery_action,
            initial_actions: layout.initial[region][actions.start as usize..actions.end as usize]
                .to_vec(),
            actions,
            state,
        }
    }

    /// The control variables of a checkpoint.
    #[must_use]
    pub fn read(&self, checkpoint: &[u8]) -> ControlState {
        let cell = |at: u32| {
            let from = at as usize;
            let mut bytes = [0; CELL_BYTES];
            if let Some(found) = checkpoint.get(from..from + CELL_BYTES) {
                bytes.copy_from_slice(found);
            }
            u32::from_le_bytes(bytes)
        };
        ControlState {
            is_active: cell(self.is_active) & 1 == 1,
            was_active: cell(self.was_active) & 1 == 1,
            recovery_action: (cell(self.recovery_action) & 0xffff) as u16,
        }
    }

    /// Sets the control variables of a checkpoint.
    pub fn write(&self, checkpoint: &mut [u8], state: ControlState) {
        for (at, value) in [
            (self.is_active, u32::from(state.is_active)),
            (self.was_active, u32::from(state.was_active)),
            (self.recovery_action, u32::from(state.recovery_action)),
        ] {
            let from = at as usize;
            if let Some(cell) = checkpoint.get_mut(from..from + CELL_BYTES) {
                cell.copy_from_slice(&value.to_le_bytes());
            }
        }
    }

    /// Gives all action variables their initial values: a new recovery begins.
    pub fn reset_actions(&self, checkpoint: &mut [u8]) {
        if let Some(actions) =
            checkpoint.get_mut(self.actions.start as usize..self.actions.end as usize)
        {
            actions.copy_from_slice(&self.initial_actions);
        }
    }

    /// Makes a checkpoint the start of an activation: with `recovery_action` 0 direct recovery, else that action. A new
    /// action begins with its initial values; with `go_on` an interrupted one goes on where it was.
    pub fn activate(&self, checkpoint: &mut [u8], recovery_action: u16, go_on: bool) {
        if !go_on {
            self.reset_actions(checkpoint);
        }
        self.write(
            checkpoint,
            ControlState {
                is_active: true,
                was_active: false,
                recovery_action,
            },
        );
    }
}

/// Elements of the byte array; what follows in memory is padding.
fn state_bytes(array: &VariableInfo) -> u32 {
    match &*array.ty {
        fam_soft_plc::layout::TypeNode::Array { dims, stride, .. } => {
            let count: i64 = dims.iter().map(|(lo, hi)| hi - lo + 1).product();
            u32::try_from(count).unwrap_or(0) * stride
        }
        _ => array.len,
    }
}
