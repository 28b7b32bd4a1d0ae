//! Runs a command whose options may also come from a file and from the environment.

use crate::args::settings::Settings;
use clap::{ArgMatches, Args, Command, FromArgMatches};

use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::ui::Ui;

/// Returns the command with all its required arguments and conflicts, which apply to all layers together.
pub(crate) fn full_command<A: Args>(name: &'static str) -> Command {
    A::augment_args(Command::new(name).bin_name(format!("veiloc {name}")))
}

/// Runs a command with the merged settings of command line (`first`, as parsed by the layered command), environment and
/// file; `--print-config` prints them instead.
pub(crate) fn run_with_config<A: Args + FromArgMatches>(
    name: &'static str,
    first: &ArgMatches,
    ui: &Ui,
    run: impl FnOnce(&A, &Ui) -> Outcome,
) -> Outcome {
    let command = full_command::<A>(name);
    let settings = Settings::of(&command, first, &|name| std::env::var_os(name)).map_err(Failure::refused)?;
    let line = std::iter::once(format!("veiloc {name}").into()).chain(settings.arguments());
    let args = match command.try_get_matches_from(line).and_then(|all| A::from_arg_matches(&all)) {
        Ok(args) => args,
        Err(error) => {
            // The same message as for an error of the command line. If stderr is closed, it is lost.
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
