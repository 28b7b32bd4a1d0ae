//! `veiloc train`: what an attacker teaches a machine.

mod neighbours;

use crate::exit::Outcome;
use crate::ui::Ui;

/// What to train.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// The attention network that tells neighbours from descriptors alone.
    Neighbours(neighbours::Args),
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Neighbours(args) => neighbours::run(args, ui),
    }
}
