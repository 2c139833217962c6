//! Two versions of a cell: what is said of the difference, and what becomes of the state.

mod common;

use common::{changed, two_stations};
use fam_engineering::changes::line;
use fam_engineering::reload::{
    CarryError, McChange, StateChange, carry_over, compare, state_change,
};
use fam_engineering::{BuiltCell, BuiltMc, build};
use fam_proto::McId;
use fam_soft_plc::{Engine, EngineOptions, Instance, Value};
use proptest::prelude::*;
use std::sync::LazyLock;

static OLD: LazyLock<BuiltCell> = LazyLock::new(|| build(&two_stations()).unwrap());

/// The same cell with a renamed step type, one variable more, one less, one of another type, and others moved by that.
static NEW: LazyLock<BuiltCell> = LazyLock::new(|| {
    let (_dir, built) = changed(&[
        (
            "feeder.st",
            "    arrived : BOOL;\n",
            "    before : LREAL := 2.5;\n    arrived : BOOL;\n",
        ),
        ("feeder.st", "    alarm : BOOL;\n", ""),
        ("feeder.st", "    next : INT;\n", "    next : DINT;\n"),
        (
            "feeder.st",
            "next := (next + 1) MOD 4;",
            "next := (next + 1) MOD 4; before := before + 1.0;",
        ),
        ("cell.toml", "(arrived OR alarm)", "arrived"),
        (
            "cell.toml",
            "watchdog_ms = 500\n\n[mc.inputs]\nPartReady",
            "watchdog_ms = 600\n\n[mc.inputs]\nPartReady",
        ),
    ]);
    built.unwrap_or_else(|p| panic!("{p}"))
});

fn mc<'a>(cell: &'a BuiltCell, name: &str) -> &'a BuiltMc {
    cell.mc(&McId::new(name).unwrap()).unwrap()
}

fn place(mc: &BuiltMc, path: &str) -> std::ops::Range<usize> {
    let variable = mc.state_variables.iter().find(|v| v.path == path);
    let variable = variable.unwrap_or_else(|| panic!("no {path}"));
    let from = (mc.control.state.start + variable.offset) as usize;
    from..from + variable.len as usize
}

#[test]
fn what_changed_is_told_mc_by_mc() {
    let change = compare(&OLD, &NEW);
    let feeder = &change.mcs[&McId::new("Feeder").unwrap()];
    let McChange::Changed { what, state } = feeder else {
        panic!("{feeder:?}");
    };
    assert_eq!(
        line(what),
        "logic; state layout; critical intervals: Pushing is another"
    );
    assert_eq!(state.new, ["Feeder.before"]);
    assert_eq!(state.gone, ["Feeder.alarm"]);
    assert_eq!(
        state.retyped,
        [(
            "Feeder.next".to_owned(),
            "INT".to_owned(),
            "DINT".to_owned()
        )]
    );
    assert!(!state.same_layout && !state.is_complete());
    let press = &change.mcs[&McId::new("Press").unwrap()];
    let McChange::Settings(what) = press else {
        panic!("{press:?}");
    };
    assert_eq!(line(what), "watchdog: 600 ms instead of 500 ms");
    let text = change.to_string();
    for part in [
        "Feeder: changed (logic; state layout; critical intervals: Pushing is another); state is compatible in part",
        "new, starts from its initial value: Feeder.before",
        "DINT instead of INT, starts from its initial value: Feeder.next",
        "gone: Feeder.alarm",
        "Press: runs on with other settings (watchdog: 600 ms instead of 500 ms)",
    ] {
        assert!(text.contains(part), "expected `{part}` in:\n{text}");
    }
    assert!(
        compare(&OLD, &OLD)
            .mcs
            .values()
            .all(|c| *c == McChange::Same)
    );
}

#[test]
fn values_are_carried_over_by_name_and_type() {
    let (old, new) = (mc(&OLD, "Feeder"), mc(&NEW, "Feeder"));
    let mut checkpoint = old.initial_checkpoint.clone();
    for (path, value) in [("fed", 77u8), ("Feeder.i", 3), ("Feeder.next", 2)] {
        checkpoint[place(old, path).start] = value;
    }
    let weights = place(old, "Feeder.weights");
    checkpoint[weights.clone()].fill(9);
    let carried = carry_over(old, new, &checkpoint).unwrap();
    assert_eq!(carried.len(), new.initial_checkpoint.len());
    assert_eq!(carried[place(new, "fed").start], 77);
    assert_eq!(carried[place(new, "Feeder.i").start], 3);
    assert_eq!(carried[place(new, "Feeder.weights")], checkpoint[weights]);
    // Of another type, and new: initial.
    assert_eq!(carried[place(new, "Feeder.next")], [0; 4]);
    assert_eq!(carried[place(new, "Feeder.before")], 2.5f64.to_le_bytes());
}

#[test]
fn a_state_in_a_critical_interval_or_a_recovery_is_not_carried_over() {
    let (old, new) = (mc(&OLD, "Feeder"), mc(&NEW, "Feeder"));
    let mut critical = old.initial_checkpoint.clone();
    critical[place(old, "Feeder.step").start] = 1;
    assert_eq!(
        carry_over(old, new, &critical),
        Err(CarryError::Critical("Pushing".to_owned()))
    );
    let mut recovering = old.initial_checkpoint.clone();
    old.control.activate(&mut recovering, 1, false);
    assert_eq!(
        carry_over(old, new, &recovering),
        Err(CarryError::Recovering(1))
    );
    let short = &old.initial_checkpoint[1..];
    assert!(matches!(
        carry_over(old, new, short),
        Err(CarryError::Length { .. })
    ));
}

/// Versions of one MC.
fn versions(old: &str, new: &str) -> [BuiltMc; 2] {
    [old, new].map(|logic| {
        let (_dir, path) = common::one_mc(logic, "");
        build(&path).unwrap_or_else(|p| panic!("{p}")).mcs.remove(0)
    })
}

/// Runs an MC for a few scans from a checkpoint.
fn run(mc: &BuiltMc, checkpoint: &[u8], scans: i64) -> Instance {
    let engine = Engine::new(EngineOptions::default()).unwrap();
    let module = engine.prepare(&mc.compiled).unwrap();
    let mut instance = Instance::new(&engine, &module).unwrap();
    let mut bytes = checkpoint.to_vec();
    mc.control.activate(&mut bytes, 0, false);
    instance
        .region_mut(mc.checkpoint_region())
        .copy_from_slice(&bytes);
    for scan in 0..scans {
        instance
            .scan(scan * 5_000_000, 1_000)
            .unwrap_or_else(|t| panic!("{t}"));
    }
    instance
}

#[test]
fn strings_and_dates_are_carried_over() {
    let logic = |len: &str, more: &str| {
        format!(
            "TYPE L : STRUCT t : STRING[4]; d : DATE; END_STRUCT; END_TYPE\nPROGRAM M\nVAR {more} s : STRING[{len}]; w : WSTRING[3]; \
             a : ARRAY[1..2] OF L; dt : DT; c : CHAR; short : STRING[{len}]; n : INT; END_VAR\n\
             IF n = 0 THEN s := 'abcd'; w := \"$20AC\"; a[2].t := 'xy'; a[2].d := D#2024-02-29; dt := DT#2025-01-01-00:00:01; c := 'q'; END_IF;\n\
             n := n + 1; short := 'z';\nEND_PROGRAM\n"
        )
    };
    let [old, new] = versions(&logic("4", ""), &logic("9", "first : LREAL;"));
    let change = state_change(&old, &new);
    assert_eq!(
        (change.new.len(), change.gone.len(), change.retyped.len()),
        (1, 0, 0),
        "{change}"
    );
    let before = run(&old, &old.initial_checkpoint, 1);
    let checkpoint = before.region(old.checkpoint_region());
    let carried = carry_over(&old, &new, checkpoint).unwrap();
    let after = run(&new, &carried, 1);
    for path in ["M.w", "M.a[2].t", "M.a[2].d", "M.dt", "M.c", "M.s"] {
        let bytes = |mc: &BuiltMc, i: &Instance| {
            let found = mc.compiled.layout.find(path).unwrap();
            let state = mc.compiled.layout.region_index("state").unwrap();
            i.region(state)[found.offset as usize..][..found.len as usize].to_vec()
        };
        let (was, is) = (bytes(&old, &before), bytes(&new, &after));
        assert_eq!(is[..was.len()], was[..], "{path}");
        assert!(is[was.len()..].iter().all(|b| *b == 0), "{path}");
        assert!(was.iter().any(|b| *b != 0), "{path}");
    }
    assert_eq!(after.read("M.n"), Some(Value::Int(2)));
    // What has less room now is told, and not cut in silence.
    let change = state_change(&new, &old);
    let told: Vec<&str> = change.retyped.iter().map(|(p, ..)| p.as_str()).collect();
    assert_eq!(told, ["M.s", "M.short"]);
}

/// Bits at %MX share their bytes: each goes to its own new place, and leaves its neighbours alone.
#[test]
fn markers_are_carried_over_bit_by_bit() {
    let logic = |a: &str, b: &str, c: &str, more: &str| {
        format!(
            "PROGRAM M\nVAR {more} a AT {a} : BOOL; b AT {b} : BOOL; c {c} : BOOL := TRUE; w AT %MW4 : INT; f AT %MX12.0 : ARRAY[0..4] OF BOOL; \
             g AT %MX14.2 : ARRAY[0..2] OF BOOL; n : INT; END_VAR\n\
             IF n = 0 THEN a := TRUE; b := FALSE; c := FALSE; w := -7; f[1] := TRUE; f[4] := TRUE; g[0] := TRUE; END_IF;\nn := n + 1;\nEND_PROGRAM\n"
        )
    };
    let old_text = logic("%MX0.0", "%MX0.1", "AT %MX0.2", "");
    let new_text = logic(
        "%MX0.6",
        "%MX1.0",
        "",
        "first : LREAL; d AT %MX0.0 : BOOL; e AT %MX1.1 : BOOL := TRUE;",
    )
    .replace("%MX14.2", "%MX14.3");
    let [old, new] = versions(&old_text, &new_text);
    let told: Vec<String> = state_change(&old, &new)
        .retyped
        .iter()
        .map(|(p, ..)| p.clone())
        .collect();
    // Its first bit is another one of its byte.
    assert_eq!(told, ["M.g"]);
    let before = run(&old, &old.initial_checkpoint, 1);
    let carried = carry_over(&old, &new, before.region(old.checkpoint_region())).unwrap();
    let after = run(&new, &carried, 1);
    for (path, value) in [
        ("M.a", Value::Bool(true)),
        ("M.b", Value::Bool(false)),
        ("M.c", Value::Bool(false)),
        ("M.d", Value::Bool(false)),
        ("M.e", Value::Bool(true)),
        ("M.w", Value::Int(-7)),
        ("M.f[0]", Value::Bool(false)),
        ("M.f[1]", Value::Bool(true)),
        ("M.f[4]", Value::Bool(true)),
        ("M.g[0]", Value::Bool(false)),
        ("M.n", Value::Int(2)),
    ] {
        assert_eq!(after.read(path), Some(value), "{path}");
    }
}

/// An instance knows of which function block it is by a number that another version may use for another one.
#[test]
fn derived_blocks_and_references_stay_those_of_the_new_version() {
    let logic = |before: &str, variable: &str| {
        format!(
            "{before}FUNCTION_BLOCK Base\nVAR n : INT; END_VAR\nMETHOD PUBLIC Step : INT\n n := n + 1; Step := n; END_METHOD\nEND_FUNCTION_BLOCK\n\
             FUNCTION_BLOCK Twice EXTENDS Base\nMETHOD PUBLIC OVERRIDE Step : INT\n n := n + 2; Step := n; END_METHOD\nEND_FUNCTION_BLOCK\n\
             PROGRAM M\nVAR {variable} one : Base; two : ARRAY[0..1] OF Twice; p : REF_TO Base; seen : INT; END_VAR\n\
             p := REF(two[1]); seen := one.Step() + p^.Step();\nEND_PROGRAM\n"
        )
    };
    let other = "FUNCTION_BLOCK A0\nMETHOD PUBLIC Step : INT\n Step := -99; END_METHOD\nEND_FUNCTION_BLOCK\nFUNCTION_BLOCK A1 EXTENDS A0\nEND_FUNCTION_BLOCK\n";
    let [old, new] = versions(&logic("", ""), &logic(other, "x : LREAL; y : A1;"));
    let change = state_change(&old, &new);
    assert_eq!(change.references, ["M.p"]);
    assert!(!change.is_complete());
    assert!(
        change
            .to_string()
            .contains("a reference, starts from its initial value: M.p"),
        "{change}"
    );
    let before = run(&old, &old.initial_checkpoint, 3);
    assert_eq!(before.read("M.seen"), Some(Value::Int(9)));
    let carried = carry_over(&old, &new, before.region(old.checkpoint_region())).unwrap();
    let after = run(&new, &carried, 1);
    assert_eq!(after.read("M.seen"), Some(Value::Int(12)));
}

proptest! {
    /// There and back, everything that both versions have is as it was.
    #[test]
    fn what_both_versions_have_survives_the_way_there_and_back(bytes in prop::collection::vec(any::<u8>(), 400)) {
        let (old, new) = (mc(&OLD, "Feeder"), mc(&NEW, "Feeder"));
        let mut checkpoint = old.initial_checkpoint.clone();
        for (variable, value) in old.state_variables.iter().zip(bytes.chunks(8)) {
            // The step stays where it is, so that no interval holds.
            if variable.path == "Feeder.step" { continue; }
            let from = (old.control.state.start + variable.offset) as usize;
            let len = (variable.len as usize).min(value.len());
            checkpoint[from..from + len].copy_from_slice(&value[..len]);
        }
        let there = carry_over(old, new, &checkpoint).unwrap();
        let back = carry_over(new, old, &there).unwrap();
        let StateChange { gone, retyped, .. } = state_change(old, new);
        for variable in &old.state_variables {
            let lost = gone.contains(&variable.path) || retyped.iter().any(|(p, ..)| *p == variable.path);
            let at = place(old, &variable.path);
            let expected = if lost { &old.initial_checkpoint[at.clone()] } else { &checkpoint[at.clone()] };
            prop_assert_eq!(&back[at], expected, "{}", variable.path);
        }
        // Between the same versions nothing is lost at all.
        prop_assert_eq!(carry_over(old, old, &checkpoint).unwrap()[old.control.state.start as usize..].to_vec(),
            checkpoint[old.control.state.start as usize..].to_vec());
    }
}
