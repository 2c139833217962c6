//! Masks hold exactly where the condition holds: against the compiled program and a direct evaluation, over generated
//! conditions and states.

use fam_engineering::masks::masks;
use fam_proto::diagnosis::Mask;
use fam_soft_plc::check::tree::{Expr, Place, StepKind};
use fam_soft_plc::layout::{CompileSpec, RegionSpec};
use fam_soft_plc::{
    CheckOptions, Elem, Engine, EngineOptions, Instance, Interruption, SourceFile, TypedProject,
    Value, check, check_expression, compile, evaluate, parse_project,
};
use proptest::prelude::*;
use std::cell::Cell;

const DECLARATIONS: &str = "
TYPE Mode : (Off := -1, Slow := 2, Fast := 3); END_TYPE
VAR_GLOBAL g : DINT; END_VAR
VAR_GLOBAL CONSTANT LIMIT : INT := 2; END_VAR
PROGRAM M
VAR_EXTERNAL g : DINT; END_VAR
VAR_EXTERNAL CONSTANT LIMIT : INT; END_VAR
VAR
    b0 : BOOL; b1 : BOOL; i : INT; d : DINT; u : UINT; s : SINT; l : LINT; ul : ULINT; w : WORD;
    r : REAL; lr : LREAL; t : TIME; e : Mode; a : ARRAY[1..3] OF INT; p : ARRAY[0..3] OF BYTE; timer : TON;
END_VAR
VAR
";

/// Variables with the constants that they are compared with, and others that they may be compared with.
const COMPARED: &[(&str, &[&str], &[&str])] = &[
    (
        "i",
        &["0", "2", "-3", "32767", "-32768", "LIMIT", "INT#16#10"],
        &["d", "a[2]", "s", "i"],
    ),
    (
        "d",
        &["0", "1", "-2147483648", "70000"],
        &["l", "u", "g", "i"],
    ),
    ("u", &["0", "3", "65535"], &["ul", "d"]),
    ("s", &["-128", "127", "0"], &["i", "lr"]),
    ("l", &["0", "-9223372036854775807", "5"], &["d"]),
    ("ul", &["0", "18446744073709551615"], &["u"]),
    ("w", &["WORD#16#8001", "16#3", "0"], &[]),
    (
        "r",
        &["0.0", "0.1", "-1.5", "2", "1.0e30"],
        &["lr", "i", "r"],
    ),
    ("lr", &["0.0", "0.1", "REAL#0.1", "3"], &["r", "d", "lr"]),
    ("t", &["T#0s", "T#20ms", "T#-1s"], &["timer.ET"]),
    ("timer.ET", &["T#1s", "T#20ms"], &["t"]),
    ("g", &["0", "2"], &["d", "i"]),
    ("a[1]", &["0", "2"], &["a[3]"]),
    ("M.a[3]", &["LIMIT"], &["g"]),
    ("p[2]", &["BYTE#3", "0"], &["w"]),
];
const BOOLS: &[&str] = &[
    "b0",
    "b1",
    "timer.Q",
    "timer.running",
    "w.15",
    "i.0",
    "p[1].7",
    "TRUE",
    "FALSE",
    "e = Fast",
    "e <> Mode#Off",
    "Slow = e",
];
const OPERATORS: &[&str] = &["=", "<>", "<", "<=", ">", ">="];

fn leaf() -> impl Strategy<Value = String> {
    let comparison = (
        prop::sample::select(COMPARED),
        prop::sample::select(OPERATORS),
        any::<prop::sample::Index>(),
        any::<bool>(),
    )
        .prop_map(|((name, constants, others), op, index, swap)| {
            let right: Vec<&str> = constants.iter().chain(others).copied().collect();
            let right = right[index.index(right.len())];
            if swap {
                format!("{right} {op} {name}")
            } else {
                format!("{name} {op} {right}")
            }
        });
    prop_oneof![3 => comparison, 1 => prop::sample::select(BOOLS).prop_map(str::to_owned)]
}

fn condition() -> impl Strategy<Value = String> {
    leaf().prop_recursive(3, 10, 3, |inner| {
        prop_oneof![
            2 => (inner.clone(), inner.clone()).prop_map(|(a, b)| format!("({a}) AND ({b})")),
            2 => (inner.clone(), inner.clone()).prop_map(|(a, b)| format!("({a}) OR ({b})")),
            1 => (inner.clone(), inner.clone()).prop_map(|(a, b)| format!("({a}) XOR ({b})")),
            1 => (inner.clone(), inner.clone()).prop_map(|(a, b)| format!("({a}) = ({b})")),
            1 => (inner.clone(), inner.clone()).prop_map(|(a, b)| format!("({a}) <> ({b})")),
            2 => inner.prop_map(|a| format!("NOT ({a})")),
        ]
    })
}

/// Values near the constants that conditions name.
fn value(elem: Elem, raw: u64) -> Value {
    let n = (raw >> 8) as usize;
    match elem {
        Elem::Real => {
            Value::Real([0.0, 0.1, -1.5, 2.0, f32::NAN, f32::INFINITY, -0.0, 1.0e30][n % 8])
        }
        Elem::Lreal => Value::Lreal(
            [
                0.0,
                0.1,
                f64::from(0.1f32),
                3.0,
                f64::NAN,
                f64::NEG_INFINITY,
                2.0,
                -1.5,
            ][n % 8],
        ),
        Elem::Time => {
            Value::Time([0, 20_000_000, -1_000_000_000, 1_000_000_000, 19_999_999][n % 5])
        }
        _ => {
            let (lo, hi) = elem.limits().unwrap();
            let near = [0, 1, 2, 3, -1, -3, 5, 16, lo, hi, 70_000, 0x8001][n % 12];
            Value::from_i128(elem, near)
        }
    }
}

struct Program {
    typed: TypedProject,
    instance: Instance,
    exprs: Vec<Expr>,
    rows: Vec<Option<Vec<Vec<Mask>>>>,
    conditions: Vec<String>,
}

fn program(engine: &Engine, conditions: Vec<String>) -> Program {
    let mut text = DECLARATIONS.to_owned();
    for k in 0..conditions.len() {
        text.push_str(&format!("    c{k} : BOOL;\n"));
    }
    text.push_str("END_VAR\n");
    for (k, condition) in conditions.iter().enumerate() {
        text.push_str(&format!("    c{k} := {condition};\n"));
    }
    text.push_str("END_PROGRAM\n");
    let (project, found) = parse_project(&[SourceFile::new("m.st", text.clone())]);
    assert!(found.is_empty(), "{found:?}");
    let typed = check(
        &project,
        CheckOptions {
            allow_internal_access: true,
            ..CheckOptions::default()
        },
    )
    .unwrap_or_else(|p| panic!("{}\n{text}", p[0]));
    let spec = CompileSpec {
        entry: "M".into(),
        regions: vec![RegionSpec {
            name: "state".into(),
            programs: vec!["M".into()],
            globals: vec!["g".into()],
            markers: false,
        }],
        ..CompileSpec::default()
    };
    let compiled = compile(&typed, &spec).unwrap_or_else(|p| panic!("{}", p[0]));
    let layout = compiled.layout.clone();
    let locate = |path: &str| {
        layout
            .find(path)
            .and_then(|v| Some((v.offset, v.ty.elem()?)))
    };
    let exprs: Vec<Expr> = conditions
        .iter()
        .map(|c| check_expression(&typed, Some("M"), "", c).unwrap_or_else(|p| panic!("{}", p[0])))
        .collect();
    let rows = exprs
        .iter()
        .zip(&conditions)
        .map(|(expr, c)| match masks(&typed, expr, &locate) {
            Ok(rows) => Some(rows),
            Err(e) if e.message.contains("too large") => None,
            Err(e) => panic!("{c}: {}", e.message),
        })
        .collect();
    let module = engine.prepare(&compiled).unwrap();
    Program {
        typed,
        exprs,
        instance: Instance::new(engine, &module).unwrap(),
        rows,
        conditions,
    }
}

#[test]
fn masks_hold_where_the_condition_holds() {
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::None,
    })
    .unwrap();
    let (compared, held) = (Cell::new(0u32), Cell::new(0u32));
    let cases = (
        prop::collection::vec(condition(), 12),
        prop::collection::vec(prop::collection::vec(any::<u64>(), 40), 24),
    );
    proptest!(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(40) }, |((conditions, states) in cases)| {
        let mut p = program(&engine, conditions);
        let layout = p.instance.layout().clone();
        let leaves: Vec<_> = layout.roots.iter().filter(|r| !r.path.starts_with("M.c")).flat_map(|r| layout.leaves(r)).collect();
        for raws in &states {
            for (leaf, raw) in leaves.iter().zip(raws.iter().cycle()) {
                let v = match &*leaf.ty {
                    fam_soft_plc::TypeNode::Enum { base, values, .. } => {
                        Value::from_i128(*base, i128::from(values[*raw as usize % values.len()].1))
                    }
                    ty => value(ty.elem().unwrap(), raw.rotate_left(leaf.offset % 61)),
                };
                p.instance.write_variable(leaf, v).unwrap();
            }
            let state = p.instance.region(0).to_vec();
            p.instance.scan(0, 1).unwrap();
            for (k, rows) in p.rows.iter().enumerate() {
                let Some(rows) = rows else { continue };
                let by_masks = rows.iter().any(|row| row.iter().all(|m| m.holds(&state)));
                let by_program = p.instance.read(&format!("M.c{k}")).unwrap();
                let direct = evaluate(&p.typed, &p.exprs[k], &|place| load(&p, &state, place)).unwrap();
                prop_assert_eq!(Value::Bool(by_masks), by_program, "{} compiled, rows {:?}", p.conditions[k], rows);
                prop_assert_eq!(Value::Bool(by_masks), direct, "{} evaluated", p.conditions[k]);
                compared.set(compared.get() + 1);
                held.set(held.get() + u32::from(by_masks));
            }
        }
    });
    let (compared, held) = (compared.get(), held.get());
    assert!(compared > 5_000, "{compared}");
    assert!(
        held > compared / 10 && held < compared / 10 * 9,
        "{held} of {compared}"
    );
}

/// The value of a place in the state before the scan.
fn load(p: &Program, state: &[u8], place: &Place) -> Option<Value> {
    let mut whole = place.clone();
    let bit = match whole.steps.last().map(|s| &s.kind) {
        Some(StepKind::Bit(bit)) => Some(*bit),
        _ => None,
    };
    if bit.is_some() {
        whole.steps.pop();
    }
    let variable = p.instance.layout().find(&p.typed.path_of(&whole)?)?;
    let from = variable.offset as usize;
    let elem = variable.ty.elem()?;
    let value = Value::load(
        elem,
        &state[from..from + variable.len.min(elem.cell_bytes()) as usize],
    );
    match bit {
        Some(bit) => Some(Value::Bool(value.as_i128()? >> bit & 1 == 1)),
        None => Some(value),
    }
}
