//! The core of a controller node, without threads, clocks and network: what the scan thread, the sender thread and the
//! replica thread do.
//!
//! - [`spec`]: what a node knows of an MC: control variables, initial values, cycle, diagnosis.
//! - [`runtime`]: the narrow interface to whatever executes an MC; [`plc`] for compiled logic, [`model_mc`] for simulations.
//! - [`newest`]: which image of a gateway is the newest that can be believed.
//! - [`replica`]: the passive side: the newest checkpoints of an MC, and its instance ready to run.
//! - [`active`]: an active MC; it moves as one box from replica to scan thread and back.
//! - [`scan`]: one tick of the scan thread: records, inputs, Control POUs, frames.
//! - [`sender`]: full or delta, digest, bytes of a frame.
//! - [`workload`]: scan times and lag.
//!
//! The way of a state: [`replica::Replica::frame`] keeps it, [`replica::Replica::act`] makes an [`active::ActiveMc`] of it,
//! [`scan::ScanCore::tick`] runs it and gives out [`scan::ScannedFrame`]s, [`sender::FrameEncoder`] makes bytes of them.

pub mod active;
pub mod buffers;
pub mod carry;
pub mod model_mc;
pub mod newest;
#[cfg(feature = "compiled")]
pub mod plc;
mod record;
pub mod replica;
pub mod runtime;
pub mod scan;
pub mod sender;
pub mod spec;
pub mod workload;

pub use active::ActiveMc;
pub use carry::Carry;
pub use replica::{Replica, ReplicaOutcome, StagedVersion};
pub use runtime::McRuntime;
pub use scan::{ScanCommand, ScanCore, ScanHost, ScannedFrame};
pub use sender::FrameEncoder;
pub use spec::{ControlOffsets, McSpec};
