//! A proposal as the tables of a cell: `image` driver, every MC on every controller.

use crate::import::ProposedMc;
use crate::model::toml_file::{
    CellFile, CellTable, ControllerTable, FORMAT, GatewayTable, Hosts, McTable, OutputTable,
    SettingsTable,
};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use toml::Spanned;

/// Tick of a cell whose project says nothing, in milliseconds.
const TICK_MS_DEFAULT: f64 = 10.0;
/// A guess of the worst-case time of a scan.
const WORST_CASE_US_DEFAULT: f64 = 500.0;
const GATEWAY: &str = "gateway1";

/// A controller of the cell.
#[derive(Debug, Clone)]
pub struct ProposedController {
    /// Its name.
    pub name: String,
    /// For people.
    pub description: String,
    /// Its place in the model.
    pub at: Range<usize>,
}

/// A mechatronic component with its place in the model and the file that its logic is in.
#[derive(Debug, Clone)]
pub struct PlacedMc {
    /// What was proposed.
    pub mc: ProposedMc,
    /// Its place in the model.
    pub at: Range<usize>,
    /// Name of its logic file.
    pub file: String,
}

/// A name as FAM's identifiers take it: IEC letters, digits and single underscores.
#[must_use]
pub fn name_of(text: &str) -> String {
    let mut name = String::new();
    for c in text.chars() {
        let c = if c.is_ascii_alphanumeric() { c } else { '_' };
        if c != '_' || !name.ends_with('_') {
            name.push(c);
        }
    }
    let name = name.trim_matches('_');
    if name.starts_with(|c: char| c.is_ascii_alphabetic()) {
        name.to_owned()
    } else {
        format!("x{name}")
    }
}

/// The tables.
#[must_use]
pub fn tables(
    cell: Spanned<String>,
    controllers: &[ProposedController],
    mcs: &[PlacedMc],
) -> CellFile {
    let tick_ms = tick_ms(mcs);
    let points = Points::of(mcs);
    CellFile {
        format: Spanned::new(0..0, FORMAT),
        cell: CellTable {
            name: cell,
            tick_ms: Spanned::new(0..0, tick_ms),
            link_mbit_s: None,
        },
        settings: SettingsTable::default(),
        gateway: vec![Spanned::new(
            0..0,
            GatewayTable {
                name: Spanned::new(0..0, GATEWAY.to_owned()),
                driver: Spanned::new(0..0, "image".to_owned()),
                address: None,
            },
        )],
        controller: controllers
            .iter()
            .map(|c| {
                let table = ControllerTable {
                    name: Spanned::new(c.at.clone(), c.name.clone()),
                    description: c.description.clone(),
                    cpu_factor: None,
                    memory_mb: None,
                    limit_percent: None,
                };
                Spanned::new(c.at.clone(), table)
            })
            .collect(),
        mc: mcs
            .iter()
            .map(|mc| mc_table(mc, tick_ms, &points))
            .collect(),
    }
}

/// The largest tick of which all cycles are multiples, in whole milliseconds where they are.
fn tick_ms(mcs: &[PlacedMc]) -> f64 {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // positive and short
    let cycles_us = mcs
        .iter()
        .filter_map(|m| m.mc.cycle_ms)
        .map(|ms| (ms * 1000.0).round() as u64)
        .filter(|us| *us > 0);
    let tick_us = cycles_us.fold(0, gcd);
    if tick_us == 0 {
        TICK_MS_DEFAULT
    } else {
        #[allow(clippy::cast_precision_loss)] // microseconds of a cycle
        let ms = tick_us as f64 / 1000.0;
        ms
    }
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The addresses that variables of one name have, whatever MC they are in.
struct Points<'a>(BTreeMap<String, BTreeSet<&'a str>>);

impl<'a> Points<'a> {
    fn of(mcs: &'a [PlacedMc]) -> Self {
        let mut all: BTreeMap<String, BTreeSet<&str>> = BTreeMap::new();
        for PlacedMc { mc, .. } in mcs {
            let inputs = mc.inputs.iter().map(|i| (&i.name, &i.address));
            let outputs = mc.outputs.iter().map(|o| (&o.name, &o.address));
            for (name, address) in inputs.chain(outputs).filter(|(_, a)| !a.is_empty()) {
                let of_name = all.entry(name.to_ascii_uppercase()).or_default();
                of_name.insert(address);
            }
        }
        Self(all)
    }

    /// The point of a variable: its name, with that of its MC where the name means several addresses.
    fn name(&self, mc: &str, variable: &str) -> String {
        let of_name = self.0.get(&variable.to_ascii_uppercase());
        // Of a located string the characters have points.
        let variable = variable.trim_start_matches("__text_");
        if of_name.is_some_and(|addresses| addresses.len() > 1) {
            return format!("image:{}_{variable}", name_of(mc));
        }
        format!("image:{variable}")
    }
}

fn mc_table(placed: &PlacedMc, tick_ms: f64, points: &Points<'_>) -> Spanned<McTable> {
    let PlacedMc { mc, at, file } = placed;
    let here = |text: &str| Spanned::new(at.clone(), text.to_owned());
    let cycle_ms = mc.cycle_ms.unwrap_or(tick_ms);
    // Four silent cycles are no failure yet, and a failover has to end before the watchdog strikes.
    let suspect_ms = (4.0 * cycle_ms).max(50.0);
    let watchdog_ms = (2.0 * suspect_ms + 100.0).max(1000.0);
    let worst_case_us = WORST_CASE_US_DEFAULT.min(cycle_ms * 1000.0 / 4.0);
    let point = |name: &str| points.name(&mc.name, name);
    let inputs: BTreeMap<Spanned<String>, Spanned<String>> = mc
        .inputs
        .iter()
        .map(|input| {
            let source = match &input.from {
                Some((peer, output)) => format!("mc:{}.{output}", name_of(peer)),
                None => point(&input.name),
            };
            (here(&input.name), here(&source))
        })
        .collect();
    let outputs = mc
        .outputs
        .iter()
        .map(|output| {
            let table = OutputTable {
                field: output.field.then(|| here(&point(&output.name))),
                export: output.export,
                fail_safe: Some(Spanned::new(at.clone(), output.idle.clone())),
            };
            (here(&output.name), Spanned::new(at.clone(), table))
        })
        .collect();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most the default
    let worst_case_us = worst_case_us.max(1.0) as u32;
    let table = McTable {
        name: here(&name_of(&mc.name)),
        program: Some(here(&mc.program)),
        logic: Spanned::new(at.clone(), vec![here(file)]),
        gateway: here(GATEWAY),
        hosts: Some(Spanned::new(at.clone(), Hosts::Word("all".to_owned()))),
        criticality: 0,
        cycle_ms: Some(Spanned::new(at.clone(), cycle_ms)),
        worst_case_us: Spanned::new(at.clone(), worst_case_us),
        watchdog_ms: Some(Spanned::new(at.clone(), watchdog_ms)),
        suspect_ms: Some(Spanned::new(at.clone(), suspect_ms)),
        stop: None,
        state: None,
        inputs,
        outputs,
        critical_interval: Vec::new(),
    };
    Spanned::new(at.clone(), table)
}
