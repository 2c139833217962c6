//! From CAEX objects to the tables of a cell: the same that stand in a `cell.toml`, with their places in the AutomationML file.

use super::document::ObjectId;
use super::foreign;
use super::instances::Instances;
use super::library::{Caex, InstanceId, Part};
use super::links::{Links, Side, side};
use super::logic_reference::LogicFiles;
use super::unread::{self, Seen};
use super::uri;
use super::values::{MEGABITS, MEGABYTES, MILLISECONDS, PERCENT, PLAIN, Values};
use crate::files::ModelFiles;
use crate::model::toml_file::{
    CellFile, CellTable, ControllerTable, FORMAT, GatewayTable, SettingsTable,
};
use fam_soft_plc::diag::{Diagnostic, Severity};
use std::collections::{BTreeMap, BTreeSet};
use toml::Spanned;

const ROLES: &str = "FAMRoleClassLib/";
const INTERFACES: &str = "FAMInterfaceClassLib/";

/// Tick of a cell that does not say one, in milliseconds; as in `cell.toml`.
const TICK_MS_DEFAULT: f64 = 5.0;

/// Logic files that were made from others: name and text.
pub type MadeFiles = Vec<(String, String)>;

/// The tables of a model. `None` if there is nothing to go on with.
pub fn tables(
    caex: &Caex,
    files: &ModelFiles,
    problems: &mut Vec<Diagnostic>,
) -> Option<(CellFile, MadeFiles)> {
    caex.check_references(problems);
    let instances = Instances::of(caex);
    let links = Links::of(caex, &instances, problems);
    let mut reader = Reader {
        values: Values {
            caex,
            problems: Vec::new(),
        },
        links,
        instances: &instances,
        logic: LogicFiles::new(files),
        points: BTreeMap::new(),
        exports: BTreeMap::new(),
    };
    let all = instances.all.as_slice();
    let is_fam = all
        .iter()
        .any(|e| reader.has_role(e, "MechatronicComponent"));
    let file = if is_fam {
        reader.cell(all).map(|file| (file, Vec::new()))
    } else if problems.iter().any(|p| p.severity == Severity::Error) {
        // With broken references nobody knows what the elements are.
        None
    } else {
        foreign::tables(caex, files, all, &mut reader.values.problems)
    };
    problems.append(&mut reader.values.problems);
    file
}

pub(super) struct Reader<'a> {
    pub(super) values: Values<'a>,
    pub(super) links: Links,
    instances: &'a Instances,
    pub(super) logic: LogicFiles<'a>,
    /// Field points by their interface: text, and the gateway that they belong to.
    pub(super) points: BTreeMap<Side, (String, ObjectId)>,
    /// Outputs by their interface: MC and variable.
    pub(super) exports: BTreeMap<Side, (String, String)>,
}

impl<'a> Reader<'a> {
    pub(super) fn caex(&self) -> &'a Caex {
        self.values.caex
    }

    pub(super) fn name(&self, part: &Part) -> Spanned<String> {
        Spanned::new(
            part.at.clone(),
            self.caex().objects[part.id].name.text.clone(),
        )
    }

    pub(super) fn has_role(&self, part: &Part, role: &str) -> bool {
        let path = format!("{ROLES}{role}");
        self.caex().roles(part.id).contains(&path)
    }

    pub(super) fn is_interface(&self, part: &Part, class: &str) -> bool {
        let path = format!("{INTERFACES}{class}");
        self.caex().interface_classes(part.id).contains(&path)
    }

    pub(super) fn side(&self, element: &Part, interface: &Part) -> Side {
        // A mirror that leads nowhere is a thing of its own.
        side(self.caex(), self.instances, element, interface.id).unwrap_or_else(|_| Side {
            element: element.instance(),
            interface: interface.id,
        })
    }

    fn of_role<'p>(&self, all: &'p [Part], role: &str) -> Vec<&'p Part> {
        all.iter()
            .filter(|e| !self.caex().is_mirror(e.id) && self.has_role(e, role))
            .collect()
    }

    fn cell(&mut self, all: &[Part]) -> Option<CellFile> {
        let cells = self.of_role(all, "Cell");
        if let [_, second, ..] = cells.as_slice() {
            let at = second.at.clone();
            self.values
                .error("M202", at, "the model has more than one cell")
                .hint = Some("keep each cell in a file of its own".to_owned());
        }
        let gateways = self.of_role(all, "Gateway");
        let controllers = self.of_role(all, "Controller");
        let mcs = self.of_role(all, "MechatronicComponent");
        for mc in &mcs {
            if controllers.iter().any(|c| c.instance() == mc.instance()) {
                let name = self.name(mc).into_inner();
                let message = format!("{name} is a controller and a mechatronic component");
                let problem = self.values.error("M816", mc.at.clone(), message);
                problem.expected = Some("one of the two roles".to_owned());
                problem.hint = Some("make two elements of it, joined by Hosting".to_owned());
            }
        }
        for gateway in &gateways {
            self.field_points(gateway, gateway.id, 0);
        }
        for mc in &mcs {
            self.outputs_of(mc);
        }
        let hosts = self.hosting(&controllers, &mcs);
        self.links_without_meaning(&controllers, &mcs);
        let hierarchy = *self.caex().hierarchies.first()?;
        let cell = match cells.first() {
            Some(cell) => self.cell_table(cell, &controllers),
            None => {
                let object = &self.caex().objects[hierarchy];
                CellTable {
                    name: Spanned::new(object.name.at.clone(), object.name.text.clone()),
                    tick_ms: self.tick(None, &controllers),
                    link_mbit_s: None,
                }
            }
        };
        let settings = match cells.first() {
            Some(cell) => self.settings(cell),
            None => SettingsTable::default(),
        };
        self.unread(&[&cells, &gateways, &controllers, &mcs]);
        let gateway_tables: Vec<Spanned<GatewayTable>> =
            gateways.iter().map(|g| self.gateway(g)).collect();
        let controller_tables = controllers.iter().map(|c| self.controller(c)).collect();
        let mc_tables = mcs
            .iter()
            .map(|mc| {
                let hosts = hosts.get(&mc.instance()).cloned().unwrap_or_default();
                self.mc(mc, &gateways, hosts)
            })
            .collect();
        Some(CellFile {
            format: Spanned::new(0..0, FORMAT),
            cell,
            settings,
            gateway: gateway_tables,
            controller: controller_tables,
            mc: mc_tables,
        })
    }

    /// The tick: the cell's, else the cycle of its controllers, which have to agree.
    fn tick(&mut self, cell: Option<&Part>, controllers: &[&Part]) -> Spanned<f64> {
        let mut tick = cell.and_then(|c| self.values.number(c, "tick", MILLISECONDS));
        for controller in controllers {
            let Some(cycle) = self.values.number(controller, "cycle", MILLISECONDS) else {
                continue;
            };
            match &tick {
                None => tick = Some(cycle),
                Some(tick) if tick.get_ref() == cycle.get_ref() => {}
                Some(tick) => {
                    let (tick, cycle_ms) = (*tick.get_ref(), *cycle.get_ref());
                    let name = self.name(controller).into_inner();
                    self.values
                        .error(
                            "M403",
                            cycle.span(),
                            format!("controller {name} has a cycle of {cycle_ms} ms, others of the cell have {tick} ms"),
                        )
                        .expected = Some("one cycle for all controllers of a cell; slower MCs have a multiple of it".to_owned());
                }
            }
        }
        tick.unwrap_or_else(|| Spanned::new(0..0, TICK_MS_DEFAULT))
    }

    fn cell_table(&mut self, cell: &Part, controllers: &[&Part]) -> CellTable {
        CellTable {
            name: self.name(cell),
            tick_ms: self.tick(Some(cell), controllers),
            link_mbit_s: self.values.number(cell, "linkThroughput", MEGABITS),
        }
    }

    fn settings(&mut self, cell: &Part) -> SettingsTable {
        let mut settings = SettingsTable::default();
        for attribute in self.caex().nested(cell, "settings") {
            let name = attribute.name.text.as_str();
            let (target, quantity) = match name {
                "report" => (&mut settings.report_ms, MILLISECONDS),
                "reportLost" => (&mut settings.report_lost_ms, MILLISECONDS),
                "bids" => (&mut settings.bids_ms, MILLISECONDS),
                "activation" => (&mut settings.activation_ms, MILLISECONDS),
                "release" => (&mut settings.release_ms, MILLISECONDS),
                "spread" => (&mut settings.spread_percent, PERCENT),
                "gain" => (&mut settings.gain_percent, PERCENT),
                "balanceHold" => (&mut settings.balance_hold_ms, MILLISECONDS),
                "balancePause" => (&mut settings.balance_pause_ms, MILLISECONDS),
                other => {
                    let message = format!("`{other}` is no setting");
                    self.values
                        .error("M809", attribute.name.at.clone(), message)
                        .expected = Some("report, reportLost, bids, activation, release, spread, gain, balanceHold or balancePause".to_owned());
                    continue;
                }
            };
            *target = self.values.nested_number(&attribute, quantity);
        }
        settings
    }

    fn gateway(&mut self, part: &Part) -> Spanned<GatewayTable> {
        let driver = self.values.text(part, "driver");
        let table = GatewayTable {
            name: self.name(part),
            driver: driver.unwrap_or_else(|| Spanned::new(part.at.clone(), "image".to_owned())),
            address: self.values.text(part, "address"),
        };
        Spanned::new(part.at.clone(), table)
    }

    fn controller(&mut self, part: &Part) -> Spanned<ControllerTable> {
        let table = ControllerTable {
            name: self.name(part),
            description: self.caex().objects[part.id].description.clone(),
            cpu_factor: self.values.number(part, "cpuFactor", PLAIN),
            memory_mb: self.values.number(part, "memory", MEGABYTES),
            limit_percent: self.values.number(part, "loadLimit", PERCENT),
        };
        Spanned::new(part.at.clone(), table)
    }

    /// Field points of a gateway's element and of all below it.
    fn field_points(&mut self, element: &Part, gateway: ObjectId, depth: usize) {
        for interface in self.caex().interfaces(element) {
            let classes = self.caex().interface_classes(interface.id);
            let is_point = classes
                .iter()
                .any(|c| *c == format!("{INTERFACES}FieldPoint") || c.ends_with("/Channel"));
            if !is_point {
                continue;
            }
            let point = match self.values.text(&interface, "point") {
                Some(point) => point.into_inner(),
                // A channel of another tool: known by its name to the driver `image`.
                None => format!(
                    "image:{}.{}",
                    self.name(element).get_ref(),
                    self.name(&interface).get_ref()
                ),
            };
            let side = self.side(element, &interface);
            self.points.insert(side, (point, gateway));
        }
        if depth < super::document::DEPTH_MAX {
            for inner in self.caex().elements(element) {
                self.field_points(&inner, gateway, depth + 1);
            }
        }
    }

    fn outputs_of(&mut self, mc: &Part) {
        for interface in self.caex().interfaces(mc) {
            if self.is_interface(&interface, "Output") {
                let variable = self.variable(&interface).into_inner();
                let name = self.name(mc).into_inner();
                let side = self.side(mc, &interface);
                self.exports.insert(side, (name, variable));
            }
        }
    }

    /// Variable of an Input, Output or State: what its reference names, else its own name.
    pub(super) fn variable(&self, interface: &Part) -> Spanned<String> {
        let fragment = self.values.text(interface, "refURI").and_then(|text| {
            let uri = uri::parse(text.get_ref()).ok()?;
            Some(Spanned::new(text.span(), uri.fragment?))
        });
        fragment.unwrap_or_else(|| self.name(interface))
    }

    /// Attributes of FAM's elements, their interfaces and critical intervals that nobody reads.
    fn unread(&mut self, elements: &[&[&Part]]) {
        let mut parts = Vec::new();
        let mut add = |reader: &Self, name: String, part: &Part| {
            for interface in reader.caex().interfaces(part) {
                let classes = reader.caex().interface_classes(interface.id);
                if classes.iter().any(|c| c.starts_with(INTERFACES)) {
                    let own = reader.name(&interface).into_inner();
                    parts.push(Seen {
                        name: format!("{name}/{own}"),
                        part: interface,
                    });
                }
            }
            parts.push(Seen {
                name,
                part: part.clone(),
            });
        };
        for part in elements.iter().copied().flatten() {
            let name = self.name(part).into_inner();
            for inner in self.caex().elements(part) {
                if self.has_role(&inner, "CriticalInterval") {
                    let own = self.name(&inner).into_inner();
                    add(self, format!("{name}/{own}"), &inner);
                }
            }
            add(self, name, part);
        }
        unread::report(&mut self.values, &parts);
    }

    /// Links of FAM's own interfaces with what they cannot be joined with: without a word they would be lost.
    fn links_without_meaning(&mut self, controllers: &[&Part], mcs: &[&Part]) {
        let instances = |parts: &[&Part]| -> BTreeSet<InstanceId> {
            parts.iter().map(|p| p.instance()).collect()
        };
        let (of_controllers, of_mcs) = (instances(controllers), instances(mcs));
        let mut wrong = Vec::new();
        for part in controllers.iter().chain(mcs) {
            for interface in self.caex().interfaces(part) {
                let own = self.side(part, &interface);
                let partners = self.links.partners(&own);
                if self.is_interface(&interface, "Hosting") {
                    let is_pair = |other: &Side| {
                        let (a, b) = (&own.element, &other.element);
                        (of_controllers.contains(a) && of_mcs.contains(b))
                            || (of_mcs.contains(a) && of_controllers.contains(b))
                    };
                    if !partners.iter().all(is_pair) {
                        wrong.push((part, interface, "a controller and an MC"));
                    }
                } else if self.is_interface(&interface, "Output")
                    && partners.iter().any(|p| self.exports.contains_key(p))
                {
                    wrong.push((part, interface, "an Output with an Input or a field point"));
                }
            }
        }
        for (part, interface, expected) in wrong {
            let of = self.name(part).into_inner();
            let name = self.name(&interface).into_inner();
            let message = format!("`{name}` of {of} is linked with what it cannot be joined with");
            let problem = self.values.error("M815", interface.at.clone(), message);
            problem.expected = Some(format!("a link that joins {expected}"));
            problem.hint = Some("correct the sides of its InternalLink, or remove that".to_owned());
        }
    }

    /// Controllers of each MC: joined by links, or holding a mirror object of it.
    fn hosting(&self, controllers: &[&Part], mcs: &[&Part]) -> BTreeMap<InstanceId, Vec<String>> {
        let caex = self.caex();
        let mcs: BTreeSet<InstanceId> = mcs.iter().map(|m| m.instance()).collect();
        let mut hosts: BTreeMap<InstanceId, Vec<String>> = BTreeMap::new();
        for controller in controllers {
            let name = self.name(controller).into_inner();
            let mut todo = caex.elements(controller);
            let mut left = caex.objects.len();
            while let Some(inner) = todo.pop()
                && left > 0
            {
                left -= 1;
                let master = self.instances.master(caex, &inner).instance();
                if master != inner.instance() && mcs.contains(&master) {
                    hosts.entry(master).or_default().push(name.clone());
                } else {
                    todo.extend(caex.elements(&inner));
                }
            }
            for interface in caex.interfaces(controller) {
                if !self.is_interface(&interface, "Hosting") {
                    continue;
                }
                for partner in self.links.partners(&self.side(controller, &interface)) {
                    if mcs.contains(&partner.element) {
                        hosts
                            .entry(partner.element.clone())
                            .or_default()
                            .push(name.clone());
                    }
                }
            }
        }
        hosts
    }
}
