//! Programs run alone: tasks, instances, inputs, what is shown; and what is said about a project.

use fam_soft_plc::standalone::{self, Options, Shown};
use fam_soft_plc::{
    CheckOptions, Dialect, Engine, EngineOptions, Instance, Interruption, SourceFile, diagnose,
};

use crate::common::show;

fn instance(text: &str, program: Option<&str>) -> (Instance, i64) {
    let options = Options {
        program: program.map(str::to_owned),
        ..Options::default()
    };
    let prepared = standalone::prepare(&[SourceFile::new("a.st", text)], &options)
        .unwrap_or_else(|d| panic!("{}", show(&d)));
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::None,
    })
    .expect("engine");
    let module = engine.prepare(&prepared.mc).expect("module");
    let instance = Instance::new(&engine, &module).expect("instance");
    (instance, prepared.cycle_ns)
}

fn after(text: &str, program: Option<&str>, scans: i64) -> Vec<(String, String)> {
    let (mut instance, cycle) = instance(text, program);
    for scan in 0..scans {
        instance
            .scan(scan * cycle, 2)
            .unwrap_or_else(|t| panic!("{t}"));
    }
    standalone::variables(&instance)
        .into_iter()
        .map(|(path, shown)| {
            let text = match shown {
                Shown::Scalar(v) => v.to_string(),
                Shown::Name(n) | Shown::Text(n) => n,
                other => format!("{other:?}"),
            };
            (path, text)
        })
        .collect()
}

fn value<'a>(all: &'a [(String, String)], path: &str) -> &'a str {
    all.iter().find(|(p, _)| p == path).map_or_else(
        || panic!("{path} is not among {all:?}"),
        |(_, v)| v.as_str(),
    )
}

const CONFIGURED: &str = "
VAR_GLOBAL limit : INT := 3; seen : INT; alarm : BOOL; END_VAR
PROGRAM Count VAR_INPUT step : INT := 1; END_VAR VAR_OUTPUT sum : INT; END_VAR VAR t : TON; END_VAR
sum := sum + step; t(IN := TRUE, PT := T#100ms); alarm := sum >= limit; END_PROGRAM
PROGRAM OnAlarm VAR n : INT; END_VAR n := n + 1; END_PROGRAM
CONFIGURATION C RESOURCE R ON PLC
TASK Fast(INTERVAL := T#20ms, PRIORITY := 1);
TASK Slow(INTERVAL := T#100ms, PRIORITY := 2);
TASK Event(SINGLE := alarm, PRIORITY := 3);
PROGRAM one WITH Fast : Count(sum => seen);
PROGRAM two WITH Slow : Count(step := 10);
PROGRAM three WITH Event : OnAlarm;
END_RESOURCE END_CONFIGURATION";

#[test]
fn tasks_run_their_instances_as_often_as_they_say() {
    let all = after(CONFIGURED, None, 10);
    assert_eq!(value(&all, "one.sum"), "10", "every scan of 20 ms");
    assert_eq!(value(&all, "two.sum"), "20", "every fifth");
    assert_eq!(value(&all, "seen"), "10", "connected");
    // `alarm` rises with the second instance in the first scan, falls with the first one, and rises again in the third.
    assert_eq!(value(&all, "OnAlarm.n"), "2");
    assert_eq!(value(&all, "one.t.ET"), "T#100ms");
    assert!(!all.iter().any(|(p, _)| p.contains("__")), "{all:?}");
}

#[test]
fn one_program_or_block_runs_under_its_own_name() {
    let text = "
FUNCTION_BLOCK Twice VAR_INPUT x : INT := 4; END_VAR VAR_IN_OUT y : INT; END_VAR VAR_OUTPUT z : INT; END_VAR y := y + 1; z := 2 * x; END_FUNCTION_BLOCK
FUNCTION Half : INT VAR_INPUT x : INT := 8; END_VAR Half := x / 2; END_FUNCTION
PROGRAM A VAR n : INT; END_VAR n := n + 1; END_PROGRAM
PROGRAM B VAR n : INT; END_VAR n := n + 1; END_PROGRAM";
    let all = after(text, Some("b"), 3);
    assert_eq!(value(&all, "B.n"), "3");
    assert!(!all.iter().any(|(p, _)| p == "A.n"));
    assert_eq!(value(&after(text, Some("Twice"), 2), "Twice.z"), "8");
    assert_eq!(value(&after(text, Some("Half"), 1), "Half_result"), "4");
    let all = after(text, None, 2);
    assert_eq!((value(&all, "A.n"), value(&all, "B.n")), ("2", "2"));
}

#[test]
fn values_are_written_as_their_literals() {
    let text = "
TYPE Mode : (Off, On); END_TYPE
PROGRAM P VAR m : Mode; s : STRING[4]; t : TIME; b AT %IX1.2 : BOOL; a : ARRAY[1..2] OF INT; w : WORD; END_VAR ; END_PROGRAM";
    let (mut i, _) = instance(text, None);
    for (name, text) in [
        ("m", "On"),
        ("P.s", "'hello'"),
        ("t", "T#2s"),
        ("%IX1.2", "1"),
        ("P.a[2]", "-7"),
        ("w", "16#FF"),
    ] {
        let info = standalone::find(&i, name).unwrap_or_else(|| panic!("{name}"));
        standalone::write(&mut i, &info, text).unwrap_or_else(|e| panic!("{e}"));
    }
    let all: Vec<(String, Shown)> = standalone::variables(&i);
    let of = |path: &str| all.iter().find(|(p, _)| p == path).map(|(_, v)| v.clone());
    assert_eq!(of("P.m"), Some(Shown::Name("On".into())));
    assert_eq!(of("P.s"), Some(Shown::Text("hell".into())));
    assert_eq!(i.read("P.b").map(|v| v.to_string()), Some("TRUE".into()));
    assert_eq!(i.read("P.a[2]").map(|v| v.to_string()), Some("-7".into()));
    let info = standalone::find(&i, "w").expect("w");
    assert!(standalone::write(&mut i, &info, "65536").is_err());
}

#[test]
fn assertions_are_counted() {
    let text = "PROGRAM TestIt VAR check : ASSERT; n : INT; END_VAR
n := n + 1; check(condition := n < 3, message := 'n below 3'); check(condition := TRUE, message := 'x'); END_PROGRAM";
    let (mut i, cycle) = instance(text, Some("TestIt"));
    for scan in 0..4 {
        i.scan(scan * cycle, 2).unwrap_or_else(|t| panic!("{t}"));
    }
    let counts = standalone::assertions(&i);
    assert_eq!(counts.len(), 1);
    assert_eq!((counts[0].passed, counts[0].failed), (6, 2));
    assert_eq!(counts[0].first_failure, "n below 3");
}

fn codes(text: &str, dialect: Dialect) -> Vec<String> {
    let options = CheckOptions {
        dialect,
        ..CheckOptions::default()
    };
    diagnose(&[SourceFile::new("a.st", text)], options)
        .into_iter()
        .map(|d| format!("{} {}", d.code, d.line))
        .collect()
}

#[test]
fn what_is_probably_wrong_is_a_warning() {
    let text = "PROGRAM P
VAR unused : INT; n : INT; u : UINT; q AT %QX0.0 : BOOL; END_VAR
IF u >= 0 THEN n := 1; END_IF;
RETURN;
n := 2;
END_PROGRAM
PROGRAM R
VAR q AT %QX0.0 : BOOL; END_VAR
q := TRUE;
END_PROGRAM
FUNCTION F : INT VAR_INPUT x : INT; END_VAR VAR y : INT; END_VAR
IF x > y THEN RETURN; END_IF;
END_FUNCTION
PROGRAM S VAR n : INT; END_VAR
n := F(n); ABS(n); %QX0.0 := n > 1;
END_PROGRAM
PROGRAM T VAR i : INT; END_VAR
FOR i := 1 TO 3 DO i := i + 1; END_FOR;
END_PROGRAM";
    let found = codes(text, Dialect::Standard);
    for code in [
        "W702 2", "W704 3", "W703 5", "W706 11", "W708 11", "W705 15", "W707 15", "W716 18",
    ] {
        assert!(found.contains(&code.to_owned()), "{code}: {found:?}");
    }
}

#[test]
fn what_other_compilers_refuse_is_a_warning() {
    let text = "FUNCTION_BLOCK B
METHOD PUBLIC M : INT M := 1; END_METHOD
METHOD PUBLIC N : INT N := 1; END_METHOD
END_FUNCTION_BLOCK
FUNCTION_BLOCK D EXTENDS B
METHOD PUBLIC M : INT M := 2; END_METHOD
METHOD PUBLIC OVERRIDE N : INT N := 2; END_METHOD
END_FUNCTION_BLOCK
PROGRAM P VAR
d : D; a__b : INT;
c_ : INT; _ok : INT; a_b_c : INT;
lamp AT %Q* : BOOL;
placed AT %Q* : BOOL;
END_VAR
a__b := d.M(); c_ := d.N(); _ok := a__b; a_b_c := c_ + _ok; lamp := a_b_c > 0; placed := lamp;
END_PROGRAM
CONFIGURATION C RESOURCE R ON PLC PROGRAM p1 : P; END_RESOURCE
VAR_CONFIG R.p1.placed AT %QX0.0 : BOOL; END_VAR
END_CONFIGURATION";
    let found = codes(text, Dialect::Standard);
    assert_eq!(found, ["W717 6", "W718 10", "W718 11", "W720 12"]);
    assert_eq!(codes(text, Dialect::Codesys), ["W720 12"]);

    let twice = "PROGRAM P VAR c AT %Q* : BOOL; END_VAR c := NOT c; END_PROGRAM
CONFIGURATION C RESOURCE R ON PLC PROGRAM p1 : P; PROGRAM p2 : P; END_RESOURCE
VAR_CONFIG R.p1.c AT %QX0.0 : BOOL; R.p2.c AT %QX0.1 : BOOL; END_VAR
END_CONFIGURATION";
    assert_eq!(codes(twice, Dialect::Standard), Vec::<String>::new());
}

#[test]
fn a_mistake_in_one_pou_does_not_hide_those_of_others() {
    let text = "PROGRAM P VAR a : INT; END_VAR
a := ;
b := 1;
END_PROGRAM
PROGRAM R VAR a : INT; END_VAR
a := TRUE;
END_PROGRAM";
    assert_eq!(codes(text, Dialect::Standard), ["E110 2", "E302 6"]);
}

#[test]
fn codesys_converts_numbers_with_a_warning() {
    let text = "PROGRAM P VAR a : INT; d : DINT; b : BYTE; r : REAL; END_VAR
a := d;
b := b + 1;
r := r * b;
d := a AND 7;
END_PROGRAM";
    let strict = codes(text, Dialect::Standard);
    assert!(strict.iter().any(|c| c == "E302 2"), "{strict:?}");
    let liberal = codes(text, Dialect::Codesys);
    assert!(liberal.iter().all(|c| c.starts_with('W')), "{liberal:?}");
    assert!(liberal.contains(&"W710 2".to_owned()), "{liberal:?}");
}
