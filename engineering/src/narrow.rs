//! A state that its engineer has narrowed: which variables stay in it, and the bytes of the others in every checkpoint.
//!
//! All variables of an MC are state unless the model lists those that are. What it leaves out has its initial value in every
//! checkpoint, and so starts from there on another controller.

use crate::model::{Cell, McSpec};
use crate::problem::{Explain, suggestion};
use fam_soft_plc::diag::Diagnostic;
use fam_soft_plc::layout::{Area, Layout, VariableInfo};
use std::ops::Range;

/// Most names in a warning.
const NAMES_MAX: usize = 8;

/// Places of the serialized state that are always initial, in order; empty if everything is state.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Narrowed {
    /// Offset and bytes.
    pub places: Vec<(u32, Vec<u8>)>,
}

impl Narrowed {
    /// Whether a byte belongs to a variable that is no state.
    #[must_use]
    pub fn contains(&self, offset: u32) -> bool {
        self.places
            .iter()
            .any(|(at, bytes)| (*at..at + bytes.len() as u32).contains(&offset))
    }
}

/// What the model's list leaves out.
pub fn narrowed(
    cell: &Cell,
    mc: &McSpec,
    layout: &Layout,
    state: usize,
    problems: &mut Vec<Diagnostic>,
) -> Narrowed {
    let Some(list) = &mc.state else {
        return Narrowed::default();
    };
    let mut kept: Vec<Range<u32>> = Vec::new();
    for name in list {
        let text = name.get_ref();
        let inner = format!("{}.{text}", mc.program.get_ref());
        let found = [inner.as_str(), text.as_str()]
            .into_iter()
            .filter_map(|path| layout.find(path))
            .find(|v| v.area == Area::Region(state));
        match found {
            Some(variable) => kept.push(variable.offset..variable.offset + variable.len),
            None => {
                let prefix = format!("{}.", mc.program.get_ref());
                let known: Vec<&str> = layout
                    .roots
                    .iter()
                    .filter(|v| v.area == Area::Region(state))
                    .map(|v| v.path.strip_prefix(&prefix).unwrap_or(&v.path))
                    .collect();
                problems.push(
                    cell.text
                        .error(
                            "M513",
                            name.span(),
                            format!(
                                "MC {}: its state lists `{text}`, which it does not have",
                                mc.mc
                            ),
                        )
                        .hint(suggestion(text, known)),
                );
            }
        }
    }
    let is_kept = |v: &VariableInfo| {
        kept.iter()
            .any(|k| k.start <= v.offset && v.offset + v.len <= k.end)
    };
    let left: Vec<&VariableInfo> = layout
        .variables
        .iter()
        .filter(|v| v.area == Area::Region(state) && !is_kept(v))
        .collect();
    if let Some(first) = list.first()
        && !left.is_empty()
    {
        let mut names: Vec<&str> = left
            .iter()
            .take(NAMES_MAX)
            .map(|v| v.path.as_str())
            .collect();
        if left.len() > NAMES_MAX {
            names.push("...");
        }
        let message = format!(
            "MC {}: {} of its variables are no state: {}",
            mc.mc,
            left.len(),
            names.join(", ")
        );
        problems.push(
            cell.text
                .warning("W808", first.span(), message)
                .hint("on another controller they start from their initial values; leave out the list to keep everything"),
        );
    }
    let initial = &layout.initial[state];
    let places = left
        .iter()
        .filter_map(|v| {
            let bytes = initial.get(v.offset as usize..(v.offset + v.len) as usize)?;
            Some((v.offset, bytes.to_vec()))
        })
        .collect();
    Narrowed { places }
}
