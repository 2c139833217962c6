//! What CAEX says of the history of its elements: `ChangeMode`, and versions, revisions and the like in their headers.
//!
//! What is marked as deleted is no part of the plant; everything else counts as it stands there, whether it is said to be created, changed or
//! neither. FAM has no use for versions and revisions. Of both it says so, once for each file.

use crate::problem::{Explain, ModelText};
use fam_soft_plc::diag::Diagnostic;
use roxmltree::Node;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

/// Most names in one message.
const NAMES_MAX: usize = 5;
/// Header elements that say something of an element's history or rights.
const ORGANIZATION: [&str; 4] = ["Version", "Revision", "Copyright", "AdditionalInformation"];

/// What is said of an element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// It is part of the plant.
    There,
    /// It is not.
    Deleted,
    /// Nobody knows.
    Unknown,
}

/// Reads `ChangeMode`.
#[must_use]
pub fn change(node: Node<'_, '_>) -> Change {
    match node.attribute("ChangeMode").map(str::trim) {
        None => Change::There,
        Some(mode) if mode.eq_ignore_ascii_case("delete") => Change::Deleted,
        Some(mode) => {
            let known = ["state", "create", "change"];
            match known.iter().any(|k| mode.eq_ignore_ascii_case(k)) {
                true => Change::There,
                false => Change::Unknown,
            }
        }
    }
}

/// What a file says of its history.
#[derive(Debug, Default)]
pub struct History {
    /// Deleted elements by their place, with their paths.
    deleted: BTreeMap<usize, (Range<usize>, String)>,
    /// Elements with organizational information.
    headers: BTreeSet<&'static str>,
    owners: BTreeSet<String>,
    header_at: Option<Range<usize>>,
}

impl History {
    /// Notes an element that is marked as deleted.
    pub fn deleted(&mut self, inside: &[String], node: Node<'_, '_>, at: Range<usize>) {
        let name = ["Name", "Alias", "RefBaseRoleClassPath", "RefRoleClassPath"]
            .iter()
            .find_map(|a| node.attribute(*a));
        let name = name.unwrap_or(node.tag_name().name());
        let path: Vec<&str> = inside.iter().map(String::as_str).chain([name]).collect();
        self.deleted.insert(at.start, (at, path.join("/")));
    }

    /// Notes a header element of an instance.
    pub fn header(&mut self, inside: &[String], element: &str, at: Range<usize>) {
        let Some(known) = ORGANIZATION.iter().find(|o| **o == element) else {
            return;
        };
        self.headers.insert(known);
        self.owners.insert(inside.join("/"));
        self.header_at.get_or_insert(at);
    }

    /// What is to be said of it.
    pub fn notices(self, text: &ModelText, problems: &mut Vec<Diagnostic>) {
        if let Some((at, _)) = self.deleted.values().next().cloned() {
            let message = format!(
                "marked as deleted (ChangeMode=\"delete\"), and so no part of the plant: {}",
                names(self.deleted.values().map(|(_, path)| path))
            );
            problems.push(
                text.warning("W812", at, message)
                    .hint("remove them from the file once the change is released"),
            );
        }
        if let Some(at) = self.header_at {
            let what: Vec<&str> = self.headers.into_iter().collect();
            let message = format!(
                "{} of {}: FAM has no use for it",
                what.join(", "),
                names(self.owners.iter())
            );
            problems.push(text.warning("W813", at, message).hint(
                "keep this file: neither what `fam generate` nor what `fam convert` writes has it",
            ));
        }
    }
}

/// The first names, and how many more.
pub fn names<'a>(list: impl ExactSizeIterator<Item = &'a String>) -> String {
    let more = list.len().saturating_sub(NAMES_MAX);
    let some: Vec<String> = list.take(NAMES_MAX).map(|n| format!("`{n}`")).collect();
    match more {
        0 => some.join(", "),
        more => format!("{} and {more} more", some.join(", ")),
    }
}
