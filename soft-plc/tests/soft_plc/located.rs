//! Located arrays and hierarchical addresses as the host sees them: inputs that it sets, outputs that it reads, their layout.

use fam_soft_plc::Value;
use fam_soft_plc::check::lint::lint;
use fam_soft_plc::layout::Area;

use fam_soft_plc::SourceFile;
use fam_soft_plc::standalone::{self, Options};

use crate::common::{Machine, show, typed};

const PROGRAM: &str = "
PROGRAM P
VAR
    levels AT %IW1.0 : ARRAY[1..3] OF INT;
    switches AT %IX4.6 : ARRAY[0..3] OF BOOL;
    motors AT %QX1.0.0 : ARRAY[0..9] OF BOOL;
    speeds AT %QW4 : ARRAY[1..3] OF INT := [7, 8, -9];
    i : INT;
END_VAR
FOR i := 1 TO 3 DO speeds[i] := levels[4 - i]; END_FOR;
FOR i := 0 TO 3 DO motors[9 - i] := switches[i]; END_FOR;
END_PROGRAM
";

#[test]
fn elements_lie_in_the_image_as_single_variables_would() {
    let mut machine = Machine::new(PROGRAM);
    let layout = machine.instance.layout().clone();
    let found = |path: &str| {
        let info = layout.find(path).expect("a variable");
        (info.area, info.offset, info.bit, info.len)
    };
    assert_eq!(found("P.levels[1]"), (Area::Inputs, 256, None, 2));
    assert_eq!(found("P.levels[3]"), (Area::Inputs, 260, None, 2));
    assert_eq!(found("P.switches[1]"), (Area::Inputs, 4, Some(7), 1));
    assert_eq!(found("P.switches[2]"), (Area::Inputs, 5, Some(0), 1));
    assert_eq!(found("P.motors[9]"), (Area::Outputs, 257, Some(1), 1));
    assert_eq!(found("P.motors"), (Area::Outputs, 256, Some(0), 2));
    assert_eq!(layout.inputs.len, 264);
    assert_eq!(layout.outputs.len, 264);
    assert_eq!(layout.initial_outputs[8..14], [7, 0, 8, 0, 0xF7, 0xFF]);

    let inputs = machine.instance.inputs_mut();
    inputs[256..262].copy_from_slice(&[1, 0, 0xFE, 0xFF, 3, 1]);
    (inputs[4], inputs[5]) = (0b0100_0000, 0b0000_0010);
    machine.scan();
    let outputs = machine.instance.outputs();
    assert_eq!(outputs[8..14], [3, 1, 0xFE, 0xFF, 1, 0]);
    // Switches 0 and 3 are on: motors 9 and 6.
    assert_eq!(outputs[256..258], [0b0100_0000, 0b0000_0010]);
}

const RECORDS: &str = "
TYPE
    Drive : STRUCT speed : INT; running, fault : BOOL; torque : REAL; END_STRUCT;
    Frame : STRUCT drives : ARRAY[1..2] OF Drive; lamps : ARRAY[0..10] OF BOOL; END_STRUCT;
END_TYPE
PROGRAM P
VAR
    seen AT %IB8 : Frame;
    wanted AT %QB8 : Frame := (drives := [1((speed := 5)), (torque := 2.0, fault := TRUE)]);
END_VAR
wanted.drives[1] := seen.drives[2];
wanted.lamps := seen.lamps;
END_PROGRAM
";

#[test]
fn fields_lie_in_the_image_as_single_variables_would() {
    let mut machine = Machine::new(RECORDS);
    let layout = machine.instance.layout().clone();
    let found = |path: &str| {
        let info = layout.find(path).expect("a variable");
        (info.area, info.offset, info.bit, info.len)
    };
    assert_eq!(found("P.seen"), (Area::Inputs, 8, None, 20));
    assert_eq!(found("P.seen.drives"), (Area::Inputs, 8, None, 16));
    assert_eq!(found("P.seen.drives[2].speed"), (Area::Inputs, 16, None, 2));
    assert_eq!(
        found("P.seen.drives[2].fault"),
        (Area::Inputs, 18, Some(1), 1)
    );
    assert_eq!(
        found("P.seen.drives[2].torque"),
        (Area::Inputs, 20, None, 4)
    );
    assert_eq!(found("P.seen.lamps[9]"), (Area::Inputs, 25, Some(1), 1));
    let leaves = layout.leaves(&layout.find("P.seen").expect("a variable"));
    assert_eq!(leaves.len(), 2 * 4 + 11);
    assert_eq!(leaves[18].offset, 25);
    assert_eq!(leaves[18].bit, Some(2));
    assert_eq!(layout.initial_outputs[8..10], [5, 0]);
    assert_eq!(layout.initial_outputs[16..24], [0, 0, 2, 0, 0, 0, 0, 0x40]);

    let inputs = machine.instance.inputs_mut();
    inputs[16..24].copy_from_slice(&[0xFE, 0xFF, 0b01, 0, 0, 0, 0x80, 0x3F]);
    inputs[24..26].copy_from_slice(&[0b1000_0001, 0b0000_0100]);
    machine.scan();
    let outputs = machine.instance.outputs();
    assert_eq!(outputs[8..16], [0xFE, 0xFF, 0b01, 0, 0, 0, 0x80, 0x3F]);
    assert_eq!(outputs[24..26], [0b1000_0001, 0b0000_0100]);
}

#[test]
fn addresses_of_other_plcs_lie_at_the_end_of_the_image() {
    let mut machine = Machine::new(
        "PROGRAM P VAR node AT %QW0.0.2.8193.0 : INT; x : BOOL; END_VAR
node := 7; %QX0.0.2.8193.9 := TRUE; x := %qx0.0.2.8193.9; END_PROGRAM",
    );
    machine.scan();
    assert_eq!(
        machine.instance.outputs()[65_520..],
        [1, 0, 0, 0, 0, 0, 0, 0, 7, 0, 0, 0, 0, 0, 0, 0]
    );
    assert_eq!(machine.instance.read("P.x"), Some(Value::Bool(true)));
}

fn warnings(outputs: &str, body: &str) -> usize {
    let text = format!("PROGRAM P VAR i : INT; {outputs} END_VAR {body} END_PROGRAM");
    let all = lint(&typed(&text));
    all.iter().filter(|d| d.code == "W707").count()
}

#[test]
fn outputs_that_overlap_are_found_whichever_way_they_are_written() {
    let both = "a AT %QW4 : ARRAY[0..3] OF INT; b AT %QW7 : INT;";
    assert_eq!(warnings(both, "a[3] := 1; b := 2;"), 1);
    assert_eq!(warnings(both, "a[2] := 1; b := 2;"), 0);
    assert_eq!(warnings(both, "a[i] := 1; b := 2;"), 1);
    let bits = "a AT %QX8.6 : ARRAY[0..3] OF BOOL; b AT %QX9.1 : BOOL; c AT %QX9.2 : BOOL;";
    assert_eq!(warnings(bits, "a[i] := TRUE; c := TRUE;"), 0);
    assert_eq!(warnings(bits, "a[i] := TRUE; b := TRUE;"), 1);
    let records = "a AT %QB20 : ARRAY[0..3] OF STRUCT n : INT; b : BOOL; END_STRUCT; c AT %QW13 : INT; d AT %QX26.1 : BOOL;";
    assert_eq!(warnings(records, "a[1].b := TRUE; c := 1;"), 1);
    assert_eq!(warnings(records, "a[1].b := TRUE; d := TRUE;"), 0);
    assert_eq!(warnings(records, "a[1].n := 1; c := 1;"), 0);
    assert_eq!(warnings(records, "a[i].n := 1; c := 1;"), 1);
    let levels = "a AT %QW1.2 : INT; b AT %QB261 : BYTE;";
    assert_eq!(warnings(levels, "a := 1; b := 2;"), 1);
}

const TEXTS: &str = "
VAR_GLOBAL
    recipe AT %IB10 : STRING[5];
    answer AT %QB10 : STRING[5] := 'begin';
    note AT %MB10 : WSTRING[3] := \"ab\";
END_VAR
PROGRAM P
VAR_EXTERNAL recipe, answer : STRING[5]; note : WSTRING[3]; END_VAR
VAR n : INT; END_VAR
n := n + 1;
IF n > 1 THEN answer := recipe; note := CONCAT(note, \"Ω\"); END_IF;
IF n > 2 THEN RETURN; END_IF;
END_PROGRAM
";

#[test]
fn located_strings_lie_in_the_image_by_their_characters() {
    let mut machine = Machine::new(TEXTS);
    assert_eq!(
        machine.instance.layout().initial_outputs[10..16],
        *b"begin\0"
    );
    machine.scan();
    assert_eq!(machine.instance.outputs()[10..16], *b"begin\0");
    // Longer than it may be, without an end.
    machine.instance.inputs_mut()[10..16].copy_from_slice(b"abcdef");
    machine.scan();
    assert_eq!(machine.instance.outputs()[10..16], *b"abcde\0");
    machine.instance.inputs_mut()[10..16].copy_from_slice(b"xy\0zzz");
    machine.scan();
    assert_eq!(machine.instance.outputs()[10..16], *b"xy\0\0\0\0");
    let note = standalone::find(&machine.instance, "note").expect("a variable");
    assert_eq!(machine.instance.read_text(&note).as_deref(), Some("abΩ"));
}

#[test]
fn a_table_of_inputs_sets_located_strings() {
    let options = Options::default();
    let prepared = standalone::prepare(&[SourceFile::new("t.st", TEXTS)], &options)
        .unwrap_or_else(|d| panic!("{}", show(&d)));
    let mut machine = Machine::of(&prepared.mc);
    let recipe = standalone::find(&machine.instance, "recipe").expect("a variable");
    standalone::write(&mut machine.instance, &recipe, "'A5'").expect("a text");
    machine.scan();
    machine.scan();
    assert_eq!(machine.instance.outputs()[10..16], *b"A5\0\0\0\0");
}
