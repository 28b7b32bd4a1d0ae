//! The commands that run until they are told to stop: `veiloc serve` and `veiloc worker`. One file a command: its arguments, and the
//! few lines that hand them to the libraries.
#![forbid(unsafe_code)]

#[cfg(feature = "cluster")]
mod cluster_args;
mod map_memory;
pub mod page_args;
pub mod serve;
mod settled;
mod voice;
#[cfg(feature = "cluster")]
pub mod worker;

use veiloc_arguments::settings::layered;
// Every command talks by these: they go by the names of their files.
use veiloc_terminal::{exit, ui};

/// The command that reads the command line of `serve` and `worker`, before files and variables are looked at.
pub fn first_look(command: clap::Command) -> clap::Command {
    let command = command.mut_subcommand("serve", layered);
    #[cfg(feature = "cluster")]
    let command = command.mut_subcommand("worker", layered);
    command
}
