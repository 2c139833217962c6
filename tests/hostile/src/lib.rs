//! What hostile bytes must not do to anything in FAM that reads bytes: one function for each decoder.
//!
//! Each function of [`TARGETS`] takes any bytes and panics if a promise breaks: a decoder that accepts something which it
//! writes differently, a fence that lets through what is not the owner's, a state that is half changed, or a panic of the
//! code itself. The fuzz targets (`tests/fuzz`) and the property test (`tests/decoders.rs`, stable toolchain) run the same
//! functions on the same [`seeds`].

mod agents;
mod assembly;
mod cell;
mod diagnosis;
#[cfg(feature = "diagnosis-file")]
mod models;
mod pieces;
mod records;
mod repository;
pub mod seeds;
mod wire;

pub use agents::agents;
pub use assembly::piece;
pub use cell::{cell, gateway_id, mc_id, owner};
pub use diagnosis::diagnosis;
#[cfg(feature = "diagnosis-file")]
pub use models::{amlx, caex, diagnosis_file, plcopen};
pub use records::records;
pub use repository::repository;
pub use wire::{checkpoint, frame, image, message};

/// A decoder under test: its name, and what it must stand.
pub type Target = (&'static str, fn(&[u8]));

/// All of them.
pub const TARGETS: [Target; 9] = [
    ("message", message),
    ("frame", frame),
    ("checkpoint", checkpoint),
    ("image", image),
    ("piece", piece),
    ("records", records),
    ("repository", repository),
    ("diagnosis", diagnosis),
    ("agents", agents),
];

/// Readers of model files.
#[cfg(feature = "diagnosis-file")]
pub const MODEL_TARGETS: [Target; 4] = [
    ("caex", caex),
    ("amlx", amlx),
    ("plcopen", plcopen),
    ("diagnosis_file", diagnosis_file),
];
