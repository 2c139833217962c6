//! Texts that nobody meant: no panic, no exhausted stack, always an answer.

use std::sync::LazyLock;

use fam_soft_plc::{CheckOptions, SourceFile, check, compile, parse_project};
use proptest::prelude::*;

use crate::common::{show, spec};

static ENGINE: LazyLock<wasmtime::Engine> = LazyLock::new(wasmtime::Engine::default);

/// Goes as far as the text allows; answers the diagnostics.
fn attempt(text: &str) -> String {
    let (project, diagnostics) = parse_project(&[SourceFile::new("t.st", text)]);
    let mut out = show(&diagnostics);
    match check(&project, CheckOptions::default()) {
        Err(more) => out.push_str(&show(&more)),
        Ok(typed) => {
            match compile(&typed, &spec("P")) {
                Err(more) => out.push_str(&show(&more)),
                // What is compiled must also be valid.
                Ok(mc) => wasmtime::Module::validate(&ENGINE, &mc.wasm)
                    .unwrap_or_else(|e| panic!("{text}\n{e:?}")),
            }
        }
    }
    out
}

#[test]
fn depth_is_limited_with_a_message() {
    for (open, close) in [("(", ")"), ("-(", ")"), ("NOT (", ")"), ("ABS(", ")")] {
        let text = format!(
            "PROGRAM P VAR x : DINT; END_VAR x := {}1{}; END_PROGRAM",
            open.repeat(5000),
            close.repeat(5000)
        );
        assert!(attempt(&text).contains("nested deeper than"), "{open}");
    }
    let nested = format!(
        "PROGRAM P VAR x : DINT; END_VAR {} x := 1; {} END_PROGRAM",
        "IF x = 1 THEN ".repeat(5000),
        "END_IF; ".repeat(5000)
    );
    assert!(attempt(&nested).contains("nested deeper than"));
    let chain = format!(
        "PROGRAM P VAR x : DINT; END_VAR x := x{}; END_PROGRAM",
        " + x".repeat(100_000)
    );
    assert!(attempt(&chain).contains("a chain of more than 400 operators"));
    let types = format!(
        "TYPE T : {}INT; END_TYPE PROGRAM P VAR x : T; END_VAR ; END_PROGRAM",
        "ARRAY[0..0] OF ".repeat(5000)
    );
    assert!(attempt(&types).contains("nested deeper than"));
    let fields = format!(
        "PROGRAM P VAR x : DINT; END_VAR x := x{}; END_PROGRAM",
        ".a".repeat(5000)
    );
    assert!(attempt(&fields).contains("nested deeper than"));
}

#[test]
fn what_is_within_the_limits_compiles() {
    let deep = format!(
        "PROGRAM P VAR x : DINT; b : BOOL; END_VAR x := {}x{}; b := x > 0{}; {} x := 1; {} END_PROGRAM",
        "(1 + ".repeat(90),
        ")".repeat(90),
        " AND x > 1".repeat(390),
        "IF x = 1 THEN ".repeat(150),
        "END_IF; ".repeat(150)
    );
    assert_eq!(attempt(&deep), "");
}

#[test]
fn structures_that_hold_each_other_many_times_are_answered() {
    let nested = |levels: usize| {
        let types: String = (0..levels)
            .map(|n| format!("S{n} : STRUCT a, b : S{}; END_STRUCT;\n", n + 1))
            .collect();
        format!(
            "TYPE {types}S{levels} : STRUCT v : INT; END_STRUCT; END_TYPE PROGRAM P VAR s : S0; END_VAR s.a := s.b; END_PROGRAM"
        )
    };
    assert!(!attempt(&nested(18)).contains("error"));
    for levels in [30, 60, 100] {
        let said = attempt(&nested(levels));
        assert!(
            said.contains("this structure has 2097152 fields"),
            "{levels}: {said}"
        );
    }
}

#[test]
fn sizes_are_limited_with_a_message() {
    for (decl, message) in [
        (
            "a : ARRAY[0..200000000] OF INT;",
            "more than 134217728 elements",
        ),
        (
            "a : ARRAY[0..9999999] OF ARRAY[0..9999999] OF LREAL;",
            "and an MC has at most",
        ),
        (
            "a : ARRAY[0..9999999] OF LREAL; b, c, d, e, f, g, h : ARRAY[0..9999999] OF LREAL;",
            "and an MC has at most",
        ),
        (
            "a AT %QB65000 : ARRAY[0..1000] OF BYTE;",
            "reaches beyond the process image",
        ),
    ] {
        let out = attempt(&format!("PROGRAM P VAR {decl} END_VAR ; END_PROGRAM"));
        assert!(out.contains(message), "{decl}: {out}");
    }
}

const WORDS: &[&str] = &[
    "PROGRAM P",
    "END_PROGRAM",
    "VAR",
    "END_VAR",
    "FUNCTION F : INT",
    "END_FUNCTION",
    "FUNCTION_BLOCK B",
    "END_FUNCTION_BLOCK",
    "TYPE",
    "END_TYPE",
    "STRUCT",
    "END_STRUCT",
    "x",
    "y",
    "t",
    "F",
    "B",
    "T1",
    ":",
    ":=",
    ";",
    ",",
    "(",
    ")",
    "[",
    "]",
    "..",
    ".",
    "=>",
    "=",
    "INT",
    "BOOL",
    "LREAL",
    "TIME",
    "TON",
    "ARRAY[0..3] OF",
    "1",
    "2.5",
    "16#FF",
    "T#1s",
    "'s'",
    "%IX0.0",
    "%QW1",
    "INT#5",
    "E#a",
    "IF",
    "THEN",
    "ELSE",
    "ELSIF",
    "END_IF",
    "CASE",
    "OF",
    "END_CASE",
    "FOR",
    "TO",
    "BY",
    "DO",
    "END_FOR",
    "WHILE",
    "END_WHILE",
    "REPEAT",
    "UNTIL",
    "END_REPEAT",
    "EXIT",
    "RETURN",
    "AND",
    "OR",
    "NOT",
    "MOD",
    "+",
    "-",
    "*",
    "/",
    "**",
    "<",
    ">",
    "TRUE",
    "VAR_INPUT",
    "VAR_IN_OUT",
    "VAR_GLOBAL",
    "CONSTANT",
    "(* c *)",
    "(*",
    "{",
    "$",
    "é",
    "x : INT;",
    "x := x + 1;",
    "y(x := 1);",
    "CONFIGURATION c",
    "RESOURCE r ON p",
    "TASK",
    "END_CONFIGURATION",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_sequence_of_words_is_answered(words in prop::collection::vec(prop::sample::select(WORDS), 0..60)) {
        attempt(&words.join(" "));
        attempt(&format!("PROGRAM P VAR x, y : INT; t : TON; END_VAR {} END_PROGRAM", words.join(" ")));
    }

    #[test]
    fn any_text_is_answered(text in "\\PC{0,200}") {
        attempt(&text);
        attempt(&format!("<project xmlns=\"http://www.plcopen.org/xml/tc6_0201\">{text}</project>"));
    }
}
