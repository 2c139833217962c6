//! All files of a model together: the main one and the libraries that it refers to.

use super::document::{self, ExternalReference, Kind, Object, ObjectId};
use super::{FAM_LIBRARY, FAM_LIBRARY_FILE, uri};
use crate::files::{FileError, ModelFiles, folder_of, join};
use crate::problem::{Explain, ModelText};
use fam_soft_plc::diag::Diagnostic;
use std::collections::BTreeMap;
use std::ops::Range;

/// Most files of a model.
const FILES_MAX: usize = 64;
/// Libraries of the standard and of its recommendations: references to their classes are understood by their names, also
/// where the library itself is not at hand.
pub(super) const STANDARD_LIBRARIES: [&str; 3] = [
    "AutomationML",
    "AutomationProjectConfiguration",
    "Communication",
];

/// A file of the model.
#[derive(Debug)]
pub(super) struct File {
    pub(super) text: ModelText,
    /// Path relative to the model's folder, for references from it.
    path: String,
    /// By alias: number of the file; `None` if it could not be read (reported).
    pub(super) aliases: BTreeMap<String, Option<usize>>,
}

/// A model: its main file and the libraries that it refers to.
#[derive(Debug)]
pub struct Caex {
    pub(super) files: Vec<File>,
    /// All objects.
    pub objects: Vec<Object>,
    /// Instance hierarchies of the main file.
    pub hierarchies: Vec<ObjectId>,
    /// Classes by file and path without alias.
    pub(super) classes: BTreeMap<(usize, String), ObjectId>,
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

    /// Folder of a file, relative to the model's files.
    #[must_use]
    pub fn folder(&self, file: usize) -> &str {
        folder_of(&self.files[file].path)
    }

    /// Where a reference stands, for messages: nothing for the main file, whose lines they show.
    #[must_use]
    pub fn in_library(&self, file: usize) -> String {
        match file {
            0 => String::new(),
            _ => format!(" in the library `{}`", self.files[file].path),
        }
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
    pub(super) fn by_id(&self, from: ObjectId, id: &str) -> Option<ObjectId> {
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
}

/// An ID without braces, in lower case.
fn normal_id(id: &str) -> String {
    id.trim()
        .trim_start_matches('{')
        .trim_end_matches('}')
        .to_ascii_lowercase()
}
