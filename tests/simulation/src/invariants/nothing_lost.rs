//! **Nothing that the plant has seen is lost** (point 5): no outputs reach the field without their state on record, each epoch starts
//! from the head of the record, and scan numbers go on behind it.

use super::{Ended, Facts, Invariant, Seen};
use crate::simulator::Logic;
use fam_node_core::model_mc::ModelMc;
use fam_proto::{Phase, Reset};

pub(super) struct NothingLost;

impl Invariant for NothingLost {
    fn name(&self) -> &'static str {
        "nothing that the plant has seen is lost"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        match seen {
            Seen::Applied { applied, outputs } => {
                let mc = facts.mc(&applied.mc)?;
                let id = applied.checkpoint_id();
                let Some(head) = mc.head.as_ref().filter(|h| h.id == id) else {
                    return Err(format!(
                        "{}: outputs of scan {} are applied, but the record's head is {:?}",
                        applied.mc,
                        applied.scan,
                        mc.head.as_ref().map(|h| h.id)
                    ));
                };
                if head.outputs.as_ref() != *outputs {
                    return Err(format!(
                        "{}: outputs of scan {} are applied that are not those of the record's head",
                        applied.mc, applied.scan
                    ));
                }
                if !matches!(facts.info(&applied.mc)?.logic, Logic::Model { .. }) {
                    return Ok(());
                }
                // The model MC puts its count into its outputs: outputs and state are of one scan.
                let count = ModelMc::count(&head.state).to_le_bytes();
                if head.phase == Phase::Running && outputs.get(1..9) != Some(&count[..]) {
                    return Err(format!(
                        "{}: outputs of scan {} belong to another state",
                        applied.mc, applied.scan
                    ));
                }
                Ok(())
            }
            Seen::Granted { opened, owner, .. } => {
                let mc = facts.mc(&opened.mc)?;
                let head = mc.head.as_ref().map(|h| h.id);
                let repeated = mc.grants.contains_key(&opened.epoch);
                let cold = opened.reset == Some(Reset::Cold);
                if opened.base != head && !(cold && opened.base.is_none()) {
                    return Err(format!(
                        "{}: epoch {} is granted to {owner} on {:?}, but the head of the record is {head:?}",
                        opened.mc, opened.epoch, opened.base
                    ));
                }
                if let Some(checkpoint) = &opened.checkpoint
                    && (Some(checkpoint.id) != opened.base || !checkpoint.is_intact())
                {
                    return Err(format!(
                        "{}: the grant of epoch {} carries another checkpoint than it names",
                        opened.mc, opened.epoch
                    ));
                }
                // Where the head is lost with the power, so is the count; a cold reset begins anew.
                let head_lost =
                    mc.grant.as_ref().and_then(|g| g.ended.as_ref()) == Some(&Ended::HeadLost);
                if opened.next_scan <= mc.last_scan && !repeated && !(head_lost && cold) {
                    return Err(format!(
                        "{}: epoch {} is to begin with scan {}, but scan {} was applied",
                        opened.mc, opened.epoch, opened.next_scan, mc.last_scan
                    ));
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}
