//! Messages: what is wrong, where, what was expected, what to do.

use fam_soft_plc::{CheckOptions, Diagnostic, SourceFile, check, parse_project};

use crate::common::show;

pub fn diagnose(text: &str) -> Vec<Diagnostic> {
    let (project, diagnostics) = parse_project(&[SourceFile::new("cell.st", text)]);
    if !diagnostics.is_empty() {
        return diagnostics;
    }
    match check(&project, CheckOptions::default()) {
        Ok(typed) => typed.warnings,
        Err(diagnostics) => diagnostics,
    }
}

fn in_program(vars: &str, body: &str) -> String {
    format!("PROGRAM P\nVAR {vars} END_VAR\n{body}\nEND_PROGRAM\n")
}

#[test]
fn a_message_shows_the_line_and_what_to_do() {
    let text = in_program("speed : INT; limit : REAL;", "  speed := limit * 2.0;");
    assert_eq!(
        show(&diagnose(&text)),
        "error[E302]: REAL cannot become INT here
  --> cell.st:3:12 (in P)
  |
3 |   speed := limit * 2.0;
  |            ^^^^^^^^^^^
  = expected: a value of type INT
  = hint: convert it: REAL_TO_INT(...)
"
    );
    let text = in_program("a : INT;", "a = 5;");
    assert_eq!(
        show(&diagnose(&text)),
        "error[E117]: `=` compares and does not assign
  --> cell.st:3:3 (in P)
  |
3 | a = 5;
  |   ^
  = expected: `:=`
"
    );
    let text = in_program("a : INT;", "a := 5\na := 6;");
    assert_eq!(
        show(&diagnose(&text)),
        "error[E111]: the `;` after the assignment is missing
  --> cell.st:3:7 (in P)
  |
3 | a := 5
  |       ^
  = expected: `;`
"
    );
    let text = in_program("x : BOOL;", "IF x THEN\n  x := FALSE;");
    assert_eq!(
        show(&diagnose(&text)),
        "error[E118]: this IF is not closed: `END_PROGRAM` stands where its END_IF should
  --> cell.st:3:1 (in P)
  |
3 | IF x THEN
  | ^^
  = expected: END_IF
"
    );
}

/// (declarations, statements, code, line, column, part of the message)
const CASES: &[(&str, &str, &str, u32, u32, &str)] = &[
    ("a : INT;", "a := ;", "E110", 3, 6, "`;` cannot stand here"),
    ("a : INT;", "a := b;", "E301", 3, 6, "`b` is not declared"),
    (
        "a : INT;",
        "a := 40000;",
        "E302",
        3,
        6,
        "40000 does not fit INT",
    ),
    (
        "a : USINT;",
        "a := -1;",
        "E302",
        3,
        6,
        "-1 does not fit USINT",
    ),
    ("a : BOOL;", "a := 2;", "E302", 3, 6, "2 does not fit BOOL"),
    ("a : TIME;", "a := 5;", "E302", 3, 6, "5 is no duration"),
    (
        "a : INT; b : BOOL;",
        "a := a + b;",
        "E305",
        3,
        6,
        "`+` does not apply to INT and BOOL",
    ),
    (
        "a : INT; b : WORD;",
        "b := b AND a;",
        "E305",
        3,
        6,
        "`AND` does not apply to WORD and INT",
    ),
    (
        "a : LINT; b : ULINT; c : BOOL;",
        "c := a < b;",
        "E305",
        3,
        6,
        "`<` does not apply to LINT and ULINT",
    ),
    (
        "a : INT;",
        "IF a THEN a := 1; END_IF",
        "E308",
        3,
        4,
        "a condition must be BOOL, and this is INT",
    ),
    (
        "a : ARRAY[1..3] OF INT;",
        "a[4] := 1;",
        "E316",
        3,
        3,
        "the index 4 is outside 1..3",
    ),
    (
        "a : ARRAY[1..3] OF INT;",
        "a[1, 2] := 1;",
        "E314",
        3,
        1,
        "this array has 1 dimension, and 2 indices are given",
    ),
    (
        "a : INT;",
        "a.x := 1;",
        "E312",
        3,
        3,
        "`a` is INT and has no fields",
    ),
    (
        "a : INT;",
        "a[1] := 1;",
        "E314",
        3,
        1,
        "`a` is INT and cannot be indexed",
    ),
    (
        "a : TON;",
        "a(INN := TRUE);",
        "E409",
        3,
        3,
        "TON has no parameter `INN`",
    ),
    (
        "a : TON;",
        "a.QQ := TRUE;",
        "E312",
        3,
        3,
        "TON has no variable `QQ`",
    ),
    (
        "a : TON;",
        "a(Q := TRUE);",
        "E408",
        3,
        3,
        "`Q` is in VAR_OUTPUT of TON and cannot stand before `:=`",
    ),
    (
        "a : TON; b : BOOL;",
        "b := a(IN := TRUE);",
        "E403",
        3,
        6,
        "only a function can be called inside an expression",
    ),
    (
        "a : INT;",
        "a(x := 1);",
        "E406",
        3,
        1,
        "INT cannot be called",
    ),
    (
        "a : INT;",
        "a := SQR(a);",
        "E402",
        3,
        6,
        "the function `SQR` is not declared",
    ),
    (
        "a : INT;",
        "a := MAX(a);",
        "E411",
        3,
        6,
        "MAX takes 2 or more arguments",
    ),
    (
        "a : INT; r : REAL;",
        "a := SHL(r, 1);",
        "E306",
        3,
        10,
        "SHL does not apply to REAL",
    ),
    (
        "a : INT;",
        "EXIT;",
        "E413",
        3,
        1,
        "EXIT stands outside of any loop",
    ),
    (
        "a : INT;",
        "CASE a OF 1: a := 1; 1: a := 2; END_CASE",
        "E414",
        3,
        22,
        "this value has a branch already",
    ),
    (
        "a, b : INT;",
        "CASE a OF b: a := 1; END_CASE",
        "E414",
        3,
        11,
        "a label of CASE must be constant",
    ),
    (
        "a : REAL;",
        "FOR a := 1 TO 2 DO END_FOR",
        "E415",
        3,
        5,
        "REAL cannot count a FOR loop",
    ),
    (
        "a : INT;",
        "FOR a := 1 TO 2 BY 0 DO END_FOR",
        "E415",
        3,
        20,
        "the step of a FOR loop cannot be 0",
    ),
    ("a : INT;", "a := a / 0;", "E318", 3, 10, "division by zero"),
    (
        "x AT %IX0.0 : BOOL;",
        "x := TRUE;",
        "E317",
        3,
        1,
        "`x` is located at the input %IX0.0 and cannot be written",
    ),
    (
        "a : INT;",
        "%IX0.0 := TRUE;",
        "E317",
        3,
        1,
        "`%IX0.0` is an input and cannot be written",
    ),
    (
        "x AT %IW0 : BOOL;",
        ";",
        "E207",
        2,
        10,
        "BOOL has 1 bit and `%IW0` has 16 bits",
    ),
    (
        "x AT %QX0.9 : BOOL;",
        ";",
        "E208",
        2,
        10,
        "a byte has bits 0 to 7",
    ),
    (
        "a : INTT;",
        ";",
        "E202",
        2,
        9,
        "the type `INTT` is not declared",
    ),
    (
        "a : STRING[0];",
        ";",
        "E226",
        2,
        9,
        "a string cannot have 0 characters",
    ),
    (
        "a : INT; A : BOOL;",
        ";",
        "E201",
        2,
        14,
        "the variable `A` is declared twice",
    ),
    (
        "a : ARRAY[3..1] OF INT;",
        ";",
        "E210",
        2,
        15,
        "3..1 is no range of indices",
    ),
    (
        "a : ARRAY[1..2] OF INT := [1, 2, 3];",
        ";",
        "E215",
        2,
        31,
        "3 values for an array of 2 elements",
    ),
    (
        "a : INT := TRUE;",
        ";",
        "E302",
        2,
        16,
        "BOOL cannot become INT here",
    ),
    (
        "a : INT; b : INT := a;",
        ";",
        "E217",
        2,
        25,
        "an initial value must be constant",
    ),
    ("a : REFERENCE TO INT;", ";", "E109", 2, 9, "REFERENCE TO"),
    (
        "a : INT;",
        "a := T#5x;",
        "E107",
        3,
        6,
        "`x` does not start with a unit of time",
    ),
    (
        "a : INT;",
        "a := 2#12;",
        "E105",
        3,
        6,
        "`2` is no digit of a number with base 2",
    ),
    (
        "a : INT;",
        "a := 5; (* open",
        "E101",
        3,
        9,
        "this comment or pragma is never closed",
    ),
    (
        "a : INT;",
        "{{ if (0) { if (1) { a = 1; }}}} a := 1;",
        "E104",
        3,
        1,
        "code of another language cannot be run",
    ),
    (
        "for : INT;",
        ";",
        "E112",
        2,
        5,
        "`FOR` is a reserved word and no name",
    ),
    (
        "m : (Red, Green); n : INT;",
        "m := 1;",
        "E302",
        3,
        6,
        "an integer literal cannot become (Red, Green) here",
    ),
    (
        "m : (Red, Green); n : INT;",
        "n := m;",
        "E302",
        3,
        6,
        "(Red, Green) cannot become INT here",
    ),
    ("a : INT;", "P();", "E410", 1, 9, "P calls itself: P > P"),
    (
        "a : INT; b : INT;",
        "a := b := 3;",
        "E116",
        3,
        8,
        "only one assignment can stand in a statement",
    ),
];

#[test]
fn each_mistake_has_its_message_at_its_place() {
    let mut wrong = Vec::new();
    for (vars, body, code, line, column, message) in CASES {
        let diagnostics = diagnose(&in_program(vars, body));
        let fits = diagnostics.iter().any(|d| {
            d.code == *code && (d.line, d.column) == (*line, *column) && d.message.contains(message)
        });
        if !fits {
            wrong.push(format!(
                "{vars} {body}\nexpected {code} {line}:{column} {message}\n{}",
                show(&diagnostics)
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn many_errors_come_in_one_run_in_the_order_of_the_text() {
    let text = in_program(
        "a : INT; b : BOOL;",
        "a := x;\nb := ;\na := 7\nb := TRUE;\nIF a THN b := FALSE; END_IF;\na := y;",
    );
    let lines: Vec<(u32, String)> = diagnose(&text)
        .into_iter()
        .map(|d| (d.line, d.code))
        .collect();
    assert_eq!(
        lines,
        [(4, "E110".into()), (5, "E111".into()), (7, "E110".into())]
    );
    let text = in_program("a : INT; b : BOOL;", "a := x;\nb := a;\na := b;\nc := 1;");
    let lines: Vec<u32> = diagnose(&text).iter().map(|d| d.line).collect();
    assert_eq!(lines, [3, 4, 5, 6]);
}

#[test]
fn declarations_outside_of_pous_are_checked() {
    for (text, code, message) in [
        ("TYPE A : B; B : A; END_TYPE", "E209", "contains itself"),
        (
            "TYPE S : STRUCT s : ARRAY[0..1] OF S; END_STRUCT; END_TYPE",
            "E209",
            "contains itself",
        ),
        (
            "FUNCTION_BLOCK F VAR f : F; END_VAR ; END_FUNCTION_BLOCK",
            "E225",
            "contains an instance of F",
        ),
        (
            "FUNCTION_BLOCK F VAR g : G; END_VAR ; END_FUNCTION_BLOCK FUNCTION_BLOCK G VAR f : F; END_VAR ; END_FUNCTION_BLOCK",
            "E225",
            "contains an instance",
        ),
        (
            "VAR_GLOBAL CONSTANT a : INT := b; b : INT := a; END_VAR",
            "E204",
            "needs its own value",
        ),
        (
            "VAR_GLOBAL CONSTANT a : INT; END_VAR",
            "E205",
            "has no value",
        ),
        (
            "VAR_GLOBAL x : INT; END_VAR PROGRAM x ; END_PROGRAM",
            "E201",
            "`x` is declared twice",
        ),
        (
            "PROGRAM INT ; END_PROGRAM",
            "E201",
            "`INT` is the name of an elementary type",
        ),
        (
            "PROGRAM P VAR_EXTERNAL g : INT; END_VAR ; END_PROGRAM",
            "E223",
            "there is no global variable `g`",
        ),
        (
            "VAR_GLOBAL g : DINT; END_VAR PROGRAM P VAR_EXTERNAL g : INT; END_VAR ; END_PROGRAM",
            "E224",
            "is INT here and DINT in VAR_GLOBAL",
        ),
        (
            "PROGRAM P VAR_IN_OUT a : INT; END_VAR ; END_PROGRAM",
            "E220",
            "a PROGRAM cannot have VAR_IN_OUT",
        ),
        (
            "FUNCTION F : INT VAR t : TON; END_VAR F := 1; END_FUNCTION",
            "E222",
            "cannot stand in VAR of a FUNCTION",
        ),
        (
            "FUNCTION_BLOCK F VAR x AT %IX0.0 : BOOL; END_VAR ; END_FUNCTION_BLOCK",
            "E206",
            "cannot be located",
        ),
        (
            "FUNCTION_BLOCK F EXTENDS G ; END_FUNCTION_BLOCK",
            "E230",
            "there is no function block `G`",
        ),
        (
            "FUNCTION_BLOCK F METHOD ABSTRACT M END_METHOD END_FUNCTION_BLOCK",
            "E234",
            "must be ABSTRACT itself",
        ),
        ("PROGRAM P VAR a : INT; ", "E118", "this VAR is not closed"),
        ("PROGRAM P ;", "E118", "PROGRAM P is not closed"),
        ("a := 5;", "E110", "`a` cannot stand here"),
        (
            "TYPE E1 : (Same); E2 : (Same); END_TYPE PROGRAM P VAR b : BOOL; END_VAR b := Same = Same; END_PROGRAM",
            "E304",
            "several enumerations",
        ),
        (
            "FUNCTION F : INT VAR_INPUT a : INT; END_VAR VAR_IN_OUT b : INT; END_VAR F := a; END_FUNCTION PROGRAM P VAR x : INT; END_VAR x := F(a := 1); END_PROGRAM",
            "E411",
            "the argument for `b` (VAR_IN_OUT) is missing",
        ),
        (
            "FUNCTION F : INT VAR_IN_OUT b : INT; END_VAR F := 1; END_FUNCTION PROGRAM P VAR x : DINT; y : INT; END_VAR y := F(b := x); END_PROGRAM",
            "E412",
            "takes a variable of type INT, and this is DINT",
        ),
        (
            "FUNCTION A : INT A := B(); END_FUNCTION FUNCTION B : INT B := A(); END_FUNCTION",
            "E410",
            "calls itself: A > B > A",
        ),
    ] {
        let diagnostics = diagnose(text);
        let found = diagnostics
            .iter()
            .any(|d| d.code == code && d.message.contains(message));
        assert!(
            found,
            "{text}\nexpected {code} {message}\n{}",
            show(&diagnostics)
        );
    }
}

#[test]
fn a_warning_does_not_stop_the_check() {
    let diagnostics =
        diagnose("FUNCTION F : INT VAR_INPUT a : INT; END_VAR a := a + 1; F := a; END_FUNCTION");
    assert_eq!(diagnostics.len(), 1, "{}", show(&diagnostics));
    assert!(
        diagnostics[0]
            .to_string()
            .starts_with("warning[W701]: `a` is an input and is written here")
    );
}

#[test]
fn a_projects_own_block_replaces_that_of_the_library() {
    let text = "FUNCTION_BLOCK R_TRIG VAR_INPUT CLK : BOOL; END_VAR VAR_OUTPUT Q, extra : BOOL; END_VAR extra := CLK; END_FUNCTION_BLOCK
PROGRAM P VAR r : R_TRIG; x : BOOL; END_VAR r(CLK := TRUE, extra => x); END_PROGRAM";
    assert_eq!(show(&diagnose(text)), "");
}

#[test]
fn a_mistake_in_a_header_does_not_drag_others_along() {
    for body in [
        "IF a > THEN a := 1; ELSE a := 2; END_IF; a := 3;",
        "WHILE a < 3 DOO a := 1; END_WHILE; a := 3;",
        "CASE a + OF 1: a := 1; END_CASE; a := 3;",
        "CASE a OF 1: a := 1; 2 a := 2; 3: a := 4; END_CASE; a := 3;",
        "FOR a = 1 TO 3 DO a := 1; END_FOR; a := 3;",
        "FOR a := 1 TO DO a := 1; END_FOR; a := 3;",
        "REPEAT a := ; UNTIL a > 3 END_REPEAT; a := 3;",
    ] {
        let diagnostics = diagnose(&in_program("a : INT;", body));
        assert_eq!(diagnostics.len(), 1, "{body}\n{}", show(&diagnostics));
    }
}
