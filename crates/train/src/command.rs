//! What can be trained.

use veiloc_terminal::exit::Outcome;
use veiloc_terminal::ui::Ui;

use crate::neighbours::NeighbourArgs;
use crate::positions::PositionArgs;

/// What to train.
#[derive(clap::Subcommand)]
pub enum Command {
    /// The attention network that tells neighbours from descriptors alone.
    Neighbours(NeighbourArgs),
    /// The attention network that tells positions from all rows of a query, descriptors and lines.
    Positions(PositionArgs),
}

/// Trains, and writes what was learned.
///
/// # Errors
/// A failure that says whose fault it is: files, options, or a training that found nothing.
#[cfg(feature = "network")]
pub fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Neighbours(args) => crate::neighbours::run(args, ui),
        Command::Positions(args) => crate::positions::run(args, ui),
    }
}

/// Says how to get what trains.
///
/// # Errors
/// Always.
#[cfg(not(feature = "network"))]
pub fn run(_command: &Command, _ui: &Ui) -> Outcome {
    Err(veiloc_terminal::exit::Failure::with_help(
        "this veiloc was built without networks",
        "build it with `cargo build --release -p veiloc-cli --features network`",
    ))
}
