//! AutomationML containers (`.amlx`): zip files after the Open Packaging Conventions, whose root document is the model.

use super::uri::percent_decoded;
use super::zip::{Limits, ZipError, pack as pack_zip, unpack};
use crate::files::{FILE_BYTES_MAX, ModelFiles, join};
use crate::plcopen::xml::Xml;
use std::collections::BTreeMap;

/// Relationship of the model in `_rels/.rels`.
pub const ROOT_DOCUMENT: &str =
    "http://schemas.automationml.org/container/relationship/RootDocument";

const RELATIONSHIPS: &str = "http://schemas.openxmlformats.org/package/2006/relationships";
const CONTENT_TYPES: &str = "http://schemas.openxmlformats.org/package/2006/content-types";
const LIMITS: Limits = Limits {
    parts: 10_000,
    part_bytes: FILE_BYTES_MAX,
    all_bytes: 4 * FILE_BYTES_MAX,
};

/// Why a container cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ContainerError {
    /// Not a zip file, or a damaged one.
    #[error("this is no AutomationML container that can be read: {0}")]
    Zip(#[from] ZipError),
    /// A part that would leave the container.
    #[error("the container has a part outside of it: {0}")]
    Outside(String),
    /// Two parts that a reference could mean alike.
    #[error("the container has two parts of one path: `{0}`")]
    Twice(String),
    /// No root document.
    #[error("the container does not say which of its parts is the model: {0}")]
    NoRoot(String),
}

/// The parts of a container and the path of its model.
///
/// # Errors
/// [`ContainerError`].
pub fn open(bytes: &[u8]) -> Result<(ModelFiles, String), ContainerError> {
    let mut parts = BTreeMap::new();
    for (name, content) in unpack(bytes, LIMITS)? {
        let path = join("", &name.replace('\\', "/"))
            .map_err(|e| ContainerError::Outside(e.to_string()))?;
        if parts.insert(path, content).is_some() {
            return Err(ContainerError::Twice(name));
        }
    }
    let files = ModelFiles::parts(parts);
    let root = root_document(&files)?;
    Ok((files, root))
}

fn root_document(files: &ModelFiles) -> Result<String, ContainerError> {
    let no_root = ContainerError::NoRoot;
    let text = files
        .read("_rels/.rels")
        .map_err(|e| no_root(e.to_string()))?;
    let document =
        roxmltree::Document::parse(&text).map_err(|e| no_root(format!("`_rels/.rels`: {e}")))?;
    let mut targets = document
        .descendants()
        .filter(|n| n.has_tag_name((RELATIONSHIPS, "Relationship")))
        .filter(|n| n.attribute("Type") == Some(ROOT_DOCUMENT))
        .filter_map(|n| n.attribute("Target"));
    let target = targets
        .next()
        .ok_or_else(|| no_root(format!("`_rels/.rels` has no relationship {ROOT_DOCUMENT}")))?;
    if let Some(other) = targets.find(|other| *other != target) {
        return Err(no_root(format!(
            "`_rels/.rels` names both `{target}` and `{other}`"
        )));
    }
    let target = percent_decoded(target)
        .ok_or_else(|| no_root(format!("`{target}` has a wrong percent escape")))?;
    join("", target.trim_start_matches('/')).map_err(|e| no_root(e.to_string()))
}

/// A container of some files, one of which is the model.
#[must_use]
pub fn pack(files: &BTreeMap<String, String>, root: &str) -> Vec<u8> {
    let mut parts: BTreeMap<String, Vec<u8>> = files
        .iter()
        .map(|(name, text)| (name.clone(), text.clone().into_bytes()))
        .collect();
    let mut types = Xml::new();
    types.open("Types", &[("xmlns", CONTENT_TYPES)]);
    for (ending, content) in [
        (
            "rels",
            "application/vnd.openxmlformats-package.relationships+xml",
        ),
        ("aml", "model/vnd.automationml+xml"),
        ("xml", "text/xml"),
        ("st", "text/plain"),
    ] {
        types.empty(
            "Default",
            &[("Extension", ending), ("ContentType", content)],
        );
    }
    types.close();
    let mut relationships = Xml::new();
    relationships.open("Relationships", &[("xmlns", RELATIONSHIPS)]);
    relationships.empty(
        "Relationship",
        &[
            ("Type", ROOT_DOCUMENT),
            ("Target", &format!("/{root}")),
            ("Id", "root"),
        ],
    );
    relationships.close();
    parts.insert(
        "[Content_Types].xml".to_owned(),
        types.finish().into_bytes(),
    );
    parts.insert(
        "_rels/.rels".to_owned(),
        relationships.finish().into_bytes(),
    );
    pack_zip(&parts)
}
