//! AutomationML: CAEX 3.0 and 2.15, alone or in an `.amlx` container, read into the same model as `cell.toml`, and written.
//!
//! - [`document`]: the XML as objects; 2.15 and 3.0 look the same from here on.
//! - [`library`]: all files of a model; [`classes`]: class paths, inheritance, mirror objects; [`inherited`]: what an object has of its classes.
//! - [`instances`]: all elements, those that classes bring along included.
//! - [`links`]: what an InternalLink joins.
//! - [`uri`], [`container`], [`mod@zip`]: references to files, and the files of a container.
//! - [`cell`]: what the objects mean: the cell's tables.
//! - [`foreign`]: models that know nothing of FAM.
//! - [`mod@write`]: the tables as a CAEX file.

pub mod cell;
pub mod classes;
mod component;
pub mod container;
pub mod document;
pub mod foreign;
pub mod hints;
mod history;
pub mod inherited;
pub mod instances;
pub mod library;
pub mod links;
pub mod logic_reference;
mod unread;
pub mod uri;
pub mod values;
pub mod write;
pub mod zip;

/// The role and interface classes of FAM, as they are shipped in `deploy/lib`.
pub const FAM_LIBRARY: &str = include_str!("../../../deploy/lib/FAM.aml");
/// Name of that file: a reference to a file of this name means the classes of this build, wherever it points.
pub const FAM_LIBRARY_FILE: &str = "FAM.aml";
