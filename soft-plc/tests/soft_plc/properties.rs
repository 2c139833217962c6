//! Integer arithmetic and conversions against Rust's, over random values and the edges of each type.

use std::fmt::Write;
use std::sync::{LazyLock, Mutex};

use fam_soft_plc::{Elem, Value};
use proptest::prelude::*;

use crate::common::Machine;

const INTS: [Elem; 8] = [
    Elem::Sint,
    Elem::Int,
    Elem::Dint,
    Elem::Lint,
    Elem::Usint,
    Elem::Uint,
    Elem::Udint,
    Elem::Ulint,
];
const BITS: [Elem; 4] = [Elem::Byte, Elem::Word, Elem::Dword, Elem::Lword];

/// One program that computes everything at once, so that it is compiled once.
static MACHINE: LazyLock<Mutex<Machine>> = LazyLock::new(|| {
    let (mut vars, mut body) = (String::new(), String::new());
    for t in INTS.into_iter().chain(BITS) {
        let _ = writeln!(vars, "a_{t}, b_{t} : {t};");
        for s in INTS.into_iter().chain(BITS) {
            let _ = writeln!(vars, "c_{s}_{t} : {t};");
            let _ = writeln!(body, "c_{s}_{t} := {s}_TO_{t}(a_{s});");
        }
    }
    for t in INTS {
        let _ = writeln!(
            vars,
            "add_{t}, sub_{t}, mul_{t}, div_{t}, mod_{t}, abs_{t}, max_{t}, min_{t} : {t}; lt_{t}, ge_{t}, eq_{t} : BOOL; r_{t} : REAL; l_{t} : LREAL;"
        );
        let _ = writeln!(
            body,
            "add_{t} := a_{t} + b_{t}; sub_{t} := a_{t} - b_{t}; mul_{t} := a_{t} * b_{t}; abs_{t} := ABS(a_{t}); max_{t} := MAX(a_{t}, b_{t}); min_{t} := MIN(a_{t}, b_{t});
IF b_{t} <> 0 THEN div_{t} := a_{t} / b_{t}; mod_{t} := a_{t} MOD b_{t}; END_IF;
lt_{t} := a_{t} < b_{t}; ge_{t} := a_{t} >= b_{t}; eq_{t} := a_{t} = b_{t};
r_{t} := {t}_TO_REAL(a_{t}); l_{t} := {t}_TO_LREAL(a_{t});"
        );
    }
    for t in BITS {
        let _ = writeln!(
            vars,
            "and_{t}, or_{t}, xor_{t}, not_{t}, shl_{t}, shr_{t}, rol_{t}, ror_{t} : {t};"
        );
        let _ = writeln!(
            body,
            "and_{t} := a_{t} AND b_{t}; or_{t} := a_{t} OR b_{t}; xor_{t} := a_{t} XOR b_{t}; not_{t} := NOT a_{t};
shl_{t} := SHL(a_{t}, n); shr_{t} := SHR(a_{t}, n); rol_{t} := ROL(a_{t}, n); ror_{t} := ROR(a_{t}, n);"
        );
    }
    Mutex::new(Machine::new(&format!(
        "PROGRAM P VAR n : INT; {vars} END_VAR {body} END_PROGRAM"
    )))
});

/// Rust's own wrapping conversion.
fn wrap(t: Elem, v: i128) -> i128 {
    match t {
        Elem::Sint => (v as i8).into(),
        Elem::Int => (v as i16).into(),
        Elem::Dint => (v as i32).into(),
        Elem::Lint => (v as i64).into(),
        Elem::Usint | Elem::Byte => (v as u8).into(),
        Elem::Uint | Elem::Word => (v as u16).into(),
        Elem::Udint | Elem::Dword => (v as u32).into(),
        _ => (v as u64).into(),
    }
}

fn value(t: Elem, v: i128) -> Value {
    if t.is_signed() {
        Value::Int(v as i64)
    } else {
        Value::Uint(v as u64)
    }
}

fn word() -> impl Strategy<Value = u64> {
    let edges = vec![
        0,
        1,
        2,
        7,
        0x7f,
        0x80,
        0xff,
        0x7fff,
        0x8000,
        0xffff,
        0x7fff_ffff,
        0x8000_0000,
        0xffff_ffff,
        i64::MAX as u64,
        i64::MIN as u64,
        u64::MAX,
        u64::MAX - 1,
    ];
    prop_oneof![
        any::<u64>(),
        prop::sample::select(edges),
        (-200i64..200).prop_map(|v| v as u64)
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn integers_and_bit_strings_agree_with_rust(a in word(), b in word(), n in -3i16..70) {
        let mut m = MACHINE.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        for t in INTS.into_iter().chain(BITS) {
            m.set(&format!("a_{t}"), value(t, wrap(t, a.into())));
            m.set(&format!("b_{t}"), value(t, wrap(t, b.into())));
        }
        m.set("n", Value::Int(n.into()));
        m.scan();
        let get = |m: &Machine, name: String| m.get(&name).as_i128().unwrap_or(i128::MAX);
        for t in INTS {
            let (x, y) = (wrap(t, a.into()), wrap(t, b.into()));
            prop_assert_eq!(get(&m, format!("add_{t}")), wrap(t, x + y));
            prop_assert_eq!(get(&m, format!("sub_{t}")), wrap(t, x - y));
            prop_assert_eq!(get(&m, format!("mul_{t}")), wrap(t, x.wrapping_mul(y)));
            prop_assert_eq!(get(&m, format!("abs_{t}")), wrap(t, x.abs()));
            prop_assert_eq!(get(&m, format!("max_{t}")), x.max(y));
            prop_assert_eq!(get(&m, format!("min_{t}")), x.min(y));
            if y != 0 {
                prop_assert_eq!(get(&m, format!("div_{t}")), wrap(t, x / y));
                prop_assert_eq!(get(&m, format!("mod_{t}")), wrap(t, x % y));
            }
            prop_assert_eq!(m.get(&format!("lt_{t}")), Value::Bool(x < y));
            prop_assert_eq!(m.get(&format!("ge_{t}")), Value::Bool(x >= y));
            prop_assert_eq!(m.get(&format!("eq_{t}")), Value::Bool(x == y));
            prop_assert_eq!(m.get(&format!("r_{t}")), Value::Real(x as f32));
            prop_assert_eq!(m.get(&format!("l_{t}")), Value::Lreal(x as f64));
        }
        for s in INTS.into_iter().chain(BITS) {
            for t in INTS.into_iter().chain(BITS) {
                prop_assert_eq!(get(&m, format!("c_{s}_{t}")), wrap(t, wrap(s, a.into())), "{} to {}", s, t);
            }
        }
        for t in BITS {
            let width = t.bits();
            let (x, y) = (wrap(t, a.into()) as u64, wrap(t, b.into()) as u64);
            let shifted = |v: Option<u64>| if (0..width as i16).contains(&n) { wrap(t, v.unwrap_or(0).into()) } else { 0 };
            prop_assert_eq!(get(&m, format!("and_{t}")), i128::from(x & y));
            prop_assert_eq!(get(&m, format!("or_{t}")), i128::from(x | y));
            prop_assert_eq!(get(&m, format!("xor_{t}")), i128::from(x ^ y));
            prop_assert_eq!(get(&m, format!("not_{t}")), wrap(t, (!x).into()));
            prop_assert_eq!(get(&m, format!("shl_{t}")), shifted(x.checked_shl(n as u32)));
            prop_assert_eq!(get(&m, format!("shr_{t}")), shifted(x.checked_shr(n as u32)));
            let by = i32::from(n).rem_euclid(width as i32) as u32;
            let (rol, ror): (i128, i128) = match t {
                Elem::Byte => ((x as u8).rotate_left(by).into(), (x as u8).rotate_right(by).into()),
                Elem::Word => ((x as u16).rotate_left(by).into(), (x as u16).rotate_right(by).into()),
                Elem::Dword => ((x as u32).rotate_left(by).into(), (x as u32).rotate_right(by).into()),
                _ => (x.rotate_left(by).into(), x.rotate_right(by).into()),
            };
            prop_assert_eq!(get(&m, format!("rol_{t}")), rol);
            prop_assert_eq!(get(&m, format!("ror_{t}")), ror);
        }
    }

    #[test]
    fn folded_constants_equal_computed_values(a in word(), b in word(), op in prop::sample::select(vec!["+", "-", "*", "/", "MOD", "<", ">=", "="]), t in prop::sample::select(INTS.to_vec())) {
        let (x, y) = (wrap(t, a.into()), wrap(t, b.into()));
        prop_assume!(y != 0);
        let ty = if matches!(op, "<" | ">=" | "=") { "BOOL".to_owned() } else { t.to_string() };
        let text = format!("PROGRAM P VAR a : {t} := {x}; b : {t} := {y}; c, d : {ty}; END_VAR c := a {op} b; d := {t}#{x} {op} {t}#{y}; END_PROGRAM");
        let mut m = Machine::new(&text);
        m.scan();
        prop_assert_eq!(m.get("c"), m.get("d"));
    }
}

static REALS: LazyLock<Mutex<Machine>> = LazyLock::new(|| {
    let mut text = String::from("PROGRAM P VAR x : LREAL; f : REAL;\n");
    for t in INTS {
        let _ = writeln!(text, "{t}_ok : BOOL; r_{t}, t_{t}, f_{t} : {t};");
    }
    text.push_str("END_VAR\nf := LREAL_TO_REAL(x);\n");
    for t in INTS {
        let _ = writeln!(
            text,
            "IF {t}_ok THEN r_{t} := LREAL_TO_{t}(x); t_{t} := TRUNC(x); f_{t} := REAL_TO_{t}(f); END_IF;"
        );
    }
    text.push_str("END_PROGRAM");
    Mutex::new(Machine::new(&text))
});

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn reals_round_to_the_nearest_even_integer(x in prop_oneof![-1.0e3..1.0e3f64, -1.0e19..1.0e19f64, (-500i32..500).prop_map(|v| f64::from(v) / 2.0), any::<f64>()]) {
        let mut m = REALS.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        m.set("x", Value::Lreal(x));
        let single = x as f32;
        let in_range = |v: f64, t: Elem| t.limits().is_some_and(|(lo, hi)| v >= lo as f64 && v < (hi + 1) as f64);
        for t in INTS {
            let fits = in_range(x.round_ties_even(), t) && in_range(x.trunc(), t) && in_range(f64::from(single).round_ties_even(), t);
            m.set(&format!("{t}_ok"), Value::Bool(fits));
        }
        m.scan();
        for t in INTS {
            if m.get(&format!("{t}_ok")) == Value::Bool(true) {
                prop_assert_eq!(m.get(&format!("r_{t}")).as_i128(), Some(x.round_ties_even() as i128));
                prop_assert_eq!(m.get(&format!("t_{t}")).as_i128(), Some(x.trunc() as i128));
                prop_assert_eq!(m.get(&format!("f_{t}")).as_i128(), Some(f64::from(single).round_ties_even() as i128));
            }
        }
    }
}
