//! Class paths with aliases, inheritance of classes, mirror objects.

use super::document::ObjectId;
use super::library::{Caex, STANDARD_LIBRARIES};
use crate::problem::{Explain, suggestion};
use fam_soft_plc::diag::Diagnostic;
use std::collections::BTreeSet;

/// Longest chain of base classes.
const CHAIN_MAX: usize = 64;
/// Base of all references to logic, wherever its library stands.
const LOGIC_CLASS: &str = "ExternalDataConnector/PLCopenXMLInterface";

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

    /// Whether an interface refers to PLC logic: of the standard's class, or of one below it whose library may not be at hand.
    #[must_use]
    pub fn is_logic(&self, interface: ObjectId) -> bool {
        let classes = self.interface_classes(interface);
        let is_one = |class: &String| {
            let below = class.split_once(LOGIC_CLASS).map(|(_, rest)| rest);
            below.is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        classes.iter().any(is_one)
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
