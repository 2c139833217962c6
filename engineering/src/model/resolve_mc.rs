//! Mechatronic components: hosts, timing, inputs and outputs, critical intervals, and what they say of each other.

use super::resolve::{Resolver, is_iec_name, ms};
use super::toml_file::{Hosts, IntervalTable, McTable};
use super::{InputFrom, InputSpec, IntervalSpec, McSpec, OutputSpec, points};
use crate::problem::{Explain, suggestion};
use fam_proto::diagnosis::IntervalKind;
use fam_proto::model::{ControllerModel, FieldDriver, FieldPoint, GatewayModel, ModbusTable};
use fam_proto::{ControllerId, McId};
use std::collections::BTreeMap;
use std::ops::Range;
use toml::Spanned;

/// A move after a freeze may take this long (design, section 9): the watchdog has to wait for it.
pub const FAILOVER_BOUND_US: u64 = 80_000;
/// The gateway refuses an open while the owner's frames are fresh (3 cycles); silence must last longer before it is reported.
pub const SUSPECT_CYCLES_MIN: u64 = 4;

const WATCHDOG_US_DEFAULT: u64 = 1_000_000;
const SUSPECT_US_DEFAULT: u64 = 50_000;

impl Resolver {
    pub(super) fn mcs(
        &mut self,
        tables: Vec<Spanned<McTable>>,
        tick_us: u32,
        gateways: &[GatewayModel],
        controllers: &[ControllerModel],
    ) -> Vec<McSpec> {
        let mut seen = BTreeMap::new();
        let mut list = Vec::new();
        for table in tables {
            let table = table.into_inner();
            let is_new = self.is_new(&mut seen, "MCs", &table.name);
            if let Some(spec) = self.mc(table, tick_us, gateways, controllers)
                && is_new
            {
                list.push(spec);
            }
        }
        list.sort_by(|a, b| a.mc.cmp(&b.mc));
        list
    }

    fn mc(
        &mut self,
        table: McTable,
        tick_us: u32,
        gateways: &[GatewayModel],
        controllers: &[ControllerModel],
    ) -> Option<McSpec> {
        let mc = self.name(&table.name, McId::new);
        let name = table.name.get_ref().clone();
        if mc.is_some() && !is_iec_name(&name) {
            self.error(
                "M201",
                table.name.span(),
                format!(
                    "`{name}` cannot be the name of an MC, because its POUs are named after it"
                ),
            )
            .expected = Some(
                "letters, digits and single underscores, not ending in one (IEC 61131-3)"
                    .to_owned(),
            );
            return None;
        }
        let gateway = gateways
            .iter()
            .find(|g| g.gateway.as_str() == table.gateway.get_ref());
        // Without any gateway that alone is what is wrong.
        if gateway.is_none() && !gateways.is_empty() {
            let known: Vec<&str> = gateways.iter().map(|g| g.gateway.as_str()).collect();
            let hint = suggestion(table.gateway.get_ref(), known);
            self.error(
                "M205",
                table.gateway.span(),
                format!(
                    "MC {name}: there is no gateway `{}`",
                    table.gateway.get_ref()
                ),
            )
            .hint = Some(hint);
        }
        let hosts = self.hosts(&table, controllers);
        if table.logic.get_ref().is_empty() {
            self.error(
                "M206",
                table.logic.span(),
                format!("MC {name} has no logic"),
            )
            .expected = Some("at least one .st or PLCopen XML file".to_owned());
        }
        let (cycle_us, watchdog_us, suspect_us) = self.timing(&table, tick_us);
        let driver = gateway.map(|g| &g.driver);
        let inputs = self.inputs(&name, &table, driver);
        let outputs = self.outputs(&name, &table, driver);
        let intervals = self.intervals(&name, &table);
        let program = table
            .program
            .clone()
            .unwrap_or_else(|| Spanned::new(table.name.span(), name.clone()));
        Some(McSpec {
            mc: mc?,
            at: table.name.span(),
            program,
            logic: table.logic.into_inner(),
            gateway: gateway.map(|g| g.gateway.clone()),
            hosts,
            criticality: table.criticality,
            cycle_us,
            worst_case_us: *table.worst_case_us.get_ref(),
            watchdog_us,
            suspect_us,
            stop: table.stop,
            state: table.state,
            inputs,
            outputs,
            intervals,
        })
    }

    fn hosts(&mut self, table: &McTable, controllers: &[ControllerModel]) -> Vec<ControllerId> {
        let name = table.name.get_ref();
        let known: Vec<&str> = controllers.iter().map(|c| c.controller.as_str()).collect();
        let mut hosts = Vec::new();
        let at = table
            .hosts
            .as_ref()
            .map_or(table.name.span(), Spanned::span);
        match table.hosts.as_ref().map(Spanned::get_ref) {
            Some(Hosts::Word(word)) if word == "all" => {
                hosts.extend(controllers.iter().map(|c| c.controller.clone()));
            }
            Some(Hosts::Word(word)) => {
                let word = word.clone();
                self.error(
                    "M207",
                    at,
                    format!("MC {name}: `{word}` is no list of controllers"),
                )
                .expected = Some(format!("hosts = \"all\" or hosts = [\"{word}\"]"));
                return hosts;
            }
            Some(Hosts::List(list)) => {
                for host in list {
                    match controllers.iter().find(|c| c.controller.as_str() == host) {
                        Some(c) if hosts.contains(&c.controller) => {}
                        Some(c) => hosts.push(c.controller.clone()),
                        None => {
                            let hint = suggestion(host, known.clone());
                            self.error(
                                "M207",
                                at.clone(),
                                format!("MC {name}: there is no controller `{host}`"),
                            )
                            .hint = Some(hint);
                        }
                    }
                }
                if hosts.is_empty() && !list.is_empty() {
                    return hosts;
                }
            }
            None => {}
        }
        if hosts.is_empty() {
            self.error("M208", at, format!("MC {name} is hosted on no controller"))
                .hint = Some(if known.is_empty() {
                "add a `[[controller]]`, and `hosts = \"all\"` to the MC".to_owned()
            } else {
                format!("add `hosts = \"all\"`, or a list of: {}", known.join(", "))
            });
        }
        hosts.sort();
        hosts
    }

    /// Cycle, watchdog and suspect time, in microseconds.
    fn timing(&mut self, table: &McTable, tick_us: u32) -> (u32, u64, u64) {
        let name = table.name.get_ref().clone();
        let cycle_us = table
            .cycle_ms
            .as_ref()
            .and_then(|v| self.micros(v, "the cycle"))
            .map_or(tick_us, |us| u32::try_from(us).unwrap_or(u32::MAX));
        let cycle_at = table
            .cycle_ms
            .as_ref()
            .map_or(table.name.span(), Spanned::span);
        if tick_us != 0 && !cycle_us.is_multiple_of(tick_us) {
            self.error(
                "M403",
                cycle_at.clone(),
                format!(
                    "MC {name}: a cycle of {} is no multiple of the tick",
                    ms(cycle_us.into())
                ),
            )
            .expected = Some(format!("a multiple of {}", ms(tick_us.into())));
        }
        let suspect_us = table
            .suspect_ms
            .as_ref()
            .and_then(|v| self.micros(v, "suspect_ms"))
            .unwrap_or(SUSPECT_US_DEFAULT);
        let shortest = SUSPECT_CYCLES_MIN * u64::from(cycle_us.max(tick_us));
        if suspect_us < shortest {
            let at = table.suspect_ms.as_ref().map_or(cycle_at, Spanned::span);
            self.error(
                "M404",
                at,
                format!(
                    "MC {name}: after {} of silence it is too early to call it suspect",
                    ms(suspect_us)
                ),
            )
            .expected = Some(format!(
                "at least {SUSPECT_CYCLES_MIN} cycles, {}: a single late scan is no failure",
                ms(shortest)
            ));
        }
        let watchdog_us = table
            .watchdog_ms
            .as_ref()
            .and_then(|v| self.micros(v, "watchdog_ms"))
            .unwrap_or(WATCHDOG_US_DEFAULT);
        if watchdog_us <= suspect_us + FAILOVER_BOUND_US {
            let at = table
                .watchdog_ms
                .as_ref()
                .or(table.suspect_ms.as_ref())
                .map_or(table.name.span(), Spanned::span);
            self.error(
                "M405",
                at,
                format!(
                    "MC {name}: a watchdog of {} would strike before a failover could end",
                    ms(watchdog_us)
                ),
            )
            .expected = Some(format!(
                "more than suspect_ms ({}) and the time of a failover ({}) together, {}",
                ms(suspect_us),
                ms(FAILOVER_BOUND_US),
                ms(suspect_us + FAILOVER_BOUND_US)
            ));
        }
        (cycle_us, watchdog_us, suspect_us)
    }

    fn fits_driver(
        &mut self,
        what: &str,
        point: &FieldPoint,
        at: Range<usize>,
        driver: Option<&FieldDriver>,
    ) {
        let (found, needed) = match (point, driver) {
            (FieldPoint::Modbus { .. }, Some(FieldDriver::Image)) => ("a Modbus point", "image"),
            (FieldPoint::Image(_), Some(FieldDriver::Modbus { .. })) => {
                ("an image point", "modbus")
            }
            _ => return,
        };
        self.error(
            "M301",
            at,
            format!("{what}: {found}, but its gateway has the driver `{needed}`"),
        )
        .hint = Some("use a point of that driver, or another gateway".to_owned());
    }

    fn inputs(
        &mut self,
        mc: &str,
        table: &McTable,
        driver: Option<&FieldDriver>,
    ) -> Vec<InputSpec> {
        let mut list: Vec<InputSpec> = Vec::new();
        for (name, source) in &table.inputs {
            let what = format!("input {} of MC {mc}", name.get_ref());
            // An input of an AutomationML model without a source has been reported where it was read.
            let is_reported = self.text.is_caex() && source.get_ref().is_empty();
            let from = match points::input_source(source.get_ref()) {
                Ok(from) => Some(from),
                Err(_) if is_reported => None,
                Err(e) => {
                    self.error("M302", source.span(), format!("{what}: {}", e.message))
                        .expected = Some(e.expected);
                    None
                }
            };
            if let Some(InputFrom::Field(point)) = &from {
                self.fits_driver(&what, point, source.span(), driver);
            }
            list.push(InputSpec {
                name: name.clone(),
                from,
                at: source.span(),
            });
        }
        list
    }

    fn outputs(
        &mut self,
        mc: &str,
        table: &McTable,
        driver: Option<&FieldDriver>,
    ) -> Vec<OutputSpec> {
        let mut list = Vec::new();
        for (name, output) in &table.outputs {
            let what = format!("output {} of MC {mc}", name.get_ref());
            let output_at = output.span();
            let output = output.get_ref();
            let field = output.field.as_ref().and_then(|text| {
                match points::field_point(text.get_ref()) {
                    Ok(point) => {
                        self.fits_driver(&what, &point, text.span(), driver);
                        if let FieldPoint::Modbus {
                            table: table @ (ModbusTable::DiscreteInput | ModbusTable::InputRegister),
                            ..
                        } = point
                        {
                            let (found, instead) = match table {
                                ModbusTable::DiscreteInput => ("discrete inputs", "coil"),
                                _ => ("input registers", "holding"),
                            };
                            self.error("M303", text.span(), format!("{what}: {found} cannot be written"))
                                .expected = Some(format!("a point of the table `{instead}`"));
                            return None;
                        }
                        Some(Spanned::new(text.span(), point))
                    }
                    Err(e) => {
                        self.error("M302", text.span(), format!("{what}: {}", e.message))
                            .expected = Some(e.expected);
                        None
                    }
                }
            });
            if output.field.is_none() && !output.export {
                self.error("M304", output_at.clone(), format!("{what} goes nowhere"))
                    .expected = Some("`field = \"...\"`, or `export = true`".to_owned());
            }
            if output.fail_safe.is_none() {
                self.error("M305", output_at, format!("{what} has no fail-safe value"))
                    .hint = Some(
                    "say what it gets when nobody drives it, such as `fail_safe = false`"
                        .to_owned(),
                );
            }
            list.push(OutputSpec {
                name: name.clone(),
                field,
                export: output.export,
                fail_safe: output.fail_safe.clone(),
            });
        }
        list
    }

    fn intervals(&mut self, mc: &str, table: &McTable) -> Vec<IntervalSpec> {
        let mut seen = BTreeMap::new();
        let mut list = Vec::new();
        for interval in &table.critical_interval {
            if let Some(spec) = self.interval(mc, interval.get_ref(), table.stop.as_ref())
                && self.is_new(
                    &mut seen,
                    &format!("critical intervals of MC {mc}"),
                    &spec.name,
                )
            {
                list.push(spec);
            }
        }
        list
    }

    fn interval(
        &mut self,
        mc: &str,
        table: &IntervalTable,
        stop: Option<&Spanned<String>>,
    ) -> Option<IntervalSpec> {
        let name = table.name.get_ref();
        let what = format!("critical interval {name} of MC {mc}");
        if name.is_empty() && self.text.is_caex() {
            return None; // reported by the reader
        }
        if !is_iec_name(name) {
            self.error(
                "M201",
                table.name.span(),
                format!("`{name}` cannot be the name of a critical interval, because its action is named after it"),
            )
            .expected =
                Some("letters, digits and single underscores, not ending in one (IEC 61131-3)".to_owned());
            return None;
        }
        let kind = match table.kind.get_ref().as_str() {
            "checkpoint" => IntervalKind::Checkpoint,
            "unrecoverable" => IntervalKind::Unrecoverable,
            other => {
                self.error(
                    "M501",
                    table.kind.span(),
                    format!("{what}: `{other}` is no kind"),
                )
                .expected = Some("checkpoint or unrecoverable".to_owned());
                return None;
            }
        };
        let recovery = match (&table.recovery, kind, stop) {
            (Some(pou), ..) => pou.clone(),
            (None, IntervalKind::Unrecoverable, Some(stop)) => stop.clone(),
            (None, IntervalKind::Unrecoverable, None) => {
                self.error(
                    "M502",
                    table.name.span(),
                    format!("{what} has no way to stop safely"),
                )
                .hint = Some("give it a `recovery`, or the MC a `stop` POU".to_owned());
                return None;
            }
            (None, IntervalKind::Checkpoint, _) => {
                self.error(
                    "M502",
                    table.name.span(),
                    format!("{what} has no recovery action"),
                )
                .hint = Some(
                    "add `recovery = \"<FUNCTION_BLOCK>\"`, which leads the process back"
                        .to_owned(),
                );
                return None;
            }
        };
        if kind == IntervalKind::Unrecoverable
            && let Some((first, _)) = table.checkpoint_state.iter().next()
        {
            self.error(
                "M503",
                first.span(),
                format!("{what} is unrecoverable: there is no checkpoint state to go back to"),
            )
            .hint = Some("remove `checkpoint_state`, or make the kind `checkpoint`".to_owned());
        }
        Some(IntervalSpec {
            name: table.name.clone(),
            condition: table.condition.clone(),
            kind,
            recovery,
            repeatable: table.repeatable,
            checkpoint_state: table
                .checkpoint_state
                .iter()
                .map(|(k, v)| (k.clone(), v.clone()))
                .collect(),
        })
    }

    /// Every input from another MC has to name an exported output of an MC.
    pub(super) fn exports(&mut self, mcs: &[McSpec]) {
        for mc in mcs {
            for input in &mc.inputs {
                let Some(InputFrom::Export { mc: from, variable }) = &input.from else {
                    continue;
                };
                let what = format!("input {} of MC {}", input.name.get_ref(), mc.mc);
                let Some(exporter) = mcs.iter().find(|m| &m.mc == from) else {
                    let known: Vec<&str> = mcs.iter().map(|m| m.mc.as_str()).collect();
                    let hint = suggestion(from.as_str(), known);
                    self.error(
                        "M306",
                        input.at.clone(),
                        format!("{what}: there is no MC `{from}`"),
                    )
                    .hint = Some(hint);
                    continue;
                };
                match exporter.output(variable) {
                    Some(output) if !output.export => {
                        self.error(
                            "M307",
                            input.at.clone(),
                            format!("{what}: `{variable}` is an output of MC {from}, but it is not exported"),
                        )
                        .hint = Some(format!("add `export = true` to it in MC {from}"));
                    }
                    Some(_) => {}
                    None if exporter
                        .inputs
                        .iter()
                        .any(|i| i.name.get_ref().eq_ignore_ascii_case(variable)) =>
                    {
                        self.error(
                            "M309",
                            input.at.clone(),
                            format!("{what}: `{variable}` is an input of MC {from}; only outputs can be exported"),
                        )
                        .hint = Some("read the same source as that MC does".to_owned());
                    }
                    None => {
                        let known: Vec<&str> = exporter
                            .outputs
                            .iter()
                            .filter(|o| o.export)
                            .map(|o| o.name.get_ref().as_str())
                            .collect();
                        let hint = suggestion(variable, known);
                        self.error(
                            "M309",
                            input.at.clone(),
                            format!("{what}: MC {from} exports no `{variable}`"),
                        )
                        .hint = Some(hint);
                    }
                }
            }
        }
    }

    /// Whether the declared worst case fits at all.
    pub(super) fn capacity(&mut self, mcs: &[McSpec], controllers: &[ControllerModel]) {
        for mc in mcs {
            if mc.worst_case_us == 0 {
                self.error(
                    "M406",
                    mc.at.clone(),
                    format!("MC {}: a scan takes more than no time", mc.mc),
                )
                .expected = Some("worst_case_us of at least 1".to_owned());
            }
            let fits = |c: &ControllerModel| {
                let scan_us = u64::from(mc.worst_case_us) * 1000 / u64::from(c.cpu_factor_permille);
                scan_us * 1000 <= u64::from(mc.cycle_us) * u64::from(c.limit_permille)
            };
            let hosts: Vec<&ControllerModel> = controllers
                .iter()
                .filter(|c| mc.hosts.contains(&c.controller))
                .collect();
            if !hosts.is_empty() && !hosts.iter().any(|c| fits(c)) {
                let hint = format!(
                    "a scan may take {} us every {}: raise limit_percent or the cycle, or host it on a faster controller",
                    mc.worst_case_us,
                    ms(mc.cycle_us.into())
                );
                self.error(
                    "M407",
                    mc.at.clone(),
                    format!(
                        "MC {} alone is above the limit of every controller that hosts it",
                        mc.mc
                    ),
                )
                .hint = Some(hint);
            }
            for c in hosts.into_iter().filter(|c| !fits(c)) {
                let message = format!(
                    "MC {} alone is above the limit of controller {}",
                    mc.mc, c.controller
                );
                let warning = self
                    .text
                    .warning("W801", mc.at.clone(), message)
                    .hint("it will never be placed there");
                self.problems.push(warning);
            }
        }
    }
}
