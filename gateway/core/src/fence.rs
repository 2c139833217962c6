//! The fence: what a frame has to be so that its outputs reach the field. Each check is one function with one reason.
//!
//! Order of the checks: MC known, not a repetition, record open, epoch, owner, scan, base, input image, layout and
//! lengths, successor, then the content is rebuilt and its digest compared. The first that fails names the rejection.

use crate::ages::Age;
use crate::gate::Gate;
use fam_proto::{FrameHeader, Now, RecordState};

/// No owner can be this many scans ahead of the head: its watchdog would have closed the epoch long before.
pub const SCANS_AHEAD_MAX: u64 = 1_000_000;

/// Why a frame is not applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rejection {
    /// The frame does not read.
    Unreadable,
    /// The gateway does not serve the MC.
    UnknownMc,
    /// A write of the record is under way; the sender goes on with its next frame.
    Busy,
    /// No epoch is open.
    NotOpen,
    /// The epoch is lower than the open one: its owner was deposed.
    OldEpoch,
    /// The epoch was never opened here.
    UnopenedEpoch,
    /// The epoch belongs to another owner.
    OtherOwner,
    /// The scan is not above the head's.
    OldScan,
    /// The scan is further ahead than is possible.
    ScanTooFarAhead,
    /// The first frame of the epoch does not build on the head.
    WrongBase,
    /// The input image that it names was never sent.
    UnknownImage,
    /// The inputs that it was computed from are older than the watchdog time.
    OldImage,
    /// The state has another layout.
    Layout,
    /// The outputs have another length.
    OutputsLength,
    /// The state has another length.
    StateLength,
    /// It releases the MC to an epoch that is not above its own.
    BadSuccessor,
    /// The checkpoint that its delta builds on is not held.
    BaseNotHeld,
    /// The delta does not read.
    DeltaDamaged,
    /// The rebuilt state is not the one that the sender had.
    WrongDigest,
    /// The record could not be written, so the outputs were not applied.
    NotRecorded,
}

impl Rejection {
    /// In words, for events.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Rejection::Unreadable => "does not read",
            Rejection::UnknownMc => "MC not served here",
            Rejection::Busy => "record being written",
            Rejection::NotOpen => "no epoch open",
            Rejection::OldEpoch => "epoch of a deposed owner",
            Rejection::UnopenedEpoch => "epoch never opened",
            Rejection::OtherOwner => "epoch of another owner",
            Rejection::OldScan => "scan not above the last one applied",
            Rejection::ScanTooFarAhead => "scan impossibly far ahead",
            Rejection::WrongBase => "does not build on the state applied last",
            Rejection::UnknownImage => "names an input image that was never sent",
            Rejection::OldImage => "computed from inputs older than the watchdog time",
            Rejection::Layout => "state of another layout",
            Rejection::OutputsLength => "outputs of another length",
            Rejection::StateLength => "state of another length",
            Rejection::BadSuccessor => "releases to an epoch not above its own",
            Rejection::BaseNotHeld => "delta on a checkpoint that is not held",
            Rejection::DeltaDamaged => "damaged delta",
            Rejection::WrongDigest => "state differs from its digest",
            Rejection::NotRecorded => "record could not be written",
        }
    }
}

impl std::fmt::Display for Rejection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.words())
    }
}

type Check = fn(&Gate, &FrameHeader, Now) -> Result<(), Rejection>;

/// Whether the sender may drive at all: what a test build can switch off.
pub(crate) const AUTHORITY: &[Check] = &[open, epoch, owner, scan, base, image];
/// Whether the frame fits the MC.
pub(crate) const SHAPE: &[Check] = &[idle, layout, outputs_length, state_length, successor];

fn require(good: bool, rejection: Rejection) -> Result<(), Rejection> {
    if good { Ok(()) } else { Err(rejection) }
}

/// A frame that is the head already: sent again, or arrived twice.
pub(crate) fn is_repetition(gate: &Gate, frame: &FrameHeader) -> bool {
    let record = gate.ledger();
    record.epoch == frame.epoch
        && record.owner.as_ref() == Some(&frame.owner)
        && gate.head_id() == Some(frame.checkpoint_id())
}

fn idle(gate: &Gate, _: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(!gate.is_writing(), Rejection::Busy)
}

fn open(gate: &Gate, _: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(gate.ledger().state == RecordState::Open, Rejection::NotOpen)
}

fn epoch(gate: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(frame.epoch >= gate.ledger().epoch, Rejection::OldEpoch)?;
    require(frame.epoch == gate.ledger().epoch, Rejection::UnopenedEpoch)
}

fn owner(gate: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(
        gate.ledger().owner.as_ref() == Some(&frame.owner),
        Rejection::OtherOwner,
    )
}

fn scan(gate: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    let last = gate.ledger().last_scan;
    require(frame.scan > last, Rejection::OldScan)?;
    require(
        frame.scan.0 - last.0 <= SCANS_AHEAD_MAX,
        Rejection::ScanTooFarAhead,
    )
}

fn base(gate: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(
        gate.ledger().driven || frame.base == gate.head_id(),
        Rejection::WrongBase,
    )
}

fn image(gate: &Gate, frame: &FrameHeader, now: Now) -> Result<(), Rejection> {
    match gate.ages().age(frame.image, now) {
        Age::Us(us) => require(us <= gate.model().watchdog_us, Rejection::OldImage),
        Age::TooOld => Err(Rejection::OldImage),
        Age::Unknown => Err(Rejection::UnknownImage),
    }
}

fn layout(gate: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(frame.layout == gate.layout(), Rejection::Layout)
}

fn outputs_length(gate: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(
        frame.outputs_len as usize == gate.model().fail_safe.len(),
        Rejection::OutputsLength,
    )
}

fn state_length(gate: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(
        gate.fits(frame.layout, frame.state_len),
        Rejection::StateLength,
    )
}

fn successor(_: &Gate, frame: &FrameHeader, _: Now) -> Result<(), Rejection> {
    require(
        frame
            .released_to
            .as_ref()
            .is_none_or(|to| to.epoch > frame.epoch),
        Rejection::BadSuccessor,
    )
}
