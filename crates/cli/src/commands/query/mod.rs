//! `veiloc query`: the client of the service.

mod connection;
pub(crate) mod send;
mod session;

use std::sync::Arc;

use crate::output::exit::Outcome;
use crate::output::ui::Ui;

/// Localize an image with a service, without sending the image.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Seal one image, or read the sealed queries of a session, send them, and print the pose.
    Send(send::Args),
}

pub(crate) fn run(command: &Command, ui: &Arc<Ui>) -> Outcome {
    match command {
        Command::Send(args) => send::run(args, ui),
    }
}
