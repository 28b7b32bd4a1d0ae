//! `veiloc query`: the device's side of the service.

mod connection;
mod send;
mod session;

use std::sync::Arc;

use crate::exit::Outcome;
use crate::ui::Ui;

/// Ask a service where an image was taken, without sending it.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Seal one image, or take the sealed ones of a session, send, print the pose.
    Send(send::Args),
}

pub(crate) fn run(command: &Command, ui: &Arc<Ui>) -> Outcome {
    match command {
        Command::Send(args) => send::run(args, ui),
    }
}
