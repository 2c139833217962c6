//! Both forms of Serialize and Deserialize give the same bytes and bring the same state back, for every type.

mod common;

use common::one_mc;
use fam_engineering::BuiltMc;
use fam_engineering::build::build_for;
use fam_engineering::generate::Target;
use fam_soft_plc::layout::{Area, TypeNode, VariableInfo};
use fam_soft_plc::{Elem, Engine, EngineOptions, Instance, Value};
use proptest::prelude::*;
use std::sync::Arc;

const BUDGET_TICKS: u64 = 1000;
const DAY_NS: i64 = 86_400_000_000_000;

/// Every elementary type; strings and dates; arrays of all kinds; structures, enumerations, subranges, nested and derived function
/// blocks; globals.
const EVERY_TYPE: &str = include_str!("cells/types/types.st");

const SMALL: &[&str] = &[
    "PROGRAM M\nVAR x : BOOL; END_VAR\n x := NOT x;\nEND_PROGRAM\n",
    "PROGRAM M\nVAR a : ARRAY[0..9] OF BOOL; b : LREAL; c : SINT; END_VAR\n a[3] := NOT a[3]; b := b + 0.5; c := c - 1;\nEND_PROGRAM\n",
    "VAR_GLOBAL g : INT; END_VAR\nPROGRAM Helper\nVAR n : DINT; END_VAR\n n := n + 3;\nEND_PROGRAM\nPROGRAM M\nVAR_EXTERNAL g : INT; END_VAR\nVAR t : TP; END_VAR\n Helper(); g := g + 1; t(IN := g = 2, PT := T#10ms);\nEND_PROGRAM\n",
];

struct Pair {
    fam: BuiltMc,
    portable: BuiltMc,
}

fn built(logic: &str, inputs: &str) -> Pair {
    let (_dir, path) = one_mc(logic, inputs);
    let one = |target| {
        build_for(&path, target)
            .unwrap_or_else(|p| panic!("{p}"))
            .mcs
            .remove(0)
    };
    Pair {
        fam: one(Target::Fam),
        portable: one(Target::Portable),
    }
}

fn every_type() -> Pair {
    built(
        EVERY_TYPE,
        "[mc.inputs]\nin0 = \"image:in0\"\n[mc.outputs]\nout0 = { field = \"image:out0\", fail_safe = 0 }\n",
    )
}

fn instance(mc: &BuiltMc) -> Instance {
    let engine = Engine::new(EngineOptions::default()).unwrap();
    let module = engine.prepare(&mc.compiled).unwrap();
    Instance::new(&engine, &module).unwrap()
}

fn activate(mc: &BuiltMc, instance: &mut Instance, checkpoint: &[u8]) {
    let mut bytes = checkpoint.to_vec();
    mc.control.activate(&mut bytes, 0, false);
    instance
        .region_mut(mc.checkpoint_region())
        .copy_from_slice(&bytes);
}

fn same_bytes_over(scans: usize, pair: &Pair, feed: impl Fn(&mut Instance)) {
    let (fam, portable) = (&pair.fam, &pair.portable);
    let mut a = instance(fam);
    let mut b = instance(portable);
    assert_eq!(fam.initial_checkpoint, portable.initial_checkpoint);
    activate(fam, &mut a, &fam.initial_checkpoint);
    activate(portable, &mut b, &fam.initial_checkpoint);
    for scan in 1..=scans {
        let time = scan as i64 * 5_000_000;
        for i in [&mut a, &mut b] {
            feed(i);
            i.scan(time, BUDGET_TICKS).unwrap_or_else(|t| panic!("{t}"));
        }
        let checkpoint = a.region(fam.checkpoint_region()).to_vec();
        assert_eq!(
            checkpoint,
            b.region(portable.checkpoint_region()),
            "after scan {scan}"
        );
        // Each goes on from the other's bytes, on an instance that knows nothing.
        if scan % 3 == 0 {
            (a, b) = (instance(fam), instance(portable));
            activate(fam, &mut a, &checkpoint);
            activate(portable, &mut b, &checkpoint);
        }
    }
}

#[test]
fn both_forms_agree_over_scans_and_restores() {
    same_bytes_over(10, &every_type(), |i| {
        i.write("in0", Value::Bool(true)).unwrap()
    });
    for logic in SMALL {
        same_bytes_over(7, &built(logic, ""), |_| {});
    }
}

#[test]
fn the_portable_form_uses_no_extension() {
    let text = every_type().portable.control_st;
    assert!(!text.contains("__"), "{text}");
    assert!(text.contains("FOR fam_i0 := 1 TO 2 DO"), "{text}");
    assert!(
        every_type()
            .fam
            .control_st
            .contains("__REGION_TO_BYTES('state', M_state)")
    );
}

#[test]
fn a_state_that_cannot_be_written_out_is_named() {
    let table = [
        (
            "PROGRAM M\nVAR x : INT; p : REF_TO INT; END_VAR\n p := REF(x); x := p^ + 1;\nEND_PROGRAM\n",
            "the variable `M.p` cannot be serialized one by one: it holds an address",
        ),
        (
            "TYPE S : STRUCT n : INT; which : REF_TO INT; END_STRUCT; END_TYPE\n\
             PROGRAM M\nVAR s : ARRAY[2..3] OF S; x : INT; END_VAR\n s[2].which := REF(x); x := s[2].which^ + 1;\nEND_PROGRAM\n",
            "the variable `M.s[2].which` cannot be serialized one by one: it holds an address",
        ),
    ];
    for (logic, message) in table {
        let (_dir, path) = one_mc(logic, "");
        assert!(build_for(&path, Target::Fam).is_ok(), "{logic}");
        let problems = build_for(&path, Target::Portable).unwrap_err().to_string();
        assert!(
            problems.contains("error[M511]: MC M: ") && problems.contains(message),
            "{problems}"
        );
    }
}

/// All scalars of the state.
fn leaves(mc: &BuiltMc) -> Vec<VariableInfo> {
    let layout = &mc.compiled.layout;
    let region = layout.region_index("state").unwrap();
    let roots = layout
        .roots
        .iter()
        .filter(|r| r.area == Area::Region(region));
    let leaves = roots.flat_map(|r| layout.leaves(r));
    // Which function block an instance is of changes with nothing.
    leaves.filter(|l| !l.path.ends_with(".__TYPE")).collect()
}

/// The bytes of a string that the variable can have: its length, characters of all kinds, zeros.
fn text(wide: bool, len: u32, raw: u64, bytes: &mut [u8]) {
    bytes.fill(0);
    let count = raw % u64::from(len + 1);
    bytes[..4].copy_from_slice(&(count as u32).to_le_bytes());
    let width = if wide { 2 } else { 1 };
    for n in 0..count as usize * width {
        bytes[4 + n] = (raw >> (n * 8 % 57)) as u8;
    }
}

/// A value that the variable can have, from random bits; the edges often.
fn value(ty: &TypeNode, raw: u64) -> Value {
    let pick = raw >> 60;
    match ty {
        TypeNode::Enum { base, values, .. } => {
            Value::from_i128(*base, i128::from(values[raw as usize % values.len()].1))
        }
        TypeNode::Subrange { base, lo, hi } => {
            let span = (hi - lo + 1) as u64;
            Value::from_i128(*base, i128::from(lo + (raw % span) as i64))
        }
        _ => {
            let elem = ty.elem().unwrap();
            match (elem, pick) {
                (Elem::Real, 0) => Value::Real(f32::NAN),
                (Elem::Real, 1) => Value::Real(f32::NEG_INFINITY),
                (Elem::Real, _) => Value::Real(fam_soft_plc::value::canonical_f32(f32::from_bits(
                    raw as u32,
                ))),
                (Elem::Lreal, 0) => Value::Lreal(f64::NAN),
                (Elem::Lreal, 1) => Value::Lreal(f64::INFINITY),
                (Elem::Lreal, _) => {
                    Value::Lreal(fam_soft_plc::value::canonical_f64(f64::from_bits(raw)))
                }
                // Whole days, and times within one.
                (Elem::Date, _) => Value::Date(raw as i64 / DAY_NS * DAY_NS),
                (Elem::Tod, 0) => Value::Tod(DAY_NS - 1),
                (Elem::Tod, _) => Value::Tod((raw as i64).rem_euclid(DAY_NS)),
                (_, 0) => Value::from_i128(elem, elem.limits().unwrap().0),
                (_, 1) => Value::from_i128(elem, elem.limits().unwrap().1),
                _ => Value::from_i128(elem, i128::from(raw)),
            }
        }
    }
}

#[test]
fn any_state_goes_out_and_back() {
    let pair = Arc::new(every_type());
    let leaves = leaves(&pair.fam);
    assert!(leaves.len() > 150, "{}", leaves.len());
    let engine = Engine::new(EngineOptions::default()).unwrap();
    let modules = [&pair.fam, &pair.portable].map(|mc| (mc, engine.prepare(&mc.compiled).unwrap()));
    let state = pair.fam.compiled.layout.region_index("state").unwrap();
    let strategy = prop::collection::vec(any::<u64>(), leaves.len());
    proptest!(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(64) }, |(raws in strategy)| {
        let mut written: Vec<Vec<u8>> = Vec::new();
        let mut live = Vec::new();
        for (mc, module) in &modules {
            let mut i = Instance::new(&engine, module).unwrap();
            for (leaf, raw) in leaves.iter().zip(&raws) {
                if let TypeNode::Text { wide, len } = &*leaf.ty {
                    let range = leaf.offset as usize..(leaf.offset + leaf.len) as usize;
                    text(*wide, *len, *raw, &mut i.region_mut(state)[range]);
                } else {
                    i.write_variable(leaf, value(&leaf.ty, *raw)).unwrap();
                }
            }
            // isActive and wasActive: the program, which does nothing without its input, then Serialize.
            let mut checkpoint = i.region(mc.checkpoint_region()).to_vec();
            let running = fam_engineering::ControlState { is_active: true, was_active: true, recovery_action: 0 };
            mc.control.write(&mut checkpoint, running);
            i.region_mut(mc.checkpoint_region()).copy_from_slice(&checkpoint);
            i.scan(0, BUDGET_TICKS).unwrap();
            written.push(i.region(mc.checkpoint_region()).to_vec());
            live.push(i.region(state).to_vec());
        }
        prop_assert_eq!(&live[0], &live[1]);
        prop_assert_eq!(&written[0], &written[1]);
        prop_assert_eq!(&written[0][pair.fam.control.state.start as usize..pair.fam.control.state.end as usize], &live[0][..]);
        for (mc, module) in &modules {
            let mut i = Instance::new(&engine, module).unwrap();
            activate(mc, &mut i, &written[0]);
            i.scan(5_000_000, BUDGET_TICKS).unwrap();
            prop_assert_eq!(i.region(state), &live[0][..]);
        }
    });
}
