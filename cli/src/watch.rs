//! `fam watch`: live values of running MCs, from the heads that their gateway keeps. The controllers notice nothing.
//!
//! What is shown of an MC is one moment of it: the state behind the outputs that were applied last, with these outputs.

use crate::args::WatchArgs;
use crate::run::shown_text;
use anyhow::{Context, Result, anyhow, bail};
use fam_driver::Client;
use fam_engineering::{BuiltCell, BuiltMc};
use fam_proto::{CellId, GatewayId, LayoutHash, McId, Watched, codec, keys};
use fam_soft_plc::layout::{Area, VariableInfo};
use fam_soft_plc::standalone::show;
use fam_soft_plc::{Engine, EngineOptions, Instance};
use std::io::{IsTerminal, Write};
use std::time::Duration;

/// How long a gateway may take to answer.
const WITHIN: Duration = Duration::from_secs(3);
/// Names offered where one is not known.
const OFFERED_MAX: usize = 8;

/// An MC with the variables that are watched of it.
struct Watch<'a> {
    mc: McId,
    gateway: GatewayId,
    layout: LayoutHash,
    built: &'a BuiltMc,
    instance: Instance,
    variables: Vec<VariableInfo>,
}

/// `fam watch`
///
/// # Errors
/// If a variable is not known, the gateway cannot be reached, or it runs another version than the model.
pub async fn run(args: &WatchArgs) -> Result<()> {
    let path = args.cell.clone();
    let built = tokio::task::spawn_blocking(move || fam_engineering::build(&path)).await?;
    let built = built.map_err(|problems| anyhow!("{problems}"))?;
    let mut watches = resolve(&built, &args.variables)?;
    let cell: CellId = built.model.cell.clone();
    let client = Client::open(cell.clone(), args.endpoints.clone()).await?;
    let terminal = std::io::stdout().is_terminal() && !args.csv;
    if args.csv {
        println!("{}", header(&watches));
    }
    let mut seen = Vec::new();
    let mut left = args.samples;
    let mut every = tokio::time::interval(Duration::from_millis(args.every_ms.max(1)));
    every.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    while left != Some(0) {
        every.tick().await;
        let mut samples = Vec::new();
        for watch in &mut watches {
            let key = keys::watch(&cell, &watch.gateway);
            let asked = watch.mc.as_str().as_bytes().to_vec();
            let answer = client.link().request(&key, asked, WITHIN).await;
            let answer = answer.with_context(|| {
                format!(
                    "gateway {} does not show {}",
                    watch.gateway,
                    watch.mc.as_str()
                )
            })?;
            samples.push(codec::decode::<Watched>(&answer)?);
        }
        let scans: Vec<_> = samples.iter().map(scan_of).collect();
        if scans == seen {
            continue; // nothing was applied since
        }
        seen = scans;
        let rows = rows(&mut watches, &samples)?;
        let mut out = std::io::stdout().lock();
        if args.csv {
            let at_us = samples.iter().map(|s| s.at_us).max().unwrap_or(0);
            writeln!(out, "{}", line(at_us, &samples, &rows))?;
        } else {
            let home = if terminal { "\x1b[H\x1b[2J" } else { "" };
            writeln!(out, "{home}{}", table(&watches, &samples, &rows))?;
        }
        out.flush()?;
        left = left.map(|n| n - 1);
    }
    client.close().await;
    Ok(())
}

fn scan_of(sample: &Watched) -> Option<fam_proto::CheckpointId> {
    sample.record.head.as_ref().map(|h| h.checkpoint.id)
}

/// The variables by MC, in the order in which the MCs are named first.
fn resolve<'a>(built: &'a BuiltCell, names: &[String]) -> Result<Vec<Watch<'a>>> {
    let engine = Engine::new(EngineOptions::default())?;
    let mut watches: Vec<Watch<'a>> = Vec::new();
    for name in names {
        let (mc, path) = name
            .split_once('.')
            .ok_or_else(|| anyhow!("`{name}`: expected <MC>.<variable>, such as Station1.step"))?;
        let known = built
            .model
            .mcs
            .iter()
            .find(|m| m.mc.as_str().eq_ignore_ascii_case(mc));
        let Some((model, part)) = known.and_then(|m| Some((m, built.mc(&m.mc)?))) else {
            let all: Vec<&str> = built.model.mcs.iter().map(|m| m.mc.as_str()).collect();
            bail!(
                "`{name}`: the cell {} has no MC `{mc}`; it has {}",
                built.model.cell,
                all.join(", ")
            );
        };
        let at = match watches.iter().position(|w| w.mc == model.mc) {
            Some(at) => at,
            None => {
                let module = engine.prepare(&part.compiled)?;
                watches.push(Watch {
                    mc: model.mc.clone(),
                    gateway: model.gateway.clone(),
                    layout: model.layout,
                    built: part,
                    instance: Instance::new(&engine, &module)?,
                    variables: Vec::new(),
                });
                watches.len() - 1
            }
        };
        let variable = find(&watches[at], path).with_context(|| format!("`{name}`"))?;
        watches[at].variables.push(variable);
    }
    Ok(watches)
}

/// A variable by its path in the MC's program, or by its whole path (`Station1_Control.wasActive`).
fn find(watch: &Watch<'_>, path: &str) -> Result<VariableInfo> {
    let layout = watch.instance.layout();
    let program = &watch.built.program;
    let candidates = [format!("{program}.{path}"), path.to_owned()];
    let Some(found) = candidates.iter().find_map(|p| layout.find(p)) else {
        let first = path.split(['.', '[']).next().unwrap_or(path);
        let near = layout.roots.iter().map(|root| {
            let name = root.path.strip_prefix(program.as_str());
            name.and_then(|n| n.strip_prefix('.')).unwrap_or(&root.path)
        });
        let mut near: Vec<&str> = near.filter(|n| !n.contains("__")).collect();
        near.sort_by_key(|n| distance(n, first));
        near.truncate(OFFERED_MAX);
        bail!(
            "{} has no variable `{path}`; near it: {}",
            watch.mc,
            near.join(", ")
        );
    };
    if is_kept(watch, &found) {
        return Ok(found);
    }
    bail!(
        "`{path}` is no part of the state of {}: it is not in its checkpoints, and nobody but its controller sees it",
        watch.mc
    );
}

/// How unlike two names are: what they do not share at their beginning, without regard to case.
fn distance(a: &str, b: &str) -> usize {
    let (a, b) = (a.to_ascii_lowercase(), b.to_ascii_lowercase());
    let same = a.bytes().zip(b.bytes()).take_while(|(x, y)| x == y).count();
    a.len() + b.len() - 2 * same
}

/// Whether the variable lies in checkpoint, inputs or outputs.
fn is_kept(watch: &Watch<'_>, variable: &VariableInfo) -> bool {
    match variable.area {
        Area::Inputs | Area::Outputs => true,
        Area::Region(region) => {
            [checkpoint_region(watch), state_region(watch)].contains(&Some(region))
        }
    }
}

fn checkpoint_region(watch: &Watch<'_>) -> Option<usize> {
    let layout = watch.instance.layout();
    layout.region_index(fam_engineering::generate::REGION_CHECKPOINT)
}

fn state_region(watch: &Watch<'_>) -> Option<usize> {
    let layout = watch.instance.layout();
    layout.region_index(fam_engineering::generate::REGION_STATE)
}

/// The values of all watched variables as text, by MC; `None` for an MC that has never run.
fn rows(watches: &mut [Watch<'_>], samples: &[Watched]) -> Result<Vec<Option<Vec<String>>>> {
    let mut rows = Vec::new();
    for (watch, sample) in watches.iter_mut().zip(samples) {
        let Some(head) = &sample.record.head else {
            rows.push(None);
            continue;
        };
        let state = &head.checkpoint.state;
        let fits = head.checkpoint.layout == watch.layout;
        let (Some(whole), Some(part), true) = (checkpoint_region(watch), state_region(watch), fits)
        else {
            bail!(
                "the cell runs another version of {} than this model; give the model in force with --cell",
                watch.mc
            );
        };
        let serialized = &watch.built.control.state;
        fill(watch.instance.region_mut(whole), state);
        let serialized = state.get(serialized.start as usize..serialized.end as usize);
        fill(watch.instance.region_mut(part), serialized.unwrap_or(&[]));
        fill(watch.instance.inputs_mut(), &sample.inputs);
        fill(watch.instance.outputs_mut(), &head.outputs);
        let text = |v: &VariableInfo| {
            show(&watch.instance, v).map_or(String::new(), |shown| shown_text(&shown))
        };
        rows.push(Some(watch.variables.iter().map(text).collect()));
    }
    Ok(rows)
}

fn fill(to: &mut [u8], from: &[u8]) {
    let len = to.len().min(from.len());
    to[..len].copy_from_slice(&from[..len]);
}

fn name_of(watch: &Watch<'_>, variable: &VariableInfo) -> String {
    let path = variable.path.strip_prefix(watch.built.program.as_str());
    let path = path
        .and_then(|p| p.strip_prefix('.'))
        .unwrap_or(&variable.path);
    format!("{}.{path}", watch.mc)
}

fn header(watches: &[Watch<'_>]) -> String {
    let mut columns = vec!["time_ms".to_owned()];
    for watch in watches {
        columns.push(format!("{}.scan", watch.mc));
        columns.extend(watch.variables.iter().map(|v| quoted(&name_of(watch, v))));
    }
    columns.join(",")
}

fn line(at_us: u64, samples: &[Watched], rows: &[Option<Vec<String>>]) -> String {
    let mut columns = vec![format!("{}.{:03}", at_us / 1_000, at_us % 1_000)];
    for (sample, row) in samples.iter().zip(rows) {
        columns.push(scan_of(sample).map_or(String::new(), |id| id.scan.to_string()));
        columns.extend(row.iter().flatten().map(|v| quoted(v)));
    }
    columns.join(",")
}

/// As RFC 4180 wants it.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

fn table(watches: &[Watch<'_>], samples: &[Watched], rows: &[Option<Vec<String>>]) -> String {
    let mut table = crate::status::table(&["variable", "value"]);
    let mut titles = Vec::new();
    for ((watch, sample), row) in watches.iter().zip(samples).zip(rows) {
        let record = &sample.record;
        let owner = record
            .owner
            .as_ref()
            .map_or("nobody", |o| o.controller.as_str());
        titles.push(match scan_of(sample) {
            Some(id) => format!(
                "{} on {owner}, {}, epoch {}, scan {}",
                watch.mc,
                record.state.word(),
                record.epoch,
                id.scan
            ),
            None => format!("{} has never run", watch.mc),
        });
        for (variable, value) in watch.variables.iter().zip(row.iter().flatten()) {
            table.add_row([name_of(watch, variable), value.clone()]);
        }
    }
    format!("{}\n{table}", titles.join("\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_quoted_as_csv_wants_it() {
        for (text, expected) in [
            ("12", "12"),
            ("[1,2]", "\"[1,2]\""),
            ("say \"so\"", "\"say \"\"so\"\"\""),
        ] {
            assert_eq!(quoted(text), expected);
        }
    }

    #[test]
    fn the_likest_names_come_first() {
        let mut names = ["speed", "step", "station", "x"];
        names.sort_by_key(|n| distance(n, "stepp"));
        assert_eq!(names[0], "step");
    }
}
