//! Random well-typed expressions: the compiled program and the evaluation of the typed tree agree, traps included.

use std::fmt::Write;

use fam_soft_plc::{Elem, TrapKind, Value, check_expression, evaluate};
use proptest::prelude::*;
use proptest::test_runner::TestRng;

use crate::common::{Machine, compiled, show, spec, typed};

const NUMBERS: [Elem; 10] = [
    Elem::Sint,
    Elem::Int,
    Elem::Dint,
    Elem::Lint,
    Elem::Usint,
    Elem::Uint,
    Elem::Udint,
    Elem::Ulint,
    Elem::Real,
    Elem::Lreal,
];
const BITS: [Elem; 5] = [Elem::Bool, Elem::Byte, Elem::Word, Elem::Dword, Elem::Lword];

/// Writes expressions of a wanted type.
struct Writer<'a> {
    rng: &'a mut TestRng,
}

impl Writer<'_> {
    fn below(&mut self, n: usize) -> usize {
        (self.rng.random::<u32>() as usize) % n
    }

    fn one<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len())]
    }

    fn literal(&mut self, t: Elem) -> String {
        match t {
            Elem::Bool => self.one(&["TRUE", "FALSE"]).to_owned(),
            Elem::Time => format!("T#{}us", self.below(5_000_000)),
            t if t.is_real() => format!("{t}#{}.{}", self.below(100), self.below(100)),
            t => {
                let (lo, hi) = t.limits().unwrap_or((0, 0));
                let v = match self.below(4) {
                    0 => lo,
                    1 => hi,
                    _ => (self.below(200) as i128 - 100).clamp(lo, hi),
                };
                format!("{t}#{v}")
            }
        }
    }

    fn expr(&mut self, t: Elem, depth: u32) -> String {
        if depth == 0 {
            return match self.below(3) {
                0 => self.literal(t),
                n => format!("{}_{t}", ["a", "b"][n - 1]),
            };
        }
        let d = depth - 1;
        match self.below(8) {
            0 => format!(
                "SEL({}, {}, {})",
                self.expr(Elem::Bool, d),
                self.expr(t, d),
                self.expr(t, d)
            ),
            1 if t != Elem::Bool => format!(
                "LIMIT({}, {}, {})",
                self.expr(t, d),
                self.expr(t, d),
                self.expr(t, d)
            ),
            2 if t != Elem::Bool => format!(
                "{}({}, {})",
                self.one(&["MAX", "MIN"]),
                self.expr(t, d),
                self.expr(t, d)
            ),
            3 => format!(
                "MUX({}, {}, {})",
                self.expr(Elem::Int, 0),
                self.expr(t, d),
                self.expr(t, d)
            ),
            4 | 5 if t == Elem::Bool => {
                let s = if self.below(2) == 0 {
                    self.one(&NUMBERS)
                } else {
                    self.one(&BITS)
                };
                format!(
                    "({} {} {})",
                    self.expr(s, d),
                    self.one(&["=", "<>", "<", "<=", ">", ">="]),
                    self.expr(s, d)
                )
            }
            4 if t == Elem::Time => {
                format!("({} {} {})", self.expr(t, d), self.one(&["*", "/"]), {
                    let n = self.one(&[Elem::Int, Elem::Dint, Elem::Real, Elem::Lreal]);
                    self.expr(n, d)
                })
            }
            4 if t == Elem::Lint => format!("TIME_TO_LINT({})", self.expr(Elem::Time, d)),
            4 if t.is_int() => {
                let s = self.one(&NUMBERS);
                let word = if s.is_real() {
                    self.one(&["TO", "TRUNC"])
                } else {
                    "TO"
                };
                format!("{s}_{word}_{t}({})", self.expr(s, d))
            }
            4 if t.is_bit() => {
                let s = self.one(&[Elem::Int, Elem::Udint, Elem::Byte, Elem::Lword, Elem::Bool]);
                format!("{s}_TO_{t}({})", self.expr(s, d))
            }
            4 if t.is_real() => {
                let s = self.one(&NUMBERS);
                format!("{s}_TO_{t}({})", self.expr(s, d))
            }
            5 if t.is_bit() => format!(
                "{}({}, {})",
                self.one(&["SHL", "SHR", "ROL", "ROR"]),
                self.expr(t, d),
                self.expr(Elem::Int, 0)
            ),
            5 if t.is_real() => format!(
                "{}({})",
                self.one(&["SQRT", "SIN", "ATAN", "ABS", "EXP"]),
                self.expr(t, d)
            ),
            5 if t.is_signed() => format!("ABS(-{})", self.expr(t, 0)),
            6 if t.is_bit() => format!("NOT {}", self.expr(t, d)),
            _ if t.is_bit() => format!(
                "({} {} {})",
                self.expr(t, d),
                self.one(&["AND", "OR", "XOR"]),
                self.expr(t, d)
            ),
            _ if t == Elem::Time => format!(
                "({} {} {})",
                self.expr(t, d),
                self.one(&["+", "-"]),
                self.expr(t, d)
            ),
            _ if t.is_real() => format!(
                "({} {} {})",
                self.expr(t, d),
                self.one(&["+", "-", "*", "/"]),
                self.expr(t, d)
            ),
            _ => format!(
                "({} {} {})",
                self.expr(t, d),
                self.one(&["+", "-", "*", "/", "MOD"]),
                self.expr(t, d)
            ),
        }
    }

    fn value(&mut self, t: Elem) -> Value {
        match t {
            Elem::Real => Value::Real(self.one(&[
                0.0,
                -0.0,
                1.5,
                -2.5,
                3.0e38,
                1.0e-40,
                127.5,
                f32::INFINITY,
            ])),
            Elem::Lreal => {
                Value::Lreal(self.one(&[0.0, -0.0, 1.5, -2.5, 1.0e308, 1.0e-310, 255.5, -1.0e10]))
            }
            t => {
                let (lo, hi) = t.limits().unwrap_or((0, 0));
                let small = (self.below(20) as i128 - 10).clamp(lo, hi);
                let v = self.one(&[lo, hi, 0, 1, small, lo + 1, hi / 2]);
                Value::from_i128(t, v)
            }
        }
    }
}

/// More where somebody asks for them.
fn cases() -> u32 {
    std::env::var("PROPTEST_CASES")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(400)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn compiled_and_evaluated_expressions_agree(seed in any::<u64>()) {
        let mut rng = TestRng::from_seed(proptest::test_runner::RngAlgorithm::ChaCha, &{
            let mut bytes = [0u8; 32];
            bytes[..8].copy_from_slice(&seed.to_le_bytes());
            bytes
        });
        let mut writer = Writer { rng: &mut rng };
        let all: Vec<Elem> = NUMBERS.into_iter().chain(BITS).chain([Elem::Time]).collect();
        let t = writer.one(&all);
        let text = writer.expr(t, 4);
        let mut vars = format!("result : {t};\n");
        for t in &all {
            let _ = writeln!(vars, "a_{t}, b_{t} : {t};");
        }
        let program = format!("PROGRAM P VAR {vars} END_VAR result := {text}; END_PROGRAM");
        let (parsed, problems) = fam_soft_plc::parse_project(&[fam_soft_plc::SourceFile::new("t.st", program.as_str())]);
        prop_assert!(problems.is_empty(), "{}", show(&problems));
        // A constant part may be wrong for all to see: the checker says so, and there is nothing to compare.
        if let Err(problems) = fam_soft_plc::check(&parsed, fam_soft_plc::CheckOptions::default()) {
            prop_assert!(problems.iter().all(|p| p.code == "E318"), "{program}\n{}", show(&problems));
            return Ok(());
        }
        let project = typed(&program);
        let expr = check_expression(&project, Some("P"), "expression", &text).unwrap_or_else(|d| panic!("{}", show(&d)));
        let mut machine = Machine::of(&compiled(&program, &spec("P")));
        for _ in 0..4 {
            for t in &all {
                for name in ["a", "b"] {
                    let value = writer.value(*t);
                    machine.set(&format!("{name}_{t}"), value);
                }
            }
            let evaluated = evaluate(&project, &expr, &|place| machine.instance.read(&project.path_of(place)?));
            match (machine.try_scan(), evaluated) {
                (Ok(()), Ok(value)) => {
                    let found = machine.get("result");
                    // NaNs in memory are canonical.
                    let value = match value {
                        Value::Real(v) if v.is_nan() => Value::Real(f32::from_bits(0x7fc0_0000)),
                        Value::Lreal(v) if v.is_nan() => Value::Lreal(f64::from_bits(0x7ff8_0000_0000_0000)),
                        v => v,
                    };
                    prop_assert_eq!(bits(found), bits(value), "{} = {} and {}", text, found, value);
                }
                (Err(trap), Err(_)) => prop_assert!(trap.kind != TrapKind::Internal, "{trap}"),
                // The evaluation is eager, and the program leaves out the right side of AND and OR where it can.
                (Ok(()), Err(_)) if text.contains("AND") || text.contains("OR") => {}
                (ran, evaluated) => prop_assert!(false, "{program}\nran: {ran:?}, evaluated: {evaluated:?}"),
            }
        }
    }
}

fn bits(value: Value) -> u64 {
    match value {
        Value::Real(v) => v.to_bits().into(),
        Value::Lreal(v) => v.to_bits(),
        v => v.as_i128().unwrap_or(0) as u64,
    }
}
