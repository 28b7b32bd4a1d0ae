//! The `veiloc` program, called by the script that the package installs.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the program with a command line whose first word is its own name; returns its exit code. It prints, and Ctrl-C ends
/// the process.
#[pyfunction]
pub(crate) fn run_program(py: Python<'_>, command_line: Vec<OsString>) -> u8 {
    py.detach(|| veiloc_cli::run(command_line))
}
