//! Usual mistakes: one mistake is one error, where a person would look, with a hint where there is one.

use fam_soft_plc::{CheckOptions, Severity, SourceFile, check, parse_project};

/// What is wrong, the text behind `PROGRAM P VAR`, the code, line and column counted in it, and a part of what is said.
const SLIPS: &[(&str, &str, u32, u32, &str)] = &[
    (
        "a : INT; END_VAR\na := 1\na := 2;",
        "E111",
        2,
        7,
        "the `;` after the assignment is missing",
    ),
    (
        "a : INT\nb : INT; END_VAR\na := 1;",
        "E111",
        1,
        8,
        "the `;` after the declaration is missing",
    ),
    (
        "a : INT; END_VAR\nIF a = 1 THEN\na := 2;",
        "E118",
        2,
        1,
        "END_IF",
    ),
    ("a : INT; END_VAR\na = 1;\na := 2;", "E117", 2, 3, "`:=`"),
    (
        "a : INT; END_VAR\nIF a := 1 THEN a := 2; END_IF;",
        "E110",
        2,
        6,
        "`=` compares",
    ),
    (
        "a : INT; END_VAR\nIF a = 1\na := 2;\nEND_IF;",
        "E110",
        2,
        9,
        "THEN is missing here",
    ),
    (
        "a : INT; END_VAR\nFOR a := 1 TO 3\n;\nEND_FOR;",
        "E110",
        2,
        16,
        "DO is missing here",
    ),
    (
        "a : INT; END_VAR\nWHILE a < 3\na := a + 1;\nEND_WHILE;",
        "E110",
        2,
        12,
        "DO is missing here",
    ),
    (
        "a : INT; END_VAR\nCASE a\n1: a := 2;\nEND_CASE;",
        "E110",
        2,
        7,
        "OF is missing here",
    ),
    (
        "a : INT; END_VAR\na := (1 + 2 * 3;\na := 1;",
        "E110",
        2,
        16,
        "`)`",
    ),
    (
        "a : INT; END_VAR\na := 1 + 2) * 3;\na := 1;",
        "E110",
        2,
        11,
        "closes nothing",
    ),
    (
        "s : STRING; a : INT; END_VAR\ns := 'abc;\na := 2;",
        "E102",
        2,
        6,
        "not closed on its line",
    ),
    (
        "s : STRING; a : INT; END_VAR\ns := CONCAT('abc, s);\na := 2;",
        "E102",
        2,
        13,
        "not closed on its line",
    ),
    (
        "a : INT; END_VAR\na := 1; (* begin\na := 2;",
        "E101",
        2,
        9,
        "never closed",
    ),
    (
        "a : INT;\na := 2;\na := 3;",
        "E118",
        0,
        0,
        "a statement stands where its END_VAR should",
    ),
    (
        "a : INT;\nIF a = 2 THEN a := 3; END_IF;",
        "E118",
        0,
        0,
        "`IF` stands where its END_VAR should",
    ),
    (
        "a : INT; END_VAR\nIF a = 1 THEN a := 2;\nELSE IF a = 2 THEN a := 3;\nEND_IF;",
        "E118",
        2,
        1,
        "write ELSIF",
    ),
    (
        "a : INT; END_VAR\nIF a = 1 THEN a := 2;\nELSEIF a = 2 THEN a := 3;\nEND_IF;",
        "E110",
        3,
        1,
        "ELSIF",
    ),
    (
        "a : INT; END_VAR\nIF a = 1 THEN a := 2; ENDIF;\na := 3;",
        "E110",
        2,
        23,
        "END_IF",
    ),
    (
        "a : BOOL; END_VAR\na := 1 == 1;",
        "E110",
        2,
        9,
        "one `=` compares",
    ),
    (
        "a : BOOL; END_VAR\na := 1 != 1;",
        "E104",
        2,
        8,
        "`<>` is not equal",
    ),
    ("a : BOOL; END_VAR\na := a && a;", "E110", 2, 9, "AND joins"),
    ("a : BOOL; END_VAR\na := a | a;", "E104", 2, 8, "OR joins"),
    ("a : INT; END_VAR\na += 1;", "E110", 2, 3, "a := a + 1"),
    ("a : INT; END_VAR\na++;", "E110", 2, 2, "a := a + 1"),
    ("a : INT; END_VAR\na := a % 2;", "E103", 2, 8, "MOD"),
    (
        "a : INT; END_VAR\na := 12abc;",
        "E105",
        2,
        6,
        "cannot begin with a digit",
    ),
    ("a : INT; END_VAR\na := 16#XY;", "E104", 2, 8, "16#FF"),
    (
        "a : INT; END_VAR\na := 16#FG;",
        "E105",
        2,
        6,
        "A to F to the base 16",
    ),
    (
        "1a : INT; b : INT; END_VAR\nb := 1;",
        "E105",
        1,
        1,
        "cannot begin with a digit",
    ),
    (
        "größe, b : INT; END_VAR\ngröße := b;\nb := größe;",
        "E104",
        1,
        1,
        "`größe` is no name",
    ),
    (
        "a : INT = 3; END_VAR\na := 1;",
        "E111",
        1,
        8,
        "`:=` gives a value",
    ),
    (
        "s : STRING; END_VAR\ns := \"abc\";",
        "E302",
        2,
        6,
        "single quotes",
    ),
    (
        "s : WSTRING; END_VAR\ns := 'abc';",
        "E302",
        2,
        6,
        "double quotes",
    ),
    (
        "counter : INT; END_VAR\ncountr := 1;",
        "E301",
        2,
        1,
        "did you mean `counter`?",
    ),
    (
        "limit : INT; END_VAR\nlimit := LIMIT(1, limit, 3);",
        "E403",
        2,
        10,
        "hides the function",
    ),
    (
        "a : INT; END_VAR\nVAR_EXTERNAL g : INT; END_VAR\na := g + g;\ng := a;",
        "E223",
        2,
        14,
        "VAR_GLOBAL",
    ),
    (
        "t : TON; END_VAR\nt(IN := TRUE, PT := 5);",
        "E302",
        2,
        21,
        "T#0s",
    ),
    (
        "a : INT; e : (x, y); END_VAR\nCASE a OF\n1: a := 2;\nx: a := 3;\nEND_CASE;",
        "E302",
        4,
        1,
        "cannot become INT",
    ),
    (
        "a : INT; e : (x, y); END_VAR\nIF e > y THEN a := 1; END_IF;",
        "E305",
        2,
        4,
        "TO_INT(...)",
    ),
    (
        "a : ARRAY[0..1] OF INT; e : (x, y); END_VAR\na[e] := 1;",
        "E315",
        2,
        3,
        "TO_INT(...)",
    ),
];

#[test]
fn one_mistake_is_one_error_where_a_person_would_look() {
    let mut wrong = Vec::new();
    for (text, code, line, column, part) in SLIPS {
        let (line, column) = if *line == 0 {
            (1, 1)
        } else {
            (line + 1, *column)
        };
        let text = format!("PROGRAM P\nVAR {text}\nEND_PROGRAM\n");
        let text = text.replacen("PROGRAM P\nVAR ", "PROGRAM P VAR\n", 1);
        let (project, mut problems) = parse_project(&[SourceFile::new("slip.st", text.as_str())]);
        if problems.is_empty() {
            problems = check(&project, CheckOptions::default())
                .err()
                .unwrap_or_default();
        }
        let errors: Vec<_> = problems
            .iter()
            .filter(|p| p.severity == Severity::Error)
            .collect();
        let said: String = errors.iter().map(ToString::to_string).collect();
        let fits = match errors.as_slice() {
            [one] => {
                let at_var = column == 1 && line == 1 && one.line == 1;
                one.code == *code
                    && (at_var || (one.line, one.column) == (line, column))
                    && said.contains(part)
            }
            _ => false,
        };
        if !fits {
            wrong.push(format!(
                "{text}expected {code} at {line}:{column}, {part}\n{said}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n---\n"));
}

/// Whole texts, for what is wrong between POUs.
const WHOLE: &[(&str, &str, u32, u32, &str)] = &[
    (
        "FUNCTION_BLOCK B VAR_IN_OUT x : INT; END_VAR\nMETHOD PUBLIC M : INT M := x; END_METHOD\nx := 1;\nEND_FUNCTION_BLOCK",
        "E301",
        2,
        28,
        "pass it to the method",
    ),
    (
        "FUNCTION_BLOCK B VAR_IN_OUT x : INT; END_VAR\nMETHOD PUBLIC M : INT M := THIS^.x; END_METHOD\nx := 1;\nEND_FUNCTION_BLOCK",
        "E313",
        2,
        34,
        "pass it to the method",
    ),
    (
        "FUNCTION_BLOCK B VAR_TEMP x : INT; END_VAR\nMETHOD PUBLIC M : INT M := x; END_METHOD\nx := 1;\nEND_FUNCTION_BLOCK",
        "E301",
        2,
        28,
        "pass it to the method",
    ),
    (
        "FUNCTION_BLOCK B\nMETHOD PUBLIC M : INT M := 1; END_METHOD\nMETHOD PUBLIC m : INT m := 2; END_METHOD\nEND_FUNCTION_BLOCK",
        "E201",
        3,
        15,
        "declared twice",
    ),
    (
        "INTERFACE I METHOD M : INT END_METHOD\nMETHOD M END_METHOD END_INTERFACE",
        "E201",
        2,
        8,
        "declared twice",
    ),
];

#[test]
fn mistakes_between_pous_are_told_once_too() {
    for (text, code, line, column, part) in WHOLE {
        let (project, problems) = parse_project(&[SourceFile::new("slip.st", *text)]);
        assert!(problems.is_empty(), "{problems:?}");
        let errors = check(&project, CheckOptions::default())
            .err()
            .unwrap_or_default();
        let said: String = errors.iter().map(ToString::to_string).collect();
        assert_eq!(errors.len(), 1, "{text}\n{said}");
        let found = (errors[0].code.as_str(), errors[0].line, errors[0].column);
        assert_eq!(found, (*code, *line, *column), "{said}");
        assert!(said.contains(part), "{said}");
    }
}

#[test]
fn a_misspelt_end_of_a_pou_ends_it() {
    let text = "PROGRAM P VAR a : INT; END_VAR\na := 1;\nEND_PROGRAMM\nPROGRAM Q VAR b : INT; END_VAR\nb := 1;\nEND_PROGRAM\n";
    let (project, problems) = parse_project(&[SourceFile::new("slip.st", text)]);
    assert_eq!(problems.len(), 1, "{problems:?}");
    assert_eq!((problems[0].line, problems[0].column), (3, 1));
    assert_eq!(project.pous.len(), 2);
}
