//! Which MC goes on which controller (design, section 8): a pure function from a [`Problem`] to a [`Solution`].
//!
//! Uniform machines: an MC needs a share of the reference controller, a controller offers CPU factor x limit of it.
//! The objective, each line deciding only among what the lines above leave equal:
//!
//! 1. every MC placed; where capacity is short, the more critical ones, then those that run already;
//! 2. no controller over its limit, and the highest workload (in shares of the limit) as low as possible;
//! 3. within the tolerance above that: the least cost that the qualities of service put on placements;
//! 4. then as little state moved as possible, then again the lower highest workload.
//!
//! Hosting sets, memory and the whole cycle are hard: nothing is placed against them. The limit is not: an MC runs rather on a
//! controller above its limit than nowhere, and work balance reports the overload. What a controller already runs may stay there.
//!
//! Cells up to [`EXACT_MCS_MAX`] free MCs on [`EXACT_CONTROLLERS_MAX`] controllers are searched exactly (branch and bound with a
//! node limit), larger ones by construction and local search with a lower bound.

mod exact;
mod heuristic;
mod planted;
mod state;
#[cfg(test)]
mod tests;

pub use planted::{Planted, planted};

/// Up to this many MCs that may be placed freely the search is exact.
pub const EXACT_MCS_MAX: usize = 16;
/// Up to this many controllers the search is exact.
pub const EXACT_CONTROLLERS_MAX: usize = 8;
/// The limit of a controller, in the unit of workloads.
pub const LIMIT_PPM: u64 = 1_000_000;
/// Nodes that the exact search visits at most in each of its two passes, unless the problem says otherwise.
pub const NODE_LIMIT: u64 = 200_000;

/// What a controller offers.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Capacity {
    /// CPU factor x limit, in millionths of the reference controller. At least 1.
    pub capacity_ppm: u64,
    /// CPU factor alone: the whole cycle, in millionths of the reference controller.
    pub cycle_ppm: u64,
    /// Memory for MCs, in kB.
    pub memory_kb: u64,
    /// What runs there beside the MCs of the problem, in millionths of the reference controller.
    pub base_ppm: u64,
}

/// A controller that may run an MC.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Host {
    /// Position in [`Problem::controllers`].
    pub controller: u32,
    /// What the qualities of service put on this placement; 0 is best.
    pub cost: u64,
}

/// What an MC asks for.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Demand {
    /// Scan time / cycle on the reference controller, in millionths.
    pub need_ppm: u64,
    /// Memory, in kB.
    pub memory_kb: u64,
    /// What a move has to carry, in bytes.
    pub state_bytes: u64,
    /// Higher is placed first.
    pub criticality: u32,
    /// Where it may run, each controller once.
    pub hosts: Vec<Host>,
    /// Where it runs now.
    pub current: Option<u32>,
    /// It stays where it is (pinned, or on its way there).
    pub fixed: bool,
}

/// A cell to be planned.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Problem {
    /// Controllers.
    pub controllers: Vec<Capacity>,
    /// MCs.
    pub mcs: Vec<Demand>,
    /// Highest workloads that differ by no more than this count as equal, in millionths of the limit.
    pub tolerance_ppm: u64,
    /// Nodes that the exact search may visit in each pass; see [`NODE_LIMIT`].
    pub node_limit: u64,
}

/// What the planner found.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Solution {
    /// For each MC its controller; `None` if it is left out.
    pub assignment: Vec<Option<u32>>,
    /// Highest workload, in millionths of the limit.
    pub peak_ppm: u64,
    /// No assignment that places the same MCs has a lower highest workload than this.
    pub lower_bound_ppm: u64,
    /// MCs that find no place.
    pub left_out: Vec<usize>,
    /// MCs that leave the controller that they run on for another one.
    pub moves: Vec<usize>,
    /// Whether the search was exact and ran to its end.
    pub proven: bool,
}

impl Problem {
    /// Workload of a controller that has `sum_ppm` to run, in millionths of its limit, rounded up.
    #[must_use]
    pub fn workload_ppm(&self, controller: usize, sum_ppm: u64) -> u64 {
        (sum_ppm * LIMIT_PPM).div_ceil(self.controllers[controller].capacity_ppm.max(1))
    }

    /// What each controller has to run under an assignment, in millionths of the reference controller.
    #[must_use]
    pub fn sums_ppm(&self, assignment: &[Option<u32>]) -> Vec<u64> {
        let mut sums: Vec<u64> = self.controllers.iter().map(|c| c.base_ppm).collect();
        for (mc, place) in self.mcs.iter().zip(assignment) {
            if let Some(c) = place {
                sums[*c as usize] += mc.need_ppm;
            }
        }
        sums
    }

    /// Highest workload under an assignment, in millionths of the limit.
    #[must_use]
    pub fn peak_ppm(&self, assignment: &[Option<u32>]) -> u64 {
        let sums = self.sums_ppm(assignment);
        (0..sums.len())
            .map(|c| self.workload_ppm(c, sums[c]))
            .max()
            .unwrap_or(0)
    }

    /// What the qualities of service put on an assignment.
    #[must_use]
    pub fn cost(&self, assignment: &[Option<u32>]) -> u64 {
        secondary(self, assignment).0
    }

    /// A bound that holds for every assignment that places exactly the MCs which `assignment` places.
    #[must_use]
    pub fn lower_bound_ppm(&self, assignment: &[Option<u32>]) -> u64 {
        let mut fixed: Vec<u64> = self.controllers.iter().map(|c| c.base_ppm).collect();
        for mc in self.mcs.iter().filter(|m| m.fixed) {
            if let Some(c) = mc.current {
                fixed[c as usize] += mc.need_ppm;
            }
        }
        // What is fixed cannot fall; each free MC weighs at least what it weighs alone on its best host.
        let mut bound = (0..fixed.len())
            .map(|c| self.workload_ppm(c, fixed[c]))
            .max()
            .unwrap_or(0);
        let mut used = vec![false; self.controllers.len()];
        let mut total: u64 = 0;
        for (mc, place) in self.mcs.iter().zip(assignment) {
            if mc.fixed || place.is_none() {
                continue;
            }
            total += mc.need_ppm;
            let mut best = u64::MAX;
            for host in &mc.hosts {
                let c = host.controller as usize;
                used[c] = true;
                best = best.min(self.workload_ppm(c, fixed[c] + mc.need_ppm));
            }
            if best != u64::MAX {
                bound = bound.max(best);
            }
        }
        // All that may run on the used controllers, spread perfectly over those of them that fixed load leaves below that level.
        let mut levels: Vec<usize> = (0..used.len()).filter(|c| used[*c]).collect();
        levels.sort_by_key(|c| self.workload_ppm(*c, fixed[*c]));
        let (mut load, mut capacity) = (total, 0);
        for (at, c) in levels.iter().enumerate() {
            load += fixed[*c];
            capacity += self.controllers[*c].capacity_ppm.max(1);
            let level = (load * LIMIT_PPM).div_ceil(capacity);
            let next = levels
                .get(at + 1)
                .map_or(u64::MAX, |n| self.workload_ppm(*n, fixed[*n]));
            if level <= next {
                bound = bound.max(level);
                break;
            }
        }
        bound
    }
}

/// Plans. Deterministic; never fails: what cannot be placed is in [`Solution::left_out`].
#[must_use]
pub fn plan(problem: &Problem) -> Solution {
    let (mut assignment, mut proven) = (heuristic::search(problem), false);
    let free = problem.mcs.iter().filter(|m| !m.fixed).count();
    if free <= EXACT_MCS_MAX && problem.controllers.len() <= EXACT_CONTROLLERS_MAX {
        (assignment, proven) = exact::search(problem, assignment);
    }
    let peak_ppm = problem.peak_ppm(&assignment);
    let bound = problem.lower_bound_ppm(&assignment).min(peak_ppm);
    Solution {
        peak_ppm,
        lower_bound_ppm: bound,
        left_out: (0..assignment.len())
            .filter(|m| assignment[*m].is_none())
            .collect(),
        moves: (0..assignment.len())
            .filter(|m| {
                let (from, to) = (problem.mcs[*m].current, assignment[*m]);
                from.is_some() && to.is_some() && from != to
            })
            .collect(),
        proven,
        assignment,
    }
}

/// What an assignment is worth, before tolerance: lower is better. First what is left out by class of criticality (highest class
/// first), then how many of those run now, then the highest workload.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Worth {
    left_out: Vec<u32>,
    evicted: u32,
    peak_ppm: u64,
}

/// Classes of criticality, highest first.
fn classes(problem: &Problem) -> Vec<u32> {
    let mut classes: Vec<u32> = problem.mcs.iter().map(|m| m.criticality).collect();
    classes.sort_unstable_by(|a, b| b.cmp(a));
    classes.dedup();
    classes
}

fn worth(problem: &Problem, classes: &[u32], assignment: &[Option<u32>]) -> Worth {
    let mut left_out = vec![0; classes.len()];
    let mut evicted = 0;
    for (mc, place) in problem.mcs.iter().zip(assignment) {
        if place.is_none() {
            if let Ok(class) = classes.binary_search_by(|c| mc.criticality.cmp(c)) {
                left_out[class] += 1;
            }
            evicted += u32::from(mc.current.is_some());
        }
    }
    Worth {
        left_out,
        evicted,
        peak_ppm: problem.peak_ppm(assignment),
    }
}

/// Up to where highest workloads count as equal to the lowest possible one.
fn allowed_peak_ppm(problem: &Problem, best_ppm: u64) -> u64 {
    let wide = best_ppm.saturating_add(problem.tolerance_ppm);
    if best_ppm <= LIMIT_PPM {
        wide.min(LIMIT_PPM)
    } else {
        wide
    }
}

/// Cost of the qualities of service and bytes of state moved.
fn secondary(problem: &Problem, assignment: &[Option<u32>]) -> (u64, u64) {
    let (mut cost, mut moved) = (0, 0);
    for (mc, place) in problem.mcs.iter().zip(assignment) {
        let Some(place) = place else { continue };
        if mc.fixed {
            continue;
        }
        cost += mc
            .hosts
            .iter()
            .find(|h| h.controller == *place)
            .map_or(0, |h| h.cost);
        moved += move_weight(mc, *place);
    }
    (cost, moved)
}

/// Weight of having the MC on `place`: bytes moved, at least 1 for a move.
fn move_weight(mc: &Demand, place: u32) -> u64 {
    match mc.current {
        Some(current) if current != place => mc.state_bytes.max(1),
        _ => 0,
    }
}
