//! Exact search for small cells: branch and bound in two passes, each with a node limit.
//!
//! Pass one finds the best [`Worth`](super::Worth): what has to be left out, and the lowest highest workload. Pass two keeps
//! to that, within the tolerance, and finds the least cost and the least state moved.

use super::state::State;
use super::{Problem, allowed_peak_ppm, classes, move_weight, secondary, worth};

/// Improves `start` to the optimum. The flag says whether it is proven.
pub(super) fn search(problem: &Problem, start: Vec<Option<u32>>) -> (Vec<Option<u32>>, bool) {
    let classes = classes(problem);
    let mut order: Vec<usize> = (0..problem.mcs.len())
        .filter(|m| !problem.mcs[*m].fixed)
        .collect();
    order.sort_by_key(|m| (std::cmp::Reverse(problem.mcs[*m].need_ppm), *m));
    // Leaving one MC of a class out outweighs all those of lower classes.
    let base = order.len() as u128 + 1;
    let penalties: Vec<u128> = problem
        .mcs
        .iter()
        .map(|m| {
            let rank = classes.iter().filter(|c| **c < m.criticality).count();
            base.saturating_pow(u32::try_from(rank).unwrap_or(u32::MAX))
        })
        .collect();
    let penalty_of = |assignment: &[Option<u32>]| -> (u128, u32) {
        let mut sum = (0, 0);
        for (m, place) in assignment.iter().enumerate() {
            if place.is_none() && !problem.mcs[m].fixed {
                sum.0 += penalties[m];
                sum.1 += u32::from(problem.mcs[m].current.is_some());
            }
        }
        sum
    };
    let mut remaining = vec![0; order.len() + 1];
    let mut least = vec![(0, 0); order.len() + 1];
    for at in (0..order.len()).rev() {
        let mc = &problem.mcs[order[at]];
        remaining[at] = remaining[at + 1] + mc.need_ppm;
        let best = mc
            .hosts
            .iter()
            .map(|h| (h.cost, move_weight(mc, h.controller)))
            .min();
        let (cost, moved) = best.unwrap_or((0, 0));
        // Bounded one by one: the cheapest host need not be the one that moves least.
        let moved = mc
            .hosts
            .iter()
            .map(|h| move_weight(mc, h.controller))
            .min()
            .unwrap_or(moved);
        least[at] = (least[at + 1].0 + cost, least[at + 1].1 + moved);
    }
    let best_worth = worth(problem, &classes, &start);
    let (penalty, evicted) = penalty_of(&start);
    let mut search = Search {
        problem,
        alike: alike(problem),
        order,
        penalties,
        remaining,
        least,
        state: State::new(problem),
        nodes: 0,
        best: start,
        best_first: (penalty, evicted, best_worth.peak_ppm),
        best_second: (0, 0, 0),
        allowed_ppm: 0,
    };
    let fixed_peak = (0..problem.controllers.len())
        .map(|c| search.state.workload_ppm(c))
        .max()
        .unwrap_or(0);
    search.first(0, (0, 0), fixed_peak);
    let proven_first = search.nodes <= problem.node_limit;

    search.allowed_ppm = allowed_peak_ppm(problem, search.best_first.2);
    let (cost, moved) = secondary(problem, &search.best);
    search.best_second = (cost, moved, search.best_first.2);
    search.nodes = 0;
    search.second(0, (0, 0), (0, 0), fixed_peak);
    let proven = proven_first && search.nodes <= problem.node_limit;
    (search.best, proven)
}

/// Class of each controller: those of a class offer the same and host the same MCs.
fn alike(problem: &Problem) -> Vec<usize> {
    let column = |c: usize| -> Vec<(usize, u64)> {
        problem
            .mcs
            .iter()
            .enumerate()
            .filter(|(_, m)| !m.fixed)
            .flat_map(|(at, m)| m.hosts.iter().map(move |h| (at, h)))
            .filter(|(_, h)| h.controller as usize == c)
            .map(|(at, h)| (at, h.cost))
            .collect()
    };
    let columns: Vec<_> = (0..problem.controllers.len()).map(column).collect();
    (0..columns.len())
        .map(|c| {
            (0..c)
                .find(|d| {
                    let (a, b) = (&problem.controllers[c], &problem.controllers[*d]);
                    columns[*d] == columns[c]
                        && (a.capacity_ppm, a.cycle_ppm, a.memory_kb)
                            == (b.capacity_ppm, b.cycle_ppm, b.memory_kb)
                })
                .unwrap_or(c)
        })
        .collect()
}

struct Search<'p> {
    problem: &'p Problem,
    /// For each controller the first one that is like it.
    alike: Vec<usize>,
    /// Free MCs, largest need first.
    order: Vec<usize>,
    penalties: Vec<u128>,
    /// Need of the MCs from a position of `order` on.
    remaining: Vec<u64>,
    /// Least cost and least bytes moved from a position of `order` on, if all are placed.
    least: Vec<(u64, u64)>,
    state: State<'p>,
    nodes: u64,
    best: Vec<Option<u32>>,
    best_first: (u128, u32, u64),
    best_second: (u64, u64, u64),
    allowed_ppm: u64,
}

impl Search<'_> {
    /// Lowest highest workload that the rest could still lead to.
    fn bound_ppm(&self, at: usize, peak: u64) -> u64 {
        let load: u64 = self.state.sum_ppm.iter().sum::<u64>() + self.remaining[at];
        let capacity: u64 = self
            .problem
            .controllers
            .iter()
            .map(|c| c.capacity_ppm.max(1))
            .sum();
        peak.max((load * super::LIMIT_PPM).div_ceil(capacity.max(1)))
    }

    fn first(&mut self, at: usize, left: (u128, u32), peak: u64) {
        self.nodes += 1;
        let (best_penalty, best_evicted, best_peak) = self.best_first;
        if self.nodes > self.problem.node_limit || left > (best_penalty, best_evicted) {
            return;
        }
        // With the penalty of the best one nothing more may be left out, so that the rest has to go somewhere.
        if left.0 == best_penalty && left.1 == best_evicted && self.bound_ppm(at, peak) >= best_peak
        {
            return;
        }
        let Some(&m) = self.order.get(at) else {
            if (left.0, left.1, peak) < self.best_first {
                self.best_first = (left.0, left.1, peak);
                self.best = self.state.assignment();
            }
            return;
        };
        // Lowest resulting workload first: good solutions early.
        let mut options: Vec<(u64, usize)> = Vec::with_capacity(self.problem.mcs[m].hosts.len());
        for host in &self.problem.mcs[m].hosts {
            let c = host.controller as usize;
            let twin_tried = (self.alike[c]..c).any(|d| {
                self.alike[d] == self.alike[c]
                    && self.state.sum_ppm[d] == self.state.sum_ppm[c]
                    && self.state.used_kb(d) == self.state.used_kb(c)
                    && self.state.fits(m, d)
            });
            if self.state.fits(m, c) && !twin_tried {
                let sum = self.state.sum_ppm[c] + self.problem.mcs[m].need_ppm;
                options.push((self.problem.workload_ppm(c, sum), c));
            }
        }
        options.sort_unstable();
        for (workload, c) in options {
            self.state.put(m, c);
            self.first(at + 1, left, peak.max(workload));
            self.state.take(m);
        }
        let evicted = u32::from(self.problem.mcs[m].current.is_some());
        self.first(at + 1, (left.0 + self.penalties[m], left.1 + evicted), peak);
    }

    fn second(&mut self, at: usize, left: (u128, u32), spent: (u64, u64), peak: u64) {
        self.nodes += 1;
        let allowed = (self.best_first.0, self.best_first.1);
        if self.nodes > self.problem.node_limit || left > allowed || peak > self.allowed_ppm {
            return;
        }
        if left == allowed {
            let (cost, moved) = (spent.0 + self.least[at].0, spent.1 + self.least[at].1);
            if (cost, moved, peak) >= self.best_second
                || self.bound_ppm(at, peak) > self.allowed_ppm
            {
                return;
            }
        }
        let Some(&m) = self.order.get(at) else {
            if left == allowed {
                self.best_second = (spent.0, spent.1, peak);
                self.best = self.state.assignment();
            }
            return;
        };
        let mc = &self.problem.mcs[m];
        let mut options: Vec<(u64, u64, u64, usize)> = Vec::with_capacity(mc.hosts.len());
        for host in &mc.hosts {
            let c = host.controller as usize;
            if self.state.fits(m, c) {
                let workload = self
                    .problem
                    .workload_ppm(c, self.state.sum_ppm[c] + mc.need_ppm);
                options.push((host.cost, move_weight(mc, host.controller), workload, c));
            }
        }
        options.sort_unstable();
        for (cost, moved, workload, c) in options {
            self.state.put(m, c);
            self.second(
                at + 1,
                left,
                (spent.0 + cost, spent.1 + moved),
                peak.max(workload),
            );
            self.state.take(m);
        }
        let evicted = u32::from(mc.current.is_some());
        let left = (left.0 + self.penalties[m], left.1 + evicted);
        self.second(at + 1, left, spent, peak);
    }
}
