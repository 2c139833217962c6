//! A small MC in plain Rust, for simulations and tests: the same control variables, phases, critical intervals and traps
//! as compiled logic, at a fraction of the cost.
//!
//! State: `count : ULINT` (normal scans), `trace : ULINT` (a running hash over count, inputs and MC time: two runs that
//! agree in it have taken the same way), `step : DINT` (0 to [`STEPS`] - 1, one more with each scan), then padding.
//! Steps 3 and 4 are the critical interval `Carry` (checkpoint, action 1, repeatable), step 7 is `Press` (unrecoverable,
//! action 2), step 9 is `Once` (checkpoint, action 3, not repeatable); action 4 is the stop POU. Each action takes
//! [`ACTION_SCANS`] scans. The first output byte tells the phase, the following eight `count`. An input byte 0 of
//! [`TRAP_INPUT`] makes normal logic trap, [`TRAP_ALWAYS`] every action too.

use crate::runtime::McRuntime;
use crate::spec::{ControlOffsets, McSpec};
use fam_proto::diagnosis::{
    CriticalInterval, Diagnosis, IntervalKind, Mask, MaskOperand, MaskOperator, MaskType,
    MaskVariable,
};
use fam_proto::{GatewayId, LayoutHash, McId, TrapInfo};

/// Steps of a round.
pub const STEPS: i32 = 12;
/// Scans that an action takes.
pub const ACTION_SCANS: i32 = 4;
/// First input byte that makes normal logic trap.
pub const TRAP_INPUT: u8 = 0xEE;
/// First input byte that makes everything trap.
pub const TRAP_ALWAYS: u8 = 0xEF;
/// Value of `recoveryAction` for the checkpoint interval `Carry`.
pub const CARRY: u16 = 1;
/// Value of `recoveryAction` for the unrecoverable interval `Press`.
pub const PRESS: u16 = 2;
/// Value of `recoveryAction` for the checkpoint interval `Once`, whose action may not be repeated.
pub const ONCE: u16 = 3;
/// Value of `recoveryAction` for the stop POU.
pub const STOP: u16 = 4;
/// Length of the input image, in bytes.
pub const INPUTS_LEN: usize = 4;
/// Length of the output image, in bytes.
pub const OUTPUTS_LEN: usize = 9;

const IS_ACTIVE: usize = 0;
const WAS_ACTIVE: usize = 4;
const RECOVERY: usize = 8;
const ACTION_COUNT: usize = 12;
const STATE: usize = 16;
const COUNT: usize = STATE;
const TRACE: usize = STATE + 8;
const STEP: usize = STATE + 16;
const STATE_BYTES: usize = 24;

/// An instance of the model MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ModelMc {
    checkpoint: Vec<u8>,
    inputs: [u8; INPUTS_LEN],
    outputs: [u8; OUTPUTS_LEN],
    /// Live variables: Deserialize brings them from the checkpoint, Serialize back.
    live: Vec<u8>,
}

impl ModelMc {
    /// An instance with this many bytes of state beyond its own; they change slowly, as tables do.
    #[must_use]
    pub fn new(padding: usize) -> ModelMc {
        ModelMc {
            checkpoint: vec![0; STATE + STATE_BYTES + padding],
            inputs: [0; INPUTS_LEN],
            outputs: [0; OUTPUTS_LEN],
            live: vec![0; STATE_BYTES + padding],
        }
    }

    /// What a node knows of it.
    #[must_use]
    pub fn spec(
        index: usize,
        mc: McId,
        gateway: GatewayId,
        cycle_us: u32,
        padding: usize,
    ) -> McSpec {
        let initial = vec![0; STATE + STATE_BYTES + padding];
        McSpec {
            index,
            mc,
            gateway,
            layout: ModelMc::layout(padding),
            cycle_us,
            diagnosis: ModelMc::diagnosis(padding),
            control: ControlOffsets {
                is_active: IS_ACTIVE,
                was_active: WAS_ACTIVE,
                recovery_action: RECOVERY,
                actions: ACTION_COUNT..STATE,
            },
            initial,
            // `count` is retained
            retained: std::iter::once(COUNT..TRACE).collect(),
            inputs_len: INPUTS_LEN,
            outputs_len: OUTPUTS_LEN,
        }
    }

    /// Hash of its layout.
    #[must_use]
    pub fn layout(padding: usize) -> LayoutHash {
        LayoutHash(0x6D6F_6465_6C00 + padding as u64)
    }

    /// Its diagnosis file.
    #[must_use]
    pub fn diagnosis(padding: usize) -> Diagnosis {
        let interval = |name: &str, steps: (i128, i128), kind, action, repeatable| {
            let compare = |operator, value| Mask {
                left: MaskVariable {
                    offset: (STEP - STATE) as u32,
                    of: MaskType::Signed(4),
                },
                bits: u64::MAX,
                operator,
                right: MaskOperand::Integer(value),
            };
            CriticalInterval {
                name: name.to_owned(),
                rows: vec![vec![
                    compare(MaskOperator::GreaterOrEqual, steps.0),
                    compare(MaskOperator::LessOrEqual, steps.1),
                ]],
                kind,
                action,
                pou: format!("Recover{name}"),
                repeatable,
            }
        };
        Diagnosis {
            state_offset: STATE as u32,
            checkpoint_len: (STATE + STATE_BYTES + padding) as u32,
            intervals: vec![
                interval("Carry", (3, 4), IntervalKind::Checkpoint, CARRY, true),
                interval("Press", (7, 7), IntervalKind::Unrecoverable, PRESS, true),
                interval("Once", (9, 9), IntervalKind::Checkpoint, ONCE, false),
            ],
            stop_action: Some(STOP),
        }
    }

    /// `count` in a checkpoint: normal scans so far.
    #[must_use]
    pub fn count(checkpoint: &[u8]) -> u64 {
        read_u64(checkpoint, COUNT)
    }

    /// `trace` in a checkpoint.
    #[must_use]
    pub fn trace(checkpoint: &[u8]) -> u64 {
        read_u64(checkpoint, TRACE)
    }

    /// `step` in a checkpoint.
    #[must_use]
    pub fn step(checkpoint: &[u8]) -> i32 {
        read_i32(checkpoint, STEP)
    }

    fn program(&mut self, mc_time_us: u64) -> Result<(), TrapInfo> {
        let count = read_u64(&self.live, 0) + 1;
        let mut trace = read_u64(&self.live, 8);
        let inputs = u64::from(u32::from_le_bytes(self.inputs));
        for word in [count, inputs, mc_time_us] {
            trace = (trace ^ word)
                .wrapping_mul(0x9E37_79B9_7F4A_7C15)
                .rotate_left(17);
        }
        self.live[..8].copy_from_slice(&count.to_le_bytes());
        if matches!(self.inputs[0], TRAP_INPUT | TRAP_ALWAYS) {
            return Err(trap("Model", "division by zero")); // half updated, as real logic is
        }
        self.live[8..16].copy_from_slice(&trace.to_le_bytes());
        let step = (read_i32(&self.live, 16) + 1) % STEPS;
        self.live[16..20].copy_from_slice(&step.to_le_bytes());
        let padding = self.live.len() - STATE_BYTES;
        if padding > 0 {
            let at = STATE_BYTES + (count as usize * 7) % padding;
            self.live[at] = self.live[at].wrapping_add(1);
        }
        self.outputs[0] = 1;
        self.outputs[1..9].copy_from_slice(&count.to_le_bytes());
        self.checkpoint[STATE..].copy_from_slice(&self.live);
        Ok(())
    }

    fn deserialize(&mut self) {
        self.live.copy_from_slice(&self.checkpoint[STATE..]);
    }

    /// A step of an action; whether it has ended.
    fn action(&mut self, action: u16) -> Result<bool, TrapInfo> {
        if self.inputs[0] == TRAP_ALWAYS {
            return Err(trap("RecoverModel", "index out of range"));
        }
        let count = read_i32(&self.checkpoint, ACTION_COUNT) + 1;
        write_i32(&mut self.checkpoint, ACTION_COUNT, count);
        self.outputs[0] = 100 + action as u8;
        Ok(count >= ACTION_SCANS)
    }
}

impl McRuntime for ModelMc {
    /// The generated Control program's three shapes: direct, checkpoint recovery, safe stop.
    fn scan(&mut self, mc_time_us: u64) -> Result<(), TrapInfo> {
        let active = read_i32(&self.checkpoint, IS_ACTIVE) != 0;
        let was = read_i32(&self.checkpoint, WAS_ACTIVE) != 0;
        if active && was {
            return self.program(mc_time_us);
        }
        if active {
            match read_i32(&self.checkpoint, RECOVERY) as u16 {
                0 => {
                    self.deserialize();
                    self.program(mc_time_us)?;
                    write_i32(&mut self.checkpoint, WAS_ACTIVE, 1);
                }
                action @ (CARRY | ONCE) => {
                    if self.action(action)? {
                        self.deserialize();
                        // the checkpoint state of both intervals: the round begins anew
                        self.live[16..20].copy_from_slice(&0i32.to_le_bytes());
                        self.program(mc_time_us)?;
                        write_i32(&mut self.checkpoint, WAS_ACTIVE, 1);
                        write_i32(&mut self.checkpoint, RECOVERY, 0);
                    }
                }
                action => {
                    if self.action(action)? {
                        write_i32(&mut self.checkpoint, RECOVERY, 0);
                        write_i32(&mut self.checkpoint, IS_ACTIVE, 0);
                    }
                }
            }
            return Ok(());
        }
        write_i32(&mut self.checkpoint, WAS_ACTIVE, 0);
        Ok(())
    }

    fn checkpoint(&self) -> &[u8] {
        &self.checkpoint
    }
    fn checkpoint_mut(&mut self) -> &mut [u8] {
        &mut self.checkpoint
    }
    fn inputs_mut(&mut self) -> &mut [u8] {
        &mut self.inputs
    }
    fn outputs(&self) -> &[u8] {
        &self.outputs
    }
    fn outputs_mut(&mut self) -> &mut [u8] {
        &mut self.outputs
    }
    fn reset(&mut self) {
        self.checkpoint.fill(0);
        self.live.fill(0);
        self.inputs.fill(0);
        self.outputs.fill(0);
    }
}

fn trap(pou: &str, message: &str) -> TrapInfo {
    TrapInfo {
        pou: pou.to_owned(),
        file: "model_mc".to_owned(),
        line: 1,
        message: message.to_owned(),
    }
}

fn read_u64(bytes: &[u8], at: usize) -> u64 {
    let mut word = [0; 8];
    word.copy_from_slice(&bytes[at..at + 8]);
    u64::from_le_bytes(word)
}

fn read_i32(bytes: &[u8], at: usize) -> i32 {
    let mut word = [0; 4];
    word.copy_from_slice(&bytes[at..at + 4]);
    i32::from_le_bytes(word)
}

fn write_i32(bytes: &mut [u8], at: usize, value: i32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}
