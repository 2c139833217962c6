//! The tables of a cell as a CAEX 3.0 file with the roles and interfaces of FAM. The same tables give the same bytes.

use super::uri::percent_encoded;
use crate::model::toml_file::{
    CellFile, ControllerTable, GatewayTable, Hosts, IntervalTable, McTable,
};
use crate::plcopen::xml::Xml;
use std::collections::BTreeMap;
use toml::Spanned;
use xxhash_rust::xxh3::xxh3_128;

/// Alias of FAM's library in written files.
const ALIAS: &str = "FAM";

/// What the writer needs to know beside the tables.
pub struct Setting<'a> {
    /// Name of the file that is written.
    pub file_name: &'a str,
    /// Path of `FAM.aml` from there.
    pub library: &'a str,
    /// The file, among those given, that declares a POU.
    pub file_of: FileOf<'a>,
}

/// Finds the file, among those given, that declares a POU.
pub type FileOf<'a> = &'a dyn Fn(&[Spanned<String>], &str) -> Option<String>;

/// Writes a model.
#[must_use]
pub fn write(cell: &CellFile, setting: &Setting<'_>) -> String {
    let mut writer = Writer {
        xml: Xml::new(),
        setting,
        cell: cell.cell.name.get_ref().clone(),
        links: Vec::new(),
    };
    writer.file(cell);
    writer.xml.finish()
}

struct Writer<'a> {
    xml: Xml,
    setting: &'a Setting<'a>,
    cell: String,
    /// Name and both sides.
    links: Vec<(String, String, String)>,
}

/// An ID that depends on the path of names alone.
fn id(path: &str) -> String {
    let hex = format!("{:032x}", xxh3_128(path.as_bytes()));
    format!(
        "{}-{}-{}-{}-{}",
        &hex[..8],
        &hex[8..12],
        &hex[12..16],
        &hex[16..20],
        &hex[20..]
    )
}

/// Value of a variable: its data type and its text.
fn value_text(value: &toml::Value) -> (&'static str, String) {
    match value {
        toml::Value::Boolean(b) => ("xs:boolean", b.to_string()),
        toml::Value::Integer(i) => ("xs:integer", i.to_string()),
        toml::Value::Float(f) => ("xs:double", format!("{f:?}")),
        toml::Value::String(s) => ("xs:string", s.clone()),
        other => ("xs:string", other.to_string()),
    }
}

impl Writer<'_> {
    fn file(&mut self, cell: &CellFile) {
        let xml = &mut self.xml;
        xml.open(
            "CAEXFile",
            &[
                ("SchemaVersion", "3.0"),
                ("FileName", self.setting.file_name),
                ("xmlns", "http://www.dke.de/CAEX"),
            ],
        );
        xml.text("SuperiorStandardVersion", "AutomationML 2.10");
        xml.empty(
            "SourceDocumentInformation",
            &[
                ("OriginName", "FAM"),
                ("OriginID", "urn:fam:model"),
                ("OriginVersion", env!("CARGO_PKG_VERSION")),
                // The schema asks for a time; the same cell has to give the same bytes.
                ("LastWritingDateTime", "2020-01-01T00:00:00"),
            ],
        );
        xml.empty(
            "ExternalReference",
            &[("Path", self.setting.library), ("Alias", ALIAS)],
        );
        let name = self.cell.clone();
        xml.open("InstanceHierarchy", &[("Name", &name)]);
        self.element(&name, &name, "");
        self.number("tick", Some(&cell.cell.tick_ms), Some("ms"));
        self.number(
            "linkThroughput",
            cell.cell.link_mbit_s.as_ref(),
            Some("Mbit/s"),
        );
        self.settings(cell);
        for gateway in &cell.gateway {
            self.gateway(gateway.get_ref(), cell);
        }
        for controller in &cell.controller {
            self.controller(controller.get_ref());
        }
        for mc in &cell.mc {
            self.mc(mc.get_ref(), cell);
        }
        for (name, a, b) in std::mem::take(&mut self.links) {
            self.xml.empty(
                "InternalLink",
                &[
                    ("Name", &name),
                    ("RefPartnerSideA", &a),
                    ("RefPartnerSideB", &b),
                ],
            );
        }
        self.role("Cell");
        self.xml.close();
        self.xml.close();
        self.xml.close();
    }

    fn element(&mut self, name: &str, path: &str, description: &str) {
        self.xml
            .open("InternalElement", &[("Name", name), ("ID", &id(path))]);
        if !description.is_empty() {
            self.xml.text("Description", description);
        }
    }

    fn role(&mut self, role: &str) {
        let path = format!("{ALIAS}@FAMRoleClassLib/{role}");
        self.xml
            .empty("RoleRequirements", &[("RefBaseRoleClassPath", &path)]);
    }

    fn attribute(&mut self, name: &str, data_type: &str, unit: Option<&str>, value: &str) {
        let mut attributes = vec![("Name", name), ("AttributeDataType", data_type)];
        if let Some(unit) = unit {
            attributes.push(("Unit", unit));
        }
        self.xml.open("Attribute", &attributes);
        self.xml.text("Value", value);
        self.xml.close();
    }

    fn number(&mut self, name: &str, value: Option<&Spanned<f64>>, unit: Option<&str>) {
        if let Some(value) = value {
            self.attribute(name, "xs:double", unit, &value.get_ref().to_string());
        }
    }

    fn string(&mut self, name: &str, value: Option<&str>) {
        if let Some(value) = value {
            self.attribute(name, "xs:string", None, value);
        }
    }

    /// Opens an interface; its ID.
    fn interface(&mut self, name: &str, path: &str, class: &str) -> String {
        let own = id(path);
        let class = format!("{ALIAS}@FAMInterfaceClassLib/{class}");
        self.xml.open(
            "ExternalInterface",
            &[("Name", name), ("ID", &own), ("RefBaseClassPath", &class)],
        );
        own
    }

    fn settings(&mut self, cell: &CellFile) {
        let s = &cell.settings;
        let all = [
            ("report", &s.report_ms, "ms"),
            ("reportLost", &s.report_lost_ms, "ms"),
            ("bids", &s.bids_ms, "ms"),
            ("activation", &s.activation_ms, "ms"),
            ("release", &s.release_ms, "ms"),
            ("spread", &s.spread_percent, "%"),
            ("gain", &s.gain_percent, "%"),
            ("balanceHold", &s.balance_hold_ms, "ms"),
            ("balancePause", &s.balance_pause_ms, "ms"),
        ];
        if all.iter().all(|(_, value, _)| value.is_none()) {
            return;
        }
        self.xml.open(
            "Attribute",
            &[("Name", "settings"), ("AttributeDataType", "xs:string")],
        );
        for (name, value, unit) in all {
            self.number(name, value.as_ref(), Some(unit));
        }
        self.xml.close();
    }

    /// A gateway with the field points that its MCs name, by device.
    fn gateway(&mut self, gateway: &GatewayTable, cell: &CellFile) {
        let name = gateway.name.get_ref();
        let path = format!("{}/{name}", self.cell);
        self.element(name, &path, "");
        self.string("driver", Some(gateway.driver.get_ref()));
        self.string(
            "address",
            gateway.address.as_ref().map(|a| a.get_ref().as_str()),
        );
        let mut devices: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for mc in cell.mc.iter().map(Spanned::get_ref) {
            if mc.gateway.get_ref() != name {
                continue;
            }
            let inputs = mc.inputs.values().map(Spanned::get_ref);
            let outputs = mc
                .outputs
                .values()
                .filter_map(|o| o.get_ref().field.as_ref().map(Spanned::get_ref));
            for point in inputs.chain(outputs) {
                if let Some((device, _)) = device_of(point) {
                    let points = devices.entry(device).or_default();
                    if !points.contains(point) {
                        points.push(point.clone());
                    }
                }
            }
        }
        for (device, mut points) in devices {
            points.sort_by_key(|p| point_key(p));
            self.element(&device, &format!("{path}/{device}"), "");
            for point in points {
                let (_, short) = device_of(&point).unwrap_or_default();
                self.interface(&short, &point_path(&self.cell, name, &point), "FieldPoint");
                self.string("point", Some(&point));
                self.xml.close();
            }
            self.role("FieldDevice");
            self.xml.close();
        }
        self.role("Gateway");
        self.xml.close();
    }

    fn controller(&mut self, controller: &ControllerTable) {
        let name = controller.name.get_ref();
        let path = format!("{}/{name}", self.cell);
        self.element(name, &path, &controller.description);
        self.number("cpuFactor", controller.cpu_factor.as_ref(), None);
        self.number("memory", controller.memory_mb.as_ref(), Some("MB"));
        self.number("loadLimit", controller.limit_percent.as_ref(), Some("%"));
        self.interface("Hosting", &format!("{path}/Hosting"), "Hosting");
        self.xml.close();
        self.role("Controller");
        self.xml.close();
    }

    /// A reference to a POU of the MC's logic, or to a file of it.
    fn reference(&mut self, file: &str, pou: Option<&str>) {
        let mut text = percent_encoded(file);
        if let Some(pou) = pou {
            text.push('#');
            text.push_str(&percent_encoded(pou));
        }
        self.attribute("refURI", "xs:anyURI", None, &text);
    }

    fn mc(&mut self, mc: &McTable, cell: &CellFile) {
        let name = mc.name.get_ref().clone();
        let path = format!("{}/{name}", self.cell);
        self.element(&name, &path, "");
        let program = mc.program.as_ref().map_or(&name, Spanned::get_ref).clone();
        let files = mc.logic.get_ref();
        let main = (self.setting.file_of)(files, &program);
        if main.is_none() {
            self.string("program", Some(&program));
        }
        if cell.gateway.len() > 1 {
            self.string("gateway", Some(mc.gateway.get_ref()));
        }
        self.attribute(
            "criticality",
            "xs:unsignedInt",
            None,
            &mc.criticality.to_string(),
        );
        self.number("cycle", mc.cycle_ms.as_ref(), Some("ms"));
        self.attribute(
            "worstCaseLoad",
            "xs:unsignedInt",
            Some("us"),
            &mc.worst_case_us.get_ref().to_string(),
        );
        self.number("watchdog", mc.watchdog_ms.as_ref(), Some("ms"));
        self.number("suspect", mc.suspect_ms.as_ref(), Some("ms"));

        self.hosting(mc, &path, cell);
        for file in files {
            let file = file.get_ref();
            let short = file.rsplit('/').next().unwrap_or(file);
            self.interface(short, &format!("{path}/logic/{file}"), "Logic");
            let is_main = main.as_ref() == Some(file);
            self.reference(file, is_main.then_some(program.as_str()));
            self.xml.close();
        }
        if let Some(stop) = &mc.stop {
            self.interface("Stop", &format!("{path}/Stop"), "StopAction");
            self.action(files, stop.get_ref());
            self.xml.close();
        }
        for variable in mc.state.iter().flatten() {
            let variable = variable.get_ref();
            self.interface(variable, &format!("{path}/state/{variable}"), "State");
            self.xml.close();
        }
        self.variables(mc, &path);
        for interval in &mc.critical_interval {
            self.interval(interval.get_ref(), &path, files);
        }
        self.role("MechatronicComponent");
        self.xml.close();
    }

    fn hosting(&mut self, mc: &McTable, path: &str, cell: &CellFile) {
        let name = mc.name.get_ref();
        let own = self.interface("Hosting", &format!("{path}/Hosting"), "Hosting");
        self.xml.close();
        let hosts: Vec<String> = match mc.hosts.as_ref().map(Spanned::get_ref) {
            Some(Hosts::Word(word)) if word == "all" => cell
                .controller
                .iter()
                .map(|c| c.get_ref().name.get_ref().clone())
                .collect(),
            Some(Hosts::Word(word)) => vec![word.clone()],
            Some(Hosts::List(list)) => list.clone(),
            None => Vec::new(),
        };
        for host in hosts {
            let side = id(&format!("{}/{host}/Hosting", self.cell));
            self.links
                .push((format!("{host} hosts {name}"), side, own.clone()));
        }
    }

    fn variables(&mut self, mc: &McTable, path: &str) {
        let gateway = mc.gateway.get_ref();
        for (variable, source) in &mc.inputs {
            let variable = variable.get_ref();
            let source = source.get_ref();
            let own = self.interface(variable, &format!("{path}/in/{variable}"), "Input");
            let other = match source.strip_prefix("mc:").and_then(|s| s.split_once('.')) {
                Some((mc, exported)) => Some(id(&format!("{}/{mc}/out/{exported}", self.cell))),
                None => device_of(source).map(|_| id(&point_path(&self.cell, gateway, source))),
            };
            match other {
                Some(other) => {
                    let name = format!("{source} to {}.{variable}", mc.name.get_ref());
                    self.links.push((name, other, own));
                }
                // What is no point stays as it is written, for `fam check` to tell.
                None => self.string("point", Some(source)),
            }
            self.xml.close();
        }
        for (variable, output) in &mc.outputs {
            let (variable, output) = (variable.get_ref(), output.get_ref());
            let own = self.interface(variable, &format!("{path}/out/{variable}"), "Output");
            if let Some(field) = &output.field {
                let field = field.get_ref();
                match device_of(field) {
                    Some(_) => {
                        let other = id(&point_path(&self.cell, gateway, field));
                        let name = format!("{}.{variable} to {field}", mc.name.get_ref());
                        self.links.push((name, own, other));
                    }
                    None => self.string("point", Some(field)),
                }
            }
            if let Some(value) = &output.fail_safe {
                let (data_type, text) = value_text(value.get_ref());
                self.attribute("failSafe", data_type, None, &text);
            }
            if output.export {
                self.attribute("exported", "xs:boolean", None, "true");
            }
            self.xml.close();
        }
    }

    fn action(&mut self, files: &[Spanned<String>], pou: &str) {
        let file = (self.setting.file_of)(files, pou)
            .or_else(|| files.first().map(|f| f.get_ref().clone()))
            .unwrap_or_default();
        self.reference(&file, Some(pou));
    }

    fn interval(&mut self, interval: &IntervalTable, mc_path: &str, files: &[Spanned<String>]) {
        let name = interval.name.get_ref();
        let path = format!("{mc_path}/{name}");
        self.element(name, &path, "");
        self.string("condition", Some(interval.condition.get_ref()));
        self.string("kind", Some(interval.kind.get_ref()));
        self.attribute(
            "repeatable",
            "xs:boolean",
            None,
            &interval.repeatable.to_string(),
        );
        if !interval.checkpoint_state.is_empty() {
            self.xml.open(
                "Attribute",
                &[
                    ("Name", "checkpointState"),
                    ("AttributeDataType", "xs:string"),
                ],
            );
            for (variable, value) in &interval.checkpoint_state {
                let (data_type, text) = value_text(value.get_ref());
                self.attribute(variable.get_ref(), data_type, None, &text);
            }
            self.xml.close();
        }
        if let Some(recovery) = &interval.recovery {
            self.interface("Recovery", &format!("{path}/Recovery"), "RecoveryAction");
            self.action(files, recovery.get_ref());
            self.xml.close();
        }
        self.role("CriticalInterval");
        self.xml.close();
    }
}

fn point_path(cell: &str, gateway: &str, point: &str) -> String {
    format!("{cell}/{gateway}/{point}")
}

/// Device of a field point and the point's name there; `None` for what is no field point.
fn device_of(point: &str) -> Option<(String, String)> {
    if let Some(rest) = point.strip_prefix("modbus:") {
        let (unit, rest) = rest.split_once('/')?;
        return Some((format!("unit{unit}"), rest.replace('/', "")));
    }
    let name = point.strip_prefix("image:").filter(|n| !n.is_empty())?;
    Some(("points".to_owned(), name.to_owned()))
}

/// Points in the order of their tables and addresses.
fn point_key(point: &str) -> (String, u32, String) {
    let (table, address) = point.rsplit_once('/').unwrap_or((point, ""));
    match address.parse() {
        Ok(number) => (table.to_owned(), number, String::new()),
        Err(_) => (String::new(), 0, point.to_owned()),
    }
}
