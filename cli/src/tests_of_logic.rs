//! `fam test`: runs test programs written in Structured Text. Their `ASSERT` blocks come with the standard library:
//! `check : ASSERT;` and `check(condition := x = 3, message := 'x is 3');`.

use crate::args::TestArgs;
use crate::run::sources;
use anyhow::{Context, Result, bail};
use fam_soft_plc::standalone::{self, Options};
use fam_soft_plc::{Engine, EngineOptions, Instance, Interruption, SourceFile, Value};
use std::path::PathBuf;

/// Wasm instructions after which a scan counts as endless.
const FUEL_OF_A_SCAN: u64 = 1_000_000_000;

/// Runs all tests of a folder. `Ok(false)`: some failed.
pub fn run(args: &TestArgs) -> Result<bool> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(&args.folder)
        .with_context(|| format!("{} cannot be read", args.folder.display()))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|path| {
            path.extension()
                .is_some_and(|e| e.eq_ignore_ascii_case("st") || e.eq_ignore_ascii_case("xml"))
        })
        .collect();
    files.sort();
    let files = sources(&files)?;
    let (project, _) = fam_soft_plc::parse_project(&files);
    let tests: Vec<String> = project
        .pous
        .iter()
        .filter(|p| p.kind == fam_soft_plc::syntax::ast::PouKind::Program)
        .map(|p| p.name.name.clone())
        .filter(|name| name.to_ascii_uppercase().starts_with("TEST"))
        .collect();
    if tests.is_empty() {
        bail!(
            "{}: there is no PROGRAM whose name begins with TEST",
            args.folder.display()
        );
    }
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::Fuel(FUEL_OF_A_SCAN),
    })?;
    let (mut passed, mut failed) = (0, 0);
    for name in &tests {
        match test(&engine, &files, name, args)? {
            None => {
                passed += 1;
                println!("ok      {name}");
            }
            Some(why) => {
                failed += 1;
                println!("FAILED  {name}: {why}");
            }
        }
    }
    println!("{passed} passed, {failed} failed");
    Ok(failed == 0)
}

/// Why the test fails, if it does.
fn test(
    engine: &Engine,
    files: &[SourceFile],
    name: &str,
    args: &TestArgs,
) -> Result<Option<String>> {
    let options = Options {
        program: Some(name.to_owned()),
        ..Options::default()
    };
    let prepared = match standalone::prepare(files, &options) {
        Ok(prepared) => prepared,
        Err(diagnostics) => {
            let text: String = diagnostics.iter().map(ToString::to_string).collect();
            return Ok(Some(format!("it cannot be compiled\n{text}")));
        }
    };
    let module = engine.prepare(&prepared.mc)?;
    let mut instance = Instance::new(engine, &module)?;
    let done = format!("{name}.done");
    for scan in 0..args.scans {
        let now_ns = (args.cycle_ms * 1e6 * scan as f64) as i64;
        if let Err(trap) = instance.scan(now_ns, 2) {
            return Ok(Some(trap.to_string()));
        }
        if instance.read(&done) == Some(Value::Bool(true)) {
            break;
        }
    }
    let counts = standalone::assertions(&instance);
    if let Some(bad) = counts.iter().find(|c| c.failed > 0) {
        return Ok(Some(format!(
            "{} ({} of {} in {})",
            bad.first_failure,
            bad.failed,
            bad.failed + bad.passed,
            bad.path
        )));
    }
    if counts.iter().map(|c| c.passed).sum::<i64>() == 0 {
        return Ok(Some("it asserts nothing".to_owned()));
    }
    Ok(None)
}
