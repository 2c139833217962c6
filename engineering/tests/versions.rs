//! Small changes between two versions of one MC: each is seen, and the state goes over only where it means the same.

mod common;

use common::one_mc;
use fam_engineering::reload::{
    CarryError, McChange, carry_over, compare, kept_ranges, state_change,
};
use fam_engineering::{BuiltCell, BuiltMc, build};

const LAMP: &str = "VAR_GLOBAL Lamp AT %QX0.0 : BOOL; END_VAR\n";
const BACK: &str =
    "FUNCTION_BLOCK Back\nVAR_OUTPUT end : BOOL; END_VAR\n end := TRUE;\nEND_FUNCTION_BLOCK\n";

/// A program with these declarations.
fn logic(types: &str, vars: &str) -> String {
    format!("{types}PROGRAM M\nVAR step : INT; {vars} END_VAR\n step := step + 1;\nEND_PROGRAM\n")
}

fn cell(logic: &str, extra: &str) -> BuiltCell {
    let (_dir, path) = one_mc(logic, extra);
    build(&path).unwrap_or_else(|p| panic!("{logic}{extra}{p}"))
}

/// What is said to have changed.
fn what(old: &BuiltCell, new: &BuiltCell) -> Vec<String> {
    match compare(old, new).mcs.into_values().next().unwrap() {
        McChange::Changed { what, .. } | McChange::Settings(what) => {
            what.iter().map(ToString::to_string).collect()
        }
        other => vec![format!("{other:?}")],
    }
}

#[test]
fn each_change_of_the_model_is_seen() {
    let lamp = format!("{LAMP}{BACK}{}", logic("", ""));
    let outputs = |value: &str| {
        format!("[mc.outputs]\nLamp = {{ field = \"image:Lamp\", fail_safe = {value} }}\n")
    };
    let interval = |name: &str, value: u32| {
        format!(
            "{}[[mc.critical_interval]]\nname = \"{name}\"\ncondition = \"step = 5\"\nkind = \"checkpoint\"\nrecovery = \"Back\"\nrepeatable = true\n[mc.critical_interval.checkpoint_state]\nstep = {value}\n",
            outputs("false")
        )
    };
    let table: [(String, String, &[&str]); 6] = [
        (
            outputs("false"),
            outputs("true"),
            &["outputs: Lamp is another"],
        ),
        (
            format!(
                "cycle_ms = 10\nwatchdog_ms = 900\nsuspect_ms = 90\n{}",
                outputs("false")
            ),
            format!(
                "cycle_ms = 20\nwatchdog_ms = 900\nsuspect_ms = 90\n{}",
                outputs("false")
            ),
            &["cycle: 20 ms instead of 10 ms"],
        ),
        (
            format!("watchdog_ms = 800\nsuspect_ms = 90\n{}", outputs("false")),
            format!("watchdog_ms = 900\nsuspect_ms = 90\n{}", outputs("false")),
            &["watchdog: 900 ms instead of 800 ms"],
        ),
        (
            interval("A", 1),
            interval("A", 2),
            &["critical intervals: A is another"],
        ),
        (
            interval("A", 1),
            interval("B", 1),
            &["critical intervals: B is new, A is gone"],
        ),
        (interval("A", 1), interval("A", 1), &["Same"]),
    ];
    for (old, new, expected) in table {
        let found = what(&cell(&lamp, &old), &cell(&lamp, &new));
        for part in expected {
            assert!(
                found.iter().any(|f| f == part),
                "{part} in {found:?} of {new}"
            );
        }
    }
}

/// Declarations of the old and of the new version, and whether `x` is kept.
const TYPES: [(&str, &str, &str, &str, bool); 11] = [
    ("", "x : INT (0..10);", "", "x : INT (0..10);", true),
    ("", "x : INT (0..10);", "", "x : INT (-1..11);", true),
    ("", "x : INT (0..10);", "", "x : INT (0..9);", false),
    ("", "x : INT (0..10);", "", "x : INT (1..10);", false),
    (
        "TYPE E : (A := 1, B := 2); END_TYPE\n",
        "x : E;",
        "TYPE E : (A := 1, B := 2, C); END_TYPE\n",
        "x : E;",
        true,
    ),
    (
        "TYPE E : (A := 1, B := 2); END_TYPE\n",
        "x : E;",
        "TYPE E : (A := 2, B := 1); END_TYPE\n",
        "x : E;",
        false,
    ),
    (
        "TYPE S : STRUCT a, b : INT; END_STRUCT; END_TYPE\n",
        "x : S;",
        "TYPE S : STRUCT A, b : INT; END_STRUCT; END_TYPE\n",
        "x : S;",
        true,
    ),
    (
        "TYPE S : STRUCT a, b : INT; END_STRUCT; END_TYPE\n",
        "x : ARRAY[0..1] OF S;",
        "TYPE S : STRUCT b, a : INT; END_STRUCT; END_TYPE\n",
        "x : ARRAY[0..1] OF S;",
        false,
    ),
    ("", "x : STRING[4];", "", "x : STRING[9];", true),
    ("", "x : STRING[9];", "", "x : STRING[4];", false),
    (
        "",
        "x : ARRAY[0..3] OF INT;",
        "",
        "x : ARRAY[1..4] OF INT;",
        false,
    ),
];

#[test]
fn a_value_is_kept_where_it_means_the_same() {
    for (old_types, old, new_types, new, is_kept) in TYPES {
        let old_cell = cell(&logic(old_types, old), "");
        let new_cell = cell(&logic(new_types, new), "");
        let change = state_change(&old_cell.mcs[0], &new_cell.mcs[0]);
        let retyped: Vec<&str> = change.retyped.iter().map(|(p, ..)| p.as_str()).collect();
        let expected: &[&str] = if is_kept { &[] } else { &["M.x"] };
        assert_eq!(retyped, expected, "{old_types}{old} {new_types}{new}");
    }
}

fn place(mc: &BuiltMc, path: &str) -> std::ops::Range<usize> {
    let variable = mc.compiled.layout.find(path).unwrap();
    let from = (mc.control.state.start + variable.offset) as usize;
    from..from + variable.len as usize
}

#[test]
fn behind_a_shorter_string_there_is_nothing() {
    let old = cell(&logic("", "x : STRING[4] := 'ab';"), "");
    let new = cell(&logic("", "y : LINT; x : STRING[9] := 'cdefghijk';"), "");
    let (old, new) = (&old.mcs[0], &new.mcs[0]);
    let carried = carry_over(old, new, &old.initial_checkpoint).unwrap();
    let bytes = &carried[place(new, "M.x")];
    assert_eq!(&bytes[..6], b"\x02\0\0\0ab");
    assert!(bytes[6..].iter().all(|b| *b == 0), "{bytes:?}");
}

#[test]
fn addresses_stay_behind_where_the_layout_changes() {
    let old = cell(&logic("", "p : REF_TO INT;"), "");
    let moved = cell(&logic("", "y : LINT; p : REF_TO INT;"), "");
    let (old, moved) = (&old.mcs[0], &moved.mcs[0]);
    let change = state_change(old, moved);
    assert_eq!(change.references, ["M.p"]);
    let at = place(moved, "M.p");
    let copies = |kept: &fam_engineering::reload::KeptRanges, at: &std::ops::Range<usize>| {
        let mut copies = kept.copies.iter();
        copies.any(|(from, to)| *to < at.end && at.start < to + from.len())
    };
    assert!(!copies(&kept_ranges(old, moved), &at));
    assert!(copies(&kept_ranges(old, old), &place(old, "M.p")));
}

#[test]
fn a_state_that_the_new_version_calls_critical_is_not_carried_over() {
    let text = format!("{BACK}{}", logic("", ""));
    let interval = "[[mc.critical_interval]]\nname = \"Low\"\ncondition = \"step < 5\"\nkind = \"checkpoint\"\nrecovery = \"Back\"\n";
    let (old, new) = (cell(&text, ""), cell(&text, interval));
    let (old, new) = (&old.mcs[0], &new.mcs[0]);
    let refused = carry_over(old, new, &old.initial_checkpoint);
    assert_eq!(refused, Err(CarryError::Critical("Low".to_owned())));
    let mut later = old.initial_checkpoint.clone();
    later[place(old, "M.step")][0] = 7;
    assert!(carry_over(old, new, &later).is_ok());
}
