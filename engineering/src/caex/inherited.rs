//! What an object has of its classes and roles: attributes, elements, interfaces.

use super::document::{Attribute, Kind, ObjectId, Text};
use super::library::{Caex, Part};
use std::collections::BTreeSet;
use std::ops::Range;

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
        for holder in self.holders(part.id) {
            let mut attributes = self.objects[holder].attributes.iter();
            let Some(attribute) = attributes.find(|a| a.name.text == name) else {
                continue;
            };
            let attribute = self.placed(holder, attribute.clone(), part);
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
        for holder in self.holders(part.id) {
            let mut attributes = self.objects[holder].attributes.iter();
            let named = attributes.find(|a| a.name.text == name && !a.attributes.is_empty());
            if let Some(attribute) = named {
                return self.placed(holder, attribute.clone(), part).attributes;
            }
        }
        Vec::new()
    }

    /// An attribute of a holder with its places in the main file.
    fn placed(&self, holder: ObjectId, mut attribute: Attribute, part: &Part) -> Attribute {
        if self.objects[holder].file == 0 {
            return attribute;
        }
        let texts = [
            Some(&mut attribute.name),
            attribute.value.as_mut(),
            attribute.default.as_mut(),
            attribute.unit.as_mut(),
        ];
        for text in texts.into_iter().flatten() {
            text.at = part.at.clone();
        }
        attribute.attributes = attribute
            .attributes
            .into_iter()
            .map(|inner| self.placed(holder, inner, part))
            .collect();
        attribute
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
}
