//! Epochs of the MCs, reserved in durable blocks ahead of their use, so that a failover waits for no disk.
//!
//! An epoch is given out once, above everything that any gateway's record has shown, and only if the repository has confirmed
//! a block that contains it. After a restart the numbers go on above the last block, whatever of it was used.

use fam_proto::{Epoch, McId};
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};

/// Epochs in a block.
pub const BLOCK: u64 = 64;
/// A new block is asked for when so few are left.
const LOW: u64 = 16;
/// A record that is further ahead than this is no record: no cell activates an MC so often. Following it would let one
/// damaged message use up all numbers.
pub const AHEAD_MAX: u64 = 1 << 32;
/// Numbers end here, far above what [`AHEAD_MAX`] lets anyone reach: nothing is given out above, and nothing overflows.
const LAST: u64 = u64::MAX - 2 * BLOCK;

/// A block that has to be made durable before its epochs count.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Block {
    /// The MC.
    pub mc: McId,
    /// Highest epoch of the block.
    pub upto: Epoch,
}

#[derive(Debug, Clone, PartialEq, Eq)]
struct Numbers {
    /// Next to be given out.
    next: u64,
    /// Up to here the repository has confirmed.
    durable: u64,
    /// Asked for, not confirmed yet.
    asked: Option<u64>,
}

// What is given out next is above everything given out or seen: only whether it can be given out is a part of the state.
impl Hash for Numbers {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.next <= self.durable, self.asked.is_some()).hash(state);
    }
}

/// The epochs of all MCs.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Epochs {
    numbers: BTreeMap<McId, Numbers>,
}

impl Epochs {
    /// Goes on above what the repository has reserved for each MC.
    #[must_use]
    pub fn new<'a>(
        mcs: impl Iterator<Item = &'a McId>,
        reserved: &BTreeMap<McId, Epoch>,
    ) -> Epochs {
        let numbers = mcs
            .map(|mc| {
                let upto = reserved.get(mc).map_or(0, |e| e.0);
                let numbers = Numbers {
                    next: upto.saturating_add(1),
                    durable: upto,
                    asked: None,
                };
                (mc.clone(), numbers)
            })
            .collect();
        Epochs { numbers }
    }

    /// A record shows this epoch: numbers go on above it, unless it is out of all reason ([`AHEAD_MAX`]).
    pub fn seen(&mut self, mc: &McId, epoch: Epoch) {
        if let Some(numbers) = self.numbers.get_mut(mc) {
            let next = epoch.0.saturating_add(1);
            if next <= numbers.next.saturating_add(AHEAD_MAX) {
                numbers.next = numbers.next.max(next);
            }
        }
    }

    /// Blocks that have to be asked for now; each is asked for once until it is confirmed or failed.
    pub fn wanted(&mut self) -> Vec<Block> {
        let mut wanted = Vec::new();
        for (mc, numbers) in &mut self.numbers {
            let few = numbers.next.saturating_add(LOW) > numbers.durable;
            if numbers.asked.is_none() && few && numbers.next <= LAST {
                let upto = numbers.next.max(numbers.durable).saturating_add(BLOCK - 1);
                numbers.asked = Some(upto);
                wanted.push(Block {
                    mc: mc.clone(),
                    upto: Epoch(upto),
                });
            }
        }
        wanted
    }

    /// The repository has answered for a block.
    pub fn answered(&mut self, block: &Block, durable: bool) {
        if let Some(numbers) = self.numbers.get_mut(&block.mc)
            && numbers.asked == Some(block.upto.0)
        {
            numbers.asked = None;
            if durable {
                numbers.durable = numbers.durable.max(block.upto.0);
            }
        }
    }

    /// Gives out the next epoch, if it is durable.
    pub fn take(&mut self, mc: &McId) -> Option<Epoch> {
        let numbers = self.numbers.get_mut(mc)?;
        (numbers.next <= numbers.durable.min(LAST)).then(|| {
            numbers.next += 1;
            Epoch(numbers.next - 1)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn mc() -> McId {
        McId::new("m").unwrap()
    }

    #[test]
    fn nothing_is_given_out_before_its_block_is_durable() {
        let mut epochs = Epochs::new([mc()].iter(), &BTreeMap::from([(mc(), Epoch(64))]));
        assert_eq!(epochs.take(&mc()), None);
        let block = epochs.wanted().remove(0);
        assert_eq!(block.upto, Epoch(128));
        assert_eq!(epochs.wanted(), []);
        epochs.answered(&block, false);
        assert_eq!(epochs.take(&mc()), None);
        let block = epochs.wanted().remove(0);
        epochs.answered(&block, true);
        assert_eq!(epochs.take(&mc()), Some(Epoch(65)));
        epochs.seen(&mc(), Epoch(500));
        assert_eq!(epochs.take(&mc()), None);
        let block = epochs.wanted().remove(0);
        epochs.answered(&block, true);
        assert_eq!(epochs.take(&mc()), Some(Epoch(501)));
    }

    #[test]
    fn a_record_from_nowhere_uses_up_no_numbers() {
        let mut epochs = Epochs::new([mc()].iter(), &BTreeMap::new());
        epochs.seen(&mc(), Epoch(u64::MAX));
        epochs.seen(&mc(), Epoch(AHEAD_MAX + 1));
        assert_eq!(epochs.wanted()[0].upto, Epoch(BLOCK));
        // Used up they are reported as not there, rather than given out twice.
        let disk = BTreeMap::from([(mc(), Epoch(u64::MAX))]);
        let mut epochs = Epochs::new([mc()].iter(), &disk);
        assert_eq!((epochs.wanted(), epochs.take(&mc())), (vec![], None));
    }

    proptest! {
        /// Random use with crashes in between: what is given out only ever grows, and stays within what the disk holds.
        #[test]
        fn epochs_only_grow_across_restarts(steps in prop::collection::vec(0..5u8, 1..300)) {
            let mut disk = BTreeMap::new();
            let mut epochs = Epochs::new([mc()].iter(), &disk);
            let (mut last, mut seen) = (0, 0);
            for step in steps {
                match step {
                    0 => epochs = Epochs::new([mc()].iter(), &disk),
                    1 => {
                        seen += 7;
                        epochs.seen(&mc(), Epoch(seen));
                    }
                    2 => for block in epochs.wanted() {
                        epochs.answered(&block, false);
                    },
                    3 => for block in epochs.wanted() {
                        disk.insert(block.mc.clone(), block.upto);
                        epochs.answered(&block, true);
                    },
                    _ => if let Some(epoch) = epochs.take(&mc()) {
                        prop_assert!(epoch.0 > last && epoch.0 <= disk[&mc()].0);
                        last = epoch.0;
                    },
                }
            }
        }
    }
}
