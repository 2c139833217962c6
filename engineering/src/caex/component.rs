//! A mechatronic component of a CAEX model: its logic, inputs and outputs, critical intervals.

use super::cell::Reader;
use super::document::{ObjectId, Text};
use super::library::Part;
use super::logic_reference::Target;
use super::uri;
use super::values::{MICROSECONDS, MILLISECONDS, PLAIN, value};
use crate::files::join;
use crate::model::toml_file::{Hosts, IntervalTable, McTable, OutputTable};
use crate::problem::suggestion;
use std::collections::BTreeMap;
use std::ops::Range;
use toml::Spanned;

/// A reference to logic.
struct LogicReference {
    file: Spanned<String>,
    target: Option<Target>,
    fragment: Option<Spanned<String>>,
}

impl Reader<'_> {
    pub(super) fn mc(
        &mut self,
        part: &Part,
        gateways: &[&Part],
        mut hosts: Vec<String>,
    ) -> Spanned<McTable> {
        let name = self.name(part);
        let mc = name.get_ref().clone();
        let mut logic: Vec<Spanned<String>> = Vec::new();
        let mut program = self.values.text(part, "program");
        let mut stop = None;
        let (mut inputs, mut outputs) = (BTreeMap::new(), BTreeMap::new());
        let mut state: Vec<Spanned<String>> = Vec::new();
        let mut served: BTreeMap<ObjectId, Range<usize>> = BTreeMap::new();
        for interface in self.caex().interfaces(part) {
            if self.is_interface(&interface, "Input") {
                let (variable, source, gateway) = self.input(&mc, part, &interface);
                if let Some(gateway) = gateway {
                    served.entry(gateway).or_insert(interface.at.clone());
                }
                self.twice(&mc, &inputs, &variable);
                let nowhere = || Spanned::new(interface.at.clone(), String::new());
                inputs.insert(variable, source.unwrap_or_else(nowhere));
            } else if self.is_interface(&interface, "Output") {
                let (variable, output, gateway) = self.output(&mc, part, &interface);
                if let Some(gateway) = gateway {
                    served.entry(gateway).or_insert(interface.at.clone());
                }
                self.twice(&mc, &outputs, &variable);
                outputs.insert(variable, Spanned::new(interface.at.clone(), output));
            } else if self.is_interface(&interface, "State") {
                state.push(self.variable(&interface));
            } else if self.is_interface(&interface, "StopAction") {
                stop = self.action(&format!("stop POU of MC {mc}"), &interface, &mut logic);
            } else if self.is_logic(&interface) {
                let what = format!("logic of MC {mc}");
                let Some(reference) = self.logic_reference(&what, &interface) else {
                    continue;
                };
                add_file(&mut logic, reference.file);
                if let (
                    Some(Target::Pou {
                        name,
                        program: true,
                    }),
                    Some(fragment),
                ) = (&reference.target, &reference.fragment)
                {
                    program.get_or_insert_with(|| Spanned::new(fragment.span(), name.clone()));
                }
            }
        }
        let intervals = self.intervals(&mc, part, &mut logic);
        let gateway = self.gateway_of(&mc, part, gateways, &served);
        if let Some(all) = self.values.text(part, "hosts") {
            if all.get_ref() == "all" {
                hosts = vec!["all".to_owned()];
            } else {
                hosts.extend(
                    all.get_ref()
                        .split([',', ' '])
                        .filter(|h| !h.is_empty())
                        .map(str::to_owned),
                );
            }
        }
        let hosts = match hosts.as_slice() {
            [all] if all == "all" => Hosts::Word("all".to_owned()),
            _ => Hosts::List(hosts),
        };
        let worst_case_us = self.values.whole(part, "worstCaseLoad", MICROSECONDS);
        let worst_case_us = worst_case_us.unwrap_or_else(|| {
            // One that is wrong has been reported.
            if self.values.text(part, "worstCaseLoad").is_none() {
                self.values
                    .error(
                        "M810",
                        part.at.clone(),
                        format!("MC {mc} does not say how long a scan takes"),
                    )
                    .expected = Some(
                    "the attribute `worstCaseLoad`: microseconds on a controller of CPU factor 1.0"
                        .to_owned(),
                );
            }
            Spanned::new(part.at.clone(), 1)
        });
        let table = McTable {
            name,
            program,
            logic: Spanned::new(part.at.clone(), logic),
            gateway,
            hosts: Some(Spanned::new(part.at.clone(), hosts)),
            criticality: self
                .values
                .whole(part, "criticality", PLAIN)
                .map_or(0, Spanned::into_inner),
            cycle_ms: self.values.number(part, "cycle", MILLISECONDS),
            worst_case_us,
            watchdog_ms: self.values.number(part, "watchdog", MILLISECONDS),
            suspect_ms: self.values.number(part, "suspect", MILLISECONDS),
            stop,
            state: (!state.is_empty()).then_some(state),
            inputs,
            outputs,
            critical_interval: intervals,
        };
        Spanned::new(part.at.clone(), table)
    }

    fn is_logic(&self, interface: &Part) -> bool {
        self.caex().is_logic(interface.id)
    }

    fn twice<T>(&mut self, mc: &str, seen: &BTreeMap<Spanned<String>, T>, name: &Spanned<String>) {
        if seen.contains_key(name) {
            let message = format!("MC {mc}: the variable `{}` is listed twice", name.get_ref());
            self.values.error("M202", name.span(), message).hint =
                Some("remove one of its interfaces".to_owned());
        }
    }

    /// The gateway of an MC: the one that its field points belong to.
    fn gateway_of(
        &mut self,
        mc: &str,
        part: &Part,
        gateways: &[&Part],
        served: &BTreeMap<ObjectId, Range<usize>>,
    ) -> Spanned<String> {
        let name_of = |reader: &Self, id: &ObjectId| reader.caex().objects[*id].name.text.clone();
        if let Some(given) = self.values.text(part, "gateway") {
            return given;
        }
        let names: Vec<String> = served.keys().map(|g| name_of(self, g)).collect();
        if names.len() > 1 {
            let at = served
                .values()
                .next_back()
                .cloned()
                .unwrap_or(part.at.clone());
            self.values
                .error(
                    "M205",
                    at,
                    format!(
                        "MC {mc} is joined with field points of several gateways: {}",
                        names.join(", ")
                    ),
                )
                .expected = Some("one gateway for all inputs and outputs of an MC".to_owned());
        }
        let name = names.into_iter().next().or_else(|| match gateways {
            [only] => Some(name_of(self, &only.id)),
            _ => None,
        });
        // Without any the later check says that there is no gateway of this name.
        Spanned::new(part.at.clone(), name.unwrap_or_default())
    }

    /// What an interface is joined with: field points and outputs of MCs.
    fn sources(&self, part: &Part, interface: &Part) -> Vec<(String, Option<ObjectId>)> {
        let own = self.side(part, interface);
        let mut sources = Vec::new();
        for partner in self.links.partners(&own) {
            let source = match (self.points.get(partner), self.exports.get(partner)) {
                (Some((point, gateway)), _) => (point.clone(), Some(*gateway)),
                (None, Some((mc, variable))) => (format!("mc:{mc}.{variable}"), None),
                (None, None) => continue,
            };
            if !sources.contains(&source) {
                sources.push(source);
            }
        }
        sources
    }

    #[allow(clippy::type_complexity)]
    fn input(
        &mut self,
        mc: &str,
        part: &Part,
        interface: &Part,
    ) -> (Spanned<String>, Option<Spanned<String>>, Option<ObjectId>) {
        let variable = self.variable(interface);
        let what = format!("input {} of MC {mc}", variable.get_ref());
        let sources = self.sources(part, interface);
        let point = self.values.text(interface, "point");
        let source = match (point, sources.as_slice()) {
            (Some(point), []) => Some((point, None)),
            (None, [(source, gateway)]) => {
                Some((Spanned::new(interface.at.clone(), source.clone()), *gateway))
            }
            (None, []) => {
                self.values
                    .error(
                        "M302",
                        interface.at.clone(),
                        format!("{what} comes from nowhere"),
                    )
                    .hint = Some(
                    "link it with a FieldPoint of the gateway, or with an Output of another MC"
                        .to_owned(),
                );
                None
            }
            (point, several) => {
                let names: Vec<String> = point
                    .map(Spanned::into_inner)
                    .into_iter()
                    .chain(several.iter().map(|(s, _)| s.clone()))
                    .collect();
                self.values
                    .error(
                        "M302",
                        interface.at.clone(),
                        format!("{what} has several sources: {}", names.join(", ")),
                    )
                    .expected = Some("one source for each input".to_owned());
                None
            }
        };
        let (source, gateway) = source.map_or((None, None), |(s, g)| (Some(s), g));
        (variable, source, gateway)
    }

    fn output(
        &mut self,
        mc: &str,
        part: &Part,
        interface: &Part,
    ) -> (Spanned<String>, OutputTable, Option<ObjectId>) {
        let variable = self.variable(interface);
        let own = self.side(part, interface);
        let fields: Vec<(String, ObjectId)> = self
            .links
            .partners(&own)
            .iter()
            .filter_map(|p| self.points.get(p).cloned())
            .collect();
        let point = self.values.text(interface, "point");
        let what = format!("output {} of MC {mc}", variable.get_ref());
        if fields.len() + usize::from(point.is_some()) > 1 {
            let names: Vec<&str> = point
                .iter()
                .map(|p| p.get_ref().as_str())
                .chain(fields.iter().map(|(f, _)| f.as_str()))
                .collect();
            let message = format!("{what} drives several field points: {}", names.join(", "));
            self.values
                .error("M302", interface.at.clone(), message)
                .expected = Some("one field point for each output".to_owned());
        }
        // An output that another MC reads is exported, whether it says so or not.
        let is_read = self
            .links
            .partners(&own)
            .iter()
            .any(|p| p.element != own.element && !self.points.contains_key(p));
        let gateway = fields.first().map(|(_, g)| *g);
        let field = point.or_else(|| {
            let (text, _) = fields.first()?;
            Some(Spanned::new(interface.at.clone(), text.clone()))
        });
        let output = OutputTable {
            field,
            export: self.values.flag(interface, "exported") || is_read,
            fail_safe: self.values.variable_value(interface, "failSafe"),
        };
        (variable, output, gateway)
    }

    fn intervals(
        &mut self,
        mc: &str,
        part: &Part,
        logic: &mut Vec<Spanned<String>>,
    ) -> Vec<Spanned<IntervalTable>> {
        let mut list = Vec::new();
        for element in self.caex().elements(part) {
            if !self.has_role(&element, "CriticalInterval") {
                continue;
            }
            let name = self.name(&element);
            let what = format!("critical interval {} of MC {mc}", name.get_ref());
            let mut recovery = None;
            for interface in self.caex().interfaces(&element) {
                if self.is_interface(&interface, "RecoveryAction") {
                    recovery = self.action(&what, &interface, logic);
                } else if self.is_logic(&interface) {
                    let at = interface.at.clone();
                    self.values
                        .error(
                            "M502",
                            at,
                            format!("{what}: its reference to logic is no RecoveryAction"),
                        )
                        .hint = Some(
                        "give the interface the class FAMInterfaceClassLib/RecoveryAction"
                            .to_owned(),
                    );
                }
            }
            let mut required = |attribute: &str, expected: &str| {
                self.values.text(&element, attribute).unwrap_or_else(|| {
                    self.values
                        .error(
                            "M810",
                            element.at.clone(),
                            format!("{what} has no `{attribute}`"),
                        )
                        .expected = Some(expected.to_owned());
                    Spanned::new(element.at.clone(), String::new())
                })
            };
            let condition = required(
                "condition",
                "an ST expression over the state, such as `step = 50`",
            );
            let kind = required("kind", "checkpoint or unrecoverable");
            if condition.get_ref().is_empty() || kind.get_ref().is_empty() {
                continue;
            }
            let mut checkpoint_state = BTreeMap::new();
            for attribute in self.caex().nested(&element, "checkpointState") {
                let value = attribute
                    .value
                    .clone()
                    .and_then(|text| value(attribute.data_type.as_deref(), text));
                match value {
                    Some(value) => {
                        let Text { text, at } = attribute.name;
                        checkpoint_state.insert(Spanned::new(at, text), value);
                    }
                    None => {
                        let message = format!(
                            "{what}: the checkpoint state gives `{}` no value",
                            attribute.name.text
                        );
                        self.values.error("M810", attribute.name.at, message).hint =
                            Some("add a `Value`, or remove the attribute".to_owned());
                    }
                }
            }
            let table = IntervalTable {
                repeatable: self.values.flag(&element, "repeatable"),
                name,
                condition,
                kind,
                recovery,
                checkpoint_state,
            };
            list.push(Spanned::new(element.at.clone(), table));
        }
        list
    }

    /// The POU of a recovery action or stop action; its file belongs to the MC's logic.
    fn action(
        &mut self,
        what: &str,
        interface: &Part,
        logic: &mut Vec<Spanned<String>>,
    ) -> Option<Spanned<String>> {
        let reference = self.logic_reference(what, interface)?;
        let Some(fragment) = reference.fragment else {
            self.values
                .error(
                    "M811",
                    reference.file.span(),
                    format!("{what}: the reference names no POU"),
                )
                .expected = Some(format!("`{}#<FUNCTION_BLOCK>`", reference.file.get_ref()));
            return None;
        };
        add_file(logic, reference.file);
        let pou = match reference.target {
            Some(Target::Pou { name, .. }) => name,
            Some(Target::Variable(name)) => {
                let message = format!("{what}: `{name}` is a variable, not a POU");
                self.values.error("M812", fragment.span(), message).expected =
                    Some("the name or globalId of a FUNCTION_BLOCK".to_owned());
                return None;
            }
            None => fragment.get_ref().clone(),
        };
        Some(Spanned::new(fragment.span(), pou))
    }

    fn logic_reference(&mut self, what: &str, interface: &Part) -> Option<LogicReference> {
        let found = self.caex().attribute(interface, "refURI");
        let Some(found) = found.filter(|f| !f.value.text.is_empty()) else {
            self.values
                .error(
                    "M811",
                    interface.at.clone(),
                    format!(
                        "{what}: the interface `{}` refers to no file",
                        self.values.caex.objects[interface.id].name.text
                    ),
                )
                .expected = Some(format!(
                "the attribute `refURI`: {}",
                uri::UriError::EXPECTED
            ));
            return None;
        };
        let what = &format!("{what}{}", self.caex().in_library(found.file));
        let text = Spanned::new(found.value.at, found.value.text);
        let uri = match uri::parse(text.get_ref()) {
            Ok(uri) => uri,
            Err(e) => {
                self.values
                    .error("M811", text.span(), format!("{what}: {e}"))
                    .expected = Some(uri::UriError::EXPECTED.to_owned());
                return None;
            }
        };
        let path = match join(self.caex().folder(found.file), &uri.path) {
            Ok(path) => path,
            Err(e) => {
                self.values
                    .error("M805", text.span(), format!("{what}: {e}"))
                    .hint = Some(e.hint().to_owned());
                return None;
            }
        };
        let target = match &uri.fragment {
            None => None,
            Some(fragment) => match self.logic.target(&path, fragment) {
                Ok(target) => target,
                Err(names) => {
                    let hint = suggestion(fragment, names.iter().map(String::as_str));
                    self.values
                        .error(
                            "M812",
                            text.span(),
                            format!(
                                "{what}: `{path}` has no POU, variable or globalId `{fragment}`"
                            ),
                        )
                        .hint = Some(hint);
                    None
                }
            },
        };
        let span = text.span();
        Some(LogicReference {
            file: Spanned::new(span.clone(), path),
            target,
            fragment: uri.fragment.map(|f| Spanned::new(span, f)),
        })
    }
}

fn add_file(logic: &mut Vec<Spanned<String>>, file: Spanned<String>) {
    if !logic.contains(&file) {
        logic.push(file);
    }
}
