//! What `fam status` and `fam events` print.

use comfy_table::{Cell, CellAlignment, Color, ContentArrangement, Table, presets};
use fam_proto::{CellStatus, ControllerStatus, Event, McStatus, Phase, Severity};
use serde_json::{Value, json};
use std::io::IsTerminal;

/// Whether standard output shows colours.
pub fn colours() -> bool {
    std::io::stdout().is_terminal() && std::env::var_os("NO_COLOR").is_none()
}

/// Whether standard error shows colours.
pub fn colours_on_stderr() -> bool {
    std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none()
}

/// An empty table in the house's form.
pub fn table(header: &[&str]) -> Table {
    let mut table = Table::new();
    table
        .load_style(presets::UTF8_HORIZONTAL_ONLY)
        .set_content_arrangement(ContentArrangement::Dynamic);
    if !colours() {
        table.force_no_tty();
    }
    table.set_header(header.iter().map(|h| Cell::new(h).fg(Color::DarkGrey)));
    table
}

/// A right-aligned cell.
pub fn number(text: impl ToString) -> Cell {
    Cell::new(text).set_alignment(CellAlignment::Right)
}

/// Workload in percent of the controller's limit.
pub fn percent(permille: u32) -> f64 {
    f64::from(permille) / 10.0
}

/// The status as text.
pub fn render(status: &CellStatus) -> String {
    let mut text = format!("cell {}, generation {}", status.cell, status.generation);
    if let Some(busy) = &status.in_progress {
        text += &format!(", in progress: {busy}");
    }
    if status.alarms > 0 {
        text += &format!(", {} alarm(s): see `fam events`, `fam ack`", status.alarms);
    }
    if status.bad_messages > 0 {
        text += &format!(", {} unreadable message(s)", status.bad_messages);
    }
    let mut controllers = table(&[
        "controller",
        "state",
        "workload %",
        "active",
        "late ticks",
        "overruns",
        "CPU %",
        "memory MB",
        "unreadable",
        "real time",
    ]);
    for c in &status.controllers {
        controllers.add_row(controller_row(c));
    }
    let mut mcs = table(&[
        "MC",
        "on",
        "record",
        "state",
        "epoch",
        "scan",
        "rejected",
        "pinned to",
    ]);
    for m in &status.mcs {
        mcs.add_row(mc_row(m));
    }
    let gateways: String = status
        .gateways
        .iter()
        .map(|g| {
            format!(
                "gateway {}: {}, image {}{}\n",
                g.gateway,
                if g.up { "up" } else { "down" },
                g.image,
                match g.bad_messages {
                    0 => String::new(),
                    bad => format!(", {bad} unreadable message(s)"),
                }
            )
        })
        .collect();
    let refused: String = status
        .controllers
        .iter()
        .flat_map(|c| {
            c.ineligible
                .iter()
                .map(move |(mc, why)| format!("{mc} may not run on {}: {why}\n", c.controller))
        })
        .collect();
    format!("{text}\n{controllers}\n{mcs}\n{gateways}{refused}")
}

fn controller_row(c: &ControllerStatus) -> Vec<Cell> {
    let state = match (c.up, c.drained) {
        (true, true) => "drained",
        (true, false) => "up",
        (false, _) if c.boot.is_some() => "down",
        (false, _) => "not seen",
    };
    let colour = if c.up { Color::Green } else { Color::DarkGrey };
    let active: Vec<&str> = c.active.iter().map(fam_proto::McId::as_str).collect();
    let mut row = vec![Cell::new(&c.controller), Cell::new(state).fg(colour)];
    match c.report.as_ref().filter(|_| c.up) {
        Some(r) => row.extend([
            number(format!("{:.0}", percent(r.workload_permille))),
            Cell::new(active.join(" ")),
            number(r.late_ticks),
            number(r.overruns),
            number(format!("{:.0}", percent(r.process_cpu_permille))),
            number(r.process_memory_kb / 1024),
            number(r.bad_messages),
        ]),
        None => row.extend([
            number(""),
            Cell::new(active.join(" ")),
            number(""),
            number(""),
            number(""),
            number(""),
            number(""),
        ]),
    }
    row.push(Cell::new(if c.real_time.is_empty() {
        "none".to_owned()
    } else {
        c.real_time.join(", ")
    }));
    row
}

fn mc_row(m: &McStatus) -> Vec<Cell> {
    let state = match m.phase {
        Some(Phase::Running) => "running".to_owned(),
        Some(Phase::Recovering(n)) => format!("recovering (action {n})"),
        Some(Phase::Stopping(_)) => "stopping".to_owned(),
        Some(Phase::Stopped) => "stopped".to_owned(),
        None => String::new(),
    };
    let record = Cell::new(&m.record).fg(match m.record.as_str() {
        "open" => Color::Green,
        "fail-safe" | "faulted" => Color::Red,
        _ => Color::Yellow,
    });
    vec![
        Cell::new(&m.mc),
        Cell::new(m.owner.as_ref().map_or("-", |o| o.as_str())),
        record,
        Cell::new(state),
        number(m.epoch),
        number(m.scan),
        number(m.rejected),
        Cell::new(m.pinned.as_ref().map_or("", |p| p.as_str())),
    ]
}

/// One event as a line.
pub fn event_line(e: &Event) -> String {
    let at = humantime::format_rfc3339_millis(
        std::time::UNIX_EPOCH + std::time::Duration::from_micros(e.wall_us),
    );
    let word = match e.severity {
        Severity::Info => "info",
        Severity::Warning => "warning",
        Severity::Alarm if e.acknowledged => "alarm (acknowledged)",
        Severity::Alarm => "ALARM",
    };
    let line = format!("{:>5}  {at}  {word:<7}  {}", e.seq, e.text);
    match e.severity {
        Severity::Alarm if colours() => format!("\x1b[31m{line}\x1b[0m"),
        Severity::Warning if colours() => format!("\x1b[33m{line}\x1b[0m"),
        _ => line,
    }
}

/// One event as JSON.
pub fn event_json(e: &Event) -> Value {
    json!({
        "seq": e.seq, "at_us": e.at_us, "wall_us": e.wall_us, "severity": e.severity, "kind": e.kind,
        "mc": e.mc, "controller": e.controller, "plan": e.plan, "epoch": e.epoch, "scan": e.scan,
        "text": e.text, "acknowledged": e.acknowledged,
    })
}

/// The status as JSON.
///
/// # Errors
/// If it cannot be written as JSON.
pub fn status_json(s: &CellStatus) -> serde_json::Result<Value> {
    serde_json::to_value(s)
}
