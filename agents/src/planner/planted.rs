//! Problems whose optimum is known because it was planted: for the benchmark and for tests.

use super::state::index;
use super::{Capacity, Demand, Host, NODE_LIMIT, Problem};

/// Workload of every controller in the planted optimum, in millionths of the limit.
const PLANTED_PPM: u64 = 700_000;
/// Hosts beside the planted one.
const OTHER_HOSTS: std::ops::RangeInclusive<u64> = 4..=12;

/// A problem with its optimum.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Planted {
    /// The problem.
    pub problem: Problem,
    /// The lowest possible highest workload, in millionths of the limit.
    pub optimum_ppm: u64,
}

/// Small and good enough to strew needs and hosts (xorshift64*).
struct Xorshift(u64);

impl Xorshift {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }
    fn within(&mut self, range: std::ops::RangeInclusive<u64>) -> u64 {
        range.start() + (self.next() >> 16) % (range.end() - range.start() + 1)
    }
}

/// A cell in which every controller can be loaded to exactly the same share of its limit, which therefore is the optimum:
/// each controller's capacity is cut at random places into the needs of its MCs, then each MC gets further hosts at random.
///
/// # Panics
/// If there are no controllers or fewer MCs than controllers.
#[must_use]
pub fn planted(seed: u64, controllers: usize, mcs: usize) -> Planted {
    assert!(controllers > 0 && mcs >= controllers);
    let mut random = Xorshift(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let mut problem = Problem {
        controllers: Vec::new(),
        mcs: Vec::new(),
        tolerance_ppm: 0,
        node_limit: NODE_LIMIT,
    };
    for c in 0..controllers {
        // CPU factors 0.5 to 2.0 and limits 0.5 to 0.9, in steps that divide without rest.
        let factor_permille = 10 * random.within(50..=200);
        let capacity_ppm = factor_permille * 10 * random.within(50..=90);
        let pieces = mcs / controllers + usize::from(c < mcs % controllers);
        let total = capacity_ppm / 10 * (PLANTED_PPM / 100_000);
        let mut cuts: Vec<u64> = (1..pieces).map(|_| random.within(1..=total - 1)).collect();
        cuts.push(0);
        cuts.push(total);
        cuts.sort_unstable();
        let mut memory_kb = 0;
        for piece in cuts.windows(2) {
            let mut hosts = vec![c];
            let others = random.within(OTHER_HOSTS).min(controllers as u64 - 1);
            for _ in 0..others {
                #[allow(clippy::cast_possible_truncation)] // below `controllers`
                hosts.push(random.within(0..=controllers as u64 - 1) as usize);
            }
            hosts.sort_unstable();
            hosts.dedup();
            let kb = random.within(100..=1_000);
            memory_kb += kb;
            problem.mcs.push(Demand {
                need_ppm: piece[1] - piece[0],
                memory_kb: kb,
                state_bytes: kb * 100,
                criticality: 1,
                hosts: hosts
                    .into_iter()
                    .map(|h| Host {
                        controller: index(h),
                        cost: 0,
                    })
                    .collect(),
                current: None,
                fixed: false,
            });
        }
        problem.controllers.push(Capacity {
            capacity_ppm,
            cycle_ppm: factor_permille * 1_000,
            memory_kb: memory_kb * 2,
            base_ppm: 0,
        });
    }
    Planted {
        problem,
        optimum_ppm: PLANTED_PPM,
    }
}
