//! A cell and its MCs, ready to run.

use crate::control::ControlLayout;
use crate::generate::REGION_CHECKPOINT;
use fam_proto::McId;
use fam_proto::diagnosis::Diagnosis;
use fam_proto::model::CellModel;
use fam_soft_plc::CompiledMc;
use fam_soft_plc::diag::Diagnostic;
use fam_soft_plc::layout::TypeNode;
use fam_soft_plc::source::SourceFile;

/// A cell, ready to run.
#[derive(Debug, Clone)]
pub struct BuiltCell {
    /// What all processes read.
    pub model: CellModel,
    /// MCs, in the order of `model.mcs`.
    pub mcs: Vec<BuiltMc>,
    /// What is worth a look, but stops nothing.
    pub warnings: Vec<Diagnostic>,
}

impl BuiltCell {
    /// An MC.
    #[must_use]
    pub fn mc(&self, mc: &McId) -> Option<&BuiltMc> {
        self.mcs.iter().find(|m| &m.mc == mc)
    }
}

/// An MC, ready to run.
#[derive(Debug, Clone)]
pub struct BuiltMc {
    /// Its name.
    pub mc: McId,
    /// Its main PROGRAM.
    pub program: String,
    /// Its cycle, in microseconds.
    pub cycle_us: u32,
    /// The module: entry is `<MC>_Control`; regions `checkpoint`, `state`, `work`.
    pub compiled: CompiledMc,
    /// Where the control variables lie in the checkpoint.
    pub control: ControlLayout,
    /// Checkpoint of an MC without history: all variables at their initial values.
    pub initial_checkpoint: Vec<u8>,
    /// Masks and actions.
    pub diagnosis: Diagnosis,
    /// Intervals as people wrote them, in the order of `diagnosis.intervals`.
    pub intervals: Vec<IntervalText>,
    /// Variables of the serialized state, arrays whole.
    pub state_variables: Vec<StateVariable>,
    /// All sources, the generated one last.
    pub sources: Vec<SourceFile>,
    /// ST of the three generated POUs.
    pub control_st: String,
}

/// A critical interval for the diagnosis file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IntervalText {
    /// Condition in ST.
    pub condition: String,
    /// Checkpoint state: variable and value as text.
    pub checkpoint_state: Vec<(String, String)>,
}

/// A variable of the serialized state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateVariable {
    /// Dotted path, such as `Station1.timer.ET`.
    pub path: String,
    /// Type as ST writes it.
    pub type_name: String,
    /// Offset in the serialized state, in bytes.
    pub offset: u32,
    /// Whether a warm reset keeps it.
    pub retain: bool,
    /// Bytes that it takes.
    pub len: u32,
}

impl BuiltMc {
    /// Number of the region `checkpoint` in the module's layout.
    #[must_use]
    pub fn checkpoint_region(&self) -> usize {
        self.compiled
            .layout
            .region_index(REGION_CHECKPOINT)
            .unwrap_or(0)
    }

    /// Checkpoint for a warm reset: initial values, but retained variables as in `last`.
    #[must_use]
    pub fn warm_checkpoint(&self, last: &[u8]) -> Vec<u8> {
        let mut checkpoint = self.initial_checkpoint.clone();
        if last.len() != checkpoint.len() {
            return checkpoint;
        }
        for variable in self.state_variables.iter().filter(|v| v.retain) {
            let from = (self.control.state.start + variable.offset) as usize;
            let range = from..from + variable.len as usize;
            if let (Some(target), Some(source)) =
                (checkpoint.get_mut(range.clone()), last.get(range))
            {
                target.copy_from_slice(source);
            }
        }
        checkpoint
    }
}

pub(crate) fn type_name(node: &TypeNode) -> String {
    match node {
        TypeNode::Elem(elem) => elem.name().to_owned(),
        TypeNode::Enum { name, base, values } if name.is_empty() => {
            let names: Vec<&str> = values.iter().map(|(n, _)| n.as_str()).collect();
            format!("{base} ({})", names.join(", "))
        }
        TypeNode::Enum { name, .. } | TypeNode::Struct { name, .. } => name.clone(),
        TypeNode::Subrange { base, lo, hi } => format!("{base} ({lo}..{hi})"),
        TypeNode::Text { wide, len } => {
            format!("{}[{len}]", if *wide { "WSTRING" } else { "STRING" })
        }
        TypeNode::Array { dims, elem, .. } => {
            let dims: Vec<String> = dims.iter().map(|(lo, hi)| format!("{lo}..{hi}")).collect();
            format!("ARRAY[{}] OF {}", dims.join(", "), type_name(elem))
        }
    }
}
