//! Exported variables of MCs of other gateways: their outputs come with the other gateway's images.
//!
//! A value is as old as its image. When the images stay away for the exporting MC's watchdog time, or before the first
//! one, its fail-safe values stand in: exactly what its own gateway does when its frames stay away.

use fam_proto::model::{CellModel, InputSource, McModel};
use fam_proto::{GatewayId, ImageNumber, InputImage, McId, Now};
use std::collections::{BTreeMap, BTreeSet};

/// An MC of another gateway.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Foreign {
    gateway: GatewayId,
    watchdog_us: u64,
    fail_safe: Vec<u8>,
    newest: Option<Newest>,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Newest {
    image: ImageNumber,
    outputs: Vec<u8>,
    at: Now,
}

/// The MCs of `id` that others read, and those of others that the MCs of `id` read.
pub(super) fn of(cell: &CellModel, id: &GatewayId) -> (BTreeSet<McId>, BTreeMap<McId, Foreign>) {
    let model = |mc: &McId| cell.mcs.iter().find(|m| &m.mc == mc);
    let (mut exported, mut foreign) = (BTreeSet::new(), BTreeMap::new());
    for reader in &cell.mcs {
        for input in &reader.inputs {
            let InputSource::Export { mc, .. } = &input.source else {
                continue;
            };
            let Some(exporter) = model(mc).filter(|e| e.gateway != reader.gateway) else {
                continue;
            };
            if &exporter.gateway == id {
                exported.insert(mc.clone());
            } else if &reader.gateway == id {
                foreign.insert(mc.clone(), Foreign::new(exporter));
            }
        }
    }
    (exported, foreign)
}

impl Foreign {
    fn new(model: &McModel) -> Foreign {
        Foreign {
            gateway: model.gateway.clone(),
            watchdog_us: model.watchdog_us,
            fail_safe: model.fail_safe.clone(),
            newest: None,
        }
    }

    /// Length of its output image.
    pub(super) fn len(&self) -> usize {
        self.fail_safe.len()
    }

    /// Takes what an image says, if it is from the MC's own gateway and the newest one.
    pub(super) fn take(&mut self, image: &InputImage, outputs: &[u8], now: Now) {
        // Numbers grow over restarts, which boot ids need not do: they come from a wall clock.
        let newer = self.newest.as_ref().is_none_or(|n| n.image < image.number);
        if image.gateway == self.gateway && outputs.len() == self.len() && newer {
            self.newest = Some(Newest {
                image: image.number,
                outputs: outputs.to_vec(),
                at: now,
            });
        }
    }

    /// Its outputs as far as they are known here.
    pub(super) fn outputs(&self, now: Now) -> &[u8] {
        match &self.newest {
            Some(newest) if now.since_us(newest.at) <= self.watchdog_us => &newest.outputs,
            _ => &self.fail_safe,
        }
    }
}
