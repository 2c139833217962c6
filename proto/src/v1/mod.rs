//! The wire and disk types of format version 1. Frozen once released: a change makes a `v2` beside it.
//!
//! Only types in these modules derive `Serialize` for wire and disk (and the ids that they hold).

pub mod checkpoint;
pub mod event;
pub mod frame;
pub mod gateway;
pub mod image;
pub mod message;
pub mod operator;
pub mod piece;
pub mod plan;
pub mod record;
pub mod repository;

pub use checkpoint::*;
pub use event::*;
pub use frame::*;
pub use gateway::*;
pub use image::*;
pub use message::*;
pub use operator::*;
pub use piece::*;
pub use plan::*;
pub use record::*;
pub use repository::*;
