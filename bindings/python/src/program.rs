//! The `veiloc` program; the package installs a script that calls it.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the program and returns its exit code. Ctrl-C ends the process.
///
/// Args:
///     command_line: the program's name, then its arguments.
#[pyfunction]
pub(crate) fn run_program(py: Python<'_>, command_line: Vec<OsString>) -> u8 {
    py.detach(|| veiloc_cli::run(command_line))
}
