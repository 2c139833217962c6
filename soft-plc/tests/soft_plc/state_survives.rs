//! State survives: whatever a program does, its regions copied to a fresh instance after scan k go on as if nothing had
//! happened. For the programs of the benchmarks, of `deploy`, of the templates and examples, and of `tests/cases`.

use std::path::{Path, PathBuf};

use fam_soft_plc::standalone::{self, Options};
use fam_soft_plc::{
    CompiledMc, Dialect, Engine, EngineOptions, Instance, Interruption, Module, SourceFile, Value,
};

use crate::cases;
use crate::common::{CYCLE_NS, FUEL, show};

/// Scans after which the state is taken.
const CUTS: [i64; 3] = [1, 7, 40];
/// Scans that are compared afterwards.
const AFTER: i64 = 100;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// All `.st` files of a folder.
fn folder(name: &str) -> Vec<SourceFile> {
    let path = root().join(name);
    let entries = std::fs::read_dir(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut files: Vec<PathBuf> = entries.map(|e| e.expect("a file").path()).collect();
    files.sort();
    let wanted = files
        .into_iter()
        .filter(|p| p.extension().is_some_and(|e| e == "st"));
    wanted
        .map(|p| {
            let text =
                std::fs::read_to_string(&p).unwrap_or_else(|e| panic!("{}: {e}", p.display()));
            SourceFile::new(p.display().to_string(), text)
        })
        .collect()
}

fn engine() -> Engine {
    let interruption = Interruption::Fuel(FUEL);
    Engine::new(EngineOptions { interruption }).expect("engine")
}

fn prepared(what: &str, files: &[SourceFile]) -> CompiledMc {
    let options = Options::default();
    let first = standalone::prepare(files, &options);
    let prepared = first.or_else(|_| {
        let mut options = Options::default();
        options.check.dialect = Dialect::Codesys;
        standalone::prepare(files, &options)
    });
    prepared
        .unwrap_or_else(|d| panic!("{what}: {}", show(&d)))
        .mc
}

/// Inputs of a scan: the same for every instance.
fn give_inputs(instance: &mut Instance, scan: i64) {
    for (number, byte) in instance.inputs_mut().iter_mut().enumerate() {
        let mixed = (scan as u64 / 3 + number as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        *byte = (mixed >> 40) as u8;
    }
}

fn bytes(instance: &Instance) -> Vec<u8> {
    let mut all = instance.outputs().to_vec();
    for index in 0..instance.layout().regions.len() {
        all.extend_from_slice(instance.region(index));
    }
    all
}

/// One scan; `None` if it trapped.
fn scan(instance: &mut Instance, number: i64) -> Option<Vec<u8>> {
    give_inputs(instance, number);
    instance.scan(number * CYCLE_NS, 2).ok()?;
    Some(bytes(instance))
}

/// Runs on in a fresh instance after each cut and compares. `start` prepares an instance before its first scan. Answers the
/// number of scans that were compared.
fn survives(what: &str, engine: &Engine, module: &Module, start: &dyn Fn(&mut Instance)) -> usize {
    let fresh = || Instance::new(engine, module).expect("instance");
    let mut whole = fresh();
    start(&mut whole);
    let mut trace = Vec::new();
    for number in 0..CUTS[CUTS.len() - 1] + AFTER {
        match scan(&mut whole, number) {
            Some(state) => trace.push(state),
            None => break,
        }
    }
    let mut compared = 0;
    for cut in CUTS {
        if trace.len() as i64 <= cut {
            break;
        }
        let mut first = fresh();
        start(&mut first);
        for number in 0..cut {
            assert_eq!(
                scan(&mut first, number).as_ref(),
                trace.get(number as usize),
                "{what}: scan {number} anew"
            );
        }
        let mut second = fresh();
        for index in 0..second.layout().regions.len() {
            second
                .region_mut(index)
                .copy_from_slice(first.region(index));
        }
        second.outputs_mut().copy_from_slice(first.outputs());
        for number in cut..(cut + AFTER).min(trace.len() as i64) {
            let state = scan(&mut second, number);
            assert!(
                state.as_ref() == trace.get(number as usize),
                "{what}: restored after scan {cut}, scan {number} differs"
            );
            compared += 1;
        }
    }
    compared
}

fn check(what: &str, files: &[SourceFile]) {
    let engine = engine();
    let module = engine
        .prepare(&prepared(what, files))
        .unwrap_or_else(|e| panic!("{what}: {e}"));
    let compared = survives(what, &engine, &module, &|_| {});
    assert!(
        compared >= AFTER as usize,
        "{what}: only {compared} scans without a trap"
    );
}

#[test]
fn of_the_programs_of_the_benchmarks() {
    let programs = folder("cli/src/bench/scan");
    assert!(programs.len() >= 13);
    for file in programs {
        check(&file.name.clone(), &[file]);
    }
}

#[test]
fn of_the_cells_and_examples() {
    for name in [
        "deploy/fms200/logic",
        "engineering/templates/new/logic",
        "engineering/tests/cells/two_stations",
    ] {
        // Each component is a project of its own, with what all share.
        let (shared, own): (Vec<_>, Vec<_>) = folder(name).into_iter().partition(|f| {
            ["/common.st", "/profile.st"]
                .iter()
                .any(|end| f.name.ends_with(end))
        });
        for file in own {
            let what = file.name.clone();
            let mut files = shared.clone();
            files.push(file);
            check(&what, &files);
        }
    }
    let library = folder("deploy/lib");
    for left_out in [
        ["pack_motion_delayed.st", "policy_two_products.st"],
        ["pack_motion.st", "policy.st"],
    ] {
        let mut files = library.clone();
        let all = folder("deploy/marking-machine").into_iter();
        files.extend(all.filter(|f| {
            !left_out
                .iter()
                .any(|out| f.name.ends_with(&format!("/{out}")))
        }));
        check("the marking machine", &files);
    }
}

#[test]
fn of_the_cases() {
    let engine = engine();
    let mut compared = 0;
    for file in cases::files() {
        let (mc, numbers) = cases::compiled(&file);
        let module = engine.prepare(&mc).unwrap_or_else(|e| panic!("{e}"));
        for number in numbers {
            let start = |instance: &mut Instance| {
                instance
                    .write("Main.which", Value::Int(number))
                    .expect("the selector");
            };
            compared += survives(&format!("case {number}"), &engine, &module, &start);
        }
    }
    assert!(compared > 100_000, "{compared} scans");
}
