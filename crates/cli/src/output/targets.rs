//! Output files and folders on the command line: all of them are checked before a command begins.
//!
//! An argument that names an output has one of the types of this module. [`check`] finds these arguments in every
//! command, so a new command needs no call of its own.

use std::fs;
use std::io::ErrorKind;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use clap::ArgMatches;
use clap::builder::{MapValueParser, PathBufValueParser, TypedValueParser as _, ValueParserFactory};
use veiloc_map::atomic_file::followed;

use crate::output::exit::Failure;
use crate::output::files;

/// Defines a path of the command line with the check of its kind.
macro_rules! output {
    ($(#[$doc:meta])* $name:ident, $check:expr) => {
        $(#[$doc])*
        #[derive(Debug, Clone)]
        pub(crate) struct $name(PathBuf);

        impl Deref for $name {
            type Target = Path;

            fn deref(&self) -> &Path {
                &self.0
            }
        }

        impl AsRef<Path> for $name {
            fn as_ref(&self) -> &Path {
                &self.0
            }
        }

        impl ValueParserFactory for $name {
            type Parser = MapValueParser<PathBufValueParser, fn(PathBuf) -> Self>;

            fn value_parser() -> Self::Parser {
                PathBufValueParser::new().map(Self as fn(PathBuf) -> Self)
            }
        }

        impl $name {
            fn check(&self) -> Result<(), Failure> {
                let check: fn(&Path) -> Result<(), Failure> = $check;
                check(&self.0)
            }
        }
    };
}

output!(
    /// A file that is written; its folder must exist.
    OutFile,
    |path| {
        files::refuse_standard(path)?;
        check_file(path)
    }
);
output!(
    /// A file that is written, or `-` for stdout.
    OutFileOrStdout,
    check_file_or_stdout
);
output!(
    /// A folder that is written, and created if it does not exist.
    OutFolder,
    |path| {
        files::refuse_standard(path)?;
        check_folder(path)
    }
);
output!(
    /// A file, or a folder that is created if it does not exist, or `-` for stdout; the command decides which.
    OutFileOrFolder,
    |path| if files::is_standard(path) || (path.exists() && !path.is_dir()) { check_file_or_stdout(path) } else { check_folder(path) }
);

/// Checks every output of the command line that can be checked: that its folder exists and is writable, and that it is
/// of the right kind.
///
/// # Errors
/// The first output that cannot be written; the error names it and the remedy.
pub(crate) fn check(matches: &ArgMatches) -> Result<(), Failure> {
    for id in matches.ids() {
        let id = id.as_str();
        each(matches, id, OutFile::check)?;
        each(matches, id, OutFileOrStdout::check)?;
        each(matches, id, OutFolder::check)?;
        each(matches, id, OutFileOrFolder::check)?;
    }
    matches.subcommand().map_or(Ok(()), |(_, inner)| check(inner))
}

/// Applies `check` to the values of an argument, if they are of this type.
fn each<T: Clone + Send + Sync + 'static>(
    matches: &ArgMatches,
    id: &str,
    check: fn(&T) -> Result<(), Failure>,
) -> Result<(), Failure> {
    matches.try_get_many::<T>(id).ok().flatten().into_iter().flatten().try_for_each(check)
}

fn check_file_or_stdout(path: &Path) -> Result<(), Failure> {
    if files::is_standard(path) { Ok(()) } else { check_file(path) }
}

fn check_file(path: &Path) -> Result<(), Failure> {
    let ends_in_slash = path.as_os_str().to_string_lossy().ends_with(['/', std::path::MAIN_SEPARATOR]);
    if path.is_dir() || ends_in_slash {
        return Err(Failure::with_help(
            format!("{}: this is a folder, and a file is expected", path.display()),
            "give the name of a file",
        ));
    }
    // A device or a pipe is written directly.
    if fs::metadata(path).is_ok_and(|m| !m.is_file()) {
        return Ok(());
    }
    let file = followed(path).map_err(|e| Failure::output(path.display(), &e))?;
    let folder = match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        let what = if folder.exists() { "is not a folder" } else { "does not exist" };
        return Err(Failure::with_help(
            format!("{}: its folder {} {what}", path.display(), folder.display()),
            "create the folder, or choose another file",
        ));
    }
    check_writable(path, folder)
}

fn check_folder(path: &Path) -> Result<(), Failure> {
    // The folders that do not exist yet are created in the first one that does.
    let existing = path.ancestors().find(|folder| folder.symlink_metadata().is_ok());
    let existing = existing.unwrap_or(Path::new("."));
    if !existing.is_dir() {
        let what = format!("{}: {} is not a folder", path.display(), existing.display());
        return Err(Failure::with_help(what, "choose a writable folder"));
    }
    check_writable(path, existing)
}

/// Creates and removes a file in the folder: permissions alone do not tell whether the file system is writable.
fn check_writable(path: &Path, folder: &Path) -> Result<(), Failure> {
    match tempfile::tempfile_in(folder) {
        Ok(_) => Ok(()),
        // Some file systems lack what a temporary file needs.
        Err(e) if matches!(e.kind(), ErrorKind::Unsupported | ErrorKind::InvalidInput) => Ok(()),
        Err(e) => {
            Err(Failure::output(format_args!("{}: its folder {}", path.display(), folder.display()), &e))
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::{Args as _, FromArgMatches as _};

    use super::*;

    #[derive(clap::Args)]
    struct Args {
        #[arg(long)]
        file: Option<OutFile>,
        #[arg(long, num_args = 0..=1, default_missing_value = "-")]
        json: Option<OutFileOrStdout>,
        #[arg(long)]
        folder: Vec<OutFolder>,
        #[arg(long)]
        either: Option<OutFileOrFolder>,
    }

    fn refusal(line: &[&str]) -> Option<String> {
        let command = Args::augment_args(clap::Command::new("inner"));
        let command = clap::Command::new("outer").subcommand(command);
        let matches = command.try_get_matches_from([&["outer", "inner"], line].concat()).expect("parsed");
        let read = Args::from_arg_matches(matches.subcommand().expect("inner").1).expect("read");
        let count = usize::from(read.file.is_some()) + usize::from(read.json.is_some());
        assert!(count + read.folder.len() + usize::from(read.either.is_some()) > 0);
        let Failure::Refused { report } = check(&matches).err()? else { panic!("another failure") };
        Some(report.to_string())
    }

    #[test]
    fn outputs_of_every_kind_are_checked() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let path = |name: &str| dir.path().join(name).display().to_string();
        fs::write(path("there"), "x").expect("written");
        for good in [
            ["--file", &path("a")],
            ["--file", &path("there")],
            ["--json", "-"],
            ["--folder", &path("a/b/c")],
            ["--either", &path("a/b")],
            ["--either", &path("there")],
            ["--either", "-"],
        ] {
            assert_eq!(refusal(&good), None, "{good:?}");
        }
        assert_eq!(refusal(&["--json"]), None, "stdout");
        for (bad, part) in [
            (["--file", &path("no/a")], "does not exist"),
            (["--json", &path("no/a")], "does not exist"),
            (["--file", &path("there/a")], "is not a folder"),
            (["--file", &path("")], "a file is expected"),
            (["--file", &path("new/")], "a file is expected"),
            (["--file", "-"], "stdout"),
            (["--folder", &path("there/a")], "is not a folder"),
            (["--folder", &path("there")], "is not a folder"),
            (["--folder", "-"], "stdout"),
            (["--either", &path("there/a")], "is not a folder"),
        ] {
            let refusal = refusal(&bad).unwrap_or_else(|| panic!("accepted: {bad:?}"));
            assert!(refusal.contains(part) && refusal.contains(bad[1]), "{bad:?}: {refusal}");
        }
        let several = ["--folder", &path("a"), "--folder", &path("there"), "--file", &path("a")];
        assert!(refusal(&several).is_some(), "the second value");
        assert_eq!(fs::read_dir(dir.path()).expect("there").count(), 1, "a check leaves no file");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_checked_at_their_target() {
        let dir = tempfile::tempdir().expect("temporary folder");
        let link = dir.path().join("link");
        std::os::unix::fs::symlink("no/such/file", &link).expect("linked");
        let link = link.display().to_string();
        assert!(refusal(&["--file", &link]).is_some_and(|r| r.contains("no/such") && r.contains(&link)));
    }
}
