//! Run-time errors: each stops the scan, and says what happened in which POU and line.

use fam_soft_plc::{Engine, EngineOptions, Instance, TrapKind, Value};

use crate::common::{Machine, compiled, spec};

/// (declarations, statements in lines from 5 on, kind, line, message)
const CASES: &[(&str, &str, TrapKind, u32, &str)] = &[
    (
        "a, d : INT;",
        "a := 1;\na := a / d;",
        TrapKind::DivisionByZero,
        6,
        "division by zero",
    ),
    (
        "a, d : ULINT;",
        "a := a MOD d;",
        TrapKind::DivisionByZero,
        5,
        "division by zero",
    ),
    (
        "t : TIME; d : INT;",
        "t := t / d;",
        TrapKind::DivisionByZero,
        5,
        "division by zero",
    ),
    (
        "a : ARRAY[1..10] OF INT; i : INT := 11;",
        "IF TRUE THEN\na[i] := 1;\nEND_IF",
        TrapKind::Index,
        6,
        "the index 11 is outside 1..10",
    ),
    (
        "a : ARRAY[1..10] OF BOOL; i : LINT := -9223372036854775808;",
        "a[i] := TRUE;",
        TrapKind::Index,
        5,
        "the index -9223372036854775808 is outside 1..10",
    ),
    (
        "a : ARRAY[-5..5] OF INT; i : UDINT := 4294967295;",
        "a[i] := 1;",
        TrapKind::Index,
        5,
        "the index 4294967295 is outside -5..5",
    ),
    (
        "a : ARRAY[0..1, 3..4] OF INT; i : SINT := 2; k : INT;",
        "k := a[1, i];",
        TrapKind::Index,
        5,
        "the index 2 is outside 3..4",
    ),
    (
        "r : INT(0..10); k : INT := 11;",
        "r := k;",
        TrapKind::Range,
        5,
        "the value 11 is outside 0..10",
    ),
    (
        "r : INT(-3..10); k : INT := -4;",
        "r := k;",
        TrapKind::Range,
        5,
        "the value -4 is outside -3..10",
    ),
    (
        "r : INT; k : REAL := 32767.5;",
        "r := REAL_TO_INT(k);",
        TrapKind::Conversion,
        5,
        "the real number does not fit INT",
    ),
    (
        "r : LINT; k : LREAL := 9223372036854775807.0;",
        "r := LREAL_TO_LINT(k);",
        TrapKind::Conversion,
        5,
        "the real number does not fit LINT",
    ),
    (
        "r : UDINT; k : REAL := -1.0;",
        "r := TRUNC(k);",
        TrapKind::Conversion,
        5,
        "the real number does not fit UDINT",
    ),
    (
        "r : INT; z : REAL;",
        "r := REAL_TO_INT(z / z);",
        TrapKind::Conversion,
        5,
        "the real number does not fit INT",
    ),
    (
        "r, k : INT := 2;",
        "r := MUX(k, 1, 2);",
        TrapKind::Index,
        5,
        "MUX has 2 inputs and none with number 2",
    ),
    // In a function of the library: the line is that of the call.
    (
        "r : UINT; w : WORD := 16#00FA; d : DATE;",
        "d := CONCAT_DATE(2024, 1, 1);\nr := WORD_BCD_TO_UINT(w);",
        TrapKind::Range,
        6,
        "the value 10 is outside 0..9 (in the standard function called here)",
    ),
    (
        "r : DT; d : INT := 30;",
        "r := CONCAT_DT(2024, 1, d, 0, 0, 0, 0);\nr := CONCAT_DT(2024, 2, d, 0, 0, 0, 0);",
        TrapKind::Range,
        6,
        "the value 30 is outside 1..29 (in the standard function called here)",
    ),
];

#[test]
fn errors_are_named_with_pou_and_line() {
    for (vars, body, kind, line, message) in CASES {
        let text = format!("PROGRAM P\nVAR\n{vars}\nEND_VAR\n{body}\nEND_PROGRAM\n");
        let trap = Machine::new(&text).try_scan().expect_err(body);
        assert_eq!(
            (
                trap.kind,
                trap.pou.as_str(),
                trap.file.as_str(),
                trap.line,
                trap.message.as_str()
            ),
            (*kind, "P", "test.st", *line, *message),
            "{body}"
        );
    }
}

#[test]
fn values_at_the_edge_do_not_trap() {
    let mut m = Machine::new(
        "PROGRAM P VAR a : ARRAY[-2..2] OF INT; i : INT; r : INT(-5..5); f : LREAL := 32767.49; d : LREAL := -2147483648.0; n : DINT; END_VAR
FOR i := -2 TO 2 DO a[i] := i; END_FOR; r := 5; r := a[-2] - 3; i := LREAL_TO_INT(f); n := LREAL_TO_DINT(d); END_PROGRAM",
    );
    m.scan();
    assert_eq!(m.text("i"), "32767");
    assert_eq!(m.text("n"), "-2147483648");
    assert_eq!(m.text("r"), "-5");
}

#[test]
fn an_enumeration_refuses_numbers_that_are_none_of_its_values() {
    let text = "TYPE M : (A, B := 5, C); Full : (X, Y, Z); END_TYPE
PROGRAM P VAR m : M; f : Full; k : INT; END_VAR
m := INT_TO_M(k);
f := INT_TO_Full(k);
END_PROGRAM";
    for (k, line) in [(0, 0), (5, 4), (6, 4), (3, 3), (-1, 3), (7, 3)] {
        let mut m = Machine::new(text);
        m.set("k", Value::Int(k));
        match m.try_scan() {
            Ok(()) => assert_eq!(line, 0, "{k}"),
            Err(trap) => {
                assert_eq!(
                    (trap.kind, trap.line),
                    (TrapKind::Conversion, line),
                    "{k}: {trap}"
                );
                assert!(
                    trap.message.ends_with(&format!("has no value {k}")),
                    "{trap}"
                );
            }
        }
    }
}

const ENDLESS: &str = "
FUNCTION Busy : INT
VAR_INPUT n : INT; END_VAR
VAR i : INT; END_VAR
FOR i := 1 TO n DO
  Busy := Busy + 1;
END_FOR;
END_FUNCTION
FUNCTION_BLOCK Stuck
VAR_INPUT go : BOOL; END_VAR
VAR n : DINT; k : INT; END_VAR
n := 0;
WHILE go DO
  n := n + 1;
END_WHILE;
END_FUNCTION_BLOCK
PROGRAM P
VAR s : Stuck; ok : INT; run : BOOL; END_VAR
ok := ok + 1;
s(go := run);
END_PROGRAM";

#[test]
fn an_endless_loop_is_stopped_by_fuel_and_named() {
    let mut m = Machine::new(ENDLESS);
    m.scan();
    m.set("run", Value::Bool(true));
    let trap = m.try_scan().expect_err("endless");
    assert_eq!(
        (trap.kind, trap.pou.as_str(), trap.line),
        (TrapKind::EndlessLoop, "Stuck", 13)
    );
    assert_eq!(
        trap.to_string(),
        "the scan took too long and was stopped (endless loop?) in Stuck (test.st, line 13)"
    );
    // The instance stays usable.
    m.set("run", Value::Bool(false));
    m.scan();
    assert_eq!(m.text("ok"), "3");
}

#[test]
fn an_endless_loop_is_stopped_by_ticks() {
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    let module = engine
        .prepare(&compiled(ENDLESS, &spec("P")))
        .expect("module");
    let mut instance = Instance::new(&engine, &module).expect("instance");
    instance.scan(0, 2).expect("no loop yet");
    instance.write("P.run", Value::Bool(true)).expect("write");
    let stop = std::sync::atomic::AtomicBool::new(false);
    let trap = std::thread::scope(|scope| {
        scope.spawn(|| {
            while !stop.load(std::sync::atomic::Ordering::Relaxed) {
                engine.interrupt_tick();
                std::thread::yield_now();
            }
        });
        let result = instance.scan(0, 2);
        stop.store(true, std::sync::atomic::Ordering::Relaxed);
        result.expect_err("endless")
    });
    assert_eq!(
        (trap.kind, trap.pou.as_str(), trap.line),
        (TrapKind::EndlessLoop, "Stuck", 13)
    );
}

#[test]
fn a_loop_that_calls_is_found_wherever_the_time_runs_out() {
    let text = "
FUNCTION_BLOCK Leaf
VAR x : DINT; END_VAR
x := x + 1;
x := x * 3;
END_FUNCTION_BLOCK
PROGRAM P
VAR l : Leaf; END_VAR
REPEAT
  l();
UNTIL FALSE END_REPEAT;
END_PROGRAM";
    let trap = Machine::new(text).try_scan().expect_err("endless");
    assert_eq!((trap.pou.as_str(), trap.line), ("P", 9));
}

#[test]
fn a_trap_inside_an_instance_names_its_block() {
    let text = "
FUNCTION_BLOCK Leaf
VAR_INPUT d : INT; END_VAR
VAR x : DINT; END_VAR
x := 100 / d;
END_FUNCTION_BLOCK
PROGRAM P
VAR list : ARRAY[0..3] OF Leaf; i : INT; END_VAR
FOR i := 3 TO 0 BY -1 DO
  list[i](d := i);
END_FOR;
END_PROGRAM";
    let mut m = Machine::new(text);
    let trap = m.try_scan().expect_err("division");
    assert_eq!(
        (trap.kind, trap.pou.as_str(), trap.line),
        (TrapKind::DivisionByZero, "Leaf", 5)
    );
    assert_eq!(
        trap.to_string(),
        "division by zero in Leaf (test.st, line 5)"
    );
    assert_eq!(m.text("list[1].x"), "100");
}
