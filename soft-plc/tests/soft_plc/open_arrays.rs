//! `ARRAY[*]`: functions that take arrays of any bounds.

use crate::common::{Machine, run};
use fam_soft_plc::{CheckOptions, SourceFile, check, parse_project};

const FUNCTIONS: &str = "
FUNCTION Total : DINT
VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR
VAR i : DINT; offset : DINT := 1000; END_VAR
FOR i := LOWER_BOUND(a, 1) TO UPPER_BOUND(a, 1) DO
    Total := Total + a[i];
    a[i] := a[i] + 1;
END_FOR;
Total := Total + offset;
END_FUNCTION
FUNCTION Trace : LREAL
VAR_INPUT m : ARRAY[*, *] OF LREAL; END_VAR
VAR i : DINT; shift : DINT; END_VAR
shift := LOWER_BOUND(ARR := m, DIM := 2) - LOWER_BOUND(ARR := m, DIM := 1);
FOR i := LOWER_BOUND(m, 1) TO UPPER_BOUND(m, 1) DO
    Trace := Trace + m[i, i + shift];
END_FOR;
END_FUNCTION
FUNCTION Twice : DINT
VAR_IN_OUT b : ARRAY[*] OF INT; END_VAR
Twice := Total(b) + Total(a := b);
END_FUNCTION
";

fn machine(vars: &str, body: &str) -> Machine {
    Machine::new(&format!(
        "{FUNCTIONS}PROGRAM P\nVAR\n{vars}\nEND_VAR\n{body}\nEND_PROGRAM\n"
    ))
}

fn problems(text: &str) -> String {
    let (project, diagnostics) = parse_project(&[SourceFile::new("test.st", text)]);
    let of_text: String = diagnostics.iter().map(ToString::to_string).collect();
    match check(&project, CheckOptions::default()) {
        Ok(_) => of_text,
        Err(all) => of_text + &all.iter().map(ToString::to_string).collect::<String>(),
    }
}

#[test]
fn one_function_takes_arrays_of_different_bounds() {
    let mut m = machine(
        "x : ARRAY[-2..2] OF INT := [1, 2, 3, 4, 5]; y : ARRAY[10..11] OF INT := [20, 30]; p, q, r, again : DINT;",
        "p := Total(x); q := Total(a := y); r := Twice(x); again := Total(x);",
    );
    m.scan();
    // Each pass adds one to every element, and 1000 to its result.
    assert_eq!(m.text("p"), "1015");
    assert_eq!(m.text("q"), "1050");
    assert_eq!(m.text("r"), "2045");
    assert_eq!(m.text("again"), "1030");
    assert_eq!(m.text("x[-2]"), "5");
    assert_eq!(m.text("y[11]"), "31");
}

#[test]
fn several_dimensions_and_arrays_by_value() {
    let mut m = machine(
        "a : ARRAY[1..2, 5..6] OF LREAL := [1.0, 2.0, 3.0, 4.0]; b : ARRAY[0..2, 0..2] OF LREAL := [1.0, 8(0.0)]; s, t : LREAL;",
        "s := Trace(a); b[1, 1] := 7.0; b[2, 2] := 0.5; t := Trace(m := b);",
    );
    m.scan();
    assert_eq!(m.text("s"), "5.0");
    assert_eq!(m.text("t"), "8.5");
}

#[test]
fn bounds_are_known_of_every_array() {
    let names = ["l", "u", "v"];
    let found = run(
        "a : ARRAY[3..7, -1..4] OF BOOL; l, u : DINT; v : ARRAY[0..1] OF INT; w : DINT;",
        "l := LOWER_BOUND(a, 2); u := UPPER_BOUND(ARR := a, DIM := 1); w := UPPER_BOUND(v, 1);",
        &names[..2],
    );
    assert_eq!(found, ["-1", "7"]);
}

#[test]
fn an_index_outside_of_what_was_passed_is_a_trap() {
    let mut m = Machine::new(
        "FUNCTION Pick : INT\nVAR_IN_OUT a : ARRAY[*] OF INT; END_VAR\nVAR_INPUT i : DINT; END_VAR\nPick := a[i];\nEND_FUNCTION
PROGRAM P\nVAR x : ARRAY[0..3] OF INT; y : ARRAY[0..9] OF INT; i : DINT; r : INT; END_VAR
r := Pick(y, i); r := Pick(x, i); i := i + 4;\nEND_PROGRAM\n",
    );
    m.scan();
    let trap = m.try_scan().unwrap_err().to_string();
    assert!(trap.contains("Pick") && trap.contains("line 4"), "{trap}");
}

#[test]
fn what_cannot_be_is_said() {
    let program = |vars: &str, body: &str| {
        format!("{FUNCTIONS}PROGRAM P\nVAR\n{vars}\nEND_VAR\n{body}\nEND_PROGRAM\n")
    };
    for (text, message) in [
        (
            program("x : ARRAY[*] OF INT;", ";"),
            "ARRAY[*] can stand only for a parameter of a function",
        ),
        (
            program("x : ARRAY[0..3] OF DINT; r : DINT;", "r := Total(x);"),
            "`a` takes ARRAY[*] OF INT, and this is ARRAY[0..3] OF DINT",
        ),
        (
            program("x : ARRAY[0..3, 0..1] OF INT; r : DINT;", "r := Total(x);"),
            "`a` takes ARRAY[*] OF INT, and this is ARRAY[0..3, 0..1] OF INT",
        ),
        (
            program("x : INT; r : DINT;", "r := Total(x);"),
            "`a` takes ARRAY[*] OF INT, and this is INT",
        ),
        (
            program("r : DINT;", "r := Total();"),
            "the argument for `a` (VAR_IN_OUT) is missing",
        ),
        (
            program("x : ARRAY[0..3] OF INT; r : DINT;", "r := UPPER_BOUND(x, 2);"),
            "the array has no dimension 2",
        ),
        (
            program("x : INT; r : DINT;", "r := UPPER_BOUND(x, 1);"),
            "INT is no array",
        ),
        (
            "FUNCTION F : INT\nVAR_IN_OUT a : ARRAY[*] OF INT; END_VAR\nF := F(a);\nEND_FUNCTION\nPROGRAM P\nVAR x : ARRAY[0..3] OF INT; r : INT; END_VAR\nr := F(x);\nEND_PROGRAM\n".to_owned(),
            "F calls itself: F > F",
        ),
    ] {
        let found = problems(&text);
        assert!(found.contains(message), "{message}\n{found}");
    }
    // Once, however many kinds of arrays are passed.
    let twice = problems(
        "FUNCTION F : INT\nVAR_IN_OUT a : ARRAY[*] OF INT; END_VAR\nF := nothing;\nEND_FUNCTION\nPROGRAM P\nVAR x : ARRAY[0..3] OF INT; y : ARRAY[0..4] OF INT; r : INT; END_VAR\nr := F(x); r := F(y);\nEND_PROGRAM\n",
    );
    assert_eq!(twice.matches("`nothing`").count(), 1, "{twice}");
}
