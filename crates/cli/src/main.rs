//! The `veiloc` binary: the command line of `veiloc_cli`, and nothing else.
#![forbid(unsafe_code)]

use std::process::ExitCode;

fn main() -> ExitCode {
    veiloc_cli::run(std::env::args_os()).into()
}
