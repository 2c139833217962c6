//! Buffers for checkpoints on their way from the scan thread to the sender thread: made once, used again and again.

use std::sync::Arc;

/// Buffers of one MC: the sender's ring, the last good one, the base, and some on the way.
pub const BUFFERS: usize = crate::sender::RING + 8;

/// A checkpoint's bytes and the outputs that belong to it.
#[derive(Debug, PartialEq, Eq)]
pub struct Buffer {
    bytes: Vec<u8>,
    state_len: usize,
}

impl Buffer {
    fn new(state_len: usize, outputs_len: usize) -> Buffer {
        Buffer {
            bytes: vec![0; state_len + outputs_len],
            state_len,
        }
    }

    /// Checkpoint bytes.
    #[must_use]
    pub fn state(&self) -> &[u8] {
        &self.bytes[..self.state_len]
    }

    /// Output image.
    #[must_use]
    pub fn outputs(&self) -> &[u8] {
        &self.bytes[self.state_len..]
    }

    /// Takes both over; lengths have to be the buffer's.
    pub fn fill(&mut self, state: &[u8], outputs: &[u8]) {
        self.bytes[..self.state_len].copy_from_slice(state);
        self.bytes[self.state_len..].copy_from_slice(outputs);
    }
}

/// The buffers of one MC. Nobody but the pool holds a free one.
#[derive(Debug)]
pub struct Pool {
    slots: Vec<Arc<Buffer>>,
    next: usize,
}

impl Pool {
    /// [`BUFFERS`] buffers for checkpoints and outputs of these lengths.
    #[must_use]
    pub fn new(state_len: usize, outputs_len: usize) -> Pool {
        let slots = (0..BUFFERS).map(|_| Arc::new(Buffer::new(state_len, outputs_len)));
        Pool {
            slots: slots.collect(),
            next: 0,
        }
    }

    /// Fills a free buffer; `None` if all are on the way. Does not allocate.
    pub fn fill(&mut self, state: &[u8], outputs: &[u8]) -> Option<Arc<Buffer>> {
        for _ in 0..self.slots.len() {
            let slot = &mut self.slots[self.next];
            self.next = (self.next + 1) % BUFFERS;
            if let Some(buffer) = Arc::get_mut(slot) {
                buffer.fill(state, outputs);
                return Some(slot.clone());
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_in_use_is_never_written() {
        let mut pool = Pool::new(2, 1);
        let held: Vec<_> = (0..BUFFERS)
            .map(|n| pool.fill(&[n as u8, 1], &[2]).unwrap())
            .collect();
        assert_eq!(pool.fill(&[9, 9], &[9]), None);
        for (n, buffer) in held.iter().enumerate() {
            assert_eq!(
                (buffer.state(), buffer.outputs()),
                (&[n as u8, 1][..], &[2][..])
            );
        }
        drop(held);
        assert!(pool.fill(&[9, 9], &[9]).is_some());
    }
}
