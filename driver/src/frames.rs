//! Frames: put from plain threads, received without a copy on Zenoh's own thread.

use crate::pieces::{PieceSender, Taker};
use fam_proto::{BootId, CellId, InputImage, McId, keys};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Publisher;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::sample::Locality;

/// Which frames a process receives. A process never receives its own.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Frames {
    /// None.
    #[default]
    None,
    /// Those of every MC of the cell.
    All,
    /// Those of these MCs.
    Of(Vec<McId>),
}

/// The bytes of a received frame as they came; a large one lies in several pieces.
#[derive(Debug, Clone)]
pub struct FrameBytes(pub(crate) ZBytes);

impl FrameBytes {
    /// Length in bytes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }
    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
    /// The bytes in one piece; copied only if they came in several.
    #[must_use]
    pub fn contiguous(&self) -> Cow<'_, [u8]> {
        self.0.to_bytes()
    }
    /// The pieces, in order.
    pub fn pieces(&self) -> impl Iterator<Item = &[u8]> {
        self.0.slices()
    }
    /// A shared copy.
    #[must_use]
    pub fn to_arc(&self) -> Arc<[u8]> {
        Arc::from(&*self.contiguous())
    }
}

/// Takes frames on Zenoh's thread: it must hand them on and return.
pub type FrameSink = Arc<dyn Fn(McId, FrameBytes) + Send + Sync>;
/// Takes images on Zenoh's thread, before they come as a [`crate::LinkEvent`] too.
pub type ImageSink = Arc<dyn Fn(&Arc<InputImage>) + Send + Sync>;

/// Where data goes at once, on Zenoh's thread, past the queue of events.
#[derive(Clone, Default)]
pub struct Sinks {
    /// Frames; they are then no [`crate::LinkEvent`]s any more.
    pub frame: Option<FrameSink>,
    /// Images.
    pub image: Option<ImageSink>,
}

/// Puts frames; for the sender thread of a node, which may block (the scan thread must not).
#[derive(Clone)]
pub struct FrameSender {
    session: zenoh::Session,
    cell: CellId,
    pieces: Arc<PieceSender>,
    publishers: Arc<Mutex<BTreeMap<McId, Publishers>>>,
}

/// Of one MC's frames.
struct Publishers {
    /// Leaves at once, with all that waits before it.
    last: Publisher<'static>,
    /// Waits for what follows.
    followed: Publisher<'static>,
}

impl FrameSender {
    pub(crate) fn new(
        session: zenoh::Session,
        cell: CellId,
        pieces: Arc<PieceSender>,
    ) -> FrameSender {
        FrameSender {
            session,
            cell,
            pieces,
            publishers: Arc::default(),
        }
    }

    /// Puts a frame. A receiver that is too slow misses it: its next full checkpoint makes that good. Returns whether the
    /// session took it. One that is too long for one message goes in pieces, each acknowledged by the gateway. One that is
    /// `followed` by another at once may leave in one packet with it.
    pub fn put_frame(&self, mc: &McId, bytes: Vec<u8>, followed: bool) -> bool {
        if PieceSender::has_to(&bytes) {
            return self
                .pieces
                .send(&keys::frame(&self.cell, mc), Taker::Gateway, bytes);
        }
        let Ok(mut publishers) = self.publishers.lock() else {
            return false;
        };
        if !publishers.contains_key(mc) {
            match (self.publisher(mc, true), self.publisher(mc, false)) {
                (Ok(last), Ok(followed)) => {
                    publishers.insert(mc.clone(), Publishers { last, followed })
                }
                (Err(error), _) | (_, Err(error)) => {
                    tracing::error!(mc = %mc, "frames of {mc} cannot be sent: {error}");
                    return false;
                }
            };
        }
        let publishers = &publishers[mc];
        let publisher = if followed {
            &publishers.followed
        } else {
            &publishers.last
        };
        publisher.put(bytes).wait().is_ok()
    }

    fn publisher(&self, mc: &McId, express: bool) -> zenoh::Result<Publisher<'static>> {
        self.session
            .declare_publisher(keys::frame(&self.cell, mc))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::DataHigh)
            .express(express)
            .allowed_destination(Locality::Remote)
            .wait()
    }
}

impl std::fmt::Debug for FrameSender {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FrameSender").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for Sinks {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Sinks")
            .field("frame", &self.frame.is_some())
            .field("image", &self.image.is_some())
            .finish()
    }
}

/// What stands beside each message in plain text, so that even one of another version names its sender.
pub(crate) fn signature(process: &fam_proto::ProcessId, boot: BootId) -> String {
    format!("{process} (boot {boot})")
}
