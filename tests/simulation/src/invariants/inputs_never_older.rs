//! **Inputs never grow older** (design, section 5, cycle): along the chain no scan uses an image older than the one before it.

use super::{Facts, Invariant, Seen};

pub(super) struct InputsNeverOlder;

impl Invariant for InputsNeverOlder {
    fn name(&self) -> &'static str {
        "inputs never grow older"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Recorded { mc: name, head } = seen else {
            return Ok(());
        };
        let mc = facts.mc(name)?;
        match &mc.head {
            Some(before) if head.meta.image < before.image => Err(format!(
                "{name}: scan {} used image {:x} after scan {} had used image {:x}",
                head.meta.id.scan, head.meta.image.0, before.id.scan, before.image.0
            )),
            _ => Ok(()),
        }
    }
}
