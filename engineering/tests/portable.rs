//! What `--target portable` writes: plain IEC 61131-3 and nothing else, and standard blocks that do what the compiler's own do.

mod common;

use common::{one_mc, two_stations};
use fam_engineering::generate::Target;
use fam_engineering::generate::standard::{MC_TIME, blocks};
use fam_engineering::output;
use fam_soft_plc::standalone::{self, Options};
use fam_soft_plc::{Engine, EngineOptions, Instance, SourceFile};
use std::path::{Path, PathBuf};

fn deploy(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../deploy")
        .join(path)
}

#[test]
fn nothing_but_the_standard_is_written() {
    let types = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cells/types/cell.toml");
    let marking = deploy("marking-machine/cell.toml");
    for path in [two_stations(), types, deploy("fms200/cell.toml"), marking] {
        let (files, _) = output::generate(&path, Target::Portable)
            .unwrap_or_else(|p| panic!("{}: {p}", path.display()));
        assert!(files.contains_key("standard.st"));
        for (name, text) in files {
            // Names with two underscores are nobody's but a compiler's (IEC 61131-3, 6.1.2).
            assert!(!text.contains("__"), "{name} of {}", path.display());
        }
    }
}

/// Every name as a whole word becomes another one.
fn renamed(text: &str, names: &[&str]) -> String {
    let mut out = String::new();
    for word in text.split_inclusive(|c: char| !c.is_ascii_alphanumeric() && c != '_') {
        let name = word.trim_end_matches(|c: char| !c.is_ascii_alphanumeric() && c != '_');
        if names.contains(&name) {
            out.push_str("Plain_");
        }
        out.push_str(word);
    }
    out
}

#[test]
fn the_plain_blocks_do_what_the_compilers_own_do() {
    let blocks = blocks();
    assert!(blocks.len() >= 25, "{}", blocks.len());
    let names: Vec<&str> = blocks
        .iter()
        .filter_map(|b| b.split_whitespace().nth(1))
        .collect();
    for name in [
        "TON", "TOF", "TP", "R_TRIG", "F_TRIG", "SR", "RS", "CTU", "CTD", "CTUD",
    ] {
        assert!(names.contains(&name), "{name}");
    }
    let mut text = format!("VAR_GLOBAL {MC_TIME} : TIME; END_VAR\n");
    for block in &blocks {
        text.push_str(&renamed(block, &names));
    }
    let calls = [
        ("TON", "IN := x, PT := T#20ms", &["Q", "ET"][..]),
        ("TOF", "IN := x, PT := T#15ms", &["Q", "ET"]),
        ("TP", "IN := x, PT := T#25ms", &["Q", "ET"]),
        ("R_TRIG", "CLK := x", &["Q"]),
        ("F_TRIG", "CLK := x", &["Q"]),
        ("SR", "S1 := x, R := y", &["Q1"]),
        ("RS", "S := x, R1 := y", &["Q1"]),
        ("CTU", "CU := x, R := y, PV := 3", &["Q", "CV"]),
        ("CTD", "CD := x, LD := y, PV := 3", &["Q", "CV"]),
        (
            "CTUD",
            "CU := x, CD := y, R := x AND y, LD := FALSE, PV := 3",
            &["QU", "QD", "CV"],
        ),
    ];
    let (mut variables, mut body) = (String::new(), String::new());
    for (name, arguments, outputs) in calls {
        variables.push_str(&format!("a_{name} : {name}; b_{name} : Plain_{name};\n"));
        body.push_str(&format!("a_{name}({arguments}); b_{name}({arguments});\n"));
        for output in outputs {
            body.push_str(&format!(
                "IF a_{name}.{output} <> b_{name}.{output} THEN differs := differs + 1; END_IF;\n"
            ));
        }
        body.push_str(&format!(
            "IF a_{name}.{0} <> last_{name} THEN turns_{name} := turns_{name} + 1; last_{name} := a_{name}.{0}; END_IF;\n",
            outputs[0]
        ));
        variables.push_str(&format!("turns_{name} : DINT; last_{name} : BOOL;\n"));
    }
    text.push_str(&format!(
        "PROGRAM M\nVAR_EXTERNAL {MC_TIME} : TIME; END_VAR\nVAR x, y : BOOL; random : UDINT := 1; differs : DINT;\n{variables}END_VAR\n\
         {MC_TIME} := {MC_TIME} + T#5ms;\nrandom := random * 1103515245 + 12345;\n\
         IF random / 65536 MOD 7 = 0 THEN x := NOT x; END_IF;\nIF random / 65536 MOD 11 = 0 THEN y := NOT y; END_IF;\n{body}END_PROGRAM\n"
    ));
    let prepared = standalone::prepare(&[SourceFile::new("plain.st", text)], &Options::default())
        .unwrap_or_else(|d| {
            let texts: Vec<String> = d.iter().map(ToString::to_string).collect();
            panic!("{}", texts.join("\n"))
        });
    let engine = Engine::new(EngineOptions::default()).unwrap();
    let module = engine.prepare(&prepared.mc).unwrap();
    let mut instance = Instance::new(&engine, &module).unwrap();
    for scan in 1..=3_000 {
        instance
            .scan(scan * 5_000_000, 1_000)
            .unwrap_or_else(|t| panic!("{t}"));
    }
    let number = |path: &str| instance.read(path).and_then(|v| v.as_i128()).unwrap();
    assert_eq!(number("M.differs"), 0);
    for (name, ..) in calls {
        assert!(number(&format!("M.turns_{name}")) > 20, "{name}");
    }
}

/// What a foreign PLC runs each cycle counts the MC's time.
#[test]
fn each_mc_has_its_own_time() {
    let (_dir, path) = one_mc(
        "PROGRAM M\nVAR t : TON; END_VAR\n t(IN := TRUE, PT := T#1s);\nEND_PROGRAM\n",
        "cycle_ms = 10\n",
    );
    let (files, _) = output::generate(&path, Target::Portable).unwrap_or_else(|p| panic!("{p}"));
    let text = &files["standard.st"];
    assert!(
        text.contains("PROGRAM M_Cycle\n")
            && text.contains(
                "M_mcTime := M_mcTime + T#10ms;\nFAM_mcTime := M_mcTime;\nM_Control();\n"
            ),
        "{text}"
    );
}
