//! Located variables against the model: places that overlap in part, registers at the end of a table, signs, names in any case; and intervals
//! that hold together and differ in one thing only.

mod common;

use common::one_mc;
use fam_engineering::build;
use fam_engineering::convert::{Form, convert, write_files};
use fam_proto::model::{Number, Place};

fn said(logic: &str, extra: &str) -> String {
    let (_dir, path) = one_mc(logic, extra);
    match build(&path) {
        Ok(_) => String::new(),
        Err(problems) => problems.to_string(),
    }
}

#[test]
fn places_that_overlap_in_part_are_found() {
    let program = "PROGRAM M\nVAR n : INT; END_VAR\n n := n + 1;\nEND_PROGRAM\n";
    for (a, b, is_overlap) in [
        ("%IW0 : INT", "%IB1 : BYTE", true),
        ("%IW0 : INT", "%IB2 : BYTE", false),
        ("%ID1 : DINT", "%IX7.7 : BOOL", true),
        ("%ID1 : DINT", "%IX8.0 : BOOL", false),
        ("%IL0 : LINT", "%IW3 : INT", true),
    ] {
        let logic = format!("VAR_GLOBAL A AT {a}; B AT {b}; END_VAR\n{program}");
        let text = said(&logic, "[mc.inputs]\nA = \"image:A\"\nb = \"image:B\"\n");
        assert_eq!(text.contains("error[M311]"), is_overlap, "{a} {b}: {text}");
        assert_eq!(text.is_empty(), !is_overlap, "{text}");
    }
}

#[test]
fn registers_end_with_their_table() {
    for (ty, area, address, fits) in [
        ("INT", "W", 65535, true),
        ("DINT", "D", 65534, true),
        ("DINT", "D", 65535, false),
        ("LREAL", "L", 65532, true),
        ("LREAL", "L", 65533, false),
    ] {
        let logic = format!(
            "VAR_GLOBAL A AT %I{area}0 : {ty}; END_VAR\nPROGRAM M\nVAR n : INT; END_VAR\n n := n + 1;\nEND_PROGRAM\n"
        );
        let (dir, path) = one_mc(
            &logic,
            &format!("[mc.inputs]\nA = \"modbus:1/input/{address}\"\n"),
        );
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.replace(
            "driver = \"image\"",
            "driver = \"modbus\"\naddress = \"10.0.0.1:502\"",
        );
        std::fs::write(&path, text).unwrap();
        let found = build(&path).map_or_else(|p| p.to_string(), |_| String::new());
        assert_eq!(
            found.contains("`A` does not fit behind"),
            !fits,
            "{ty} {address}: {found}"
        );
        assert_eq!(found.is_empty(), fits, "{found}");
        drop(dir);
    }
}

#[test]
fn numbers_keep_their_sign_on_the_way_in() {
    for (ty, area, number) in [
        ("SINT", "B", Number::Signed),
        ("LINT", "L", Number::Signed),
        ("DINT", "D", Number::Signed),
        ("ULINT", "L", Number::Unsigned),
        ("WORD", "W", Number::Unsigned),
        ("REAL", "D", Number::Real),
        ("LREAL", "L", Number::Real),
    ] {
        let logic = format!(
            "VAR_GLOBAL A AT %I{area}0 : {ty}; END_VAR\nPROGRAM M\nVAR n : INT; END_VAR\n n := n + 1;\nEND_PROGRAM\n"
        );
        let (_dir, path) = one_mc(&logic, "[mc.inputs]\nA = \"image:A\"\n");
        let built = build(&path).unwrap_or_else(|p| panic!("{p}"));
        assert_eq!(built.model.mcs[0].inputs[0].number, number, "{ty}");
    }
}

#[test]
fn intervals_that_hold_together_have_one_recovery() {
    let logic = "FUNCTION_BLOCK Back\nVAR_OUTPUT end : BOOL; END_VAR\n end := TRUE;\nEND_FUNCTION_BLOCK\n\
                 PROGRAM M\nVAR step : INT; END_VAR\n step := step + 1;\nEND_PROGRAM\n";
    let one = |name: &str, kind: &str, repeatable: bool, value: &str| {
        format!(
            "[[mc.critical_interval]]\nname = \"{name}\"\ncondition = \"step > 5\"\nkind = \"{kind}\"\nrecovery = \"Back\"\nrepeatable = {repeatable}\n{value}"
        )
    };
    let lead = |step: u32| format!("[mc.critical_interval.checkpoint_state]\nstep = {step}\n");
    let first = one("A", "checkpoint", true, &lead(1));
    for (second, differs) in [
        (one("B", "checkpoint", true, &lead(1)), false),
        (one("B", "checkpoint", false, &lead(1)), true),
        (one("B", "checkpoint", true, &lead(2)), true),
        (one("B", "checkpoint", true, ""), true),
        (one("B", "unrecoverable", true, ""), true),
    ] {
        let text = said(logic, &format!("{first}{second}"));
        assert_eq!(text.contains("error[M510]"), differs, "{second}{text}");
    }
}

#[test]
fn inputs_stand_in_the_order_of_their_places() {
    let logic = "VAR_GLOBAL A AT %IX0.3 : BOOL; B AT %IX0.1 : BOOL; C AT %IW2 : INT; END_VAR\nPROGRAM M\nVAR n : INT; END_VAR\n n := n + 1;\nEND_PROGRAM\n";
    let (_dir, path) = one_mc(
        logic,
        "[mc.inputs]\nC = \"image:C\"\nA = \"image:A\"\nB = \"image:B\"\n",
    );
    let built = build(&path).unwrap_or_else(|p| panic!("{p}"));
    let inputs = built.model.mcs[0].inputs.iter();
    let names: Vec<&str> = inputs.map(|i| i.name.as_str()).collect();
    assert_eq!(names, ["B", "A", "C"]);
}

#[test]
fn what_the_list_of_the_state_leaves_out_is_named() {
    let logic = "PROGRAM M\nVAR first, second, third : INT; END_VAR\n first := first + second + third;\nEND_PROGRAM\n";
    for (list, left) in [
        (
            "\"first\"",
            "2 of its variables are no state: M.second, M.third",
        ),
        (
            "\"third\"",
            "2 of its variables are no state: M.first, M.second",
        ),
        (
            "\"second\", \"M.first\"",
            "1 of its variables are no state: M.third",
        ),
    ] {
        let (_dir, path) = one_mc(logic, &format!("state = [{list}]\n"));
        let built = build(&path).unwrap_or_else(|p| panic!("{p}"));
        let mut warnings = built.warnings.iter().map(ToString::to_string);
        let found = warnings.find(|w| w.contains("W808")).unwrap();
        assert!(found.contains(left), "{found}");
    }
}

const PARTS: &str = "
TYPE Drive : STRUCT speed : INT; fault : BOOL; END_STRUCT; END_TYPE
VAR_GLOBAL
    levels AT %IW0 : ARRAY[1..3] OF INT;
    seen AT %IB8 : ARRAY[0..1] OF Drive;
    lamps AT %QX0.6 : ARRAY[0..1, 1..2] OF BOOL;
    wanted AT %QB4 : Drive;
END_VAR
PROGRAM M
lamps[1, 2] := levels[2] > 0;
wanted := seen[1];
END_PROGRAM
";

fn listed(inputs: &[&str], outputs: &[&str]) -> String {
    let inputs: String = inputs
        .iter()
        .map(|name| format!("\"{name}\" = \"image:{name}\"\n"))
        .collect();
    let outputs: String = outputs
        .iter()
        .map(|name| format!("\"{name}\" = {{ field = \"image:{name}\", fail_safe = 0 }}\n"))
        .collect();
    let outputs = outputs.replace("fault\", fail_safe = 0", "fault\", fail_safe = false");
    let mut text = String::new();
    for line in outputs.lines() {
        let line = if line.starts_with("\"lamps") {
            line.replace("fail_safe = 0", "fail_safe = true")
        } else {
            line.to_owned()
        };
        text.push_str(&line);
        text.push('\n');
    }
    format!("[mc.inputs]\n{inputs}[mc.outputs]\n{text}")
}

const INPUTS: [&str; 7] = [
    "levels[1]",
    "levels[2]",
    "Levels[3]",
    "seen[0].speed",
    "seen[0].fault",
    "seen[1].speed",
    "seen[1].fault",
];
const OUTPUTS: [&str; 6] = [
    "lamps[0,1]",
    "lamps[0, 2]",
    "lamps[1,1]",
    "lamps[1,2]",
    "wanted.speed",
    "wanted.fault",
];

#[test]
fn elements_and_fields_are_points_of_their_own() {
    let (dir, path) = one_mc(PARTS, &listed(&INPUTS, &OUTPUTS));
    let built = build(&path).unwrap_or_else(|p| panic!("{p}"));
    let mc = &built.model.mcs[0];
    let place = |name: &str| {
        let inputs = mc.inputs.iter().map(|p| (&p.name, p.place));
        let outputs = mc.outputs.iter().map(|p| (&p.name, p.place));
        let mut all = inputs.chain(outputs);
        all.find(|(n, _)| *n == name).expect("a point").1
    };
    assert_eq!(place("levels[3]"), Place::Bytes { byte: 4, width: 2 });
    assert_eq!(place("seen[1].speed"), Place::Bytes { byte: 12, width: 2 });
    assert_eq!(place("seen[1].fault"), Place::Bit { byte: 14, bit: 0 });
    assert_eq!(place("lamps[0,2]"), Place::Bit { byte: 0, bit: 7 });
    assert_eq!(place("lamps[1,2]"), Place::Bit { byte: 1, bit: 1 });
    assert_eq!(place("wanted.fault"), Place::Bit { byte: 6, bit: 0 });
    assert_eq!(mc.fail_safe[..2], [0b1100_0000, 0b0000_0011]);

    // The same in AutomationML, and back.
    let plain =
        convert(&path, "cell.aml", &Form::Caex { library: None }).unwrap_or_else(|p| panic!("{p}"));
    let aml = dir.path().join("aml");
    write_files(&plain.files, &aml).unwrap_or_else(|p| panic!("{p}"));
    let again = build(&aml.join("cell.aml")).unwrap_or_else(|p| panic!("{p}"));
    assert_eq!(again.model.mcs[0].inputs, mc.inputs);
    assert_eq!(again.model.mcs[0].outputs, mc.outputs);
}

#[test]
fn a_part_that_is_not_listed_is_told_once_for_its_variable() {
    let text = said(PARTS, &listed(&INPUTS[3..], &OUTPUTS[..5]));
    assert_eq!(text.matches("error[M312]").count(), 2, "{text}");
    assert!(text.contains("`levels[1]` (at %IW0)"), "{text}");
    assert!(
        text.contains("add `\"levels[1]\" = \"...\"` to [mc.inputs], and the like"),
        "{text}"
    );
    assert!(text.contains("`wanted.fault` (at %QX6.0)"), "{text}");
    let text = said(PARTS, &listed(&INPUTS, &["lamps[0,3]"]));
    assert!(
        text.contains("its logic has no output `lamps[0,3]`"),
        "{text}"
    );
    assert!(text.contains("did you mean `lamps[0,"), "{text}");
}
