//! Masks over a serialized state, and the decision that they lead to (diagnosis file of an MC).
//!
//! A critical interval's condition is a disjunctive normal form over the serialized state: the interval holds if all
//! masks of at least one row hold. The MC Agent and the scan thread evaluate exactly these bytes; both read no variables.

use serde::{Deserialize, Serialize};

/// Elementary type of a masked variable, in the state's byte order (little endian).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskType {
    /// Unsigned, 1, 2, 4 or 8 bytes (also BOOL and bit strings).
    Unsigned(u8),
    /// Signed, 1, 2, 4 or 8 bytes.
    Signed(u8),
    /// REAL (4) or LREAL (8).
    Real(u8),
}

impl MaskType {
    /// Width in bytes.
    #[must_use]
    pub fn bytes(self) -> usize {
        match self {
            MaskType::Unsigned(n) | MaskType::Signed(n) | MaskType::Real(n) => n as usize,
        }
    }
}

/// Comparison of a mask.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskOperator {
    Equal,
    NotEqual,
    Less,
    LessOrEqual,
    Greater,
    GreaterOrEqual,
}

/// A variable in the serialized state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct MaskVariable {
    /// Offset in the serialized state, in bytes.
    pub offset: u32,
    /// Its type.
    pub of: MaskType,
}

/// Right-hand side of a mask.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskOperand {
    /// An integer constant.
    Integer(i128),
    /// A real constant, as the bits of an LREAL (so that masks compare and hash).
    RealBits(u64),
    /// Another variable.
    Variable(MaskVariable),
}

/// One comparison over the serialized state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Mask {
    /// Left-hand side.
    pub left: MaskVariable,
    /// Bits of the left-hand side that count (all ones for a whole variable; integers only).
    pub bits: u64,
    /// Comparison.
    pub operator: MaskOperator,
    /// Right-hand side.
    pub right: MaskOperand,
}

/// How an interruption in a critical interval is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum IntervalKind {
    /// A recovery action leads back to the checkpoint state, then normal logic goes on.
    Checkpoint,
    /// No way back: the action stops the MC safely.
    Unrecoverable,
}

/// A critical interval.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct CriticalInterval {
    /// Its name.
    pub name: String,
    /// Rows of masks: any row whose masks all hold makes the interval hold.
    pub rows: Vec<Vec<Mask>>,
    /// Kind.
    pub kind: IntervalKind,
    /// Value of `recoveryAction` that runs its action; unique in the MC, at least 1.
    pub action: u16,
    /// POU of the action.
    pub pou: String,
    /// Whether an interrupted action may be gone on with on another controller.
    pub repeatable: bool,
}

/// Where the control variables lie in a checkpoint, and what to make of the rest: all that an MC Agent knows of its MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Diagnosis {
    /// Offset of the serialized state in the checkpoint, in bytes (control variables and actions lie before it).
    pub state_offset: u32,
    /// Length of the checkpoint, in bytes.
    pub checkpoint_len: u32,
    /// Critical intervals, in the order of the model.
    pub intervals: Vec<CriticalInterval>,
    /// Value of `recoveryAction` that runs the stop POU; `None` if the MC has none.
    pub stop_action: Option<u16>,
}

/// What the MC Agent decides on a state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Recovery<'a> {
    /// No critical interval holds: go on from the state.
    Direct,
    /// Lead the process back with the interval's action first.
    Checkpoint(&'a CriticalInterval),
    /// Stop safely with the interval's action.
    SafeStop(&'a CriticalInterval),
}

impl Diagnosis {
    /// The first critical interval that holds in a checkpoint. A checkpoint of another length is in none (callers check the layout first).
    #[must_use]
    pub fn critical_interval(&self, checkpoint: &[u8]) -> Option<&CriticalInterval> {
        let state = checkpoint.get(self.state_offset as usize..)?;
        self.intervals.iter().find(|i| i.holds(state))
    }

    /// What an interruption in this checkpoint has to be answered with.
    #[must_use]
    pub fn recovery(&self, checkpoint: &[u8]) -> Recovery<'_> {
        match self.critical_interval(checkpoint) {
            None => Recovery::Direct,
            Some(i) if i.kind == IntervalKind::Checkpoint => Recovery::Checkpoint(i),
            Some(i) => Recovery::SafeStop(i),
        }
    }

    /// The interval whose action has this number.
    #[must_use]
    pub fn interval_of_action(&self, action: u16) -> Option<&CriticalInterval> {
        self.intervals.iter().find(|i| i.action == action)
    }
}

impl CriticalInterval {
    /// Whether the interval holds in a serialized state.
    #[must_use]
    pub fn holds(&self, state: &[u8]) -> bool {
        self.rows
            .iter()
            .any(|row| row.iter().all(|mask| mask.holds(state)))
    }
}

impl Mask {
    /// Whether the comparison holds; `false` if a variable lies outside the state.
    #[must_use]
    pub fn holds(&self, state: &[u8]) -> bool {
        let Some(mut left) = self.left.read(state) else {
            return false;
        };
        if let Value::Integer(value) = &mut left
            && self.bits != u64::MAX
        {
            *value = i128::from((*value as u64) & self.bits);
        }
        let right = match self.right {
            MaskOperand::Integer(value) => Value::Integer(value),
            MaskOperand::RealBits(bits) => Value::Real(f64::from_bits(bits)),
            MaskOperand::Variable(variable) => match variable.read(state) {
                Some(value) => value,
                None => return false,
            },
        };
        let order = left.compare(right);
        use std::cmp::Ordering::{Equal, Greater, Less};
        match self.operator {
            MaskOperator::Equal => order == Some(Equal),
            MaskOperator::NotEqual => order != Some(Equal),
            MaskOperator::Less => order == Some(Less),
            MaskOperator::LessOrEqual => matches!(order, Some(Less | Equal)),
            MaskOperator::Greater => order == Some(Greater),
            MaskOperator::GreaterOrEqual => matches!(order, Some(Greater | Equal)),
        }
    }
}

#[derive(Clone, Copy)]
enum Value {
    Integer(i128),
    Real(f64),
}

impl Value {
    /// `None` where one side is NaN.
    #[allow(clippy::cast_precision_loss)] // an integer against a real is compared as LREAL, as the compiler widens it
    fn compare(self, other: Value) -> Option<std::cmp::Ordering> {
        match (self, other) {
            (Value::Integer(a), Value::Integer(b)) => Some(a.cmp(&b)),
            (Value::Real(a), Value::Real(b)) => a.partial_cmp(&b),
            (Value::Integer(a), Value::Real(b)) => (a as f64).partial_cmp(&b),
            (Value::Real(a), Value::Integer(b)) => a.partial_cmp(&(b as f64)),
        }
    }
}

impl MaskVariable {
    fn read(self, state: &[u8]) -> Option<Value> {
        let width = self.of.bytes();
        if !(1..=8).contains(&width) {
            return None; // no type of ours
        }
        let from = self.offset as usize;
        let bytes = state.get(from..from.checked_add(width)?)?;
        let mut wide = [0; 8];
        wide.get_mut(..width)?.copy_from_slice(bytes);
        let raw = u64::from_le_bytes(wide);
        Some(match self.of {
            MaskType::Unsigned(_) => Value::Integer(i128::from(raw)),
            MaskType::Signed(n) => {
                let shift = 64 - 8 * u32::from(n);
                Value::Integer(i128::from((raw << shift).cast_signed() >> shift))
            }
            MaskType::Real(4) => Value::Real(f64::from(f32::from_bits(raw as u32))),
            MaskType::Real(_) => Value::Real(f64::from_bits(raw)),
        })
    }
}
