//! Where Zenoh's thread leaves the newest image of each gateway for the scan thread. Neither waits for the other.

use arc_swap::ArcSwapOption;
use fam_node_core::newest::Newest;
use fam_proto::{GatewayId, InputImage, Now};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};

/// Images that the writer keeps, so that it is the writer who frees them and not the scan thread.
const KEPT: usize = 8;

/// An image, and when it came.
#[derive(Debug)]
pub struct Stamped {
    /// The image.
    pub image: Arc<InputImage>,
    /// On the clock of this process.
    pub at: Now,
}

#[derive(Debug, Default)]
struct Slot {
    newest: ArcSwapOption<Stamped>,
    /// Only the writer takes it.
    kept: Mutex<(Newest, VecDeque<Arc<Stamped>>)>,
}

/// One slot for each gateway of the cell.
#[derive(Debug)]
pub struct Mailbox {
    slots: BTreeMap<GatewayId, Slot>,
}

impl Mailbox {
    /// Empty, for these gateways; images of others are dropped.
    #[must_use]
    pub fn new(gateways: impl IntoIterator<Item = GatewayId>) -> Mailbox {
        Mailbox {
            slots: gateways.into_iter().map(|g| (g, Slot::default())).collect(),
        }
    }

    /// Leaves an image; one that is not newer than what lies there, or cannot be, is dropped.
    pub fn put(&self, image: &Arc<InputImage>, at: Now) {
        let Some(slot) = self.slots.get(&image.gateway) else {
            return;
        };
        let Ok(mut place) = slot.kept.lock() else {
            return;
        };
        let (newest, kept) = &mut *place;
        if !newest.admit(image.boot, image.number, at) {
            return;
        }
        let stamped = Arc::new(Stamped {
            image: image.clone(),
            at,
        });
        slot.newest.store(Some(stamped.clone()));
        if kept.len() == KEPT {
            kept.pop_front();
        }
        kept.push_back(stamped);
    }

    /// Gives each gateway's newest image; for the scan thread.
    pub fn each(&self, mut take: impl FnMut(&Stamped)) {
        for slot in self.slots.values() {
            if let Some(stamped) = &*slot.newest.load() {
                take(stamped);
            }
        }
    }

    /// When the newest image of each gateway came.
    pub fn ages(&self) -> impl Iterator<Item = (&GatewayId, Option<Now>)> {
        self.slots
            .iter()
            .map(|(gateway, slot)| (gateway, slot.newest.load().as_ref().map(|s| s.at)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use fam_proto::{BootId, ImageNumber};

    fn image(boot: u64, number: u64) -> Arc<InputImage> {
        Arc::new(InputImage {
            gateway: GatewayId::new("gateway1").unwrap(),
            boot: BootId(boot),
            number: ImageNumber(number),
            sent_at_us: 0,
            inputs: Vec::new(),
            records: Vec::new(),
            exports: Vec::new(),
        })
    }

    #[test]
    fn the_newest_image_lies_there_and_the_writer_keeps_some() {
        let mailbox = Mailbox::new([GatewayId::new("gateway1").unwrap()]);
        let newest = || {
            let mut seen = None;
            mailbox.each(|s| seen = Some((s.image.boot.0, s.image.number.0, s.at.0)));
            seen
        };
        assert_eq!(newest(), None);
        for (boot, number, expected) in [
            (1, 5, (1, 5, 0)),
            (1, 4, (1, 5, 0)),
            (1, 6, (1, 6, 2)),
            (2, 7, (1, 6, 2)),
            (2, 8, (2, 8, 4)),
            (1, 9, (2, 8, 4)),
        ]
        .into_iter()
        .enumerate()
        .map(|(at, (boot, number, expected))| ((boot, number, at), expected))
        .map(|((b, n, at), e)| {
            mailbox.put(&image(b, n), Now(at as u64));
            (b, n, e)
        }) {
            assert_eq!(newest(), Some(expected), "after {boot}, {number}");
        }
        let held = image(2, 9);
        mailbox.put(&held, Now(10_000));
        for number in 10..10 + KEPT as u64 - 1 {
            mailbox.put(&image(2, number), Now(11_000));
        }
        assert_eq!(Arc::strong_count(&held), 2);
        mailbox.put(&image(2, 100), Now(100_000));
        assert_eq!(Arc::strong_count(&held), 1);
    }
}
