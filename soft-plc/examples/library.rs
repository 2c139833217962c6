//! `cargo run --release -p fam-soft-plc --example library -- FILE...`: how many POUs of a library the checker takes in the CODESYS
//! dialect, why it refuses the others, and what each of those that it takes does when it is called with variables that nobody has set.

use std::collections::{BTreeMap, BTreeSet};

use fam_soft_plc::syntax::ast::{PouKind, VarSection};
use fam_soft_plc::{
    CheckOptions, CompileSpec, Dialect, Engine, EngineOptions, Instance, Interruption, Project,
    Severity, SourceFile, check, compile, parse_project,
};

/// Scans of each POU, and Wasm instructions for each of them.
const SCANS: i64 = 100;
const FUEL: u64 = 20_000_000;

fn options() -> CheckOptions {
    CheckOptions {
        dialect: Dialect::Codesys,
        ..CheckOptions::default()
    }
}

/// Text as UTF-8, or as ISO 8859-1 if it is none; characters that an earlier conversion has lost are question marks.
fn read(path: &str) -> anyhow::Result<SourceFile> {
    let bytes = std::fs::read(path)?;
    let text = String::from_utf8(bytes)
        .unwrap_or_else(|e| e.as_bytes().iter().map(|b| char::from(*b)).collect());
    Ok(SourceFile::new(path, text.replace('\u{fffd}', "?")))
}

/// A program that calls the POU with a variable for each parameter.
fn caller(project: &Project, number: usize) -> Option<String> {
    let pou = &project.pous[number];
    let name = &pou.name.name;
    let (mut vars, mut args) = (String::new(), Vec::new());
    for (index, block) in pou.vars.iter().enumerate() {
        let given = match block.section {
            VarSection::InOut => true,
            VarSection::Input => pou.kind == PouKind::Function,
            _ => false,
        };
        if !given || block.constant {
            continue;
        }
        for (place, decl) in block.decls.iter().enumerate() {
            let spec = project.sources.slice(decl.spec.span);
            vars.push_str(&format!("v{index}_{place} : {spec};\n"));
            args.push(format!("{} := v{index}_{place}", decl.name.name));
        }
    }
    let args = args.join(", ");
    let call = match pou.kind {
        PouKind::FunctionBlock => {
            vars.push_str(&format!("one : {name};\n"));
            format!("one({args});")
        }
        PouKind::Function => {
            if let Some(result) = &pou.result {
                let spec = project.sources.slice(result.span);
                vars.push_str(&format!("result : {spec};\n"));
                format!("result := {name}({args});")
            } else {
                format!("{name}({args});")
            }
        }
        _ => format!("{name}({args});"),
    };
    Some(format!(
        "PROGRAM Caller__\nVAR\n{vars}END_VAR\n{call}\nEND_PROGRAM\n"
    ))
}

fn main() -> anyhow::Result<()> {
    let files = std::env::args()
        .skip(1)
        .map(|path| read(&path))
        .collect::<anyhow::Result<Vec<_>>>()?;
    let (mut project, _) = parse_project(&files);
    let all = project.pous.len();
    let mut refused: BTreeMap<String, String> = BTreeMap::new();
    let mut first = 0;
    while let Err(problems) = check(&project, options()) {
        let mut bad = BTreeSet::new();
        for problem in problems.iter().filter(|p| p.severity == Severity::Error) {
            if let Some(pou) = &problem.pou {
                let name = pou.split('.').next().unwrap_or(pou).to_ascii_uppercase();
                let why = format!(
                    "{} line {}: {}",
                    problem.code, problem.line, problem.message
                );
                refused.entry(name.clone()).or_insert(why);
                bad.insert(name);
            } else {
                println!("{problem}");
            }
        }
        if bad.is_empty() {
            break;
        }
        if first == 0 {
            first = bad.len();
        }
        project
            .pous
            .retain(|p| !bad.contains(&p.name.name.to_ascii_uppercase()));
    }
    for (name, why) in &refused {
        println!("refused {name}: {why}");
    }
    let accepted = project.pous.len();
    println!("{all} POUs, {accepted} accepted, {first} refused for themselves");
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::Fuel(FUEL),
    })?;
    let names: BTreeSet<String> = project.pous.iter().map(|p| p.name.name.clone()).collect();
    let (mut ran, mut stopped) = (0, 0);
    for number in 0..accepted {
        let name = project.pous[number].name.name.clone();
        let Some(text) = caller(&project, number) else {
            continue;
        };
        let mut with = files.clone();
        with.push(SourceFile::new("caller", text));
        let (mut whole, _) = parse_project(&with);
        whole
            .pous
            .retain(|p| names.contains(&p.name.name) || p.name.name == "Caller__");
        let typed = match check(&whole, options()) {
            Ok(typed) => typed,
            Err(problems) => {
                println!("{name} cannot be called: {}", problems[0]);
                continue;
            }
        };
        let spec = CompileSpec {
            entry: "Caller__".to_owned(),
            ..CompileSpec::default()
        };
        let mc = match compile(&typed, &spec) {
            Ok(mc) => mc,
            Err(problems) => {
                println!("{name}: {}", problems[0]);
                continue;
            }
        };
        let module = engine.prepare(&mc)?;
        let mut instance = Instance::new(&engine, &module)?;
        let mut trap = None;
        for scan in 0..SCANS {
            if let Err(found) = instance.scan(scan * 10_000_000, 2) {
                trap = Some((scan, found));
                break;
            }
        }
        match trap {
            None => ran += 1,
            Some((scan, trap)) => {
                stopped += 1;
                println!("stopped {name} in scan {scan}: {trap}");
            }
        }
    }
    println!("{ran} run {SCANS} scans, {stopped} are stopped by a run-time check");
    Ok(())
}
