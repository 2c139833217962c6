//! From what is known and bid to a planner's problem, and back to names.

use crate::cell_view::{CellView, UnderWay};
use crate::monitor::{Placement, Qualities};
use crate::planner::{Capacity, Demand, Host, LIMIT_PPM, Problem, Solution};
use crate::unfit::Unfit;
use fam_proto::model::McModel;
use fam_proto::{Bid, Cause, ControllerId, Holding, McId, Now};
use std::collections::{BTreeMap, BTreeSet};

/// Nodes of the exact search when something is down: a failover does not wait for the last per mille.
const NODE_LIMIT_FAILURE: u64 = 20_000;
/// A workload this much above what the known MCs explain is taken for real, in millionths of the limit.
const UNEXPLAINED_PPM: u64 = 50_000;

/// What a decision is made from.
pub(super) struct Asked<'a> {
    pub(super) view: &'a CellView,
    pub(super) qualities: &'a Qualities,
    pub(super) bids: &'a BTreeMap<ControllerId, Bid>,
    pub(super) holdings: &'a BTreeMap<(ControllerId, McId), Holding>,
    pub(super) now: Now,
    /// The operator says where to.
    pub(super) target: Option<(&'a McId, &'a ControllerId)>,
}

/// Which MCs may be placed anew.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Free {
    /// Those that the call was about.
    Called,
    /// All that run, too.
    All,
}

/// A problem with the names of what it is about.
pub(super) struct Built {
    pub(super) problem: Problem,
    pub(super) controllers: Vec<ControllerId>,
    pub(super) mcs: Vec<McId>,
    /// For each MC the controllers that do not come into question, with the reason.
    refusals: Vec<Vec<(ControllerId, Unfit)>>,
}

/// MCs that run on a controller and are not on their way.
pub(super) fn on_controller(view: &CellView, controller: &ControllerId) -> Vec<McId> {
    view.mcs
        .iter()
        .filter(|(_, m)| m.under_way.is_none())
        .filter(|(mc, _)| view.runs_on(mc) == Some(controller))
        .map(|(mc, _)| mc.clone())
        .collect()
}

/// MCs that work balance may move: they run, are not on their way, and are not kept where they are.
pub(super) fn movable(view: &CellView) -> Vec<McId> {
    view.mcs
        .iter()
        .filter(|(_, m)| m.under_way.is_none())
        .filter(|(mc, m)| {
            let runs_on = view.runs_on(mc);
            runs_on.is_some() && m.pinned.as_ref() != runs_on
        })
        .map(|(mc, _)| mc.clone())
        .collect()
}

pub(super) fn build(asked: &Asked<'_>, called: &BTreeSet<McId>, free: Free) -> Built {
    let view = asked.view;
    let settings = &view.model.settings;
    let controllers: Vec<ControllerId> = view
        .controllers
        .iter()
        .filter(|(_, c)| c.is_up())
        .map(|(name, _)| name.clone())
        .collect();
    let place = |controller: &ControllerId| -> Option<u32> {
        let at = controllers.binary_search(controller).ok()?;
        u32::try_from(at).ok()
    };
    let failure = called.iter().any(|mc| view.need(mc).is_some());
    let mut built = Built {
        problem: Problem {
            controllers: Vec::new(),
            mcs: Vec::new(),
            tolerance_ppm: u64::from(settings.gain_permille) * 1_000 / 2,
            node_limit: if failure {
                NODE_LIMIT_FAILURE
            } else {
                crate::planner::NODE_LIMIT
            },
        },
        controllers: controllers.clone(),
        mcs: Vec::new(),
        refusals: Vec::new(),
    };
    for (mc, there) in &view.mcs {
        let Some((model, _)) = view.mc(mc) else {
            continue;
        };
        let runs_on = view.runs_on(mc);
        let current = match &there.under_way {
            Some(UnderWay::To(to)) => place(to),
            _ => runs_on.and_then(&place),
        };
        let is_called = called.contains(mc) && there.under_way.is_none();
        if !is_called && current.is_none() {
            continue;
        }
        let kept = there.pinned.is_some() && there.pinned.as_ref() == runs_on;
        let fixed = !is_called && (free == Free::Called || kept || there.under_way.is_some());
        let (mut hosts, mut refusals) = (Vec::new(), Vec::new());
        if !fixed {
            (hosts, refusals) = asked.hosts(model, is_called, &place);
            let may_stay = !is_called
                || current.is_some_and(|c| {
                    asked.target.is_none()
                        && !view.controllers[&controllers[c as usize]].is_emptied()
                });
            if let Some(c) = current.filter(|_| may_stay)
                && !hosts.iter().any(|h| h.controller == c)
            {
                hosts.push(Host {
                    controller: c,
                    cost: 0,
                });
            }
        }
        built.mcs.push(mc.clone());
        built.refusals.push(refusals);
        built.problem.mcs.push(Demand {
            need_ppm: asked.need_ppm(model),
            memory_kb: model.memory_kb,
            state_bytes: u64::from(model.diagnosis.checkpoint_len),
            criticality: model.criticality,
            hosts,
            current,
            fixed,
        });
    }
    for (at, controller) in controllers.iter().enumerate() {
        let capacity = asked.capacity(controller, at, &built);
        built.problem.controllers.push(capacity);
    }
    built
}

impl Asked<'_> {
    /// Controllers that may take the MC, with what that costs, and those that may not, with the reason.
    fn hosts(
        &self,
        model: &McModel,
        called: bool,
        place: &dyn Fn(&ControllerId) -> Option<u32>,
    ) -> (Vec<Host>, Vec<(ControllerId, Unfit)>) {
        let (mut hosts, mut refusals) = (Vec::new(), Vec::new());
        let pinned = self.view.mcs[&model.mc]
            .pinned
            .as_ref()
            .filter(|c| self.view.may_take(c, &model.mc, self.now).is_ok());
        for controller in &model.hosts {
            let verdict = self.objection(model, controller, called, pinned);
            match (verdict, place(controller)) {
                (Err(why), _) => refusals.push((controller.clone(), why)),
                (Ok(_), None) => refusals.push((controller.clone(), Unfit::NotRegistered)),
                (Ok(cost), Some(at)) => hosts.push(Host {
                    controller: at,
                    cost,
                }),
            }
        }
        (hosts, refusals)
    }

    fn objection(
        &self,
        model: &McModel,
        controller: &ControllerId,
        called: bool,
        pinned: Option<&ControllerId>,
    ) -> Result<u64, Unfit> {
        let mc = &model.mc;
        self.view.may_take(controller, mc, self.now)?;
        match self.target {
            Some((wished, to)) if wished == mc => {
                if to != controller {
                    return Err(Unfit::Unwished(to.clone()));
                }
            }
            _ => {
                if let Some(pin) = pinned
                    && pin != controller
                {
                    return Err(Unfit::Pinned(pin.clone()));
                }
            }
        }
        let bid = self.bids.get(controller);
        match bid {
            None if called => return Err(Unfit::NoBid),
            None => {}
            Some(bid) => {
                if let Some(offer) = bid.offers.iter().find(|o| &o.mc == mc)
                    && let Some(why) = &offer.unable
                {
                    return Err(Unfit::Unable(why.clone()));
                }
            }
        }
        let placement = Placement {
            view: self.view,
            mc: model,
            controller,
            bid,
            holding: self.holdings.get(&(controller.clone(), mc.clone())),
        };
        self.qualities.weigh(&placement).map_err(Unfit::Quality)?;
        Ok(self.qualities.cost(&placement))
    }

    /// What the MC needs of the reference controller: measured where it runs, else the most that a bid says, else declared.
    fn need_ppm(&self, model: &McModel) -> u64 {
        let offered = |controller: &ControllerId| -> Option<u64> {
            let offer = self
                .bids
                .get(controller)?
                .offers
                .iter()
                .find(|o| o.mc == model.mc && o.unable.is_none() && o.worst_case_us > 0)?;
            let registration = self.view.controllers[controller].registration.as_ref()?;
            Some(need_ppm(
                offer.worst_case_us,
                registration.cpu_factor_permille,
                model.cycle_us,
            ))
        };
        let declared = need_ppm(model.worst_case_us, 1_000, model.cycle_us);
        self.view
            .runs_on(&model.mc)
            .and_then(&offered)
            .or_else(|| self.bids.keys().filter_map(offered).max())
            .unwrap_or(declared)
    }

    /// What a controller offers. What it says in its bid wins over its last report and its registration.
    fn capacity(&self, controller: &ControllerId, at: usize, built: &Built) -> Capacity {
        let there = &self.view.controllers[controller];
        let (factor, limit, memory_kb) = there.registration.as_ref().map_or((1, 1, 0), |r| {
            (
                u64::from(r.cpu_factor_permille),
                u64::from(r.limit_permille),
                r.memory_kb,
            )
        });
        let capacity_ppm = (factor * limit).max(1);
        let here = |m: &&Demand| m.current.is_some_and(|c| c as usize == at);
        let mut explained_ppm = 0;
        let mut resident_kb = 0;
        for mc in built.problem.mcs.iter().filter(here) {
            explained_ppm += mc.need_ppm;
            resident_kb += mc.memory_kb;
        }
        let bid = self.bids.get(controller);
        let workload_permille = bid.map(|b| b.workload_permille).or_else(|| {
            let report = there.report.as_ref();
            report.map(|r| r.workload_permille)
        });
        let measured_ppm = u64::from(workload_permille.unwrap_or(0)) * capacity_ppm / 1_000;
        let more_ppm = measured_ppm.saturating_sub(explained_ppm);
        let margin_ppm = capacity_ppm * UNEXPLAINED_PPM / LIMIT_PPM;
        Capacity {
            capacity_ppm,
            cycle_ppm: factor * 1_000,
            memory_kb: bid.map_or(memory_kb, |b| b.memory_free_kb + resident_kb),
            base_ppm: if more_ppm > margin_ppm { more_ppm } else { 0 },
        }
    }
}

/// Share of the reference controller that scans of `scan_us` on a controller of this factor take.
fn need_ppm(scan_us: u32, cpu_factor_permille: u32, cycle_us: u32) -> u64 {
    u64::from(scan_us) * u64::from(cpu_factor_permille) * 1_000 / u64::from(cycle_us.max(1))
}

impl Built {
    /// Names of some of the MCs.
    pub(super) fn names(&self, mcs: &[usize]) -> BTreeSet<McId> {
        mcs.iter().map(|m| self.mcs[*m].clone()).collect()
    }

    /// MCs that find no place, with the reason.
    pub(super) fn left_out(&self, solution: &Solution) -> Vec<(McId, String)> {
        solution
            .left_out
            .iter()
            .map(|m| {
                let demand = &self.problem.mcs[*m];
                let mut reasons: Vec<String> = self.refusals[*m]
                    .iter()
                    .map(|(controller, why)| format!("{controller} {why}"))
                    .collect();
                reasons.extend(demand.hosts.iter().map(|h| {
                    let controller = &self.controllers[h.controller as usize];
                    format!("{controller} has no room beside what is more critical or runs there")
                }));
                if reasons.is_empty() {
                    reasons.push("no controller hosts it".to_owned());
                }
                (self.mcs[*m].clone(), reasons.join("; "))
            })
            .collect()
    }

    /// Everything that runs stays.
    pub(super) fn stay(&self) -> Vec<Option<u32>> {
        self.problem.mcs.iter().map(|m| m.current).collect()
    }

    /// Whether a plan of work balance gains enough to be worth its moves.
    pub(super) fn is_gain(&self, solution: &Solution, view: &CellView, cause: &Cause) -> bool {
        let stay = self.stay();
        let (before, after) = (self.problem.peak_ppm(&stay), solution.peak_ppm);
        let gain_ppm = u64::from(view.model.settings.gain_permille) * 1_000;
        let cheaper = matches!(cause, Cause::Custom(_) | Cause::Overrun(..))
            && self.problem.cost(&solution.assignment) < self.problem.cost(&stay)
            && after
                <= before
                    .max(LIMIT_PPM)
                    .max(solution.lower_bound_ppm + gain_ppm);
        before >= after + gain_ppm.max(1) || (before > LIMIT_PPM && after <= LIMIT_PPM) || cheaper
    }
}
