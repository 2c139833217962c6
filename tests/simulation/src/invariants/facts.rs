//! The books of what was seen: who was granted what, what stands in the record and at the field.

use super::Seen;
use crate::simulator::{Cell, McInfo};
use fam_proto::model::McModel;
use fam_proto::{
    CheckpointId, Epoch, ImageNumber, InputImage, McId, Owner, Phase, Reset, Scan, Successor,
};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Heads of an MC that are remembered for those who start from them.
const HEADS_MAX: usize = 256;
/// Images that are remembered.
const IMAGES_MAX: usize = 1_024;

/// A head of an MC's chain, as it was recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeadFact {
    /// Which checkpoint.
    pub id: CheckpointId,
    /// MC time, in microseconds.
    pub mc_time_us: u64,
    /// Phase.
    pub phase: Phase,
    /// Input image of its scan.
    pub image: ImageNumber,
    /// The checkpoint's bytes.
    pub state: Arc<Vec<u8>>,
    /// Outputs.
    pub outputs: Arc<[u8]>,
    /// It released the MC, and nothing has disturbed it since.
    pub released: Option<Successor>,
}

/// What ended an epoch before the next was granted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ended {
    /// Released to this successor.
    Released(Successor),
    /// Fail-safe values were set.
    FailSafe,
    /// The gateway was restarted.
    Restart,
    /// Stopped safely.
    Stopped,
    /// Its logic trapped, and the record says so.
    Faulted,
    /// The gateway's machine lost its power, and the head with it.
    HeadLost,
}

/// An epoch that was granted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// The epoch.
    pub epoch: Epoch,
    /// To whom.
    pub owner: Owner,
    /// When.
    pub at_us: u64,
    /// What it starts from.
    pub base: Option<CheckpointId>,
    /// That head, for owners that begin long after.
    from: Option<HeadFact>,
    /// Outputs that stood at the field.
    pub outputs: Vec<u8>,
    /// The reset that came with it.
    pub reset: Option<Reset>,
    /// What ended the epoch before.
    pub after: Option<Ended>,
    /// What ended it.
    pub ended: Option<Ended>,
    /// When its last frame was applied.
    pub applied_at_us: Option<u64>,
}

/// One MC.
#[derive(Debug, Clone)]
pub struct McFacts {
    /// Its model.
    pub model: Arc<McModel>,
    /// The newest head on record.
    pub head: Option<HeadFact>,
    /// The head before.
    pub before: Option<HeadFact>,
    /// Highest scan ever recorded.
    pub last_scan: Scan,
    /// What was applied last.
    pub applied: Option<(CheckpointId, Owner)>,
    /// The newest grant.
    pub grant: Option<Grant>,
    /// An epoch that is on record and was not answered yet, and whether it begins without a head: a reset has been carried out by it.
    opened: Option<(Epoch, bool)>,
    /// All grants.
    pub grants: BTreeMap<Epoch, Grant>,
    /// Outputs that stand at the field; `None` before the first.
    pub field: Option<Vec<u8>>,
    /// Those are the fail-safe values, set as such.
    pub fail_safe: bool,
    /// Heads recorded lately.
    heads: VecDeque<HeadFact>,
    /// Releases that scan threads have marked, by epoch.
    releases: BTreeMap<Epoch, (Scan, Successor)>,
}

impl McFacts {
    /// A head that was recorded.
    #[must_use]
    pub fn head_of(&self, id: CheckpointId) -> Option<&HeadFact> {
        let granted = self.grants.values().filter_map(|g| g.from.as_ref());
        self.heads.iter().rev().chain(granted).find(|h| h.id == id)
    }
}

/// All MCs.
#[derive(Debug)]
pub struct Facts {
    /// The cell.
    pub cell: Arc<Cell>,
    /// Virtual time, in microseconds.
    pub now_us: u64,
    /// The MCs.
    pub mcs: BTreeMap<McId, McFacts>,
    /// Since when the gateway runs without a break.
    pub gateway_up_us: u64,
    images: VecDeque<Arc<InputImage>>,
}

impl Facts {
    pub(super) fn new(cell: Arc<Cell>) -> Facts {
        let mcs = cell.mcs.iter().map(|info| {
            let facts = McFacts {
                model: info.model.clone(),
                head: None,
                before: None,
                last_scan: Scan(0),
                applied: None,
                grant: None,
                opened: None,
                grants: BTreeMap::new(),
                field: None,
                fail_safe: false,
                heads: VecDeque::new(),
                releases: BTreeMap::new(),
            };
            (info.mc.clone(), facts)
        });
        Facts {
            mcs: mcs.collect(),
            now_us: 0,
            gateway_up_us: 0,
            images: VecDeque::new(),
            cell,
        }
    }

    /// The books of an MC.
    ///
    /// # Errors
    /// The cell has no such MC.
    pub fn mc(&self, mc: &McId) -> Result<&McFacts, String> {
        self.mcs
            .get(mc)
            .ok_or_else(|| format!("{mc} is not in the cell"))
    }

    /// What runs as an MC.
    ///
    /// # Errors
    /// The cell has no such MC.
    pub fn info(&self, mc: &McId) -> Result<&McInfo, String> {
        let index = self.cell.index(mc);
        index
            .map(|index| &self.cell.mcs[index])
            .ok_or_else(|| format!("{mc} is not in the cell"))
    }

    /// An image that was sent.
    #[must_use]
    pub fn image(&self, number: ImageNumber) -> Option<&InputImage> {
        let at = self
            .images
            .binary_search_by_key(&number, |i| i.number)
            .ok()?;
        self.images.get(at).map(Arc::as_ref)
    }

    pub(super) fn take(&mut self, seen: &Seen<'_>) {
        let now_us = self.now_us;
        match seen {
            Seen::Ordered { .. }
            | Seen::Diverted { .. }
            | Seen::Trapped { .. }
            | Seen::Restored { .. }
            | Seen::WriteBegun { .. }
            | Seen::Written { .. }
            | Seen::Plant { .. }
            | Seen::End { .. } => {}
            Seen::PowerLost => {
                for mc in self.mcs.values_mut() {
                    mc.lose_head();
                }
            }
            Seen::Opened { mc, ledger } => {
                if let Some(mc) = self.mcs.get_mut(*mc) {
                    mc.opened = Some((ledger.epoch, ledger.base.is_none()));
                }
            }
            Seen::Granted { opened, owner, .. } => {
                if let Some(mc) = self.mcs.get_mut(&opened.mc) {
                    mc.opened = None;
                    // The same grant may be told again.
                    if mc.grants.contains_key(&opened.epoch) {
                        return;
                    }
                    let grant = Grant {
                        epoch: opened.epoch,
                        owner: (*owner).clone(),
                        at_us: now_us,
                        base: opened.base,
                        from: opened.base.and_then(|id| mc.head_of(id).cloned()),
                        outputs: opened.outputs.clone(),
                        reset: opened.reset,
                        after: mc.grant.as_ref().and_then(|g| g.ended.clone()),
                        ended: None,
                        applied_at_us: None,
                    };
                    if grant.reset == Some(Reset::Cold) {
                        mc.head = None; // from here on the MC has no history
                        if grant.after == Some(Ended::HeadLost) {
                            // Nobody knows any more how far it had come.
                            mc.last_scan = Scan(0);
                            mc.applied = None;
                        }
                    }
                    mc.grants.insert(grant.epoch, grant.clone());
                    mc.grant = Some(grant);
                }
            }
            Seen::Recorded { mc, head } => {
                if let Some(mc) = self.mcs.get_mut(*mc) {
                    mc.record(HeadFact {
                        id: head.meta.id,
                        mc_time_us: head.meta.mc_time_us,
                        phase: head.meta.phase,
                        image: head.meta.image,
                        state: head.state.clone(),
                        outputs: head.outputs.clone(),
                        released: None,
                    });
                }
            }
            Seen::Applied { applied, outputs } => {
                if let Some(mc) = self.mcs.get_mut(&applied.mc) {
                    mc.applied = Some((applied.checkpoint_id(), applied.owner.clone()));
                    mc.field = Some(outputs.to_vec());
                    mc.fail_safe = false;
                    let ended = match (&applied.phase, &mc.head) {
                        (Phase::Stopped, _) => Some(Ended::Stopped),
                        (_, Some(head)) => head.released.clone().map(Ended::Released),
                        _ => None,
                    };
                    if let Some(grant) = &mut mc.grant {
                        grant.applied_at_us = Some(now_us);
                        grant.ended = ended;
                    }
                }
            }
            Seen::FailSafe { mc } => {
                if let Some(mc) = self.mcs.get_mut(*mc) {
                    mc.field = Some(mc.model.fail_safe.clone());
                    mc.fail_safe = true;
                }
            }
            Seen::Kept { mc, outputs } => {
                if let Some(mc) = self.mcs.get_mut(*mc) {
                    mc.field = Some(outputs.to_vec());
                    mc.fail_safe = false;
                }
            }
            // Between field and record lies a moment in which the gateway may die: then the record is as good as closed by the restart.
            Seen::Closed { mc, faulted } => {
                let why = if *faulted {
                    Ended::Faulted
                } else {
                    Ended::FailSafe
                };
                self.end(mc, why);
            }
            Seen::Image(image) => {
                if self.images.len() == IMAGES_MAX {
                    self.images.pop_front();
                }
                self.images.push_back(Arc::clone(image));
            }
            Seen::Scanned(frame) => {
                if let (Some(to), Some(mc)) = (&frame.released_to, self.mcs.get_mut(&frame.spec.mc))
                {
                    mc.releases.insert(frame.epoch, (frame.scan, to.clone()));
                }
            }
            Seen::GatewayUp { restarted } => {
                self.gateway_up_us = now_us;
                if *restarted {
                    for mc in self.mcs.values_mut() {
                        mc.restart();
                    }
                }
            }
        }
    }

    fn end(&mut self, mc: &McId, why: Ended) {
        let Some(mc) = self.mcs.get_mut(mc) else {
            return;
        };
        if let Some(head) = &mut mc.head {
            head.released = None;
        }
        if let Some(grant) = &mut mc.grant
            && !(why == Ended::FailSafe
                && matches!(
                    grant.ended,
                    Some(Ended::Faulted | Ended::Stopped | Ended::HeadLost)
                ))
        {
            grant.ended = Some(why);
        }
    }
}

impl McFacts {
    fn record(&mut self, mut head: HeadFact) {
        if let Some((scan, to)) = self.releases.get(&head.id.epoch)
            && *scan == head.id.scan
        {
            head.released = Some(to.clone());
        }
        if self.heads.len() == HEADS_MAX {
            self.heads.pop_front();
        }
        self.heads.push_back(head.clone());
        self.last_scan = self.last_scan.max(head.id.scan);
        self.before = self.head.replace(head);
    }

    /// The gateway died between an epoch's record and its answer: what the epoch did to the record stands.
    fn restart_opened(&mut self, headless: bool) {
        let Some(grant) = &mut self.grant else {
            return;
        };
        if headless {
            self.head = None;
            if grant.ended == Some(Ended::HeadLost) {
                self.last_scan = Scan(0);
                self.applied = None;
            }
        }
        grant.ended = Some(Ended::Restart);
    }

    /// What was not synced is gone. An MC that never ran has nothing to lose.
    fn lose_head(&mut self) {
        if self.head.take().is_some()
            && let Some(grant) = &mut self.grant
        {
            grant.ended = Some(Ended::HeadLost);
        }
    }

    fn restart(&mut self) {
        if let Some((_, headless)) = self.opened.take() {
            self.restart_opened(headless);
        } else if let Some(grant) = &mut self.grant {
            // A head that says stopped may have been recorded right before the gateway died.
            let stopped = self
                .head
                .as_ref()
                .is_some_and(|h| h.phase == Phase::Stopped && h.id.epoch == grant.epoch);
            match grant.ended {
                _ if stopped => grant.ended = Some(Ended::Stopped),
                None | Some(Ended::Released(_)) => grant.ended = Some(Ended::Restart),
                _ => {}
            }
        }
        if let Some(head) = &mut self.head {
            head.released = None;
        }
        // It may have died between the record and the field: the field is then a scan behind.
        if !self.fail_safe {
            self.field = None;
        }
    }
}
