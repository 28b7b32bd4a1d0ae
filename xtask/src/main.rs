//! Project chores: `cargo xtask tidy` checks the structure that the compiler does not.
//!
//! What is checked is what a reviewer cannot see by looking at one file: the arrows between the rooms, where
//! `unsafe` may live, that every file says what it is for, and that nothing of one person's machine was committed.

mod arrows;
mod sources;

use std::path::Path;
use std::process::ExitCode;

fn main() -> ExitCode {
    let task = std::env::args().nth(1);
    if task.as_deref() == Some("tidy") {
        return tidy();
    }
    say("usage: cargo xtask tidy");
    ExitCode::from(2)
}

fn tidy() -> ExitCode {
    let Some(root) = Path::new(env!("CARGO_MANIFEST_DIR")).parent() else {
        say("the workspace root was not found above xtask");
        return ExitCode::from(3);
    };
    let mut faults = Vec::new();
    let checked =
        arrows::check(root, &mut faults).and_then(|rooms| Ok((rooms, sources::check(root, &mut faults)?)));
    match checked {
        Err(error) => {
            say(&format!("tidy could not run: {error}"));
            ExitCode::from(3)
        }
        Ok((rooms, files)) if faults.is_empty() => {
            say(&format!("tidy: {rooms} rooms and {files} files in order"));
            ExitCode::SUCCESS
        }
        Ok(_) => {
            for fault in &faults {
                say(fault);
            }
            say(&format!("tidy: {} faults", faults.len()));
            ExitCode::FAILURE
        }
    }
}

#[expect(clippy::print_stderr, reason = "a chore talks to the person who called it")]
fn say(line: &str) {
    eprintln!("{line}");
}
