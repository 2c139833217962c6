//! How numbers that only grow, and moments, are hashed: with a mark of their kind.
//!
//! No agent looks at the absolute value of an epoch, a boot id or a moment; it compares them, and counts on. So two states that
//! differ in nothing else are one state to whoever explores states. A hasher that knows the marks (`tests/model-check`)
//! can put ranks and distances in their place; for every other hasher they are bytes like others.

use std::hash::Hasher;

/// High half of every marked word.
pub const MARK: u128 = 0x4641_4D5F_4D41_524B << 64;

/// Kinds of marked numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Mark {
    /// A moment on the process's clock.
    Now = 1,
    /// [`crate::Epoch`].
    Epoch = 2,
    /// [`crate::Scan`].
    Scan = 3,
    /// [`crate::BootId`].
    Boot = 4,
    /// [`crate::ImageNumber`].
    Image = 5,
    /// [`crate::OrderId`].
    Order = 6,
    /// [`crate::PlanId`].
    Plan = 7,
    /// [`crate::Digest`]: compared for equality only.
    Digest = 8,
    /// A counter of an agent's own.
    Count = 9,
    /// Number of a negotiation.
    Negotiation = 10,
}

/// Feeds a number with its mark.
pub fn hash_marked<H: Hasher>(mark: Mark, value: u64, state: &mut H) {
    state.write_u8(mark as u8);
    state.write_u128(MARK | u128::from(value));
}
