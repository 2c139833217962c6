//! Explores all states in breadth, checks each step, and at the end decides liveness on the whole graph.

use crate::action::Action;
use crate::cell::Cell;
use crate::properties::{LIVENESS, Violation};
use crate::state::{Body, Bug, Faults, Pid, Process, State};
use crate::step::World;
use fam_proto::RecordState;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

/// How far the exploration goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// A state in which more epochs have been ordered than these is not gone on from: clocks that race order ever new ones.
    pub activations: u8,
    /// A guard: beyond so many states the exploration ends, and says that it is not complete.
    pub states: usize,
    /// Count the different states of each part (takes a third longer).
    pub parts: bool,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// Different states.
    pub states: usize,
    /// Steps taken between them.
    pub steps: u64,
    /// Longest shortest way from the beginning.
    pub depth: u32,
    /// States at the bound of activations, not gone on from.
    pub at_bound: usize,
    /// States that waited for their turn at once, at most.
    pub waiting: usize,
    /// Whether everything within the bound of activations was explored.
    pub complete: bool,
    /// States in which the MC is driven by a live owner.
    pub driven: usize,
    /// Different states of each part, taken for itself.
    pub parts: BTreeMap<&'static str, usize>,
    /// Grants, by how the epoch before had ended or stood: proof that the interesting things happen.
    pub grants: BTreeMap<String, u64>,
    /// The first broken promise, with the way to it.
    pub violation: Option<(Violation, Vec<String>)>,
}

/// Processes that are kept to be shared, before those that no state has any more go.
const LIVES_MAX: usize = 100_000;

struct Seen {
    parent: u32,
    action: Option<Action>,
    depth: u32,
}

/// Explores everything that can come of the settled cell with these faults.
#[must_use]
pub fn explore(faults: Faults, bounds: Bounds, bug: Option<Bug>) -> Report {
    let cell = Cell::default();
    let world = World { cell: &cell, bug };
    let start = world.prepared(cell.settled(faults));
    let mut search = Search {
        world,
        start: start.clone(),
        seen: Vec::new(),
        ids: BTreeMap::new(),
        parts: BTreeMap::new(),
        lives: BTreeMap::new(),
        good: Vec::new(),
        open: Vec::new(),
        edges: Vec::new(),
        queue: VecDeque::new(),
        report: Report {
            states: 0,
            steps: 0,
            depth: 0,
            at_bound: 0,
            waiting: 0,
            complete: true,
            driven: 0,
            parts: BTreeMap::new(),
            grants: BTreeMap::new(),
            violation: None,
        },
    };
    search.add(start, 0, None, bounds);
    search.run(bounds);
    search.finish()
}

struct Search<'a> {
    world: World<'a>,
    start: State,
    seen: Vec<Seen>,
    ids: BTreeMap<u128, u32>,
    parts: BTreeMap<&'static str, BTreeSet<u128>>,
    /// Processes that states share.
    lives: BTreeMap<(usize, u128), Arc<Process>>,
    /// The MC is driven by a live owner.
    good: Vec<bool>,
    /// Not gone on from.
    open: Vec<bool>,
    /// Steps that are no faults.
    edges: Vec<(u32, u32)>,
    queue: VecDeque<(u32, State)>,
    report: Report,
}

impl Search<'_> {
    /// The number of a state; a new one waits for its turn.
    fn add(&mut self, state: State, parent: u32, action: Option<Action>, bounds: Bounds) -> u32 {
        let fingerprint = state.fingerprint();
        if let Some(id) = self.ids.get(&fingerprint) {
            return *id;
        }
        let id = u32::try_from(self.seen.len()).unwrap_or(u32::MAX);
        self.ids.insert(fingerprint, id);
        if bounds.parts {
            for (name, part) in state.parts() {
                self.parts.entry(name).or_default().insert(part);
            }
        }
        let depth = match action {
            Some(_) => self.seen[parent as usize].depth + 1,
            None => 0,
        };
        self.report.depth = self.report.depth.max(depth);
        self.seen.push(Seen {
            parent,
            action,
            depth,
        });
        self.good.push(self.is_driven(&state));
        let at_bound = state.activations > bounds.activations;
        self.open.push(at_bound);
        if at_bound {
            self.report.at_bound += 1;
        } else {
            let state = self.shared(state);
            self.queue.push_back((id, state));
            self.report.waiting = self.report.waiting.max(self.queue.len());
        }
        id
    }

    /// The state with those of its processes that others have, too.
    fn shared(&mut self, mut state: State) -> State {
        if self.lives.len() >= LIVES_MAX {
            self.lives.retain(|_, life| Arc::strong_count(life) > 1);
        }
        for (at, process) in state.processes.iter_mut().enumerate() {
            if let Some(process) = process {
                let key = (at, process.words().exact());
                let life = self.lives.entry(key).or_insert_with(|| Arc::clone(process));
                *process = Arc::clone(life);
            }
        }
        state
    }

    fn run(&mut self, bounds: Bounds) {
        while let Some((id, state)) = self.queue.pop_front() {
            if self.seen.len() >= bounds.states {
                self.report.complete = false;
                self.open[id as usize] = true;
                for (id, _) in self.queue.drain(..) {
                    self.open[id as usize] = true;
                }
                return;
            }
            for action in self.world.actions(&state) {
                self.report.steps += 1;
                match self.world.step(&state, &action) {
                    Ok(next) => {
                        self.count_grant(&state, &next);
                        let to = self.add(next, id, Some(action), bounds);
                        if !action.is_fault() && to != id {
                            self.edges.push((to, id));
                        }
                    }
                    Err(violation) => {
                        self.report.complete = false;
                        let mut way = self.way(id);
                        way.push(format!("{action:?}"));
                        self.report.violation = Some((violation, way));
                        return;
                    }
                }
            }
        }
    }

    fn finish(mut self) -> Report {
        self.report.states = self.seen.len();
        let parts = std::mem::take(&mut self.parts);
        self.report.parts = parts
            .into_iter()
            .map(|(name, seen)| (name, seen.len()))
            .collect();
        self.report.driven = self.good.iter().filter(|good| **good).count();
        if self.report.violation.is_none()
            && let Some(stuck) = stuck(&self.good, &self.open, &mut self.edges)
        {
            let text = "from here no way leads to a state in which the MC is driven".to_owned();
            let violation = Violation {
                property: LIVENESS,
                text,
            };
            self.report.violation = Some((violation, self.way(stuck)));
        }
        self.report
    }

    fn is_driven(&self, state: &State) -> bool {
        let Some(gate) = state.gateway().and_then(|g| g.gate(&self.world.cell.mc)) else {
            return false;
        };
        let ledger = gate.ledger();
        let Some(owner) = &ledger.owner else {
            return false;
        };
        let node = self
            .world
            .cell
            .controllers
            .iter()
            .position(|c| *c == owner.controller);
        let lives = node.is_some_and(|n| {
            let runs = state.node(n).and_then(|(_, plc)| plc.active.as_ref());
            state.boot(Pid::Node(n)) == Some(owner.boot)
                && runs.is_some_and(|active| active.epoch == ledger.epoch)
        });
        ledger.state == RecordState::Open && ledger.driven && lives
    }

    fn count_grant(&mut self, before: &State, after: &State) {
        if before.facts.grant == after.facts.grant {
            return;
        }
        let Some(gateway) = before.gateway() else {
            return;
        };
        if let Some(gate) = gateway.gate(&self.world.cell.mc) {
            let word = gate.ledger().state.word();
            let driven = if gate.ledger().driven {
                ""
            } else {
                ", not driven"
            };
            let how = format!("after {word}{driven}");
            *self.report.grants.entry(how).or_default() += 1;
        }
    }

    /// The way to a state, in words.
    fn way(&self, to: u32) -> Vec<String> {
        let mut actions = Vec::new();
        let mut at = to;
        while let Some(action) = self.seen[at as usize].action {
            actions.push(action);
            at = self.seen[at as usize].parent;
        }
        actions.reverse();
        let mut state = self.start.clone();
        let mut words = Vec::new();
        for action in actions {
            words.push(tell(&state, &action));
            match self.world.step(&state, &action) {
                Ok(next) => state = next,
                Err(violation) => {
                    words.push(violation.to_string());
                    break;
                }
            }
        }
        words
    }
}

/// The first state from which no step that is no fault leads on to a good one, or out of what was explored. Edges are `(to, from)`.
fn stuck(good: &[bool], open: &[bool], edges: &mut [(u32, u32)]) -> Option<u32> {
    edges.sort_unstable();
    let mut reaches: Vec<bool> = good.iter().zip(open).map(|(g, o)| *g || *o).collect();
    let mut work: Vec<u32> = (0..u32::try_from(reaches.len()).unwrap_or(u32::MAX))
        .filter(|n| reaches[*n as usize])
        .collect();
    while let Some(to) = work.pop() {
        let first = edges.partition_point(|(t, _)| *t < to);
        for (_, from) in edges[first..].iter().take_while(|(t, _)| *t == to) {
            if !reaches[*from as usize] {
                reaches[*from as usize] = true;
                work.push(*from);
            }
        }
    }
    let stuck = reaches.iter().position(|reaches| !reaches)?;
    u32::try_from(stuck).ok()
}

/// An action in words, in the state in which it is taken.
fn tell(state: &State, action: &Action) -> String {
    let flight = |n: &usize| {
        state.flights.get(*n).map_or_else(String::new, |f| {
            let packet = match &*f.packet {
                crate::state::Packet::Message(m) => format!("{:?}", m.body),
                crate::state::Packet::Frame(f) => {
                    format!("frame {} of epoch {}", f.header.scan, f.header.epoch)
                }
            };
            let short: String = packet.chars().take(160).collect();
            format!(" {:?} to {:?}: {short}", f.from, f.to)
        })
    };
    match action {
        Action::Deliver(n)
        | Action::Hold(n)
        | Action::Lose(n)
        | Action::Repeat(n)
        | Action::DeliverAndCrash(n) => {
            format!("{action:?}{}", flight(n))
        }
        Action::Time(pid) | Action::TimeAndCrash(pid) => {
            let why = state.process(*pid).and_then(|p| match &p.body {
                Body::Manager(m) => fam_proto::Agent::poll_timeout(m),
                Body::Gateway(g) => fam_proto::Agent::poll_timeout(g),
                Body::Node(n, ..) => fam_proto::Agent::poll_timeout(n),
            });
            format!("{action:?} ({})", why.map_or("", |(_, why)| why))
        }
        _ => format!("{action:?}"),
    }
}

#[cfg(test)]
mod tests {
    use super::stuck;

    #[test]
    fn who_cannot_get_out_of_a_loop_is_stuck() {
        // 0 -> 1 -> 2 (good); 3 <-> 4 is a loop of its own, 5 -> 3; 6 was not gone on from, 7 -> 6.
        let edges = [(1, 0), (2, 1), (4, 3), (3, 4), (3, 5), (6, 7)];
        let mut good = vec![false; 8];
        good[2] = true;
        let mut open = vec![false; 8];
        open[6] = true;
        assert_eq!(stuck(&good, &open, &mut edges.clone()), Some(3));
        let mut mended = edges.to_vec();
        mended.push((2, 4));
        assert_eq!(stuck(&good, &open, &mut mended), None);
    }
}
