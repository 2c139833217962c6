//! The cases of `tests/cases`: values worked out by hand from the standard.

use std::path::{Path, PathBuf};

use fam_soft_plc::standalone::{Shown, show};
use fam_soft_plc::{
    CheckOptions, CompiledMc, Dialect, Instance, SourceFile, Value, check, compile, parse_project,
};

use crate::common::Machine;

pub struct Case {
    line: usize,
    vars: String,
    body: String,
    expected: String,
}

pub struct File {
    dialect: Dialect,
    pous: String,
    cases: Vec<Case>,
}

fn read(path: &Path) -> File {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let is_codesys = path
        .file_stem()
        .is_some_and(|stem| stem.to_string_lossy().starts_with("codesys"));
    let mut file = File {
        dialect: if is_codesys {
            Dialect::Codesys
        } else {
            Dialect::Standard
        },
        pous: String::new(),
        cases: Vec::new(),
    };
    let mut shared = false;
    for (number, line) in text.lines().enumerate() {
        match line {
            "@pous" => shared = true,
            "@end" => shared = false,
            _ if shared => {
                file.pous.push_str(line);
                file.pous.push('\n');
            }
            _ if line.starts_with('#') || line.is_empty() => {}
            _ => {
                let parts: Vec<&str> = line.split(" ~").collect();
                let [vars, body, expected] = parts.as_slice() else {
                    panic!(
                        "{}:{}: three parts are expected",
                        path.display(),
                        number + 1
                    );
                };
                file.cases.push(Case {
                    line: number + 1,
                    vars: (*vars).to_owned(),
                    body: body.trim().replace(" | ", "\n"),
                    expected: expected.trim().to_owned(),
                });
            }
        }
    }
    file
}

fn program(name: &str, case: &Case) -> String {
    format!(
        "PROGRAM {name} VAR {} END_VAR\n{}\nEND_PROGRAM\n",
        case.vars, case.body
    )
}

/// The code of the first error of a text that should have one.
fn refused(text: String, dialect: Dialect) -> Result<(), String> {
    let (project, problems) = parse_project(&[SourceFile::new("case.st", text)]);
    let errors = |list: Vec<fam_soft_plc::Diagnostic>| {
        list.into_iter()
            .find(|p| p.severity == fam_soft_plc::Severity::Error)
    };
    if let Some(problem) = errors(problems) {
        return Err(problem.code);
    }
    match check(
        &project,
        CheckOptions {
            dialect,
            ..CheckOptions::default()
        },
    ) {
        Ok(_) => Ok(()),
        Err(problems) => errors(problems).map_or(Ok(()), |p| Err(p.code)),
    }
}

fn shown(instance: &Instance, name: &str) -> String {
    let info = instance.layout().find(&format!("{name}.r"));
    match info.and_then(|i| show(instance, &i)) {
        Some(Shown::Scalar(value)) => value.to_string(),
        Some(Shown::Text(text) | Shown::Name(text)) => text,
        other => format!("{other:?}"),
    }
}

/// What a running case shows: values after its scans, or the trap.
fn run(machine: &mut Machine, number: i64, expected: &str) -> String {
    machine.instance.reset();
    machine.set("Main.which", Value::Int(number));
    let name = format!("C{number}");
    let Some((cycle, values)) = expected.strip_prefix('[').and_then(|e| e.split_once("ms]")) else {
        return match machine.instance.scan(0, 2) {
            Ok(()) => shown(&machine.instance, &name),
            Err(trap) => format!("trap {:?}", trap.kind),
        };
    };
    let cycle_ns = cycle.parse::<i64>().expect("milliseconds") * 1_000_000;
    let mut row = format!("[{cycle}ms]");
    for scan in 0..values.split_whitespace().count() {
        if let Err(trap) = machine.instance.scan(scan as i64 * cycle_ns, 2) {
            return format!("{row} trap {:?}", trap.kind);
        }
        row.push(' ');
        row.push_str(&shown(&machine.instance, &name));
    }
    row
}

fn folder() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases");
    let mut files: Vec<_> = std::fs::read_dir(&folder)
        .expect("the folder of cases")
        .map(|e| e.expect("a file").path())
        .filter(|p| p.extension().is_some_and(|e| e == "txt"))
        .collect();
    files.sort();
    files
}

/// All files of cases.
pub fn files() -> Vec<File> {
    folder().iter().map(|path| read(path)).collect()
}

/// The cases of a file that run, in one module; `Main.which` selects one by its number.
pub fn compiled(file: &File) -> (CompiledMc, Vec<i64>) {
    let (mut text, mut calls) = (file.pous.clone(), String::new());
    let mut numbers = Vec::new();
    for (number, case) in file.cases.iter().enumerate() {
        if !case.expected.starts_with("error ") {
            text.push_str(&program(&format!("C{number}"), case));
            calls.push_str(&format!("{number}: C{number}();\n"));
            numbers.push(number as i64);
        }
    }
    text.push_str(&format!(
        "PROGRAM Main VAR_INPUT which : INT; END_VAR\nCASE which OF\n{calls}END_CASE;\nEND_PROGRAM\n"
    ));
    let options = CheckOptions {
        dialect: file.dialect,
        ..CheckOptions::default()
    };
    let typed = crate::common::typed_with(&text, options);
    let mc = compile(&typed, &crate::common::spec("Main"));
    let mc = mc.unwrap_or_else(|d| panic!("{}", crate::common::show(&d)));
    (mc, numbers)
}

#[test]
fn programs_give_what_was_worked_out_from_the_standard() {
    let mut wrong = Vec::new();
    let mut count = 0;
    for path in folder() {
        let file = read(&path);
        let name = path.file_name().unwrap_or_default().display().to_string();
        count += file.cases.len();
        let mut broken = false;
        for (number, case) in file.cases.iter().enumerate() {
            let own = program(&format!("C{number}"), case);
            let found = refused(format!("{}{own}", file.pous), file.dialect).err();
            let expected = case.expected.strip_prefix("error ").map(str::to_owned);
            if found != expected {
                broken |= found.is_some();
                let (line, found) = (case.line, found.unwrap_or("nothing".into()));
                wrong.push(format!(
                    "{name}:{line}: {} is refused with {found}, expected {}",
                    case.body, case.expected
                ));
            }
        }
        if broken {
            continue;
        }
        let (mc, numbers) = compiled(&file);
        let mut machine = Machine::of(&mc);
        for number in numbers {
            let case = &file.cases[number as usize];
            let found = run(&mut machine, number, &case.expected);
            if found != case.expected {
                let Case {
                    line,
                    vars,
                    body,
                    expected,
                } = case;
                wrong.push(format!(
                    "{name}:{line}: {vars} ~ {body} gives {found}, expected {expected}"
                ));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{} of {count}:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
    assert!(count >= 500, "{count} cases");
}
