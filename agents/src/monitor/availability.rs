//! Availability: every MC that may run has an owner that drives it.
//!
//! Sees lost liveliness tokens, missing reports, the gateways' silence reports, and MCs without an owner. A need that nobody has
//! answered is raised again after a while, and at once when a controller joins.

use super::{Placement, QualityOfService};
use crate::cell_view::{CellView, Loss, Need};
use fam_proto::mark::{Mark, hash_marked};
use fam_proto::{Cause, ControllerId, Epoch, McId, Now, QosEvent};
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};

/// A need that is still there after this long is raised again, in microseconds.
pub const RETRY_US: u64 = 100_000;
/// The longest pause between two tries, in microseconds.
const RETRY_MAX_US: u64 = 2_000_000;
/// A controller whose newest input image is older than this can drive nothing, in microseconds.
pub const IMAGE_STALE_US: u64 = 100_000;
/// A replica so many scans behind the record follows closely: the gateway's copy is not needed.
const CLOSE_SCANS: u64 = 8;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Raised {
    epoch: Epoch,
    kind: u8,
    version: u64,
    tries: u32,
    again: Now,
}

impl Hash for Raised {
    fn hash<H: Hasher>(&self, state: &mut H) {
        // How often it was raised shows in the time.
        (self.epoch, self.kind, self.again).hash(state);
        hash_marked(Mark::Count, self.version, state);
    }
}

/// The monitor.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Availability {
    raised: BTreeMap<McId, Raised>,
    joining: Option<Now>,
}

impl QualityOfService for Availability {
    fn name(&self) -> &str {
        "availability"
    }

    fn monitor(&mut self, view: &CellView, now: Now) -> Vec<QosEvent> {
        self.joining = None;
        if !view.settled {
            return Vec::new();
        }
        let homeless: BTreeMap<McId, Need> = view.homeless(now).into_iter().collect();
        self.joining = view
            .joining_until(now)
            .filter(|_| view.mcs.keys().any(|mc| view.waits_for_joining(mc, now)));
        self.raised.retain(|mc, _| homeless.contains_key(mc));
        let mut events = Vec::new();
        let mut lost: BTreeMap<(ControllerId, Loss), Vec<McId>> = BTreeMap::new();
        for (mc, need) in homeless {
            if !self.is_news(&mc, &need, view, now) {
                continue;
            }
            match need {
                Need::Lost(controller, loss) => {
                    lost.entry((controller, loss)).or_default().push(mc);
                }
                Need::Silent(silent_us) => events.push(event(
                    Cause::McSilent(mc.clone()),
                    format!(
                        "{mc}: the gateway has had no valid frame for {}",
                        milliseconds(silent_us)
                    ),
                )),
                Need::Unowned(state) => events.push(event(
                    Cause::McUnowned(mc.clone()),
                    format!("{mc} has no owner (its record says: {state})"),
                )),
            }
        }
        for ((controller, loss), mcs) in lost {
            let names: Vec<&str> = mcs.iter().map(McId::as_str).collect();
            let detail = format!("{controller} is lost ({loss}); it ran {}", names.join(", "));
            events.push(event(Cause::ControllerLost(controller), detail));
        }
        events
    }

    fn deadline(&self) -> Option<(Now, &'static str)> {
        let again = self.raised.values().map(|r| r.again).min();
        let again = again.map(|at| (at, "an MC is still without an owner"));
        let joining = self.joining.map(|at| (at, "nodes that are about to join"));
        again.into_iter().chain(joining).min()
    }

    fn weigh(&self, placement: &Placement<'_>) -> Result<(), String> {
        match placement.bid {
            Some(bid) if bid.image_age_us > IMAGE_STALE_US => {
                Err(if bid.image_age_us == u64::MAX {
                    "has had no input image".to_owned()
                } else {
                    format!(
                        "has had no input image for {}",
                        milliseconds(bid.image_age_us)
                    )
                })
            }
            _ => Ok(()),
        }
    }

    /// For an MC that is down, a controller that holds its state goes before one that does not.
    fn cost(&self, placement: &Placement<'_>) -> u64 {
        let mc = &placement.mc.mc;
        let Some(head) = placement
            .view
            .mcs
            .get(mc)
            .and_then(|m| m.record.as_ref())
            .and_then(|r| r.head)
        else {
            return 0;
        };
        if placement.view.need(mc).is_none() {
            return 0;
        }
        match placement.holding.and_then(|h| h.held) {
            Some(held) if held.scan.0 + CLOSE_SCANS >= head.scan.0 => 0,
            Some(_) => 1,
            None => 2,
        }
    }

    fn boxed(&self) -> Box<dyn QualityOfService> {
        Box::new(self.clone())
    }

    fn digest(&self, mut hasher: &mut dyn Hasher) {
        self.hash(&mut hasher);
    }
}

impl Availability {
    /// Whether the need is new, or has waited long enough to be told again.
    fn is_news(&mut self, mc: &McId, need: &Need, view: &CellView, now: Now) -> bool {
        let epoch = view.mcs[mc].record.as_ref().map_or(Epoch(0), |r| r.epoch);
        let kind = match need {
            Need::Lost(..) => 0,
            Need::Silent(_) => 1,
            Need::Unowned(_) => 2,
        };
        let known = self.raised.get(mc);
        let same = known.filter(|r| (r.epoch, r.kind, r.version) == (epoch, kind, view.version));
        let tries = match same {
            Some(raised) if now < raised.again => return false,
            Some(raised) => raised.tries.saturating_add(1),
            None => 1,
        };
        let pause = (RETRY_US << (tries - 1).min(10)).min(RETRY_MAX_US);
        self.raised.insert(
            mc.clone(),
            Raised {
                epoch,
                kind,
                version: view.version,
                tries,
                again: now.plus_us(pause),
            },
        );
        true
    }
}

fn event(cause: Cause, detail: String) -> QosEvent {
    QosEvent {
        qos: "availability".to_owned(),
        cause,
        detail,
    }
}

fn milliseconds(us: u64) -> String {
    format!("{}.{} ms", us / 1_000, us / 100 % 10)
}
