//! Cuts the bytes of a fuzzer into numbers and pieces; at the end of the bytes there are only zeros.

/// What is left of the bytes.
pub(crate) struct Pieces<'a>(pub &'a [u8]);

impl<'a> Pieces<'a> {
    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    pub(crate) fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else {
            return 0;
        };
        self.0 = rest;
        *first
    }

    pub(crate) fn word(&mut self) -> u16 {
        u16::from_le_bytes([self.byte(), self.byte()])
    }

    /// So many bytes, or what is left.
    pub(crate) fn take(&mut self, len: usize) -> &'a [u8] {
        let (piece, rest) = self.0.split_at(len.min(self.0.len()));
        self.0 = rest;
        piece
    }

    /// A piece that says its own length first, in two bytes.
    pub(crate) fn piece(&mut self) -> &'a [u8] {
        let len = usize::from(self.word());
        self.take(len)
    }

    /// Lays pieces over `bytes`, each with its place before it: position, length below 16, content.
    pub(crate) fn lay_over(&mut self, bytes: &mut [u8]) {
        while !self.is_empty() && !bytes.is_empty() {
            let at = usize::from(self.word()) % bytes.len();
            let len = usize::from(self.byte() % 16) + 1;
            let piece = self.take(len);
            let end = (at + piece.len()).min(bytes.len());
            bytes[at..end].copy_from_slice(&piece[..end - at]);
        }
    }
}
