//! Which image of a gateway is the newest that can be believed.
//!
//! Within a life of the gateway that is the one with the highest number, as long as the time since the last explains it: one
//! damaged number must not make the node deaf to the images to come. Another life is believed with its second image in
//! succession if its number is higher (numbers grow over restarts, boot ids need not: they come from a wall clock), and else
//! when the one in force is silent.

use fam_proto::{BootId, ImageNumber, Now};

/// No gateway sends images faster than this, in microseconds.
const IMAGE_US_MIN: u64 = 500;
/// So many images may be missed at once beside those that the time explains.
const AHEAD: u64 = 4;
/// A life that is silent for this long gives way to any other, in microseconds.
const SILENT_US: u64 = 200_000;

/// What was believed last.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Known {
    boot: BootId,
    number: ImageNumber,
    at: Now,
}

/// The newest image of one gateway.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Newest {
    known: Option<Known>,
    /// Of another life, and not yet believed.
    other: Option<Known>,
}

impl Newest {
    /// Whether this image, come at `now`, takes the place of the one before.
    pub fn admit(&mut self, boot: BootId, number: ImageNumber, now: Now) -> bool {
        let this = Known {
            boot,
            number,
            at: now,
        };
        let Some(known) = self.known else {
            self.known = Some(this);
            return true;
        };
        let good = if boot == known.boot {
            follows(known, this)
        } else {
            let silent = now.since_us(known.at) >= SILENT_US;
            let second = self
                .other
                .is_some_and(|other| other.boot == boot && follows(other, this));
            let later = number > known.number || silent;
            if later {
                self.other = Some(this);
            }
            second && later
        };
        if good {
            *self = Newest {
                known: Some(this),
                other: None,
            };
        }
        good
    }
}

/// Whether an image can come after another of the same life.
fn follows(before: Known, this: Known) -> bool {
    let ahead = this.number.0.saturating_sub(before.number.0);
    ahead > 0 && ahead <= AHEAD + this.at.since_us(before.at) / IMAGE_US_MIN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_numbers_and_boots_make_nobody_deaf() {
        let mut newest = Newest::default();
        let mut admit = |boot, number, ms: u64| {
            newest.admit(BootId(boot), ImageNumber(number), Now(0).plus_ms(ms))
        };
        for (boot, number, ms, expected) in [
            (5, 10, 0, true),
            (5, 10, 5, false),
            (5, 9, 5, false),
            (5, 11, 5, true),
            // A number from nowhere, and the next true one.
            (5, u64::MAX, 6, false),
            (5, 12, 10, true),
            // A boot id from nowhere, once and again with another number.
            (u64::MAX, 13, 11, false),
            (u64::MAX, 99_999, 12, false),
            (5, 13, 15, true),
            // The gateway was restarted: believed with its second image.
            (6, 1 << 32, 100, false),
            (6, (1 << 32) + 1, 105, true),
            (5, 14, 106, false),
            (5, 15, 107, false),
            // A long silence explains many images.
            (6, (1 << 32) + 1_001, 5_105, true),
            // It was restarted with an earlier clock.
            (3, 2 << 32, 5_110, false),
            (3, (2 << 32) + 1, 5_115, true),
            // It was restarted with a new record file: heard when the other life is silent.
            (7, 1, 5_120, false),
            (7, 2, 5_125, false),
            (7, 60, 5_410, false),
            (7, 61, 5_415, true),
        ] {
            assert_eq!(
                admit(boot, number, ms),
                expected,
                "{boot} {number} at {ms} ms"
            );
        }
    }
}
