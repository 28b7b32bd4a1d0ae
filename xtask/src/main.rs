//! Project checks. `cargo xtask tidy` checks the invariants of ARCHITECTURE.md over `cargo metadata`, and source files.
//! `cargo xtask json-reference` writes docs/reference/json.md, `cargo xtask c-header` writes bindings/c/include/veiloc.h; with
//! `--check` they compare.
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
        ["json-reference"] => generate(root, &JSON_REFERENCE, &[]),
        ["json-reference", "--check"] => generate(root, &JSON_REFERENCE, &["--check"]),
        ["c-header"] => generate(root, &C_HEADER, &[]),
        ["c-header", "--check"] => generate(root, &C_HEADER, &["--check"]),
        _ => {
            print_line("usage: cargo xtask tidy | json-reference [--check] | c-header [--check]");
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

/// A generated file, and the example that writes it from the types of its crate.
struct Generated {
    file: &'static str,
    example: &'static [&'static str],
}

const JSON_REFERENCE: Generated = Generated {
    file: "docs/reference/json.md",
    example: &["--package", "veiloc-cli", "--features", "schema", "--example", "json_reference"],
};

const C_HEADER: Generated = Generated {
    file: "bindings/c/include/veiloc.h",
    example: &["--package", "veiloc-c", "--example", "header"],
};

fn generate(root: &Path, generated: &Generated, options: &[&str]) -> Result<Vec<String>, String> {
    let status = Command::new(env!("CARGO"))
        .args(["run", "--quiet"])
        .args(generated.example)
        .arg("--")
        .args(options)
        .current_dir(root)
        .status()
        .map_err(|error| format!("cargo run: {error}"))?;
    Ok(if status.success() { Vec::new() } else { vec![format!("{}: {status}", generated.file)] })
}

#[expect(clippy::print_stderr, reason = "a command line program")]
fn print_line(line: &str) {
    eprintln!("{line}");
}
