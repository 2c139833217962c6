//! **Critical intervals are answered as declared** (point 6): an epoch after an interruption begins with the action of the critical
//! interval that holds, an interrupted action goes on if it may be repeated, and leads to a safe stop if not.

use super::reference::{Given, Reference, begin, beginning, stop};
use super::{Facts, Invariant, Seen};
use fam_proto::{Epoch, McId, Owner, Reset};
use std::collections::BTreeMap;

#[derive(Default)]
pub(super) struct RecoveryAsDeclared {
    begun: BTreeMap<(McId, Owner), Epoch>,
    /// Sent into the stop POU before the first frame of the epoch.
    diverted: BTreeMap<(McId, Owner), Epoch>,
    reference: Reference,
}

impl Invariant for RecoveryAsDeclared {
    fn name(&self) -> &'static str {
        "critical intervals are answered as declared"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        if let Seen::Diverted { mc, owner, epoch } = seen {
            let key = ((*mc).clone(), (*owner).clone());
            self.diverted.insert(key, *epoch);
        }
        let Seen::Scanned(frame) = seen else {
            return Ok(());
        };
        let key = (frame.spec.mc.clone(), frame.owner.clone());
        let diverted = self.diverted.remove(&key) == Some(frame.epoch);
        if self.begun.insert(key, frame.epoch) == Some(frame.epoch) {
            return Ok(());
        }
        let mc = facts.mc(&frame.spec.mc)?;
        let base = frame.base.and_then(|id| mc.head_of(id));
        let info = facts.info(&frame.spec.mc)?;
        let Some(grant) = mc.grants.get(&frame.epoch) else {
            return Ok(()); // judged as invented
        };
        let Some(inputs) = facts
            .image(frame.image)
            .and_then(|image| image.inputs_of(&frame.spec.mc))
        else {
            return Ok(()); // judged as invented
        };
        let what = format!(
            "{}: epoch {} on {}",
            frame.spec.mc, frame.epoch, frame.owner
        );
        let Some(how) = beginning(grant, base, &mc.model.diagnosis) else {
            return Err(format!("{what} begins although nothing may be run"));
        };
        let state = base.map(|b| b.state.as_slice());
        let mut checkpoint = begin(info, state, &how);
        if diverted {
            // Its first scan has trapped, or an order to stop came before it.
            checkpoint = stop(info, &checkpoint).unwrap_or(checkpoint);
        }
        let given = Given {
            inputs: &inputs.bytes,
            outputs: &grant.outputs,
            mc_time_us: frame.mc_time_us,
        };
        let made = self.reference.scan(info, &checkpoint, &given);
        if made.is_none_or(|(state, _)| state != frame.buffer.state()) {
            return Err(format!(
                "{what} does not begin as it has to: {}recovery action {}{}, after {:?} in {:?}",
                match how.initial {
                    None => "",
                    Some(Reset::Warm) => "retained variables only, ",
                    Some(_) => "initial values, ",
                },
                how.recovery,
                if how.keep_action { " going on" } else { "" },
                grant.after,
                base.map(|b| b.phase),
            ));
        }
        Ok(())
    }
}
