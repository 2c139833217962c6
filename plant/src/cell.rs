//! The cell as the servers share it: whoever looks at it brings it up to the present first.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use fam_plant_core::{ConfigError, Mechanics, PlantConfig, machine};
use tracing::warn;

use crate::pace::Pace;
use crate::status::PlantStatus;

/// Lag is worth a line in the log only if it grows by this much.
const LAG_WORTH_TELLING_US: u64 = 100_000;

pub(crate) struct Cell {
    inner: Mutex<Inner>,
}

struct Inner {
    plant: Box<dyn Mechanics>,
    pace: Pace,
    started: Instant,
    requests: u64,
    told_incidents: usize,
    told_lag_us: u64,
}

impl Cell {
    pub fn new(config: PlantConfig, time_scale: f64) -> Result<Self, ConfigError> {
        let inner = Inner {
            plant: machine(config)?,
            pace: Pace::new(time_scale),
            started: Instant::now(),
            requests: 0,
            told_incidents: 0,
            told_lag_us: 0,
        };
        Ok(Cell {
            inner: Mutex::new(inner),
        })
    }

    /// Brings the cell up to the present.
    pub fn advance(&self) {
        self.with(|_| ());
    }

    /// A request of a controller to the cell as it is now.
    pub fn request<R>(&self, request: impl FnOnce(&mut dyn Mechanics) -> R) -> R {
        self.with(|inner| {
            inner.requests += 1;
            inner.plant.heard();
            request(inner.plant.as_mut())
        })
    }

    /// What happened so far; `whole` with products and incidents one by one.
    pub fn status(&self, whole: bool) -> PlantStatus {
        self.with(|inner| {
            let plant = &inner.plant;
            PlantStatus {
                time_us: plant.now_us(),
                lag_us: inner.pace.lag_us(),
                config: plant.config(),
                modbus_requests: inner.requests,
                finished: plant.finished(),
                incidents_total: plant.incidents_total(),
                ledger: plant.ledger(),
                products: if whole {
                    plant.products().to_vec()
                } else {
                    Vec::new()
                },
                incidents: if whole {
                    plant.incidents().to_vec()
                } else {
                    Vec::new()
                },
            }
        })
    }

    fn with<R>(&self, action: impl FnOnce(&mut Inner) -> R) -> R {
        // Even if a request had panicked, the next one finds a cell whose parts add up: each write and each tick is whole.
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        let elapsed = inner.started.elapsed();
        inner.advance(elapsed);
        action(&mut inner)
    }
}

impl Inner {
    fn advance(&mut self, elapsed: Duration) {
        let due_us = self.pace.due_us(elapsed);
        self.plant.step(due_us);
        for incident in self.plant.incidents().iter().skip(self.told_incidents) {
            warn!("incident: {incident}");
        }
        self.told_incidents = self.plant.incidents().len();
        if self.pace.lag_us() >= self.told_lag_us + LAG_WORTH_TELLING_US {
            self.told_lag_us = self.pace.lag_us();
            warn!(
                "the plant process was stalled: simulated time is {} ms behind in all",
                self.told_lag_us / 1000
            );
        }
    }
}
