//! What every source file owes the reader, and what none may hold.

use std::path::Path;
use std::process::Command;

use crate::rooms::MOST_LINES_OF_A_FILE;

/// The room that may hold `unsafe` code.
const UNSAFE_ROOM: &str = "crates/kernels/";
/// Where exports keep their names, which the edition calls `#[unsafe(no_mangle)]` (decision 0027): no lint can forbid that.
const EXPORTS: &str = "bindings/web/";

/// Beginnings of paths that exist on one person's machine only.
const PERSONAL_PATHS: &[&str] = &["/home/", "/root/", "/Users/"];

/// Checks all files git knows; returns how many were read.
pub(crate) fn check(root: &Path, faults: &mut Vec<String>) -> Result<usize, String> {
    let listed = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root)
        .output()
        .map_err(|e| format!("git ls-files: {e}"))?;
    if !listed.status.success() {
        return Err(format!("git ls-files: {}", String::from_utf8_lossy(&listed.stderr)));
    }
    let architecture =
        std::fs::read_to_string(root.join("ARCHITECTURE.md")).map_err(|e| format!("ARCHITECTURE.md: {e}"))?;
    let mut files = 0;
    for name in String::from_utf8_lossy(&listed.stdout).split('\0').filter(|n| !n.is_empty()) {
        // A file of bytes is nobody's prose; one that was just deleted is not there to read.
        let Ok(text) = std::fs::read_to_string(root.join(name)) else { continue };
        files += 1;
        check_file(name, &text, faults);
        let room = name.strip_prefix("crates/").and_then(|n| n.strip_suffix("/Cargo.toml"));
        if let Some(room) = room.filter(|room| !architecture.contains(&format!("`{room}`"))) {
            faults.push(format!("{name}: ARCHITECTURE.md does not say what `{room}` is for"));
        }
    }
    Ok(files)
}

fn check_file(name: &str, text: &str, faults: &mut Vec<String>) {
    let is_rust = Path::new(name).extension().is_some_and(|e| e == "rs");
    if is_rust {
        if !text.starts_with("//!") {
            faults.push(format!("{name}: does not open with `//!` saying what it is for"));
        }
        let is_ours = name.starts_with("crates/") || name.starts_with("bindings/");
        let is_root = is_ours && name.ends_with("/src/lib.rs");
        let is_exporting = name.starts_with(EXPORTS);
        let lint = if is_exporting { "#![deny(unsafe_code)]" } else { "#![forbid(unsafe_code)]" };
        if is_root && !name.starts_with(UNSAFE_ROOM) && !text.contains(lint) {
            faults.push(format!("{name}: lacks {lint}"));
        }
        if is_exporting
            && ["unsafe {", "unsafe fn", "unsafe impl", "unsafe extern"].iter().any(|u| text.contains(u))
        {
            faults.push(format!("{name}: has unsafe code; only the names of exports may take the word here"));
        }
        // Bindings are no rooms, which are bounded elsewhere.
        let lines = text.lines().count();
        if name.starts_with("bindings/") && lines > MOST_LINES_OF_A_FILE {
            faults.push(format!("{name}: {lines} lines, at most {MOST_LINES_OF_A_FILE}"));
        }
    }
    if name.starts_with("xtask/") || name == "Cargo.lock" {
        return;
    }
    for (number, line) in text.lines().enumerate() {
        if let Some(path) = PERSONAL_PATHS.iter().find(|p| starts_a_path(line, p)) {
            faults.push(format!("{name}:{}: names a place of one machine ({path}…)", number + 1));
        }
    }
}

/// Whether `prefix` begins an absolute path in the line: `a/home/x` and `https://host/home/` do not count.
fn starts_a_path(line: &str, prefix: &str) -> bool {
    line.match_indices(prefix).any(|(at, _)| {
        let before = line[..at].chars().next_back();
        before.is_none_or(|c| !(c.is_alphanumeric() || "./_-})".contains(c)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_found() {
        let mut faults = Vec::new();
        check_file("crates/map/src/lib.rs", "fn main() {}", &mut faults);
        assert_eq!(faults.len(), 2, "{faults:?}");
        faults.clear();
        check_file("bindings/python/src/lib.rs", "//! A module.", &mut faults);
        assert_eq!(faults.len(), 1, "{faults:?}");
        faults.clear();
        check_file("docs/x.md", "see /home/me/data", &mut faults);
        assert_eq!(faults.len(), 1, "{faults:?}");
    }

    #[test]
    fn exports_keep_their_names_and_nothing_else() {
        let mut faults = Vec::new();
        check_file("bindings/web/src/lib.rs", "//! Calls.\n#![deny(unsafe_code)]\n", &mut faults);
        check_file(
            "bindings/web/src/exports.rs",
            "//! Calls.\n#[unsafe(no_mangle)]\nfn f() {}\n",
            &mut faults,
        );
        assert!(faults.is_empty(), "{faults:?}");
        check_file("bindings/web/src/lib.rs", "//! Calls.\n", &mut faults);
        check_file("bindings/web/src/exports.rs", "//! Calls.\nfn f() { unsafe { g() } }\n", &mut faults);
        check_file("bindings/python/src/lib.rs", "//! Calls.\n#![deny(unsafe_code)]\n", &mut faults);
        assert_eq!(faults.len(), 3, "{faults:?}");
    }

    #[test]
    fn ordinary_files_pass() {
        let mut faults = Vec::new();
        check_file("crates/map/src/lib.rs", "//! Maps.\n#![forbid(unsafe_code)]\n", &mut faults);
        check_file("docs/x.md", "a service answers at host/home/ and ../shared/data", &mut faults);
        assert!(faults.is_empty(), "{faults:?}");
    }
}
