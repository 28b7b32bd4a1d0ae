//! `veiloc synth`: rendered places, written as data sets.

mod city;
mod export;

use std::path::Path;

use crate::exit::{Failure, Outcome};
use crate::ui::Ui;

/// What to do with rendered places.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// A rendered place with its true poses, in the folders and lists of a published data set.
    Export(export::Args),
    /// Many rendered rooms in one world, some of which look alike: to see how maps, search and trust hold as they grow.
    City(city::Args),
}

/// Runs one of `veiloc synth`.
///
/// # Errors
/// The folder holds something, or cannot be written.
pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Export(args) => export::run(args, ui),
        Command::City(args) => city::run(args, ui),
    }
}

/// Nothing that is there is written over.
fn check_empty(folder: &Path) -> Result<(), Failure> {
    if std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Failure::with_help(
            format!("{}: there is something in it", folder.display()),
            "name a folder that is new or empty; nothing there was touched",
        ));
    }
    Ok(())
}

fn refused(error: impl ToString) -> Failure {
    Failure::with_help(error.to_string(), "name a folder that may be written")
}
