//! Two versions of a cell: what changed for which MC, and how the state of a changed one is carried over.
//!
//! State is carried over by name and type: a variable of the new version takes its bytes from the variable of the same path
//! and the same type in the old one; what is new, or of another type, starts from its initial value; what is gone is left
//! behind; references start from their initial values, as addresses of the old version mean nothing in the new one. All of
//! that is listed, so that a person can confirm it before anything happens.
//!
//! Whoever reloads a running cell: [`compare`] tells what to show and what to ask; for each [`McChange::Changed`], stop the MC at a
//! state that [`carry_over`] takes (not critical, no recovery under way), and start the new version from what it gives.

use crate::build::{BuiltCell, BuiltMc};
use crate::changes::{self, Difference};
use fam_proto::McId;
use fam_proto::model::McModel;
use fam_soft_plc::Elem;
use fam_soft_plc::layout::{Area, FieldNode, TypeNode, VariableInfo};
use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;

/// What becomes of the state of an MC.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct StateChange {
    /// Variables that keep their values.
    pub kept: usize,
    /// Variables that only the new version has.
    pub new: Vec<String>,
    /// Variables that only the old version has.
    pub gone: Vec<String>,
    /// Variables of another type: path, old and new type.
    pub retyped: Vec<(String, String, String)>,
    /// References, in variables that both versions have: an address of the old version means nothing in the new one.
    pub references: Vec<String>,
    /// Whether the layout is the same to the byte.
    pub same_layout: bool,
}

impl StateChange {
    /// Whether no value is lost and none is new.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.new.is_empty()
            && self.gone.is_empty()
            && self.retyped.is_empty()
            && self.references.is_empty()
    }
}

/// What changed for an MC.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum McChange {
    /// Only the new version has it.
    Added,
    /// Only the old version has it.
    Removed,
    /// Runs on untouched: logic, layout, masks, inputs and outputs are the same.
    Same,
    /// The MC itself is the same; where it may run or how it is watched is not.
    Settings(Vec<Difference>),
    /// Stopped at a non-critical state, carried over and started.
    Changed {
        /// What changed.
        what: Vec<Difference>,
        /// What becomes of its state.
        state: StateChange,
    },
}

/// What changed between two versions of a cell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellChange {
    /// MCs of both versions.
    pub mcs: BTreeMap<McId, McChange>,
    /// Controllers and gateways, settings, the cell itself: one sentence each.
    pub cell: Vec<String>,
}

/// Compares two versions.
#[must_use]
pub fn compare(old: &BuiltCell, new: &BuiltCell) -> CellChange {
    let mut mcs = BTreeMap::new();
    for (model, built) in old.model.mcs.iter().zip(&old.mcs) {
        let change = match (new.model.mc(&model.mc), new.mc(&model.mc)) {
            (Some(new_model), Some(new_built)) => mc_change((model, built), (new_model, new_built)),
            _ => McChange::Removed,
        };
        mcs.insert(model.mc.clone(), change);
    }
    for mc in &new.mcs {
        mcs.entry(mc.mc.clone()).or_insert(McChange::Added);
    }
    CellChange {
        mcs,
        cell: cell_changes(old, new),
    }
}

fn cell_changes(old: &BuiltCell, new: &BuiltCell) -> Vec<String> {
    let (old, new) = (&old.model, &new.model);
    let mut list = Vec::new();
    if old.cell != new.cell {
        list.push(format!(
            "the cell is called {} instead of {}",
            new.cell, old.cell
        ));
    }
    list.extend(parts(
        "controller",
        (&old.controllers, &new.controllers),
        |c| c.controller.as_str(),
        changes::controller,
    ));
    list.extend(parts(
        "gateway",
        (&old.gateways, &new.gateways),
        |g| g.gateway.as_str(),
        changes::gateway,
    ));
    if old.settings != new.settings {
        list.push("the settings of the agents are others".to_owned());
    }
    list
}

/// What became of controllers or gateways.
fn parts<T: PartialEq>(
    what: &str,
    (old, new): (&[T], &[T]),
    name: impl Fn(&T) -> &str,
    differences: impl Fn(&T, &T) -> Vec<Difference>,
) -> Vec<String> {
    let mut list = Vec::new();
    for part in old {
        match new.iter().find(|other| name(other) == name(part)) {
            None => list.push(format!("{what} {} is gone", name(part))),
            Some(other) if other != part => {
                let how = changes::line(&differences(part, other));
                list.push(format!("{what} {} is another: {how}", name(part)));
            }
            Some(_) => {}
        }
    }
    let is_new = |part: &&T| old.iter().all(|other| name(other) != name(part));
    let added = new.iter().filter(is_new);
    list.extend(added.map(|part| format!("{what} {} is new", name(part))));
    list
}

fn mc_change(old: (&McModel, &BuiltMc), new: (&McModel, &BuiltMc)) -> McChange {
    let what = changes::mc(old, new);
    if !what.is_empty() {
        let state = state_change(old.1, new.1);
        return McChange::Changed { what, state };
    }
    let settings = changes::mc_settings(old.0, new.0);
    if settings.is_empty() {
        McChange::Same
    } else {
        McChange::Settings(settings)
    }
}

/// The variables of an MC's state, arrays whole.
fn state_of(mc: &BuiltMc) -> impl Iterator<Item = &VariableInfo> {
    let layout = &mc.compiled.layout;
    let state = layout
        .region_index(crate::generate::REGION_STATE)
        .map(Area::Region);
    layout
        .variables
        .iter()
        .filter(move |v| Some(v.area) == state && !v.path.ends_with(TAG_END))
}

/// Hidden variable of instances of related function blocks.
const TAG: &str = "__TYPE";
pub(crate) const TAG_END: &str = ".__TYPE";

/// IEC names ignore case; the MC's own name stands in front of what its program declares.
fn key(variable: &VariableInfo) -> String {
    variable.path.to_ascii_uppercase()
}

/// What the compiler keeps in an instance of a function block to tell which one it is of: the new version's own stays.
fn is_tag(field: &FieldNode) -> bool {
    field.name == TAG
}

/// Whether a value is, or has in it, an address.
fn holds_address(ty: &TypeNode) -> bool {
    match ty {
        TypeNode::Array { elem, .. } => holds_address(elem),
        TypeNode::Struct { fields, .. } => fields.iter().any(|f| holds_address(&f.ty)),
        _ => ty.elem() == Some(Elem::Ref),
    }
}

/// What of an old checkpoint goes into a new one.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct KeptRanges {
    /// Ranges of the old one, and where each begins in the new one.
    pub copies: Vec<(Range<usize>, usize)>,
    /// Ranges of the new one that are zero: behind the end of a shorter string.
    pub zeros: Vec<Range<usize>>,
    /// BOOLs at %MX, which share their bytes: byte and mask of the old one, byte and mask of the new one.
    pub bits: Vec<((usize, u8), (usize, u8))>,
}

impl KeptRanges {
    fn copy(&mut self, from: Range<usize>, to: usize) {
        match self.copies.last_mut() {
            Some((range, at)) if range.end == from.start && *at + range.len() == to => {
                range.end = from.end;
            }
            _ => self.copies.push((from, to)),
        }
    }

    /// Brings a value over to a type that means the same ([`same_type`]). Addresses and tags stay as they are in the new one;
    /// addresses go along if the layout is the same.
    fn value(
        &mut self,
        (from, at): (&TypeNode, Range<usize>),
        (to, place): (&TypeNode, Range<usize>),
        same_layout: bool,
    ) {
        match (from, to) {
            (
                TypeNode::Array {
                    dims, elem, stride, ..
                },
                TypeNode::Array {
                    elem: to_elem,
                    stride: to_stride,
                    ..
                },
            ) => {
                let count = dims.iter().map(|(lo, hi)| hi - lo + 1).product::<i64>();
                let part = |begin: usize, stride: u32, n: usize| {
                    let stride = stride as usize;
                    begin + n * stride..begin + (n + 1) * stride
                };
                for n in 0..usize::try_from(count).unwrap_or(0) {
                    self.value(
                        (elem, part(at.start, *stride, n)),
                        (to_elem, part(place.start, *to_stride, n)),
                        same_layout,
                    );
                }
            }
            (TypeNode::Struct { fields, .. }, TypeNode::Struct { fields: others, .. }) => {
                let part = |begin: usize, f: &FieldNode| {
                    begin + f.offset as usize..begin + (f.offset + f.len) as usize
                };
                for (a, b) in fields.iter().zip(others).filter(|(a, _)| !is_tag(a)) {
                    self.value(
                        (&a.ty, part(at.start, a)),
                        (&b.ty, part(place.start, b)),
                        same_layout,
                    );
                }
            }
            _ if holds_address(from) && !same_layout => {}
            _ => {
                // A longer string has room for all of the shorter one's, and zeros behind it.
                let len = at.len().min(place.len());
                if len < place.len() {
                    self.zeros.push(place.start + len..place.end);
                }
                self.copy(at.start..at.start + len, place.start);
            }
        }
    }
}

/// Whether the bytes of one mean the same in the other.
fn same_type(a: &TypeNode, b: &TypeNode) -> bool {
    match (a, b) {
        (TypeNode::Elem(a), TypeNode::Elem(b)) => a == b,
        (
            TypeNode::Enum { base, values, .. },
            TypeNode::Enum {
                base: other_base,
                values: others,
                ..
            },
        ) => {
            // A value keeps its meaning if its name keeps its number; more values do no harm.
            base == other_base
                && values.iter().all(|(name, number)| {
                    others
                        .iter()
                        .any(|(n, v)| n.eq_ignore_ascii_case(name) && v == number)
                })
        }
        (
            TypeNode::Subrange { base, lo, hi },
            TypeNode::Subrange {
                base: b,
                lo: l,
                hi: h,
            },
        ) => base == b && l <= lo && hi <= h,
        (
            TypeNode::Text { wide, len },
            TypeNode::Text {
                wide: other_wide,
                len: other_len,
            },
        ) => wide == other_wide && len <= other_len,
        (
            TypeNode::Array { dims, elem, .. },
            TypeNode::Array {
                dims: other_dims,
                elem: other_elem,
                ..
            },
        ) => dims == other_dims && same_type(elem, other_elem),
        (TypeNode::Struct { fields, .. }, TypeNode::Struct { fields: others, .. }) => {
            fields.len() == others.len()
                && fields
                    .iter()
                    .zip(others)
                    .all(|(a, b)| a.name.eq_ignore_ascii_case(&b.name) && same_type(&a.ty, &b.ty))
        }
        _ => false,
    }
}

/// Whether the value of one variable can go to the other.
fn fits(from: &VariableInfo, to: &VariableInfo) -> bool {
    // Of arrays of bits the first has to be the same one of its byte.
    same_type(&from.ty, &to.ty) && (from.bit == to.bit || to.ty.elem() == Some(Elem::Bool))
}

/// What becomes of the state of an MC.
#[must_use]
pub fn state_change(old: &BuiltMc, new: &BuiltMc) -> StateChange {
    let before: BTreeMap<String, &VariableInfo> = state_of(old).map(|v| (key(v), v)).collect();
    let mut change = StateChange {
        same_layout: old.compiled.layout.hash() == new.compiled.layout.hash(),
        ..StateChange::default()
    };
    let mut found = std::collections::BTreeSet::new();
    for variable in state_of(new) {
        let key = key(variable);
        match before.get(&key) {
            None => change.new.push(variable.path.clone()),
            Some(old) if fits(old, variable) => {
                if holds_address(&variable.ty) && !change.same_layout {
                    change.references.push(variable.path.clone());
                } else {
                    change.kept += 1;
                }
            }
            Some(old) => change.retyped.push((
                variable.path.clone(),
                crate::build::type_name(&old.ty),
                crate::build::type_name(&variable.ty),
            )),
        }
        found.insert(key);
    }
    change.gone = before
        .iter()
        .filter(|(key, _)| !found.contains(*key))
        .map(|(_, v)| v.path.clone())
        .collect();
    change
}

/// Why a state cannot be carried over.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CarryError {
    /// Not a checkpoint of the old version.
    #[error(
        "the checkpoint has {found} bytes, one of the old version has {expected}; read it from the controller that runs the MC"
    )]
    Length {
        /// Its length.
        found: usize,
        /// Length of the old version's.
        expected: usize,
    },
    /// In a critical interval or a recovery nobody may exchange the logic.
    #[error("the state is in the critical interval {0}; wait until the MC has left it")]
    Critical(String),
    /// A recovery action runs.
    #[error("a recovery action runs (number {0}); wait until it has ended")]
    Recovering(u16),
}

/// What a new checkpoint takes over from an old one: the variables of the same path and of a type that means the same.
#[must_use]
pub fn kept_ranges(old: &BuiltMc, new: &BuiltMc) -> KeptRanges {
    let before: BTreeMap<String, &VariableInfo> = state_of(old).map(|v| (key(v), v)).collect();
    let same_layout = old.compiled.layout.hash() == new.compiled.layout.hash();
    let mut kept = KeptRanges::default();
    let place = |state: u32, v: &VariableInfo| {
        let begin = (state + v.offset) as usize;
        begin..begin + v.len as usize
    };
    for variable in state_of(new) {
        if let Some(source) = before.get(&key(variable))
            && fits(source, variable)
        {
            let (from, to) = (
                place(old.control.state.start, source),
                place(new.control.state.start, variable),
            );
            match (source.bit, variable.bit) {
                (None, None) => {}
                (bit, to_bit) if variable.ty.elem() == Some(Elem::Bool) => {
                    // One that does not share its byte is 0 or 1.
                    let mask = |bit: Option<u8>| 1 << bit.unwrap_or(0);
                    kept.bits
                        .push(((from.start, mask(bit)), (to.start, mask(to_bit))));
                    continue;
                }
                _ => {
                    kept.copy(from, to.start);
                    continue;
                }
            }
            kept.value((&source.ty, from), (&variable.ty, to), same_layout);
        }
    }
    kept
}

/// A checkpoint of the new version from one of the old: values by name and type, the rest initial. The control variables start
/// as those of an MC that is not active; its activation sets them.
///
/// # Errors
/// [`CarryError`] for a checkpoint of another layout, or one in a critical interval of the old version or of the new one.
pub fn carry_over(old: &BuiltMc, new: &BuiltMc, checkpoint: &[u8]) -> Result<Vec<u8>, CarryError> {
    let expected = old.initial_checkpoint.len();
    if checkpoint.len() != expected {
        return Err(CarryError::Length {
            found: checkpoint.len(),
            expected,
        });
    }
    if let Some(interval) = old.diagnosis.critical_interval(checkpoint) {
        return Err(CarryError::Critical(interval.name.clone()));
    }
    let action = old.control.read(checkpoint).recovery_action;
    if action != 0 {
        return Err(CarryError::Recovering(action));
    }
    let mut carried = new.initial_checkpoint.clone();
    let kept = kept_ranges(old, new);
    for range in kept.zeros {
        if let Some(target) = carried.get_mut(range) {
            target.fill(0);
        }
    }
    for (range, to) in kept.copies {
        let target = carried.get_mut(to..to + range.len());
        if let (Some(bytes), Some(target)) = (checkpoint.get(range), target) {
            target.copy_from_slice(bytes);
        }
    }
    for ((from, mask), (to, to_mask)) in kept.bits {
        if let (Some(byte), Some(target)) = (checkpoint.get(from), carried.get_mut(to)) {
            *target = *target & !to_mask | if byte & mask == 0 { 0 } else { to_mask };
        }
    }
    if let Some(interval) = new.diagnosis.critical_interval(&carried) {
        return Err(CarryError::Critical(interval.name.clone()));
    }
    Ok(carried)
}

impl fmt::Display for StateChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.same_layout {
            return write!(
                f,
                "state layout is the same: {} variables are kept",
                self.kept
            );
        }
        let word = if self.is_complete() {
            "state is compatible"
        } else {
            "state is compatible in part"
        };
        write!(f, "{word}: {} variables are kept", self.kept)?;
        for path in &self.new {
            write!(f, "\n    new, starts from its initial value: {path}")?;
        }
        for (path, old, new) in &self.retyped {
            write!(
                f,
                "\n    {new} instead of {old}, starts from its initial value: {path}"
            )?;
        }
        for path in &self.references {
            write!(
                f,
                "\n    a reference, starts from its initial value: {path}"
            )?;
        }
        for path in &self.gone {
            write!(f, "\n    gone: {path}")?;
        }
        Ok(())
    }
}

impl fmt::Display for CellChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for sentence in &self.cell {
            writeln!(f, "{sentence}")?;
        }
        for (mc, change) in &self.mcs {
            match change {
                McChange::Added => writeln!(f, "{mc}: new")?,
                McChange::Removed => writeln!(f, "{mc}: gone")?,
                McChange::Same => writeln!(f, "{mc}: the same, runs on untouched")?,
                McChange::Settings(what) => {
                    writeln!(
                        f,
                        "{mc}: runs on with other settings ({})",
                        changes::line(what)
                    )?;
                }
                McChange::Changed { what, state } => {
                    writeln!(f, "{mc}: changed ({}); {state}", changes::line(what))?;
                }
            }
        }
        Ok(())
    }
}
