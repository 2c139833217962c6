//! Critical intervals of an MC: masks of their conditions, checkpoint states, and whether two of them contradict each other.

use crate::generate::Overlay;
use crate::logic::Logic;
use crate::masks::satisfy::{Satisfiable, satisfiable};
use crate::masks::{Locate, masks};
use crate::model::{Cell, IntervalSpec, McSpec};
use crate::problem::{Explain, ModelText};
use crate::values::st_value;
use fam_proto::diagnosis::{IntervalKind, Mask};
use fam_soft_plc::check::check_expression;
use fam_soft_plc::check::tree::{ExprKind, Root};
use fam_soft_plc::diag::Diagnostic;
use std::ops::Range;
use toml::Spanned;

/// An interval with its masks.
#[derive(Debug, Clone, PartialEq)]
pub struct Interval {
    /// Rows of masks, offsets relative to the serialized state.
    pub rows: Vec<Vec<Mask>>,
    /// Checkpoint state.
    pub overlay: Vec<Overlay>,
}

/// What of an MC is state.
#[derive(Clone, Copy)]
pub struct State<'a> {
    /// Where a single value lies.
    pub locate: Locate<'a>,
    /// Whether a variable, of whatever type, is state.
    pub contains: &'a dyn Fn(&str) -> bool,
    /// The state at its initial values.
    pub initial: &'a [u8],
}

/// Works out all intervals of an MC. `None` for one that is wrong.
pub fn intervals(
    cell: &Cell,
    mc: &McSpec,
    logic: &Logic,
    state: State<'_>,
    problems: &mut Vec<Diagnostic>,
) -> Vec<Option<Interval>> {
    let found: Vec<Option<Interval>> = mc
        .intervals
        .iter()
        .map(|spec| interval(cell, mc, spec, logic, state, problems))
        .collect();
    overlaps(cell, mc, &found, problems);
    for (spec, interval) in mc.intervals.iter().zip(&found) {
        let Some(interval) = interval else { continue };
        let what = format!("critical interval {} of MC {}", spec.name.get_ref(), mc.mc);
        if interval.rows.is_empty() {
            problems.push(
                cell.text
                    .error(
                        "M508",
                        spec.condition.span(),
                        format!("{what}: the condition can never hold"),
                    )
                    .hint("correct it, or remove the interval"),
            );
            continue;
        }
        // Where the condition does not hold; unknown if that grows too large.
        let otherwise = rows_of(
            mc,
            logic,
            state.locate,
            &format!("NOT ({})", spec.condition.get_ref()),
        );
        let leads_back = || {
            let after = checkpoint(mc, spec, interval, logic, state.locate);
            !after.is_empty()
                && otherwise
                    .as_ref()
                    .is_some_and(|rows| overlap(rows, &[after]) == Satisfiable::No)
        };
        let always = otherwise.as_ref().is_some_and(Vec::is_empty);
        if always || interval.rows.iter().any(Vec::is_empty) {
            problems.push(
                cell.text
                    .warning("W803", spec.condition.span(), format!("{what}: the condition always holds"))
                    .hint("the MC can never be moved as planned, and every interruption runs the action"),
            );
            continue;
        }
        if interval
            .rows
            .iter()
            .any(|row| row.iter().all(|m| m.holds(state.initial)))
        {
            problems.push(
                cell.text
                    .warning(
                        "W804",
                        spec.condition.span(),
                        format!("{what}: the initial state is critical"),
                    )
                    .hint("an MC usually starts where its process is known"),
            );
        }
        if leads_back() {
            problems.push(
                cell.text
                    .warning(
                        "W814",
                        spec.condition.span(),
                        format!("{what}: the checkpoint state is critical itself"),
                    )
                    .expected("a checkpoint state outside of the interval, from which the normal logic goes on")
                    .hint("correct the checkpoint state or the condition: after its recovery the MC would stand in the interval again"),
            );
        }
    }
    found
}

fn interval(
    cell: &Cell,
    mc: &McSpec,
    spec: &IntervalSpec,
    logic: &Logic,
    state: State<'_>,
    problems: &mut Vec<Diagnostic>,
) -> Option<Interval> {
    let what = format!("critical interval {} of MC {}", spec.name.get_ref(), mc.mc);
    let rows = match rows(cell, mc, spec, &what, logic, state.locate) {
        Ok(rows) => Some(rows),
        Err(found) => {
            problems.extend(found);
            None
        }
    };
    let mut overlay = Vec::new();
    let mut complete = true;
    for (name, value) in &spec.checkpoint_state {
        match one_overlay(cell, mc, &what, name, value, logic, state.contains) {
            Ok(found) => overlay.push(found),
            Err(problem) => {
                problems.push(*problem);
                complete = false;
            }
        }
    }
    Some(Interval {
        rows: rows.filter(|_| complete)?,
        overlay,
    })
}

/// Rows of a condition that is known to be good, `None` if masks cannot say it.
fn rows_of(mc: &McSpec, logic: &Logic, locate: Locate<'_>, text: &str) -> Option<Vec<Vec<Mask>>> {
    let program = Some(mc.program.get_ref().as_str());
    let expr = check_expression(&logic.typed, program, "", text).ok()?;
    masks(&logic.typed, &expr, locate).ok()
}

/// What the checkpoint state says, each variable as a mask.
fn checkpoint(
    mc: &McSpec,
    spec: &IntervalSpec,
    interval: &Interval,
    logic: &Logic,
    locate: Locate<'_>,
) -> Vec<Mask> {
    spec.checkpoint_state
        .iter()
        .zip(&interval.overlay)
        .filter_map(|((name, _), overlay)| {
            let equals = format!("{} = {}", name.get_ref(), overlay.value);
            let rows = rows_of(mc, logic, locate, &equals)?;
            <[Vec<Mask>; 1]>::try_from(rows).ok()
        })
        .flat_map(|[row]| row)
        .collect()
}

fn rows(
    cell: &Cell,
    mc: &McSpec,
    spec: &IntervalSpec,
    what: &str,
    logic: &Logic,
    locate: Locate<'_>,
) -> Result<Vec<Vec<Mask>>, Vec<Diagnostic>> {
    let text = spec.condition.get_ref();
    let checked = check_expression(&logic.typed, Some(mc.program.get_ref()), "", text);
    let expr = checked.map_err(|found| {
        found
            .into_iter()
            .map(|d| {
                let at = place_in(
                    &cell.text,
                    &spec.condition,
                    char_offset(text, d.line, d.column),
                    d.len as usize,
                );
                Diagnostic {
                    expected: d.expected,
                    hint: d.hint,
                    ..cell
                        .text
                        .error("M507", at, format!("{what}: {}", d.message))
                }
            })
            .collect::<Vec<_>>()
    })?;
    masks(&logic.typed, &expr, locate).map_err(|e| {
        let len = (e.span.end - e.span.start) as usize;
        let at = place_in(&cell.text, &spec.condition, e.span.start as usize, len);
        vec![
            cell.text
                .error("M507", at, format!("{what}: {}", e.message))
                .hint(e.hint),
        ]
    })
}

/// Byte offset of a line and column, both from 1.
fn char_offset(text: &str, line: u32, column: u32) -> usize {
    let start: usize = text
        .split_inclusive('\n')
        .take((line as usize).saturating_sub(1))
        .map(str::len)
        .sum();
    text[start..]
        .char_indices()
        .nth((column as usize).saturating_sub(1))
        .map_or(text.len(), |(i, _)| start + i)
}

/// A part of a string value in the file; the whole string if it does not stand there letter by letter.
fn place_in(file: &ModelText, value: &Spanned<String>, at: usize, len: usize) -> Range<usize> {
    let span = value.span();
    let written = file.text.get(span.clone()).unwrap_or("");
    match written.find(value.get_ref().as_str()) {
        Some(quote) if at < value.get_ref().len() => {
            let start = span.start + quote + at;
            start..(start + len.max(1)).min(span.end)
        }
        _ => span,
    }
}

fn one_overlay(
    cell: &Cell,
    mc: &McSpec,
    what: &str,
    name: &Spanned<String>,
    given: &Spanned<toml::Value>,
    logic: &Logic,
    is_state: &dyn Fn(&str) -> bool,
) -> Result<Overlay, Box<Diagnostic>> {
    let typed = &logic.typed;
    let error = |at: Range<usize>, message: String| Box::new(cell.text.error("M509", at, message));
    let checked = check_expression(typed, Some(mc.program.get_ref()), "", name.get_ref());
    let expr = checked.map_err(|found| {
        let why = found.first().map_or(String::new(), |d| d.message.clone());
        let hint = found.first().and_then(|d| d.hint.clone());
        let mut problem = error(name.span(), format!("{what}: checkpoint state: {why}"));
        problem.hint = hint;
        problem
    })?;
    let not_state = || {
        Box::new(
            error(
                name.span(),
                format!(
                    "{what}: checkpoint state: `{}` is not part of the state",
                    name.get_ref()
                ),
            )
            .hint(crate::masks::IS_STATE),
        )
    };
    let ExprKind::Load(place) = &expr.kind else {
        return Err(not_state());
    };
    let path = typed.path_of(place).ok_or_else(not_state)?;
    let global = match &place.root {
        Root::Var(id) if typed.var(*id).location.is_none() => {
            let var = typed.var(*id);
            var.owner
                .is_none()
                .then(|| (var.name.clone(), typed.type_name(var.ty)))
        }
        _ => return Err(not_state()),
    };
    let value = st_value(typed, mc.program.get_ref(), place.ty, given.get_ref()).map_err(|e| {
        Box::new(
            error(
                given.span(),
                format!(
                    "{what}: checkpoint state of `{}`: {}",
                    name.get_ref(),
                    e.message
                ),
            )
            .expected(e.expected),
        )
    })?;
    if !is_state(&path) {
        return Err(not_state());
    }
    Ok(Overlay {
        path,
        global,
        value,
    })
}

/// Two intervals that hold for one state must not ask for different recoveries.
fn overlaps(cell: &Cell, mc: &McSpec, found: &[Option<Interval>], problems: &mut Vec<Diagnostic>) {
    for (i, a) in found.iter().enumerate() {
        for (j, b) in found.iter().enumerate().skip(i + 1) {
            let (Some(a), Some(b)) = (a, b) else { continue };
            let (first, second) = (&mc.intervals[i], &mc.intervals[j]);
            if same_recovery(first, a, second, b) {
                continue;
            }
            let (one, two) = (first.name.get_ref(), second.name.get_ref());
            match overlap(&a.rows, &b.rows) {
                Satisfiable::No => {}
                Satisfiable::Yes => problems.push(
                    cell.text
                        .error(
                            "M510",
                            second.condition.span(),
                            format!(
                                "MC {}: the critical intervals {one} and {two} overlap, and their recoveries differ",
                                mc.mc
                            ),
                        )
                        .expected("conditions that exclude each other, or the same recovery for both")
                        .hint(format!("add to the condition of {two} what excludes {one}, such as `AND NOT (...)`")),
                ),
                Satisfiable::Unknown => problems.push(
                    cell.text
                        .warning(
                            "W805",
                            second.condition.span(),
                            format!(
                                "MC {}: it cannot be decided whether the critical intervals {one} and {two} overlap",
                                mc.mc
                            ),
                        )
                        .hint(format!("where both hold, the recovery of {one} is taken")),
                ),
            }
        }
    }
}

fn same_recovery(first: &IntervalSpec, a: &Interval, second: &IntervalSpec, b: &Interval) -> bool {
    let values = |i: &Interval| {
        i.overlay
            .iter()
            .map(|o| (o.path.clone(), o.value.clone()))
            .collect::<Vec<_>>()
    };
    first.kind == second.kind
        && first.repeatable == second.repeatable
        && first
            .recovery
            .get_ref()
            .eq_ignore_ascii_case(second.recovery.get_ref())
        && (first.kind == IntervalKind::Unrecoverable || values(a) == values(b))
}

fn overlap(a: &[Vec<Mask>], b: &[Vec<Mask>]) -> Satisfiable {
    let mut result = Satisfiable::No;
    for row in a {
        for other in b {
            let both: Vec<Mask> = row.iter().chain(other).copied().collect();
            match satisfiable(&both) {
                Satisfiable::Yes => return Satisfiable::Yes,
                Satisfiable::Unknown => result = Satisfiable::Unknown,
                Satisfiable::No => {}
            }
        }
    }
    result
}
