//! **The plant goes on unharmed**: nothing collides, drops, is fitted twice or left out, whatever fails.

use super::{Facts, Invariant, Seen};

pub(super) struct PlantUnharmed;

impl Invariant for PlantUnharmed {
    fn name(&self) -> &'static str {
        "the plant goes on unharmed"
    }

    fn see(&mut self, seen: &Seen<'_>, _: &Facts) -> Result<(), String> {
        match seen {
            Seen::Plant {
                incidents: 1..,
                last,
            } => Err(format!("the plant reports {}", last.unwrap_or("incidents"))),
            _ => Ok(()),
        }
    }
}
