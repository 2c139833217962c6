//! Runs any agent on tokio and Zenoh. The only crate that names Zenoh.
//!
//! - [`Link`]: one process's connection to its cell: messages, input images, frames, events, who is alive.
//! - [`run()`]: drives one [`fam_proto::Agent`] with what comes in and carries out what goes out, strictly in order.
//! - [`cells_at`]: which cells answer at an endpoint.
//! - [`Client`]: an operator's command: asks the manager, and repeats until it is answered.
//! - [`FrameSender`]: puts frames from a plain thread.
//! - [`Topic`], [`Link::subscribe`], [`Link::serve`], [`Link::request`]: plain bytes for recorders and field values.
//! - [`init_logging`], [`clock`], [`boot_id`], [`boot_after`], [`runtime`], [`termination`]: what each process needs around them.
//!
//! Everything here needs a multi-threaded tokio runtime ([`runtime`], or `#[tokio::test(flavor = "multi_thread")]`).

mod bad;
mod cells;
mod client;
mod clock;
mod config;
mod frames;
mod linger;
mod link;
mod logging;
mod pieces;
mod process;
mod reach;
mod run;
mod topic;

pub use cells::cells_at;
pub use client::{Client, ClientError};
pub use clock::{boot_after, boot_id, clock, now, wall_us};
pub use frames::{FrameBytes, FrameSender, FrameSink, Frames, ImageSink, Sinks};
pub use link::{EVENTS_WAITING_MAX, Link, LinkError, LinkEvent, LinkEvents, LinkOptions};
pub use logging::{LogFormat, init_logging, log_event};
pub use process::{runtime, termination};
pub use run::{Shell, run};
pub use topic::{RequestError, Server, Subscription, Topic};
