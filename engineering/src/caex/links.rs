//! What InternalLinks join. A side is `{GUID}:Name` (2.15), `GUID:Name` (AR APC) or the ID of the interface alone (3.0).
//!
//! A link of a SystemUnitClass, or of an element in one, holds in each instance of the class, between the instance's own elements
//! and interfaces. A link that an instance has under the same name replaces it.

use super::document::{Kind, ObjectId, Text};
use super::instances::Instances;
use super::library::{Caex, InstanceId, Part};
use crate::problem::{Explain, suggestion};
use fam_soft_plc::diag::Diagnostic;
use std::collections::{BTreeMap, BTreeSet};

/// Interfaces that are joined, in both directions; mirrors count as their masters.
#[derive(Debug, Default)]
pub struct Links {
    partners: BTreeMap<Side, Vec<Side>>,
}

/// An interface of an element. The element counts too: an inherited interface is one object for all instances of its class.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Side {
    /// The element.
    pub element: InstanceId,
    /// The interface.
    pub interface: ObjectId,
}

/// What a side says, before it is known in which instance.
enum Named {
    /// An interface by its ID, and the element that it belongs to.
    Interface(ObjectId, ObjectId),
    /// An element, and the name of its interface.
    Name(ObjectId, String),
}

type Why = (String, String);

impl Links {
    /// All links of the main file, and those that classes bring into its instance hierarchies.
    pub fn of(caex: &Caex, instances: &Instances, problems: &mut Vec<Diagnostic>) -> Links {
        let mut links = Links::default();
        let mut done = BTreeSet::new();
        for (number, part) in instances.all.iter().enumerate() {
            for link in links_of(caex, part) {
                done.insert(link);
                links.join(caex, instances, Some(number), link, problems);
            }
        }
        // Those beside all elements, and those of classes without instance, which are only held against what they name.
        for (link, object) in caex.objects.iter().enumerate() {
            if object.kind != Kind::InternalLink || object.file != 0 || done.contains(&link) {
                continue;
            }
            if is_in_class(caex, link) {
                for written in object.sides.iter().flatten() {
                    if let Err(why) = named(caex, link, &written.text) {
                        report(caex, link, written, why, problems);
                    }
                }
            } else {
                links.join(caex, instances, None, link, problems);
            }
        }
        links
    }

    fn join(
        &mut self,
        caex: &Caex,
        instances: &Instances,
        from: Option<usize>,
        link: ObjectId,
        problems: &mut Vec<Diagnostic>,
    ) {
        let Some([a, b]) = &caex.objects[link].sides else {
            return;
        };
        let mut side = |written: &Text| {
            if written.text.is_empty() {
                return None; // reported by the reader
            }
            let found = named(caex, link, &written.text)
                .and_then(|named| located(caex, instances, from, &named));
            found
                .map_err(|why| report(caex, link, written, why, problems))
                .ok()
        };
        if let (Some(a), Some(b)) = (side(a), side(b)) {
            self.add(a.clone(), b.clone());
            self.add(b, a);
        }
    }

    fn add(&mut self, from: Side, to: Side) {
        let partners = self.partners.entry(from).or_default();
        if !partners.contains(&to) {
            partners.push(to);
        }
    }

    /// What an interface is joined with, in the order of the file.
    #[must_use]
    pub fn partners(&self, side: &Side) -> &[Side] {
        self.partners.get(side).map_or(&[], Vec::as_slice)
    }
}

/// Links of an element: its own, and those of its classes that it does not have itself under their name.
fn links_of(caex: &Caex, part: &Part) -> Vec<ObjectId> {
    let mut list = Vec::new();
    let mut names = BTreeSet::new();
    for holder in std::iter::once(part.id).chain(caex.bases(part.id)) {
        let mut here = Vec::new();
        for child in &caex.objects[holder].children {
            let object = &caex.objects[*child];
            let name = object.name.text.as_str();
            if object.kind == Kind::InternalLink && !names.contains(name) {
                list.push(*child);
                here.push(name);
            }
        }
        // Nameless links replace nothing.
        names.extend(here.into_iter().filter(|n| !n.is_empty()));
    }
    list
}

fn is_in_class(caex: &Caex, id: ObjectId) -> bool {
    let mut at = Some(id);
    while let Some(object) = at {
        if caex.objects[object].kind == Kind::SystemUnitClass {
            return true;
        }
        at = caex.objects[object].parent;
    }
    false
}

fn report(
    caex: &Caex,
    link: ObjectId,
    written: &Text,
    (message, hint): Why,
    problems: &mut Vec<Diagnostic>,
) {
    let problem = caex
        .text_of(link)
        .error("M808", written.at.clone(), format!("a link's side `{}`: {message}", written.text))
        .expected("the ID of an interface, or the ID of an element, a colon and the name of its interface")
        .hint(hint);
    // A link of a class is wrong once, however many instances there are.
    if !problems.contains(&problem) {
        problems.push(problem);
    }
}

/// What a side names in the file of its link.
fn named(caex: &Caex, link: ObjectId, text: &str) -> Result<Named, Why> {
    let file = caex.objects[link].file;
    if let Some(id) = caex.by_id_in(file, text) {
        let object = &caex.objects[id];
        if object.kind != Kind::ExternalInterface {
            return Err((
                format!("`{}` is no interface", object.name.text),
                "name one of its interfaces behind a colon".to_owned(),
            ));
        }
        let interface = caex.master(id);
        return Ok(Named::Interface(interface, owner(caex, interface)));
    }
    let gone = || {
        (
            "there is no object with this ID".to_owned(),
            "correct the ID, or remove the link".to_owned(),
        )
    };
    // The name may contain colons, the ID does not.
    let (id, name) = text.split_once(':').ok_or_else(gone)?;
    let element = caex.master(caex.by_id_in(file, id).ok_or_else(gone)?);
    let interfaces = caex.interfaces(&caex.part(element));
    let name_of = |part: &Part| caex.objects[part.id].name.text.as_str();
    if !interfaces.iter().any(|i| name_of(i) == name) {
        let known: Vec<&str> = interfaces.iter().map(name_of).collect();
        return Err((
            format!(
                "`{}` has no interface `{name}`",
                caex.objects[element].name.text
            ),
            suggestion(name, known),
        ));
    }
    Ok(Named::Name(element, name.to_owned()))
}

/// That, in the instance in which the link shows.
fn located(
    caex: &Caex,
    instances: &Instances,
    from: Option<usize>,
    named: &Named,
) -> Result<Side, Why> {
    let (element, name) = match named {
        Named::Interface(interface, element) => {
            let part = instances.find(caex, from, *element)?;
            let inner = caex.interfaces(&part);
            let name = &caex.objects[*interface].name.text;
            let is_there = inner.iter().any(|i| i.id == *interface);
            let own = inner.iter().find(|i| caex.objects[i.id].name.text == *name);
            let interface = match own {
                // The instance has it anew.
                Some(own) if !is_there => own.id,
                _ => *interface,
            };
            return Ok(Side {
                element: part.instance(),
                interface,
            });
        }
        Named::Name(element, name) => (instances.find(caex, from, *element)?, name),
    };
    let found = caex
        .interfaces(&element)
        .into_iter()
        .find(|i| caex.objects[i.id].name.text == *name);
    match found {
        Some(found) => side(caex, instances, &element, found.id),
        None => Err((
            format!(
                "`{}` has no interface `{name}`",
                caex.objects[element.id].name.text
            ),
            "add it to the instance, or correct the link".to_owned(),
        )),
    }
}

/// An interface of an element as a side; mirrors count as their masters.
///
/// # Errors
/// What stands against following a mirror.
pub fn side(
    caex: &Caex,
    instances: &Instances,
    element: &Part,
    interface: ObjectId,
) -> Result<Side, Why> {
    let master = caex.master(interface);
    let element = if master == interface {
        instances.master(caex, element)
    } else {
        // A mirrored interface belongs to another element.
        instances.find(caex, instances.number(element), owner(caex, master))?
    };
    Ok(Side {
        element: element.instance(),
        interface: master,
    })
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
