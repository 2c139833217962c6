//! Values that compiled code does not read back from memory: each program has a way in which the one it kept would be old.

use fam_soft_plc::Value;

use crate::common::Machine;

const PARTS: &str = "
TYPE Pair : STRUCT x, y : INT; END_STRUCT; END_TYPE
VAR_GLOBAL g : INT; END_VAR
FUNCTION Bump : INT VAR_INPUT more : INT; END_VAR g := g + more; Bump := g; END_FUNCTION
FUNCTION Set VAR_IN_OUT t : INT; END_VAR VAR_INPUT v : INT; END_VAR t := v; END_FUNCTION
FUNCTION_BLOCK Own
VAR_INPUT x : INT; END_VAR VAR_IN_OUT y : INT; END_VAR VAR_OUTPUT seen : INT; END_VAR
x := 1; y := 5; seen := x;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Two
VAR_INPUT a, b, sum : INT; END_VAR
sum := sum + a + b;
END_FUNCTION_BLOCK
";

#[test]
fn what_was_written_under_another_name_is_read() {
    for (variables, body, expected) in [
        // A parameter by reference is the instance's own variable.
        ("o : Own;", "o(y := o.x); r := o.seen;", "5"),
        // A reference.
        (
            "a : INT := 1; p : REF_TO INT;",
            "p := REF(a); r := a; p^ := 7; r := a;",
            "7",
        ),
        (
            "s : Pair; p : REF_TO Pair;",
            "p := REF(s); s.x := 1; p^.x := 8; r := s.x;",
            "8",
        ),
        // The same element by two indices; another element by the same index.
        (
            "l : ARRAY[0..4] OF INT; i, j : INT := 2;",
            "l[i] := 1; l[j] := 2; r := l[i];",
            "2",
        ),
        (
            "l : ARRAY[0..4] OF INT := [1, 2, 3]; i : INT;",
            "l[i] := 9; i := i + 1; r := l[i];",
            "2",
        ),
        (
            "l : ARRAY[0..4] OF Pair; i : INT := 1;",
            "l[i].x := 9; Set(i, 3); r := l[i].x;",
            "0",
        ),
        (
            "l : ARRAY[0..4] OF BYTE; i : INT := 1;",
            "l[i] := 16#0F; l[i].7 := TRUE; r := BYTE_TO_INT(l[i]);",
            "143",
        ),
        // What a called POU writes.
        ("", "g := 1; Bump(2); r := g;", "3"),
        ("a : INT;", "g := 1; a := g; r := Bump(4) + g;", "10"),
        ("t : INT;", "t := 1; Set(t, 6); r := t;", "6"),
        (
            "f : Two;",
            "f.a := 3; f(b := f.a); f(a := 1, b := f.a); r := f.sum;",
            "8",
        ),
        (
            "f : Two;",
            "f(a := 5, b := 1); f.sum := 10; f(b := 2); r := f.sum;",
            "17",
        ),
        // Whole structures.
        ("s, t : Pair;", "t.x := 4; s.x := 1; s := t; r := s.x;", "4"),
        (
            "l : ARRAY[0..1] OF Pair; t : Pair; i : INT := 1;",
            "t.y := 4; l[i].y := 1; l[1] := t; r := l[i].y;",
            "4",
        ),
    ] {
        expect(variables, body, expected);
    }
}

#[test]
fn what_ran_on_another_way_only_is_not_taken_for_known() {
    for (variables, body, expected) in [
        (
            "c : BOOL;",
            "a := 1; IF c THEN a := 2; END_IF; r := a;",
            "1",
        ),
        (
            "c : BOOL := TRUE;",
            "a := 1; IF c THEN a := 2; END_IF; r := a;",
            "2",
        ),
        (
            "l : ARRAY[0..4] OF INT := [5(7)]; i : INT := 2; c : BOOL;",
            "IF c THEN a := l[i]; ELSIF i = 9 THEN a := l[i]; END_IF; r := l[i];",
            "7",
        ),
        // The right side of AND is not always evaluated.
        (
            "l : ARRAY[0..4] OF INT := [5(7)]; i : INT := 2; c : BOOL;",
            "IF c AND l[i] = 7 THEN a := 1; END_IF; r := l[i] + a;",
            "7",
        ),
        (
            "l : ARRAY[0..4] OF INT := [5(7)]; i : INT := 2; c : BOOL := TRUE;",
            "IF c OR l[i] = 7 THEN a := 1; END_IF; r := l[i] + a;",
            "8",
        ),
        (
            "",
            "g := 2; CASE g OF 1: g := 10; 2: g := 20; a := g; 3: a := 1; 4: a := 2; ELSE g := 0; END_CASE; r := g + a;",
            "40",
        ),
        (
            "",
            "g := 2; CASE g OF 1: g := 10; 2: Bump(5); END_CASE; r := g;",
            "7",
        ),
    ] {
        expect(&format!("{variables} a : INT;"), body, expected);
    }
}

#[test]
fn loops_read_what_the_round_before_has_written() {
    for (variables, body, expected) in [
        // The limit is evaluated once, the variable in it is not.
        (
            "i : INT;",
            "g := 1; FOR i := g TO 3 DO r := r + g; Bump(1); END_FOR;",
            "6",
        ),
        (
            "i : INT;",
            "g := 3; FOR i := 1 TO g DO Bump(1); END_FOR; r := g;",
            "6",
        ),
        // CONTINUE comes from where less is known.
        (
            "i, x : INT;",
            "FOR i := 1 TO 3 DO g := i; IF i = 3 THEN Bump(10); CONTINUE; END_IF; x := g; END_FOR; r := g;",
            "13",
        ),
        (
            "i : INT;",
            "WHILE i < 3 DO i := i + 1; g := i; IF i = 2 THEN Bump(40); EXIT; END_IF; END_WHILE; r := g;",
            "42",
        ),
        (
            "i : INT;",
            "REPEAT i := i + 1; g := i; IF i = 2 THEN Bump(40); CONTINUE; END_IF; UNTIL g > 2 END_REPEAT; r := i;",
            "2",
        ),
        (
            "f : ARRAY[0..2] OF Two; i : INT;",
            "FOR i := 0 TO 5 DO f[i MOD 3](a := i, b := f[0].sum); END_FOR; r := f[2].sum;",
            "10",
        ),
        (
            "f : Two; i : INT;",
            "FOR i := 1 TO 3 DO f.sum := f.sum + 1; f(a := f.sum); r := r + f.sum; END_FOR;",
            "22",
        ),
    ] {
        expect(variables, body, expected);
    }
}

fn expect(variables: &str, body: &str, expected: &str) {
    let text = format!("{PARTS}PROGRAM P VAR r : INT; {variables} END_VAR {body} END_PROGRAM");
    let mut m = Machine::new(&text);
    m.scan();
    assert_eq!(m.text("r"), expected, "{variables} {body}");
}

#[test]
fn bounds_of_real_numbers_keep_what_is_no_number_and_the_sign_of_nothing() {
    let text = "
PROGRAM P
VAR v : LREAL; low, high, both, zero : LREAL; single : REAL; END_VAR
low := MAX(-1.5, v);
high := MIN(v, 2.5);
both := LIMIT(-1.5, v, 2.5);
zero := LIMIT(0.0, v, 2.5);
single := LIMIT(-1.5, LREAL_TO_REAL(v), 2.5);
END_PROGRAM";
    let nan = f64::from_bits(0xfff8_0000_0000_0001);
    let mut m = Machine::new(text);
    for (v, low, high, both, zero) in [
        (1.0, 1.0, 1.0, 1.0, 1.0),
        (-7.0, -1.5, -7.0, -1.5, 0.0),
        (7.0, 7.0, 2.5, 2.5, 2.5),
        (f64::INFINITY, f64::INFINITY, 2.5, 2.5, 2.5),
        (f64::NEG_INFINITY, -1.5, f64::NEG_INFINITY, -1.5, 0.0),
        (-0.0, -0.0, -0.0, -0.0, 0.0),
        (nan, f64::NAN, f64::NAN, f64::NAN, f64::NAN),
    ] {
        m.set("v", Value::Lreal(v));
        m.scan();
        for (name, wanted) in [("low", low), ("high", high), ("both", both), ("zero", zero)] {
            let Some(Value::Lreal(found)) = m.instance.read(&format!("P.{name}")) else {
                panic!("{name} is an LREAL");
            };
            // Bits, so that the sign of 0 counts, and of NaNs only the canonical one will do.
            let wanted = if wanted.is_nan() {
                0x7ff8_0000_0000_0000
            } else {
                wanted.to_bits()
            };
            assert_eq!(found.to_bits(), wanted, "{name} of {v}");
        }
        let Some(Value::Real(single)) = m.instance.read("P.single") else {
            panic!("a REAL");
        };
        let wanted = if both.is_nan() {
            0x7fc0_0000
        } else {
            (both as f32).to_bits()
        };
        assert_eq!(single.to_bits(), wanted, "{v}");
    }
}

#[test]
fn a_case_finds_the_branch_of_every_value() {
    for (ty, values) in [
        (
            "INT",
            &[-32768i64, -6, -5, -4, 0, 1, 2, 3, 9, 10, 14, 15, 16, 32767][..],
        ),
        ("UDINT", &[0, 1, 2, 3, 9, 10, 14, 15, 16, 4_294_967_295]),
        ("LINT", &[i64::MIN, -5, 0, 1, 2, 3, 10, 15, i64::MAX]),
    ] {
        let negative = if ty == "UDINT" { "100" } else { "-5" };
        let text = format!(
            "PROGRAM P VAR v : {ty}; r : INT; END_VAR
CASE v OF 3: r := 3; 10..15: r := 10; {negative}: r := 5; 0, 2: r := 2; ELSE r := -1; END_CASE;
END_PROGRAM"
        );
        let mut m = Machine::new(&text);
        for value in values {
            let v = match ty {
                "UDINT" => Value::Uint(*value as u64),
                _ => Value::Int(*value),
            };
            m.set("v", v);
            m.scan();
            let expected = match value {
                3 => 3,
                10..=15 => 10,
                -5 => 5,
                0 | 2 => 2,
                _ => -1,
            };
            assert_eq!(m.text("r"), expected.to_string(), "{ty} {value}");
        }
    }
}

#[test]
fn a_counter_that_its_body_writes_ends_where_its_type_does() {
    for (body, expected) in [
        (
            "FOR i := 1 TO 20 DO IF i = 10 THEN i := 32767; END_IF; n := n + 1; END_FOR;",
            "-32768 10",
        ),
        (
            "FOR i := 1 TO 20 DO IF i = 10 THEN i := 25; END_IF; n := n + 1; END_FOR;",
            "26 10",
        ),
        (
            "FOR i := 5 TO 1 BY -1 DO IF i = 3 THEN i := -32768; END_IF; n := n + 1; END_FOR;",
            "32767 3",
        ),
        (
            "FOR i := 32760 TO 32767 DO n := n + 1; END_FOR;",
            "-32768 8",
        ),
        ("FOR i := 3 TO 1 DO n := n + 1; END_FOR;", "3 0"),
        ("FOR i := 1 TO 1 DO n := n + 1; END_FOR;", "2 1"),
        ("n := 2; FOR i := 1 TO n DO n := n + 1; END_FOR;", "3 4"),
    ] {
        let mut m = Machine::new(&format!(
            "PROGRAM P VAR i, n : INT; END_VAR {body} END_PROGRAM"
        ));
        m.scan();
        assert_eq!(
            format!("{} {}", m.text("i"), m.text("n")),
            expected,
            "{body}"
        );
    }
}
