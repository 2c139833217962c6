//! The System Repository on disk: what the Middleware Manager knows, in a redb database over any storage backend.
//!
//! - [`Repository`]: stores [`fam_proto::RepoWrite`]s, loads their sum as [`fam_proto::RepoState`].
//! - [`open_file`]: a file, refused untouched if it is torn, foreign, of another cell or of a newer version.
//! - [`disk`]: a disk in memory that crashes and fills up, for tests and the simulation.
//!
//! This crate reads no clock and starts no thread; its only I/O is what the storage backend does.

pub mod disk;
mod error;
mod file;
mod store;

pub use error::RepositoryError;
pub use file::open_file;
pub use store::{EVENTS_KEPT_MAX, FORMAT, Repository};
