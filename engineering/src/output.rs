//! `fam generate`: everything that runs, as files. The same model gives the same bytes.
//!
//! - `<controller>.xml`: the Flexible Automation Project of each controller.
//! - `<MC>.diagnosis.xml`: the diagnosis file of each MC.
//! - `agents.toml`: the properties of each agent.
//! - `model/`: the model itself in its plain form, with its logic, for the processes to read.
//! - `deployment.toml`: for `fam up`.
//! - `standard.st`: with `--target portable`, the standard blocks whose internals are state, and what counts their time.
//! - `summary.txt`: a table for people.

use crate::build::{BuiltCell, build_for, in_parallel, processors};
use crate::convert::{Form, convert};
use crate::files::ModelAt;
use crate::generate::Target;
use crate::generate::standard::standard;
use crate::plcopen::{diagnosis_file, project_xml};
use crate::problem::{Explain, Problems, file_error};
use crate::staged::Staged;
use fam_soft_plc::Severity;
use fam_soft_plc::diag::Diagnostic;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Where the plain form of the model stands among the generated files.
pub const MODEL: &str = "model/cell.toml";

/// All generated files by their path, and the cell that they are of.
///
/// # Errors
/// All [`Problems`] of the model at once.
pub fn generate<'a>(
    model: impl Into<ModelAt<'a>>,
    target: Target,
) -> Result<(BTreeMap<String, String>, BuiltCell), Problems> {
    let model = model.into();
    let built = build_for(model, target)?;
    let plain = convert(model, "cell.toml", &Form::Toml)?;
    let mut files = files_of(&built, target);
    for (name, text) in plain.files {
        files.insert(format!("model/{name}"), text);
    }
    Ok((files, built))
}

/// Generates into a folder, which stays as it was if something fails. Returns the paths.
///
/// # Errors
/// As [`generate`], or a file that cannot be written.
pub fn write<'a>(
    model: impl Into<ModelAt<'a>>,
    target: Target,
    dir: &Path,
) -> Result<(Vec<PathBuf>, BuiltCell), Problems> {
    let model = model.into();
    beside(model, dir)?;
    let plain = convert(model, "cell.toml", &Form::Toml)?;
    let mut staged = Staged::new(dir)?;
    for (name, text) in plain.files {
        staged.add(format!("model/{name}"), &text)?;
    }
    let mut built = build_for(model, target)?;
    each_file(&built, target, &mut |name, text| staged.add(name, &text))?;
    let written = staged.deliver()?;
    built.warnings.extend(left_over(dir, &written));
    Ok((written, built))
}

/// Names the files of an earlier generation: those that look generated, and that this one did not write. They may also be
/// somebody's own, so that nobody removes them unasked.
fn left_over(dir: &Path, written: &[PathBuf]) -> Option<Diagnostic> {
    let files_in = |folder: PathBuf| {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        entries.map(|e| e.path()).filter(|p| p.is_file())
    };
    let looks_generated = |path: &PathBuf| {
        path.extension().is_some_and(|e| e == "xml") || path.ends_with("standard.st")
    };
    let mut old: Vec<String> = files_in(dir.to_owned())
        .filter(looks_generated)
        .chain(files_in(dir.join("model")))
        .filter(|path| !written.contains(path))
        .map(|path| format!("`{}`", path.strip_prefix(dir).unwrap_or(&path).display()))
        .collect();
    old.sort();
    let message = format!("this model does not make {}", sentence_list(&old)?);
    Some(Diagnostic {
        severity: Severity::Warning,
        ..file_error("W601", dir, message).hint("if they are of an earlier generation, remove them")
    })
}

/// `a`, `a and b`, `a, b and c`; the first few of many. `None` of none.
fn sentence_list(names: &[String]) -> Option<String> {
    const SHOWN: usize = 8;
    let (shown, more) = names.split_at(names.len().min(SHOWN));
    let (last, before) = shown.split_last()?;
    Some(match (before, more.len()) {
        ([], _) => last.clone(),
        (_, 0) => format!("{} and {last}", before.join(", ")),
        (_, more) => format!("{}, {last} and {more} more", before.join(", ")),
    })
}

/// What is generated never takes the place of what it is generated from.
fn beside(model: ModelAt<'_>, dir: &Path) -> Result<(), Problems> {
    let own = match model.file.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let Ok(own) = own.canonicalize() else {
        return Ok(()); // there is no model, which its reader says
    };
    let taken = [dir.to_owned(), dir.join("model")];
    if taken
        .iter()
        .any(|d| d.canonicalize().is_ok_and(|d| d == own))
    {
        let message =
            "the model stands here itself: generated files would replace its own".to_owned();
        return Err(Problems::one(file_error("M602", dir, message).hint(
            "give a folder for generated files alone, such as `--out out`",
        )));
    }
    Ok(())
}

/// The generated files of a cell, without its model.
#[must_use]
pub fn files_of(built: &BuiltCell, target: Target) -> BTreeMap<String, String> {
    let mut files = BTreeMap::new();
    let collected = each_file(built, target, &mut |name, text| {
        files.insert(name, text);
        Ok(())
    });
    debug_assert!(collected.is_ok());
    files
}

/// What takes the files: name and text.
type Sink<'a> = &'a mut dyn FnMut(String, String) -> Result<(), Problems>;

/// Hands out the generated files one by one, so that not all of them have to be held at once.
fn each_file(built: &BuiltCell, target: Target, sink: Sink<'_>) -> Result<(), Problems> {
    // As many at a time as there are processors, so that not all of them are held at once.
    for some in built.model.controllers.chunks(processors()) {
        let texts = in_parallel(some.len(), |n| project_xml(built, &some[n].controller));
        for (controller, text) in some.iter().zip(texts) {
            sink(format!("{}.xml", controller.controller), text)?;
        }
    }
    for mc in &built.mcs {
        sink(
            format!("{}.diagnosis.xml", mc.mc),
            diagnosis_file::write(mc),
        )?;
    }
    sink("agents.toml".to_owned(), agents(built))?;
    sink("deployment.toml".to_owned(), deployment(built))?;
    sink("summary.txt".to_owned(), summary(built))?;
    if target == Target::Portable {
        sink("standard.st".to_owned(), standard(&built.mcs))?;
    }
    Ok(())
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    let names: Vec<String> = names.map(quoted).collect();
    format!("[{}]", names.join(", "))
}

/// Properties of the agents: what each registers with.
#[must_use]
pub fn agents(built: &BuiltCell) -> String {
    let model = &built.model;
    let mut out = format!(
        "# Generated by fam from the model of cell {}: the properties of its agents. Do not edit.\nformat = 1\n",
        model.cell
    );
    for controller in &model.controllers {
        let id = controller.controller.as_str();
        let mcs = model
            .mcs
            .iter()
            .filter(|m| m.hosts.contains(&controller.controller));
        let _ = write!(
            out,
            "\n[[controller_agent]]\nid = {}\ndescription = {}\ncpu_factor = {}\nmemory_kb = {}\nlimit_percent = {}\nproject = {}\nmcs = {}\n",
            quoted(id),
            quoted(&controller.description),
            decimal(controller.cpu_factor_permille, 1000),
            controller.memory_kb,
            decimal(controller.limit_permille, 10),
            quoted(&format!("{id}.xml")),
            list(mcs.map(|m| m.mc.as_str()))
        );
    }
    for (mc, of) in model.mcs.iter().zip(&built.mcs) {
        let _ = write!(
            out,
            "\n[[mc_agent]]\nmc = {}\ncontrollers = {}\ngateway = {}\ncriticality = {}\ncycle_us = {}\nworst_case_us = {}\nstate_bytes = {}\nstate_diagnosis = {}\ncritical_intervals = {}\n",
            quoted(mc.mc.as_str()),
            list(mc.hosts.iter().map(|h| h.as_str())),
            quoted(mc.gateway.as_str()),
            mc.criticality,
            mc.cycle_us,
            mc.worst_case_us,
            of.control.state.end - of.control.state.start,
            quoted(&format!("{}.diagnosis.xml", mc.mc)),
            list(mc.diagnosis.intervals.iter().map(|i| i.name.as_str()))
        );
    }
    out
}

/// A fixed-point number as people write it.
fn decimal(value: u32, scale: u32) -> String {
    format!("{:?}", f64::from(value) / f64::from(scale))
}

/// A deployment that starts everything on this machine.
#[must_use]
pub fn deployment(built: &BuiltCell) -> String {
    let model = &built.model;
    let mut out = format!(
        "# Generated by fam from the model of cell {}: all processes on one machine. `fam up` starts them.\ncell = \"{MODEL}\"\nrun_dir = \"run\"\ncontrollers = {}\n",
        model.cell,
        list(model.controllers.iter().map(|c| c.controller.as_str()))
    );
    let first = crate::deployment::PORT_FIRST;
    let _ = write!(out, "\n[manager]\nlisten = \"tcp/127.0.0.1:{first}\"\n");
    for (index, gateway) in model.gateways.iter().enumerate() {
        let port = usize::from(first) + 1 + index;
        let _ = write!(
            out,
            "\n[[gateway]]\nname = {}\nlisten = \"tcp/127.0.0.1:{port}\"\n",
            quoted(gateway.gateway.as_str())
        );
        if let fam_proto::model::FieldDriver::Modbus { address } = &gateway.driver {
            let _ = writeln!(out, "address = {}", quoted(address));
        }
    }
    out
}

/// Tables of controllers and MCs.
#[must_use]
pub fn summary(built: &BuiltCell) -> String {
    let model = &built.model;
    let mut controllers = vec![
        [
            "controller",
            "CPU factor",
            "limit",
            "memory",
            "hosts",
            "load of all",
        ]
        .map(str::to_owned)
        .to_vec(),
    ];
    for controller in &model.controllers {
        let hosted: Vec<_> = model
            .mcs
            .iter()
            .filter(|m| m.hosts.contains(&controller.controller))
            .collect();
        // In permille of the cycle, then of the limit.
        let used: u64 = hosted
            .iter()
            .map(|m| {
                u64::from(m.worst_case_us) * 1_000_000
                    / u64::from(controller.cpu_factor_permille.max(1))
                    / u64::from(m.cycle_us.max(1))
            })
            .sum();
        controllers.push(vec![
            controller.controller.to_string(),
            decimal(controller.cpu_factor_permille, 1000),
            format!("{} %", decimal(controller.limit_permille, 10)),
            format!("{} MB", controller.memory_kb / 1024),
            format!("{} of {} MCs", hosted.len(), model.mcs.len()),
            format!(
                "{} %",
                used * 100 / u64::from(controller.limit_permille.max(1))
            ),
        ]);
    }
    let mut mcs = vec![
        [
            "MC",
            "gateway",
            "cycle",
            "scan",
            "state",
            "variables",
            "inputs",
            "outputs",
            "critical intervals",
        ]
        .map(str::to_owned)
        .to_vec(),
    ];
    for (mc, of) in model.mcs.iter().zip(&built.mcs) {
        mcs.push(vec![
            mc.mc.to_string(),
            mc.gateway.to_string(),
            crate::model::resolve::ms(mc.cycle_us.into()),
            format!("{} us", mc.worst_case_us),
            format!("{} B", of.control.state.end - of.control.state.start),
            of.state_variables.len().to_string(),
            mc.inputs.len().to_string(),
            mc.outputs.len().to_string(),
            mc.diagnosis.intervals.len().to_string(),
        ]);
    }
    format!(
        "Cell {}\n\n{}\n{}",
        model.cell,
        table(&controllers),
        table(&mcs)
    )
}

/// Columns as wide as their widest cell, two spaces between them.
#[must_use]
pub fn table(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns)
        .map(|c| {
            rows.iter()
                .filter_map(|r| r.get(c))
                .map(|cell| cell.chars().count())
                .max()
                .unwrap_or(0)
        })
        .collect();
    let mut out = String::new();
    for row in rows {
        let mut line = String::new();
        for (cell, width) in row.iter().zip(&widths) {
            let _ = write!(line, "{cell:<width$}  ");
        }
        let _ = writeln!(out, "{}", line.trim_end());
    }
    out
}
