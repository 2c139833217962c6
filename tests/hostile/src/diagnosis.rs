//! Diagnosis files, and masks over states that they were not made for.

use crate::pieces::Pieces;
use fam_proto::diagnosis::{
    CriticalInterval, Diagnosis, IntervalKind, Mask, MaskOperand, MaskOperator, MaskType,
    MaskVariable,
};

/// Masks of the fuzzer's own, or a file of its own, over a state of its own.
pub fn diagnosis(bytes: &[u8]) {
    let mut pieces = Pieces(bytes);
    let how = pieces.byte();
    if how & 1 == 0 {
        let state = pieces.piece();
        decide(&masks(&mut pieces), state);
    } else {
        file(pieces.0);
    }
}

#[cfg(feature = "diagnosis-file")]
fn file(bytes: &[u8]) {
    if let Ok(text) = std::str::from_utf8(bytes)
        && let Ok(diagnosis) = fam_engineering::plcopen::diagnosis_file::read(text)
    {
        decide(&diagnosis, bytes);
    }
}

#[cfg(not(feature = "diagnosis-file"))]
fn file(_bytes: &[u8]) {}

/// The decision is made, and is the one of the first interval that holds.
pub(crate) fn decide(diagnosis: &Diagnosis, checkpoint: &[u8]) {
    let found = diagnosis.critical_interval(checkpoint);
    if let Some(found) = found {
        let state = &checkpoint[diagnosis.state_offset as usize..];
        assert!(found.holds(state));
        assert!(diagnosis.interval_of_action(found.action).is_some());
    }
    assert_eq!(
        found.is_none(),
        diagnosis.recovery(checkpoint) == fam_proto::diagnosis::Recovery::Direct
    );
}

fn masks(pieces: &mut Pieces<'_>) -> Diagnosis {
    let state_offset = u32::from(pieces.byte());
    let mut intervals = Vec::new();
    while !pieces.is_empty() && intervals.len() < 8 {
        let how = pieces.byte();
        let rows = (0..how % 4)
            .map(|_| (0..pieces.byte() % 4).map(|_| mask(pieces)).collect())
            .collect();
        intervals.push(CriticalInterval {
            name: "I".to_owned(),
            rows,
            kind: if how & 16 == 0 {
                IntervalKind::Checkpoint
            } else {
                IntervalKind::Unrecoverable
            },
            action: u16::from(how),
            pou: "P".to_owned(),
            repeatable: how & 32 == 0,
        });
    }
    Diagnosis {
        state_offset,
        checkpoint_len: 0,
        intervals,
        stop_action: None,
    }
}

fn variable(pieces: &mut Pieces<'_>) -> MaskVariable {
    let width = pieces.byte();
    let of = match width >> 6 {
        0 => MaskType::Unsigned(width & 15),
        1 => MaskType::Signed(width & 15),
        2 => MaskType::Real(width & 15),
        // The whole range, far outside too.
        _ => MaskType::Signed(width),
    };
    let low = u32::from(pieces.byte());
    let offset = if width & 32 == 0 { low } else { u32::MAX - low };
    MaskVariable { offset, of }
}

fn mask(pieces: &mut Pieces<'_>) -> Mask {
    let left = variable(pieces);
    let operator = match pieces.byte() % 6 {
        0 => MaskOperator::Equal,
        1 => MaskOperator::NotEqual,
        2 => MaskOperator::Less,
        3 => MaskOperator::LessOrEqual,
        4 => MaskOperator::Greater,
        _ => MaskOperator::GreaterOrEqual,
    };
    let mut number = || {
        let mut bytes = [0; 8];
        let piece = pieces.take(8);
        bytes[..piece.len()].copy_from_slice(piece);
        u64::from_le_bytes(bytes)
    };
    let bits = if number() & 1 == 0 {
        u64::MAX
    } else {
        number()
    };
    let value = number();
    let right = match value % 3 {
        0 => MaskOperand::Integer(i128::from(value.cast_signed())),
        1 => MaskOperand::RealBits(value),
        _ => MaskOperand::Variable(variable(pieces)),
    };
    Mask {
        left,
        bits,
        operator,
        right,
    }
}
