//! **One writer** (point 11): a field device has one serial writer. What its gateway writes arrives once and in that order, each MC's
//! outputs and no others, and nothing of a gateway's earlier life after something of a later one.

use super::{Facts, Invariant, Seen};
use fam_proto::{BootId, McId};
use std::collections::VecDeque;

/// Writes on their way at most: more is a gateway whose writes go nowhere.
const WRITES_MAX: usize = 100_000;

#[derive(Default)]
pub(super) struct OneWriter {
    begun: VecDeque<(BootId, McId, Vec<u8>)>,
}

impl Invariant for OneWriter {
    fn name(&self) -> &'static str {
        "one writer"
    }

    fn see(&mut self, seen: &Seen<'_>, facts: &Facts) -> Result<(), String> {
        match seen {
            Seen::WriteBegun {
                gateway,
                mc,
                outputs,
            } => {
                let len = facts.mc(mc)?.model.fail_safe.len();
                if outputs.len() != len {
                    return Err(format!(
                        "{mc}: {} bytes of outputs are written, it has {len}",
                        outputs.len()
                    ));
                }
                let begun = (*gateway, (*mc).clone(), outputs.to_vec());
                self.begun.push_back(begun);
                if self.begun.len() > WRITES_MAX {
                    return Err(format!("{mc}: writes to the field do not arrive"));
                }
                Ok(())
            }
            Seen::Written {
                gateway,
                mc,
                outputs,
            } => match self.begun.pop_front() {
                Some((by, of, what)) if (by, &of, what.as_slice()) == (*gateway, *mc, *outputs) => {
                    Ok(())
                }
                expected => Err(format!(
                    "{mc}: a write reaches the field that is not the next one of its gateway (next is {})",
                    expected.map_or_else(|| "none".to_owned(), |(_, of, _)| format!("one of {of}"))
                )),
            },
            _ => Ok(()),
        }
    }
}
