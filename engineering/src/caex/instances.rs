//! All elements of the instance hierarchies, those that classes bring along included.
//!
//! An inherited element is one object of its class for all instances of that class, so that an object alone does not say
//! which element is meant: [`Part::instance`] does. What refers to an object of a class (the side of a link, a mirror object)
//! is followed into the instance in which the reference shows.

use super::document::{DEPTH_MAX, Kind, ObjectId};
use super::library::{Caex, InstanceId, Part};
use std::collections::BTreeMap;

/// Most instances that a message names.
const NAMES_MAX: usize = 4;

/// The elements, outer ones first.
#[derive(Debug, Default)]
pub struct Instances {
    /// Elements.
    pub all: Vec<Part>,
    /// For each of them the number of the element that it stands in.
    parents: Vec<Option<usize>>,
    numbers: BTreeMap<InstanceId, usize>,
    /// Elements by the classes that they derive from.
    of_class: BTreeMap<ObjectId, Vec<usize>>,
}

impl Instances {
    /// All elements of the main file's hierarchies.
    #[must_use]
    pub fn of(caex: &Caex) -> Instances {
        let mut instances = Instances::default();
        let mut todo: Vec<(Part, Option<usize>, usize)> = caex
            .hierarchies
            .iter()
            .rev()
            .map(|h| (caex.part(*h), None, 0))
            .collect();
        while let Some((part, parent, depth)) = todo.pop() {
            let is_element = caex.objects[part.id].kind == Kind::InternalElement;
            let own = if is_element {
                Some(instances.all.len())
            } else {
                None
            };
            // A class that contains an instance of itself has no end.
            if depth < DEPTH_MAX {
                let inner = caex.elements(&part).into_iter().rev();
                todo.extend(inner.map(|p| (p, own, depth + 1)));
            }
            if let Some(number) = own {
                instances.numbers.insert(part.instance(), number);
                for class in caex.bases(part.id) {
                    instances.of_class.entry(class).or_default().push(number);
                }
                instances.parents.push(parent);
                instances.all.push(part);
            }
        }
        instances
    }

    /// Number of an element.
    #[must_use]
    pub fn number(&self, part: &Part) -> Option<usize> {
        self.numbers.get(&part.instance()).copied()
    }

    /// The element that an object is, where the reference to it shows in the element `from`: the object itself, or what the
    /// nearest instance of its class around `from` has of it.
    ///
    /// # Errors
    /// What stands against it, and what to do.
    pub fn find(
        &self,
        caex: &Caex,
        from: Option<usize>,
        object: ObjectId,
    ) -> Result<Part, (String, String)> {
        let name = |id: ObjectId| caex.objects[id].name.text.as_str();
        let mut way = Vec::new();
        let mut at = object;
        while caex.objects[at].kind != Kind::SystemUnitClass {
            way.push(at);
            match caex.objects[at].parent {
                Some(parent) => at = parent,
                None => return Ok(caex.part(object)),
            }
        }
        let class = at;
        let found = match self.around(caex, from, class) {
            Some(found) => found,
            None => match self.of_class.get(&class).map_or(&[][..], Vec::as_slice) {
                [only] => *only,
                [] => {
                    return Err((
                        format!(
                            "`{}` stands in the class `{}`, of which the model has no instance",
                            name(object),
                            name(class)
                        ),
                        "name an object of the instance hierarchy".to_owned(),
                    ));
                }
                several => {
                    let names: Vec<&str> = several
                        .iter()
                        .take(NAMES_MAX)
                        .map(|n| name(self.all[*n].id))
                        .collect();
                    return Err((
                        format!(
                            "`{}` stands in the class `{}`, which has {} instances ({}): it is not clear which one is meant",
                            name(object),
                            name(class),
                            several.len(),
                            names.join(", ")
                        ),
                        "put the link into the class, or give the instances elements of their own and name those"
                            .to_owned(),
                    ));
                }
            },
        };
        let mut part = self.all[found].clone();
        for step in way.into_iter().rev() {
            let inner = caex.elements(&part);
            // An element of the instance itself stands for the one of the class that has its name.
            let next = inner
                .iter()
                .find(|p| p.id == step)
                .or_else(|| inner.iter().find(|p| name(p.id) == name(step)));
            match next {
                Some(next) => part = next.clone(),
                None => {
                    return Err((
                        format!("`{}` has no element `{}`", name(part.id), name(step)),
                        "add it to the instance, or correct the link".to_owned(),
                    ));
                }
            }
        }
        Ok(part)
    }

    /// The nearest element around `from`, itself included, that derives from a class.
    fn around(&self, caex: &Caex, from: Option<usize>, class: ObjectId) -> Option<usize> {
        let mut next = from;
        while let Some(number) = next {
            if caex.bases(self.all[number].id).contains(&class) {
                return Some(number);
            }
            next = self.parents[number];
        }
        None
    }

    /// The element that a mirror object stands for; the element itself if it is none.
    #[must_use]
    pub fn master(&self, caex: &Caex, part: &Part) -> Part {
        let master = caex.master(part.id);
        if master == part.id {
            return part.clone();
        }
        self.find(caex, self.number(part), master)
            .unwrap_or_else(|_| caex.part(master))
    }
}
