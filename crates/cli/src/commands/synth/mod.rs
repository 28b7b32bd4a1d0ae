//! `veiloc synth`: renders scenes and writes them as data sets.

mod city;
mod export;

use std::path::Path;

use crate::output::exit::{Failure, Outcome};
use crate::output::ui::Ui;

/// What to render.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Render a scene with its true poses, in the folders and lists of a published data set.
    Export(export::Args),
    /// Render many rooms in one world, some of them similar, to test how maps, retrieval and trust scale.
    City(city::Args),
}

/// Runs a command of `veiloc synth`.
///
/// # Errors
/// The folder is not empty, or cannot be written.
pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::Export(args) => export::run(args, ui),
        Command::City(args) => city::run(args, ui),
    }
}

/// Existing files are never overwritten.
fn check_empty(folder: &Path) -> Result<(), Failure> {
    if std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) {
        return Err(Failure::with_help(
            format!("{}: the folder is not empty", folder.display()),
            "give a new or empty folder; nothing was changed",
        ));
    }
    Ok(())
}

fn refused(error: impl ToString) -> Failure {
    Failure::with_help(error.to_string(), "give a writable folder")
}
