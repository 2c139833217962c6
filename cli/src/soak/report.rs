//! The ledger of a soak, for people and as JSON.

use super::ledger::Ledger;
use super::meter::{Holding, Meter};
use comfy_table::Cell;
use fam_plant::PlantStatus;
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;

/// Everything that is told at the end.
pub struct Report<'a> {
    pub minutes: u64,
    pub seed: u64,
    pub faults: BTreeMap<&'static str, u64>,
    pub commands_refused: u64,
    pub ledger: &'a Ledger,
    pub plant: &'a PlantStatus,
    pub meter: &'a Meter,
    pub stalls: usize,
    pub journal_holes: u64,
}

impl Report<'_> {
    /// Whether all that must be 0 is 0.
    pub fn held(&self) -> bool {
        let l = self.ledger;
        l.double_driven == 0
            && l.lost == 0
            && l.false_failovers == 0
            && l.stuck == 0
            && self.plant.incidents_total == 0
    }

    /// The ledger as one object.
    pub fn json(&self) -> Value {
        Value::Object(self.figures())
    }

    fn figures(&self) -> Map<String, Value> {
        let l = self.ledger;
        let mut figures = Map::new();
        let mut add = |name: &str, value: Value| {
            figures.insert(name.to_owned(), value);
        };
        add("minutes", json!(self.minutes));
        add("seed", json!(self.seed));
        add("faults", json!(self.faults));
        add("faults_total", json!(self.faults.values().sum::<u64>()));
        add("commands_refused", json!(self.commands_refused));
        add("failovers", json!(l.failovers));
        add("false_failovers", json!(l.false_failovers));
        add(
            "false_failovers_while_machine_stalled",
            json!(l.false_while_stalled),
        );
        add("planned_moves", json!(l.planned_moves));
        add("recoveries", json!(l.recoveries));
        add("double_driven_scans", json!(l.double_driven));
        add("applied_scans_lost", json!(l.lost));
        add("incidents", json!(self.plant.incidents_total));
        add("stuck_mcs", json!(l.stuck));
        add("mcs_stopped", json!(l.stops));
        add("products", json!(self.plant.finished));
        add("scans_applied", json!(l.scans));
        add("longest_gap_ms", json!(l.longest_gap_us / 1_000));
        add("journal_holes", json!(self.journal_holes));
        add("stalls_witnessed", json!(self.stalls));
        let processes: Map<String, Value> = self
            .meter
            .held()
            .iter()
            .map(|(name, held)| {
                let holding = |h: Holding| json!({ "rss_mb": mb(h.rss_kb), "fds": h.fds });
                let (measured, from, to) = held.longest;
                let value = json!({
                    "start": holding(held.start),
                    "end": holding(held.end),
                    "peak": holding(held.peak),
                    "lives": held.lives,
                    "longest_life": { "measurements": measured, "start": holding(from), "end": holding(to) },
                });
                (name.clone(), value)
            })
            .collect();
        add("processes", Value::Object(processes));
        figures
    }

    /// Two tables.
    pub fn print(&self) {
        let mut table = crate::status::table(&["figure", "value"]);
        for (name, value) in self.figures() {
            match value {
                Value::Object(inner) if name != "processes" => {
                    for (kind, n) in inner {
                        table.add_row(vec![
                            Cell::new(format!("{name}: {kind}")),
                            crate::status::number(&n),
                        ]);
                    }
                }
                Value::Object(_) => {}
                value => {
                    table.add_row(vec![Cell::new(name), crate::status::number(&value)]);
                }
            }
        }
        println!("{table}");
        let mut table = crate::status::table(&[
            "process",
            "lives",
            "MB start",
            "MB end",
            "MB peak",
            "files start",
            "files end",
            "files peak",
        ]);
        for (name, held) in self.meter.held() {
            let cells = [
                name.clone(),
                held.lives.to_string(),
                mb(held.start.rss_kb).to_string(),
                mb(held.end.rss_kb).to_string(),
                mb(held.peak.rss_kb).to_string(),
                held.start.fds.to_string(),
                held.end.fds.to_string(),
                held.peak.fds.to_string(),
            ];
            table.add_row(cells.map(Cell::new).to_vec());
        }
        println!("{table}");
    }
}

#[allow(clippy::cast_precision_loss)]
fn mb(kb: u64) -> f64 {
    (kb as f64 / 102.4).round() / 10.0
}
