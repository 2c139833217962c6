//! A controller node: one soft-PLC, one Controller Agent, and one MC Agent for each MC that it hosts, in one process.
//!
//! ```text
//!   Zenoh's thread            agents (tokio)          replica thread         scan thread          sender thread
//!   --------------            --------------          --------------         -----------          -------------
//!   images ---- mailbox ------------------------------------------------------> tick
//!   images, messages -------> NodeAgents --- acts ---> Replica --- ActiveMc --> ScanCore -- frames --> FrameEncoder --> Zenoh
//!   frames -------------------------------------------> Replica <-- ActiveMc --   |
//!                             NodeAgents <-- news ------ + <------- news ---------+
//! ```
//!
//! The scan thread waits for nothing but the next tick or the start of an interrupted MC: images lie in a lock-free
//! mailbox ([`mailbox`]), commands and frames pass through bounded queues, and it never puts anything on the network. A
//! watchdog thread ends endless loops, by the scan thread's own CPU time.

mod cache;
mod cpu;
mod hosted;
pub mod mailbox;
mod real_time;
mod replica_thread;
mod run;
pub mod scan_thread;
mod sender_thread;
mod shared;
mod shell;
mod stage;
pub mod trace;
mod watchdog;

pub use hosted::{HostError, Hosted, host};
pub use real_time::RealTimeOptions;
pub use run::{NodeOptions, run};
