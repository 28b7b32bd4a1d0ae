//! The user's own folders, by the XDG Base Directory Specification.

use std::path::{Path, PathBuf};

/// `$VARIABLE/veiloc`, or `veiloc` in a folder of the home folder. Only absolute paths count, as the specification requires.
fn user_folder(variable: &str, in_home: &str) -> Option<PathBuf> {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let folder = absolute(variable).or_else(|| Some(absolute("HOME")?.join(in_home)))?;
    Some(folder.join(Path::new("veiloc")))
}

/// For what can be read again: `$XDG_CACHE_HOME/veiloc`, or `~/.cache/veiloc`. Other users cannot write to it.
pub(crate) fn user_cache() -> Option<PathBuf> {
    user_folder("XDG_CACHE_HOME", ".cache")
}

/// For what the user put there: `$XDG_DATA_HOME/veiloc`, or `~/.local/share/veiloc`.
pub(crate) fn user_data() -> Option<PathBuf> {
    user_folder("XDG_DATA_HOME", ".local/share")
}
