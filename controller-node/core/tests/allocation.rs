//! A tick allocates nothing in steady state.

mod common;

use common::*;
use fam_node_core::model_mc::ModelMc;
use fam_node_core::{ActiveMc, ScanHost, ScannedFrame};
use fam_proto::access::McNews;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell as Counter;

struct Counting;

thread_local! {
    static ALLOCATIONS: Counter<u64> = const { Counter::new(0) };
}

// SAFETY: everything is handed on to the system's allocator as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = ALLOCATIONS.try_with(|n| n.set(n.get() + 1));
        // SAFETY: the caller's promises are the system allocator's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Hands frames on to a bounded queue, as the process does.
struct Host {
    frames: Vec<ScannedFrame>,
}

impl ScanHost<ModelMc> for Host {
    fn cpu_ns(&mut self) -> u64 {
        0
    }
    fn scanning(&mut self, _: Option<usize>) {}
    fn spend_ns(&mut self, _: u64) {}
    fn frame(&mut self, frame: ScannedFrame) {
        self.frames.push(frame);
    }
    fn news(&mut self, _: usize, news: McNews) {
        panic!("{news:?}");
    }
    fn returned(&mut self, _: Box<ActiveMc<ModelMc>>) {
        panic!("it stays active");
    }
}

#[test]
fn a_tick_allocates_nothing_in_steady_state() {
    let mut cell = model_cell(2_000);
    cell.activate_a(0, |_| {});
    cell.activate_a(1, |_| {});
    for _ in 0..20 {
        cell.tick();
    }
    let mut host = Host {
        frames: Vec::with_capacity(8),
    };
    let mut counted = 0;
    for _ in 0..50 {
        cell.now = cell.now.plus_us(TICK_US);
        let image = cell.gateway.image();
        let before = ALLOCATIONS.with(Counter::get);
        cell.a.core.image(image, cell.now);
        cell.a.core.tick(cell.now, &mut host);
        counted += ALLOCATIONS.with(Counter::get) - before;
        assert_eq!(host.frames.len(), 2);
        for frame in host.frames.drain(..) {
            let encoded = cell.a.encoders[frame.spec.index]
                .encode(&frame, cell.now)
                .unwrap();
            cell.gateway.frame(&encoded.bytes);
        }
    }
    assert_eq!(counted, 0);
}
