//! VAR_CONFIG: variables of programs and of function block instances get their places in the process image.

use crate::common::{Machine, compiled, spec};
use fam_soft_plc::{CheckOptions, SourceFile, check, parse_project};

const BLOCKS: &str = "
FUNCTION_BLOCK Sensor
VAR
    raw AT %I* : BOOL;
    level AT %I* : INT;
    lamp AT %Q* : BOOL;
END_VAR
VAR_OUTPUT seen : INT; END_VAR
IF raw THEN seen := seen + level; END_IF;
lamp := raw;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Station
VAR left, right : Sensor; END_VAR
VAR_OUTPUT sum : INT; END_VAR
left(); right();
sum := left.seen + right.seen;
END_FUNCTION_BLOCK
PROGRAM P
VAR s : Station; own AT %I* : BOOL; early : BOOL; scans : INT; END_VAR
scans := scans + 1;
s();
early := own;
IF own THEN RETURN; END_IF;
scans := scans + 100;
END_PROGRAM
";

const PLACES: &str = "
CONFIGURATION C
RESOURCE R ON PLC
    PROGRAM Main : P;
END_RESOURCE
VAR_CONFIG
    R.Main.own AT %IX0.0 : BOOL;
    R.Main.s.left.raw AT %IX0.1 : BOOL;
    R.Main.s.left.level AT %IW1 : INT;
    R.Main.s.left.lamp AT %QX0.3 : BOOL;
    R.Main.s.right.raw AT %IX0.2 : BOOL;
    R.Main.s.right.level AT %IW2 : INT;
    R.Main.s.right.lamp AT %QX1.0 : BOOL;
END_VAR
END_CONFIGURATION
";

fn problems(places: &str) -> String {
    let text = format!("{BLOCKS}{places}");
    let (project, diagnostics) = parse_project(&[SourceFile::new("test.st", text)]);
    assert!(diagnostics.is_empty());
    match check(&project, CheckOptions::default()) {
        Ok(_) => String::new(),
        Err(all) => all.iter().map(ToString::to_string).collect(),
    }
}

#[test]
fn instances_read_and_write_the_places_that_var_config_gives_them() {
    let mut m = Machine::of(&compiled(&format!("{BLOCKS}{PLACES}"), &spec("P")));
    m.scan();
    assert_eq!(m.instance.outputs()[..2], [0, 0]);
    let inputs = m.instance.inputs_mut();
    inputs[0] = 0b010;
    inputs[2..6].copy_from_slice(&[7, 0, 20, 0]);
    m.scan();
    assert_eq!(m.instance.outputs()[..2], [0b1000, 0]);
    assert_eq!(m.text("s.sum"), "7");
    // Both, and RETURN: what stands behind the body still comes out.
    m.instance.inputs_mut()[0] = 0b111;
    m.scan();
    assert_eq!(m.instance.outputs()[..2], [0b1000, 1]);
    assert_eq!(m.text("s.sum"), "34");
    assert_eq!(m.text("early"), "TRUE");
    assert_eq!(m.text("scans"), "203");
    m.instance.inputs_mut()[0] = 0b100;
    m.scan();
    assert_eq!(m.instance.outputs()[..2], [0, 1]);
    assert_eq!(m.text("s.sum"), "54");
}

#[test]
fn a_line_of_var_config_that_means_nothing_says_so() {
    let config = |line: &str| {
        format!(
            "CONFIGURATION C\nRESOURCE R ON PLC\nPROGRAM Main : P;\nEND_RESOURCE\nVAR_CONFIG\n{line}\nEND_VAR\nEND_CONFIGURATION\n"
        )
    };
    for (line, message) in [
        (
            "R.Main.s.middle.raw AT %IX0.1 : BOOL;",
            "this path of VAR_CONFIG names no variable of a program or of an instance in one",
        ),
        (
            "R.Other.own AT %IX0.1 : BOOL;",
            "this path of VAR_CONFIG names no variable of a program or of an instance in one",
        ),
        (
            "R.Main.own.raw AT %IX0.1 : BOOL;",
            "`own` is no function block instance",
        ),
        (
            "R.Main.s.left.seen AT %IW1 : INT;",
            "`seen` is not declared with AT %I* or AT %Q*",
        ),
        (
            "R.Main.s.left.raw AT %QX0.1 : BOOL;",
            "`raw` cannot stand at %QX0.1",
        ),
        (
            "R.Main.s.left.raw AT %IW1 : BOOL;",
            "BOOL has 1 bit and `%IW1` has 16 bits",
        ),
        (
            "R.Main.s.left.raw : BOOL := TRUE;",
            "VAR_CONFIG does not say where `raw` stands",
        ),
    ] {
        let found = problems(&config(line));
        assert!(found.contains(message), "{line}\n{found}");
    }
}

/// `VAR AT %IW2 : INT; END_VAR`: a variable whose address is its name has the declared type and initial value.
#[test]
fn an_address_can_be_declared_without_a_name() {
    let text = "PROGRAM P
VAR
  AT %IW2 : INT;
  AT %QW4 : INT := -7;
  AT %IX0.0 : BOOL;
  r : INT;
END_VAR
r := %iw2;
IF %IX0.0 THEN %QW4 := r - 1; END_IF;
END_PROGRAM";
    let mut m = Machine::new(text);
    m.instance.inputs_mut()[4..6].copy_from_slice(&(-300_i16).to_le_bytes());
    m.scan();
    assert_eq!(m.text("r"), "-300");
    assert_eq!(m.instance.outputs()[8..10], (-7_i16).to_le_bytes());
    m.instance.inputs_mut()[0] = 1;
    m.scan();
    assert_eq!(m.instance.outputs()[8..10], (-301_i16).to_le_bytes());
}
