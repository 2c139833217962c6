//! From the text form to the model: units converted, names checked, references between parts of the file resolved.
//!
//! Every check reports and goes on, so that one run shows all that is wrong.

use super::Cell;
use super::toml_file::{CellFile, ControllerTable, FORMAT};
use crate::problem::ModelText;
use fam_proto::model::{ControllerModel, FieldDriver, GatewayModel, Settings};
use fam_proto::{CellId, ControllerId, GatewayId, NameError};
use fam_soft_plc::diag::Diagnostic;
use std::collections::BTreeMap;
use std::ops::Range;
use toml::Spanned;

const CPU_FACTOR_PERMILLE_DEFAULT: u32 = 1000;
const MEMORY_KB_DEFAULT: u64 = 256 * 1024;
const LIMIT_PERMILLE_DEFAULT: u32 = 600;

/// Resolves the tables of a model; `problems` are those of reading it.
#[must_use]
pub fn resolve(
    file: CellFile,
    text: ModelText,
    problems: Vec<Diagnostic>,
) -> (Option<Cell>, Vec<Diagnostic>) {
    let mut resolver = Resolver { text, problems };
    let cell = resolver.cell(file);
    let Resolver { text, problems } = resolver;
    (cell.map(|cell| Cell { text, ..cell }), problems)
}

/// Collects problems while the parts of the file are gone through.
pub(super) struct Resolver {
    pub(super) text: ModelText,
    pub(super) problems: Vec<Diagnostic>,
}

impl Resolver {
    pub(super) fn error(
        &mut self,
        code: &str,
        at: Range<usize>,
        message: impl Into<String>,
    ) -> &mut Diagnostic {
        let problem = self.text.error(code, at, message);
        self.problems.push(problem);
        self.problems.last_mut().expect("one was just added")
    }

    pub(super) fn name<T>(
        &mut self,
        name: &Spanned<String>,
        new: fn(&str) -> Result<T, NameError>,
    ) -> Option<T> {
        match new(name.get_ref()) {
            Ok(id) => Some(id),
            Err(e) => {
                // The error is one sentence with what was expected behind a colon.
                let text = e.to_string();
                let (message, expected) = text.split_once(": expected ").unwrap_or((&text, ""));
                let (message, expected) = (message.to_owned(), expected.to_owned());
                self.error("M201", name.span(), message).expected = Some(expected);
                None
            }
        }
    }

    /// Milliseconds as whole microseconds.
    pub(super) fn micros(&mut self, value: &Spanned<f64>, what: &str) -> Option<u64> {
        const US_MAX: f64 = 86_400e6;
        let us = value.get_ref() * 1000.0;
        let whole = us.round();
        if us.is_finite() && (us - whole).abs() < 1e-6 && (1.0..=US_MAX).contains(&whole) {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            // in range by the test above
            return Some(whole as u64);
        }
        let expected = "milliseconds, from 0.001 to one day, in whole microseconds";
        self.error(
            "M401",
            value.span(),
            format!("{what} cannot be {} ms", value.get_ref()),
        )
        .expected = Some(expected.to_owned());
        None
    }

    fn permille(
        &mut self,
        value: &Spanned<f64>,
        what: &str,
        unit: &str,
        scale: f64,
        max: f64,
    ) -> Option<u32> {
        let permille = (value.get_ref() * scale).round();
        if permille.is_finite() && (1.0..=max).contains(&permille) {
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            // in range by the test above
            return Some(permille as u32);
        }
        self.error(
            "M401",
            value.span(),
            format!("{what} cannot be {}{unit}", value.get_ref()),
        )
        .expected = Some(format!("{} to {}{unit}", 1.0 / scale, max / scale));
        None
    }

    fn cell(&mut self, file: CellFile) -> Option<Cell> {
        if *file.format.get_ref() != FORMAT {
            self.error(
                "M102",
                file.format.span(),
                format!("the file has format {}", file.format.get_ref()),
            )
            .expected = Some(format!(
                "format = {FORMAT}, which is what this version of fam reads"
            ));
            return None;
        }
        let cell = self.name(&file.cell.name, CellId::new);
        let tick_us = self
            .micros(&file.cell.tick_ms, "the tick")
            .map_or(5_000, |us| u32::try_from(us).unwrap_or(u32::MAX));
        let link_bytes_s = file.cell.link_mbit_s.as_ref().and_then(|mbit| {
            let bytes = mbit.get_ref() * 125_000.0;
            if bytes.is_finite() && bytes >= 1.0 {
                #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                // positive; a cast saturates
                return Some(Spanned::new(mbit.span(), bytes as u64));
            }
            self.error("M401", mbit.span(), "a link needs a throughput above 0")
                .expected = Some("Mbit/s, such as 1000".to_owned());
            None
        });
        let settings = self.settings(&file.settings);
        let gateways = self.gateways(&file);
        let controllers = self.controllers(&file.controller, tick_us);
        let mcs = self.mcs(file.mc, tick_us, &gateways, &controllers);
        self.exports(&mcs);
        self.capacity(&mcs, &controllers);
        Some(Cell {
            text: ModelText::default(),
            cell: cell?,
            tick_us,
            link_bytes_s,
            settings,
            gateways,
            controllers,
            mcs,
        })
    }

    fn settings(&mut self, table: &super::toml_file::SettingsTable) -> Settings {
        let mut settings = Settings::default();
        for (value, target, what) in [
            (&table.report_ms, &mut settings.report_us, "report_ms"),
            (
                &table.report_lost_ms,
                &mut settings.report_lost_us,
                "report_lost_ms",
            ),
            (&table.bids_ms, &mut settings.bids_us, "bids_ms"),
            (
                &table.activation_ms,
                &mut settings.activation_us,
                "activation_ms",
            ),
            (&table.release_ms, &mut settings.release_us, "release_ms"),
            (
                &table.balance_hold_ms,
                &mut settings.balance_hold_us,
                "balance_hold_ms",
            ),
            (
                &table.balance_pause_ms,
                &mut settings.balance_pause_us,
                "balance_pause_ms",
            ),
        ] {
            if let Some(us) = value.as_ref().and_then(|v| self.micros(v, what)) {
                *target = us;
            }
        }
        for (value, target, what) in [
            (
                &table.spread_percent,
                &mut settings.spread_permille,
                "spread_percent",
            ),
            (
                &table.gain_percent,
                &mut settings.gain_permille,
                "gain_percent",
            ),
        ] {
            if let Some(p) = value
                .as_ref()
                .and_then(|v| self.permille(v, what, " %", 10.0, 1000.0))
            {
                *target = p;
            }
        }
        if settings.report_lost_us < 2 * settings.report_us {
            let at = table.report_lost_ms.as_ref().or(table.report_ms.as_ref());
            let at = at.map_or(0..0, Spanned::span);
            let lost_ms = settings.report_lost_us / 1000;
            let report_ms = settings.report_us / 1000;
            self.error(
                "M402",
                at,
                format!("report_lost_ms ({lost_ms}) leaves no room for a lost report"),
            )
            .expected = Some(format!("at least twice report_ms ({report_ms})"));
        }
        settings
    }

    /// Reports a name that an earlier part of the same kind has.
    pub(super) fn is_new(
        &mut self,
        seen: &mut BTreeMap<String, Range<usize>>,
        kind: &str,
        name: &Spanned<String>,
    ) -> bool {
        let key = name.get_ref().to_ascii_lowercase();
        if let Some(first) = seen.get(&key) {
            let (line, _) = self.text.position(first.start);
            self.error(
                "M202",
                name.span(),
                format!("there are two {kind} named `{}`", name.get_ref()),
            )
            .hint = Some(format!(
                "the first one stands in line {line}; rename one of them"
            ));
            return false;
        }
        seen.insert(key, name.span());
        true
    }

    fn gateways(&mut self, file: &CellFile) -> Vec<GatewayModel> {
        let mut seen = BTreeMap::new();
        let mut list = Vec::new();
        let tick_us = self.micros_quietly(&file.cell.tick_ms);
        for table in &file.gateway {
            let table = table.get_ref();
            let driver = match (table.driver.get_ref().as_str(), &table.address) {
                ("modbus", Some(address)) => Some(FieldDriver::Modbus {
                    address: address.get_ref().clone(),
                }),
                ("modbus", None) => {
                    self.error(
                        "M203",
                        table.driver.span(),
                        "the driver `modbus` needs an address",
                    )
                    .hint = Some("add `address = \"127.0.0.1:1502\"`".to_owned());
                    None
                }
                ("image", None) => Some(FieldDriver::Image),
                ("image", Some(address)) => {
                    self.error(
                        "M203",
                        address.span(),
                        "the driver `image` has no device and no address",
                    )
                    .hint = Some("remove the address, or use the driver `modbus`".to_owned());
                    None
                }
                (other, _) => {
                    self.error(
                        "M203",
                        table.driver.span(),
                        format!("`{other}` is no field driver"),
                    )
                    .expected = Some("modbus or image".to_owned());
                    None
                }
            };
            if self.is_new(&mut seen, "gateways", &table.name)
                && let Some(gateway) = self.name(&table.name, GatewayId::new)
            {
                // A gateway with a wrong driver stays known, so that MCs that name it are not wrong as well.
                list.push(GatewayModel {
                    gateway,
                    tick_us,
                    driver: driver.unwrap_or(FieldDriver::Image),
                });
            }
        }
        if file.gateway.is_empty() {
            self.error("M204", file.cell.name.span(), "the cell has no gateway")
                .hint = Some("add a `[[gateway]]` with `name` and `driver`".to_owned());
        }
        list.sort_by(|a, b| a.gateway.cmp(&b.gateway));
        list
    }

    fn micros_quietly(&mut self, value: &Spanned<f64>) -> u32 {
        let known = self.problems.len();
        let us = self.micros(value, "the tick");
        self.problems.truncate(known);
        us.map_or(5_000, |us| u32::try_from(us).unwrap_or(u32::MAX))
    }

    fn controllers(
        &mut self,
        tables: &[Spanned<ControllerTable>],
        tick_us: u32,
    ) -> Vec<ControllerModel> {
        let mut seen = BTreeMap::new();
        let mut list = Vec::new();
        for table in tables {
            let table = table.get_ref();
            let cpu_factor_permille = match &table.cpu_factor {
                Some(v) => self.permille(v, "a CPU factor", "", 1000.0, 100_000.0),
                None => None,
            };
            let limit_permille = match &table.limit_percent {
                Some(v) => self.permille(v, "the limit", " %", 10.0, 1000.0),
                None => None,
            };
            let memory_kb = table.memory_mb.as_ref().and_then(|mb| {
                let kb = mb.get_ref() * 1024.0;
                if kb.is_finite() && kb >= 1.0 {
                    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
                    // positive; a cast saturates
                    return Some(kb as u64);
                }
                self.error("M401", mb.span(), "a controller needs memory above 0")
                    .expected = Some("MB, such as 256".to_owned());
                None
            });
            if self.is_new(&mut seen, "controllers", &table.name)
                && let Some(controller) = self.name(&table.name, ControllerId::new)
            {
                list.push(ControllerModel {
                    controller,
                    description: table.description.clone(),
                    cpu_factor_permille: cpu_factor_permille.unwrap_or(CPU_FACTOR_PERMILLE_DEFAULT),
                    memory_kb: memory_kb.unwrap_or(MEMORY_KB_DEFAULT),
                    limit_permille: limit_permille.unwrap_or(LIMIT_PERMILLE_DEFAULT),
                    tick_us,
                });
            }
        }
        list.sort_by(|a, b| a.controller.cmp(&b.controller));
        list
    }
}

/// Milliseconds for people.
#[must_use]
#[allow(clippy::cast_precision_loss)] // times of a model are far below 2^53 us
pub fn ms(us: u64) -> String {
    format!("{} ms", us as f64 / 1000.0)
}

/// IEC 61131-3, clause 6.1.2: letters, digits and underscores, none doubled, none at the end.
#[must_use]
pub fn is_iec_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_alphabetic())
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        && !name.contains("__")
        && !name.ends_with('_')
}
