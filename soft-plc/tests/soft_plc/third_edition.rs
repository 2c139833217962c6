//! Strings, dates, references, parts of bit strings, enable inputs: values worked out by hand from the standard.

use crate::common::{Machine, compiled, spec, typed};
use fam_soft_plc::standalone::{Shown, variables};

/// Runs each case in a program of its own, all in one instance; (declarations, statements, expected value of `r`).
pub fn check_cases(before: &str, cases: &[(&str, &str, &str)]) {
    let mut text = before.to_owned();
    let mut calls = String::new();
    for (index, (vars, body, _)) in cases.iter().enumerate() {
        text.push_str(&format!(
            "PROGRAM C{index}\nVAR\n{vars}\nEND_VAR\n{body}\nEND_PROGRAM\n"
        ));
        calls.push_str(&format!("C{index}();\n"));
    }
    text.push_str(&format!("PROGRAM P\n{calls}END_PROGRAM\n"));
    let mut machine = Machine::of(&compiled(&text, &spec("P")));
    machine.scan();
    let shown = variables(&machine.instance);
    let mut wrong = Vec::new();
    for (index, (vars, body, expected)) in cases.iter().enumerate() {
        let path = format!("C{index}.r");
        let found = shown.iter().find(|(p, _)| *p == path);
        let found = match found {
            Some((_, Shown::Scalar(value))) => value.to_string(),
            Some((_, Shown::Text(text))) => text.clone(),
            Some((_, Shown::Name(name))) => name.clone(),
            other => format!("{other:?}"),
        };
        if found != *expected {
            wrong.push(format!(
                "{vars}\n  {body}\n  r = {found}, expected {expected}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[rustfmt::skip]
const STRINGS: &[(&str, &str, &str)] = &[
    ("r : STRING;", "r := 'abc';", "abc"),
    ("r : STRING[3];", "r := 'abcdef';", "abc"),
    ("r : STRING(3);", "r := 'abcdef';", "abc"),
    ("r : STRING := 'init';", ";", "init"),
    ("r : STRING[4] := 'initial';", ";", "init"),
    ("r : WSTRING[5];", "r := \"w$00E9x\";", "w\u{e9}x"),
    ("r : STRING;", "r := 'a$'b$$c$41';", "a'b$cA"),
    ("r : STRING; s : STRING := 'hello';", "r := LEFT(s, 3);", "hel"),
    ("r : STRING; s : STRING := 'hello';", "r := LEFT(IN := s, L := 99);", "hello"),
    ("r : STRING; s : STRING := 'hello';", "r := RIGHT(s, 2);", "lo"),
    ("r : STRING; s : STRING := 'hello';", "r := MID(s, 3, 2);", "ell"),
    ("r : STRING; s : STRING := 'hello';", "r := MID(IN := s, L := 10, P := 4);", "lo"),
    ("r : STRING; s : STRING := 'hello';", "r := CONCAT(s, ' ', 'world');", "hello world"),
    ("r : STRING; s : STRING := 'hello';", "r := INSERT(s, 'XY', 2);", "heXYllo"),
    ("r : STRING; s : STRING := 'hello';", "r := INSERT(s, 'XY', 0);", "XYhello"),
    ("r : STRING; s : STRING := 'hello';", "r := DELETE(s, 2, 3);", "heo"),
    ("r : STRING; s : STRING := 'hello';", "r := REPLACE(s, 'P', 2, 4);", "helP"),
    ("r : STRING; s : STRING := 'hello';", "r := REPLACE(IN1 := s, IN2 := 'ABC', L := 1, P := 1);", "ABCello"),
    ("r : INT; s : STRING := 'hello';", "r := LEN(s);", "5"),
    ("r : INT; s : STRING := 'hello';", "r := FIND(s, 'l');", "3"),
    ("r : INT; s : STRING := 'hello';", "r := FIND(s, 'lo');", "4"),
    ("r : INT; s : STRING := 'hello';", "r := FIND(s, 'lx');", "0"),
    ("r : INT; s : STRING;", "r := LEN(s);", "0"),
    ("r : BOOL; s : STRING := 'abc';", "r := s = 'abc';", "TRUE"),
    ("r : BOOL; s : STRING := 'abc';", "r := s < 'abd' AND s > 'ab' AND s <> 'abcd';", "TRUE"),
    ("r : BOOL; s : STRING[10] := 'abc'; t : STRING[20] := 'abc';", "r := s = t AND NOT (s <> t);", "TRUE"),
    ("r : STRING; s : STRING := 'abc';", "r := s; s := 'other'; r := CONCAT(r, s);", "abcother"),
    ("r : STRING[5]; s : STRING := 'abc';", "r := CONCAT(s, s);", "abcab"),
    ("r : STRING := 'long text'; s : STRING := 'x';", "r := s;", "x"),
    ("r : STRING := 'abcdef';", "r := MID(r, 3, 2);", "bcd"),
    ("r : STRING; i : INT := -42;", "r := INT_TO_STRING(i);", "-42"),
    ("r : STRING; b : BOOL := TRUE;", "r := BOOL_TO_STRING(b);", "TRUE"),
    ("r : STRING; x : REAL := 1.5;", "r := REAL_TO_STRING(x);", "1.5"),
    ("r : STRING; t : TIME := T#1s500ms;", "r := TIME_TO_STRING(t);", "T#1s500ms"),
    ("r : STRING; u : ULINT := 18446744073709551615;", "r := TO_STRING(u);", "18446744073709551615"),
    ("r : INT; s : STRING := ' 123 ';", "r := STRING_TO_INT(s);", "123"),
    ("r : DINT; s : STRING := '-16#10';", "r := STRING_TO_DINT(s);", "-16"),
    ("r : LREAL; s : STRING := '2.5e3';", "r := STRING_TO_LREAL(s);", "2500.0"),
    ("r : TIME; s : STRING := 'T#2s';", "r := STRING_TO_TIME(s);", "T#2s"),
    ("r : BOOL; s : STRING := 'true';", "r := STRING_TO_BOOL(s);", "TRUE"),
    ("r : WSTRING; s : STRING := 'ab';", "r := STRING_TO_WSTRING(s);", "ab"),
    ("r : STRING; s : WSTRING := \"ab\";", "r := WSTRING_TO_STRING(s);", "ab"),
    ("r : STRING; g : BOOL := TRUE;", "r := SEL(g, 'no', 'yes');", "yes"),
    ("r : STRING; k : INT := 2;", "r := MUX(k, 'a', 'b', 'c');", "c"),
    ("r : STRING; s : STRING := 'b';", "r := MAX(s, 'a', 'c');", "c"),
    ("r : STRING; s : STRING := 'b';", "r := MIN(s, 'a', 'c');", "a"),
    ("r : CHAR;", "r := 'x';", "'x'"),
    ("r : CHAR; s : STRING := 'hello';", "r := s[2];", "'e'"),
    ("r : STRING := 'hello'; i : INT := 1;", "r[i] := 'J';", "Jello"),
    ("r : STRING; c : CHAR := 'q';", "r := CONCAT(c, 'r');", "qr"),
    ("r : BYTE; c : CHAR := 'A';", "r := CHAR_TO_BYTE(c);", "65"),
    ("r : STRING; a : ARRAY[1..3] OF STRING[8] := ['x', 'yy', 'zzz']; i : INT := 3;", "a[2] := 'changed!!'; r := CONCAT(a[i], a[2]);", "zzzchanged!"),
    ("r : STRING; s : STRING := 'x';", "CASE LEN(s) OF 1: r := 'one'; ELSE r := 'other'; END_CASE", "one"),
    ("r : STRING; i : INT;", "FOR i := 1 TO 3 DO r := CONCAT(r, INT_TO_STRING(i)); END_FOR", "123"),
    ("r : STRING[20]; s : STRING := 'go';", "r := twice(s);", "gogo"),
    ("r : STRING; s : STRING := 'go';", "r := twice(twice(s));", "gogogogo"),
    ("r : STRING[4]; s : STRING[6] := 'abc';", "add(s, 'defgh'); r := s;", "abcd"),
    ("r : STRING[6] := 'abc';", "add(r, 'defgh');", "abcdef"),
    ("r : STRING; f : Greeter;", "f(name := 'Ada', greeting => r);", "Hello Ada"),
    ("r : STRING; f : Greeter;", "f.name := 'Bob'; f(); r := f.greeting;", "Hello Bob"),
    ("r : INT; p : Person := (name := 'Eve', age := 7);", "r := LEN(p.name) * 10 + p.age;", "37"),
];

const STRING_POUS: &str = "
TYPE Person : STRUCT name : STRING[10] := 'nobody'; age : INT; END_STRUCT; END_TYPE
FUNCTION twice : STRING[40] VAR_INPUT s : STRING; END_VAR twice := CONCAT(s, s); END_FUNCTION
FUNCTION add VAR_IN_OUT s : STRING; END_VAR VAR_INPUT t : STRING; END_VAR s := CONCAT(s, t); END_FUNCTION
FUNCTION_BLOCK Greeter VAR_INPUT name : STRING[12]; END_VAR VAR_OUTPUT greeting : STRING; END_VAR
greeting := CONCAT('Hello ', name); END_FUNCTION_BLOCK
";

#[test]
fn strings_are_what_the_standard_says() {
    check_cases(STRING_POUS, STRINGS);
}

#[rustfmt::skip]
const DATES: &[(&str, &str, &str)] = &[
    ("r : DATE;", "r := D#2024-02-29;", "D#2024-02-29"),
    ("r : LDATE;", "r := LDATE#1970-01-02;", "D#1970-01-02"),
    ("r : TOD;", "r := TOD#12:34:56.789;", "TOD#12:34:56.789"),
    ("r : TIME_OF_DAY;", "r := TIME_OF_DAY#23:59:59;", "TOD#23:59:59"),
    ("r : DT;", "r := DT#2000-01-01-00:00:00;", "DT#2000-01-01-00:00:00"),
    ("r : DATE_AND_TIME;", "r := DATE_AND_TIME#1999-12-31-23:59:59.5;", "DT#1999-12-31-23:59:59.5"),
    ("r : TIME; a : DATE := D#2024-03-01; b : DATE := D#2024-02-28;", "r := a - b;", "T#2d"),
    ("r : DT; a : DT := DT#2024-02-28-23:00:00;", "r := a + T#2h;", "DT#2024-02-29-01:00:00"),
    ("r : TIME; a : DT := DT#2024-01-01-00:00:00; b : DT := DT#2023-12-31-23:59:59;", "r := a - b;", "T#1s"),
    ("r : TOD; a : TOD := TOD#10:00:00;", "r := a - T#30m;", "TOD#09:30:00"),
    ("r : TIME; a : TOD := TOD#10:00:00;", "r := SUB_TOD_TOD(a, TOD#09:00:00);", "T#1h"),
    ("r : DATE; a : DT := DT#2024-02-29-13:00:00;", "r := DT_TO_DATE(a);", "D#2024-02-29"),
    ("r : TOD; a : DT := DT#1969-12-31-13:00:00;", "r := DATE_AND_TIME_TO_TIME_OF_DAY(a);", "TOD#13:00:00"),
    ("r : BOOL; a : DATE := D#2024-03-01;", "r := a > D#2024-02-29 AND a = D#2024-03-01;", "TRUE"),
    ("r : DT; a : DATE := D#2024-03-01;", "r := CONCAT_DATE_TOD(a, TOD#06:00:00);", "DT#2024-03-01-06:00:00"),
    ("r : DATE;", "r := CONCAT_DATE(2024, 2, 29);", "D#2024-02-29"),
    ("r : TOD;", "r := CONCAT_TOD(1, 2, 3, 4);", "TOD#01:02:03.004"),
    ("r : INT; a : DATE := D#2024-02-29; y, m, d : INT;", "SPLIT_DATE(IN := a, YEAR => y, MONTH => m, DAY => d); r := y + m * 10 + d;", "2073"),
    ("r : INT; a : TOD := TOD#13:14:15.016; h, m, s, ms : INT;", "SPLIT_TOD(IN := a, HOUR => h, MINUTE => m, SECOND => s, MILLISECOND => ms); r := h * 1000 + m * 10 + s + ms;", "13171"),
    // 2024-02-29 was a Thursday; Sunday is 0.
    ("r : INT;", "r := DAY_OF_WEEK(D#2024-02-29);", "4"),
    ("r : DINT; t : TIME := T#1s500ms;", "r := TIME_TO_DINT(t);", "1500"),
    ("r : REAL; t : TIME := T#1s500us;", "r := TIME_TO_REAL(t);", "1000.5"),
    ("r : TIME; n : DINT := 250;", "r := DINT_TO_TIME(n);", "T#250ms"),
    ("r : STRING; d : DATE := D#2024-02-29;", "r := DATE_TO_STRING(d);", "D#2024-02-29"),
    ("r : DATE; s : STRING := '2024-02-29';", "r := STRING_TO_DATE(s);", "D#2024-02-29"),
];

#[test]
fn dates_are_what_the_standard_says() {
    check_cases("", DATES);
}

#[rustfmt::skip]
const PARTS: &[(&str, &str, &str)] = &[
    ("r : BYTE; d : DWORD := 16#12345678;", "r := d.%B1;", "86"),
    ("r : WORD; d : DWORD := 16#12345678;", "r := d.%W1;", "4660"),
    ("r : DWORD := 16#12345678;", "r.%B3 := 16#FF;", "4281620088"),
    ("r : LWORD;", "r.%D1 := 1; r.%W0 := 16#FFFF; r.%X16 := TRUE;", "4295098367"),
    ("r : BOOL; w : WORD := 4;", "r := w.%X2 AND NOT w.%X3;", "TRUE"),
    ("r : WORD;", "r := TO_BIG_ENDIAN(WORD#16#1234);", "13330"),
    ("r : DINT; a : DINT := 1;", "r := TO_BIG_ENDIAN(a);", "16777216"),
    ("r : LWORD; a : LWORD := 1;", "r := FROM_BIG_ENDIAN(a);", "72057594037927936"),
    ("r : INT; a : INT := 16#1234;", "r := TO_BIG_ENDIAN(a);", "13330"),
    ("r : UINT;", "r := WORD_BCD_TO_UINT(16#1234);", "1234"),
    ("r : WORD; a : UINT := 987;", "r := UINT_TO_BCD_WORD(a);", "2439"),
    ("r : BOOL;", "r := IS_VALID_BCD(16#19) AND NOT IS_VALID_BCD(16#1A);", "TRUE"),
    ("r : INT; x : INT := 5; p : REF_TO INT;", "p := REF(x); p^ := p^ + 1; r := x;", "6"),
    ("r : BOOL; p : REF_TO INT; x : INT;", "r := p = NULL; p := ADR(x); r := r AND p <> NULL;", "TRUE"),
    ("r : INT; s : Pair; p : REF_TO Pair;", "p := REF(s); p^.a := 3; p^.b := 4; r := s.a * 10 + s.b;", "34"),
    ("r : INT; a : ARRAY[0..3] OF INT := [1, 2, 3, 4]; p : REF_TO INT; i : INT;", "FOR i := 0 TO 3 DO p := REF(a[i]); r := r + p^; END_FOR", "10"),
    ("r : INT; a : ARRAY[0..3] OF INT := [1, 2, 3, 4]; p : POINTER TO ARRAY[0..3] OF INT;", "p := ADR(a); r := p^[2];", "3"),
    ("r : INT; x : INT; ok : BOOL;", "x := plus(EN := TRUE, a := 1, b := 2, ENO => ok); r := x; IF ok THEN r := r + 100; END_IF", "103"),
    ("r : INT := 7; ok : BOOL := TRUE;", "r := plus(EN := FALSE, a := 1, b := 2, ENO => ok); IF ok THEN r := 0; END_IF", "7"),
    ("r : INT; t : CTU; i : INT;", "FOR i := 1 TO 3 DO t(EN := i <> 2, CU := i = 3, PV := 1); END_FOR r := t.CV;", "1"),
    ("r : Color;", "r := Color.Green;", "Green"),
    ("r : INT; c : Color := Blue;", "CASE c OF Color#Red: r := 1; Color.Green, Blue: r := 2; END_CASE", "2"),
    ("r : INT;", "r := Space.seven() + SPACE.Seven();", "14"),
    ("r : INT; x AT %MW4 : INT; y AT %MB8 : BYTE;", "x := 300; y := 1; r := x;", "257"),
    ("r : BYTE; x AT %MW20 : WORD := 16#1234;", "r := %MB41;", "18"),
    ("r : INT; e : Edges;", "e(up := TRUE, down := TRUE); e(up := TRUE, down := FALSE); e(up := FALSE); e(up := TRUE, down := TRUE); r := e.ups * 10 + e.downs;", "21"),
    ("r : INT; a : ARRAY[1..2, 1..2] OF INT := [1, 2, 3, 4];", "r := a[2, 1];", "3"),
    ("r : DINT;", "r := SIZEOF(r) + SIZEOF(LREAL);", "12"),
    ("r : INT; b : BOOL := TRUE;", "IF b AND_THEN r = 0 OR_ELSE FALSE THEN r := 5; END_IF", "5"),
];

const PART_POUS: &str = "
TYPE Pair : STRUCT a : INT; b : INT; END_STRUCT; Color : (Red, Green, Blue); END_TYPE
FUNCTION plus : INT VAR_INPUT a, b : INT; END_VAR plus := a + b; END_FUNCTION
NAMESPACE Space FUNCTION seven : INT seven := 7; END_FUNCTION END_NAMESPACE
FUNCTION_BLOCK Edges VAR_INPUT up : BOOL R_EDGE; down : BOOL F_EDGE; END_VAR VAR_OUTPUT ups, downs : INT; END_VAR
IF up THEN ups := ups + 1; END_IF IF down THEN downs := downs + 1; END_IF END_FUNCTION_BLOCK
";

#[test]
fn parts_references_and_enables_are_what_the_standard_says() {
    check_cases(PART_POUS, PARTS);
}

const CLASSES: &str = "
INTERFACE Shape METHOD area : INT VAR_INPUT scale : INT; END_VAR END_METHOD METHOD name : STRING[10] END_METHOD END_INTERFACE
FUNCTION_BLOCK ABSTRACT Base IMPLEMENTS Shape
VAR_INPUT size : INT; END_VAR
VAR calls : INT; END_VAR
METHOD PUBLIC ABSTRACT area : INT VAR_INPUT scale : INT; END_VAR END_METHOD
METHOD PUBLIC name : STRING[10] name := 'base'; END_METHOD
METHOD PUBLIC twice : INT twice := THIS.area(2) + area(scale := 2); END_METHOD
METHOD PROTECTED count calls := calls + 1; END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK Square EXTENDS Base
METHOD PUBLIC OVERRIDE area : INT VAR_INPUT scale : INT; END_VAR count(); area := size * size * scale; END_METHOD
METHOD PUBLIC OVERRIDE name : STRING[10] name := 'square'; END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK Cube EXTENDS Square
VAR_OUTPUT volume : INT; END_VAR
METHOD PUBLIC OVERRIDE area : INT VAR_INPUT scale : INT; END_VAR area := 6 * SUPER.area(scale); END_METHOD
volume := size * size * size;
END_FUNCTION_BLOCK
FUNCTION_BLOCK Bigger EXTENDS Cube
SUPER(); volume := volume + 1;
END_FUNCTION_BLOCK
FUNCTION measure : INT VAR_INPUT s : Shape; END_VAR measure := s.area(scale := 1); END_FUNCTION
FUNCTION by_reference : INT VAR_IN_OUT b : Square; END_VAR by_reference := b.area(1); END_FUNCTION
";

#[rustfmt::skip]
const CLASS_CASES: &[(&str, &str, &str)] = &[
    ("r : INT; s : Square;", "s.size := 3; r := s.area(2);", "18"),
    ("r : INT; s : Square;", "s.size := 3; r := s.twice();", "36"),
    ("r : INT; c : Cube;", "c.size := 2; r := c.twice();", "96"),
    ("r : INT; c : Cube;", "c(size := 3); r := c.volume;", "27"),
    ("r : INT; c : Bigger;", "c(size := 3); r := c.volume;", "28"),
    ("r : INT; c : Cube; s : Square; i : Shape;", "c.size := 1; s.size := 2; i := c; r := i.area(1) * 10; i := s; r := r + i.area(1);", "64"),
    ("r : STRING; c : Cube; i : Shape;", "i := c; r := i.name();", "square"),
    ("r : INT; c : Cube;", "c.size := 1; r := measure(c);", "6"),
    ("r : INT; c : Cube;", "c.size := 1; r := by_reference(c);", "6"),
    ("r : BOOL; c : Cube; i : Shape; p : REF_TO Square; q : REF_TO Cube;", "p := REF(c); q ?= p; i ?= p; r := q <> NULL AND i <> NULL;", "TRUE"),
    ("r : BOOL; s : Square; p : REF_TO Square; q : REF_TO Cube;", "p := REF(s); q ?= p; r := q = NULL;", "TRUE"),
    ("r : INT; a : ARRAY[0..1] OF Square; i : INT := 1;", "a[i].size := 4; r := a[i].area(1);", "16"),
];

#[test]
fn methods_are_inherited_overridden_and_chosen_by_the_instance() {
    check_cases(CLASSES, CLASS_CASES);
}

/// A label has the current result of the way by which it is reached.
#[test]
fn a_current_result_reaches_a_label() {
    let text = "
PROGRAM P
VAR_INPUT reset : BOOL; END_VAR
VAR count, copy, n : INT; END_VAR
LD reset
JMPC clear
LD count
ADD 1
JMP done
clear:
LD 100
done:
ST count
ST copy
LD 0
again:
ADD 2
ST n
LT 7
JMPCN over
LD n
JMP again
over:
LD n
ST n
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    m.scan();
    assert_eq!((m.text("count"), m.text("copy")), ("2".into(), "2".into()));
    m.set("reset", fam_soft_plc::Value::Bool(true));
    m.scan();
    assert_eq!(m.text("count"), "100");
    assert_eq!(m.text("n"), "8");
    // One way to the label has no result.
    let text = "PROGRAM P VAR a : BOOL; b : INT; END_VAR
JMP on
LD 1
JMP on
on:
ST b
END_PROGRAM";
    let (_, problems) = fam_soft_plc::parse_project(&[fam_soft_plc::SourceFile::new("p.st", text)]);
    let problems = crate::common::show(&problems);
    assert!(problems.contains("E710"), "{problems}");
}

#[test]
fn lists_of_instructions_run() {
    let text = "
FUNCTION_BLOCK Count VAR_INPUT CU : BOOL; END_VAR VAR_OUTPUT CV : INT; END_VAR
LD CU
JMPCN done
LD CV
ADD 1
ST CV
done:
LD CV
ST CV
END_FUNCTION_BLOCK
FUNCTION Mean : REAL VAR_INPUT a, b : REAL; END_VAR
LD a
ADD b
DIV 2.0
ST Mean
END_FUNCTION
PROGRAM P
VAR a : BOOL := TRUE; b, c, q, s, n : BOOL; x : INT := 5; y, z, loops : INT; f : Count; m : REAL; t : TON; END_VAR
LD a
AND( b
ORN c
)
ST q
STN n
LD a
S s
LD x
MUL 3
SUB 1
ST y
GT 10
ST b
LD x
MAX 9, 2
ST z
CAL f(CU := a)
LD 1.0
Mean 4.0
ST m
LD a
CALC t(IN := a, PT := T#1s)
again:
LD loops
ADD 1
ST loops
LT 4
JMPC again
RET
LD 99
ST y
END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    for (name, expected) in [
        ("q", "TRUE"),
        ("n", "FALSE"),
        ("s", "TRUE"),
        ("y", "14"),
        ("b", "TRUE"),
        ("z", "9"),
        ("f.CV", "1"),
        ("m", "2.5"),
        ("loops", "4"),
    ] {
        assert_eq!(m.text(name), expected, "{name}");
    }
}

#[test]
fn edges_keep_their_inputs() {
    // What a caller has set stays readable at the input.
    let typed = typed(PART_POUS);
    let pou = typed.find_pou("Edges").expect("declared");
    let names: Vec<&str> = typed
        .pou(pou)
        .vars
        .iter()
        .map(|v| typed.var(*v).name.as_str())
        .collect();
    assert_eq!(names[0], "up");
}
