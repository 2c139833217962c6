//! The declarations of one MC as PLCopen XML fragments: data types and POUs, in the order of its logic.
//!
//! The POUs of all MCs of a controller share one list in its project, but names may repeat between MCs. A unit can be written
//! with some of its names changed; everything that refers to them changes with it.

use super::body::{body_text, drawn, tokens, whole_text, words};
use super::xml::Xml;
use fam_soft_plc::WHOLE_TEXT_NAMESPACE;
use fam_soft_plc::check::parse_location;
use fam_soft_plc::source::Span;
use fam_soft_plc::syntax::ast::{
    Configuration, Configured, Expr, Init, Interface, Pou, PouKind, Project, TypeDecl, TypeSpec,
    TypeSpecKind, VarBlock, VarDecl, VarSection,
};
use fam_soft_plc::types::Elem;
use std::collections::BTreeMap;

/// What an MC's declarations are written with, instead of their own names and addresses.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Renames {
    /// New names of types, POUs and global variables, by their old one in upper case.
    pub names: BTreeMap<String, String>,
    /// Where the MC's inputs, outputs and memory begin in the process image, in bytes; multiples of 8.
    pub image: [u32; 3],
}

impl Renames {
    /// The name that is written for this one.
    #[must_use]
    pub fn of(&self, name: &str) -> String {
        let new = self.names.get(&name.to_ascii_uppercase());
        new.map_or(name, String::as_str).to_owned()
    }

    /// The address that is written for this one.
    fn address(&self, text: &str) -> String {
        // Addresses of another PLC's levels stand for themselves.
        let Ok(mut location) = parse_location(text, Span::default()) else {
            return text.to_owned();
        };
        let [inputs, outputs, memory] = self.image;
        location.byte += match location.area() {
            'I' => inputs,
            'Q' => outputs,
            _ => memory,
        };
        location.to_string()
    }
}

/// A data type or POU.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Item {
    /// Name in the project.
    pub name: String,
    /// Name in the MC's logic.
    pub original: String,
    /// Whether it is a data type.
    pub is_type: bool,
    /// Whether it is an INTERFACE, which stands among the POUs.
    pub is_interface: bool,
    /// Its element, without what is around it.
    pub xml: String,
}

/// All types, then all POUs of a project.
#[must_use]
pub fn items(project: &Project, renames: &Renames) -> Vec<Item> {
    items_with(project, renames, &|_| None)
}

/// The comment of a declaration, by the span of its name.
pub type Comments<'a> = &'a dyn Fn(Span) -> Option<String>;

/// As [`items`], with comments as documentation.
#[must_use]
pub fn items_with(project: &Project, renames: &Renames, comments: Comments<'_>) -> Vec<Item> {
    let writer = UnitWriter {
        project,
        renames,
        comments,
    };
    let types = project.types.iter().map(|t| Item {
        name: writer.name(&t.name.name),
        original: t.name.name.clone(),
        is_type: true,
        is_interface: false,
        xml: writer.data_type(t),
    });
    let pous = project.pous.iter().map(|p| Item {
        name: writer.name(&p.name.name),
        original: p.name.name.clone(),
        is_type: false,
        is_interface: false,
        xml: writer.pou(p),
    });
    let interfaces = project.interfaces.iter().map(|i| Item {
        name: writer.name(&i.name.name),
        original: i.name.name.clone(),
        is_type: false,
        is_interface: true,
        xml: writer.interface(i),
    });
    types.chain(interfaces).chain(pous).collect()
}

/// Writes the global variables of a project (VAR_GLOBAL blocks) as `globalVars` elements.
pub fn globals(xml: &mut Xml, project: &Project, renames: &Renames) {
    globals_with(xml, project, renames, &|_| None, &|_| true);
}

/// As [`globals`], with comments as documentation, and only those that are wanted.
pub fn globals_with(
    xml: &mut Xml,
    project: &Project,
    renames: &Renames,
    comments: Comments<'_>,
    wanted: &dyn Fn(&str) -> bool,
) {
    let writer = UnitWriter {
        project,
        renames,
        comments,
    };
    for block in &project.globals {
        let block = VarBlock {
            access: None,
            decls: block
                .decls
                .iter()
                .filter(|d| wanted(&d.name.name))
                .cloned()
                .collect(),
            ..block.clone()
        };
        if !block.decls.is_empty() {
            writer.block(xml, "globalVars", &block);
        }
    }
}

/// What VAR_CONFIG says in the logic of some MCs, each with the resource that runs its programs now, under their own names.
/// Without a resource the lines stay as they are.
pub fn config_vars(xml: &mut Xml, all: &[(&Project, &Renames, Option<&str>)]) {
    let lines = |project: &Project| {
        project
            .configurations
            .iter()
            .any(|c| !c.configured.is_empty())
    };
    if !all.iter().any(|(project, _, _)| lines(project)) {
        return;
    }
    xml.open("configVars", &[]);
    for (project, renames, resource) in all {
        let writer = UnitWriter {
            project,
            renames,
            comments: &|_| None,
        };
        for configuration in &project.configurations {
            for line in &configuration.configured {
                writer.config_var(xml, configuration, line, *resource);
            }
        }
    }
    xml.close();
}

/// A variable's declaration as it is written.
#[must_use]
pub fn variable(project: &Project, decl: &VarDecl) -> String {
    let writer = UnitWriter {
        project,
        renames: &Renames::default(),
        comments: &|_| None,
    };
    let mut xml = Xml::fragment();
    writer.variable(&mut xml, &decl.name.name, decl);
    xml.finish()
}

/// Documentation as the schema wants it.
fn documentation(xml: &mut Xml, comment: Option<String>) {
    if let Some(comment) = comment {
        xml.open("documentation", &[]);
        xml.cdata("xhtml:p", &comment);
        xml.close();
    }
}

struct UnitWriter<'a> {
    project: &'a Project,
    renames: &'a Renames,
    comments: Comments<'a>,
}

impl UnitWriter<'_> {
    fn name(&self, name: &str) -> String {
        self.renames.of(name)
    }

    fn expr(&self, expr: &Expr) -> String {
        self.renamed(self.project.sources.slice(expr.span), &[])
    }

    /// A text with all renamed words and moved addresses replaced, except names of fields and parameters and the given variables.
    fn renamed(&self, text: &str, variables: &[&str]) -> String {
        if *self.renames == Renames::default() {
            return text.to_owned();
        }
        let mut out = String::with_capacity(text.len());
        let mut done = 0;
        for (at, word) in tokens(text, 0) {
            let new = if word.starts_with('%') {
                Some(self.renames.address(word))
            } else if text[..at].trim_end().ends_with('.')
                || is_parameter(text, at, word)
                || variables.iter().any(|v| v.eq_ignore_ascii_case(word))
            {
                None
            } else {
                self.renamed_word(word)
            };
            if let Some(new) = new {
                out.push_str(&text[done..at]);
                out.push_str(&new);
                done = at + word.len();
            }
        }
        out.push_str(&text[done..]);
        out
    }

    /// `Mode`, and the conversions `Mode_TO_INT` and `INT_TO_Mode`.
    fn renamed_word(&self, word: &str) -> Option<String> {
        let upper = word.to_ascii_uppercase();
        let names = &self.renames.names;
        if let Some(new) = names.get(&upper) {
            return Some(new.clone());
        }
        let split = upper.find("_TO_")?;
        let (from, to) = (&upper[..split], &upper[split + 4..]);
        match (names.get(from), names.get(to)) {
            (None, None) => None,
            (from_new, to_new) => Some(format!(
                "{}_TO_{}",
                from_new.map_or(&word[..split], String::as_str),
                to_new.map_or(&word[split + 4..], String::as_str)
            )),
        }
    }

    fn data_type(&self, decl: &TypeDecl) -> String {
        let mut xml = Xml::fragment();
        xml.open("dataType", &[("name", &self.name(&decl.name.name))]);
        xml.open("baseType", &[]);
        self.type_spec(&mut xml, &decl.spec);
        xml.close();
        if let Some(init) = &decl.init {
            self.initial_value(&mut xml, init);
        }
        documentation(&mut xml, (self.comments)(decl.name.span));
        xml.close();
        xml.finish()
    }

    fn type_spec(&self, xml: &mut Xml, spec: &TypeSpec) {
        match &spec.kind {
            TypeSpecKind::Named(name) => self.named(xml, &name.name),
            TypeSpecKind::Str { wide, len } => {
                let element = if *wide { "wstring" } else { "string" };
                match len {
                    Some(len) => xml.empty(element, &[("length", &self.expr(len))]),
                    None => xml.empty(element, &[]),
                }
            }
            TypeSpecKind::Array { dims, elem } => {
                xml.open("array", &[]);
                for (low, high) in dims {
                    let (low, high) = (self.expr(low), self.expr(high));
                    xml.empty("dimension", &[("lower", &low), ("upper", &high)]);
                }
                xml.open("baseType", &[]);
                self.type_spec(xml, elem);
                xml.close();
                xml.close();
            }
            // TC6 has no element of its own for open bounds, and takes any text for one.
            TypeSpecKind::OpenArray { dims, elem } => {
                xml.open("array", &[]);
                for _ in 0..*dims {
                    xml.empty("dimension", &[("lower", "*"), ("upper", "*")]);
                }
                xml.open("baseType", &[]);
                self.type_spec(xml, elem);
                xml.close();
                xml.close();
            }
            TypeSpecKind::Subrange { base, lo, hi } => {
                let unsigned = Elem::from_name(&base.name).is_some_and(Elem::is_unsigned);
                xml.open(
                    if unsigned {
                        "subrangeUnsigned"
                    } else {
                        "subrangeSigned"
                    },
                    &[],
                );
                let (low, high) = (self.expr(lo), self.expr(hi));
                xml.empty("range", &[("lower", &low), ("upper", &high)]);
                xml.open("baseType", &[]);
                self.named(xml, &base.name);
                xml.close();
                xml.close();
            }
            TypeSpecKind::Enum { base, values } => {
                xml.open("enum", &[]);
                xml.open("values", &[]);
                for (name, value) in values {
                    match value {
                        Some(value) => xml.empty(
                            "value",
                            &[("name", &name.name), ("value", &self.expr(value))],
                        ),
                        None => xml.empty("value", &[("name", &name.name)]),
                    }
                }
                xml.close();
                if let Some(base) = base {
                    xml.open("baseType", &[]);
                    self.named(xml, &base.name);
                    xml.close();
                }
                xml.close();
            }
            TypeSpecKind::Ref(to) | TypeSpecKind::Pointer(to) => {
                xml.open("pointer", &[]);
                xml.open("baseType", &[]);
                self.type_spec(xml, to);
                xml.close();
                xml.close();
            }
            // Wires of diagrams have no type of their own in a project; their values are computed where they are used.
            TypeSpecKind::Inferred => xml.empty("ANY", &[]),
            TypeSpecKind::Struct { fields, .. } => {
                xml.open("struct", &[]);
                for field in fields {
                    self.variable(xml, &field.name.name, field);
                }
                xml.close();
            }
        }
    }

    fn named(&self, xml: &mut Xml, name: &str) {
        match Elem::from_name(name) {
            // TC6 knows these two by their short names, and characters not at all.
            Some(Elem::Tod) => xml.empty("TOD", &[]),
            Some(Elem::Dt) => xml.empty("DT", &[]),
            Some(elem) if !elem.is_char() => xml.empty(elem.name(), &[]),
            _ => xml.empty("derived", &[("name", &self.name(name))]),
        }
    }

    fn variable(&self, xml: &mut Xml, name: &str, decl: &VarDecl) {
        match &decl.location {
            Some(location) => {
                let address = self.renames.address(&location.name);
                xml.open("variable", &[("name", name), ("address", &address)]);
            }
            None => xml.open("variable", &[("name", name)]),
        }
        xml.open("type", &[]);
        self.type_spec(xml, &decl.spec);
        xml.close();
        if let Some(init) = &decl.init {
            self.initial_value(xml, init);
        }
        documentation(xml, (self.comments)(decl.name.span));
        xml.close();
    }

    fn config_var(
        &self,
        xml: &mut Xml,
        configuration: &Configuration,
        line: &Configured,
        resource: Option<&str>,
    ) {
        let mut names: Vec<&str> = line.path.iter().map(|p| p.name.as_str()).collect();
        let program;
        if let Some(resource) = resource
            && let Some((at, of)) = program_in(configuration, self.project, &names)
        {
            program = self.renames.of(of);
            names.splice(..=at, [resource, program.as_str()]);
        }
        let path = names.join(".");
        let address = line.location.as_ref();
        let address = address.map(|at| self.renames.address(&at.name));
        let mut attributes = vec![("instancePathAndName", path.as_str())];
        if let Some(address) = &address {
            attributes.push(("address", address));
        }
        xml.open("configVariable", &attributes);
        xml.open("type", &[]);
        self.type_spec(xml, &line.spec);
        xml.close();
        if let Some(init) = &line.init {
            self.initial_value(xml, init);
        }
        xml.close();
    }

    fn initial_value(&self, xml: &mut Xml, init: &Init) {
        xml.open("initialValue", &[]);
        self.value(xml, init);
        xml.close();
    }

    fn value(&self, xml: &mut Xml, init: &Init) {
        match init {
            Init::Expr(expr) => xml.empty("simpleValue", &[("value", &self.expr(expr))]),
            Init::Array(items, _) => {
                xml.open("arrayValue", &[]);
                for (count, item) in items {
                    match count {
                        Some(count) => {
                            let count = self.expr(count);
                            xml.open("value", &[("repetitionValue", &count)]);
                        }
                        None => xml.open("value", &[]),
                    }
                    self.value(xml, item);
                    xml.close();
                }
                xml.close();
            }
            Init::Struct(fields, _) => {
                xml.open("structValue", &[]);
                for (name, field) in fields {
                    xml.open("value", &[("member", &name.name)]);
                    self.value(xml, field);
                    xml.close();
                }
                xml.close();
            }
        }
    }

    /// An element as it stands in its file, with renamed items under their new names: they stand in quotes there.
    fn redrawn(&self, element: &str) -> String {
        let mut out = self.renamed(element, &[]);
        for (old, new) in &self.renames.names {
            let mut done = String::with_capacity(out.len());
            let mut rest = out.as_str();
            while let Some(at) = rest.find('"') {
                let (before, quoted) = rest.split_at(at + 1);
                done.push_str(before);
                let end = quoted.find('"').unwrap_or(quoted.len());
                let (word, after) = quoted.split_at(end);
                let is_parameter = before.ends_with("formalParameter=\"");
                let stays = is_parameter || !word.eq_ignore_ascii_case(old);
                done.push_str(if stays { word } else { new });
                let close = after.len().min(1);
                done.push_str(&after[..close]);
                rest = &after[close..];
            }
            done.push_str(rest);
            out = done;
        }
        out.push('\n');
        out
    }

    fn block(&self, xml: &mut Xml, element: &str, block: &VarBlock) {
        let mut attributes = Vec::new();
        if block.constant {
            attributes.push(("constant", "true"));
        }
        if block.retain {
            attributes.push(("retain", "true"));
        }
        xml.open(element, &attributes);
        for decl in &block.decls {
            let name = if is_global(block) {
                self.name(&decl.name.name)
            } else {
                decl.name.name.clone()
            };
            self.variable(xml, &name, decl);
        }
        xml.close();
    }

    fn pou(&self, pou: &Pou) -> String {
        if let Some(element) = drawn(self.project, pou) {
            return self.redrawn(element);
        }
        let mut xml = Xml::fragment();
        let kind = match pou.kind {
            PouKind::Program => "program",
            PouKind::Function | PouKind::Method => "function",
            PouKind::FunctionBlock => "functionBlock",
        };
        xml.open(
            "pou",
            &[("name", &self.name(&pou.name.name)), ("pouType", kind)],
        );
        xml.open("interface", &[]);
        if let Some(result) = &pou.result {
            xml.open("returnType", &[]);
            self.type_spec(&mut xml, result);
            xml.close();
        }
        for block in &pou.vars {
            let element = match block.section {
                VarSection::Local => "localVars",
                VarSection::Input => "inputVars",
                VarSection::Output => "outputVars",
                VarSection::InOut => "inOutVars",
                VarSection::External => "externalVars",
                VarSection::Global => "globalVars",
                VarSection::Temp => "tempVars",
            };
            self.block(&mut xml, element, block);
        }
        xml.close();
        let mut variables: Vec<&str> = pou
            .vars
            .iter()
            .filter(|b| !is_global(b))
            .flat_map(|b| &b.decls)
            .map(|d| d.name.name.as_str())
            .collect();
        if pou.kind == PouKind::Function {
            // A function's own name is its result variable, and changes with it.
            variables.retain(|v| !v.eq_ignore_ascii_case(&pou.name.name));
        }
        let text = body_text(self.project, pou);
        let is_chart = pou.kind != PouKind::Function
            && words(&text, 0).any(|(_, w)| w.eq_ignore_ascii_case("INITIAL_STEP"));
        let body = if is_chart {
            String::new()
        } else {
            self.renamed(&text, &variables)
        };
        st_body(&mut xml, &body);
        let class = &pou.class;
        let is_class = class.extends.is_some()
            || !class.implements.is_empty()
            || !class.methods.is_empty()
            || class.is_abstract
            || class.is_final;
        let has_edges = pou
            .vars
            .iter()
            .flat_map(|b| &b.decls)
            .any(|d| d.edge.is_some());
        if is_class || is_chart || has_edges {
            let (open, close) = match pou.kind {
                PouKind::Program => ("PROGRAM", "END_PROGRAM"),
                _ => ("FUNCTION_BLOCK", "END_FUNCTION_BLOCK"),
            };
            if let Some(whole) = whole_text(self.project, &pou.name, open, close) {
                whole_data(&mut xml, &self.renamed(whole, &variables));
            }
        }
        documentation(&mut xml, (self.comments)(pou.name.span));
        xml.close();
        xml.finish()
    }

    /// An INTERFACE, for which TC6 has no element: a function block without anything, with the text beside it.
    fn interface(&self, interface: &Interface) -> String {
        let mut xml = Xml::fragment();
        let name = self.name(&interface.name.name);
        xml.open("pou", &[("name", &name), ("pouType", "functionBlock")]);
        xml.empty("interface", &[]);
        st_body(&mut xml, "");
        let whole = whole_text(self.project, &interface.name, "INTERFACE", "END_INTERFACE");
        whole_data(&mut xml, &self.renamed(whole.unwrap_or_default(), &[]));
        xml.close();
        xml.finish()
    }
}

/// Whether the block's variables have the names that all POUs share.
/// Which part of a path of VAR_CONFIG is the program, and its name.
fn program_in<'a>(
    configuration: &'a Configuration,
    project: &'a Project,
    path: &[&str],
) -> Option<(usize, &'a str)> {
    let resources = &configuration.resources;
    let begins = usize::from(path.len() > 2 && resources.iter().any(|r| same(&r.name, path[0])));
    let instances = || resources.iter().flat_map(|r| &r.instances);
    (begins..path.len()).find_map(|at| {
        let instance = instances().find(|i| same(&i.name, path[at]));
        let name = instance.map_or(path[at], |i| i.program.as_str());
        let is_it = |p: &&Pou| p.kind == PouKind::Program && same(&p.name.name, name);
        let pou = project.pous.iter().find(is_it)?;
        Some((at, pou.name.name.as_str()))
    })
}

fn same(a: &str, b: &str) -> bool {
    a.eq_ignore_ascii_case(b)
}

fn is_global(block: &VarBlock) -> bool {
    matches!(block.section, VarSection::External | VarSection::Global)
}

/// Whether a word is the name of a parameter or a field: `f(word := x)`, `f(word => x)`.
fn is_parameter(text: &str, at: usize, word: &str) -> bool {
    let behind = text[at + word.len()..].trim_start();
    let before = text[..at].trim_end();
    behind.starts_with("=>") || behind.starts_with(":=") && before.ends_with(['(', ','])
}

fn st_body(xml: &mut Xml, text: &str) {
    xml.open("body", &[]);
    xml.open("ST", &[]);
    xml.cdata("xhtml:p", text);
    xml.close();
    xml.close();
}

/// What TC6 has no elements for (methods, inheritance, interfaces, textual charts, edges of inputs) goes along as the whole text.
fn whole_data(xml: &mut Xml, text: &str) {
    xml.open("addData", &[]);
    xml.open(
        "data",
        &[
            ("name", WHOLE_TEXT_NAMESPACE),
            ("handleUnknown", "preserve"),
        ],
    );
    xml.cdata_with("st", &[("xmlns", WHOLE_TEXT_NAMESPACE)], text);
    xml.close();
    xml.close();
}
