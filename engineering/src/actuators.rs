//! The design rule of generalized actuators (`deploy/lib/generalized_actuators.st`): each drive belongs to exactly one of them.
//!
//! It holds for MCs whose logic has such actuators, and for their outputs that go to the field. An output belongs to the
//! instance that gives it its value, by `=>` of its call or by an assignment from one of its outputs. Recovery actions and
//! stop POUs may write it: while they run, no actuator does.

use crate::model::{Cell, McSpec};
use crate::problem::Explain;
use fam_soft_plc::check::tree::{
    Expr, Place, Pou, PouId, Root, StepKind, StmtKind, TypedProject, VarId, visit_expr,
};
use fam_soft_plc::check::visit::{Node, visit};
use fam_soft_plc::diag::Diagnostic;
use fam_soft_plc::types::TypeKind;
use std::collections::{BTreeMap, BTreeSet};

/// Interface that all generalized actuators have.
pub const INTERFACE: &str = "IGeneralizedActuator";

/// Who gives an output its value.
#[derive(Debug, Default)]
struct Owners {
    actuators: BTreeSet<String>,
    /// POUs that write it without an actuator.
    others: BTreeSet<String>,
}

/// Reports drives that belong to no generalized actuator, to two, or to one beside which somebody else writes them.
pub fn check(cell: &Cell, mc: &McSpec, typed: &TypedProject, problems: &mut Vec<Diagnostic>) {
    let has_one = typed
        .vars
        .iter()
        .any(|v| matches!(typed.types.kind(v.ty), TypeKind::FunctionBlock(pou) if is_actuator(typed, *pou)));
    if !has_one {
        return;
    }
    let owners = owners(mc, typed);
    let none = Owners::default();
    for output in mc.outputs.iter().filter(|o| o.field.is_some()) {
        let name = output.name.get_ref();
        let Some(id) = typed.find_global(name) else {
            continue;
        };
        let Owners { actuators, others } = owners.get(&id).unwrap_or(&none);
        let list = |names: &BTreeSet<String>| -> String {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            names.join(" and ")
        };
        let (code, what, hint) = if actuators.len() > 1 {
            (
                "W811",
                format!(
                    "belongs to {} generalized actuators: {}",
                    actuators.len(),
                    list(actuators)
                ),
                "let one of them drive it, and the policy give it orders",
            )
        } else if actuators.is_empty() {
            (
                "W810",
                "belongs to no generalized actuator".to_owned(),
                "give it to one (`MotorPort => ...` of its call), so that its diagnosis covers it",
            )
        } else if !others.is_empty() {
            (
                "W811",
                format!(
                    "belongs to the generalized actuator {}, but {} writes it too",
                    list(actuators),
                    list(others)
                ),
                "only its actuator may drive it: give that an order",
            )
        } else {
            continue;
        };
        problems.push(
            cell.text
                .warning(
                    code,
                    output.name.span(),
                    format!("MC {}: the drive `{name}` {what}", mc.mc),
                )
                .hint(hint),
        );
    }
}

fn is_actuator(typed: &TypedProject, pou: PouId) -> bool {
    typed.pou(pou).implements.iter().any(|i| {
        typed.interfaces[i.0 as usize]
            .name
            .eq_ignore_ascii_case(INTERFACE)
    })
}

fn owners(mc: &McSpec, typed: &TypedProject) -> BTreeMap<VarId, Owners> {
    let mut owners: BTreeMap<VarId, Owners> = BTreeMap::new();
    let is_action = |pou: &Pou| {
        let actions = mc.intervals.iter().map(|i| &i.recovery).chain(&mc.stop);
        actions
            .map(|name| name.get_ref())
            .any(|name| name.eq_ignore_ascii_case(&pou.name))
    };
    for (number, pou) in typed.pous.iter().enumerate() {
        if pou.library || is_action(pou) {
            continue;
        }
        #[allow(clippy::cast_possible_truncation)] // as POUs are numbered
        let block = pou.instance_of.unwrap_or(PouId(number as u32));
        let inside = is_actuator(typed, block).then(|| typed.pou(block).name.clone());
        visit(&pou.body, &mut |node| {
            let Node::Stmt(stmt) = node else { return };
            match &stmt.kind {
                StmtKind::Assign(target, value) => {
                    if let Some(id) = driven(typed, target) {
                        let found = owners.entry(id).or_default();
                        match inside.clone().or_else(|| actuator_in(typed, value)) {
                            Some(name) => found.actuators.insert(name),
                            None => found.others.insert(pou.name.clone()),
                        };
                    }
                }
                StmtKind::Invoke(call) => {
                    let own = is_actuator(typed, call.pou)
                        .then(|| call.instance.as_ref().and_then(|i| typed.path_of(i)))
                        .flatten();
                    for (_, place, _) in &call.outputs {
                        if let Some(id) = driven(typed, place) {
                            let found = owners.entry(id).or_default();
                            match inside.clone().or_else(|| own.clone()) {
                                Some(name) => found.actuators.insert(name),
                                None => found.others.insert(pou.name.clone()),
                            };
                        }
                    }
                }
                _ => {}
            }
        });
    }
    owners
}

/// The located output that a place is, or is a part of.
fn driven(typed: &TypedProject, place: &Place) -> Option<VarId> {
    match place.root {
        Root::Var(id) => typed
            .var(id)
            .location
            .filter(|l| l.output && !l.memory)
            .map(|_| id),
        _ => None,
    }
}

/// The instance of an actuator from whose output a value is taken.
fn actuator_in(typed: &TypedProject, value: &Expr) -> Option<String> {
    let mut found = None;
    visit_expr(value, &mut |place| {
        let Root::Var(id) = place.root else { return };
        let is_output = matches!(
            place.steps.first().map(|s| &s.kind),
            Some(StepKind::Member(_))
        );
        let var = typed.var(id);
        if is_output
            && matches!(typed.types.kind(var.ty), TypeKind::FunctionBlock(pou) if is_actuator(typed, *pou))
        {
            let owner = var.owner.map(|pou| format!("{}.", typed.pou(pou).name));
            found = Some(format!("{}{}", owner.unwrap_or_default(), var.name));
        }
    });
    found
}
