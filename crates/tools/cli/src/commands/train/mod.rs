//! `veiloc train`: what an attacker teaches a machine.

mod attention;
mod course;
mod inversion;
mod neighbours;
mod positions;

use crate::exit::Outcome;
use crate::ui::Ui;

/// What to train.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// The attention network that tells neighbours from descriptors alone.
    Neighbours(neighbours::Args),
    /// The attention network that tells positions from all rows of a query, descriptors and lines.
    Positions(positions::Args),
    /// The network, a U-Net or three in a row, that makes images of descriptors and their places, their lines, or nothing but a bag of them.
    Inversion(inversion::Args),
}

/// Runs one of `veiloc train`.
///
/// # Errors
/// What was given cannot be read, or makes no sense together; results cannot be written.
pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Neighbours(args) => neighbours::run(args, ui),
        Command::Positions(args) => positions::run(args, ui),
        Command::Inversion(args) => inversion::run(args, ui),
    }
}
