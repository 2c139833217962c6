//! Two versions of a cell: what is said of the difference, and what becomes of the state.

mod common;

use common::{changed, two_stations};
use fam_engineering::reload::{
    CarryError, McChange, StateChange, carry_over, compare, state_change,
};
use fam_engineering::{BuiltCell, BuiltMc, build};
use fam_proto::McId;
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
    assert_eq!(what, &["logic", "state layout", "critical intervals"]);
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
    assert_eq!(press, &McChange::Settings(vec!["watchdog".to_owned()]));
    let text = change.to_string();
    for part in [
        "Feeder: changed (logic, state layout, critical intervals); state is compatible in part",
        "new, starts from its initial value: Feeder.before",
        "DINT instead of INT, starts from its initial value: Feeder.next",
        "gone: Feeder.alarm",
        "Press: runs on with another watchdog",
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
