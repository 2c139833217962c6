//! Orders on their way to MC Agents: repeated with the same number until received.

use fam_proto::{AgentId, BootId, McId, Message, Now, Order, OrderId, OrderKind};
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};

/// The first repetitions follow this close, in microseconds.
pub const REPEAT_FAST_US: u64 = 5_000;
/// How many of them.
pub const REPEAT_FAST: u32 = 4;
/// Further ones, in microseconds.
pub const REPEAT_SLOW_US: u64 = 50_000;

#[derive(Debug, Clone, PartialEq, Eq)]
struct Outgoing {
    to: AgentId,
    order: Order,
    sent: u32,
    next: Now,
    /// For orders that no job waits for: repeated no longer than this.
    expires: Option<Now>,
}

/// All orders that are not received yet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Orders {
    last: u64,
    outgoing: BTreeMap<OrderId, Outgoing>,
}

// A repetition does nothing that the first copy, come later, does not do, and the next number is above all that were given: neither
// is a part of the state.
impl Hash for Orders {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

impl Orders {
    /// Numbers begin with the boot id, a wall-clock time in microseconds, so that no two lives use the same.
    pub(super) fn new(boot: BootId) -> Orders {
        Orders {
            last: boot.0,
            outgoing: BTreeMap::new(),
        }
    }

    /// A new order, due at once.
    pub(super) fn give(
        &mut self,
        to: AgentId,
        mc: &McId,
        kind: OrderKind,
        now: Now,
        expires: Option<Now>,
    ) -> OrderId {
        self.last += 1;
        let id = OrderId(self.last);
        let order = Order {
            id,
            mc: mc.clone(),
            kind,
        };
        self.outgoing.insert(
            id,
            Outgoing {
                to,
                order,
                sent: 0,
                next: now,
                expires,
            },
        );
        id
    }

    /// The receiver has it.
    pub(super) fn received(&mut self, id: OrderId, from: &AgentId) {
        if self.outgoing.get(&id).is_some_and(|o| &o.to == from) {
            self.outgoing.remove(&id);
        }
    }

    /// Whether it is still repeated.
    pub(super) fn is_out(&self, id: OrderId) -> bool {
        self.outgoing.contains_key(&id)
    }

    /// It is not wanted any more.
    pub(super) fn withdraw(&mut self, id: OrderId) {
        self.outgoing.remove(&id);
    }

    /// What is due now.
    pub(super) fn due(&mut self, now: Now) -> Vec<(AgentId, Message)> {
        self.outgoing
            .retain(|_, o| o.expires.is_none_or(|at| now < at));
        let mut due = Vec::new();
        for outgoing in self.outgoing.values_mut().filter(|o| o.next <= now) {
            outgoing.sent += 1;
            let pause_us = if outgoing.sent <= REPEAT_FAST {
                REPEAT_FAST_US
            } else {
                REPEAT_SLOW_US
            };
            outgoing.next = now.plus_us(pause_us);
            due.push((outgoing.to.clone(), Message::Order(outgoing.order.clone())));
        }
        due
    }

    pub(super) fn deadline(&self) -> Option<(Now, &'static str)> {
        let next = self.outgoing.values().map(|o| o.next).min()?;
        Some((next, "an order is repeated"))
    }
}
