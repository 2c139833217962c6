//! The engine: precompiled modules, threads, equal bits.

use fam_soft_plc::{Engine, EngineOptions, Instance, RuntimeError, Value};

use crate::common::{Machine, compiled, spec};

const TEXT: &str =
    "PROGRAM P VAR n : INT; r : LREAL := 0.5; END_VAR n := n + 1; r := SIN(r) ** 1.5; END_PROGRAM";

#[test]
fn a_precompiled_module_runs_and_a_wrong_one_is_refused() {
    let mc = compiled(TEXT, &spec("P"));
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    let module = engine.prepare(&mc).expect("module");
    let bytes = module.serialize().expect("bytes");
    // SAFETY: the bytes come from `serialize`, or are refused before they are run.
    let load = |mc, bytes: &[u8]| unsafe { engine.load_precompiled(mc, bytes) };
    let loaded = load(&mc, &bytes).expect("loads");
    let mut a = Instance::new(&engine, &module).expect("instance");
    let mut b = Instance::new(&engine, &loaded).expect("instance");
    for time in 0..5 {
        a.scan(time, 2).expect("scan");
        b.scan(time, 2).expect("scan");
    }
    assert_eq!(a.region(0), b.region(0));
    assert_eq!(a.read("P.n"), Some(Value::Int(5)));

    assert!(matches!(load(&mc, &bytes[..20]), Err(RuntimeError::Stale)));
    let mut broken = bytes.clone();
    let last = broken.len() - 1;
    broken[last] ^= 1;
    assert!(matches!(load(&mc, &broken), Err(RuntimeError::Stale)));
    let other = compiled(&TEXT.replace("n + 1", "n + 2"), &spec("P"));
    assert!(matches!(
        load(&other, &bytes),
        Err(RuntimeError::OtherLogic { .. })
    ));
}

#[test]
fn an_instance_moves_between_threads() {
    let mut m = Machine::new(TEXT);
    m.scan();
    let mut m = std::thread::spawn(move || {
        m.scan();
        m
    })
    .join()
    .expect("thread");
    m.scan();
    assert_eq!(m.text("n"), "3");
}

#[test]
fn not_a_number_has_the_same_bits_everywhere() {
    let text = "PROGRAM P VAR z : REAL; a : ARRAY[0..3] OF REAL; y : LREAL; b : ARRAY[0..3] OF LREAL; END_VAR
a[0] := z / z; a[1] := SQRT(z - 1.0); a[2] := LN(z - 1.0); a[3] := a[0] * -1.0;
b[0] := y / y; b[1] := SQRT(y - 1.0); b[2] := ACOS(y + 2.0); b[3] := b[0] + a[0]; END_PROGRAM";
    let mut m = Machine::new(text);
    m.scan();
    let bits = |m: &Machine, name: &str| match m.get(name) {
        Value::Real(v) => u64::from(v.to_bits()),
        Value::Lreal(v) => v.to_bits(),
        _ => 0,
    };
    for i in 0..4 {
        assert_eq!(bits(&m, &format!("a[{i}]")), 0x7fc0_0000, "a[{i}]");
        assert_eq!(
            bits(&m, &format!("b[{i}]")),
            0x7ff8_0000_0000_0000,
            "b[{i}]"
        );
    }
}

#[test]
fn two_compilations_give_the_same_bytes() {
    let (a, b) = (compiled(TEXT, &spec("P")), compiled(TEXT, &spec("P")));
    assert_eq!(a.wasm, b.wasm);
    assert_eq!(a.logic_hash, b.logic_hash);
}
