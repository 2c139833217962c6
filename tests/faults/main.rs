//! Real faults on real processes: every process of the FMS-200 cell is a host of its own, a network namespace whose only cable
//! ends in a relay of ours that cuts, delays, loses, doubles and reorders packets.
//!
//! After each fault the same is asked: no scan was driven twice and none that was applied is lost (by the journal behind the
//! gateway's fence), the plant had no incident, the right controller drives, and the event log tells what happened.
//! Where no namespace can be made the tests print why and check nothing; where one can, whatever is missing then is a failure.

mod cell;
mod clocks;
mod disks;
mod journal;
mod links;
mod net;
mod process;
mod processes;
mod stages;
mod stalls;
mod weather;
