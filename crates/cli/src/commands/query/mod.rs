//! `veiloc query`: the device's side of the service.

mod client;
mod profile_cache;
mod send;

use crate::exit::Outcome;
use crate::ui::Ui;

/// Ask a service where an image was taken, without sending it.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Seal one image, send it, print the pose.
    Send(send::Args),
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Send(args) => send::run(args, ui),
    }
}
