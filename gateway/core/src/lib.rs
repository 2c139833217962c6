//! The core of an I/O gateway: records, fence, chain, watchdogs, fail-safe values and input images, without any I/O.
//!
//! The gateway stands between controllers and field devices. It keeps one *record* for each MC, the head of the MC's
//! chain of frames, and is the witness of who drives: a frame reaches the field only through [`fence`], an epoch begins
//! only through [`opening`], and silence ends in latched fail-safe values ([`gateway`]).
//!
//! ```text
//!  frame ──> fence ──> Persist(head) ──Persisted(Ok)──> ApplyOutputs, head of the chain, acknowledged in the next image
//!  open  ──> opening ─> Persist(ledger, synced) ─Persisted(Ok)─> Opened (else OpenRefused)
//!  tick  ──> ReadField ──Field──> PublishImage(inputs, exported variables, records)
//!  time  ──> suspect (reported) ──> watchdog: fail-safe values, epoch closed
//! ```
//!
//! Parts: [`gateway`] the state machine, [`gate`] one MC's record and fence, [`chain`] the checkpoints that deltas build on,
//! [`ages`] how old an input image is, [`stored`] what reaches the record file, [`place`] bits and bytes of process images,
//! [`modbus`] what to read and write of Modbus devices, [`recorder`] the journal behind the fence and what it shows.
//!
//! The gateway never reads a clock, never waits, and never answers an open before the ledger is durable.

pub mod ages;
pub mod chain;
pub mod fence;
pub mod gate;
pub mod gateway;
pub mod modbus;
pub mod opening;
pub mod place;
pub mod recorder;
pub mod stored;

pub use fence::Rejection;
pub use gateway::{
    Gateway, GatewayAct, GatewayError, GatewayInput, GatewayLocal, GatewayOutput, Why,
};
pub use stored::{MemoryRecords, RecordWrite, StoredHead, StoredRecord};
