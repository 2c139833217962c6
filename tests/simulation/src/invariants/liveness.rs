//! **Liveness** (point 10): some time after the last fault every MC that an able controller hosts is driven.

use super::{Facts, Invariant, Seen};

pub(super) struct Liveness;

impl Invariant for Liveness {
    fn name(&self) -> &'static str {
        "an MC that an able controller hosts is driven"
    }

    fn see(&mut self, seen: &Seen<'_>, _facts: &Facts) -> Result<(), String> {
        let Seen::End { must_drive } = seen else {
            return Ok(());
        };
        let missing: Vec<String> = must_drive
            .iter()
            .filter_map(|(mc, why)| Some(format!("{mc}: {}", why.as_ref()?)))
            .collect();
        if missing.is_empty() {
            Ok(())
        } else {
            Err(format!(
                "not driven after the quiet time: {}",
                missing.join("; ")
            ))
        }
    }
}
