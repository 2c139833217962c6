//! The manager process: Middleware Manager, QoS Monitors and Diagnosis & Decision under the driver, and the System Repository.
//!
//! - [`run`]: the whole process from its options: cell file, repository, endpoints.
//! - [`run_on`]: the same over a model and a repository that are already there, for tests and for programs that embed it.
//!
//! The agents decide; this crate gives them a disk (`store`), a wall clock and a log (`shell`, `spans`). When it dies the
//! plant goes on; when it comes back it takes the plant as it finds it.

mod process;
mod shell;
mod spans;
mod store;

pub use process::{ManagerOptions, run, run_on};
