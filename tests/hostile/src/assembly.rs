//! Messages that come in pieces: as bytes from anybody, and as good pieces in any order from several senders.

use crate::cell::owner;
use crate::pieces::Pieces;
use fam_proto::{
    Assembly, BootId, PARTIAL_BYTES_MAX, PIECE_BYTES, PieceHeader, ProcessId, decode_piece,
    encode_piece,
};

/// What a piece is full of: another byte in each piece of each message.
fn fill(message: u64, index: usize) -> u8 {
    (message * 4 + index as u64).to_le_bytes()[0]
}

/// Pieces, and what is put together of them: a message comes whole, as it was sent, or not at all.
pub fn piece(bytes: &[u8]) {
    let mut assembly = Assembly::default();
    if let Ok((header, piece)) = decode_piece(bytes) {
        let again = encode_piece(&header, piece).expect("what was read is written");
        assert_eq!(decode_piece(&again).as_ref(), Ok(&(header.clone(), piece)));
        let _ = assembly.take("fam/cell/to/manager", &header, piece);
    }
    let mut steps = Pieces(bytes);
    while !steps.is_empty() {
        let (who, what) = (steps.byte(), steps.byte());
        let (message, index) = (u64::from(what >> 4), u32::from(what & 3));
        // One piece, a bit more than one, three.
        let whole = match message % 3 {
            0 => PIECE_BYTES,
            1 => PIECE_BYTES + 7,
            _ => 3 * PIECE_BYTES,
        };
        let begin = index as usize * PIECE_BYTES;
        let content =
            vec![fill(message, index as usize); whole.saturating_sub(begin).min(PIECE_BYTES)];
        let header = PieceHeader {
            from: ProcessId::Node(owner(u64::from(who % 2) + 1).controller),
            boot: BootId(u64::from(who >> 6)),
            message,
            message_bytes: u32::try_from(whole).unwrap_or(0),
            index,
        };
        let sent = encode_piece(&header, &content).expect("a piece is small");
        let Ok((header, content)) = decode_piece(&sent) else {
            assert!(begin >= whole, "a good piece was refused");
            continue;
        };
        let key = format!("fam/cell/frame/mc{}", who >> 1 & 7);
        if let Ok(Some(got)) = assembly.take(&key, &header, content) {
            assert_eq!(got.len(), whole);
            for (index, piece) in got.chunks(PIECE_BYTES).enumerate() {
                assert!(*piece == vec![fill(message, index); piece.len()]);
            }
        }
        assert!(assembly.bytes() <= PARTIAL_BYTES_MAX);
    }
}
