//! Wakes the core at its ticks: absolute deadlines on the monotonic clock, finer than the runtime's timer wheel of 1 ms.

use fam_gateway_core::GatewayLocal;
use fam_proto::Now;
use std::time::Duration;
use tokio::sync::mpsc::{UnboundedSender, WeakUnboundedSender};

/// Starts the thread that wakes the core at `start` and every `tick_us` after; it ends when the queue is gone.
pub(crate) fn start(
    locals: &UnboundedSender<GatewayLocal>,
    start: Now,
    tick_us: u64,
) -> std::io::Result<()> {
    let locals = locals.downgrade();
    std::thread::Builder::new()
        .name("fam-tick".to_owned())
        .spawn(move || pace(&locals, start, tick_us.max(1)))
        .map(drop)
}

fn pace(locals: &WeakUnboundedSender<GatewayLocal>, start: Now, tick_us: u64) {
    let clock = fam_driver::clock();
    let mut next = start;
    loop {
        // Each deadline is computed from the first one; how long the sleep really took does not add up.
        let now = clock();
        if now < next {
            std::thread::sleep(Duration::from_micros(next.since_us(now)));
        }
        let Some(locals) = locals.upgrade() else {
            return;
        };
        if locals.send(GatewayLocal::Wake).is_err() {
            return;
        }
        let late_ticks = clock().since_us(next) / tick_us;
        next = next.plus_us((late_ticks + 1) * tick_us);
    }
}
