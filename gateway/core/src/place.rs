//! Bits and bytes of process images: read, written, and copied from one MC's outputs into another's inputs.

use fam_proto::model::Place;

/// Number of bits of a place.
#[must_use]
pub fn width_bits(place: Place) -> u32 {
    match place {
        Place::Bit { .. } => 1,
        Place::Bytes { width, .. } => 8 * u32::from(width),
    }
}

/// First byte of a place behind its end: an image has to be at least this long.
#[must_use]
pub fn end(place: Place) -> usize {
    match place {
        Place::Bit { byte, .. } => byte as usize + 1,
        Place::Bytes { byte, width } => byte as usize + usize::from(width),
    }
}

/// The value at a place, zero-extended; `None` if the place is not in the image.
#[must_use]
pub fn get(image: &[u8], place: Place) -> Option<u64> {
    match place {
        Place::Bit { byte, bit } => {
            let byte = *image.get(byte as usize)?;
            Some(u64::from(byte.checked_shr(bit.into())? & 1))
        }
        Place::Bytes { byte, width } => {
            let bytes = image.get(byte as usize..byte as usize + usize::from(width))?;
            let mut wide = [0; 8];
            wide.get_mut(..bytes.len())?.copy_from_slice(bytes);
            Some(u64::from_le_bytes(wide))
        }
    }
}

/// Sets a place to the low bits of `value`; for a bit any value but 0 is TRUE. Returns `false` if the place is not in the image.
pub fn set(image: &mut [u8], place: Place, value: u64) -> bool {
    match place {
        Place::Bit { byte, bit } => {
            let (Some(cell), Some(mask)) =
                (image.get_mut(byte as usize), 1_u8.checked_shl(bit.into()))
            else {
                return false;
            };
            if value == 0 {
                *cell &= !mask;
            } else {
                *cell |= mask;
            }
            true
        }
        Place::Bytes { byte, width } => {
            let wide = value.to_le_bytes();
            let (Some(cells), Some(bytes)) = (
                image.get_mut(byte as usize..byte as usize + usize::from(width)),
                wide.get(..usize::from(width)),
            ) else {
                return false;
            };
            cells.copy_from_slice(bytes);
            true
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn places() -> impl Strategy<Value = Place> {
        prop_oneof![
            (0_u32..10, 0_u8..8).prop_map(|(byte, bit)| Place::Bit { byte, bit }),
            (0_u32..10, prop::sample::select(vec![1_u8, 2, 4, 8]))
                .prop_map(|(byte, width)| Place::Bytes { byte, width }),
        ]
    }

    proptest! {
        #[test]
        fn what_is_set_reads_back_and_nothing_else_changes(place in places(), value: u64, before in prop::collection::vec(any::<u8>(), 10)) {
            let mut image = before.clone();
            if set(&mut image, place, value) {
                let bits = width_bits(place);
                let want = if bits == 1 { u64::from(value != 0) } else if bits == 64 { value } else { value & ((1 << bits) - 1) };
                prop_assert_eq!(get(&image, place), Some(want));
                let old = get(&before, place).unwrap();
                prop_assert!(set(&mut image, place, old));
            } else {
                prop_assert!(end(place) > image.len());
                prop_assert_eq!(get(&image, place), None);
            }
            prop_assert_eq!(image, before);
        }
    }
}
