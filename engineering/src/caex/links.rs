//! What InternalLinks join. A side is `{GUID}:Name` (2.15), `GUID:Name` (AR APC) or the ID of the interface alone (3.0).

use super::document::{Kind, ObjectId, Text};
use super::library::{Caex, Part};
use crate::problem::{Explain, suggestion};
use fam_soft_plc::diag::Diagnostic;
use std::collections::BTreeMap;

/// Interfaces that are joined, in both directions; mirrors count as their masters.
#[derive(Debug, Default)]
pub struct Links {
    partners: BTreeMap<Side, Vec<Side>>,
}

/// An interface of an element. The element counts too: an inherited interface is one object for all instances of its class.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Side {
    /// The element.
    pub element: ObjectId,
    /// The interface.
    pub interface: ObjectId,
}

impl Links {
    /// All links of the main file.
    pub fn of(caex: &Caex, problems: &mut Vec<Diagnostic>) -> Links {
        let mut links = Links::default();
        for object in &caex.objects {
            let Some([a, b]) = &object.sides else {
                continue;
            };
            if object.file != 0 {
                continue;
            }
            let (a, b) = (side(caex, a, problems), side(caex, b, problems));
            if let (Some(a), Some(b)) = (a, b) {
                links.partners.entry(a).or_default().push(b);
                links.partners.entry(b).or_default().push(a);
            }
        }
        links
    }

    /// What an interface is joined with, in the order of the file.
    #[must_use]
    pub fn partners(&self, side: Side) -> &[Side] {
        self.partners.get(&side).map_or(&[], Vec::as_slice)
    }
}

fn side(caex: &Caex, written: &Text, problems: &mut Vec<Diagnostic>) -> Option<Side> {
    if written.text.is_empty() {
        return None; // reported by the reader
    }
    match find(caex, &written.text) {
        Ok(side) => Some(side),
        Err((message, hint)) => {
            problems.push(
                caex.text()
                    .error("M808", written.at.clone(), format!("a link's side `{}`: {message}", written.text))
                    .expected("the ID of an interface, or the ID of an element, a colon and the name of its interface")
                    .hint(hint),
            );
            None
        }
    }
}

fn find(caex: &Caex, text: &str) -> Result<Side, (String, String)> {
    if let Some(id) = caex.by_id(text) {
        let object = &caex.objects[id];
        if object.kind != Kind::ExternalInterface {
            return Err((
                format!("`{}` is no interface", object.name.text),
                "name one of its interfaces behind a colon".to_owned(),
            ));
        }
        let interface = caex.master(id);
        let element = owner(caex, interface);
        return Ok(Side { element, interface });
    }
    let gone = || {
        (
            "there is no object with this ID".to_owned(),
            "correct the ID, or remove the link".to_owned(),
        )
    };
    // The name may contain colons, the ID does not.
    let (id, name) = text.split_once(':').ok_or_else(gone)?;
    let element = caex.master(caex.by_id(id).ok_or_else(gone)?);
    let part = Part {
        id: element,
        at: 0..0,
    };
    let interfaces = caex.interfaces(&part);
    let found = interfaces
        .iter()
        .find(|i| caex.objects[i.id].name.text == name);
    match found {
        Some(found) => {
            let interface = caex.master(found.id);
            // A mirrored interface belongs to another element.
            let element = if interface == found.id {
                element
            } else {
                owner(caex, interface)
            };
            Ok(Side { element, interface })
        }
        None => {
            let known: Vec<&str> = interfaces
                .iter()
                .map(|i| caex.objects[i.id].name.text.as_str())
                .collect();
            Err((
                format!(
                    "`{}` has no interface `{name}`",
                    caex.objects[element].name.text
                ),
                suggestion(name, known),
            ))
        }
    }
}

/// The element that an interface belongs to; interfaces may be nested.
fn owner(caex: &Caex, interface: ObjectId) -> ObjectId {
    let mut at = interface;
    while caex.objects[at].kind == Kind::ExternalInterface
        && let Some(parent) = caex.objects[at].parent
    {
        at = parent;
    }
    caex.master(at)
}
