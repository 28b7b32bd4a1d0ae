//! Checks of source files: module docs, the lint against `unsafe`, and no paths of a single machine.

use std::path::Path;
use std::process::Command;

/// The crates that may hold `unsafe` code: kernels, and the border to C, whose functions take pointers.
const UNSAFE_CRATES: [&str; 2] = ["crates/core/simd/", C_BORDER];
/// The border to C. Its crate root denies unsafe operations outside of `unsafe` blocks.
const C_BORDER: &str = "bindings/c/";
/// The crate with exported functions. The edition spells their attribute `#[unsafe(no_mangle)]` (decision 0027), so the
/// lint `unsafe_code` cannot be forbidden there.
const EXPORTS: &str = "bindings/web/";

/// Prefixes of paths that exist only on one machine.
const PERSONAL_PATHS: &[&str] = &["/home/", "/root/", "/Users/"];

/// Checks all files known to git; returns how many were read.
pub(crate) fn check(root: &Path, faults: &mut Vec<String>) -> Result<usize, String> {
    let listed = Command::new("git")
        .args(["ls-files", "-z", "--cached", "--others", "--exclude-standard"])
        .current_dir(root)
        .output()
        .map_err(|e| format!("git ls-files: {e}"))?;
    if !listed.status.success() {
        return Err(format!("git ls-files: {}", String::from_utf8_lossy(&listed.stderr)));
    }
    let mut files = 0;
    for name in String::from_utf8_lossy(&listed.stdout).split('\0').filter(|n| !n.is_empty()) {
        // Binary files and deleted files are skipped.
        let Ok(text) = std::fs::read_to_string(root.join(name)) else { continue };
        files += 1;
        check_file(name, &text, faults);
    }
    Ok(files)
}

fn check_file(name: &str, text: &str, faults: &mut Vec<String>) {
    if Path::new(name).extension().is_some_and(|e| e == "rs") {
        if !text.starts_with("//!") {
            faults.push(format!("{name}: must open with a `//!` comment that says what the file is for"));
        }
        let is_ours = name.starts_with("crates/") || name.starts_with("bindings/");
        let is_root = is_ours && name.ends_with("/src/lib.rs");
        let is_exporting = name.starts_with(EXPORTS);
        let lint = if is_exporting { "#![deny(unsafe_code)]" } else { "#![forbid(unsafe_code)]" };
        let may_be_unsafe = UNSAFE_CRATES.iter().any(|folder| name.starts_with(folder));
        let lint = if may_be_unsafe { "#![deny(unsafe_op_in_unsafe_fn)]" } else { lint };
        if is_root && !text.contains(lint) {
            faults.push(format!("{name}: lacks {lint}"));
        }
        // A pointer is read in a block, once, where it becomes a reference.
        if name.starts_with(C_BORDER) && ["unsafe impl", "transmute"].iter().any(|u| text.contains(u)) {
            faults.push(format!("{name}: only pointers may be unsafe at the border to C"));
        }
        let has_unsafe =
            || ["unsafe {", "unsafe fn", "unsafe impl", "unsafe extern"].iter().any(|u| text.contains(u));
        if is_exporting && has_unsafe() {
            faults.push(format!("{name}: has unsafe code; only the attribute of exports may be unsafe here"));
        }
    }
    if name.starts_with("xtask/") || name == "Cargo.lock" {
        return;
    }
    for (number, line) in text.lines().enumerate() {
        if let Some(path) = PERSONAL_PATHS.iter().find(|p| starts_a_path(line, p)) {
            faults.push(format!("{name}:{}: names a path of one machine ({path}…)", number + 1));
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

    fn faults(files: &[(&str, &str)]) -> Vec<String> {
        let mut faults = Vec::new();
        for (name, text) in files {
            check_file(name, text, &mut faults);
        }
        faults
    }

    #[test]
    fn faults_are_found() {
        assert_eq!(faults(&[("crates/server/map/src/lib.rs", "fn main() {}")]).len(), 2);
        assert_eq!(faults(&[("bindings/python/src/lib.rs", "//! A module.")]).len(), 1);
        assert_eq!(faults(&[("docs/x.md", "see /home/me/data")]).len(), 1);
        let exports = [
            ("bindings/web/src/lib.rs", "//! Calls.\n"),
            ("bindings/web/src/exports.rs", "//! Calls.\nfn f() { unsafe { g() } }\n"),
        ];
        assert_eq!(faults(&exports).len(), 2);
        let border = [
            ("bindings/c/src/lib.rs", "//! Calls.\n"),
            ("bindings/c/src/session.rs", "//! Calls.\nunsafe impl Send for S {}\n"),
        ];
        assert_eq!(faults(&border).len(), 2);
    }

    #[test]
    fn ordinary_files_pass() {
        let files = [
            ("crates/server/map/src/lib.rs", "//! Maps.\n#![forbid(unsafe_code)]\n"),
            ("docs/x.md", "a service answers at host/home/ and ../shared/data"),
            ("bindings/web/src/lib.rs", "//! Calls.\n#![deny(unsafe_code)]\n"),
            ("bindings/web/src/exports.rs", "//! Calls.\n#[unsafe(no_mangle)]\nfn f() {}\n"),
            ("bindings/c/src/lib.rs", "//! Calls.\n#![deny(unsafe_op_in_unsafe_fn)]\n"),
            ("bindings/c/src/session.rs", "//! Calls.\nfn f(p: *const u8) { unsafe { g(p) } }\n"),
        ];
        assert_eq!(faults(&files), Vec::<String>::new());
    }
}
