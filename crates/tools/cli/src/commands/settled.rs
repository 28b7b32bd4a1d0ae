//! A command whose options may also stand in a file and in the environment.

use crate::args::settings::Settings;
use clap::{ArgMatches, Args, Command, FromArgMatches};

use crate::exit::{Exit, Failure, Outcome};
use crate::ui::Ui;

/// The command with all that must be given, and what excludes what: for all layers together.
pub(crate) fn complete<A: Args>(name: &'static str) -> Command {
    A::augment_args(Command::new(name).bin_name(format!("veiloc {name}")))
}

/// Runs a command with what command line (`first`, as the layered command read it), environment and file say together; with
/// `--print-config` says what that is.
pub(crate) fn settled<A: Args + FromArgMatches>(
    name: &'static str,
    first: &ArgMatches,
    ui: &Ui,
    run: impl FnOnce(&A, &Ui) -> Outcome,
) -> Outcome {
    let command = complete::<A>(name);
    let settings = Settings::of(&command, first, &|name| std::env::var_os(name)).map_err(Failure::refused)?;
    let line = std::iter::once(format!("veiloc {name}").into()).chain(settings.arguments());
    let args = match command.try_get_matches_from(line).and_then(|all| A::from_arg_matches(&all)) {
        Ok(args) => args,
        Err(error) => {
            // As if all had been said on the command line. Nothing can be told of a stderr that is gone.
            let _ = error.print();
            return Ok(Exit::Usage);
        }
    };
    if first.get_flag("print_config") {
        ui.print(settings.to_toml().map_err(Failure::refused)?);
        return Ok(Exit::Success);
    }
    run(&args, ui)
}
