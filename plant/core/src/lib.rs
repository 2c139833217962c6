//! Simulated machines as pure, seeded mechanics: the FMS-200 flexible assembly cell with its four stations and its transport loop,
//! and the [marking machine](marking).
//!
//! [`Plant`] holds the whole cell. [`Plant::step`] lets simulated time pass, in ticks of 1 ms; between steps a controller reads and
//! writes the process image of each unit, as `deploy/fms200/REGISTERS.md` documents it. There is no clock, no randomness and no input or
//! output here, and all quantities are integers (micrometres, microseconds), so that the same seed and the same writes at the same
//! times give the same cell, bit for bit. What a part is depends only on the seed, its magazine and its number in that
//! magazine, never on time: products compare between runs whose timing differs.
//!
//! What real mechanics would punish is an [`Incident`]; where every part went is in the [`Ledger`].
//!
//! ```text
//! plant      all units, orders, the tick
//! ├── feeding     station 1: lane + hand
//! ├── fitting     station 2: two lanes + hand
//! ├── closing     station 3: lane + hand
//! ├── storage     station 4: drives + fork and gripper + rack
//! └── transport   belt, pallets, stoppers, lifters
//!     lane (magazines, pusher, nest, probe, ejector), hand (arm, lift, suction), cylinder, drive
//!     records (parts, ledger, incidents), part, order, image, signals
//! ```

mod closing;
mod cylinder;
mod drive;
mod feeding;
mod fitting;
mod hand;
mod image;
mod incident;
mod lane;
mod machine;
pub mod marking;
mod order;
mod part;
mod plant;
mod records;
pub mod signals;
mod storage;
mod transport;

pub use image::{
    AddressError, COILS, DISCRETE_INPUTS, HOLDING_REGISTERS, INPUT_REGISTERS, UnitImage,
};
pub use incident::{Incident, IncidentKind};
pub use machine::{MachineKind, Mechanics, machine};
pub use marking::MarkingMachine;
pub use order::Variant;
pub use part::{BearingHeight, LidHeight, Material, Part, PartId, PartKind, Shape};
pub use plant::{ConfigError, PALLETS_MAX, Plant, PlantConfig, TICK_US, UNITS};
pub use records::{Ledger, PartPlaces, Product};
