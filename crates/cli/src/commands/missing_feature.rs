//! Commands and flags that need a cargo feature which this build lacks: they name the feature instead of being unknown.

use std::ffi::OsString;

use crate::output::exit::{Failure, Outcome};

/// Accepts any arguments; the command is refused.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    words: Vec<OsString>,
}

/// Refuses a command.
pub(crate) fn run(_: &Args, command: &str, feature: &str) -> Outcome {
    Err(error(&format!("veiloc {command}"), feature))
}

/// Returns the error for a command or flag that needs a cargo feature.
pub(crate) fn error(what: &str, feature: &str) -> Failure {
    Failure::with_help(
        format!("{what}: this program was built without the cargo feature `{feature}`"),
        format!(
            "build it with `cargo build --release --features {feature}`, or with `--features full`, which has everything"
        ),
    )
}
