//! The `veiloc` binary: reads the command line, calls the libraries, and tells people how it went.
//!
//! Data goes to stdout (`--json`, tables), talk and progress go to stderr. Exit codes: 0 success, 1 the input was
//! refused or nothing was localized, 2 wrong usage, 3 our own error.
#![forbid(unsafe_code)]

mod commands;
mod exit;
mod files;
mod ui;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::ui::Ui;

/// Visual localization in which neither the image nor the keypoint positions leave the device.
#[derive(Parser)]
#[command(name = "veiloc", version, max_term_width = 110)]
struct Cli {
    /// No progress bars and no remarks, only results and errors.
    #[arg(long, short, global = true)]
    quiet: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Render a place, map it, localize hidden queries, attack them, write a report.
    Demo(commands::demo::Args),
    /// Build, import, inspect and change maps.
    #[command(subcommand)]
    Map(commands::map::Command),
    /// Turn images into sealed queries, as a device does.
    Seal(commands::seal::Args),
    /// Find where sealed queries were taken.
    Localize(commands::localize::Args),
    /// Serve maps: sealed queries in over HTTP, poses out.
    Serve(commands::serve::Args),
    /// Ask a service where an image was taken, without sending it.
    #[command(subcommand)]
    Query(commands::query::Command),
    /// Measure localization on data with known poses.
    #[command(subcommand)]
    Eval(commands::eval::Command),
    /// Recover keypoints from what is sent, by every attack under every scheme.
    Attack(commands::attack::Args),
    /// Attack what would be sent of your images, and write a report on it.
    Audit(commands::audit::Args),
    /// Teach a machine what an attacker would: to tell neighbours from descriptors.
    #[command(subcommand)]
    Train(commands::train::Command),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let ui = Ui::new(cli.quiet);
    let result = exit::catching_panics(|| match &cli.command {
        Command::Demo(args) => commands::demo::run(args, &ui),
        Command::Map(command) => commands::map::run(command, &ui),
        Command::Seal(args) => commands::seal::run(args, &ui),
        Command::Localize(args) => commands::localize::run(args, &ui),
        Command::Serve(args) => commands::serve::run(args, &ui),
        Command::Query(command) => commands::query::run(command, &ui),
        Command::Eval(command) => commands::eval::run(command, &ui),
        Command::Attack(args) => commands::attack::run(args, &ui),
        Command::Audit(args) => commands::audit::run(args, &ui),
        Command::Train(command) => commands::train::run(command, &ui),
    });
    match result {
        Ok(exit) => exit.into(),
        Err(failure) => {
            ui.failure(&failure);
            failure.exit().into()
        }
    }
}
