//! `fam bench scan`: the scan time of programs of many kinds against C written by hand for the same work, built with
//! `cc -O2`, both in this process and in turns; the results are compared first.

use anyhow::{Context, Result, bail};
use fam_soft_plc::standalone::{self, Options};
use fam_soft_plc::{Engine, EngineOptions, Instance, Interruption, Module, SourceFile, Value};
use serde_json::{Map, Value as Json, json};
use std::ffi::CString;
use std::fmt::Write as _;
use std::os::raw::c_void;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Programs with their text in both languages.
const PROGRAMS: [(&str, &str, &str); 13] = [
    (
        "arithmetic",
        include_str!("scan/arithmetic.st"),
        include_str!("scan/arithmetic.c"),
    ),
    (
        "state_machine",
        include_str!("scan/state_machine.st"),
        include_str!("scan/state_machine.c"),
    ),
    (
        "timers",
        include_str!("scan/timers.st"),
        include_str!("scan/timers.c"),
    ),
    (
        "array_loop",
        include_str!("scan/array_loop.st"),
        include_str!("scan/array_loop.c"),
    ),
    (
        "matrix",
        include_str!("scan/matrix.st"),
        include_str!("scan/matrix.c"),
    ),
    (
        "structures",
        include_str!("scan/structures.st"),
        include_str!("scan/structures.c"),
    ),
    (
        "nested_blocks",
        include_str!("scan/nested_blocks.st"),
        include_str!("scan/nested_blocks.c"),
    ),
    (
        "strings",
        include_str!("scan/strings.st"),
        include_str!("scan/strings.c"),
    ),
    (
        "transcendental",
        include_str!("scan/transcendental.st"),
        include_str!("scan/transcendental.c"),
    ),
    (
        "pid",
        include_str!("scan/pid.st"),
        include_str!("scan/pid.c"),
    ),
    (
        "crc",
        include_str!("scan/crc.st"),
        include_str!("scan/crc.c"),
    ),
    (
        "sequencer",
        include_str!("scan/sequencer.st"),
        include_str!("scan/sequencer.c"),
    ),
    (
        "sorting",
        include_str!("scan/sorting.st"),
        include_str!("scan/sorting.c"),
    ),
];

const C_HEAD: &str = "#include <stdint.h>\n#include <math.h>\n#include <string.h>\n";
/// Scans whose results are compared.
const COMPARED_SCANS: u64 = 500;
/// Time of one batch, and how many there are; the shortest of each side counts, because a machine can only be slowed.
const BATCH_NS: f64 = 2e6;
const BATCHES: usize = 25;
const CYCLE_NS: i64 = 10_000_000;

/// One program in both languages.
pub struct Pair {
    pub name: String,
    st: String,
    c: String,
}

/// The programs that `only` wants.
pub fn pairs(statements: usize, only: &dyn Fn(&str) -> bool) -> Vec<Pair> {
    let mut pairs: Vec<Pair> = PROGRAMS
        .iter()
        .map(|(name, st, c)| Pair {
            name: (*name).to_owned(),
            st: (*st).to_owned(),
            c: (*c).to_owned(),
        })
        .collect();
    pairs.push(bits(1_000));
    pairs.push(large(statements));
    pairs.retain(|pair| only(&pair.name));
    pairs
}

/// Runs the programs; answers the figures.
pub fn run(pairs: &[Pair]) -> Result<Map<String, Json>> {
    let folder = tempfile::tempdir()?;
    let mut programs = Vec::new();
    let mut log_sum = 0.0;
    for pair in pairs {
        let (ns, c_ns) = measure(pair, folder.path()).with_context(|| pair.name.clone())?;
        let ratio = ns / c_ns;
        log_sum += ratio.ln();
        programs.push(json!({ "name": pair.name, "ns": round(ns), "c_ns": round(c_ns), "ratio": round(ratio) }));
    }
    let geomean = (log_sum / pairs.len() as f64).exp();
    let mut figures = Map::new();
    figures.insert("ratio_geomean".into(), json!(round(geomean)));
    figures.insert("programs".into(), Json::Array(programs));
    Ok(figures)
}

fn round(v: f64) -> f64 {
    (v * 1000.0).round() / 1000.0
}

/// 1,000 BOOL variables, each a function of three others.
fn bits(count: usize) -> Pair {
    let mut st = String::from("PROGRAM P\nVAR\n");
    let mut c = String::from("static struct {\n");
    for i in 0..count {
        let _ = writeln!(st, "b{i} : BOOL;");
        let _ = writeln!(c, "uint8_t b{i};");
    }
    st.push_str("n : DINT; result : LINT;\nEND_VAR\nn := n + 1;\nb0 := n MOD 3 = 0;\nb1 := n MOD 5 < 2;\nb2 := NOT b1;\n");
    c.push_str("int32_t n; int64_t result; } s;\nvoid SCAN(int64_t now) {\ns.n++;\ns.b0 = s.n % 3 == 0;\ns.b1 = s.n % 5 < 2;\ns.b2 = !s.b1;\n");
    for i in 3..count {
        let (x, y, z) = (i - 1, i / 2, (i * 7) % i);
        let (a, b) = match i % 3 {
            0 => (
                format!("b{x} AND NOT b{y} OR b{z}"),
                format!("(s.b{x} & !s.b{y}) | s.b{z}"),
            ),
            1 => (format!("b{x} XOR b{y}"), format!("s.b{x} ^ s.b{y}")),
            _ => (
                format!("(b{x} OR b{y}) AND NOT b{z}"),
                format!("(s.b{x} | s.b{y}) & !s.b{z}"),
            ),
        };
        let _ = writeln!(st, "b{i} := {a};");
        let _ = writeln!(c, "s.b{i} = {b};");
    }
    let last = count - 1;
    let _ = write!(
        st,
        "result := 0;\nIF b{last} THEN result := result + 1; END_IF;\nIF b500 THEN result := result + 2; END_IF;\nEND_PROGRAM\n"
    );
    let _ = write!(
        c,
        "s.result = 0;\nif (s.b{last}) s.result += 1;\nif (s.b500) s.result += 2;\n}}\ndouble RESULT(void) {{ return (double)s.result; }}\n"
    );
    Pair {
        name: "logic".into(),
        st,
        c,
    }
}

/// A large program of IFs, assignments and arithmetic over 500 variables.
fn large(statements: usize) -> Pair {
    const VARIABLES: usize = 500;
    let mut st = String::from("PROGRAM P\nVAR\n");
    let mut c = String::from("static struct {\n");
    for i in 0..VARIABLES {
        let _ = writeln!(st, "v{i} : DINT;");
        let _ = writeln!(c, "int32_t v{i};");
    }
    st.push_str("n : DINT; result : LINT;\nEND_VAR\nn := n + 1;\n");
    c.push_str("int32_t n; int64_t result; } s;\nvoid SCAN(int64_t now) {\ns.n++;\n");
    for i in 0..statements / 2 {
        let (a, b, d) = (
            i % VARIABLES,
            (i * 7 + 3) % VARIABLES,
            (i * 13 + 5) % VARIABLES,
        );
        let k = i % 97;
        let _ = writeln!(
            st,
            "IF v{a} < v{b} + n THEN v{d} := v{a} + {k}; ELSE v{d} := v{b} - v{d} / 2; END_IF;"
        );
        let _ = writeln!(
            c,
            "if (s.v{a} < (int32_t)((uint32_t)s.v{b} + (uint32_t)s.n)) s.v{d} = (int32_t)((uint32_t)s.v{a} + {k}u); else s.v{d} = (int32_t)((uint32_t)s.v{b} - (uint32_t)(s.v{d} / 2));"
        );
    }
    st.push_str("result := v0 + v250;\nEND_PROGRAM\n");
    c.push_str("s.result = (int32_t)((uint32_t)s.v0 + (uint32_t)s.v250);\n}\ndouble RESULT(void) { return (double)s.result; }\n");
    Pair {
        name: "large".into(),
        st,
        c,
    }
}

/// A C program in this process.
struct Native {
    scan: extern "C" fn(i64),
    result: extern "C" fn() -> f64,
}

impl Native {
    fn build(pair: &Pair, folder: &Path) -> Result<Native> {
        let source = folder.join(format!("{}.c", pair.name));
        let library = folder.join(format!("{}.so", pair.name));
        std::fs::write(&source, format!("{C_HEAD}{}", pair.c))?;
        // Signed arithmetic wraps, as in the programs that are compared.
        let status = Command::new("cc")
            .args(["-O2", "-fwrapv", "-shared", "-fPIC", "-o"])
            .arg(&library)
            .arg(&source)
            .arg("-lm")
            .status()
            .context("`cc` cannot be started; install a C compiler")?;
        if !status.success() {
            bail!("cc failed for {}", source.display());
        }
        let path = CString::new(library.display().to_string())?;
        // SAFETY: the library was built just now from text of this program; its functions have the types given here.
        unsafe {
            let handle = libc::dlopen(path.as_ptr(), libc::RTLD_NOW | libc::RTLD_LOCAL);
            if handle.is_null() {
                bail!("{} cannot be loaded", library.display());
            }
            let find = |name: &str| -> Result<*mut c_void> {
                let name = CString::new(name)?;
                let found = libc::dlsym(handle, name.as_ptr());
                if found.is_null() {
                    bail!("{} lacks a function", library.display());
                }
                Ok(found)
            };
            Ok(Native {
                scan: std::mem::transmute::<*mut c_void, extern "C" fn(i64)>(find("SCAN")?),
                result: std::mem::transmute::<*mut c_void, extern "C" fn() -> f64>(find("RESULT")?),
            })
        }
    }
}

/// The machine code of the program.
pub fn compile(pair: &Pair) -> Result<(Engine, Module)> {
    let files = [SourceFile::new(
        format!("{}.st", pair.name),
        pair.st.clone(),
    )];
    let prepared = match standalone::prepare(&files, &Options::default()) {
        Ok(prepared) => prepared,
        Err(diagnostics) => {
            let text: String = diagnostics.iter().map(ToString::to_string).collect();
            bail!("{text}");
        }
    };
    // As in a controller node: a watchdog that can stop an endless loop.
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::Epoch,
    })?;
    let module = engine.prepare(&prepared.mc)?;
    Ok((engine, module))
}

/// Both programs after scans with the same results, and the time of the next scan.
fn compared(pair: &Pair, folder: &Path) -> Result<(Instance, Native, i64)> {
    let (engine, module) = compile(pair)?;
    let mut ours = Instance::new(&engine, &module)?;
    let native = Native::build(pair, folder)?;
    let mut now = 0;
    for scan in 0..COMPARED_SCANS {
        ours.scan(now, 2)
            .map_err(|trap| anyhow::anyhow!("{trap}"))?;
        (native.scan)(now);
        now += CYCLE_NS;
        let (a, b) = (value_of(&ours)?, (native.result)());
        if (a - b).abs() > 1e-9 * b.abs().max(1.0) {
            bail!("after scan {scan} the result is {a}, and that of C is {b}");
        }
    }
    Ok((ours, native, now))
}

/// Nanoseconds of one scan: ours, and that of C.
fn measure(pair: &Pair, folder: &Path) -> Result<(f64, f64)> {
    let (mut ours, native, mut now) = compared(pair, folder)?;
    let mut batch = 1;
    loop {
        let (spent, _) = time(batch, &mut now, |n| ours.scan(n, 2).is_ok());
        if spent * batch as f64 >= BATCH_NS / 2.0 || batch > 1 << 20 {
            break;
        }
        batch *= 2;
    }
    let (mut best, mut best_c) = (f64::MAX, f64::MAX);
    for _ in 0..BATCHES {
        let start = now;
        let (spent, fine) = time(batch, &mut now, |n| ours.scan(n, 2).is_ok());
        if !fine {
            bail!("a scan was stopped");
        }
        best = best.min(spent);
        let mut then = start;
        let (spent, _) = time(batch, &mut then, |n| {
            (native.scan)(n);
            true
        });
        best_c = best_c.min(spent);
    }
    Ok((best, best_c))
}

/// Nanoseconds of one of `count` scans.
fn time(count: u64, now: &mut i64, mut scan: impl FnMut(i64) -> bool) -> (f64, bool) {
    let begin = Instant::now();
    let mut fine = true;
    for _ in 0..count {
        fine &= scan(*now);
        *now += CYCLE_NS;
    }
    (begin.elapsed().as_nanos() as f64 / count as f64, fine)
}

fn value_of(instance: &Instance) -> Result<f64> {
    let value: Value = instance
        .read("P.result")
        .context("the program has no variable `result`")?;
    Ok(value.as_f64())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a program means may change in the language, and then the C beside it has to.
    #[test]
    fn programs_and_their_c_answer_the_same() {
        let folder = tempfile::tempdir().unwrap();
        for pair in pairs(1_000, &|_| true) {
            if let Err(error) = compared(&pair, folder.path()) {
                panic!("{}: {error}", pair.name);
            }
        }
    }
}
