//! A frame: what an active MC publishes after each scan, in one message: outputs and checkpoint together.
//!
//! On the wire: head and [`FrameHeader`] through the codec, then the outputs, then the state or delta, as they are.

use super::checkpoint::{CheckpointId, Digest, LayoutHash, Phase};
use crate::codec::{self, CodecError, MESSAGE_BYTES_MAX, Wire};
use crate::ids::{Epoch, ImageNumber, McId, Owner, Scan};
use serde::{Deserialize, Serialize};

/// Who may go on with a released MC, and under which epoch.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Successor {
    /// The epoch that was reserved for the successor.
    pub epoch: Epoch,
    /// The successor.
    pub owner: Owner,
}

/// What the bytes behind the outputs are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Content {
    /// The whole state.
    Full,
    /// A [`crate::delta`] against this checkpoint, which the gateway has acknowledged.
    Delta(CheckpointId),
}

/// Everything of a frame but the bytes.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct FrameHeader {
    /// The MC.
    pub mc: McId,
    /// The controller that drives it.
    pub owner: Owner,
    /// The fencing token.
    pub epoch: Epoch,
    /// The scan that this frame is the result of.
    pub scan: Scan,
    /// Input image that the scan used.
    pub image: ImageNumber,
    /// Head of the chain that this epoch starts from. Stands in every frame until the gateway has acknowledged one of the epoch.
    /// `None` only for an MC without history, or after a cold reset.
    pub base: Option<CheckpointId>,
    /// MC time after the scan, in microseconds.
    pub mc_time_us: u64,
    /// Layout of the state.
    pub layout: LayoutHash,
    /// Digest of the whole checkpoint after the scan, also when a delta is sent.
    pub digest: Digest,
    /// Phase of the MC.
    pub phase: Phase,
    /// Set irrevocably by a planned handover: this is the last scan of the epoch.
    pub released_to: Option<Successor>,
    /// CPU time of the scan, in microseconds.
    pub scan_us: u32,
    /// What follows the outputs.
    pub content: Content,
    /// Length of the outputs, in bytes.
    pub outputs_len: u32,
    /// Length of the whole state, in bytes, also when a delta is sent.
    pub state_len: u32,
}

impl FrameHeader {
    /// The checkpoint that the frame carries.
    #[must_use]
    pub fn checkpoint_id(&self) -> CheckpointId {
        CheckpointId {
            epoch: self.epoch,
            scan: self.scan,
            digest: self.digest,
        }
    }
}

impl Wire for FrameHeader {
    const KIND: u8 = 1;
    const NAME: &'static str = "frame";
}

/// A frame read without copying its bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FrameView<'a> {
    /// The header.
    pub header: FrameHeader,
    /// The MC's output image.
    pub outputs: &'a [u8],
    /// State or delta, as `header.content` says.
    pub content: &'a [u8],
}

/// Writes a frame. `header.outputs_len` has to be the length of `outputs`.
///
/// # Errors
/// [`CodecError::TooLarge`] above [`MESSAGE_BYTES_MAX`].
pub fn encode_frame(
    header: &FrameHeader,
    outputs: &[u8],
    content: &[u8],
) -> Result<Vec<u8>, CodecError> {
    debug_assert_eq!(header.outputs_len as usize, outputs.len());
    let mut bytes = codec::encode(header)?;
    let total = bytes.len() + outputs.len() + content.len();
    if total > MESSAGE_BYTES_MAX {
        return Err(CodecError::TooLarge {
            name: FrameHeader::NAME,
            bytes: total,
        });
    }
    bytes.reserve_exact(outputs.len() + content.len());
    bytes.extend_from_slice(outputs);
    bytes.extend_from_slice(content);
    Ok(bytes)
}

/// Reads a frame. The digest is not checked here: the receiver has to rebuild the state first.
///
/// # Errors
/// Any [`CodecError`]; [`CodecError::Damaged`] if the lengths contradict each other.
pub fn decode_frame(bytes: &[u8]) -> Result<FrameView<'_>, CodecError> {
    let (header, used): (FrameHeader, usize) = codec::decode_prefix(bytes)?;
    let rest = &bytes[used..];
    let damaged = CodecError::Damaged {
        name: FrameHeader::NAME,
        bytes: bytes.len(),
    };
    let (outputs, content) = rest
        .split_at_checked(header.outputs_len as usize)
        .ok_or(damaged.clone())?;
    if header.content == Content::Full && content.len() != header.state_len as usize {
        return Err(damaged);
    }
    Ok(FrameView {
        header,
        outputs,
        content,
    })
}
