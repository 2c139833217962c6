//! Time as an argument: a count of microseconds on a monotonic clock whose zero the driver chooses.

use crate::mark::{Mark, hash_marked};
use serde::{Deserialize, Serialize};

/// A moment on one process's monotonic clock, in microseconds. Moments of two processes are never compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
pub struct Now(pub u64);

impl std::hash::Hash for Now {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        hash_marked(Mark::Now, self.0, state);
    }
}

impl Now {
    /// The moment `us` microseconds later.
    #[must_use]
    pub fn plus_us(self, us: u64) -> Now {
        Now(self.0.saturating_add(us))
    }

    /// The moment `ms` milliseconds later.
    #[must_use]
    pub fn plus_ms(self, ms: u64) -> Now {
        self.plus_us(ms.saturating_mul(1_000))
    }

    /// Microseconds since `earlier`, 0 if `earlier` lies ahead.
    #[must_use]
    pub fn since_us(self, earlier: Now) -> u64 {
        self.0.saturating_sub(earlier.0)
    }
}

impl std::fmt::Display for Now {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{:06} s", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}
