//! Project checks. `cargo xtask tidy` checks the invariants of ARCHITECTURE.md over `cargo metadata`, and source files.
//!
//! cargo-deny checks licences, sources and banned crates (`deny.toml`).

mod files;
mod layers;

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let Some(root) = Path::new(env!("CARGO_MANIFEST_DIR")).parent() else {
        print_line("the workspace root was not found above xtask");
        return ExitCode::from(3);
    };
    if std::env::args().nth(1).as_deref() != Some("tidy") {
        print_line("usage: cargo xtask tidy");
        return ExitCode::from(2);
    }
    match tidy(root) {
        Ok(faults) if faults.is_empty() => ExitCode::SUCCESS,
        Ok(faults) => {
            for fault in &faults {
                print_line(fault);
            }
            print_line(&format!("{} faults", faults.len()));
            ExitCode::FAILURE
        }
        Err(error) => {
            print_line(&format!("could not run: {error}"));
            ExitCode::from(3)
        }
    }
}

/// Runs all checks; returns the faults.
fn tidy(root: &Path) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    let crates = layers::check(root, &mut faults)?;
    let files = files::check(root, &mut faults)?;
    if faults.is_empty() {
        print_line(&format!("tidy: {crates} crates and {files} files are fine"));
    }
    Ok(faults)
}

#[expect(clippy::print_stderr, reason = "a command line program")]
fn print_line(line: &str) {
    eprintln!("{line}");
}
