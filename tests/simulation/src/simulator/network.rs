//! The network between processes: delay, loss, duplication, reordering, cuts in either direction.
//!
//! In calm weather a link keeps its order and loses nothing, as TCP does. What is sent into a cut is lost, or arrives very late.

use super::random::Random;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A process, by its place in the simulated cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Pid {
    /// The manager.
    Manager,
    /// A second manager of the same cell, on a copy of the repository.
    Rival,
    /// The gateway.
    Gateway,
    /// A controller node.
    Node(usize),
    /// The operator's commands.
    Operator,
}

impl std::fmt::Display for Pid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Pid::Manager => f.pad("manager"),
            Pid::Rival => f.pad("rival"),
            Pid::Gateway => f.pad("gateway"),
            Pid::Node(n) => f.pad(&format!("node{}", n + 1)),
            Pid::Operator => f.pad("operator"),
        }
    }
}

impl From<Pid> for String {
    fn from(pid: Pid) -> String {
        pid.to_string()
    }
}

impl TryFrom<String> for Pid {
    type Error = String;

    fn try_from(name: String) -> Result<Pid, String> {
        let node = name.strip_prefix("node").and_then(|n| n.parse().ok());
        match (name.as_str(), node) {
            ("manager", _) => Ok(Pid::Manager),
            ("rival", _) => Ok(Pid::Rival),
            ("gateway", _) => Ok(Pid::Gateway),
            ("operator", _) => Ok(Pid::Operator),
            (_, Some(1usize..)) => Ok(Pid::Node(node.unwrap_or(1) - 1)),
            _ => Err(format!(
                "`{name}` is no process of a simulated cell: expected manager, rival, gateway, operator, node1, node2, ..."
            )),
        }
    }
}

/// How the network behaves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Weather {
    /// Shortest and longest delay, in microseconds.
    pub delay_us: (u64, u64),
    /// Messages lost, in a thousand.
    pub lost_permille: u64,
    /// Messages doubled, in a thousand.
    pub doubled_permille: u64,
    /// Whether each link keeps its order.
    pub ordered: bool,
}

/// Loopback or a good switch.
pub const CALM: Weather = Weather {
    delay_us: (60, 350),
    lost_permille: 0,
    doubled_permille: 0,
    ordered: true,
};

#[derive(Debug, Clone, Copy)]
struct Cut {
    since_us: u64,
    count: u32,
}

/// Longest delay of a message that was sent into a cut and is not lost, in microseconds.
const HELD_BACK_US: u64 = 1_500_000;
/// Share of the messages sent into a cut that arrive late, in a thousand.
const HELD_BACK_PERMILLE: u64 = 200;

/// The network.
#[derive(Debug)]
pub struct Network {
    weather: Weather,
    cuts: BTreeMap<(Pid, Pid), Cut>,
    /// Directions that take longer than the others, and by how much.
    slow_us: BTreeMap<(Pid, Pid), u64>,
    last_us: BTreeMap<(Pid, Pid), u64>,
    /// Each direction has chances of its own: what is sent elsewhere changes nothing here.
    chances: BTreeMap<(Pid, Pid), Random>,
    seed: u64,
    /// How long a silent link keeps its liveliness tokens, in microseconds.
    pub lease_us: u64,
}

impl Network {
    /// A calm network.
    #[must_use]
    pub fn new(seed: u64, lease_us: u64) -> Network {
        Network {
            weather: CALM,
            cuts: BTreeMap::new(),
            slow_us: BTreeMap::new(),
            last_us: BTreeMap::new(),
            chances: BTreeMap::new(),
            seed,
            lease_us,
        }
    }

    /// From now on it behaves like this.
    pub fn set_weather(&mut self, weather: Weather) {
        self.weather = weather;
    }

    /// From now on a direction takes this much longer than the others; 0: no more.
    pub fn slow_down(&mut self, from: Pid, to: Pid, by_us: u64) {
        if by_us == 0 {
            self.slow_us.remove(&(from, to));
        } else {
            self.slow_us.insert((from, to), by_us);
        }
    }

    /// Cuts a direction once more.
    pub fn cut(&mut self, from: Pid, to: Pid, now_us: u64) {
        let cut = self.cuts.entry((from, to)).or_insert(Cut {
            since_us: now_us,
            count: 0,
        });
        cut.count += 1;
    }

    /// Takes one cut of a direction back; whether it is whole again.
    pub fn heal(&mut self, from: Pid, to: Pid) -> bool {
        let Some(cut) = self.cuts.get_mut(&(from, to)) else {
            return true;
        };
        cut.count -= 1;
        if cut.count == 0 {
            self.cuts.remove(&(from, to));
            return true;
        }
        false
    }

    /// Since when a direction is cut.
    #[must_use]
    pub fn cut_since(&self, from: Pid, to: Pid) -> Option<u64> {
        self.cuts.get(&(from, to)).map(|c| c.since_us)
    }

    /// When a message sent now arrives, and when its copy does. Nothing: it is lost.
    pub fn arrivals(&mut self, from: Pid, to: Pid, now_us: u64) -> [Option<u64>; 2] {
        let seed = self.seed;
        let random = self
            .chances
            .entry((from, to))
            .or_insert_with(|| Random::new(seed, stream(from) << 32 | stream(to)));
        if self.cuts.contains_key(&(from, to)) {
            let held = random.chance(HELD_BACK_PERMILLE);
            return [
                held.then(|| now_us + random.between(1_000, HELD_BACK_US)),
                None,
            ];
        }
        let weather = self.weather;
        let now_us = now_us + self.slow_us.get(&(from, to)).copied().unwrap_or(0);
        let mut one = |random: &mut Random| {
            let mut at = now_us + random.between(weather.delay_us.0, weather.delay_us.1);
            if weather.ordered {
                let last = self.last_us.entry((from, to)).or_default();
                at = at.max(*last);
                *last = at;
            }
            at
        };
        if random.chance(weather.lost_permille) {
            return [None, None];
        }
        let first = one(random);
        let copy = random.chance(weather.doubled_permille).then(|| one(random));
        [Some(first), copy]
    }
}

/// The stream of chance that belongs to a process.
#[must_use]
pub fn stream(pid: Pid) -> u64 {
    match pid {
        Pid::Manager => 11,
        Pid::Rival => 12,
        Pid::Gateway => 13,
        Pid::Operator => 14,
        Pid::Node(n) => 100 + n as u64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_processes_read_back() {
        for pid in [
            Pid::Manager,
            Pid::Rival,
            Pid::Gateway,
            Pid::Operator,
            Pid::Node(0),
            Pid::Node(41),
        ] {
            assert_eq!(Pid::try_from(pid.to_string()), Ok(pid));
        }
        for bad in ["node0", "node", "nodes", "", "Manager"] {
            assert!(Pid::try_from(bad.to_owned()).is_err(), "{bad}");
        }
    }

    #[test]
    fn calm_links_keep_their_order_and_cuts_count() {
        let mut network = Network::new(3, 1);
        let (a, b) = (Pid::Gateway, Pid::Node(0));
        let mut last = 0;
        for n in 0..100 {
            let [Some(at), None] = network.arrivals(a, b, n) else {
                panic!("lost or doubled in calm weather");
            };
            assert!(at >= last);
            last = at;
        }
        network.cut(a, b, 5);
        network.cut(a, b, 6);
        assert_eq!(network.cut_since(a, b), Some(5));
        assert_eq!(network.cut_since(b, a), None);
        assert!(!network.heal(a, b));
        assert!(network.heal(a, b));
    }
}
