//! **Epochs are never reused** (point 3): an epoch is ordered for one controller by one life of the manager, is durable before its order
//! leaves, and is granted once; grants only rise. A manager on a copy of the repository may order what another one has ordered: there
//! the gateway, which grants an epoch once, is what keeps the promise.

use super::{Facts, Invariant, Seen};
use fam_proto::{BootId, ControllerId, Epoch, McId, OrderId, OrderKind, Owner};
use std::collections::BTreeMap;

#[derive(Default)]
pub(super) struct EpochsNeverReused {
    ordered: BTreeMap<(u64, McId, Epoch), (BootId, OrderId, ControllerId)>,
    granted: BTreeMap<(McId, Epoch), Owner>,
}

impl Invariant for EpochsNeverReused {
    fn name(&self) -> &'static str {
        "epochs are never reused"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        match seen {
            Seen::Ordered {
                manager,
                history,
                order,
                to,
                durable,
            } => {
                let OrderKind::Activate { epoch, .. } = &order.kind else {
                    return Ok(());
                };
                let mc = &order.mc;
                if epoch > durable {
                    return Err(format!(
                        "{mc}: epoch {epoch} is ordered for {to}, but only those up to {durable} are durable"
                    ));
                }
                let this = (*manager, order.id, (*to).clone());
                let first = self
                    .ordered
                    .entry((*history, mc.clone(), *epoch))
                    .or_insert_with(|| this.clone());
                if *first != this {
                    return Err(format!(
                        "{mc}: epoch {epoch} is ordered for {to} (manager boot {manager}, order {}) after it was ordered for {} (manager boot {}, order {})",
                        order.id, first.2, first.0, first.1
                    ));
                }
                Ok(())
            }
            Seen::Granted { opened, owner, .. } => {
                let (mc, epoch) = (&opened.mc, opened.epoch);
                let newest = facts.mc(mc)?.grant.as_ref().map_or(Epoch(0), |g| g.epoch);
                let first = self
                    .granted
                    .entry((mc.clone(), epoch))
                    .or_insert_with(|| (*owner).clone());
                if first != *owner {
                    return Err(format!(
                        "{mc}: epoch {epoch} is granted to {owner} after it was granted to {first}"
                    ));
                }
                if epoch < newest {
                    return Err(format!(
                        "{mc}: epoch {epoch} is granted to {owner} after epoch {newest}"
                    ));
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }
}
