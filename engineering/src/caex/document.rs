//! CAEX files as objects: the same for schema versions 2.15 and 3.0.
//!
//! The differences of 2.15 end here: no namespace, one RoleRequirements, and sides of links that are `{GUID}:Name`
//! ([`super::links`] takes all spellings). Elements that the schema does not know are errors; what it knows and FAM has no
//! use for (constraints, geometry) is passed over; of its history speaks `history`.

use super::history::{self, Change, History};
use crate::problem::{Explain, ModelText, Place};
use fam_soft_plc::diag::Diagnostic;
use roxmltree::{Document, Node, ParsingOptions};
use std::ops::Range;

/// Number of an object.
pub type ObjectId = usize;
/// How deep elements may be nested.
pub const DEPTH_MAX: usize = 64;
/// Most XML nodes of a file.
const NODES_MAX: u32 = 4_000_000;

const NAMESPACE_3: &str = "http://www.dke.de/CAEX";

/// Kind of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)] // the standard's own names
pub enum Kind {
    InstanceHierarchy,
    InternalElement,
    ExternalInterface,
    InternalLink,
    InterfaceClassLib,
    InterfaceClass,
    RoleClassLib,
    RoleClass,
    SystemUnitClassLib,
    SystemUnitClass,
    AttributeTypeLib,
    AttributeType,
}

impl Kind {
    fn of(element: &str) -> Option<Kind> {
        Some(match element {
            "InstanceHierarchy" => Kind::InstanceHierarchy,
            "InternalElement" => Kind::InternalElement,
            "ExternalInterface" => Kind::ExternalInterface,
            "InternalLink" => Kind::InternalLink,
            "InterfaceClassLib" => Kind::InterfaceClassLib,
            "InterfaceClass" => Kind::InterfaceClass,
            "RoleClassLib" => Kind::RoleClassLib,
            "RoleClass" => Kind::RoleClass,
            "SystemUnitClassLib" => Kind::SystemUnitClassLib,
            "SystemUnitClass" => Kind::SystemUnitClass,
            "AttributeTypeLib" => Kind::AttributeTypeLib,
            "AttributeType" => Kind::AttributeType,
            _ => return None,
        })
    }

    /// Whether it is a library, the first step of a class path.
    #[must_use]
    pub fn is_library(self) -> bool {
        matches!(
            self,
            Kind::InterfaceClassLib
                | Kind::RoleClassLib
                | Kind::SystemUnitClassLib
                | Kind::AttributeTypeLib
        )
    }

    /// Which elements may stand in it, beside the header ones.
    fn content(self) -> &'static [&'static str] {
        match self {
            Kind::InstanceHierarchy => &["InternalElement"],
            Kind::InternalElement => &[
                "Attribute",
                "ExternalInterface",
                "InternalElement",
                "SupportedRoleClass",
                "InternalLink",
                "RoleRequirements",
                "MappingObject",
            ],
            Kind::SystemUnitClass => &[
                "Attribute",
                "ExternalInterface",
                "InternalElement",
                "SupportedRoleClass",
                "InternalLink",
                "SystemUnitClass",
            ],
            Kind::ExternalInterface => &["Attribute", "ExternalInterface"],
            Kind::InterfaceClass => &["Attribute", "ExternalInterface", "InterfaceClass"],
            Kind::RoleClass => &["Attribute", "ExternalInterface", "RoleClass"],
            Kind::InternalLink => &[],
            Kind::InterfaceClassLib => &["InterfaceClass"],
            Kind::RoleClassLib => &["RoleClass"],
            Kind::SystemUnitClassLib => &["SystemUnitClass"],
            Kind::AttributeTypeLib => &["AttributeType"],
            Kind::AttributeType => &[
                "AttributeType",
                "Attribute",
                "DefaultValue",
                "Value",
                "RefSemantic",
                "Constraint",
            ],
        }
    }
}

/// Elements that any CAEX object may begin with.
const HEADER: [&str; 6] = [
    "Description",
    "Version",
    "Revision",
    "Copyright",
    "AdditionalInformation",
    "SourceObjectInformation",
];

/// A text with its place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Text {
    /// As it stands there, white space around it removed.
    pub text: String,
    /// In bytes of its file.
    pub at: Range<usize>,
}

/// An attribute of an object (the CAEX element, not an XML attribute).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attribute {
    /// Name.
    pub name: Text,
    /// `Value`.
    pub value: Option<Text>,
    /// `DefaultValue`.
    pub default: Option<Text>,
    /// `AttributeDataType`, such as `xs:double`.
    pub data_type: Option<String>,
    /// `Unit`.
    pub unit: Option<Text>,
    /// Path of its AttributeType.
    pub base: Option<Text>,
    /// Nested ones.
    pub attributes: Vec<Attribute>,
}

/// A named object of a CAEX file.
#[derive(Debug, Clone)]
pub struct Object {
    /// Kind.
    pub kind: Kind,
    /// Name, with its place.
    pub name: Text,
    /// ID, as written.
    pub id: Option<String>,
    /// Number of its file.
    pub file: usize,
    /// From its opening to its closing tag.
    pub at: Range<usize>,
    /// The object that it stands in.
    pub parent: Option<ObjectId>,
    /// Objects that stand in it.
    pub children: Vec<ObjectId>,
    /// `RefBaseClassPath`, `RefBaseSystemUnitPath` or `RefAttributeType`.
    pub base: Option<Text>,
    /// Paths of RoleRequirements and SupportedRoleClass.
    pub roles: Vec<Text>,
    /// Attributes; those of RoleRequirements follow its own. Of an AttributeType first itself, as the attribute that it makes.
    pub attributes: Vec<Attribute>,
    /// What attributes of its roles are called here: the role's name, and the own one.
    pub mappings: Vec<(String, String)>,
    /// Description.
    pub description: String,
    /// Sides of an InternalLink.
    pub sides: Option<[Text; 2]>,
}

/// An external library that a file names.
#[derive(Debug, Clone)]
pub struct ExternalReference {
    /// Prefix of paths into it.
    pub alias: String,
    /// Its path, as written.
    pub path: Text,
}

/// What was found in a file.
#[derive(Debug, Default)]
pub struct Parsed {
    /// Instance hierarchies and libraries.
    pub roots: Vec<ObjectId>,
    /// External libraries.
    pub references: Vec<ExternalReference>,
}

/// Parses a text with limits: no entities, not too many nodes.
///
/// # Errors
/// A problem that says what stands against it.
pub fn parse_xml(text: &ModelText) -> Result<Document<'_>, Box<Diagnostic>> {
    let options = ParsingOptions {
        nodes_limit: NODES_MAX,
        ..ParsingOptions::default()
    };
    Document::parse_with_options(&text.text, options).map_err(|e| {
        let position = e.pos();
        let start: usize = text
            .text
            .split_inclusive('\n')
            .take((position.row as usize).saturating_sub(1))
            .map(str::len)
            .sum();
        let at = text.text[start..]
            .char_indices()
            .nth((position.col as usize).saturating_sub(1))
            .map_or(text.text.len(), |(i, _)| start + i);
        Box::new(match e {
            roxmltree::Error::DtdDetected => {
                let at = text.text.find("<!DOCTYPE").unwrap_or(0);
                text.error("M801", at..at + 9, "the file declares a document type, which could define entities that expand without end")
                    .hint("remove `<!DOCTYPE ...>`: neither CAEX nor PLCopen XML has one")
            }
            roxmltree::Error::NodesLimitReached => text
                .error("M801", 0..1, format!("the file has more than {NODES_MAX} XML nodes"))
                .hint("divide it, or leave out what is no control logic"),
            _ => text
                .error("M801", at..at + 1, format!("this is no well-formed XML: {e}"))
                .expected("an AutomationML (CAEX) file, or cell.toml"),
        })
    })
}

/// Reads a file's objects into `objects`.
pub fn read(
    text: &ModelText,
    file: usize,
    objects: &mut Vec<Object>,
    problems: &mut Vec<Diagnostic>,
) -> Option<Parsed> {
    let document = match parse_xml(text) {
        Ok(document) => document,
        Err(problem) => {
            problems.push(*problem);
            return None;
        }
    };
    let mut reader = Reader {
        text,
        file,
        objects,
        problems,
        parsed: Parsed::default(),
        path: Vec::new(),
        history: History::default(),
        is_plant: false,
    };
    reader.root(document.root_element())?;
    reader.history.notices(text, reader.problems);
    Some(reader.parsed)
}

struct Reader<'a> {
    text: &'a ModelText,
    file: usize,
    objects: &'a mut Vec<Object>,
    problems: &'a mut Vec<Diagnostic>,
    parsed: Parsed,
    /// Names of the objects that are being read, the outermost first.
    path: Vec<String>,
    history: History,
    /// Whether an instance hierarchy is being read, and no library.
    is_plant: bool,
}

impl Reader<'_> {
    /// The elements in an element, without those that are marked as deleted.
    fn elements<'n, 'i>(&mut self, node: Node<'n, 'i>) -> Vec<Node<'n, 'i>> {
        let elements = node.children().filter(Node::is_element);
        elements.filter(|n| self.is_there(*n)).collect()
    }

    fn is_there(&mut self, node: Node<'_, '_>) -> bool {
        match history::change(node) {
            Change::There => return true,
            Change::Deleted => self.history.deleted(&self.path, node, self.tag(node)),
            Change::Unknown => {
                let value = self.attribute_text(node, "ChangeMode");
                let value = value.unwrap_or_else(|| self.required(node, "ChangeMode"));
                let message = format!("the ChangeMode `{}` is unknown", value.text);
                let problem = self.text.error("M803", value.at, message);
                self.report(problem.expected("state, create, change or delete"));
            }
        }
        false
    }

    fn report(&mut self, mut problem: Diagnostic) {
        if !self.path.is_empty() {
            problem.pou = Some(self.path.join("/"));
        }
        self.problems.push(problem);
    }

    /// The opening tag.
    fn tag(&self, node: Node<'_, '_>) -> Range<usize> {
        let range = node.range();
        let len = self.text.text[range.clone()]
            .find('>')
            .map_or(range.len(), |end| end + 1);
        range.start..range.start + len
    }

    fn attribute_text(&self, node: Node<'_, '_>, name: &str) -> Option<Text> {
        let attribute = node.attribute_node(name)?;
        Some(Text {
            text: attribute.value().trim().to_owned(),
            at: attribute.range_value(),
        })
    }

    /// A required XML attribute.
    fn required(&mut self, node: Node<'_, '_>, name: &str) -> Text {
        match self.attribute_text(node, name) {
            Some(text) if !text.text.is_empty() => text,
            found => {
                let at = found.map_or_else(|| self.tag(node), |t| t.at);
                let message = format!("<{}> has no `{name}`", node.tag_name().name());
                let problem = self
                    .text
                    .error("M803", at.clone(), message)
                    .expected(format!("`{name}`, which the CAEX schema requires"));
                self.report(problem);
                Text {
                    text: String::new(),
                    at,
                }
            }
        }
    }

    fn unknown(&mut self, node: Node<'_, '_>, inside: &str, expected: &[&str]) {
        let message = format!("<{}> cannot stand in <{inside}>", node.tag_name().name());
        let problem = self
            .text
            .error("M803", self.tag(node), message)
            .expected(format!("after the CAEX schema: {}", expected.join(", ")));
        self.report(problem);
    }

    fn root(&mut self, root: Node<'_, '_>) -> Option<()> {
        let name = root.tag_name().name();
        let namespace = root.tag_name().namespace().unwrap_or("");
        if name != "CAEXFile" {
            let what = match namespace {
                n if n.contains("plcopen.org/xml") => {
                    "a PLCopen project, which is the logic of a model".to_owned()
                }
                _ => format!("<{name}>"),
            };
            self.problems.push(
                self.text
                    .error(
                        "M802",
                        self.tag(root),
                        format!("this XML file is no AutomationML model: it is {what}"),
                    )
                    .expected("<CAEXFile> of CAEX 3.0 or 2.15")
                    .hint("`fam import` proposes a model from a PLCopen project"),
            );
            return None;
        }
        match (root.attribute("SchemaVersion"), namespace) {
            (Some("3.0"), NAMESPACE_3) | (Some("2.15"), "") => {}
            (Some("3.0"), other) => {
                let message = format!("the CAEX 3.0 file has the namespace `{other}`");
                let problem = self.text.error("M802", self.tag(root), message);
                self.problems.push(problem.expected(NAMESPACE_3));
            }
            (version, _) => {
                let at = root
                    .attribute_node("SchemaVersion")
                    .map_or_else(|| self.tag(root), |a| a.range_value());
                let message = match version {
                    Some(version) => format!("CAEX {version} is not supported"),
                    None => "the file does not say its SchemaVersion".to_owned(),
                };
                let problem = self.text.error("M802", at, message);
                self.problems
                    .push(problem.expected("SchemaVersion 3.0 or 2.15"));
                return None;
            }
        }
        if !self.is_there(root) {
            let message = "the file is marked as deleted as a whole";
            let problem = self.text.error("M802", self.tag(root), message);
            self.report(problem.hint("name the file that has taken its place"));
            return None;
        }
        const CONTENT: [&str; 7] = [
            "ExternalReference",
            "InstanceHierarchy",
            "InterfaceClassLib",
            "RoleClassLib",
            "SystemUnitClassLib",
            "AttributeTypeLib",
            "SourceDocumentInformation",
        ];
        for node in self.elements(root) {
            let name = node.tag_name().name();
            match name {
                "ExternalReference" => {
                    let alias = self.required(node, "Alias").text;
                    let path = self.required(node, "Path");
                    self.parsed
                        .references
                        .push(ExternalReference { alias, path });
                }
                "SourceDocumentInformation" | "SuperiorStandardVersion" => {}
                _ if HEADER.contains(&name) => {}
                _ if CONTENT.contains(&name) => {
                    let kind = Kind::of(name)?;
                    self.is_plant = kind == Kind::InstanceHierarchy;
                    let id = self.object(node, kind, None, 1);
                    self.parsed.roots.push(id);
                }
                _ => self.unknown(node, "CAEXFile", &CONTENT),
            }
        }
        Some(())
    }

    fn object(
        &mut self,
        node: Node<'_, '_>,
        kind: Kind,
        parent: Option<ObjectId>,
        depth: usize,
    ) -> ObjectId {
        let name = match kind {
            // Links are often nameless in 2.15.
            Kind::InternalLink => self.attribute_text(node, "Name").unwrap_or(Text {
                text: String::new(),
                at: self.tag(node),
            }),
            _ => self.required(node, "Name"),
        };
        let base = [
            "RefBaseClassPath",
            "RefBaseSystemUnitPath",
            "RefAttributeType",
        ]
        .iter()
        .find_map(|a| self.attribute_text(node, a))
        .filter(|b| !b.text.is_empty());
        let sides = (kind == Kind::InternalLink).then(|| {
            [
                self.required(node, "RefPartnerSideA"),
                self.required(node, "RefPartnerSideB"),
            ]
        });
        let id = self.objects.len();
        self.objects.push(Object {
            kind,
            name,
            id: node
                .attribute("ID")
                .map(str::trim)
                .filter(|i| !i.is_empty())
                .map(str::to_owned),
            file: self.file,
            at: node.range(),
            parent,
            children: Vec::new(),
            base,
            roles: Vec::new(),
            attributes: Vec::new(),
            mappings: Vec::new(),
            description: String::new(),
            sides,
        });
        if kind == Kind::AttributeType {
            let itself = self.attribute(node, depth);
            self.objects[id].attributes.extend(itself);
        }
        if depth > DEPTH_MAX {
            self.too_deep(node);
            return id;
        }
        self.path.push(self.objects[id].name.text.clone());
        for child in self.elements(node) {
            self.child(id, kind, child, depth);
        }
        self.path.pop();
        id
    }

    fn too_deep(&mut self, node: Node<'_, '_>) {
        let message = format!("elements are nested more than {DEPTH_MAX} deep");
        let problem = self.text.error("M803", self.tag(node), message);
        self.report(problem.hint("flatten the hierarchy"));
    }

    fn child(&mut self, id: ObjectId, kind: Kind, node: Node<'_, '_>, depth: usize) {
        let name = node.tag_name().name();
        if name == "Description" {
            self.objects[id].description = node.text().unwrap_or("").trim().to_owned();
            return;
        }
        if HEADER.contains(&name) {
            if self.is_plant {
                self.history.header(&self.path, name, self.tag(node));
            }
            return;
        }
        if !kind.content().contains(&name) {
            let inside = node.parent().map_or("", |p| p.tag_name().name());
            return self.unknown(node, inside, kind.content());
        }
        match name {
            "Attribute" if kind == Kind::AttributeType => {}
            "Attribute" => {
                if let Some(attribute) = self.attribute(node, depth + 1) {
                    self.objects[id].attributes.push(attribute);
                }
            }
            "SupportedRoleClass" => {
                let role = self.required(node, "RefRoleClassPath");
                self.objects[id].roles.push(role);
                for mapping in self.elements(node) {
                    self.mapping(id, mapping);
                }
            }
            "RoleRequirements" => {
                // Optional in 2.15, where an element may require attributes without a role.
                if node.has_attribute("RefBaseRoleClassPath") || node.has_children() {
                    let role = self.required(node, "RefBaseRoleClassPath");
                    self.objects[id].roles.push(role);
                }
                for inner in self.elements(node) {
                    match inner.tag_name().name() {
                        "Attribute" => {
                            if let Some(attribute) = self.attribute(inner, depth + 1) {
                                self.objects[id].attributes.push(attribute);
                            }
                        }
                        "ExternalInterface" => {
                            let child =
                                self.object(inner, Kind::ExternalInterface, Some(id), depth + 1);
                            self.objects[id].children.push(child);
                        }
                        "MappingObject" => self.mapping(id, inner),
                        other if HEADER.contains(&other) => {}
                        _ => self.unknown(
                            inner,
                            name,
                            &["Attribute", "ExternalInterface", "MappingObject"],
                        ),
                    }
                }
            }
            "MappingObject" => self.mapping(id, node),
            // Of an AttributeType: read with it.
            "RefSemantic" | "Constraint" | "Value" | "DefaultValue" => {}
            _ => {
                let Some(child_kind) = Kind::of(name) else {
                    return;
                };
                let child = self.object(node, child_kind, Some(id), depth + 1);
                self.objects[id].children.push(child);
            }
        }
    }

    /// `<MappingObject>`: names of attributes. Interfaces are known by their classes, whatever they are called.
    fn mapping(&mut self, id: ObjectId, node: Node<'_, '_>) {
        for pair in self.elements(node) {
            if pair.tag_name().name() != "AttributeNameMapping" {
                continue;
            }
            let role = self.required(pair, "RoleAttributeName").text;
            let own = self.required(pair, "SystemUnitAttributeName").text;
            self.objects[id].mappings.push((role, own));
        }
    }

    fn attribute(&mut self, node: Node<'_, '_>, depth: usize) -> Option<Attribute> {
        if depth > DEPTH_MAX {
            self.too_deep(node);
            return None;
        }
        let mut attribute = Attribute {
            name: self.required(node, "Name"),
            value: None,
            default: None,
            data_type: node.attribute("AttributeDataType").map(str::to_owned),
            unit: self.attribute_text(node, "Unit"),
            base: self
                .attribute_text(node, "RefAttributeType")
                .filter(|b| !b.text.is_empty()),
            attributes: Vec::new(),
        };
        for child in self.elements(node) {
            match child.tag_name().name() {
                "Value" => attribute.value = Some(self.content(child)),
                "DefaultValue" => attribute.default = Some(self.content(child)),
                "Attribute" => attribute
                    .attributes
                    .extend(self.attribute(child, depth + 1)),
                "RefSemantic" | "Constraint" | "AttributeType" => {}
                name if HEADER.contains(&name) => {}
                _ => self.unknown(
                    child,
                    "Attribute",
                    &[
                        "DefaultValue",
                        "Value",
                        "RefSemantic",
                        "Constraint",
                        "Attribute",
                    ],
                ),
            }
        }
        Some(attribute)
    }

    /// The text in an element; its place is that of the first piece.
    fn content(&self, node: Node<'_, '_>) -> Text {
        let text: String = node
            .children()
            .filter(Node::is_text)
            .filter_map(|n| n.text())
            .collect();
        let at = node
            .children()
            .find(Node::is_text)
            .map_or_else(|| self.tag(node), |n| n.range());
        // The place of what people see, without the white space around it.
        let raw = &self.text.text[at.clone()];
        let lead = raw.len() - raw.trim_start().len();
        let at = if raw.trim().is_empty() {
            at
        } else {
            at.start + lead..at.start + lead + raw.trim().len()
        };
        Text {
            text: text.trim().to_owned(),
            at,
        }
    }
}

/// Where the objects of a file stand, for messages.
#[must_use]
pub fn places(objects: &[Object], file: usize) -> Vec<Place> {
    let mut numbers: Vec<Option<usize>> = Vec::with_capacity(objects.len());
    let mut places = Vec::new();
    for object in objects {
        let is_here = object.file == file && !object.name.text.is_empty();
        numbers.push(is_here.then_some(places.len()));
        if is_here {
            places.push(Place {
                at: object.at.clone(),
                name: object.name.text.clone(),
                inside: object.parent.and_then(|p| numbers[p]),
            });
        }
    }
    places
}
