//! Project checks. `cargo xtask tidy` checks the invariants of ARCHITECTURE.md over `cargo metadata`, and source files.
//! `cargo xtask json-reference` writes docs/reference/json.md, or compares it with `--check`.
//!
//! cargo-deny checks licences, sources and banned crates (`deny.toml`).

mod files;
mod layers;

use std::path::Path;
use std::process::{Command, ExitCode};

fn main() -> ExitCode {
    let Some(root) = Path::new(env!("CARGO_MANIFEST_DIR")).parent() else {
        print_line("the workspace root was not found above xtask");
        return ExitCode::from(3);
    };
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match arguments[..] {
        ["tidy"] => tidy(root),
        ["json-reference"] => json_reference(root, &[]),
        ["json-reference", "--check"] => json_reference(root, &["--check"]),
        _ => {
            print_line("usage: cargo xtask tidy | json-reference [--check]");
            return ExitCode::from(2);
        }
    };
    match result {
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

/// Runs the generator, an example of the command line, whose types it reads.
fn json_reference(root: &Path, options: &[&str]) -> Result<Vec<String>, String> {
    let status = Command::new(env!("CARGO"))
        .args([
            "run",
            "--quiet",
            "--package",
            "veiloc-cli",
            "--features",
            "schema",
            "--example",
            "json_reference",
            "--",
        ])
        .args(options)
        .current_dir(root)
        .status()
        .map_err(|error| format!("cargo run: {error}"))?;
    Ok(if status.success() {
        Vec::new()
    } else {
        vec![format!("the generator of docs/reference/json.md: {status}")]
    })
}

#[expect(clippy::print_stderr, reason = "a command line program")]
fn print_line(line: &str) {
    eprintln!("{line}");
}
