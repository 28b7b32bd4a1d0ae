//! Commands and flags of cargo features that this program was built without: they say which, instead of not being there.

use std::ffi::OsString;

use crate::exit::{Failure, Outcome};

/// Anything: it is refused.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    words: Vec<OsString>,
}

/// Refuses a command.
pub(crate) fn run(_: &Args, command: &str, feature: &str) -> Outcome {
    Err(without(&format!("veiloc {command}"), feature))
}

/// What was asked for takes a cargo feature.
pub(crate) fn without(what: &str, feature: &str) -> Failure {
    Failure::with_help(
        format!("{what}: this program was built without the cargo feature `{feature}`"),
        format!(
            "build it with `cargo build --release --features {feature}`, or with `--features full`, which has everything"
        ),
    )
}
