//! `fam show`: a cell as a tree for people.

use crate::build::{BuiltCell, BuiltMc};
use crate::model::points::point_text;
use crate::model::resolve::ms;
use fam_proto::diagnosis::IntervalKind;
use fam_proto::model::{FieldDriver, InputSource, McModel, Place};

/// A line and what hangs below it.
struct Branch {
    text: String,
    below: Vec<Branch>,
}

fn leaf(text: String) -> Branch {
    Branch {
        text,
        below: Vec::new(),
    }
}

fn branch(text: String, below: Vec<Branch>) -> Branch {
    Branch { text, below }
}

/// The tree.
#[must_use]
pub fn tree(built: &BuiltCell) -> String {
    let model = &built.model;
    let gateways = model
        .gateways
        .iter()
        .map(|g| {
            leaf(match &g.driver {
                FieldDriver::Modbus { address } => format!("{}: modbus at {address}", g.gateway),
                FieldDriver::Image => format!("{}: image", g.gateway),
            })
        })
        .collect();
    let controllers = model
        .controllers
        .iter()
        .map(|c| {
            let about = if c.description.is_empty() {
                String::new()
            } else {
                format!(" ({})", c.description)
            };
            leaf(format!(
                "{}{about}: CPU factor {}, limit {} %, {} MB, tick {}",
                c.controller,
                f64::from(c.cpu_factor_permille) / 1000.0,
                f64::from(c.limit_permille) / 10.0,
                c.memory_kb / 1024,
                ms(c.tick_us.into())
            ))
        })
        .collect();
    let mcs = model
        .mcs
        .iter()
        .zip(&built.mcs)
        .map(|(mc, of)| component(built, mc, of))
        .collect();
    let root = branch(
        format!("cell {}", model.cell),
        vec![
            branch("gateways".to_owned(), gateways),
            branch("controllers".to_owned(), controllers),
            branch("mechatronic components".to_owned(), mcs),
        ],
    );
    let mut out = String::new();
    draw(&root, "", "", &mut out);
    out
}

fn draw(branch: &Branch, first: &str, rest: &str, out: &mut String) {
    out.push_str(first);
    out.push_str(&branch.text);
    out.push('\n');
    for (index, below) in branch.below.iter().enumerate() {
        let is_last = index + 1 == branch.below.len();
        let (mark, indent) = if is_last {
            ("└─ ", "   ")
        } else {
            ("├─ ", "│  ")
        };
        draw(
            below,
            &format!("{rest}{mark}"),
            &format!("{rest}{indent}"),
            out,
        );
    }
}

fn component(built: &BuiltCell, mc: &McModel, of: &BuiltMc) -> Branch {
    let hosts: Vec<&str> = mc.hosts.iter().map(|h| h.as_str()).collect();
    let mut below = vec![
        leaf(format!("hosted on {}", hosts.join(", "))),
        leaf(format!(
            "at {}, criticality {}, cycle {}, scan {} us, suspect {}, watchdog {}",
            mc.gateway,
            mc.criticality,
            ms(mc.cycle_us.into()),
            mc.worst_case_us,
            ms(mc.suspect_us),
            ms(mc.watchdog_us)
        )),
        leaf(format!(
            "state: {} variables, {} bytes",
            of.state_variables.len(),
            of.control.state.end - of.control.state.start
        )),
    ];
    let inputs = mc.inputs.iter().map(|i| {
        leaf(format!(
            "{} from {}",
            i.name,
            match &i.source {
                InputSource::Field(point) => point_text(point),
                InputSource::Export { mc, place } => exported(built, mc, *place),
            }
        ))
    });
    below.push(branch("inputs".to_owned(), inputs.collect()));
    let outputs = mc.outputs.iter().map(|o| {
        leaf(match &o.field {
            Some(point) => format!("{} to {}", o.name, point_text(point)),
            None => format!("{} (exported)", o.name),
        })
    });
    below.push(branch("outputs".to_owned(), outputs.collect()));
    let intervals = mc.diagnosis.intervals.iter().zip(&of.intervals);
    let intervals = intervals.map(|(interval, text)| {
        let kind = match interval.kind {
            IntervalKind::Checkpoint => "checkpoint recovery",
            IntervalKind::Unrecoverable => "safe stop",
        };
        let set: Vec<String> = text
            .checkpoint_state
            .iter()
            .map(|(variable, value)| format!("{variable} := {value}"))
            .collect();
        let then = if set.is_empty() {
            String::new()
        } else {
            format!(", then {}", set.join(", "))
        };
        leaf(format!(
            "{}: {} -> {kind} by {}{then}",
            interval.name, text.condition, interval.pou
        ))
    });
    below.push(branch("critical intervals".to_owned(), intervals.collect()));
    below.retain(|b| {
        !b.below.is_empty()
            || !matches!(b.text.as_str(), "inputs" | "outputs" | "critical intervals")
    });
    branch(mc.mc.to_string(), below)
}

fn exported(built: &BuiltCell, mc: &fam_proto::McId, place: Place) -> String {
    let output = built
        .model
        .mc(mc)
        .and_then(|m| m.outputs.iter().find(|o| o.place == place));
    match output {
        Some(output) => format!("{mc}.{}", output.name),
        None => mc.to_string(),
    }
}
