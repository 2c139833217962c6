//! Real time for the mechanics: how much simulated time is due, with a bound after a stall.

use std::time::Duration;

/// Simulated time that is made up for at once, at time scale 1. What a longer stall of the process leaves behind is lag: the
/// cell must not leap ahead of controllers that could not see it meanwhile.
const CATCH_UP_MAX_US: f64 = 50_000.0;

#[derive(Clone, Debug)]
pub(crate) struct Pace {
    scale: f64,
    given_us: u64,
    lag_us: u64,
}

impl Pace {
    /// `scale` is simulated time by real time.
    pub fn new(scale: f64) -> Self {
        Pace {
            scale,
            given_us: 0,
            lag_us: 0,
        }
    }

    /// Simulated time that is due after so much real time since the start.
    pub fn due_us(&mut self, elapsed: Duration) -> u64 {
        let target_us = (elapsed.as_secs_f64() * 1e6 * self.scale) as u64;
        let due_us = target_us.saturating_sub(self.given_us + self.lag_us);
        let bound_us = (CATCH_UP_MAX_US * self.scale.max(1.0)) as u64;
        let given_us = due_us.min(bound_us);
        self.given_us += given_us;
        self.lag_us += due_us - given_us;
        given_us
    }

    /// Simulated time by which the cell is behind.
    pub fn lag_us(&self) -> u64 {
        self.lag_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gives_the_time_that_has_passed_and_bounds_a_stall() {
        // (elapsed ms, due us, lag us after it)
        let table = [
            (0, 0, 0),
            (5, 5_000, 0),
            (5, 0, 0),
            (55, 50_000, 0),
            (355, 50_000, 250_000),
            (360, 5_000, 250_000),
        ];
        let mut pace = Pace::new(1.0);
        for (elapsed_ms, due_us, lag_us) in table {
            assert_eq!(
                (
                    pace.due_us(Duration::from_millis(elapsed_ms)),
                    pace.lag_us()
                ),
                (due_us, lag_us),
                "at {elapsed_ms} ms"
            );
        }
    }

    #[test]
    fn a_faster_clock_gives_more_and_may_catch_up_more() {
        let mut pace = Pace::new(10.0);
        assert_eq!(pace.due_us(Duration::from_millis(20)), 200_000);
        assert_eq!(pace.lag_us(), 0);
    }
}
