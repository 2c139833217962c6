//! The manager's agents, flow by flow: tables of (time, input, expected outputs).

mod bench;
mod cell;
mod failover;
mod operator;
mod qualities;
mod random;
mod start;
mod work_balance;
