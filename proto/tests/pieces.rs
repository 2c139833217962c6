//! Messages in pieces: whatever order, loss and repetition the pieces come in, a message comes whole or not at all.

use fam_proto::codec::{CodecError, MESSAGE_BYTES_MAX};
use fam_proto::{
    Assembly, BootId, ControllerId, PARTIAL_BYTES_MAX, PARTIAL_MAX, PIECE_BYTES, PieceHeader,
    ProcessId, decode_piece, encode_piece,
};
use proptest::prelude::*;

const KEY: &str = "fam/cell/frame/station1";

fn header(message: u64, message_bytes: usize, index: u32) -> PieceHeader {
    PieceHeader {
        from: ProcessId::Node(ControllerId::new("controller1").unwrap()),
        boot: BootId(7),
        message,
        message_bytes: u32::try_from(message_bytes).unwrap(),
        index,
    }
}

/// Bytes that tell message and place.
fn message(number: u64, len: usize) -> Vec<u8> {
    (0..len)
        .map(|at| (at as u64 ^ (at as u64 >> 11) ^ number).to_le_bytes()[0])
        .collect()
}

fn pieces(number: u64, len: usize) -> Vec<Vec<u8>> {
    let whole = message(number, len);
    (0..)
        .zip(whole.chunks(PIECE_BYTES))
        .map(|(index, piece)| encode_piece(&header(number, len, index), piece).unwrap())
        .collect()
}

fn take(assembly: &mut Assembly, key: &str, bytes: &[u8]) -> Option<Option<Vec<u8>>> {
    let (header, piece) = decode_piece(bytes).unwrap();
    assembly.take(key, &header, piece).ok()
}

#[test]
fn a_message_comes_with_its_last_piece_and_only_once() {
    let len = 3 * PIECE_BYTES + 5;
    let mut assembly = Assembly::default();
    let pieces = pieces(1, len);
    assert_eq!(pieces.len(), 4);
    for piece in &pieces[..3] {
        assert_eq!(take(&mut assembly, KEY, piece), Some(None));
    }
    assert_eq!(
        take(&mut assembly, KEY, &pieces[3]),
        Some(Some(message(1, len)))
    );
    assert_eq!(assembly.bytes(), 0);
    // Its acknowledgement was lost: it is acknowledged again, and nothing comes twice.
    assert_eq!(take(&mut assembly, KEY, &pieces[3]), Some(None));
}

#[test]
fn a_message_that_was_given_up_makes_room_for_the_next_and_never_mixes_with_it() {
    let len = 2 * PIECE_BYTES;
    let mut assembly = Assembly::default();
    let (old, new) = (pieces(1, len), pieces(2, len));
    assert_eq!(take(&mut assembly, KEY, &old[0]), Some(None));
    assert_eq!(
        take(&mut assembly, KEY, &new[1]),
        None,
        "its first is not here"
    );
    assert_eq!(take(&mut assembly, KEY, &new[0]), Some(None));
    assert_eq!(take(&mut assembly, KEY, &old[1]), None, "late");
    assert_eq!(take(&mut assembly, KEY, &old[0]), None, "late");
    assert_eq!(
        take(&mut assembly, KEY, &new[1]),
        Some(Some(message(2, len)))
    );
    assert_eq!(assembly.bytes(), 0);
}

#[test]
fn pieces_that_lie_about_themselves_are_refused() {
    let piece = vec![1; PIECE_BYTES];
    let table: [(PieceHeader, &[u8]); 4] = [
        (header(1, 2 * PIECE_BYTES, 0), &piece[1..]),
        (header(1, 2 * PIECE_BYTES, 2), &piece),
        (header(1, PIECE_BYTES, 0), &[]),
        (header(1, 10, u32::MAX), &piece[..10]),
    ];
    for (header, piece) in table {
        let read = decode_piece(&encode_piece(&header, piece).unwrap()).map(|_| ());
        assert!(
            matches!(read, Err(CodecError::Damaged { .. })),
            "{header:?}"
        );
    }
    let bytes = encode_piece(&header(1, MESSAGE_BYTES_MAX + 1, 0), &piece).unwrap();
    assert_eq!(
        decode_piece(&bytes).unwrap_err().to_string(),
        "piece of a message: 67108865 bytes, the limit is 67108864"
    );
}

#[test]
fn what_is_held_is_bounded_whoever_begins_and_never_ends() {
    let mut assembly = Assembly::default();
    let first = vec![1; PIECE_BYTES];
    for n in 0..100 {
        let begun = header(1, MESSAGE_BYTES_MAX, 0);
        assembly
            .take(&format!("fam/cell/frame/mc{n}"), &begun, &first)
            .unwrap();
        assert!(assembly.bytes() <= PARTIAL_MAX * PIECE_BYTES);
        assert!(assembly.bytes() <= PARTIAL_BYTES_MAX);
    }
    // An honest message still comes through.
    let len = PIECE_BYTES + 1;
    let honest = pieces(9, len);
    assert_eq!(take(&mut assembly, KEY, &honest[0]), Some(None));
    assert_eq!(
        take(&mut assembly, KEY, &honest[1]),
        Some(Some(message(9, len)))
    );
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]
    #[test]
    fn any_order_loss_and_repetition_gives_whole_messages_or_none(
        sent in prop::collection::vec((0usize..3, any::<prop::sample::Index>()), 0..40),
    ) {
        let len = 2 * PIECE_BYTES + 100;
        let all: Vec<_> = (1..=3).map(|number| pieces(number, len)).collect();
        let mut assembly = Assembly::default();
        let mut came = Vec::new();
        for (number, index) in sent {
            let piece = &all[number][index.index(3)];
            if let Some(Some(whole)) = take(&mut assembly, KEY, piece) {
                prop_assert_eq!(&whole, &message(number as u64 + 1, len));
                prop_assert!(!came.contains(&number), "message {} came twice", number);
                came.push(number);
            }
            prop_assert!(assembly.bytes() <= len);
        }
    }
}
