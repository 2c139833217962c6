//! **The repository keeps what it has promised** (point 3): epochs whose block was answered as durable are there after every restart,
//! whatever the disk did in between.

use super::{Facts, Invariant, Seen};

pub(super) struct RepositoryKeeps;

impl Invariant for RepositoryKeeps {
    fn name(&self) -> &'static str {
        "the repository keeps what it has promised"
    }

    fn see(&mut self, seen: &Seen<'_>, _: &Facts) -> Result<(), String> {
        match seen {
            Seen::Restored { lost } if !lost.is_empty() => Err(format!(
                "epochs that were durable are gone: {}",
                lost.join("; ")
            )),
            _ => Ok(()),
        }
    }
}
