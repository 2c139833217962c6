//! All files of a model together: class paths with aliases, inheritance of classes, mirror objects, inherited parts.

use super::document::{self, Attribute, ExternalReference, Kind, Object, ObjectId, Text};
use super::{FAM_LIBRARY, FAM_LIBRARY_FILE, uri};
use crate::files::{FileError, ModelFiles, folder_of, join};
use crate::problem::{Explain, ModelText, suggestion};
use fam_soft_plc::diag::Diagnostic;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Most files of a model.
const FILES_MAX: usize = 64;
/// Longest chain of base classes.
const CHAIN_MAX: usize = 64;
/// Libraries of the standard and of its recommendations: references to their classes are understood by their names, also
/// where the library itself is not at hand.
const STANDARD_LIBRARIES: [&str; 3] = [
    "AutomationML",
    "AutomationProjectConfiguration",
    "Communication",
];

/// A file of the model.
#[derive(Debug)]
struct File {
    text: ModelText,
    /// Path relative to the model's folder, for references from it.
    path: String,
    /// By alias: number of the file; `None` if it could not be read (reported).
    aliases: BTreeMap<String, Option<usize>>,
}

/// A model: its main file and the libraries that it refers to.
#[derive(Debug)]
pub struct Caex {
    files: Vec<File>,
    /// All objects.
    pub objects: Vec<Object>,
    /// Instance hierarchies of the main file.
    pub hierarchies: Vec<ObjectId>,
    /// Classes by file and path without alias.
    classes: BTreeMap<(usize, String), ObjectId>,
    /// Objects by file and ID.
    ids: BTreeMap<(usize, String), ObjectId>,
}

/// An object as it shows in an instance: with its place in the main file, also if a class brought it along.
#[derive(Debug, Clone)]
pub struct Part {
    /// The object.
    pub id: ObjectId,
    /// Its place in the main file.
    pub at: Range<usize>,
    /// The elements whose classes brought it along, the outermost first; none for an object of the hierarchy itself.
    pub via: Vec<ObjectId>,
}

/// What tells an element from all others, also from those that the same class brings into other instances.
pub type InstanceId = Vec<ObjectId>;

impl Part {
    /// Its identity.
    #[must_use]
    pub fn instance(&self) -> InstanceId {
        let mut id = self.via.clone();
        id.push(self.id);
        id
    }
}

/// Reads a model with all its libraries. `None` if the main file cannot be read.
pub fn load(
    files: &ModelFiles,
    name: &str,
    path: &str,
    text: String,
    problems: &mut Vec<Diagnostic>,
) -> Option<Caex> {
    let mut loader = Loader {
        source: files,
        caex: Caex {
            files: Vec::new(),
            objects: Vec::new(),
            hierarchies: Vec::new(),
            classes: BTreeMap::new(),
            ids: BTreeMap::new(),
        },
        known: BTreeMap::new(),
        open: Vec::new(),
        problems,
    };
    loader.file(name, path, text)?;
    if !loader.known.contains_key(FAM_LIBRARY_FILE) {
        // For models that name its classes without saying where they are.
        loader.file(FAM_LIBRARY_FILE, FAM_LIBRARY_FILE, FAM_LIBRARY.to_owned());
    }
    let mut caex = loader.caex;
    caex.index(problems);
    Some(caex)
}

struct Loader<'a> {
    source: &'a ModelFiles,
    caex: Caex,
    /// Files by path.
    known: BTreeMap<String, Option<usize>>,
    /// Files that are being read, the main one first.
    open: Vec<String>,
    problems: &'a mut Vec<Diagnostic>,
}

impl Loader<'_> {
    fn file(&mut self, name: &str, path: &str, text: String) -> Option<usize> {
        let number = self.caex.files.len();
        let mut model = ModelText::new(name, text);
        let parsed = document::read(&model, number, &mut self.caex.objects, self.problems);
        model.places = document::places(&self.caex.objects, number);
        self.known
            .insert(path.to_owned(), parsed.is_some().then_some(number));
        self.caex.files.push(File {
            text: model,
            path: path.to_owned(),
            aliases: BTreeMap::new(),
        });
        let parsed = parsed?;
        if number == 0 {
            self.caex.hierarchies = parsed
                .roots
                .iter()
                .copied()
                .filter(|r| self.caex.objects[*r].kind == Kind::InstanceHierarchy)
                .collect();
        }
        self.open.push(path.to_owned());
        for reference in parsed.references {
            let found = self.reference(number, &reference);
            self.caex.files[number]
                .aliases
                .insert(reference.alias, found);
        }
        self.open.pop();
        Some(number)
    }

    /// The file of an external reference.
    fn reference(&mut self, from: usize, reference: &ExternalReference) -> Option<usize> {
        let at = reference.path.at.clone();
        let what = format!("the library `{}`", reference.alias);
        let uri = match uri::parse(&reference.path.text) {
            Ok(uri) => uri,
            Err(e) => {
                let text = &self.caex.files[from].text;
                let problem = text
                    .error("M804", at, format!("{what}: {e}"))
                    .expected("a path relative to this file");
                self.problems.push(problem);
                return None;
            }
        };
        let is_fam = uri.path.rsplit('/').next() == Some(FAM_LIBRARY_FILE);
        if is_fam {
            if let Some(known) = self.known.get(FAM_LIBRARY_FILE) {
                return *known;
            }
            return self.file(FAM_LIBRARY_FILE, FAM_LIBRARY_FILE, FAM_LIBRARY.to_owned());
        }
        let folder = folder_of(&self.caex.files[from].path).to_owned();
        let path = match join(&folder, &uri.path) {
            Ok(path) => path,
            Err(e) => {
                self.not_read(from, reference, &uri.path, &e);
                return None;
            }
        };
        if let Some(begun) = self.open.iter().position(|p| *p == path) {
            let mut round: Vec<String> = self.open[begun..].to_vec();
            round.push(path);
            let message = format!(
                "{what}: the files refer to each other in a circle: {}",
                round.join(" > ")
            );
            let problem = self.caex.files[from].text.error("M807", at, message);
            self.problems
                .push(problem.hint("move the classes that both need into a third library"));
            return None;
        }
        if let Some(known) = self.known.get(&path) {
            return *known;
        }
        if self.caex.files.len() >= FILES_MAX {
            let problem = self.caex.files[from].text.error(
                "M804",
                at,
                format!("{what}: a model has at most {FILES_MAX} files"),
            );
            self.problems.push(problem);
            return None;
        }
        match self.source.read(&path) {
            Ok(text) => self.file(&path.clone(), &path, text),
            Err(e) => {
                self.not_read(from, reference, &uri.path, &e);
                self.known.insert(path, None);
                None
            }
        }
    }

    /// A library that cannot be had. One of the standard's is missed by nobody: its classes are known by their names.
    fn not_read(&mut self, from: usize, reference: &ExternalReference, path: &str, e: &FileError) {
        let at = reference.path.at.clone();
        let text = &self.caex.files[from].text;
        let message = format!("the library `{}`: {e}", reference.alias);
        let name = path.rsplit('/').next().unwrap_or(path);
        let problem = if STANDARD_LIBRARIES.iter().any(|l| name.starts_with(l)) {
            text.warning("W809", at, message)
                .hint("the classes of the standard's libraries are understood by their names")
        } else {
            let code = match e {
                FileError::Leaves(_) => "M805",
                _ => "M804",
            };
            text.error(code, at, message).hint(e.hint())
        };
        self.problems.push(problem);
    }
}

/// Why a path leads to no class. Both tell what there is instead.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ClassError {
    /// The alias before the `@` is none of the file's.
    #[error("the file has no ExternalReference with the alias `{alias}`; {hint}")]
    NoAlias {
        /// As written.
        alias: String,
        /// The ones that there are.
        hint: String,
    },
    /// No library at hand has it.
    #[error("{hint}")]
    NoClass {
        /// The ones that there are.
        hint: String,
    },
}

impl Caex {
    /// The main file.
    #[must_use]
    pub fn text(&self) -> &ModelText {
        &self.files[0].text
    }

    /// The main file, when nothing else is needed any more.
    #[must_use]
    pub fn into_text(mut self) -> ModelText {
        self.files.swap_remove(0).text
    }

    /// Folder of the main file, relative to the model's files.
    #[must_use]
    pub fn folder(&self) -> &str {
        folder_of(&self.files[0].path)
    }

    fn index(&mut self, problems: &mut Vec<Diagnostic>) {
        let mut paths: Vec<String> = Vec::with_capacity(self.objects.len());
        for (id, object) in self.objects.iter().enumerate() {
            let is_class = matches!(
                object.kind,
                Kind::InterfaceClass
                    | Kind::RoleClass
                    | Kind::SystemUnitClass
                    | Kind::AttributeType
            );
            // Instances are found by ID, classes by path.
            let path = match object.parent {
                Some(parent) if is_class => format!("{}/{}", paths[parent], object.name.text),
                None if object.kind.is_library() => object.name.text.clone(),
                _ => String::new(),
            };
            if is_class {
                self.classes
                    .entry((object.file, path.clone()))
                    .or_insert(id);
            }
            paths.push(path);
            if let Some(own) = &object.id {
                let key = (object.file, normal_id(own));
                let own = &key.1;
                match self.ids.get(&key) {
                    // Nobody can mend a library that came from elsewhere, and its first object will do.
                    Some(_) if object.file != 0 => {}
                    Some(first) => {
                        let (line, _) = self.files[0]
                            .text
                            .position(self.objects[*first].name.at.start);
                        let message = format!("the ID `{own}` is used twice");
                        problems.push(
                            self.files[0]
                                .text
                                .error("M803", object.name.at.clone(), message)
                                .hint(format!(
                                    "the first one stands in line {line}; give this one a new ID"
                                )),
                        );
                    }
                    None => {
                        self.ids.insert(key, id);
                    }
                }
            }
        }
    }

    /// The object of a file with this ID, in any spelling.
    #[must_use]
    pub fn by_id_in(&self, file: usize, id: &str) -> Option<ObjectId> {
        self.ids.get(&(file, normal_id(id))).copied()
    }

    /// The object that another one refers to by an ID.
    fn by_id(&self, from: ObjectId, id: &str) -> Option<ObjectId> {
        self.by_id_in(self.objects[from].file, id)
    }

    /// An object of the hierarchy itself.
    #[must_use]
    pub fn part(&self, id: ObjectId) -> Part {
        Part {
            id,
            at: self.objects[id].name.at.clone(),
            via: Vec::new(),
        }
    }

    /// Text of an object's file.
    #[must_use]
    pub fn text_of(&self, id: ObjectId) -> &ModelText {
        &self.files[self.objects[id].file].text
    }

    /// The class that a path written in `from` leads to. `Ok(None)` for a class of a standard library that is not at hand.
    ///
    /// # Errors
    /// [`ClassError`].
    pub fn class(&self, from: ObjectId, path: &str) -> Result<Option<ObjectId>, ClassError> {
        let file = self.objects[from].file;
        let (alias, path) = match path.split_once('@') {
            Some((alias, rest)) => (Some(alias), rest),
            None => (None, path),
        };
        let segments = segments(path);
        let path = segments.join("/");
        let is_standard = STANDARD_LIBRARIES.iter().any(|l| path.starts_with(l));
        let files: Vec<usize> = match alias {
            Some(alias) => match self.files[file].aliases.get(alias) {
                Some(Some(found)) => vec![*found],
                // That it cannot be read has been said.
                Some(None) => return Ok(None),
                None if is_standard => return Ok(None),
                None => {
                    let known = self.files[file].aliases.keys().map(String::as_str);
                    let known: Vec<&str> = known.collect();
                    return Err(ClassError::NoAlias {
                        alias: alias.to_owned(),
                        hint: suggestion(alias, known),
                    });
                }
            },
            None => std::iter::once(file)
                .chain((0..self.files.len()).filter(|f| *f != file))
                .collect(),
        };
        for file in &files {
            if let Some(found) = self.classes.get(&(*file, path.clone())) {
                return Ok(Some(*found));
            }
        }
        // A single name means the nearest class around, or beside those.
        if let [name] = segments.as_slice() {
            let mut around = self.objects[from].parent;
            while let Some(id) = around {
                let object = &self.objects[id];
                if object.name.text == *name && !object.kind.is_library() {
                    return Ok(Some(id));
                }
                let beside = object
                    .children
                    .iter()
                    .find(|c| **c != from && self.objects[**c].name.text == *name);
                if let Some(beside) = beside {
                    return Ok(Some(*beside));
                }
                around = object.parent;
            }
        }
        if is_standard {
            return Ok(None);
        }
        let known: Vec<&str> = files
            .iter()
            .flat_map(|f| {
                self.classes
                    .range((*f, String::new())..(f + 1, String::new()))
            })
            .map(|((_, p), _)| p.as_str())
            .collect();
        Err(ClassError::NoClass {
            hint: suggestion(&path, known),
        })
    }

    /// Paths of a class reference and of all that it derives from, as far as they are known, the nearest first.
    #[must_use]
    pub fn ancestry(&self, from: ObjectId, path: &str) -> Vec<String> {
        let mut chain = Vec::new();
        let (mut from, mut path) = (from, path.to_owned());
        while chain.len() < CHAIN_MAX {
            let plain = path.split_once('@').map_or(path.as_str(), |(_, p)| p);
            let class = self.class(from, &path).ok().flatten();
            chain.push(match class {
                Some(id) => self.class_path(id),
                None => segments(plain).join("/"),
            });
            let Some(id) = class else { break };
            let Some(base) = &self.objects[id].base else {
                break;
            };
            (from, path) = (id, base.text.clone());
        }
        chain
    }

    /// Full path of a class.
    #[must_use]
    pub fn class_path(&self, id: ObjectId) -> String {
        let mut names = Vec::new();
        let mut next = Some(id);
        while let Some(id) = next {
            names.push(self.objects[id].name.text.as_str());
            next = self.objects[id].parent;
        }
        names.reverse();
        names.join("/")
    }

    /// The classes that an object derives from, the nearest first.
    #[must_use]
    pub fn bases(&self, id: ObjectId) -> Vec<ObjectId> {
        let mut chain = Vec::new();
        let mut from = id;
        while chain.len() < CHAIN_MAX
            && let Some(base) = &self.objects[from].base
            && let Ok(Some(class)) = self.class(from, &base.text)
        {
            chain.push(class);
            from = class;
        }
        chain
    }

    /// The object that a mirror object stands for; itself if it is none.
    #[must_use]
    pub fn master(&self, id: ObjectId) -> ObjectId {
        let mut seen = BTreeSet::from([id]);
        let mut at = id;
        while let Some(base) = &self.objects[at].base
            && let Some(next) = self.by_id(at, &base.text)
            && self.objects[next].kind == self.objects[id].kind
            && seen.insert(next)
        {
            at = next;
        }
        at
    }

    /// Whether the object is a mirror of another one.
    #[must_use]
    pub fn is_mirror(&self, id: ObjectId) -> bool {
        self.master(id) != id
    }

    /// Paths of all role classes of an element, of its system unit classes', and of all that they derive from.
    #[must_use]
    pub fn roles(&self, id: ObjectId) -> Vec<String> {
        let mut all = Vec::new();
        for holder in std::iter::once(id).chain(self.bases(id)) {
            for role in &self.objects[holder].roles {
                all.extend(self.ancestry(holder, &role.text));
            }
        }
        all
    }

    /// Paths of all interface classes of an interface.
    #[must_use]
    pub fn interface_classes(&self, id: ObjectId) -> Vec<String> {
        match &self.objects[id].base {
            Some(base) => self.ancestry(id, &base.text),
            None => Vec::new(),
        }
    }

    /// An attribute with its value: the object's own, else what its classes or roles give as value or default.
    #[must_use]
    pub fn attribute(&self, part: &Part, name: &str) -> Option<(Attribute, Text)> {
        let mut found: Option<Attribute> = None;
        for holder in self.holders(part.id) {
            let Some(attribute) = self.objects[holder]
                .attributes
                .iter()
                .find(|a| a.name.text == name)
            else {
                continue;
            };
            let value = attribute.value.as_ref().or(if holder == part.id {
                None
            } else {
                attribute.default.as_ref()
            });
            if let Some(value) = value {
                let mut value = value.clone();
                value.at = self.place(holder, &value.at, &part.at);
                let attribute = match found {
                    // The own attribute may say type and unit and leave the value to its class.
                    Some(own) => Attribute {
                        data_type: own.data_type.or(attribute.data_type.clone()),
                        unit: own.unit.or(attribute.unit.clone()),
                        ..attribute.clone()
                    },
                    None => attribute.clone(),
                };
                return Some((attribute, value));
            }
            found.get_or_insert_with(|| attribute.clone());
        }
        let attribute = found?;
        let default = attribute.default.clone()?;
        let at = if self.objects[part.id].file == 0 {
            default.at.clone()
        } else {
            part.at.clone()
        };
        Some((
            attribute,
            Text {
                text: default.text,
                at,
            },
        ))
    }

    /// Nested attributes of the nearest attribute of that name which has any.
    #[must_use]
    pub fn nested(&self, part: &Part, name: &str) -> Vec<Attribute> {
        self.holders(part.id)
            .into_iter()
            .filter(|h| {
                self.objects[*h].file == 0 || self.objects[part.id].file == self.objects[*h].file
            })
            .filter_map(|h| {
                self.objects[h]
                    .attributes
                    .iter()
                    .find(|a| a.name.text == name && !a.attributes.is_empty())
            })
            .map(|a| a.attributes.clone())
            .next()
            .unwrap_or_default()
    }

    /// Objects whose attributes an object has: itself, its classes, its roles and their classes.
    fn holders(&self, id: ObjectId) -> Vec<ObjectId> {
        let mut holders = vec![id];
        holders.extend(self.bases(id));
        let with_roles = holders.clone();
        for holder in with_roles {
            for role in &self.objects[holder].roles {
                if let Ok(Some(class)) = self.class(holder, &role.text) {
                    holders.push(class);
                    holders.extend(self.bases(class));
                }
            }
        }
        holders
    }

    /// Inner elements: its own, and those of its system unit classes that it does not have itself.
    #[must_use]
    pub fn elements(&self, part: &Part) -> Vec<Part> {
        self.parts(part, Kind::InternalElement)
    }

    /// Interfaces: its own, and those of its classes that it does not have itself.
    #[must_use]
    pub fn interfaces(&self, part: &Part) -> Vec<Part> {
        self.parts(part, Kind::ExternalInterface)
    }

    fn parts(&self, part: &Part, kind: Kind) -> Vec<Part> {
        let mut list: Vec<Part> = Vec::new();
        let mut names = BTreeSet::new();
        for holder in std::iter::once(part.id).chain(self.bases(part.id)) {
            for child in &self.objects[holder].children {
                let object = &self.objects[*child];
                let is_new = holder == part.id || !names.contains(object.name.text.as_str());
                if object.kind == kind && is_new {
                    names.insert(object.name.text.as_str());
                    let mut via = part.via.clone();
                    if holder != part.id {
                        via.push(part.id);
                    }
                    list.push(Part {
                        id: *child,
                        at: self.place(*child, &object.name.at, &part.at),
                        via,
                    });
                }
            }
        }
        list
    }

    fn place(&self, id: ObjectId, own: &Range<usize>, instance: &Range<usize>) -> Range<usize> {
        if self.objects[id].file == 0 {
            own.clone()
        } else {
            instance.clone()
        }
    }

    /// Reports references to classes that do not exist, and inheritance that goes round in a circle.
    pub fn check_references(&self, problems: &mut Vec<Diagnostic>) {
        for (id, object) in self.objects.iter().enumerate() {
            let text = self.text_of(id);
            let what = if object.name.text.is_empty() {
                "the element".to_owned()
            } else {
                format!("`{}`", object.name.text)
            };
            let references = object.base.iter().chain(&object.roles);
            for reference in references {
                // A mirror's base is the ID of its master.
                if self.by_id(id, &reference.text).is_some() {
                    continue;
                }
                if let Err(error) = self.class(id, &reference.text) {
                    let message = format!(
                        "{what} refers to the class `{}`, which does not exist",
                        reference.text
                    );
                    problems.push(
                        text.error("M806", reference.at.clone(), message)
                            .hint(error.to_string()),
                    );
                }
            }
            if let Some(round) = self.circle(id) {
                let at = object
                    .base
                    .as_ref()
                    .map_or(object.name.at.clone(), |b| b.at.clone());
                let names: Vec<String> = round
                    .iter()
                    .map(|i| self.objects[*i].name.text.clone())
                    .collect();
                let message = format!("{what} derives from itself: {}", names.join(" > "));
                problems.push(
                    text.error("M807", at, message)
                        .hint("give one of them another base class, or none"),
                );
            }
        }
    }

    /// The way round, if following the base of an object leads back to it. Each circle is reported by its first object.
    fn circle(&self, id: ObjectId) -> Option<Vec<ObjectId>> {
        let mut way = vec![id];
        let mut at = id;
        loop {
            let base = self.objects[at].base.as_ref()?;
            let next = match self.by_id(at, &base.text) {
                Some(next) => next,
                None => self.class(at, &base.text).ok()??,
            };
            way.push(next);
            if next == id {
                return (way.iter().min() == Some(&id)).then_some(way);
            }
            if way.len() > CHAIN_MAX || way[1..way.len() - 1].contains(&next) {
                return None;
            }
            at = next;
        }
    }
}

/// An ID without braces, in lower case.
fn normal_id(id: &str) -> String {
    id.trim()
        .trim_start_matches('{')
        .trim_end_matches('}')
        .to_ascii_lowercase()
}

/// Names of a class path; a name in brackets may contain `/`.
fn segments(path: &str) -> Vec<String> {
    let mut list = vec![String::new()];
    let mut bracketed = false;
    for c in path.trim().chars() {
        match c {
            '[' => bracketed = true,
            ']' => bracketed = false,
            '/' if !bracketed => list.push(String::new()),
            c => list.last_mut().expect("there is always one").push(c),
        }
    }
    list
}
