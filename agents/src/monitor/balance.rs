//! Work balance: no controller above its limit, workloads no further apart than the threshold, and a controller that has
//! joined gets its share.
//!
//! Three things keep plans from swinging: an imbalance has to last (`balance_hold_us`), there is a pause after each plan
//! (`balance_pause_us`), and an imbalance that a plan could not better is not raised again until something has changed.

use super::{News, QualityOfService};
use crate::cell_view::CellView;
use fam_proto::mark::{Mark, hash_marked};
use fam_proto::{Cause, ControllerId, Now, PlanId, QosEvent};
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{Hash, Hasher};

const NAME: &str = "work balance";
const FULL_PERMILLE: u32 = 1_000;
/// An imbalance that no plan could better is raised again after this many pauses: bids may have been lost, or a node not ready.
const RETRY_PAUSES: u64 = 15;

/// What was seen when no plan gained enough.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Declined {
    until: Now,
    version: u64,
    generation: PlanId,
    spread_permille: u32,
    over: bool,
}

impl Hash for Declined {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.until, self.generation, self.spread_permille, self.over).hash(state);
        hash_marked(Mark::Count, self.version, state);
    }
}

/// The monitor.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct WorkBalance {
    /// Since when the imbalance lasts.
    since: Option<Now>,
    hold_until: Option<Now>,
    paused_until: Now,
    /// Joined, and not yet considered.
    fresh: BTreeSet<ControllerId>,
    declined: Option<Declined>,
    /// Last seen, for what is told later.
    seen: Option<Declined>,
}

/// What the workloads look like.
struct Seen {
    cause: Cause,
    detail: String,
    spread_permille: u32,
    over: bool,
}

impl WorkBalance {
    fn look(&self, view: &CellView) -> Option<Seen> {
        let settings = &view.model.settings;
        let loads: BTreeMap<&ControllerId, u32> = view
            .controllers
            .iter()
            .filter(|(_, c)| c.is_up() && !c.is_emptied())
            // Without an input image it can take nothing yet.
            .filter_map(|(name, c)| c.report.as_ref().map(|report| (name, report)))
            .filter(|(_, report)| report.image_age_us != u64::MAX)
            .map(|(name, report)| (name, report.workload_permille))
            .collect();
        let (high, high_load) = loads.iter().max_by_key(|(_, l)| **l)?;
        let (low, low_load) = loads.iter().min_by_key(|(_, l)| **l)?;
        let spread_permille = high_load - low_load;
        let seen = |cause, detail| {
            Some(Seen {
                cause,
                detail,
                spread_permille,
                over: *high_load > FULL_PERMILLE,
            })
        };
        if *high_load > FULL_PERMILLE && loads.len() > 1 {
            let detail = format!("{high} is at {} of its limit", percent(*high_load));
            return seen(Cause::Overload((*high).clone()), detail);
        }
        let fresh = self.fresh.iter().find(|c| {
            loads
                .get(c)
                .is_some_and(|l| *l < FULL_PERMILLE && high_load - l > settings.gain_permille)
        });
        if let Some(fresh) = fresh {
            let detail = format!(
                "{fresh} has joined and is at {} of its limit, {high} at {}",
                percent(loads[fresh]),
                percent(*high_load)
            );
            return seen(Cause::Imbalance(fresh.clone()), detail);
        }
        if spread_permille > settings.spread_permille {
            let detail = format!(
                "{high} is at {} of its limit, {low} at {}: {} apart, {} are tolerated",
                percent(*high_load),
                percent(*low_load),
                percent(spread_permille),
                percent(settings.spread_permille)
            );
            return seen(Cause::Imbalance((*high).clone()), detail);
        }
        None
    }

    /// Whether no plan was found for this before, and nothing has changed since.
    fn is_hopeless(&self, view: &CellView, seen: &Seen, now: Now) -> bool {
        self.declined.as_ref().is_some_and(|d| {
            now < d.until
                && d.version == view.version
                && d.generation == view.generation
                && d.over == seen.over
                && seen.spread_permille <= d.spread_permille + view.model.settings.gain_permille
        })
    }

    fn raise(&mut self, view: &CellView, seen: &Seen, now: Now) {
        self.since = None;
        self.hold_until = None;
        self.paused_until = now.plus_us(view.model.settings.balance_pause_us);
        self.seen = Some(Declined {
            until: now.plus_us(RETRY_PAUSES * view.model.settings.balance_pause_us),
            version: view.version,
            generation: view.generation,
            spread_permille: seen.spread_permille,
            over: seen.over,
        });
    }
}

impl QualityOfService for WorkBalance {
    fn name(&self) -> &str {
        NAME
    }

    fn monitor(&mut self, view: &CellView, now: Now) -> Vec<QosEvent> {
        self.hold_until = None;
        if !view.settled || view.is_busy(now) {
            self.since = None;
            return Vec::new();
        }
        let Some(seen) = self.look(view).filter(|s| !self.is_hopeless(view, s, now)) else {
            self.since = None;
            return Vec::new();
        };
        let since = *self.since.get_or_insert(now);
        let due = since
            .plus_us(view.model.settings.balance_hold_us)
            .max(self.paused_until);
        if now < due {
            self.hold_until = Some(due);
            return Vec::new();
        }
        self.raise(view, &seen, now);
        vec![QosEvent {
            qos: NAME.to_owned(),
            cause: seen.cause,
            detail: seen.detail,
        }]
    }

    fn deadline(&self) -> Option<(Now, &'static str)> {
        self.hold_until.map(|at| (at, "an imbalance lasts"))
    }

    fn told(&mut self, news: &News, view: &CellView, now: Now) {
        let pause_us = view.model.settings.balance_pause_us;
        match news {
            // Who was there before the manager has not joined the cell.
            News::Joined(controller) => {
                if view.settled {
                    self.fresh.insert(controller.clone());
                }
            }
            News::PlanBegan(event) => {
                if event.qos == NAME {
                    self.fresh.clear();
                }
                self.declined = None;
                self.paused_until = now.plus_us(pause_us);
            }
            News::PlanEnded => self.paused_until = now.plus_us(pause_us),
            News::Declined(event) if event.qos == NAME => {
                self.fresh.clear();
                self.declined = self.seen.clone();
            }
            News::Declined(_) => {}
        }
    }

    /// A Controller Agent's own event (as in the case study) need not last any more, but waits for a pause to end: the monitor raises
    /// it in its turn, with the numbers of all controllers.
    fn admit(&mut self, event: &QosEvent, view: &CellView, now: Now) -> bool {
        let (Cause::Imbalance(controller) | Cause::Overload(controller)) = &event.cause else {
            return false;
        };
        if view.controllers.contains_key(controller) {
            if matches!(event.cause, Cause::Imbalance(_)) {
                self.fresh.insert(controller.clone());
            }
            let held = now.0.saturating_sub(view.model.settings.balance_hold_us);
            self.since = Some(Now(held));
        }
        false
    }

    fn boxed(&self) -> Box<dyn QualityOfService> {
        Box::new(self.clone())
    }

    fn digest(&self, mut hasher: &mut dyn Hasher) {
        self.hash(&mut hasher);
    }
}

fn percent(permille: u32) -> String {
    format!("{}.{} %", permille / 10, permille % 10)
}
