//! The three generated POUs of an MC, after the flexible-automation paper (section III):
//!
//! - `<MC>_Control` is what runs. `isActive` and `wasActive` tell normal scans from the first one after an activation;
//!   `recoveryAction` says how that first one is made: 0 goes on directly from the state, a checkpoint interval's number runs
//!   its action until `end` and then goes on from the checkpoint, an unrecoverable interval's or the stop POU's number
//!   runs it until `end` and then ends the activation.
//! - `<MC>_Serialize` brings the state into the byte array `<MC>_state`, which the host reads as part of the checkpoint.
//! - `<MC>_Deserialize` brings it back, with the interval's checkpoint state laid over it.
//!
//! An action instance keeps its variables after its `end`; the host gives it its initial values again when it begins
//! a new recovery ([`crate::control::ControlLayout::actions`]).

pub mod portable;
pub mod standard;

use fam_proto::diagnosis::IntervalKind;
use std::fmt::Write as _;

/// In which form Serialize and Deserialize are written. Both give the same bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Target {
    /// One block copy, which this project's own soft-PLC can do.
    #[default]
    Fam,
    /// Variable by variable, in IEC 61131-3 that other compilers take.
    Portable,
}

/// Names of the generated POUs and variables of an MC.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names {
    /// `<MC>_Control`
    pub control: String,
    /// `<MC>_Serialize`
    pub serialize: String,
    /// `<MC>_Deserialize`
    pub deserialize: String,
    /// `<MC>_state`, the byte array.
    pub state: String,
}

/// Name of the stop POU's instance in Control.
pub const STOP_INSTANCE: &str = "StopAction";

impl Names {
    /// Names for an MC.
    #[must_use]
    pub fn of(mc: &str) -> Names {
        Names {
            control: format!("{mc}_Control"),
            serialize: format!("{mc}_Serialize"),
            deserialize: format!("{mc}_Deserialize"),
            state: format!("{mc}_state"),
        }
    }

    /// All of them.
    #[must_use]
    pub fn all(&self) -> [&str; 4] {
        [
            &self.control,
            &self.serialize,
            &self.deserialize,
            &self.state,
        ]
    }
}

/// What the generator needs to know of an MC.
#[derive(Debug, Clone)]
pub struct Plan<'a> {
    /// Name of the MC.
    pub mc: &'a str,
    /// Its main PROGRAM.
    pub program: &'a str,
    /// Its critical intervals; their numbers are 1, 2, ... in this order.
    pub intervals: Vec<PlanInterval<'a>>,
    /// Its stop POU; its number follows the intervals'.
    pub stop: Option<&'a str>,
    /// Length of its state in bytes.
    pub state_len: u32,
    /// Form of Serialize and Deserialize.
    pub copy: Copy,
    /// Offsets and bytes of variables that are no state: they are the same in every checkpoint.
    pub fixed: &'a [(u32, Vec<u8>)],
}

/// A critical interval, as Control and Deserialize need it.
#[derive(Debug, Clone)]
pub struct PlanInterval<'a> {
    /// Name.
    pub name: &'a str,
    /// Kind.
    pub kind: IntervalKind,
    /// POU of its action.
    pub pou: &'a str,
    /// Checkpoint state: variable as Deserialize reaches it, value as ST text, place in the model.
    pub overlay: Vec<Overlay>,
}

/// One value of a checkpoint state.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Overlay {
    /// Variable: `Program.x`, or a global's path.
    pub path: String,
    /// The global variable that has to be declared VAR_EXTERNAL, with its type, if it is one.
    pub global: Option<(String, String)>,
    /// Value as ST text.
    pub value: String,
}

/// How the state gets into the byte array and back.
#[derive(Debug, Clone)]
pub enum Copy {
    /// By block.
    Block,
    /// By statements.
    Statements(portable::Statements),
}

/// Name of an interval's action instance in Control.
#[must_use]
pub fn action_instance(interval: &str) -> String {
    format!("Action_{interval}")
}

/// Number of the stop action.
#[must_use]
pub fn stop_number(intervals: usize) -> u16 {
    u16::try_from(intervals + 1).unwrap_or(u16::MAX)
}

/// ST of the three POUs and the byte array.
#[must_use]
pub fn generate(plan: &Plan<'_>) -> String {
    let names = Names::of(plan.mc);
    let mut text = format!(
        "(* Generated from the cell model. Execution management of {}: do not edit. *)\n",
        plan.mc
    );
    if plan.state_len > 0 {
        let _ = writeln!(
            text,
            "VAR_GLOBAL\n    {} : ARRAY[0..{}] OF BYTE;\nEND_VAR\n",
            names.state,
            plan.state_len - 1
        );
    }
    control(&mut text, plan, &names);
    serialize(&mut text, plan, &names);
    deserialize(&mut text, plan, &names);
    text
}

fn control(text: &mut String, plan: &Plan<'_>, names: &Names) {
    let Plan { program, .. } = plan;
    let Names {
        control,
        serialize,
        deserialize,
        ..
    } = names;
    let _ = writeln!(
        text,
        "PROGRAM {control}\nVAR\n    isActive : BOOL;\n    wasActive : BOOL;\n    recoveryAction : INT;"
    );
    for interval in &plan.intervals {
        let _ = writeln!(
            text,
            "    {} : {};",
            action_instance(interval.name),
            interval.pou
        );
    }
    if let Some(stop) = plan.stop {
        let _ = writeln!(text, "    {STOP_INSTANCE} : {stop};");
    }
    let go_on = |indent: &str| {
        format!(
            "{indent}{deserialize}();\n{indent}{program}();\n{indent}{serialize}();\n{indent}wasActive := TRUE;\n"
        )
    };
    let _ = write!(
        text,
        "END_VAR\n\
         IF isActive AND wasActive THEN\n    {program}();\n    {serialize}();\n\
         ELSIF isActive AND NOT wasActive THEN\n    CASE recoveryAction OF\n        0: (* direct recovery *)\n{}",
        go_on("            ")
    );
    for (index, interval) in plan.intervals.iter().enumerate() {
        let action = action_instance(interval.name);
        let number = index + 1;
        let (what, then) = match interval.kind {
            IntervalKind::Checkpoint => (
                "checkpoint recovery",
                format!(
                    "{}                recoveryAction := 0;\n",
                    go_on("                ")
                ),
            ),
            IntervalKind::Unrecoverable => ("safe stop", stopped()),
        };
        let _ = write!(
            text,
            "        {number}: (* {what} of {} *)\n            {action}();\n            IF {action}.end THEN\n{then}            END_IF;\n",
            interval.name
        );
    }
    if plan.stop.is_some() {
        let _ = write!(
            text,
            "        {}: (* safe stop *)\n            {STOP_INSTANCE}();\n            IF {STOP_INSTANCE}.end THEN\n{}            END_IF;\n",
            stop_number(plan.intervals.len()),
            stopped()
        );
    }
    text.push_str(
        "    ELSE (* no such action: nothing may run *)\n        isActive := FALSE;\n    END_CASE;\n\
         ELSIF NOT isActive AND wasActive THEN\n    wasActive := FALSE;\nEND_IF;\nEND_PROGRAM\n\n",
    );
}

fn stopped() -> String {
    "                recoveryAction := 0;\n                isActive := FALSE;\n".to_owned()
}

fn external_state(text: &mut String, plan: &Plan<'_>, names: &Names) {
    if plan.state_len > 0 {
        let _ = writeln!(
            text,
            "VAR_EXTERNAL\n    {} : ARRAY[0..{}] OF BYTE;\nEND_VAR",
            names.state,
            plan.state_len - 1
        );
    }
}

fn externals(text: &mut String, globals: &[(String, String)]) {
    if !globals.is_empty() {
        text.push_str("VAR_EXTERNAL\n");
        for (name, ty) in globals {
            let _ = writeln!(text, "    {name} : {ty};");
        }
        text.push_str("END_VAR\n");
    }
}

fn temporaries(text: &mut String, temps: &[(String, &'static str)]) {
    if !temps.is_empty() {
        text.push_str("VAR_TEMP\n");
        for (name, ty) in temps {
            let _ = writeln!(text, "    {name} : {ty};");
        }
        text.push_str("END_VAR\n");
    }
}

fn serialize(text: &mut String, plan: &Plan<'_>, names: &Names) {
    let _ = writeln!(text, "PROGRAM {}", names.serialize);
    external_state(text, plan, names);
    match &plan.copy {
        Copy::Block if plan.state_len > 0 => {
            counter(text, plan);
            let _ = writeln!(
                text,
                "__REGION_TO_BYTES('{REGION_STATE}', {});",
                names.state
            );
        }
        Copy::Block => {}
        Copy::Statements(statements) => {
            externals(text, &statements.globals);
            temporaries(text, &statements.temps);
            counter(text, plan);
            text.push_str(&statements.serialize);
        }
    }
    fixed(text, plan, names);
    text.push_str("END_PROGRAM\n\n");
}

fn counter(text: &mut String, plan: &Plan<'_>) {
    if !plan.fixed.is_empty() {
        text.push_str("VAR_TEMP\n    fam_n : DINT;\nEND_VAR\n");
    }
}

/// Variables that are no state take their initial bytes, runs of equal ones at once.
fn fixed(text: &mut String, plan: &Plan<'_>, names: &Names) {
    for (offset, bytes) in plan.fixed {
        let mut at = 0;
        while at < bytes.len() {
            let run = bytes[at..].iter().take_while(|b| **b == bytes[at]).count();
            let first = *offset as usize + at;
            let (state, value) = (&names.state, bytes[at]);
            let _ = if run == 1 {
                writeln!(text, "{state}[{first}] := {value};")
            } else {
                writeln!(
                    text,
                    "FOR fam_n := {first} TO {} DO {state}[fam_n] := {value}; END_FOR;",
                    first + run - 1
                )
            };
            at += run;
        }
    }
}

fn deserialize(text: &mut String, plan: &Plan<'_>, names: &Names) {
    let _ = writeln!(text, "PROGRAM {}", names.deserialize);
    external_state(text, plan, names);
    let mut globals: Vec<(String, String)> = Vec::new();
    if let Copy::Statements(statements) = &plan.copy {
        globals.extend(statements.globals.iter().cloned());
    }
    for overlay in plan.intervals.iter().flat_map(|i| &i.overlay) {
        if let Some(global) = &overlay.global
            && !globals.contains(global)
        {
            globals.push(global.clone());
        }
    }
    externals(text, &globals);
    match &plan.copy {
        Copy::Block if plan.state_len > 0 => {
            let _ = writeln!(
                text,
                "__BYTES_TO_REGION('{REGION_STATE}', {});",
                names.state
            );
        }
        Copy::Block => {}
        Copy::Statements(statements) => {
            temporaries(text, &statements.temps);
            text.push_str(&statements.deserialize);
        }
    }
    if plan.intervals.iter().any(|i| !i.overlay.is_empty()) {
        let _ = writeln!(text, "CASE {}.recoveryAction OF", names.control);
        for (index, interval) in plan.intervals.iter().enumerate() {
            if interval.overlay.is_empty() {
                continue;
            }
            let _ = writeln!(
                text,
                "    {}: (* checkpoint state of {} *)",
                index + 1,
                interval.name
            );
            for overlay in &interval.overlay {
                let _ = writeln!(text, "        {} := {};", overlay.path, overlay.value);
            }
        }
        text.push_str("END_CASE;\n");
    }
    text.push_str("END_PROGRAM\n");
}

/// Region of the control variables, the actions and the byte array: what a checkpoint holds.
pub const REGION_CHECKPOINT: &str = "checkpoint";
/// Region of the live state.
pub const REGION_STATE: &str = "state";
