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

/// The standard's own example counts INTs from LOWER_BOUND to UPPER_BOUND (clause 6.6.1.2, MATRIX_MUL).
#[test]
fn bounds_are_whatever_integer_their_place_wants() {
    let text = "
FUNCTION Sum : INT
VAR_INPUT a : ARRAY[*, *] OF INT; END_VAR
VAR i, j : INT; k : USINT; END_VAR
FOR i := LOWER_BOUND(a, 1) TO UPPER_BOUND(a, 1) DO
    FOR j := LOWER_BOUND(a, 2) TO UPPER_BOUND(a, 2) DO Sum := Sum + a[i, j]; END_FOR;
END_FOR;
k := UPPER_BOUND(a, 1);
Sum := Sum + USINT_TO_INT(k) * 100;
END_FUNCTION
PROGRAM P
VAR m : ARRAY[1..2, 0..2] OF INT := [1, 2, 3, 4, 5, 6]; r : INT; w : DINT; END_VAR
r := Sum(m);
w := UPPER_BOUND(m, 2) + r;
END_PROGRAM";
    let mut machine = Machine::new(text);
    machine.scan();
    assert_eq!(machine.text("r"), "221");
    assert_eq!(machine.text("w"), "223");
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
            "ARRAY[*] can stand only for a parameter",
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

const BLOCKS: &str = "
INTERFACE Summing
    METHOD Sum : DINT VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR END_METHOD
END_INTERFACE
FUNCTION_BLOCK Plain IMPLEMENTS Summing
VAR_OUTPUT calls : INT; END_VAR
METHOD PUBLIC Sum : DINT
VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR
VAR i : DINT; END_VAR
calls := calls + 1;
FOR i := LOWER_BOUND(a, 1) TO UPPER_BOUND(a, 1) DO Sum := Sum + THIS.Weight(i) * a[i]; END_FOR;
a[LOWER_BOUND(a, 1)] := 0;
END_METHOD
METHOD PROTECTED Weight : DINT VAR_INPUT i : DINT; END_VAR Weight := 1; END_METHOD
METHOD PUBLIC Spread
VAR_INPUT v : ARRAY[*] OF INT; END_VAR
VAR_OUTPUT w : ARRAY[*] OF INT; END_VAR
VAR i : DINT; END_VAR
FOR i := LOWER_BOUND(w, 1) TO UPPER_BOUND(w, 1) DO w[i] := v[LOWER_BOUND(v, 1)] + DINT_TO_INT(i); END_FOR;
END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK Double EXTENDS Plain
METHOD PUBLIC OVERRIDE Sum : DINT
VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR
Sum := 2 * SUPER.Sum(a);
END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK Weighted EXTENDS Plain
METHOD PROTECTED OVERRIDE Weight : DINT VAR_INPUT i : DINT; END_VAR Weight := i; END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK Shift
VAR_INPUT CLK : BOOL R_EDGE; step : INT := 1; END_VAR
VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR
VAR_OUTPUT moves : INT; END_VAR
VAR i : DINT; END_VAR
IF CLK THEN
    moves := moves + step;
    FOR i := UPPER_BOUND(a, 1) TO LOWER_BOUND(a, 1) + 1 BY -1 DO a[i] := a[i - 1]; END_FOR;
    a[LOWER_BOUND(a, 1)] := moves;
END_IF;
END_FUNCTION_BLOCK
";

#[test]
fn methods_take_arrays_of_any_bounds_whichever_of_them_runs() {
    let mut m = Machine::new(&format!(
        "{BLOCKS}PROGRAM P
VAR p : Plain; d : Double; w : Weighted; s : Summing; r : REF_TO Plain;
    x : ARRAY[1..3] OF INT := [1, 2, 3]; y : ARRAY[-1..0] OF INT := [10, 20];
    a, b, c, e, f, g : DINT; out : ARRAY[5..7] OF INT;
END_VAR
a := p.Sum(x); // 6, x[1] is 0 now
b := d.Sum(a := x); // 2 * 5
s := w; c := s.Sum(x); // 2*2 + 3*3
s := d; e := s.Sum(y); // 2 * 30, y[-1] is 0
r := REF(w); f := r^.Sum(y); // 0
r := REF(p); g := r^.Sum(y); // 20
p.Spread(v := x, w => out); // 0 + 5, 6, 7
END_PROGRAM\n"
    ));
    m.scan();
    let all: Vec<String> = [
        "a", "b", "c", "e", "f", "g", "p.calls", "d.calls", "out[5]", "out[7]",
    ]
    .iter()
    .map(|n| m.text(n))
    .collect();
    assert_eq!(all, ["6", "10", "13", "60", "0", "20", "2", "2", "5", "7"]);
}

#[test]
fn an_instance_takes_arrays_of_any_bounds_and_keeps_one_state() {
    let mut m = Machine::new(&format!(
        "{BLOCKS}PROGRAM P
VAR s : Shift; x : ARRAY[1..3] OF INT; y : ARRAY[0..1] OF INT; n : INT; END_VAR
s(CLK := TRUE, a := x);
s(CLK := FALSE, a := y);
s(CLK := TRUE, a := y, step := 10);
s(CLK := TRUE, a := x);
s(CLK := FALSE, a := x);
n := s.moves;
END_PROGRAM\n"
    ));
    m.scan();
    let names = ["n", "x[1]", "x[2]", "y[0]", "y[1]"];
    let all: Vec<String> = names.iter().map(|n| m.text(n)).collect();
    assert_eq!(all, ["11", "1", "0", "11", "0"]);
    m.scan();
    let all: Vec<String> = names.iter().map(|n| m.text(n)).collect();
    assert_eq!(all, ["31", "21", "1", "31", "11"]);
}

#[test]
fn a_function_block_with_open_arrays_has_no_relatives() {
    let text = "FUNCTION_BLOCK A VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR ; END_FUNCTION_BLOCK
FUNCTION_BLOCK B EXTENDS A END_FUNCTION_BLOCK
FUNCTION_BLOCK C VAR_INPUT a : ARRAY[*] OF INT; END_VAR ; END_FUNCTION_BLOCK
PROGRAM P VAR b : B; END_VAR ; END_PROGRAM";
    let found = problems(text);
    assert!(
        found.contains("A has ARRAY[*] and cannot be derived"),
        "{found}"
    );
    assert!(
        found.contains("ARRAY[*] can stand only for a parameter"),
        "{found}"
    );
    assert_eq!(found.matches("error[").count(), 2, "{found}");
}

#[test]
fn what_is_made_of_one_text_gives_no_warnings_of_its_own() {
    let text = format!(
        "{FUNCTIONS}{BLOCKS}VAR_GLOBAL lamp AT %QX0.0 : BOOL; END_VAR
FUNCTION_BLOCK Light VAR_IN_OUT a : ARRAY[*] OF INT; END_VAR VAR_EXTERNAL lamp : BOOL; END_VAR
lamp := a[LOWER_BOUND(a, 1)] > 0;
END_FUNCTION_BLOCK
PROGRAM P VAR s : Shift; l : Light; x : ARRAY[1..3] OF INT; y : ARRAY[0..1] OF INT; t : DINT; d : Double; END_VAR
s(a := x); s(a := y); t := Total(x) + Total(y) + d.Sum(x); l(a := x); l(a := y);
END_PROGRAM"
    );
    let (project, _) = parse_project(&[SourceFile::new("test.st", text)]);
    let typed = check(&project, CheckOptions::default()).expect("right");
    let warnings = fam_soft_plc::check::lint::lint(&typed);
    let codes: Vec<&str> = warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, [""; 0], "{warnings:?}");
}

#[test]
fn arrays_that_grow_with_each_call_have_an_end() {
    let text = "FUNCTION F : DINT
VAR_INPUT a : ARRAY[*] OF INT; END_VAR
VAR b : ARRAY[0..UPPER_BOUND(a, 1) + 1] OF INT; END_VAR
F := F(b);
END_FUNCTION
PROGRAM P VAR x : ARRAY[0..3] OF INT; r : DINT; END_VAR r := F(x); END_PROGRAM";
    let found = problems(text);
    assert!(found.contains("error["), "{found}");
}
