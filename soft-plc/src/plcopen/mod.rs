//! Reads PLCopen TC6 XML projects (v2.01, and v2.00 as CODESYS writes it) into the same syntax tree as Structured Text.
//!
//! POUs, types and global variables are taken from wherever they stand, so that exports that keep them in `addData` (CODESYS)
//! are read too. Nothing is dropped in silence: a body or element that cannot be run is an error that names it.

mod actions;
mod chart;
mod network;
mod types;

use roxmltree::{Document, Node};

use crate::diag::Problem;
use crate::source::{Sources, Span};
use crate::syntax::ast::{
    Configuration, Configured, Ident, Pou, PouKind, ProgramInstance, Project, Resource, Stmt, Task,
    TypeDecl, VarBlock, VarDecl, VarSection,
};
use crate::syntax::literal;
use crate::syntax::parse_il::parse_il;
use crate::syntax::parser::{parse_body, parse_declarations};

const TC6_NAMESPACES: [&str; 2] = [
    "http://www.plcopen.org/xml/tc6_0201",
    "http://www.plcopen.org/xml/tc6_0200",
];
const TC6_V1_NAMESPACE: &str = "http://www.plcopen.org/xml/tc6.xsd";
/// Additional data with the whole text of a POU in ST: TC6 has no elements for methods, inheritance, interfaces and textual charts.
pub const WHOLE_TEXT_NAMESPACE: &str = "urn:fam:st:1";
const IEC_61131_10_NAMESPACE: &str = "www.iec.ch/public/TC65SC65BWG7TF10";

/// Whether the text is XML rather than Structured Text.
pub fn is_xml(text: &str) -> bool {
    text.trim_start_matches('\u{feff}')
        .trim_start()
        .starts_with('<')
}

/// Reads source number `source`, an XML text, into `project`.
pub fn read(
    sources: &mut Sources,
    source: u32,
    project: &mut Project,
    problems: &mut Vec<Problem>,
) {
    let text = sources.get(source).text.clone();
    let document = match Document::parse(&text) {
        Ok(document) => document,
        Err(roxmltree::Error::DtdDetected) => {
            const OPENING: &str = "<!DOCTYPE";
            let at = text.find(OPENING).unwrap_or(0);
            let span = Span::new(source, at, at + OPENING.len());
            let message = "the file declares a document type, which could define entities that expand without end";
            let problem = Problem::error("E601", span, message);
            problems.push(problem.hint("remove `<!DOCTYPE ...>`: PLCopen XML has none"));
            return;
        }
        Err(error) => {
            let at = error.pos();
            let offset: usize = text
                .split_inclusive('\n')
                .take(at.row as usize - 1)
                .map(str::len)
                .sum();
            let span = Span::new(source, offset, offset + 1);
            problems.push(Problem::error(
                "E601",
                span,
                format!("this is no well-formed XML: {error}"),
            ));
            return;
        }
    };
    let mut reader = Reader {
        sources,
        source,
        text: &text,
        problems,
        pou: None,
        serial: 0,
        functions: std::collections::BTreeSet::new(),
    };
    reader.project(document.root_element(), project);
}

struct Reader<'a> {
    sources: &'a mut Sources,
    source: u32,
    text: &'a str,
    problems: &'a mut Vec<Problem>,
    pou: Option<String>,
    /// Makes names of a diagram's own variables unique.
    serial: u32,
    /// Names of the functions that the project declares.
    functions: std::collections::BTreeSet<String>,
}

/// A text inside the XML file, as the parser needs it.
struct Part {
    source: u32,
    base: usize,
    text: String,
}

fn elements<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children()
        .filter(move |c| c.is_element() && c.tag_name().name() == name)
}

fn element<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    elements(node, name).next()
}

fn parent_is(node: Node<'_, '_>, names: &[&str]) -> bool {
    node.parent()
        .is_some_and(|p| names.contains(&p.tag_name().name()))
}

impl Reader<'_> {
    fn report(&mut self, mut problem: Problem) {
        if problem.pou.is_none() {
            problem.pou.clone_from(&self.pou);
        }
        self.problems.push(problem);
    }

    /// The opening tag of an element.
    fn tag(&self, node: Node<'_, '_>) -> Span {
        let range = node.range();
        let tag = &self.text[range.clone()];
        let len = tag.find('>').map_or(tag.len(), |end| end + 1);
        Span::new(self.source, range.start, range.start + len)
    }

    fn attribute_span(&self, node: Node<'_, '_>, name: &str) -> Span {
        match node.attribute_node(name) {
            Some(attribute) => {
                let range = attribute.range_value();
                Span::new(self.source, range.start, range.end)
            }
            None => self.tag(node),
        }
    }

    /// The attribute as a name, or an error that it is missing.
    fn name(&mut self, node: Node<'_, '_>, attribute: &str) -> Option<Ident> {
        let span = self.attribute_span(node, attribute);
        match node.attribute(attribute) {
            Some(name) if !name.trim().is_empty() => Some(Ident {
                name: name.trim().to_owned(),
                span,
            }),
            _ => {
                let message = format!("<{}> has no `{attribute}`", node.tag_name().name());
                self.report(Problem::error("E606", span, message));
                None
            }
        }
    }

    fn project(&mut self, root: Node<'_, '_>, project: &mut Project) {
        let namespace = root.tag_name().namespace().unwrap_or("");
        if root.tag_name().name() != "project" || !TC6_NAMESPACES.contains(&namespace) {
            let span = self.tag(root);
            let what = if namespace == TC6_V1_NAMESPACE {
                "PLCopen XML 1.0 (tc6.xsd) is not supported".to_owned()
            } else if namespace.contains(IEC_61131_10_NAMESPACE) {
                "IEC 61131-10 XML is not supported".to_owned()
            } else {
                format!(
                    "<{}> (namespace `{namespace}`) is no PLCopen project",
                    root.tag_name().name()
                )
            };
            self.report(
                Problem::error("E605", span, what)
                    .expected("<project> of the namespace http://www.plcopen.org/xml/tc6_0201 or tc6_0200")
                    .hint("export the project as PLCopen XML version 2.01"),
            );
            return;
        }
        self.functions = root
            .descendants()
            .filter(|n| n.is_element() && n.tag_name().name() == "pou")
            .filter(|n| n.attribute("pouType") == Some("function"))
            .filter_map(|n| n.attribute("name").map(|n| n.trim().to_ascii_uppercase()))
            .collect();
        for node in root.descendants().filter(Node::is_element) {
            self.pou = None;
            match node.tag_name().name() {
                "dataType" if parent_is(node, &["dataTypes", "data"]) => {
                    self.data_type(node, project)
                }
                "pou" if parent_is(node, &["pous", "data"]) => self.pou(node, project),
                "globalVars" if !parent_is(node, &["interface"]) => {
                    let block = self.var_block(node, VarSection::Global);
                    project.globals.push(block);
                }
                "configuration" => self.configuration(node, project),
                "resource" if !parent_is(node, &["configuration"]) => {
                    let resource = self.resource(node);
                    project.configurations.push(Configuration {
                        name: resource.name.clone(),
                        resources: vec![resource],
                        ..Configuration::default()
                    });
                }
                _ => {}
            }
        }
        self.pou = None;
    }

    fn data_type(&mut self, node: Node<'_, '_>, project: &mut Project) {
        let Some(name) = self.name(node, "name") else {
            return;
        };
        let Some(spec) = element(node, "baseType").and_then(|base| self.type_spec(base)) else {
            return;
        };
        let init = element(node, "initialValue").and_then(|v| self.initial_value(v));
        project.types.push(TypeDecl { name, spec, init });
    }

    fn pou(&mut self, node: Node<'_, '_>, project: &mut Project) {
        let Some(name) = self.name(node, "name") else {
            return;
        };
        self.pou = Some(name.name.clone());
        let range = node.range();
        let place = Span::new(self.source, range.start, range.end);
        let whole = node
            .descendants()
            .find(|n| n.has_tag_name((WHOLE_TEXT_NAMESPACE, "st")));
        if let Some(whole) = whole {
            let part = self.text_part(whole);
            let known = project.pous.len();
            let problems = parse_declarations(part.source, &part.text, part.base, project);
            self.problems.extend(problems);
            let read = &mut project.pous[known..];
            read.iter_mut().for_each(|p| p.place = place);
            return;
        }
        let kind = match node.attribute("pouType") {
            Some("program") => PouKind::Program,
            Some("function") => PouKind::Function,
            Some("functionBlock") => PouKind::FunctionBlock,
            other => {
                let span = self.attribute_span(node, "pouType");
                let message = format!("`{}` is no kind of POU", other.unwrap_or(""));
                self.report(
                    Problem::error("E607", span, message)
                        .expected("program, function or functionBlock"),
                );
                return;
            }
        };
        let mut pou = Pou {
            kind,
            name,
            result: None,
            vars: Vec::new(),
            body: Vec::new(),
            class: crate::syntax::ast::Class::default(),
            place,
        };
        if let Some(interface) = element(node, "interface") {
            self.interface(interface, &mut pou);
        }
        let extra = node
            .descendants()
            .find(|n| n.is_element() && matches!(n.tag_name().name(), "Method" | "Property"));
        if let Some(extra) = extra {
            let span = self.tag(extra);
            let message = format!(
                "{} has a {}, which is not supported",
                pou.name.name,
                extra.tag_name().name().to_uppercase()
            );
            self.report(
                Problem::error("E603", span, message).hint("use function blocks and functions"),
            );
        }
        let bodies: Vec<_> = elements(node, "body").collect();
        if bodies.len() > 1 {
            let span = self.tag(bodies[1]);
            let message = format!("{} has more than one body", pou.name.name);
            self.report(Problem::error("E603", span, message));
        }
        if let Some(body) = bodies.first() {
            self.body(*body, node, &mut pou);
        }
        project.pous.push(pou);
    }

    fn body(&mut self, body: Node<'_, '_>, pou_node: Node<'_, '_>, pou: &mut Pou) {
        let language = self.language_of(body);
        if let Some(chart) = language.filter(|l| l.tag_name().name() == "SFC") {
            self.chart(chart, pou_node, pou);
            return;
        }
        let fleeting = pou
            .vars
            .iter()
            .filter(|block| matches!(block.section, VarSection::InOut | VarSection::Temp))
            .flat_map(|block| &block.decls)
            .map(|decl| decl.name.name.to_ascii_uppercase())
            .collect();
        self.actions(pou_node, pou);
        pou.body = self.statements_of(body, pou);
        actions::put_in_place(pou, &fleeting);
    }

    /// The element that names the language of a body.
    fn language_of<'b, 'i>(&self, body: Node<'b, 'i>) -> Option<Node<'b, 'i>> {
        body.children()
            .filter(Node::is_element)
            .find(|c| !matches!(c.tag_name().name(), "addData" | "documentation"))
    }

    /// The statements of a body in any language but SFC.
    fn statements_of(&mut self, body: Node<'_, '_>, pou: &mut Pou) -> Vec<Stmt> {
        let Some(language) = self.language_of(body) else {
            return Vec::new();
        };
        match language.tag_name().name() {
            "ST" => {
                let part = self.text_part(language);
                let (statements, problems) =
                    parse_body(part.source, &part.text, part.base, &pou.name.name);
                self.problems.extend(problems);
                statements
            }
            "IL" => {
                let part = self.text_part(language);
                let (statements, problems) = parse_il(part.source, &part.text, part.base, pou);
                self.problems.extend(problems);
                statements
            }
            "FBD" | "LD" => network::Network::new(self, language).body(language, pou),
            name => {
                let span = self.tag(language);
                let message = format!(
                    "the body of {} is written in {name}, which cannot stand here",
                    pou.name.name
                );
                self.report(
                    Problem::error("E602", span, message)
                        .expected("<ST>, <FBD>, <LD>, <IL>, or <SFC> as the body of a POU"),
                );
                Vec::new()
            }
        }
    }

    /// The text below an element: with its exact place in the file where it stands there as it is, else with its line.
    fn text_part(&mut self, node: Node<'_, '_>) -> Part {
        let texts: Vec<_> = node
            .descendants()
            .filter(|n| n.is_text() && !n.text().unwrap_or("").trim().is_empty())
            .collect();
        let Some(first) = texts.first() else {
            return Part {
                source: self.source,
                base: node.range().start,
                text: String::new(),
            };
        };
        let range = first.range();
        let raw = &self.text[range.clone()];
        let opener = raw
            .find("<![CDATA[")
            .filter(|at| raw[..*at].trim().is_empty());
        let start = range.start + opener.map_or(0, |at| at + "<![CDATA[".len());
        let text: String = texts
            .iter()
            .filter_map(|t| t.text())
            .collect::<Vec<_>>()
            .join("\n");
        // The decoded text may begin with white space that stands before the CDATA section.
        for skip in [0, opener.unwrap_or(0)] {
            let Some(body) = text.get(skip..) else {
                continue;
            };
            if texts.len() == 1 && self.text[start..].starts_with(body) {
                return Part {
                    source: self.source,
                    base: start,
                    text: body.to_owned(),
                };
            }
        }
        let position = self.sources.get(self.source).position(range.start as u32);
        let name = self.sources.get(self.source).name.clone();
        let source = self
            .sources
            .add_part(&name, &text, position.line, position.column);
        Part {
            source,
            base: 0,
            text,
        }
    }

    /// The value of an attribute, likewise.
    fn attribute_part(&mut self, node: Node<'_, '_>, attribute: &str) -> Option<Part> {
        let value = node.attribute(attribute)?;
        let span = self.attribute_span(node, attribute);
        if &self.text[span.start as usize..span.end as usize] == value {
            return Some(Part {
                source: self.source,
                base: span.start as usize,
                text: value.to_owned(),
            });
        }
        let position = self.sources.get(self.source).position(span.start);
        let name = self.sources.get(self.source).name.clone();
        let source = self
            .sources
            .add_part(&name, value, position.line, position.column);
        Some(Part {
            source,
            base: 0,
            text: value.to_owned(),
        })
    }

    fn interface(&mut self, interface: Node<'_, '_>, pou: &mut Pou) {
        for node in interface.children().filter(Node::is_element) {
            let section = match node.tag_name().name() {
                "returnType" => {
                    pou.result = self.type_spec(node);
                    continue;
                }
                "localVars" => VarSection::Local,
                "inputVars" => VarSection::Input,
                "outputVars" => VarSection::Output,
                "inOutVars" => VarSection::InOut,
                "tempVars" => VarSection::Temp,
                "externalVars" => VarSection::External,
                "globalVars" => VarSection::Global,
                // Paths for communication, which FAM does on its own.
                "documentation" | "addData" | "accessVars" => continue,
                other => {
                    let span = self.tag(node);
                    let message = format!("<{other}> is not supported in the interface of a POU");
                    self.report(Problem::error("E603", span, message));
                    continue;
                }
            };
            let block = self.var_block(node, section);
            pou.vars.push(block);
        }
    }

    fn var_block(&mut self, node: Node<'_, '_>, section: VarSection) -> VarBlock {
        let flag = |name| node.attribute(name) == Some("true");
        let mut block = VarBlock {
            access: None,
            section,
            constant: flag("constant"),
            retain: flag("retain"),
            decls: Vec::new(),
        };
        for variable in elements(node, "variable") {
            block.decls.extend(self.variable(variable));
        }
        block
    }

    fn variable(&mut self, node: Node<'_, '_>) -> Option<VarDecl> {
        let name = self.name(node, "name")?;
        let Some(ty) = element(node, "type") else {
            let span = self.tag(node);
            self.report(Problem::error(
                "E606",
                span,
                format!("the variable `{}` has no type", name.name),
            ));
            return None;
        };
        let spec = self.type_spec(ty)?;
        let location = self.address(node);
        let init = element(node, "initialValue").and_then(|v| self.initial_value(v));
        Some(VarDecl {
            name,
            location,
            spec,
            init,
            edge: None,
        })
    }

    fn configuration(&mut self, node: Node<'_, '_>, project: &mut Project) {
        let mut configuration = Configuration {
            name: node.attribute("name").unwrap_or_default().to_owned(),
            ..Configuration::default()
        };
        for resource in elements(node, "resource") {
            let resource = self.resource(resource);
            configuration.resources.push(resource);
        }
        for variable in elements(node, "configVars").flat_map(|v| elements(v, "configVariable")) {
            let configured = self.configured(variable);
            configuration.configured.extend(configured);
        }
        project.configurations.push(configuration);
    }

    /// A line of VAR_CONFIG.
    fn configured(&mut self, node: Node<'_, '_>) -> Option<Configured> {
        let path = self.name(node, "instancePathAndName")?;
        let part = |name: &str| Ident {
            name: name.trim().to_owned(),
            span: path.span,
        };
        let Some(ty) = element(node, "type") else {
            let message = format!("`{}` has no type", path.name);
            let span = self.tag(node);
            self.report(Problem::error("E606", span, message));
            return None;
        };
        Some(Configured {
            path: path.name.split('.').map(part).collect(),
            location: self.address(node),
            spec: self.type_spec(ty)?,
            init: element(node, "initialValue").and_then(|v| self.initial_value(v)),
        })
    }

    fn address(&self, node: Node<'_, '_>) -> Option<Ident> {
        node.attribute("address").map(|address| Ident {
            name: address.trim().to_owned(),
            span: self.attribute_span(node, "address"),
        })
    }

    fn resource(&mut self, node: Node<'_, '_>) -> Resource {
        let mut resource = Resource {
            name: node.attribute("name").unwrap_or_default().to_owned(),
            ..Resource::default()
        };
        for task in elements(node, "task") {
            let name = task.attribute("name").unwrap_or_default().to_owned();
            let interval_ns = task
                .attribute("interval")
                .and_then(|text| self.interval(task, text));
            for instance in elements(task, "pouInstance") {
                let instance = self.program_instance(instance, Some(name.clone()));
                resource.instances.push(instance);
            }
            resource.tasks.push(Task {
                name,
                interval_ns,
                single: task.attribute("single").map(str::to_owned),
                priority: task
                    .attribute("priority")
                    .and_then(|p| p.parse().ok())
                    .unwrap_or(0),
                span: self.tag(task),
            });
        }
        for instance in elements(node, "pouInstance") {
            let instance = self.program_instance(instance, None);
            resource.instances.push(instance);
        }
        resource
    }

    /// `PT0.02S` (XML Schema), `T#20ms` (literal), or a number of seconds.
    fn interval(&mut self, task: Node<'_, '_>, text: &str) -> Option<i64> {
        let span = self.attribute_span(task, "interval");
        let upper = text.trim().to_ascii_uppercase();
        let as_literal = if let Some(duration) = upper.strip_prefix("PT") {
            format!("T#{duration}")
        } else if upper.contains('#') {
            upper
        } else if upper.is_empty() {
            return None;
        } else {
            format!(
                "T#{upper}{}",
                if upper.ends_with(|c: char| c.is_ascii_digit()) {
                    "s"
                } else {
                    ""
                }
            )
        };
        match literal::time(&as_literal, span) {
            Ok(ns) => Some(ns),
            Err(problem) => {
                self.report(*problem);
                None
            }
        }
    }

    fn program_instance(&mut self, node: Node<'_, '_>, task: Option<String>) -> ProgramInstance {
        let name = node.attribute("name").unwrap_or_default().to_owned();
        let program = node
            .attribute("typeName")
            .filter(|t| !t.is_empty())
            .unwrap_or(&name)
            .to_owned();
        ProgramInstance {
            name,
            program,
            task,
            connections: Vec::new(),
            span: self.tag(node),
        }
    }
}
