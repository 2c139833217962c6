//! Who may put events into the history, and how many: each one is kept on disk, so that a process gone wild must not fill it.

use crate::cell_view::CellView;
use fam_proto::{AgentId, McId, Now, ProcessId};
use std::collections::BTreeMap;

/// Events of one process in [`WINDOW_US`] at most.
pub const EVENTS_MAX: u32 = 200;
/// The time in which they are counted, in microseconds.
pub const WINDOW_US: u64 = 10_000_000;

/// Counts of the processes of the model; there are no others.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Tellers(BTreeMap<ProcessId, (Now, u32)>);

impl Tellers {
    /// Whether something is to be taken that goes into the history: its teller and its MC are of the cell, and there were not too many of late.
    pub(super) fn admit(
        &mut self,
        from: &AgentId,
        mc: Option<&McId>,
        view: &CellView,
        now: Now,
    ) -> bool {
        let process = from.process();
        // All operators together count as one.
        let process = match process {
            ProcessId::Client(_) => ProcessId::Client(0),
            other => other,
        };
        let known = match &process {
            ProcessId::Node(controller) => view.controllers.contains_key(controller),
            ProcessId::Gateway(gateway) => view.gateways.contains_key(gateway),
            ProcessId::Client(_) => true,
            ProcessId::Manager => false,
        };
        if !known || mc.is_some_and(|mc| !view.mcs.contains_key(mc)) {
            return false;
        }
        self.count(process, now)
    }

    /// The same for somebody who may not be of the cell: all of those together count as one.
    pub(super) fn admit_stranger(&mut self, now: Now) -> bool {
        self.count(ProcessId::Manager, now)
    }

    fn count(&mut self, process: ProcessId, now: Now) -> bool {
        let (since, count) = self.0.entry(process).or_insert((now, 0));
        if now.since_us(*since) >= WINDOW_US {
            (*since, *count) = (now, 0);
        }
        *count = count.saturating_add(1);
        *count <= EVENTS_MAX
    }
}
