//! Internal: the `veiloc` program as a library: parses a command line, calls the libraries, and prints the results.
//!
//! [`run`] is the whole program; the binary and the Python package call it. Results go to stdout (`--json`, tables);
//! messages and progress go to stderr. Exit codes: 0 success, 1 the input was refused or nothing was localized, 2 wrong
//! usage, 3 results could not be written or an internal error.
#![forbid(unsafe_code)]

#[cfg(feature = "schema")]
pub use json_reference::json_reference;

pub mod args;
mod commands;
mod demo;
#[cfg(feature = "schema")]
mod json_reference;
mod output;

use std::ffi::OsString;
use std::sync::Arc;

use crate::output::exit::{Exit, Failure};
use crate::output::ui::Ui;
use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};

/// Visual localization in which neither the image nor the keypoint positions leave the device.
#[derive(Parser)]
#[command(name = "veiloc", version, max_term_width = 110, after_help = crate::output::exit::EXIT_CODES)]
struct Cli {
    /// Print no progress and no messages, only results and errors.
    #[arg(long, short, global = true)]
    quiet: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Render a scene, map it, localize hidden queries, attack them, write a report.
    Demo(commands::demo::Args),
    /// Build, import, inspect and change maps.
    #[command(subcommand)]
    Map(commands::map::Command),
    /// List the known models of learned features, and whether their network files exist.
    Models(commands::models::Args),
    /// Extract features of images for other programs.
    #[cfg(feature = "hloc")]
    Features(commands::features::Args),
    /// Extract features of images for hloc (needs the cargo feature `hloc`).
    #[cfg(not(feature = "hloc"))]
    Features(commands::missing_feature::Args),
    /// Seal images: convert them to queries that hide the keypoint positions.
    Seal(commands::seal::Args),
    /// Estimate the poses of sealed queries.
    Localize(commands::localize::Args),
    /// Serve maps over HTTP: sealed queries in, poses out.
    Serve(commands::serve::Args),
    /// Create, list and revoke tokens of a service.
    #[command(subcommand)]
    Token(commands::token::Command),
    /// Localize an image with a service, without sending the image.
    #[command(subcommand)]
    Query(commands::query::Command),
    /// Measure localization on data with known poses.
    #[command(subcommand)]
    Eval(commands::eval::Command),
    /// Recover keypoints from obfuscated queries, with every attack under every scheme.
    Attack(commands::attack::Args),
    /// Attack the queries of your own images and write a report.
    Audit(commands::audit::Args),
    /// Render scenes and write them as data sets.
    #[command(subcommand)]
    Synth(commands::synth::Command),
}

/// Runs the whole program for a command line that begins with the program's name; returns its exit code.
///
/// It prints its results; a program that needs them as values calls the libraries.
pub fn run(command_line: impl IntoIterator<Item = OsString>) -> u8 {
    let command_line: Vec<OsString> = command_line.into_iter().collect();
    output::command_line::record(command_line.get(1..).unwrap_or_default());
    let matches = match commands::prepare_layered(Cli::command()).try_get_matches_from(command_line) {
        Ok(matches) => matches,
        Err(error) => return print_parser_output(&error),
    };
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => return print_parser_output(&error),
    };
    let ui = Arc::new(Ui::new(cli.quiet));
    let result = output::exit::catch_panics(|| {
        output::targets::check(&matches)?;
        match &cli.command {
            Command::Demo(args) => commands::demo::run(args, &ui),
            Command::Map(command) => commands::map::run(command, &ui),
            Command::Models(args) => commands::models::run(args, &ui),
            #[cfg(feature = "hloc")]
            Command::Features(args) => commands::features::run(args, &ui),
            #[cfg(not(feature = "hloc"))]
            Command::Features(args) => commands::missing_feature::run(args, "features", "hloc"),
            Command::Seal(args) => commands::seal::run(args, &ui),
            Command::Localize(args) => commands::localize::run(args, &ui),
            // Its settings also come from a file and from variables.
            Command::Serve(_) => {
                commands::serve::run(matches.subcommand().map_or(&matches, |(_, serve)| serve), &ui)
            }
            Command::Token(command) => commands::token::run(command, &ui),
            Command::Query(command) => commands::query::run(command, &ui),
            Command::Eval(command) => commands::eval::run(command, &ui),
            Command::Attack(args) => commands::attack::run(args, &ui),
            Command::Audit(args) => commands::audit::run(args, &ui),
            Command::Synth(command) => commands::synth::run(command, &ui),
        }
    });
    let exit = result.unwrap_or_else(|failure| report_failure(&failure, &ui));
    // After any other error: results were lost.
    ui.lost_output().map_or(exit, |failure| report_failure(&failure, &ui)).code()
}

fn report_failure(failure: &Failure, ui: &Ui) -> Exit {
    ui.failure(failure);
    failure.exit()
}

/// Prints the parser's own output: help and version to stdout, wrong usage to stderr.
fn print_parser_output(answer: &clap::Error) -> u8 {
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

    /// Value names in the usage, and the word in the help that states their unit.
    const UNITS: [(&str, &str); 4] =
        [("PX", "pixel"), ("SECONDS", "seconds"), ("PERCENT", "percent"), ("T/DEG", "degrees")];
    /// Value names whose absence needs no description: files and folders that are only used if given.
    const ON_DEMAND: [&str; 7] = ["FILE", "DIR", "PATH", "MAP", "PROBLEMS", "NAME=", "TOKEN"];

    /// An argument whose help says that a file or folder is written has a type that is checked before the command.
    #[test]
    fn outputs_have_checked_types() {
        use std::any::TypeId;

        use crate::output::targets::{OutFile, OutFileOrFolder, OutFileOrStdout, OutFolder};

        let checked = [
            TypeId::of::<OutFile>(),
            TypeId::of::<OutFileOrStdout>(),
            TypeId::of::<OutFolder>(),
            TypeId::of::<OutFileOrFolder>(),
        ];
        let (mut found, mut unchecked) = (0, Vec::new());
        each_argument(&Cli::command(), "veiloc", &mut |path, argument| {
            let value = argument.get_value_names().and_then(|names| names.first()).map_or("", |n| n.as_str());
            let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
            let takes_path = value.starts_with("FILE") || value == "DIR";
            let writes = ["Write", "Output", "Plot", "Destination of the report"];
            let writes = writes.iter().any(|word| help.starts_with(word)) || help.contains(" to write");
            if takes_path && (writes || argument.get_id() == "out") {
                found += 1;
                if checked.iter().all(|kind| argument.get_value_parser().type_id() != *kind) {
                    unchecked.push(format!("{path} {}", argument.get_id()));
                }
            }
        });
        assert!(found > 30 && unchecked.is_empty(), "{found} outputs; unchecked: {unchecked:?}");
    }

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
            let has_default_help = argument.is_required_set()
                || !argument.get_default_values().is_empty()
                || ON_DEMAND.iter().any(|v| value.starts_with(v))
                || help.contains("default");
            if !has_default_help {
                silent.push(format!("{name}: default"));
            }
        });
        assert!(silent.is_empty(), "help lacks:\n{}", silent.join("\n"));
    }
}
