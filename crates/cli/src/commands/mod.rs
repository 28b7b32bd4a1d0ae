//! One file per command: its arguments, and the calls of the libraries.

pub(crate) mod attack;
pub(crate) mod audit;
mod coordinate_frame_check;
pub(crate) mod demo;
mod device_args;
pub(crate) mod eval;
#[cfg(feature = "hloc")]
pub(crate) mod features;
pub(crate) mod image_list;
pub(crate) mod localize;
mod logger;
pub(crate) mod map;
mod map_memory;
mod mask_args;
#[cfg(not(all(feature = "cluster", feature = "hloc")))]
pub(crate) mod missing_feature;
pub(crate) mod models;
mod page_args;
mod posed;
pub(crate) mod query;
mod rig_file;
pub(crate) mod seal;
pub(crate) mod serve;
mod session_args;
#[cfg(feature = "cluster")]
mod store_args;
pub(crate) mod synth;
pub(crate) mod token;
mod user_folder;
mod with_config;

use crate::args::settings::layered;

/// Prepares the command line of `serve`, which is parsed before the settings file and variables are read.
pub(crate) fn prepare_layered(command: clap::Command) -> clap::Command {
    command.mut_subcommand("serve", layered)
}
