//! What the fragment of a reference to logic names: a POU, a variable, or an element by its `globalId`.

use crate::files::ModelFiles;
use roxmltree::{Document, Node};
use std::collections::BTreeMap;

/// What a fragment leads to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// A POU, with whether it is a PROGRAM.
    Pou {
        /// Its name.
        name: String,
        /// Whether it is a PROGRAM.
        program: bool,
    },
    /// A variable.
    Variable(String),
}

/// Named things of one logic file.
#[derive(Debug, Default)]
struct Names {
    /// By name in upper case.
    by_name: BTreeMap<String, Target>,
    /// By `globalId`: the POU or variable around it.
    by_id: BTreeMap<String, Target>,
}

/// Logic files, read once each.
#[derive(Debug)]
pub struct LogicFiles<'a> {
    files: &'a ModelFiles,
    /// `None` for one whose names are not known: it cannot be read, or is Structured Text.
    known: BTreeMap<String, Option<Names>>,
}

impl<'a> LogicFiles<'a> {
    /// None read so far.
    #[must_use]
    pub fn new(files: &'a ModelFiles) -> LogicFiles<'a> {
        LogicFiles {
            files,
            known: BTreeMap::new(),
        }
    }

    /// What a fragment names. `Ok(None)` if the file's names are not known here; the compiler will tell.
    ///
    /// # Errors
    /// The names that there are.
    pub fn target(&mut self, path: &str, fragment: &str) -> Result<Option<Target>, Vec<String>> {
        let files = self.files;
        let names = self
            .known
            .entry(path.to_owned())
            .or_insert_with(|| read(files, path));
        let Some(names) = names else {
            return Ok(None);
        };
        let found = names
            .by_id
            .get(fragment)
            .or_else(|| names.by_name.get(&fragment.to_ascii_uppercase()));
        match found {
            Some(target) => Ok(Some(target.clone())),
            None => Err(names
                .by_name
                .values()
                .map(|t| match t {
                    Target::Pou { name, .. } | Target::Variable(name) => name.clone(),
                })
                .collect()),
        }
    }
}

fn read(files: &ModelFiles, path: &str) -> Option<Names> {
    let text = files.read(path).ok()?;
    if !text.trim_start().starts_with('<') {
        return None;
    }
    let document = Document::parse(&text).ok()?;
    let mut names = Names::default();
    for node in document.descendants().filter(Node::is_element) {
        let target = target_of(node);
        if let (Some(target), Some(name)) = (&target, node.attribute("name")) {
            let key = name.to_ascii_uppercase();
            let is_pou = matches!(target, Target::Pou { .. });
            match names.by_name.get(&key) {
                // A POU hides variables of its name.
                Some(Target::Variable(_)) if is_pou => {
                    names.by_name.insert(key, target.clone());
                }
                Some(_) => {}
                None => {
                    names.by_name.insert(key, target.clone());
                }
            }
        }
        if let Some(id) = node.attribute("globalId") {
            let around = target.or_else(|| node.ancestors().find_map(target_of));
            if let Some(around) = around {
                names.by_id.insert(id.to_owned(), around);
            }
        }
    }
    Some(names)
}

fn target_of(node: Node<'_, '_>) -> Option<Target> {
    let name = node.attribute("name")?.to_owned();
    match node.tag_name().name() {
        "pou" => Some(Target::Pou {
            name,
            program: node.attribute("pouType") == Some("program"),
        }),
        "pouInstance" => Some(Target::Pou {
            name: node
                .attribute("typeName")
                .filter(|t| !t.is_empty())
                .map_or(name, str::to_owned),
            program: true,
        }),
        "variable" => Some(Target::Variable(name)),
        _ => None,
    }
}
