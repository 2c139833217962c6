//! How old the inputs of an image are, by the gateway's own clock: the number in a frame is looked up, never a foreign time.

use fam_proto::{ImageNumber, Now};
use std::collections::VecDeque;

/// Ages of the images of one MC, newest last, kept no longer than they can matter.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImageAges {
    /// Number of the first entry.
    first: u64,
    /// When the inputs were read; `None` before the field answered for the first time.
    read_at: VecDeque<Option<Now>>,
    /// Entries older than this are dropped, in microseconds.
    keep_us: u64,
}

// Ages follow from the numbers that were sent and the clock: no part of the state of their own.
impl std::hash::Hash for ImageAges {
    fn hash<H: std::hash::Hasher>(&self, _: &mut H) {}
}

/// What the table says of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Age {
    /// So old, in microseconds.
    Us(u64),
    /// Older than anything that matters, from another life of the gateway, or its inputs were never read.
    TooOld,
    /// No such image was ever sent.
    Unknown,
}

impl ImageAges {
    /// A table whose first image will have the number after `newest`.
    #[must_use]
    pub fn new(newest: ImageNumber, keep_us: u64) -> ImageAges {
        ImageAges {
            first: newest.0.saturating_add(1),
            read_at: VecDeque::new(),
            keep_us,
        }
    }

    /// Notes that the next image goes out with inputs read at `read_at`.
    pub fn push(&mut self, read_at: Option<Now>, now: Now) {
        self.read_at.push_back(read_at);
        while self.read_at.len() > 1
            && self.read_at[0].is_none_or(|at| now.since_us(at) > self.keep_us)
        {
            self.read_at.pop_front();
            self.first += 1;
        }
    }

    /// Age of an image's inputs.
    #[must_use]
    pub fn age(&self, image: ImageNumber, now: Now) -> Age {
        let Some(at) = image.0.checked_sub(self.first) else {
            return Age::TooOld;
        };
        match usize::try_from(at).ok().and_then(|at| self.read_at.get(at)) {
            None => Age::Unknown,
            Some(None) => Age::TooOld,
            Some(Some(read_at)) => Age::Us(now.since_us(*read_at)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_are_looked_up_and_forgotten() {
        let mut ages = ImageAges::new(ImageNumber(100), 1_000);
        assert_eq!(ages.age(ImageNumber(101), Now(0)), Age::Unknown);
        ages.push(None, Now(0));
        ages.push(Some(Now(10)), Now(10));
        ages.push(Some(Now(10)), Now(20)); // the field did not answer: inputs of before
        for (image, now, want) in [
            (100, 30, Age::TooOld),
            (101, 30, Age::TooOld),
            (102, 30, Age::Us(20)),
            (103, 30, Age::Us(20)),
            (104, 30, Age::Unknown),
            (u64::MAX, 30, Age::Unknown),
        ] {
            assert_eq!(
                ages.age(ImageNumber(image), Now(now)),
                want,
                "image {image}"
            );
        }
        ages.push(Some(Now(2_000)), Now(2_000));
        assert_eq!(ages.age(ImageNumber(103), Now(2_000)), Age::TooOld);
        assert_eq!(ages.age(ImageNumber(104), Now(2_000)), Age::Us(0));
    }
}
