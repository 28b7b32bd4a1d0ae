//! Exit codes, and whose fault a failure is.

use std::io::ErrorKind;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

/// How the program ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    /// All went well.
    Success,
    /// The input was refused, or nothing was localized.
    Refused,
    /// Our own error.
    Bug,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        // 2, wrong usage, is clap's.
        Self::from(match exit {
            Exit::Success => 0,
            Exit::Refused => 1,
            Exit::Bug => 3,
        })
    }
}

/// Why a command could not do its work.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Something that was given cannot be used; the message names it, the help says what to do.
    Refused {
        /// What is wrong, with the causes below it.
        report: miette::Report,
    },
    /// Our own error.
    Bug {
        /// What the program said as it broke.
        message: String,
    },
}

impl Failure {
    /// A refusal whose message tells the remedy itself.
    pub(crate) fn refused(message: impl std::fmt::Display) -> Self {
        Self::Refused { report: miette::miette!("{message}") }
    }

    /// A refusal with a remedy.
    pub(crate) fn with_help(message: impl std::fmt::Display, help: impl std::fmt::Display) -> Self {
        let report = miette::miette!(help = help.to_string(), "{message}");
        Self::Refused { report }
    }

    /// The exit code it ends with.
    pub(crate) const fn exit(&self) -> Exit {
        match self {
            Self::Refused { .. } => Exit::Refused,
            Self::Bug { .. } => Exit::Bug,
        }
    }
}

/// Every error of the libraries is about what was given to them: a refusal.
impl<E: std::error::Error + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        match remedy_of_io(&error) {
            Some(help) => Self::with_help(error, help),
            None => Self::Refused { report: miette::Report::from_err(error) },
        }
    }
}

/// What to do when the system refused a file: libraries say which file and what it said, but that is no remedy yet.
fn remedy_of_io(error: &(dyn std::error::Error + 'static)) -> Option<&'static str> {
    let mut causes = std::iter::successors(Some(error), |e| e.source());
    let io = causes.find_map(|e| e.downcast_ref::<std::io::Error>())?;
    Some(match io.kind() {
        ErrorKind::NotFound | ErrorKind::NotADirectory => "check the path, and that its folder exists",
        ErrorKind::IsADirectory => "check the path: it leads to a folder, and a file is wanted",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
            "check the permissions of the file and of its folder, or choose another place"
        }
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "make room on the disk, or choose another place",
        ErrorKind::UnexpectedEof | ErrorKind::InvalidData | ErrorKind::InvalidInput => {
            "the file is cut short or damaged; copy it again or make it anew"
        }
        _ => "check the path, and that the file and its folder may be read and written",
    })
}

/// What a command returns.
pub(crate) type Outcome = Result<Exit, Failure>;

/// Runs a command; a panic, which is a bug of ours, becomes a failure with its own exit code.
pub(crate) fn catching_panics(command: impl FnOnce() -> Outcome) -> Outcome {
    let previous = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let result = catch_unwind(AssertUnwindSafe(command));
    std::panic::set_hook(previous);
    result.unwrap_or_else(|panic| {
        let message = panic
            .downcast_ref::<String>()
            .cloned()
            .or_else(|| panic.downcast_ref::<&str>().map(|s| (*s).to_owned()))
            .unwrap_or_else(|| "no message".to_owned());
        Err(Failure::Bug { message })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_our_own_error() {
        let outcome = catching_panics(|| {
            let empty: [u8; 0] = [];
            assert!(!empty.is_empty(), "broke");
            Ok(Exit::Success)
        });
        let failure = outcome.expect_err("it panicked");
        assert_eq!(failure.exit(), Exit::Bug);
        assert!(matches!(failure, Failure::Bug { message } if message.contains("broke")));
    }
}
