//! A message too long for one message on the wire: cut into pieces, of which each is acknowledged before the next is sent.
//!
//! On the wire: head and [`PieceHeader`] through the codec, then the bytes of the piece, as they are. A receiver puts the
//! pieces of one sender under one key together ([`Assembly`]) and answers each with a [`PieceTaken`]; the message counts as
//! come when the last is in. A sender that gives up, or dies, leaves nothing behind but room that the next one takes.

use crate::codec::{self, CodecError, MESSAGE_BYTES_MAX, Wire};
use crate::ids::{BootId, ProcessId};
use serde::{Deserialize, Serialize};

/// Length of every piece but the last, in bytes.
pub const PIECE_BYTES: usize = 256 << 10;
/// Messages that a receiver holds in part at a time, at most; the oldest makes room.
pub const PARTIAL_MAX: usize = 8;
/// Bytes of messages held in part, at most; the oldest make room.
pub const PARTIAL_BYTES_MAX: usize = 2 * MESSAGE_BYTES_MAX;

/// What a piece is part of.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PieceHeader {
    /// Who sends it.
    pub from: ProcessId,
    /// The sender's life.
    pub boot: BootId,
    /// Number of the message, which grows over a life.
    pub message: u64,
    /// Length of the whole message, in bytes.
    pub message_bytes: u32,
    /// Which piece, from 0.
    pub index: u32,
}

impl Wire for PieceHeader {
    const KIND: u8 = 12;
    const NAME: &'static str = "piece of a message";
}

/// Acknowledges a piece.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct PieceTaken {
    /// Who has taken it.
    pub by: ProcessId,
}

impl Wire for PieceTaken {
    const KIND: u8 = 13;
    const NAME: &'static str = "acknowledgement of a piece";
}

/// Writes a piece.
///
/// # Errors
/// [`CodecError::TooLarge`] never in practice: a piece is far below the limit.
pub fn encode_piece(header: &PieceHeader, piece: &[u8]) -> Result<Vec<u8>, CodecError> {
    let mut bytes = codec::encode(header)?;
    bytes.reserve_exact(piece.len());
    bytes.extend_from_slice(piece);
    Ok(bytes)
}

/// Reads a piece: the header, and the bytes of the message in it.
///
/// # Errors
/// Any [`CodecError`]; [`CodecError::Damaged`] if the piece has not the length that its place in the message asks for.
pub fn decode_piece(bytes: &[u8]) -> Result<(PieceHeader, &[u8]), CodecError> {
    let (header, used): (PieceHeader, usize) = codec::decode_prefix(bytes)?;
    let piece = &bytes[used..];
    let whole = header.message_bytes as usize;
    if whole > MESSAGE_BYTES_MAX {
        return Err(CodecError::TooLarge {
            name: PieceHeader::NAME,
            bytes: whole,
        });
    }
    let begin = (header.index as usize).saturating_mul(PIECE_BYTES);
    if piece.is_empty() || piece.len() != whole.saturating_sub(begin).min(PIECE_BYTES) {
        return Err(CodecError::Damaged {
            name: PieceHeader::NAME,
            bytes: bytes.len(),
        });
    }
    Ok((header, piece))
}

/// Why a piece that reads well was not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PieceError {
    /// The pieces before it are not here: this receiver came late, or had to make room.
    #[error("piece {index} of message {message} of the {from} came, piece {expected} was expected")]
    OutOfOrder {
        /// The sender.
        from: ProcessId,
        /// Number of the message.
        message: u64,
        /// The piece that came.
        index: u32,
        /// The piece that would have been taken.
        expected: u32,
    },
}

/// A message of which not all pieces are here.
#[derive(Debug)]
struct Partial {
    key: String,
    from: ProcessId,
    boot: BootId,
    message: u64,
    whole: usize,
    taken: u32,
    /// Given away; remembered so that its last piece is acknowledged again if need be.
    complete: bool,
    bytes: Vec<u8>,
}

/// What a receiver holds of messages that come in pieces: one for each sender and key, in the order of their beginning.
#[derive(Debug, Default)]
pub struct Assembly {
    partial: Vec<Partial>,
}

impl Assembly {
    /// Takes a piece that came under `key`; gives the message with its last piece. A piece that came before is taken again
    /// without effect: its acknowledgement was lost.
    ///
    /// # Errors
    /// [`PieceError`], which tells the sender to begin again.
    pub fn take(
        &mut self,
        key: &str,
        header: &PieceHeader,
        piece: &[u8],
    ) -> Result<Option<Vec<u8>>, PieceError> {
        let of_sender =
            |p: &Partial| p.key == key && p.from == header.from && p.boot == header.boot;
        let mut place = self.partial.iter().position(of_sender);
        if let Some(at) = place
            && self.partial[at].message != header.message
        {
            // The sender has given up the one before; a piece of one before that is late, and is of no use.
            if header.index == 0 && self.partial[at].message < header.message {
                self.partial.remove(at);
                place = None;
            } else {
                return Err(out_of_order(header, 0));
            }
        }
        let at = match place {
            Some(at) => at,
            None if header.index == 0 => self.begin(key, header),
            None => return Err(out_of_order(header, 0)),
        };
        let partial = &mut self.partial[at];
        if header.message_bytes as usize != partial.whole || header.index > partial.taken {
            return Err(out_of_order(header, partial.taken));
        }
        if header.index < partial.taken {
            return Ok(None);
        }
        partial.bytes.extend_from_slice(piece);
        partial.taken += 1;
        if partial.bytes.len() < partial.whole {
            return Ok(None);
        }
        partial.complete = true;
        Ok(Some(std::mem::take(&mut partial.bytes)))
    }

    /// Bytes held of messages that are not complete.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.partial.iter().map(|p| p.bytes.len()).sum()
    }

    /// Makes a place for a message, if need be that of one that is complete, else of the oldest. A claim is counted as if it
    /// were full, and takes no memory before its bytes come.
    fn begin(&mut self, key: &str, header: &PieceHeader) -> usize {
        let whole = header.message_bytes as usize;
        let claimed = |partial: &[Partial]| -> usize {
            let open = partial.iter().filter(|p| !p.complete);
            open.map(|p| p.whole).sum()
        };
        while self.partial.len() >= PARTIAL_MAX
            || claimed(&self.partial) + whole > PARTIAL_BYTES_MAX
        {
            let complete = self.partial.iter().position(|p| p.complete);
            self.partial.remove(complete.unwrap_or(0));
        }
        self.partial.push(Partial {
            key: key.to_owned(),
            from: header.from.clone(),
            boot: header.boot,
            message: header.message,
            whole,
            taken: 0,
            complete: false,
            bytes: Vec::new(),
        });
        self.partial.len() - 1
    }
}

fn out_of_order(header: &PieceHeader, expected: u32) -> PieceError {
    PieceError::OutOfOrder {
        from: header.from.clone(),
        message: header.message,
        index: header.index,
        expected,
    }
}
