//! The plant process: a simulated machine of `fam-plant-core`, the FMS-200 cell or the marking machine, behind Modbus TCP, in real time.
//!
//! Each station is one Modbus unit (1 to 4), the transport is unit 5; `deploy/fms200/REGISTERS.md` is the signal map. A second
//! port tells tests and reports what happened in the cell: see [`PlantStatus`].
//!
//! The mechanics advance when a request comes and at least every 5 ms, always up to the present, so that what a controller
//! reads is as new as its request.

mod cell;
mod modbus;
mod pace;
mod server;
mod status;

pub use fam_plant_core::{Incident, IncidentKind, Ledger, MachineKind, PlantConfig, Product};
pub use modbus::{IMAGE_INPUT_WORDS, IMAGE_INPUTS, IMAGE_OUTPUT_WORDS, IMAGE_OUTPUTS};
pub use server::{PlantOptions, PlantServer, run};
pub use status::{PlantStatus, StatusClient};
