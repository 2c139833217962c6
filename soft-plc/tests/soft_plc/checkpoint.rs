//! State survives: the regions of one instance, copied to a fresh one, continue as if nothing had happened.

use fam_soft_plc::Value;

use crate::common::{CYCLE_NS, Machine, compiled, spec};

const TEXT: &str = "
TYPE Step : (Wait, Move, Grip, Done); END_TYPE
VAR_GLOBAL parts : DINT; out AT %QB0 : BYTE; sensor AT %IX0.0 : BOOL; END_VAR
FUNCTION_BLOCK Pid
VAR_INPUT e : REAL; END_VAR VAR_OUTPUT u : REAL; END_VAR VAR i, last : REAL; END_VAR
i := LIMIT(-10.0, i + e * 0.01, 10.0);
u := e * 2.0 + i + (e - last) * 0.5 + SIN(e);
last := e;
END_FUNCTION_BLOCK
PROGRAM P
VAR
  step : Step; ton1 : TON; tof1 : TOF; tp1 : TP; up : CTU; edge : R_TRIG; pid1 : Pid; x : REAL; seed : UDINT := 1;
  history : ARRAY[0..15] OF REAL; slot : USINT; n : UINT;
END_VAR
seed := seed * 1664525 + 1013904223;
edge(CLK := sensor);
CASE step OF
  Wait: IF edge.Q THEN step := Move; END_IF;
  Move: x := x + 0.5; ton1(IN := TRUE, PT := T#70ms); IF ton1.Q THEN ton1(IN := FALSE); step := Grip; END_IF;
  Grip: tp1(IN := TRUE, PT := T#40ms); IF NOT tp1.Q THEN tp1(IN := FALSE); step := Done; END_IF;
  Done: parts := parts + 1; step := Wait;
END_CASE;
tof1(IN := step = Move, PT := T#35ms);
up(CU := edge.Q, R := FALSE, PV := 3);
pid1(e := 1.0 - x);
x := x + pid1.u * 0.01;
history[slot] := x;
slot := (slot + 1) MOD 16;
n := n + 1;
out.0 := tof1.Q; out.1 := up.Q; out.2 := tp1.Q;
END_PROGRAM";

fn drive(m: &mut Machine, k: usize) -> Vec<u8> {
    m.set("sensor", Value::Bool(k % 7 < 3));
    m.scan();
    let mut all = m.instance.outputs().to_vec();
    for index in 0..m.instance.layout().regions.len() {
        all.extend_from_slice(m.instance.region(index));
    }
    all
}

#[test]
fn a_restored_instance_continues_identically() {
    let mc = compiled(TEXT, &spec("P"));
    let mut whole = Machine::of(&mc);
    let trace: Vec<Vec<u8>> = (0..140).map(|k| drive(&mut whole, k)).collect();
    assert!(whole.get("parts") > Value::Int(3));
    for cut in [1, 5, 9, 13, 17, 23, 40] {
        let mut first = Machine::of(&mc);
        for (k, expected) in trace.iter().enumerate().take(cut) {
            assert_eq!(&drive(&mut first, k), expected);
        }
        let mut second = Machine::of(&mc);
        for index in 0..mc.layout.regions.len() {
            let bytes = first.instance.region(index).to_vec();
            second.instance.region_mut(index).copy_from_slice(&bytes);
        }
        second
            .instance
            .outputs_mut()
            .copy_from_slice(first.instance.outputs());
        second.time_ns = cut as i64 * CYCLE_NS;
        for (k, expected) in trace.iter().enumerate().skip(cut) {
            assert_eq!(&drive(&mut second, k), expected, "cut {cut}, scan {k}");
        }
    }
}

#[test]
fn initial_state_instead_of_the_checkpoint_is_noticed() {
    let mc = compiled(TEXT, &spec("P"));
    let mut whole = Machine::of(&mc);
    let trace: Vec<Vec<u8>> = (0..30).map(|k| drive(&mut whole, k)).collect();
    let mut fresh = Machine::of(&mc);
    fresh.time_ns = 10 * CYCLE_NS;
    assert_ne!(drive(&mut fresh, 10), trace[10]);
}
