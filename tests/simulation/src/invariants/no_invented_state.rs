//! **No invented state** (point 4): every state, with its outputs, that a scan thread produces is the one that the MC's logic makes of
//! the state before it, and an epoch begins from exactly the head that it names as base.

use super::reference::{Beginning, Given, Reference, begin, go_on, stop};
use super::{Facts, Invariant, Seen};
use crate::simulator::McInfo;
use fam_node_core::ScannedFrame;
use fam_proto::{Epoch, McId, Owner, Reset, Scan};
use std::collections::BTreeMap;

/// An epoch that runs somewhere.
struct Run {
    epoch: Epoch,
    scan: Scan,
    state: Vec<u8>,
    outputs: Vec<u8>,
}

#[derive(Default)]
pub(super) struct NoInventedState {
    runs: BTreeMap<(McId, Owner), Run>,
    reference: Reference,
}

impl Invariant for NoInventedState {
    fn name(&self) -> &'static str {
        "no invented state"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        let Seen::Scanned(frame) = seen else {
            return Ok(());
        };
        let info = facts.info(&frame.spec.mc)?;
        if frame.spec.layout != info.spec.layout {
            return Err(format!("{} runs another version of it", words(frame)));
        }
        let key = (frame.spec.mc.clone(), frame.owner.clone());
        let same = self
            .runs
            .get_mut(&key)
            .filter(|run| run.epoch == frame.epoch);
        match same {
            Some(run) => run.follow(frame, info, facts, &mut self.reference),
            None => {
                let run = first(frame, info, facts, &mut self.reference)?;
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

fn made(frame: &ScannedFrame, by: Option<(&[u8], &[u8])>) -> bool {
    by == Some((frame.buffer.state(), frame.buffer.outputs()))
}

/// The first scan of an epoch: from its base, with any recovery (which one is another invariant's matter).
fn first(
    frame: &ScannedFrame,
    info: &McInfo,
    facts: &Facts,
    reference: &mut Reference,
) -> Result<Run, String> {
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
    let given = Given {
        inputs: inputs(frame, facts)?,
        outputs: &grant.outputs,
        mc_time_us: frame.mc_time_us, // judged by itself, where it is recorded
    };
    let initial = match (base, grant.reset) {
        (None, _) => Some(Reset::Cold),
        (Some(_), Some(Reset::Resume) | None) => None,
        (Some(_), reset) => reset,
    };
    let diagnosis = &info.spec.diagnosis;
    let actions = diagnosis.intervals.iter().map(|i| i.action);
    for recovery in std::iter::once(0)
        .chain(actions)
        .chain(diagnosis.stop_action)
    {
        for keep_action in [false, true] {
            let how = Beginning {
                initial,
                recovery,
                keep_action,
            };
            let checkpoint = begin(info, base.map(|b| b.state.as_slice()), &how);
            if made(frame, reference.scan(info, &checkpoint, &given)) {
                return Ok(Run {
                    epoch: frame.epoch,
                    scan: frame.scan,
                    state: frame.buffer.state().to_vec(),
                    outputs: frame.buffer.outputs().to_vec(),
                });
            }
        }
    }
    Err(format!(
        "{} has a state or outputs that the logic cannot make of its base, {:?}",
        words(frame),
        base.map(|b| b.id)
    ))
}

impl Run {
    fn follow(
        &mut self,
        frame: &ScannedFrame,
        info: &McInfo,
        facts: &Facts,
        reference: &mut Reference,
    ) -> Result<(), String> {
        let (state, outputs) = (frame.buffer.state(), frame.buffer.outputs());
        if frame.scan == self.scan {
            // The last word, repeated.
            return if self.state == state && self.outputs == outputs {
                Ok(())
            } else {
                Err(format!("{} is repeated with another state", words(frame)))
            };
        }
        if frame.scan != self.scan.next() {
            return Err(format!("{} follows scan {}", words(frame), self.scan));
        }
        let given = Given {
            inputs: inputs(frame, facts)?,
            outputs: &self.outputs,
            mc_time_us: frame.mc_time_us,
        };
        let on = go_on(info, &self.state);
        let good = made(frame, reference.scan(info, &on, &given))
            || stop(info, &self.state)
                .is_some_and(|stopping| made(frame, reference.scan(info, &stopping, &given)));
        if !good {
            return Err(format!(
                "{} has a state or outputs that the logic cannot make of the scan before",
                words(frame)
            ));
        }
        self.scan = frame.scan;
        self.state.copy_from_slice(state);
        self.outputs.copy_from_slice(outputs);
        Ok(())
    }
}
