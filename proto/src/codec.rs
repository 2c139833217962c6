//! The binary format of messages and disk records: a four-byte head, then the body in bincode 2.
//!
//! bincode's authors ended it in 2025 (RUSTSEC-2025-0141: unmaintained, no known flaw). This is the only module
//! that names it; golden bytes (`tests/golden.rs`) fix the format, so that a compatible crate can replace it here.
//!
//! Head: `b'F'`, format version, kind of body, 0. A large state never goes through bincode: see [`crate::v1::frame`].

use serde::{Serialize, de::DeserializeOwned};

/// Version of the wire and disk format that this build writes, and the only one that it reads.
pub const FORMAT_VERSION: u8 = 1;

/// Longest message or record, head included, in bytes.
pub const MESSAGE_BYTES_MAX: usize = 64 << 20;
/// Longest message that crosses the wire as one; a longer one goes in acknowledged pieces ([`crate::v1::piece`]).
pub const UNCUT_BYTES_MAX: usize = 8 << 20;

const MAGIC: u8 = b'F';
const HEAD_BYTES: usize = 4;

/// A body that can cross the wire or reach a disk.
pub trait Wire: Serialize + DeserializeOwned {
    /// Third byte of the head: tells kinds of bodies apart.
    const KIND: u8;
    /// What people call it, for errors.
    const NAME: &'static str;
}

/// Why bytes could not be read, or a body not be written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CodecError {
    /// Not written by FAM, or cut off before the head ended.
    #[error("{name}: {bytes} bytes that do not begin like one")]
    Foreign {
        /// What was expected.
        name: &'static str,
        /// How many bytes there were.
        bytes: usize,
    },
    /// Written by another version.
    #[error(
        "{name}: format version {found}, this build reads version {FORMAT_VERSION}; run the same version of fam everywhere"
    )]
    Version {
        /// What was expected.
        name: &'static str,
        /// The version found.
        found: u8,
    },
    /// Another kind of body.
    #[error("{name}: the bytes hold another kind of content (kind {found})")]
    Kind {
        /// What was expected.
        name: &'static str,
        /// The kind found.
        found: u8,
    },
    /// Truncated, damaged, or with bytes left over.
    #[error("{name}: damaged or truncated ({bytes} bytes)")]
    Damaged {
        /// What was expected.
        name: &'static str,
        /// How many bytes there were.
        bytes: usize,
    },
    /// Above the size limit.
    #[error("{name}: {bytes} bytes, the limit is {MESSAGE_BYTES_MAX}")]
    TooLarge {
        /// What was expected.
        name: &'static str,
        /// How many bytes there were.
        bytes: usize,
    },
}

fn config() -> impl bincode::config::Config {
    bincode::config::standard().with_limit::<MESSAGE_BYTES_MAX>()
}

/// Writes head and body.
///
/// # Errors
/// [`CodecError::TooLarge`] above [`MESSAGE_BYTES_MAX`].
pub fn encode<T: Wire>(body: &T) -> Result<Vec<u8>, CodecError> {
    let mut bytes = vec![MAGIC, FORMAT_VERSION, T::KIND, 0];
    bincode::serde::encode_into_std_write(body, &mut bytes, config()).map_err(|_| {
        CodecError::Damaged {
            name: T::NAME,
            bytes: 0,
        }
    })?;
    if bytes.len() > MESSAGE_BYTES_MAX {
        return Err(CodecError::TooLarge {
            name: T::NAME,
            bytes: bytes.len(),
        });
    }
    Ok(bytes)
}

/// Reads head and body; every byte has to belong to it.
///
/// # Errors
/// Any [`CodecError`]; never panics, and allocates no more than a small multiple of the bytes given.
pub fn decode<T: Wire>(bytes: &[u8]) -> Result<T, CodecError> {
    let (body, used) = decode_prefix(bytes)?;
    if used != bytes.len() {
        return Err(CodecError::Damaged {
            name: T::NAME,
            bytes: bytes.len(),
        });
    }
    Ok(body)
}

/// Reads head and body from the beginning of `bytes`, and says how many bytes they took.
///
/// # Errors
/// As [`decode`].
pub fn decode_prefix<T: Wire>(bytes: &[u8]) -> Result<(T, usize), CodecError> {
    let name = T::NAME;
    if bytes.len() > MESSAGE_BYTES_MAX {
        return Err(CodecError::TooLarge {
            name,
            bytes: bytes.len(),
        });
    }
    if bytes.len() < HEAD_BYTES || bytes[0] != MAGIC || bytes[3] != 0 {
        return Err(CodecError::Foreign {
            name,
            bytes: bytes.len(),
        });
    }
    if bytes[1] != FORMAT_VERSION {
        return Err(CodecError::Version {
            name,
            found: bytes[1],
        });
    }
    if bytes[2] != T::KIND {
        return Err(CodecError::Kind {
            name,
            found: bytes[2],
        });
    }
    let (body, used) =
        bincode::serde::decode_from_slice(&bytes[HEAD_BYTES..], config()).map_err(|_| {
            CodecError::Damaged {
                name,
                bytes: bytes.len(),
            }
        })?;
    Ok((body, HEAD_BYTES + used))
}
