//! What an object has of its classes and roles: attributes, elements, interfaces.

use super::document::{Attribute, Kind, ObjectId, Text};
use super::library::{Caex, Part};
use std::collections::BTreeSet;
use std::ops::Range;

/// Longest chain of attribute types.
const TYPES_MAX: usize = 64;

/// An attribute as an object has it.
#[derive(Debug, Clone)]
pub struct Found {
    /// With the type and the unit that hold; its places are in the main file.
    pub attribute: Attribute,
    /// Its value.
    pub value: Text,
    /// The file in which the value stands: paths are relative to it.
    pub file: usize,
}

impl Caex {
    /// An attribute with its value: the object's own, else what its classes or roles give as value or default.
    #[must_use]
    pub fn attribute(&self, part: &Part, name: &str) -> Option<Found> {
        let mut own: Option<Found> = None;
        let holders = self.holders(part.id);
        let names = self.names(&holders, name);
        for holder in holders {
            let Some(attribute) = self.own_attribute(holder, &names) else {
                continue;
            };
            let attribute = self.placed(holder, attribute, part);
            let found = |attribute: Attribute, value: Text| Found {
                attribute,
                value,
                file: self.objects[holder].file,
            };
            // The own attribute may say type and unit and leave the value to its class.
            let whole = match &own {
                Some(own) => Attribute {
                    data_type: own.attribute.data_type.clone().or(attribute.data_type),
                    unit: own.attribute.unit.clone().or(attribute.unit),
                    ..attribute
                },
                None => attribute,
            };
            if let Some(value) = &whole.value {
                return Some(found(whole.clone(), value.clone()));
            }
            match &whole.default {
                Some(value) if holder != part.id => {
                    return Some(found(whole.clone(), value.clone()));
                }
                // The own default counts where no class has a value.
                default => {
                    let value = default.clone().unwrap_or_else(|| whole.name.clone());
                    own.get_or_insert_with(|| found(whole, value));
                }
            }
        }
        own.filter(|own| own.attribute.default.is_some())
    }

    /// Nested attributes of the nearest attribute of that name which has any.
    #[must_use]
    pub fn nested(&self, part: &Part, name: &str) -> Vec<Attribute> {
        let holders = self.holders(part.id);
        let names = self.names(&holders, name);
        for holder in holders {
            let named = self.own_attribute(holder, &names);
            if let Some(attribute) = named.filter(|a| !a.attributes.is_empty()) {
                return self.placed(holder, attribute, part).attributes;
            }
        }
        Vec::new()
    }

    /// What an attribute of a role is called: by that name, or by the ones that the holders have for it.
    fn names<'a>(&'a self, holders: &[ObjectId], name: &'a str) -> Vec<&'a str> {
        let mappings = holders.iter().flat_map(|h| &self.objects[*h].mappings);
        let mapped = mappings.filter(|(role, _)| role == name);
        std::iter::once(name)
            .chain(mapped.map(|(_, own)| own.as_str()))
            .collect()
    }

    /// An attribute that stands in an object, under the first of these names that it has, with what its type says.
    fn own_attribute(&self, holder: ObjectId, names: &[&str]) -> Option<Attribute> {
        let object = &self.objects[holder];
        let find = |name: &&str| object.attributes.iter().find(|a| a.name.text == **name);
        let own = names.iter().find_map(find)?;
        let mut whole = own.clone();
        let mut base = own.base.clone();
        let (mut from, mut left) = (holder, TYPES_MAX);
        while let Some(path) = base.take()
            && let Ok(Some(class)) = self.class(from, &path.text)
            && let Some(general) = self.objects[class].attributes.first()
            && self.objects[class].kind == Kind::AttributeType
            && left > 0
        {
            left -= 1;
            let general = match self.objects[class].file == object.file {
                true => general.clone(),
                false => at_place(general.clone(), &own.name.at),
            };
            whole.data_type = whole.data_type.or(general.data_type);
            whole.unit = whole.unit.or(general.unit);
            whole.default = whole.default.or(general.value).or(general.default);
            if whole.attributes.is_empty() {
                whole.attributes = general.attributes;
            }
            base = general.base;
            from = class;
        }
        Some(whole)
    }

    /// An attribute of a holder with its places in the main file.
    fn placed(&self, holder: ObjectId, attribute: Attribute, part: &Part) -> Attribute {
        match self.objects[holder].file {
            0 => attribute,
            _ => at_place(attribute, &part.at),
        }
    }

    /// Objects whose attributes an object has: itself, its classes, its roles and their classes.
    pub fn holders(&self, id: ObjectId) -> Vec<ObjectId> {
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
}

/// An attribute all of whose parts stand at one place.
fn at_place(mut attribute: Attribute, at: &Range<usize>) -> Attribute {
    let texts = [
        Some(&mut attribute.name),
        attribute.value.as_mut(),
        attribute.default.as_mut(),
        attribute.unit.as_mut(),
        attribute.base.as_mut(),
    ];
    for text in texts.into_iter().flatten() {
        text.at = at.clone();
    }
    let inner = std::mem::take(&mut attribute.attributes);
    attribute.attributes = inner.into_iter().map(|a| at_place(a, at)).collect();
    attribute
}
