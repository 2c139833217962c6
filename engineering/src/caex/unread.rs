//! Attributes that nobody reads: misspelt ones, those given twice, and those of others, so that none is passed over in silence.

use super::document::ObjectId;
use super::history::names;
use super::library::{Caex, Part};
use super::values::Values;
use crate::problem::{Explain, nearest};
use std::collections::BTreeSet;
use std::ops::Range;

/// A library that cannot be read, and a class that is in none.
const NO_CLASS: [&str; 2] = ["M804", "M806"];

/// What is looked at: an element or an interface of FAM's classes.
pub struct Seen {
    /// Its name, with that of its element.
    pub name: String,
    pub part: Part,
}

/// Reports what is not read of the own attributes of the parts. Those of classes in libraries are no concern of the model.
pub fn report(values: &mut Values<'_>, parts: &[Seen]) {
    let mut others: BTreeSet<String> = BTreeSet::new();
    let mut other_at: Option<Range<usize>> = None;
    let mut done: BTreeSet<ObjectId> = BTreeSet::new();
    for Seen { name: of, part } in parts {
        let caex = values.caex;
        let object = &caex.objects[part.id];
        // Instances of one class share what stands in it.
        if object.file != 0 || !done.insert(part.id) {
            continue;
        }
        let known = known(caex, part.id);
        let mut given = BTreeSet::new();
        for attribute in &object.attributes {
            let name = attribute.name.text.as_str();
            let at = attribute.name.at.clone();
            if !given.insert(name) {
                let message = format!("`{name}` of {of} is given twice");
                values.error("M809", at, message).hint = Some("remove one of them".to_owned());
            } else if known.contains(name) {
            } else if let Some(near) = nearest(name, known.iter().copied()) {
                let warning = caex
                    .text()
                    .warning(
                        "W815",
                        at,
                        format!("`{name}` of {of} is not read: its classes have no such attribute"),
                    )
                    .hint(format!("did you mean `{near}`?"));
                values.problems.push(warning);
            } else {
                others.insert(format!("{of}/{name}"));
                other_at.get_or_insert(at);
            }
        }
    }
    // Of a class that is not there nobody knows which attributes it has; that has been told.
    let knows_all = !values
        .problems
        .iter()
        .any(|p| NO_CLASS.contains(&p.code.as_str()));
    if let Some(at) = other_at.filter(|_| knows_all) {
        let message = format!("FAM has no use for the attributes {}", names(others.iter()));
        let warning = values.caex.text().warning("W816", at, message);
        values.problems.push(warning.hint(
            "keep this file: neither what `fam generate` nor what `fam convert` writes has them",
        ));
    }
}

/// Names of attributes that an object's classes and roles have, by their own words for them.
fn known(caex: &Caex, id: ObjectId) -> BTreeSet<&str> {
    let holders = caex.holders(id);
    let classes = holders.iter().filter(|h| **h != id);
    let declared = classes.flat_map(|h| &caex.objects[*h].attributes);
    let mapped = holders.iter().flat_map(|h| &caex.objects[*h].mappings);
    declared
        .map(|a| a.name.text.as_str())
        .chain(mapped.map(|(_, own)| own.as_str()))
        .collect()
}
