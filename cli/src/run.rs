//! `fam run`: runs the programs of a project alone, in simulated time.

use crate::args::{DialectArg, RunArgs};
use anyhow::{Context, Result, bail};
use fam_soft_plc::standalone::{self, Options, Shown};
use fam_soft_plc::{
    CheckOptions, Dialect, Engine, EngineOptions, Instance, Interruption, SourceFile, Trap, Value,
    VariableInfo,
};
use serde_json::{Map, Number, Value as Json, json};
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Wasm instructions after which a scan counts as endless: some seconds.
const FUEL_OF_A_SCAN: u64 = 4_000_000_000;
/// Exit code of a run that was stopped by its own logic.
const TRAPPED: i32 = 3;

impl From<DialectArg> for Dialect {
    fn from(arg: DialectArg) -> Self {
        match arg {
            DialectArg::Standard => Dialect::Standard,
            DialectArg::Codesys => Dialect::Codesys,
        }
    }
}

/// Reads the files as sources; text that is no UTF-8 is taken as ISO 8859-1.
pub fn sources(files: &[PathBuf]) -> Result<Vec<SourceFile>> {
    files
        .iter()
        .map(|path| Ok(SourceFile::new(path.display().to_string(), text_of(path)?)))
        .collect()
}

/// The text of one file.
pub fn text_of(path: &Path) -> Result<String> {
    let bytes = fs::read(path).with_context(|| format!("{} cannot be read", path.display()))?;
    let as_they_are = |bytes: Vec<u8>| bytes.into_iter().map(char::from).collect();
    Ok(fam_engineering::files::decoded(bytes.clone()).unwrap_or_else(|| as_they_are(bytes)))
}

/// Runs the programs. `Ok(false)`: they could not be compiled.
pub fn run(args: &RunArgs) -> Result<bool> {
    let files = sources(&args.files)?;
    let options = Options {
        program: args.program.clone(),
        check: CheckOptions {
            dialect: args.dialect.into(),
            ..CheckOptions::default()
        },
    };
    let prepared = match standalone::prepare(&files, &options) {
        Ok(prepared) => prepared,
        Err(diagnostics) => {
            for diagnostic in &diagnostics {
                eprint!("{diagnostic}");
            }
            if args.json {
                println!("{}", json!({ "scans": 0, "diagnostics": diagnostics }));
            }
            return Ok(false);
        }
    };
    for warning in &prepared.warnings {
        eprint!("{warning}");
    }
    let engine = Engine::new(EngineOptions {
        interruption: Interruption::Fuel(FUEL_OF_A_SCAN),
    })?;
    let module = engine.prepare(&prepared.mc)?;
    let instance = Instance::new(&engine, &module)?;
    let cycle_ns = match args.cycle_ms {
        Some(ms) if ms > 0.0 && ms.is_finite() => (ms * 1e6).round() as i64,
        Some(ms) => bail!("a cycle of {ms} ms is none; give a positive number"),
        None => prepared.cycle_ns,
    };
    Session {
        args,
        instance,
        cycle_ns,
    }
    .go()
}

struct Session<'a> {
    args: &'a RunArgs,
    instance: Instance,
    cycle_ns: i64,
}

impl Session<'_> {
    fn go(mut self) -> Result<bool> {
        let scans = match (self.args.scans, self.args.realtime) {
            (Some(scans), _) => scans,
            (None, true) => u64::MAX,
            (None, false) => 1,
        };
        let mut inputs = match &self.args.inputs {
            Some(path) => Inputs::read(path, &self.instance)?,
            None => Inputs::default(),
        };
        let watched = self.find_all(&self.args.watch)?;
        let mut trace = match &self.args.trace {
            Some(path) => Some(Trace::create(path, &self.instance, &watched)?),
            None => None,
        };
        let begin = Instant::now();
        let mut trapped: Option<Trap> = None;
        let mut done = 0;
        while done < scans {
            inputs.apply(done, self.cycle_ns, &mut self.instance)?;
            let now_ns = self.cycle_ns.saturating_mul(done as i64);
            if self.args.realtime {
                let due = Duration::from_nanos(now_ns as u64);
                std::thread::sleep(due.saturating_sub(begin.elapsed()));
            }
            if let Err(trap) = self.instance.scan(now_ns, 2) {
                trapped = Some(trap);
                break;
            }
            done += 1;
            if let Some(trace) = &mut trace {
                trace.row(done, now_ns, &self.instance)?;
            }
            if !watched.is_empty() {
                self.show_watched(done, &watched);
            }
        }
        if let Some(trace) = trace {
            trace.close()?;
        }
        self.finish(done, trapped.as_ref())
    }

    fn find_all(&self, names: &[String]) -> Result<Vec<(String, VariableInfo)>> {
        names
            .iter()
            .map(|n| n.trim())
            .filter(|n| !n.is_empty())
            .map(|name| Ok((name.to_owned(), find(&self.instance, name)?)))
            .collect()
    }

    fn show_watched(&self, scan: u64, watched: &[(String, VariableInfo)]) {
        let mut line = format!("scan {scan}:");
        for (name, info) in watched {
            let value = standalone::show(&self.instance, info).map(|s| shown_text(&s));
            let _ = write!(line, " {name}={}", value.unwrap_or_default());
        }
        if self.args.json {
            eprintln!("{line}");
        } else {
            println!("{line}");
        }
    }

    fn finish(self, scans: u64, trap: Option<&Trap>) -> Result<bool> {
        let variables = standalone::variables(&self.instance);
        if self.args.json {
            let map: Map<String, Json> = variables
                .iter()
                .map(|(path, shown)| (path.clone(), as_json(shown)))
                .collect();
            let mut out = json!({ "scans": scans, "variables": map });
            if let Some(trap) = trap {
                out["trap"] = serde_json::to_value(trap)?;
            }
            println!("{out}");
        } else if self.args.watch.is_empty() {
            for (path, shown) in &variables {
                println!("{path} = {}", shown_text(shown));
            }
        }
        std::io::stdout().flush()?;
        if let Some(trap) = trap {
            eprintln!("stopped in scan {}: {trap}", scans + 1);
            std::process::exit(TRAPPED);
        }
        Ok(true)
    }
}

fn find(instance: &Instance, name: &str) -> Result<VariableInfo> {
    standalone::find(instance, name)
        .with_context(|| format!("there is no variable `{name}`, or several end like this"))
}

/// A value as JSON: numbers and booleans as such, durations and dates as their literals, enumerated values by their name.
pub fn as_json(shown: &Shown) -> Json {
    match shown {
        Shown::Text(text) | Shown::Name(text) => Json::String(text.clone()),
        Shown::Array(list) => Json::Array(list.iter().map(as_json).collect()),
        Shown::Struct(fields) => fields
            .iter()
            .map(|(name, value)| (name.clone(), as_json(value)))
            .collect::<Map<_, _>>()
            .into(),
        Shown::Scalar(value) => match value {
            Value::Bool(b) => Json::Bool(*b),
            Value::Int(v) => (*v).into(),
            Value::Uint(v) => (*v).into(),
            // The shortest number that is this REAL, not that of the LREAL nearest to it.
            Value::Real(v) => real(v.to_string().parse().unwrap_or(f64::NAN)),
            Value::Lreal(v) => real(*v),
            Value::Char(code) => char::from_u32(u32::from(*code))
                .map(String::from)
                .unwrap_or_default()
                .into(),
            other => other.to_string().into(),
        },
    }
}

fn real(v: f64) -> Json {
    Number::from_f64(v).map_or_else(|| Json::String(v.to_string()), Json::Number)
}

/// A value as one word or line.
pub fn shown_text(shown: &Shown) -> String {
    match shown {
        Shown::Scalar(value) => value.to_string(),
        Shown::Name(name) => name.clone(),
        Shown::Text(text) => format!("'{text}'"),
        Shown::Array(list) => {
            let items: Vec<String> = list.iter().map(shown_text).collect();
            format!("[{}]", items.join(", "))
        }
        Shown::Struct(fields) => {
            let items: Vec<String> = fields
                .iter()
                .map(|(name, value)| format!("{name} := {}", shown_text(value)))
                .collect();
            format!("({})", items.join(", "))
        }
    }
}

/// Values to set before scans: `--inputs`.
#[derive(Default)]
struct Inputs {
    /// Rows in order: when, then the values that are not empty.
    rows: Vec<(When, Vec<(VariableInfo, String)>)>,
    next: usize,
    file: String,
}

#[derive(Clone, Copy)]
enum When {
    Scan(u64),
    TimeNs(i64),
}

impl Inputs {
    /// A table with a first column `scan` (counted from 1 as `--trace` does, or from 0 if it has a row 0) or `time_ms`, and one
    /// column for each variable. A value holds until another one comes; an empty field changes nothing.
    fn read(path: &Path, instance: &Instance) -> Result<Inputs> {
        let text = text_of(path)?;
        let file = path.display().to_string();
        let mut lines = text
            .lines()
            .enumerate()
            .filter(|(_, l)| !l.trim().is_empty() && !l.trim_start().starts_with('#'));
        let Some((_, head)) = lines.next() else {
            bail!("{file} is empty; its first line names the columns: scan,P.x,P.y");
        };
        let names = fields(head);
        let by_scan = match names
            .first()
            .map(|n| n.trim().to_ascii_lowercase())
            .as_deref()
        {
            Some("scan") => true,
            Some("time_ms" | "time") => false,
            other => bail!(
                "{file}: the first column is `{}`; it must be `scan` or `time_ms`",
                other.unwrap_or_default()
            ),
        };
        let columns = names[1..]
            .iter()
            .map(|name| find(instance, name.trim()).with_context(|| file.clone()))
            .collect::<Result<Vec<_>>>()?;
        for (index, info) in columns.iter().enumerate() {
            if columns[..index].iter().any(|c| c.path == info.path) {
                bail!("{file}: two columns are `{}`", info.path);
            }
        }
        let mut rows = Vec::new();
        for (number, line) in lines {
            let cells = fields(line);
            if cells.len() > names.len() {
                let (has, more) = (names.len(), cells.len());
                bail!(
                    "{file}, line {}: {more} fields, and the first line names {has}",
                    number + 1
                );
            }
            let at = cells.first().map(String::as_str).unwrap_or_default().trim();
            let when = if by_scan {
                at.parse().ok().map(When::Scan)
            } else {
                at.parse::<f64>()
                    .ok()
                    .map(|ms| When::TimeNs((ms * 1e6).round() as i64))
            };
            let Some(when) = when else {
                bail!("{file}, line {}: `{at}` is no number", number + 1);
            };
            let values = columns
                .iter()
                .zip(&cells[1..])
                .filter(|(_, text)| !text.trim().is_empty())
                .map(|(info, text)| (info.clone(), text.trim().to_owned()))
                .collect();
            rows.push((when, values));
        }
        // As `--trace` counts, unless the table has a row 0.
        let from_0 = rows.iter().any(|(when, _)| matches!(when, When::Scan(0)));
        for (when, _) in &mut rows {
            if let When::Scan(scan) = when
                && !from_0
            {
                *scan -= 1;
            }
        }
        rows.sort_by_key(|(when, _)| match when {
            When::Scan(scan) => i128::from(*scan),
            When::TimeNs(ns) => i128::from(*ns),
        });
        Ok(Inputs {
            rows,
            next: 0,
            file,
        })
    }

    fn apply(&mut self, scan: u64, cycle_ns: i64, instance: &mut Instance) -> Result<()> {
        let now = cycle_ns.saturating_mul(scan as i64);
        while let Some((when, values)) = self.rows.get(self.next) {
            let due = match when {
                When::Scan(at) => *at <= scan,
                When::TimeNs(at) => *at <= now,
            };
            if !due {
                break;
            }
            for (info, text) in values {
                standalone::write(instance, info, text)
                    .map_err(|e| anyhow::anyhow!("{}: {e}", self.file))?;
            }
            self.next += 1;
        }
        Ok(())
    }
}

/// The fields of a line of a table, quotes taken off.
fn fields(line: &str) -> Vec<String> {
    let mut out = vec![String::new()];
    let mut quoted = false;
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' | ';' if !quoted => out.push(String::new()),
            c => {
                if let Some(last) = out.last_mut() {
                    last.push(c);
                }
            }
        }
    }
    out
}

/// Values after each scan: `--trace`.
struct Trace {
    out: std::io::BufWriter<fs::File>,
    path: PathBuf,
    columns: Vec<VariableInfo>,
}

impl Trace {
    fn create(
        path: &Path,
        instance: &Instance,
        watched: &[(String, VariableInfo)],
    ) -> Result<Trace> {
        let file = fs::File::create(path)
            .with_context(|| format!("{} cannot be written", path.display()))?;
        let mut names = Vec::new();
        let mut columns = Vec::new();
        if watched.is_empty() {
            for (name, _) in standalone::variables(instance) {
                let info = find(instance, &name)?;
                names.push(name);
                columns.push(info);
            }
        } else {
            for (name, info) in watched {
                names.push(name.clone());
                columns.push(info.clone());
            }
        }
        let mut trace = Trace {
            out: std::io::BufWriter::new(file),
            path: path.to_owned(),
            columns,
        };
        let head: Vec<String> = names.iter().map(|n| quoted(n)).collect();
        trace.line(&format!("scan,time_ms,{}", head.join(",")))?;
        Ok(trace)
    }

    fn line(&mut self, line: &str) -> Result<()> {
        writeln!(self.out, "{line}")
            .with_context(|| format!("{} cannot be written", self.path.display()))
    }

    fn row(&mut self, scan: u64, now_ns: i64, instance: &Instance) -> Result<()> {
        let mut line = format!("{scan},{}", now_ns as f64 / 1e6);
        for info in &self.columns {
            let shown = standalone::show(instance, info);
            let text = match &shown {
                Some(Shown::Text(text)) => text.clone(),
                Some(shown) => shown_text(shown),
                None => String::new(),
            };
            let _ = write!(line, ",{}", quoted(&text));
        }
        self.line(&line)
    }

    fn close(mut self) -> Result<()> {
        self.out
            .flush()
            .with_context(|| format!("{} cannot be written", self.path.display()))
    }
}

fn quoted(text: &str) -> String {
    if text.contains([',', ';', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}
