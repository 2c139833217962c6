//! **No invented state** (point 4): every state that a scan thread produces is the one that the MC's logic makes of the state before it,
//! and an epoch begins from exactly the head that it names as base.

use super::reference::{Beginning, begin, scan, stop};
use super::{Facts, Invariant, Seen};
use fam_node_core::model_mc::ModelMc;
use fam_node_core::{McRuntime, ScannedFrame};
use fam_proto::{Epoch, McId, Owner, Reset, Scan};
use std::collections::BTreeMap;

/// An epoch that runs somewhere.
struct Run {
    epoch: Epoch,
    scan: Scan,
    model: ModelMc,
}

#[derive(Default)]
pub(super) struct NoInventedState {
    runs: BTreeMap<(McId, Owner), Run>,
}

impl Invariant for NoInventedState {
    fn name(&self) -> &'static str {
        "no invented state"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Scanned(frame) = seen else {
            return Ok(());
        };
        let key = (frame.spec.mc.clone(), frame.owner.clone());
        let same = self
            .runs
            .get_mut(&key)
            .filter(|run| run.epoch == frame.epoch);
        match same {
            Some(run) => run.follow(frame, facts),
            None => {
                let run = first(frame, facts)?;
                self.runs.insert(key, run);
                Ok(())
            }
        }
    }
}

fn inputs<'a>(frame: &ScannedFrame, facts: &'a Facts) -> Result<&'a [u8], String> {
    facts
        .image(frame.image)
        .and_then(|image| image.inputs_of(&frame.spec.mc))
        .map(|inputs| inputs.bytes.as_slice())
        .ok_or_else(|| {
            format!(
                "{}: scan {} of {} names image {:x}, which was not sent lately",
                frame.spec.mc, frame.scan, frame.owner, frame.image.0
            )
        })
}

fn words(frame: &ScannedFrame) -> String {
    format!(
        "{}: scan {} of epoch {} on {}",
        frame.spec.mc, frame.scan, frame.epoch, frame.owner
    )
}

/// The first scan of an epoch: from its base, with any recovery (which one is another invariant's matter).
fn first(frame: &ScannedFrame, facts: &Facts) -> Result<Run, String> {
    let mc = facts.mc(&frame.spec.mc)?;
    let Some(grant) = mc.grants.get(&frame.epoch) else {
        return Err(format!("{} runs without a grant", words(frame)));
    };
    if grant.owner != frame.owner {
        return Err(format!(
            "{} runs under the grant of {}",
            words(frame),
            grant.owner
        ));
    }
    if frame.base != grant.base {
        return Err(format!(
            "{} names base {:?}, granted was {:?}",
            words(frame),
            frame.base,
            grant.base
        ));
    }
    let base = match frame.base {
        None => None,
        Some(id) => Some(mc.head_of(id).ok_or_else(|| {
            format!(
                "{} starts from {id:?}, which was never recorded",
                words(frame)
            )
        })?),
    };
    let inputs = inputs(frame, facts)?;
    let padding = padding(facts, &frame.spec.mc);
    let initial = match (base, grant.reset) {
        (None, _) => Some(Reset::Cold),
        (Some(_), Some(Reset::Resume) | None) => None,
        (Some(_), reset) => reset,
    };
    let mc_time_us = frame.mc_time_us; // judged by itself, where it is recorded
    for recovery in 0..=4 {
        for keep_action in [false, true] {
            let how = Beginning {
                initial,
                recovery,
                keep_action,
            };
            let mut model = begin(padding, base.map(|b| b.state.as_slice()), &how);
            if scan(&mut model, inputs, mc_time_us).is_some()
                && model.checkpoint() == frame.buffer.state()
            {
                return Ok(Run {
                    epoch: frame.epoch,
                    scan: frame.scan,
                    model,
                });
            }
        }
    }
    Err(format!(
        "{} has a state (count {}) that the logic cannot make of its base (count {:?})",
        words(frame),
        ModelMc::count(frame.buffer.state()),
        base.map(|b| ModelMc::count(&b.state))
    ))
}

fn padding(facts: &Facts, mc: &McId) -> usize {
    facts
        .cell
        .index(mc)
        .map_or(0, |index| facts.cell.mcs[index].padding)
}

impl Run {
    fn follow(&mut self, frame: &ScannedFrame, facts: &Facts) -> Result<(), String> {
        let state = frame.buffer.state();
        if frame.scan == self.scan {
            // The last word, repeated.
            return if self.model.checkpoint() == state {
                Ok(())
            } else {
                Err(format!("{} is repeated with another state", words(frame)))
            };
        }
        if frame.scan != self.scan.next() {
            return Err(format!("{} follows scan {}", words(frame), self.scan));
        }
        let mc_time_us = frame.mc_time_us;
        let inputs = inputs(frame, facts)?;
        let stopping = stop(padding(facts, &frame.spec.mc), self.model.checkpoint());
        for mut model in [self.model.clone(), stopping] {
            if scan(&mut model, inputs, mc_time_us).is_some() && model.checkpoint() == state {
                self.model = model;
                self.scan = frame.scan;
                return Ok(());
            }
        }
        Err(format!(
            "{} has a state (count {}) that the logic cannot make of the scan before (count {})",
            words(frame),
            ModelMc::count(state),
            ModelMc::count(self.model.checkpoint())
        ))
    }
}
