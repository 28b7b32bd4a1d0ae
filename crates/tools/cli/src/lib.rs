//! The `veiloc` program as a library: reads a command line, calls the libraries, and tells people how it went.
//!
//! [`run`] is all of it; the binary calls it, and so does the Python package, which carries the same program. Data goes to stdout (`--json`, tables), talk and progress go to stderr. Exit codes: 0 success, 1 the input was
//! refused or nothing was localized, 2 wrong usage, 3 results could not be written or our own error.
#![forbid(unsafe_code)]

pub mod args;
mod commands;
mod demo;
mod output;

use std::ffi::OsString;
use std::sync::Arc;

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
// Every command talks by these: they go by the names of their files.
use crate::args::{
    camera, extraction_args, faults, feature_args, global_args, json_args, localization_args,
    progressive_args, report_args,
};
use crate::output::{exit, files, items, lists, stages, ui};

use crate::exit::{Exit, Failure};
use crate::ui::Ui;

/// Visual localization in which neither the image nor the keypoint positions leave the device.
#[derive(Parser)]
#[command(name = "veiloc", version, max_term_width = 110, after_help = exit::EXIT_CODES)]
struct Cli {
    /// No progress and no remarks, only results and errors.
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
    /// Say which learned features are known, and whether their network files are there.
    Models(commands::models::Args),
    /// Extract features of images for other programs.
    #[cfg(feature = "hloc")]
    Features(commands::features::Args),
    /// Extract features of images for hloc (takes the cargo feature `hloc`).
    #[cfg(not(feature = "hloc"))]
    Features(commands::absent::Args),
    /// Turn images into sealed queries, as a device does.
    Seal(commands::seal::Args),
    /// Find where sealed queries were taken.
    Localize(commands::localize::Args),
    /// Serve maps: sealed queries in over HTTP, poses out.
    Serve(commands::serve::Args),
    /// Hold regions of a published map, for a service of many machines.
    #[cfg(feature = "cluster")]
    Worker(commands::worker::Args),
    /// Hold regions of a published map (takes the cargo feature `cluster`).
    #[cfg(not(feature = "cluster"))]
    Worker(commands::absent::Args),
    /// Make, list and revoke tokens of a service.
    #[command(subcommand)]
    Token(commands::token::Command),
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
    /// Rendered places, written as data sets.
    #[command(subcommand)]
    Synth(commands::synth::Command),
}

/// The whole program, for a command line whose first word is its own name; returns its exit code.
///
/// Prints, and so stands at the end of a process: whoever wants answers as values calls the libraries.
pub fn run(command_line: impl IntoIterator<Item = OsString>) -> u8 {
    let command_line: Vec<OsString> = command_line.into_iter().collect();
    output::command_line::keep(command_line.get(1..).unwrap_or_default());
    let matches = match commands::first_look(Cli::command()).try_get_matches_from(command_line) {
        Ok(matches) => matches,
        Err(error) => return answered(&error),
    };
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => return answered(&error),
    };
    let ui = Arc::new(Ui::new(cli.quiet));
    let result = exit::catching_panics(|| match &cli.command {
        Command::Demo(args) => commands::demo::run(args, &ui),
        Command::Map(command) => commands::map::run(command, &ui),
        Command::Models(args) => commands::models::run(args, &ui),
        #[cfg(feature = "hloc")]
        Command::Features(args) => commands::features::run(args, &ui),
        #[cfg(not(feature = "hloc"))]
        Command::Features(args) => commands::absent::run(args, "features", "hloc"),
        Command::Seal(args) => commands::seal::run(args, &ui),
        Command::Localize(args) => commands::localize::run(args, &ui),
        // What holds for it is not on the command line alone.
        Command::Serve(_) => {
            commands::serve::run(matches.subcommand().map_or(&matches, |(_, serve)| serve), &ui)
        }
        #[cfg(feature = "cluster")]
        Command::Worker(_) => {
            commands::worker::run(matches.subcommand().map_or(&matches, |(_, worker)| worker), &ui)
        }
        #[cfg(not(feature = "cluster"))]
        Command::Worker(args) => commands::absent::run(args, "worker", "cluster"),
        Command::Token(command) => commands::token::run(command, &ui),
        Command::Query(command) => commands::query::run(command, &ui),
        Command::Eval(command) => commands::eval::run(command, &ui),
        Command::Attack(args) => commands::attack::run(args, &ui),
        Command::Audit(args) => commands::audit::run(args, &ui),
        Command::Synth(command) => commands::synth::run(command, &ui),
    });
    let exit = result.unwrap_or_else(|failure| told(&failure, &ui));
    // Whatever else went wrong: who asked has not got the results there were.
    ui.lost_output().map_or(exit, |failure| told(&failure, &ui)).code()
}

fn told(failure: &Failure, ui: &Ui) -> Exit {
    ui.failure(failure);
    failure.exit()
}

/// Prints what the reader of the command line answers itself: help and version to stdout, wrong usage to stderr.
fn answered(answer: &clap::Error) -> u8 {
    let printed = answer.print().and_then(|()| std::io::Write::flush(&mut std::io::stdout()));
    match (answer.use_stderr(), printed) {
        (true, _) => Exit::Usage.code(),
        (false, Err(error)) if error.kind() != std::io::ErrorKind::BrokenPipe => {
            let failure = Failure::output("stdout", &error);
            Ui::new(false).failure(&failure);
            failure.exit().code()
        }
        (false, _) => Exit::Success.code(),
    }
}

#[cfg(test)]
mod tests {
    use clap::{Arg, ArgAction, Command};

    use super::*;

    /// Calls `check` with every argument of every command.
    fn each_argument(command: &Command, path: &str, check: &mut dyn FnMut(&str, &Arg)) {
        for argument in command.get_arguments() {
            check(path, argument);
        }
        for inner in command.get_subcommands() {
            each_argument(inner, &format!("{path} {}", inner.get_name()), check);
        }
    }

    /// What a value is called in the usage, and the word that says its unit.
    const UNITS: [(&str, &str); 4] =
        [("PX", "pixel"), ("SECONDS", "seconds"), ("PERCENT", "percent"), ("T/DEG", "degrees")];
    /// Whose absence needs no words: files and folders that are only read or written when they are named.
    const ON_DEMAND: [&str; 5] = ["FILE", "DIR", "PROBLEMS", "NAME=", "TOKEN"];

    #[test]
    fn help_names_defaults_and_units() {
        let mut silent = Vec::new();
        each_argument(&Cli::command(), "veiloc", &mut |path, argument| {
            let help =
                argument.get_long_help().or(argument.get_help()).map(ToString::to_string).unwrap_or_default();
            let help = help.to_lowercase();
            let takes_value = matches!(argument.get_action(), ArgAction::Set | ArgAction::Append);
            if argument.is_positional() || !takes_value {
                return;
            }
            let value =
                argument.get_value_names().and_then(|names| names.first()).map_or("", |name| name.as_str());
            let name = format!("{path} --{}", argument.get_long().unwrap_or_default());
            if let Some((_, unit)) =
                UNITS.iter().find(|(v, unit)| value.starts_with(v) && !help.contains(unit))
            {
                silent.push(format!("{name}: {unit}"));
            }
            let told = argument.is_required_set()
                || !argument.get_default_values().is_empty()
                || ON_DEMAND.iter().any(|v| value.starts_with(v))
                || help.contains("default");
            if !told {
                silent.push(format!("{name}: default"));
            }
        });
        assert!(silent.is_empty(), "help does not say:\n{}", silent.join("\n"));
    }
}
