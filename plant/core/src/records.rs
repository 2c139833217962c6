//! The books of the cell: every live part, where parts went, what was finished, and what went wrong.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::incident::{Incident, IncidentKind};
use crate::order::Variant;
use crate::part::{Part, PartId, PartKind};

/// Incidents kept with their cause; further ones are only counted.
pub(crate) const INCIDENTS_KEPT: usize = 1000;

/// Where all parts went. Each part that left a magazine is in the cell, rejected, stored or lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Ledger {
    /// Parts that fell out of a magazine into the cell.
    pub fed: u64,
    /// Parts put onto a pallet; a part that is put down twice counts twice.
    pub placed: u64,
    /// Parts thrown into a reject bin.
    pub rejected: u64,
    /// Of the rejected, those that were as their magazine says: waste, not an incident.
    pub rejected_good: u64,
    /// Parts in sets laid into the rack.
    pub stored: u64,
    /// Parts that fell, or were pushed out of their place.
    pub lost: u64,
    /// Parts harmed by an incident, wherever they are.
    pub damaged: u64,
    /// Parts in the cell, counted where they lie and not from the other figures.
    pub in_cell: PartPlaces,
}

impl Ledger {
    /// Whether the parts add up: `fed = in the cell + rejected + stored + lost`. If not, one was doubled or has vanished.
    pub fn balanced(&self) -> bool {
        self.fed == self.in_cell.total() + self.rejected + self.stored + self.lost
    }
}

impl fmt::Display for Ledger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} parts fed = {} in the cell + {} rejected + {} stored + {} lost; {} damaged",
            self.fed,
            self.in_cell.total(),
            self.rejected,
            self.stored,
            self.lost,
            self.damaged
        )
    }
}

/// Parts in the cell, counted where they lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PartPlaces {
    /// At the bottom of magazines, before pushers and in nests.
    pub feeding: u64,
    /// In hands and in the gripper.
    pub held: u64,
    pub on_pallets: u64,
}

impl PartPlaces {
    pub fn total(&self) -> u64 {
        self.feeding + self.held + self.on_pallets
    }
}

/// A set that was laid into the rack.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Product {
    /// Order that the controller said it fulfils.
    pub order: u16,
    /// What that order asks for.
    pub variant: Variant,
    pub parts: Vec<Part>,
    /// Code of the pallet that it came on.
    pub pallet: u16,
    pub slot: u8,
    pub stored_at_us: u64,
    /// Complete, as ordered, and its order not delivered before.
    pub good: bool,
}

impl Product {
    /// Order and pieces, without place and time: what must be equal in two runs with one seed.
    pub fn contents(&self) -> (u16, Variant, Vec<Part>) {
        (self.order, self.variant, self.parts.clone())
    }
}

impl fmt::Display for Product {
    /// As [`Product::contents`], without place and time, so that the lines of two runs compare.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "order {} ({}): ", self.order, self.variant)?;
        for (index, part) in self.parts.iter().enumerate() {
            let comma = if index > 0 { ", " } else { "" };
            let damaged = if part.damaged { " damaged" } else { "" };
            write!(f, "{comma}{}{damaged}", part.id)?;
        }
        if self.good {
            Ok(())
        } else {
            write!(f, "; not as ordered")
        }
    }
}

/// A condition that is an incident when it begins: unit, name, index.
type Condition = (u8, &'static str, usize);

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Records {
    pub seed: u64,
    pub now_us: u64,
    /// Without `in_cell`, which only the plant can count.
    pub ledger: Ledger,
    pub parts: BTreeMap<PartId, Part>,
    pub products: Vec<Product>,
    pub incidents: Vec<Incident>,
    pub incidents_total: u64,
    conditions: BTreeSet<Condition>,
}

impl Records {
    pub fn new(seed: u64) -> Self {
        Records {
            seed,
            now_us: 0,
            ledger: Ledger::default(),
            parts: BTreeMap::new(),
            products: Vec::new(),
            incidents: Vec::new(),
            incidents_total: 0,
            conditions: BTreeSet::new(),
        }
    }

    /// Reports a condition each tick; an incident is noted when it begins, and the parts that it harms are damaged then.
    /// Returns whether it has begun now.
    pub fn watch(
        &mut self,
        condition: Condition,
        active: bool,
        kind: IncidentKind,
        harmed: &[Option<PartId>],
        cause: impl FnOnce() -> String,
    ) -> bool {
        if !active {
            if !self.conditions.is_empty() {
                self.conditions.remove(&condition);
            }
            return false;
        }
        if !self.conditions.insert(condition) {
            return false;
        }
        for id in harmed.iter().flatten() {
            self.damage(*id);
        }
        self.note(condition.0, kind, cause());
        true
    }

    /// Notes an incident that is an event, not a condition.
    pub fn note(&mut self, unit: u8, kind: IncidentKind, cause: String) {
        self.incidents_total += 1;
        if self.incidents.len() < INCIDENTS_KEPT {
            self.incidents.push(Incident {
                at_us: self.now_us,
                unit,
                kind,
                cause,
            });
        }
    }

    pub fn feed(&mut self, kind: PartKind, magazine: u8, number: u32) -> PartId {
        let id = PartId {
            kind,
            magazine,
            number,
        };
        self.parts.insert(id, Part::made(self.seed, id));
        self.ledger.fed += 1;
        id
    }

    pub fn part(&self, id: PartId) -> Part {
        self.parts
            .get(&id)
            .copied()
            .unwrap_or_else(|| Part::made(self.seed, id))
    }

    pub fn reject(&mut self, id: PartId) {
        if let Some(part) = self.parts.remove(&id) {
            self.ledger.rejected += 1;
            self.ledger.rejected_good += u64::from(part.is_as_its_magazine_says());
        }
    }

    pub fn lose(&mut self, id: PartId) {
        if self.parts.remove(&id).is_some() {
            self.ledger.lost += 1;
        }
    }

    pub fn damage(&mut self, id: PartId) {
        if let Some(part) = self.parts.get_mut(&id)
            && !part.damaged
        {
            part.damaged = true;
            self.ledger.damaged += 1;
        }
    }

    /// Moves the parts of a set out of the cell into a product. Returns its place in `products`.
    pub fn store(&mut self, ids: &[PartId], product: impl FnOnce(Vec<Part>) -> Product) {
        let parts: Vec<Part> = ids.iter().filter_map(|id| self.parts.remove(id)).collect();
        self.ledger.stored += parts.len() as u64;
        self.products.push(product(parts));
    }

    /// Takes the newest product that lies in that slot back into the cell.
    pub fn take_back(&mut self, slot: u8) -> Option<Product> {
        let index = self
            .products
            .iter()
            .rposition(|product| product.slot == slot)?;
        let product = self.products.remove(index);
        self.ledger.stored -= product.parts.len() as u64;
        for part in &product.parts {
            self.parts.insert(part.id, *part);
        }
        Some(product)
    }
}
