//! Project chores. `cargo xtask tidy` checks what the compiler does not: the invariants of ARCHITECTURE.md over
//! `cargo metadata`, and the heads of files.
//!
//! Licences, sources and banned crates are cargo-deny's (`deny.toml`).

mod files;
mod layers;

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let Some(root) = Path::new(env!("CARGO_MANIFEST_DIR")).parent() else {
        say("the workspace root was not found above xtask");
        return ExitCode::from(3);
    };
    if std::env::args().nth(1).as_deref() != Some("tidy") {
        say("usage: cargo xtask tidy");
        return ExitCode::from(2);
    }
    match tidy(root) {
        Ok(faults) if faults.is_empty() => ExitCode::SUCCESS,
        Ok(faults) => {
            for fault in &faults {
                say(fault);
            }
            say(&format!("{} faults", faults.len()));
            ExitCode::FAILURE
        }
        Err(error) => {
            say(&format!("could not run: {error}"));
            ExitCode::from(3)
        }
    }
}

/// All checks; returns what is wrong.
fn tidy(root: &Path) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    let crates = layers::check(root, &mut faults)?;
    let files = files::check(root, &mut faults)?;
    if faults.is_empty() {
        say(&format!("tidy: {crates} crates and {files} files in order"));
    }
    Ok(faults)
}

#[expect(clippy::print_stderr, reason = "a chore talks to the person who called it")]
fn say(line: &str) {
    eprintln!("{line}");
}
