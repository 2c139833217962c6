//! What hosted MCs cost that do not run: memory of 200 of them with 1,000 variables each, and the time of one whose Control POU
//! finds it inactive (a controller node does not even call it). A binary of its own: it looks at the memory of its process.

// The time of a call is what is measured here.
#![allow(clippy::disallowed_methods)]

use std::fmt::Write;
use std::time::Instant;

use fam_soft_plc::{
    CheckOptions, CompileSpec, Engine, EngineOptions, Instance, SourceFile, check, compile,
    parse_project,
};

const MCS: usize = 200;
const MEMORY_KB_MAX: u64 = 100 * 1024;

/// An MC of 1,000 variables; its logic differs from that of every other.
fn project(number: usize) -> String {
    let (mut vars, mut body) = (String::new(), String::new());
    for index in 0..998 {
        let _ = writeln!(vars, "v{index} : DINT := {index};");
        if index % 10 == 0 {
            let _ = writeln!(
                body,
                "  IF v{index} > {number} THEN v{index} := v{index} - {index}; END_IF;"
            );
        }
    }
    format!(
        "PROGRAM Control VAR isActive : BOOL; scans : DINT;\n{vars}END_VAR\nIF isActive THEN\n  scans := scans + 1;\n{body}END_IF;\nEND_PROGRAM\n"
    )
}

fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").expect("the state of this process");
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"));
    let kb = line.and_then(|l| l.trim().strip_suffix("kB"));
    kb.and_then(|k| k.trim().parse().ok())
        .expect("resident memory")
}

#[test]
fn inactive_components_cost_little_memory() {
    let engine = Engine::new(EngineOptions::default()).expect("engine");
    // Machine code is made ahead and kept; hosts load it, so that no compiler's memory counts.
    let mut kept = Vec::new();
    let spec = CompileSpec {
        entry: "Control".into(),
        ..CompileSpec::default()
    };
    for number in 0..MCS {
        let (parsed, _) = parse_project(&[SourceFile::new("mc.st", project(number))]);
        let typed = check(&parsed, CheckOptions::default()).expect("a project without mistakes");
        let mc = compile(&typed, &spec).expect("a project that compiles");
        let code = engine
            .prepare(&mc)
            .and_then(|m| m.serialize())
            .expect("machine code");
        kept.push((mc, code));
    }
    let before = resident_kb();
    let mut hosted = Vec::new();
    for (mc, code) in &kept {
        // SAFETY: the bytes come from `serialize` above.
        let module = unsafe { engine.load_precompiled(mc, code) }.expect("module");
        hosted.push(Instance::new(&engine, &module).expect("instance"));
    }
    for instance in &mut hosted {
        instance.scan(0, 2).expect("scan");
    }
    let taken = resident_kb().saturating_sub(before);
    // The least of many rounds: others use the machine too.
    let mut least_ns = f64::MAX;
    for _ in 0..200 {
        let start = Instant::now();
        for instance in &mut hosted {
            instance.scan(0, 2).expect("scan");
        }
        least_ns = least_ns.min(start.elapsed().as_nanos() as f64 / MCS as f64);
    }
    // A figure, not a condition: it depends on the profile and on who else runs.
    println!(
        "{MCS} hosted MCs of 1,000 variables: {taken} kB; an inactive one: {least_ns:.0} ns a cycle"
    );
    assert!(taken < MEMORY_KB_MAX, "{taken} kB");
}
