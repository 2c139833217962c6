//! A partial assignment with its sums, and the hard limits.

use super::{LIMIT_PPM, Problem};

/// No controller.
pub(super) const NOWHERE: u32 = u32::MAX;

/// Who is where, and what that sums up to.
#[derive(Debug, Clone)]
pub(super) struct State<'p> {
    pub(super) problem: &'p Problem,
    /// Controller of each MC, or [`NOWHERE`].
    pub(super) place: Vec<u32>,
    /// What each controller has to run.
    pub(super) sum_ppm: Vec<u64>,
    /// Free MCs on each controller.
    pub(super) on: Vec<Vec<u32>>,
    memory_kb: Vec<u64>,
    /// Hard limits: the whole cycle and the memory, or what runs there already if that is more.
    hard_ppm: Vec<u64>,
    hard_kb: Vec<u64>,
}

impl<'p> State<'p> {
    /// Only what is fixed is placed.
    pub(super) fn new(problem: &'p Problem) -> State<'p> {
        let count = problem.controllers.len();
        let mut resident_ppm: Vec<u64> = problem.controllers.iter().map(|c| c.base_ppm).collect();
        let mut resident_kb = vec![0; count];
        let mut state = State {
            problem,
            place: vec![NOWHERE; problem.mcs.len()],
            sum_ppm: resident_ppm.clone(),
            on: vec![Vec::new(); count],
            memory_kb: vec![0; count],
            hard_ppm: Vec::new(),
            hard_kb: Vec::new(),
        };
        for (m, mc) in problem.mcs.iter().enumerate() {
            let Some(current) = mc.current else { continue };
            let c = current as usize;
            resident_ppm[c] += mc.need_ppm;
            resident_kb[c] += mc.memory_kb;
            if mc.fixed {
                state.place[m] = current;
                state.sum_ppm[c] += mc.need_ppm;
                state.memory_kb[c] += mc.memory_kb;
            }
        }
        for (c, capacity) in problem.controllers.iter().enumerate() {
            state.hard_ppm.push(capacity.cycle_ppm.max(resident_ppm[c]));
            state.hard_kb.push(capacity.memory_kb.max(resident_kb[c]));
        }
        state
    }

    /// Whether the hard limits let the MC onto the controller as it stands.
    pub(super) fn fits(&self, m: usize, c: usize) -> bool {
        let mc = &self.problem.mcs[m];
        self.sum_ppm[c] + mc.need_ppm <= self.hard_ppm[c]
            && self.memory_kb[c] + mc.memory_kb <= self.hard_kb[c]
    }

    /// Whether controller `c` holds the hard limits.
    pub(super) fn holds(&self, c: usize) -> bool {
        self.sum_ppm[c] <= self.hard_ppm[c] && self.memory_kb[c] <= self.hard_kb[c]
    }

    pub(super) fn put(&mut self, m: usize, c: usize) {
        debug_assert_eq!(self.place[m], NOWHERE);
        let mc = &self.problem.mcs[m];
        self.place[m] = index(c);
        self.sum_ppm[c] += mc.need_ppm;
        self.memory_kb[c] += mc.memory_kb;
        self.on[c].push(index(m));
    }

    pub(super) fn take(&mut self, m: usize) -> usize {
        let mc = &self.problem.mcs[m];
        let c = self.place[m] as usize;
        self.place[m] = NOWHERE;
        self.sum_ppm[c] -= mc.need_ppm;
        self.memory_kb[c] -= mc.memory_kb;
        if let Some(at) = self.on[c].iter().position(|x| *x as usize == m) {
            self.on[c].swap_remove(at);
        }
        c
    }

    /// Memory in use on a controller.
    pub(super) fn used_kb(&self, c: usize) -> u64 {
        self.memory_kb[c]
    }

    pub(super) fn workload_ppm(&self, c: usize) -> u64 {
        self.problem.workload_ppm(c, self.sum_ppm[c])
    }

    /// Highest sum with which the controller's workload does not exceed `workload_ppm`.
    pub(super) fn sum_at(&self, c: usize, workload_ppm: u64) -> u64 {
        workload_ppm * self.problem.controllers[c].capacity_ppm.max(1) / LIMIT_PPM
    }

    pub(super) fn assignment(&self) -> Vec<Option<u32>> {
        self.place
            .iter()
            .map(|c| (*c != NOWHERE).then_some(*c))
            .collect()
    }

    /// Rebuilds a state from an assignment.
    pub(super) fn from_assignment(problem: &'p Problem, assignment: &[Option<u32>]) -> State<'p> {
        let mut state = State::new(problem);
        for (m, place) in assignment.iter().enumerate() {
            if let (Some(c), false) = (place, problem.mcs[m].fixed) {
                state.put(m, *c as usize);
            }
        }
        state
    }
}

/// Positions fit in 32 bits: a cell has far fewer than 2^32 MCs or controllers.
#[allow(clippy::cast_possible_truncation)]
pub(super) fn index(at: usize) -> u32 {
    at as u32
}
