//! The interface of every state machine in FAM: inputs and time come in, outputs are polled, deadlines are named.
//!
//! A state machine never waits, never reads a clock and never sends by itself. One mutation (`handle` or
//! `handle_timeout`), then the caller drains `poll_output` to the end, in order, before the next mutation.
//! The production driver and the simulator drive the same code through this trait.

use crate::{BootId, Envelope, Event, InputImage, Now, ProcessId};
use std::sync::Arc;

/// A pure state machine (design, section 6).
pub trait Agent {
    /// What comes in: messages, reports, losses of peers.
    type Input;
    /// What goes out, in order: what is to be made durable, sent, done, reported.
    type Output;

    /// Takes one input at `now`.
    fn handle(&mut self, input: Self::Input, now: Now);
    /// Tells that the deadline named by [`Agent::poll_timeout`] has come (or that some time has passed: calling it early is harmless).
    fn handle_timeout(&mut self, now: Now);
    /// The next output, oldest first.
    fn poll_output(&mut self) -> Option<Self::Output>;
    /// The next deadline, and why.
    fn poll_timeout(&self) -> Option<(Now, &'static str)>;
}

/// What comes into a process's state machine from the driver; `L` is what the process itself feeds in (scan thread, field driver).
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
// Lives on the stack of whoever hands it over; a box for each message would cost more than the copy.
#[allow(clippy::large_enum_variant)]
pub enum Input<L> {
    /// A message for an agent of this process.
    Message(Envelope),
    /// A liveliness token appeared (`alive`) or is gone.
    Peer {
        /// The process.
        process: ProcessId,
        /// Its life.
        boot: BootId,
        /// Whether it is there.
        alive: bool,
    },
    /// A gateway's newest image.
    Image(Arc<InputImage>),
    /// The driver has carried out an `Output::Persist`. Epochs and the like count only from here on.
    Persisted {
        /// The ticket of the write.
        ticket: u64,
        /// `Err`: what the disk said. Nothing that depends on the write may go out.
        result: Result<(), String>,
    },
    /// From the process itself.
    Local(L),
}

/// What a process's state machine wants done, in order; `P` is what it makes durable, `X` what the process itself does.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[allow(clippy::large_enum_variant)] // as above
pub enum Output<P, X> {
    /// Make this durable, then answer with `Input::Persisted` (before anything else is handled).
    Persist {
        /// Number that the answer carries.
        ticket: u64,
        /// What to write.
        write: P,
    },
    /// Send a message (agents of the same process get it looped back).
    Send(Envelope),
    /// Do something.
    Act(X),
    /// For the history: logged, and sent to the manager by other processes.
    Event(Event),
}
