//! One file per command: its arguments, and the calls of the libraries.

#[cfg(not(all(feature = "cluster", feature = "hloc")))]
pub(crate) mod absent;
pub(crate) mod attack;
pub(crate) mod audit;
#[cfg(feature = "cluster")]
mod cluster_args;
pub(crate) mod demo;
mod device_args;
pub(crate) mod eval;
#[cfg(feature = "hloc")]
pub(crate) mod features;
pub(crate) mod listed;
pub(crate) mod localize;
pub(crate) mod map;
mod map_memory;
mod mask_args;
pub(crate) mod models;
mod page_args;
pub(crate) mod query;
mod rig_file;
pub(crate) mod seal;
pub(crate) mod serve;
mod session_args;
mod settled;
pub(crate) mod synth;
pub(crate) mod token;
mod voice;
#[cfg(feature = "cluster")]
pub(crate) mod worker;

use crate::args::settings::layered;

/// Prepares the command line of `serve` and `worker`, which is parsed before the settings file and variables are read.
pub(crate) fn first_look(command: clap::Command) -> clap::Command {
    let command = command.mut_subcommand("serve", layered);
    #[cfg(feature = "cluster")]
    let command = command.mut_subcommand("worker", layered);
    command
}
