//! Project chores: `cargo xtask tidy` checks the structure that the compiler does not, `cargo xtask rooms` prints it.
//!
//! What is checked is what a reviewer cannot see by looking at one file: the arrows between the rooms and between the
//! files of a room, their sizes, where `unsafe` may live, that every file says what it is for, that nothing of one
//! person's machine was committed, that every crate can be published, and what the dependencies of others bring in.

mod arrows;
mod dependencies;
mod file_arrows;
mod licence;
mod manifests;
mod rooms;
mod rust_text;
mod sources;
mod workspace;

use std::path::Path;
use std::process::ExitCode;

use workspace::Workspace;

fn main() -> ExitCode {
    let Some(root) = Path::new(env!("CARGO_MANIFEST_DIR")).parent() else {
        say("the workspace root was not found above xtask");
        return ExitCode::from(3);
    };
    let done = match std::env::args().nth(1).as_deref() {
        Some("tidy") => tidy(root),
        Some("rooms") => show_rooms(root),
        _ => {
            say("usage: cargo xtask tidy | rooms");
            return ExitCode::from(2);
        }
    };
    match done {
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
    let workspace = Workspace::ask(root)?;
    let rooms = arrows::check(&workspace, &mut faults);
    rooms::check(&rooms::read(&workspace)?, &mut faults);
    manifests::check(&workspace, &mut faults);
    let others = dependencies::check(&workspace, &mut faults)?;
    let files = sources::check(root, &mut faults)?;
    if faults.is_empty() {
        say(&format!("tidy: {rooms} rooms, {files} files and {others} dependencies in order"));
    }
    Ok(faults)
}

/// Prints sizes, arrows and circles; returns what is wrong with them.
fn show_rooms(root: &Path) -> Result<Vec<String>, String> {
    let mut faults = Vec::new();
    let workspace = Workspace::ask(root)?;
    let rooms = rooms::read(&workspace)?;
    print(&rooms::table(&rooms));
    arrows::check(&workspace, &mut faults);
    rooms::check(&rooms, &mut faults);
    Ok(faults)
}

#[expect(clippy::print_stdout, reason = "the table that was asked for")]
fn print(text: &str) {
    print!("{text}");
}

#[expect(clippy::print_stderr, reason = "a chore talks to the person who called it")]
fn say(line: &str) {
    eprintln!("{line}");
}
