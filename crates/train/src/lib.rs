//! The command `veiloc train`: what an attacker teaches a machine.
//!
//! Arguments, the clock, and the file from which a training goes on; what is learned is in `veiloc-outsider`, and what is
//! said of it in `veiloc-audit`. A build without the feature `network` knows the arguments and says how to get the rest.
#![forbid(unsafe_code)]

mod command;
mod course;
mod neighbours;
mod positions;

pub use command::{Command, run};
pub use neighbours::NeighbourArgs;
pub use positions::PositionArgs;
