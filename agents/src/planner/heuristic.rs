//! Construction and local search: good plans for cells of any size in bounded time.
//!
//! Largest need first onto the host that it burdens least; then the highest controller is relieved again and again by moving one
//! MC, by exchanging two, or by a chain of moves, until the lower bound is near, nothing helps, or the work limit is reached.

use super::state::{NOWHERE, State};
use super::{Problem, Worth, allowed_peak_ppm, classes, worth};

/// The search stops when the highest workload is this close to the lower bound, in millionths of the bound.
const GOAL_ABOVE_BOUND_PPM: u64 = 3_000;
/// Placements that one attempt to relieve a controller may look at.
const ATTEMPT_WORK_MAX: u64 = 20_000;
/// Placements that the whole local search may look at.
const SEARCH_WORK_MAX: u64 = 6_000_000;
/// Longest chain of moves that relieves a controller.
const CHAIN_MAX: u32 = 4;

/// The better of a plan that keeps what runs and one from scratch.
pub(super) fn search(problem: &Problem) -> Vec<Option<u32>> {
    let classes = classes(problem);
    let mut kept = construct(problem, true, &by_need(problem));
    improve(&mut kept);
    let mut best = kept.assignment();
    let mut best_worth = worth(problem, &classes, &best);
    let bound = problem.lower_bound_ppm(&best);
    let short = best_worth.left_out.iter().any(|n| *n > 0);
    let running = problem.mcs.iter().any(|m| !m.fixed && m.current.is_some());
    if short
        || (running && best_worth.peak_ppm > bound + problem.tolerance_ppm + goal_margin(bound))
    {
        let mut tries = vec![by_need(problem)];
        if short {
            tries.push(by_criticality(problem));
        }
        for order in tries {
            let mut fresh = construct(problem, false, &order);
            improve(&mut fresh);
            let assignment = fresh.assignment();
            let other = worth(problem, &classes, &assignment);
            if better(problem, &other, &best_worth) {
                (best, best_worth) = (assignment, other);
            }
        }
    }
    go_home(problem, best)
}

/// A plan from scratch has to be better by more than the tolerance: it moves more.
pub(super) fn better(problem: &Problem, fresh: &Worth, kept: &Worth) -> bool {
    let rank = |w: &Worth| (w.left_out.clone(), w.evicted);
    rank(fresh) < rank(kept)
        || (rank(fresh) == rank(kept) && fresh.peak_ppm + problem.tolerance_ppm < kept.peak_ppm)
}

fn goal_margin(bound_ppm: u64) -> u64 {
    bound_ppm * GOAL_ABOVE_BOUND_PPM / 1_000_000
}

fn by_need(problem: &Problem) -> Vec<usize> {
    let mut order: Vec<usize> = (0..problem.mcs.len()).collect();
    order.sort_by_key(|m| (std::cmp::Reverse(problem.mcs[*m].need_ppm), *m));
    order
}

fn by_criticality(problem: &Problem) -> Vec<usize> {
    let mut order = by_need(problem);
    order.sort_by_key(|m| std::cmp::Reverse(problem.mcs[*m].criticality));
    order
}

/// Places what fits, in the given order; with `keep`, what runs stays first of all.
fn construct<'p>(problem: &'p Problem, keep: bool, order: &[usize]) -> State<'p> {
    let mut state = State::new(problem);
    let hosted = |m: usize, c: u32| problem.mcs[m].hosts.iter().any(|h| h.controller == c);
    if keep {
        for &m in order {
            if let (Some(c), false) = (problem.mcs[m].current, problem.mcs[m].fixed)
                && hosted(m, c)
            {
                state.put(m, c as usize);
            }
        }
    }
    let mut without = Vec::new();
    for &m in order {
        if problem.mcs[m].fixed || state.place[m] != NOWHERE {
            continue;
        }
        let best = problem.mcs[m]
            .hosts
            .iter()
            .filter(|h| state.fits(m, h.controller as usize))
            .map(|h| {
                let c = h.controller as usize;
                let sum = state.sum_ppm[c] + problem.mcs[m].need_ppm;
                (problem.workload_ppm(c, sum), h.cost, c)
            })
            .min();
        match best {
            Some((_, _, c)) => state.put(m, c),
            None => without.push(m),
        }
    }
    without.sort_by_key(|m| std::cmp::Reverse(problem.mcs[*m].criticality));
    for m in without {
        make_room(&mut state, m);
    }
    state
}

/// Finds a place for an MC by sending another one away from there.
fn make_room(state: &mut State<'_>, m: usize) {
    let problem = state.problem;
    for host in &problem.mcs[m].hosts {
        let c = host.controller as usize;
        if state.fits(m, c) {
            state.put(m, c);
            return;
        }
        for b in state.on[c].clone() {
            let b = b as usize;
            state.take(b);
            if state.fits(m, c) {
                let other = problem.mcs[b]
                    .hosts
                    .iter()
                    .map(|h| h.controller as usize)
                    .find(|d| *d != c && state.fits(b, *d));
                if let Some(d) = other {
                    state.put(b, d);
                    state.put(m, c);
                    return;
                }
            }
            state.put(b, c);
        }
    }
}

/// Lowers the highest workload until it is near the bound or nothing helps any more.
fn improve(state: &mut State<'_>) {
    let bound = state.problem.lower_bound_ppm(&state.assignment());
    let goal = bound + goal_margin(bound);
    let mut work = 0;
    while work < SEARCH_WORK_MAX {
        let Some((peak, highest)) = (0..state.sum_ppm.len())
            .map(|c| (state.workload_ppm(c), c))
            .max()
        else {
            return;
        };
        if peak <= goal {
            return;
        }
        // The goal at once if it can be had, else half the way, else any progress.
        let steps = [goal, goal + (peak - goal) / 2, peak - 1];
        let relieved = steps.into_iter().any(|level| {
            (1..=CHAIN_MAX).any(|depth| relieve(state, highest, level, depth, &mut work))
        });
        if !relieved {
            return;
        }
    }
}

/// One attempt to bring a controller to a level: what it may cost, and how to take it back.
struct Attempt {
    level_ppm: u64,
    work_left: u64,
    /// MCs moved, with where they were.
    log: Vec<(usize, usize)>,
}

impl Attempt {
    fn shift(&mut self, state: &mut State<'_>, m: usize, to: usize) {
        let from = state.take(m);
        state.put(m, to);
        self.log.push((m, from));
    }

    fn take_back(&mut self, state: &mut State<'_>, len: usize) {
        for (m, from) in self.log.drain(len..).rev() {
            state.take(m);
            state.put(m, from);
        }
    }
}

/// Brings a controller to `level_ppm` or below, with no other one above it, by chains of up to `depth` moves.
fn relieve(state: &mut State<'_>, c: usize, level_ppm: u64, depth: u32, work: &mut u64) -> bool {
    let mut attempt = Attempt {
        level_ppm,
        work_left: ATTEMPT_WORK_MAX,
        log: Vec::new(),
    };
    let done = shed(state, c, depth, &mut attempt);
    *work += ATTEMPT_WORK_MAX - attempt.work_left + 1;
    done
}

/// Moves one MC off controller `c` that needs at least what `c` has too much, the smallest such first, to a host that takes it
/// within the level or sheds in turn.
fn shed(state: &mut State<'_>, c: usize, depth: u32, attempt: &mut Attempt) -> bool {
    let problem = state.problem;
    let need = |m: u32| problem.mcs[m as usize].need_ppm;
    let excess = state.sum_ppm[c].saturating_sub(state.sum_at(c, attempt.level_ppm));
    let mut candidates: Vec<u32> = state.on[c]
        .iter()
        .copied()
        .filter(|m| need(*m) >= excess.max(1))
        .collect();
    candidates.sort_unstable_by_key(|m| (need(*m), *m));
    for m in candidates {
        let m = m as usize;
        for host in &problem.mcs[m].hosts {
            let d = host.controller as usize;
            if d == c {
                continue;
            }
            if attempt.work_left == 0 {
                return false;
            }
            attempt.work_left -= 1;
            let sum = state.sum_ppm[d] + problem.mcs[m].need_ppm;
            let over = sum.saturating_sub(state.sum_at(d, attempt.level_ppm));
            if over == 0 && state.fits(m, d) {
                attempt.shift(state, m, d);
                return true;
            }
            // A chain pays only where what comes back is less than what goes.
            if depth > 1 && over <= problem.mcs[m].need_ppm {
                let len = attempt.log.len();
                attempt.shift(state, m, d);
                if shed(state, d, depth - 1, attempt) && state.holds(c) && state.holds(d) {
                    return true;
                }
                attempt.take_back(state, len);
            }
        }
    }
    false
}

/// Sends MCs back to where they run now as far as the tolerance allows: least state moved.
fn go_home(problem: &Problem, assignment: Vec<Option<u32>>) -> Vec<Option<u32>> {
    let allowed = allowed_peak_ppm(problem, problem.peak_ppm(&assignment));
    let mut state = State::from_assignment(problem, &assignment);
    let mut away: Vec<usize> = (0..problem.mcs.len())
        .filter(|m| {
            let mc = &problem.mcs[*m];
            !mc.fixed
                && assignment[*m].is_some()
                && mc.current.is_some()
                && mc.current != assignment[*m]
        })
        .collect();
    away.sort_by_key(|m| (std::cmp::Reverse(problem.mcs[*m].state_bytes), *m));
    for m in away {
        let mc = &problem.mcs[m];
        let Some(home) = mc.current else { continue };
        let cost = |c: u32| mc.hosts.iter().find(|h| h.controller == c).map(|h| h.cost);
        let (Some(here), Some(there)) = (cost(state.place[m]), cost(home)) else {
            continue;
        };
        let h = home as usize;
        if there <= here
            && state.fits(m, h)
            && state.sum_ppm[h] + mc.need_ppm <= state.sum_at(h, allowed)
        {
            state.take(m);
            state.put(m, h);
        }
    }
    state.assignment()
}
