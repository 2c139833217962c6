//! VAR_CONFIG: variables of programs and of function block instances get their places in the process image.

use crate::common::{Machine, compiled, spec};
use fam_soft_plc::{CheckOptions, SourceFile, check, diagnose, parse_project, standalone};

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
            "R.Main.s.left.raw AT %IX0.1 : BYTE;",
            "`raw` is BOOL, and VAR_CONFIG calls it BYTE",
        ),
        (
            "R.Main.scans : DINT := 1;",
            "`scans` is INT, and VAR_CONFIG calls it DINT",
        ),
        (
            "R.Main.s.left.seen : INT;",
            "VAR_CONFIG does not say where `seen` stands",
        ),
        ("R.Main.s.left.seen : INT := 'x';", "STRING"),
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

/// Two instances of one program, each with places and values of its own.
const TWICE: &str = "
FUNCTION_BLOCK Gain
VAR CONSTANT unit : INT := 1; END_VAR
VAR k : INT := 2; x AT %I* : INT; y AT %Q* : INT; END_VAR
y := x * k * unit;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Chain VAR first, second : Gain; limits : ARRAY[1..2] OF INT := [1, 1]; END_VAR VAR_OUTPUT sum : INT; END_VAR
first(); second(); sum := limits[1] + limits[2];
END_FUNCTION_BLOCK
PROGRAM Line VAR c : Chain; n : INT := 5; END_VAR c(); n := n + 1; END_PROGRAM
CONFIGURATION C
RESOURCE R ON PLC
    TASK T(INTERVAL := T#10ms, PRIORITY := 1);
    PROGRAM North WITH T : Line;
    PROGRAM South WITH T : Line;
END_RESOURCE
VAR_CONFIG
    R.North.c.first.x AT %IW0 : INT; R.North.c.first.y AT %QW0 : INT;
    R.North.c.second.x AT %IW1 : INT; R.North.c.second.y AT %QW1 : INT;
    R.South.c.first.x AT %IW2 : INT; R.South.c.first.y AT %QW2 : INT;
    R.South.c.second.x AT %IW3 : INT; R.South.c.second.y AT %QW3 : INT;
    R.North.c.second.k : INT := 10;
    R.South.c.first.k : INT := 100;
    R.South.n : INT := 50;
    R.South.c.limits : ARRAY[1..2] OF INT := [3, 4];
END_VAR
END_CONFIGURATION
";

#[test]
fn each_instance_of_a_program_has_its_own_places_and_initial_values() {
    let prepared = standalone::prepare(
        &[SourceFile::new("test.st", TWICE)],
        &standalone::Options::default(),
    )
    .unwrap_or_else(|d| panic!("{d:?}"));
    let mut m = Machine::of(&prepared.mc);
    for (at, input) in [1_u8, 2, 3, 4].into_iter().enumerate() {
        m.instance.inputs_mut()[2 * at] = input;
    }
    m.scan();
    let words: Vec<u16> = m.instance.outputs()[..8]
        .chunks(2)
        .map(|w| u16::from_le_bytes([w[0], w[1]]))
        .collect();
    assert_eq!(words, [2, 20, 300, 8]);
    for (path, value) in [
        ("North.n", "6"),
        ("South.n", "51"),
        ("North.c.sum", "2"),
        ("South.c.sum", "7"),
    ] {
        assert_eq!(m.text(path), value, "{path}");
    }
    assert!(
        m.instance.read("Line.n").is_none(),
        "no instance has this name"
    );
}

#[test]
fn what_is_said_about_a_program_is_said_once_however_often_it_runs() {
    let text = TWICE.replace("n := n + 1;", "IF TRUE THEN n := n + 1; END_IF;");
    let found = diagnose(&[SourceFile::new("test.st", text)], CheckOptions::default());
    assert_eq!(found.len(), 1, "{found:?}");
}
