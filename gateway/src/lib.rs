//! The process of an I/O gateway: the core of `fam-gateway-core` under the driver, beside its record file and its field.
//!
//! - [`run()`]: the process; [`GatewayOptions`] says what it needs.
//! - [`records`]: the mapped record file.
//! - [`field`]: Modbus TCP client, and points in memory (`image`), which need no plant.
//! - [`io`]: looking at inputs and outputs, and setting points of the image driver, over the link.
//! - [`recording`]: the journal of applied frames: streamed, asked for, written to a file.
//!
//! A frame's way: Zenoh's thread → queue → core (fence) → record file → field and journal; nothing else waits in between.

pub mod field;
pub mod io;
mod pace;
mod process;
pub mod recording;

pub use fam_gateway_records as records;
pub use process::{CONNECT, GatewayOptions, LISTEN, run, run_model};

#[cfg(test)]
#[path = "../core/tests/common/mod.rs"]
mod testing;
