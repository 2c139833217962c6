//! The tables of a cell as the text of a `cell.toml`.

use super::toml_file::{CellFile, Hosts, McTable};
use std::fmt::Write as _;
use toml::Spanned;

/// Writes the file.
#[must_use]
pub fn write(file: &CellFile) -> String {
    let mut out = format!("format = {}\n\n[cell]\n", file.format.get_ref());
    text(&mut out, "name", Some(&file.cell.name));
    number(&mut out, "tick_ms", Some(&file.cell.tick_ms));
    number(&mut out, "link_mbit_s", file.cell.link_mbit_s.as_ref());
    let s = &file.settings;
    let settings = [
        ("report_ms", &s.report_ms),
        ("report_lost_ms", &s.report_lost_ms),
        ("bids_ms", &s.bids_ms),
        ("activation_ms", &s.activation_ms),
        ("release_ms", &s.release_ms),
        ("spread_percent", &s.spread_percent),
        ("gain_percent", &s.gain_percent),
        ("balance_hold_ms", &s.balance_hold_ms),
        ("balance_pause_ms", &s.balance_pause_ms),
    ];
    if settings.iter().any(|(_, v)| v.is_some()) {
        out.push_str("\n[settings]\n");
        for (name, value) in settings {
            number(&mut out, name, value.as_ref());
        }
    }
    for gateway in file.gateway.iter().map(Spanned::get_ref) {
        out.push_str("\n[[gateway]]\n");
        text(&mut out, "name", Some(&gateway.name));
        text(&mut out, "driver", Some(&gateway.driver));
        text(&mut out, "address", gateway.address.as_ref());
    }
    for controller in file.controller.iter().map(Spanned::get_ref) {
        out.push_str("\n[[controller]]\n");
        text(&mut out, "name", Some(&controller.name));
        if !controller.description.is_empty() {
            let _ = writeln!(out, "description = {}", quoted(&controller.description));
        }
        number(&mut out, "cpu_factor", controller.cpu_factor.as_ref());
        number(&mut out, "memory_mb", controller.memory_mb.as_ref());
        number(&mut out, "limit_percent", controller.limit_percent.as_ref());
    }
    for table in &file.mc {
        mc(&mut out, table.get_ref());
    }
    out
}

fn mc(out: &mut String, mc: &McTable) {
    out.push_str("\n[[mc]]\n");
    text(out, "name", Some(&mc.name));
    text(out, "program", mc.program.as_ref());
    let _ = writeln!(
        out,
        "logic = {}",
        list(mc.logic.get_ref().iter().map(|f| f.get_ref().as_str()))
    );
    text(out, "gateway", Some(&mc.gateway));
    match mc.hosts.as_ref().map(Spanned::get_ref) {
        Some(Hosts::Word(word)) => {
            let _ = writeln!(out, "hosts = {}", quoted(word));
        }
        Some(Hosts::List(hosts)) => {
            let _ = writeln!(out, "hosts = {}", list(hosts.iter().map(String::as_str)));
        }
        None => {}
    }
    let _ = writeln!(out, "criticality = {}", mc.criticality);
    number(out, "cycle_ms", mc.cycle_ms.as_ref());
    let _ = writeln!(out, "worst_case_us = {}", mc.worst_case_us.get_ref());
    number(out, "watchdog_ms", mc.watchdog_ms.as_ref());
    number(out, "suspect_ms", mc.suspect_ms.as_ref());
    text(out, "stop", mc.stop.as_ref());
    if let Some(state) = &mc.state {
        let _ = writeln!(
            out,
            "state = {}",
            list(state.iter().map(|s| s.get_ref().as_str()))
        );
    }
    if !mc.inputs.is_empty() {
        out.push_str("\n[mc.inputs]\n");
        for (name, source) in &mc.inputs {
            let _ = writeln!(
                out,
                "{} = {}",
                key(name.get_ref()),
                quoted(source.get_ref())
            );
        }
    }
    if !mc.outputs.is_empty() {
        out.push_str("\n[mc.outputs]\n");
        for (name, output) in &mc.outputs {
            let output = output.get_ref();
            let mut parts = Vec::new();
            if let Some(field) = &output.field {
                parts.push(format!("field = {}", quoted(field.get_ref())));
            }
            if output.export {
                parts.push("export = true".to_owned());
            }
            if let Some(value) = &output.fail_safe {
                parts.push(format!("fail_safe = {}", value.get_ref()));
            }
            let _ = writeln!(out, "{} = {{ {} }}", key(name.get_ref()), parts.join(", "));
        }
    }
    for interval in mc.critical_interval.iter().map(Spanned::get_ref) {
        out.push_str("\n[[mc.critical_interval]]\n");
        text(out, "name", Some(&interval.name));
        text(out, "condition", Some(&interval.condition));
        text(out, "kind", Some(&interval.kind));
        text(out, "recovery", interval.recovery.as_ref());
        if interval.repeatable {
            out.push_str("repeatable = true\n");
        }
        if !interval.checkpoint_state.is_empty() {
            out.push_str("[mc.critical_interval.checkpoint_state]\n");
            for (name, value) in &interval.checkpoint_state {
                let _ = writeln!(out, "{} = {}", key(name.get_ref()), value.get_ref());
            }
        }
    }
}

fn text(out: &mut String, name: &str, value: Option<&Spanned<String>>) {
    if let Some(value) = value {
        let _ = writeln!(out, "{name} = {}", quoted(value.get_ref()));
    }
}

fn number(out: &mut String, name: &str, value: Option<&Spanned<f64>>) {
    if let Some(value) = value {
        let _ = writeln!(out, "{name} = {}", value.get_ref());
    }
}

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_owned()).to_string()
}

fn key(name: &str) -> String {
    let bare = !name.is_empty()
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if bare { name.to_owned() } else { quoted(name) }
}

fn list<'a>(items: impl Iterator<Item = &'a str>) -> String {
    let items: Vec<String> = items.map(quoted).collect();
    format!("[{}]", items.join(", "))
}
