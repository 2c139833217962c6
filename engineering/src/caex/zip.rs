//! Just enough of zip for containers after the Open Packaging Conventions: stored and deflated parts, no encryption, no zip64.

use flate2::Crc;
use flate2::read::DeflateDecoder;
use std::collections::BTreeMap;
use std::io::Read as _;

const LOCAL: u32 = 0x0403_4b50;
const CENTRAL: u32 = 0x0201_4b50;
const END: u32 = 0x0605_4b50;
const END_BYTES: usize = 22;
const STORED: u16 = 0;
const DEFLATED: u16 = 8;
/// Names are UTF-8.
const FLAG_UTF8: u16 = 1 << 11;
const FLAG_ENCRYPTED: u16 = 1;

/// Why an archive cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ZipError {
    /// No directory, or one that leads nowhere.
    #[error("its directory is damaged: {0}")]
    Directory(&'static str),
    /// More than the limits allow.
    #[error("it is too large: {0}")]
    TooLarge(String),
    /// A part.
    #[error("its part `{name}` cannot be unpacked: {why}")]
    Part {
        /// Name.
        name: String,
        /// Why.
        why: String,
    },
}

/// Limits of what is unpacked.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Parts.
    pub parts: usize,
    /// Bytes of one part.
    pub part_bytes: u64,
    /// Bytes of all parts.
    pub all_bytes: u64,
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    let found = bytes.get(at..at.checked_add(2)?)?;
    Some(u16::from_le_bytes(found.try_into().ok()?))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    let found = bytes.get(at..at.checked_add(4)?)?;
    Some(u32::from_le_bytes(found.try_into().ok()?))
}

/// All parts of an archive by their names as written; folders are left out.
///
/// # Errors
/// [`ZipError`].
pub fn unpack(bytes: &[u8], limits: Limits) -> Result<BTreeMap<String, Vec<u8>>, ZipError> {
    // The end record is the last thing but a comment of at most 64 kB.
    let first = bytes.len().saturating_sub(END_BYTES + 0xffff);
    let end = (first..=bytes.len().saturating_sub(END_BYTES))
        .rev()
        .find(|at| u32_at(bytes, *at) == Some(END))
        .ok_or(ZipError::Directory("it has no end record"))?;
    let short = || ZipError::Directory("the end record is cut off");
    let count = usize::from(u16_at(bytes, end + 10).ok_or_else(short)?);
    let mut at = u32_at(bytes, end + 16).ok_or_else(short)? as usize;
    if count > limits.parts {
        let message = format!("{count} parts, at most {} are read", limits.parts);
        return Err(ZipError::TooLarge(message));
    }
    let mut parts = BTreeMap::new();
    let mut left = limits.all_bytes;
    for _ in 0..count {
        let (name, content, next) = entry(bytes, at, limits.part_bytes.min(left))?;
        at = next;
        if name.ends_with('/') {
            continue;
        }
        left -= content.len() as u64;
        if parts.insert(name.clone(), content).is_some() {
            let why = "another part has this name too".to_owned();
            return Err(ZipError::Part { name, why });
        }
    }
    Ok(parts)
}

/// The entry of the central directory at `at`: name, content, place of the next one.
fn entry(bytes: &[u8], at: usize, limit: u64) -> Result<(String, Vec<u8>, usize), ZipError> {
    let cut = || ZipError::Directory("an entry is cut off");
    if u32_at(bytes, at) != Some(CENTRAL) {
        return Err(ZipError::Directory("an entry is not where it should be"));
    }
    let flags = u16_at(bytes, at + 8).ok_or_else(cut)?;
    let method = u16_at(bytes, at + 10).ok_or_else(cut)?;
    let crc = u32_at(bytes, at + 16).ok_or_else(cut)?;
    let packed_len = u32_at(bytes, at + 20).ok_or_else(cut)? as usize;
    let lens: Vec<usize> = [28, 30, 32]
        .iter()
        .filter_map(|o| u16_at(bytes, at + o).map(usize::from))
        .collect();
    let [name_len, extra_len, comment_len] = lens[..] else {
        return Err(cut());
    };
    let local = u32_at(bytes, at + 42).ok_or_else(cut)? as usize;
    let name = bytes.get(at + 46..at + 46 + name_len).ok_or_else(cut)?;
    let name = String::from_utf8_lossy(name).into_owned();
    let next = at + 46 + name_len + extra_len + comment_len;
    let error = |why: &str| ZipError::Part {
        name: name.clone(),
        why: why.to_owned(),
    };
    if flags & FLAG_ENCRYPTED != 0 {
        return Err(error("it is encrypted"));
    }
    if u32_at(bytes, local) != Some(LOCAL) {
        return Err(error("it is not where the directory says"));
    }
    let skip = u16_at(bytes, local + 26)
        .zip(u16_at(bytes, local + 28))
        .map(|(n, e)| 30 + usize::from(n) + usize::from(e))
        .ok_or_else(|| error("it is cut off"))?;
    let start = local + skip;
    let packed = bytes
        .get(start..start.saturating_add(packed_len))
        .ok_or_else(|| error("it is cut off"))?;
    let mut content = Vec::new();
    // The size in the directory is what the writer says; what counts is what comes out.
    let read = match method {
        STORED => packed.take(limit + 1).read_to_end(&mut content),
        DEFLATED => DeflateDecoder::new(packed)
            .take(limit + 1)
            .read_to_end(&mut content),
        _ => {
            return Err(error(
                "it is packed in a way that is neither stored nor deflated",
            ));
        }
    };
    let read = read.map_err(|e| error(&e.to_string()))? as u64;
    if read > limit {
        let message = format!("`{name}` unpacks to more than {} MB", limit >> 20);
        return Err(ZipError::TooLarge(message));
    }
    let mut sum = Crc::new();
    sum.update(&content);
    if sum.sum() != crc {
        return Err(error("its checksum does not fit"));
    }
    Ok((name, content, next))
}

/// An archive of stored parts. The same parts give the same bytes.
#[must_use]
#[allow(clippy::cast_possible_truncation)] // a container of texts is far below 4 GB
pub fn pack(parts: &BTreeMap<String, Vec<u8>>) -> Vec<u8> {
    let mut out = Vec::new();
    let mut directory = Vec::new();
    for (name, content) in parts {
        let mut sum = Crc::new();
        sum.update(content);
        let mut common = Vec::new();
        // Version 2.0, names in UTF-8, stored, 1980-01-01 (the format has no earlier time).
        for half in [20, FLAG_UTF8, STORED, 0, 0x21] {
            common.extend(half.to_le_bytes());
        }
        for word in [sum.sum(), content.len() as u32, content.len() as u32] {
            common.extend(word.to_le_bytes());
        }
        common.extend((name.len() as u16).to_le_bytes());
        common.extend(0u16.to_le_bytes());
        let local = out.len() as u32;
        out.extend(LOCAL.to_le_bytes());
        out.extend(&common);
        out.extend(name.as_bytes());
        out.extend(content);
        directory.extend(CENTRAL.to_le_bytes());
        directory.extend(20u16.to_le_bytes());
        directory.extend(&common);
        // No comment, first disk, no attributes.
        directory.extend([0; 10]);
        directory.extend(local.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let start = out.len() as u32;
    let count = parts.len() as u16;
    out.extend(&directory);
    out.extend(END.to_le_bytes());
    out.extend([0; 4]);
    out.extend(count.to_le_bytes());
    out.extend(count.to_le_bytes());
    out.extend((directory.len() as u32).to_le_bytes());
    out.extend(start.to_le_bytes());
    out.extend([0; 2]);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::write::DeflateEncoder;
    use proptest::prelude::*;
    use std::io::Write as _;

    const LIMITS: Limits = Limits {
        parts: 100,
        part_bytes: 1 << 20,
        all_bytes: 1 << 20,
    };

    proptest! {
        #[test]
        fn what_is_packed_unpacks(parts in prop::collection::btree_map("[a-z/]{1,8}[a-z]", prop::collection::vec(any::<u8>(), 0..50), 0..5)) {
            prop_assert_eq!(unpack(&pack(&parts), LIMITS), Ok(parts));
        }

        #[test]
        fn damage_is_an_error_or_the_same_parts(at in 0usize..200, value: u8) {
            let parts = BTreeMap::from([("a".to_owned(), b"content".to_vec()), ("b/c".to_owned(), vec![7; 30])]);
            let mut bytes = pack(&parts);
            let at = at % bytes.len();
            bytes[at] = value;
            if let Ok(read) = unpack(&bytes, LIMITS) {
                // Names and times have no checksum; contents have.
                prop_assert!(read.values().all(|c| parts.values().any(|p| p == c)));
            }
        }
    }

    #[test]
    fn a_bomb_is_refused() {
        let mut encoder = DeflateEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(&vec![0; 2 << 20]).unwrap();
        let packed = encoder.finish().unwrap();
        assert!(packed.len() < 10_000);
        let stored = pack(&BTreeMap::from([("a".to_owned(), packed)]));
        // The same archive with its part declared deflated.
        let mut bytes = stored;
        let central = (0..bytes.len())
            .find(|a| u32_at(&bytes, *a) == Some(CENTRAL))
            .unwrap();
        bytes[central + 10] = 8;
        let error = unpack(&bytes, LIMITS).unwrap_err();
        assert_eq!(
            error.to_string(),
            "it is too large: `a` unpacks to more than 1 MB"
        );
    }
}
