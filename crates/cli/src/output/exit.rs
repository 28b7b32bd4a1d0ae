//! Exit codes, and the classification of failures.

use std::io::ErrorKind;
use std::panic::{AssertUnwindSafe, PanicHookInfo, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, ThreadId};

use veiloc_service::ServerError;

/// How the program ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Exit {
    /// Success.
    Success,
    /// The input was refused, or nothing was localized.
    Refused,
    /// Wrong usage of the command line or of a settings layer.
    Usage,
    /// The pose is doubtful.
    Doubtful,
    /// Results could not be written.
    Unwritten,
    /// Internal error.
    Bug,
}

/// For `veiloc --help`.
pub(crate) const EXIT_CODES: &str = "\
Exit codes:
  0  done
  1  input was refused (of several files: at least one, see --skip-bad), an output file or folder cannot be
     written to, which is checked before any work, or nothing was localized
  2  wrong usage of the command line
  3  results could not be written (for example, the disk is full), or there is a bug in veiloc
  4  localized, but a pose is doubtful (of several queries: at least one)

If the reader closes the pipe (`veiloc … | head`), that is not an error.";

impl Exit {
    /// Returns the exit code of the process.
    pub(crate) const fn code(self) -> u8 {
        match self {
            Self::Success => 0,
            Self::Refused => 1,
            // The same as clap's.
            Self::Usage => 2,
            Self::Unwritten | Self::Bug => 3,
            Self::Doubtful => 4,
        }
    }
}

/// Why a command failed.
#[derive(Debug)]
pub(crate) enum Failure {
    /// An input cannot be used; the message names it, and the help gives the remedy.
    Refused {
        /// The error with its causes.
        report: miette::Report,
    },
    /// Results could not be written, although the request was valid.
    Output {
        /// The destination, and the error of the operating system.
        report: miette::Report,
    },
    /// Internal error.
    Bug {
        /// File and line of the panic. The panic message is dropped: it may contain data of an image or a query.
        location: String,
    },
}

impl Failure {
    /// A refusal whose message contains the remedy.
    pub(crate) fn refused(message: impl std::fmt::Display) -> Self {
        Self::Refused { report: miette::miette!("{message}") }
    }

    /// A refusal with a remedy.
    pub(crate) fn with_help(message: impl std::fmt::Display, help: impl std::fmt::Display) -> Self {
        let report = miette::miette!(help = help.to_string(), "{message}");
        Self::Refused { report }
    }

    /// Returns the error for results that could not be written to `target`.
    ///
    /// A path that cannot be an output file is a refused input; a failing disk or device is not.
    pub(crate) fn output(target: impl std::fmt::Display, error: &std::io::Error) -> Self {
        if is_about_the_path(error.kind()) {
            let help = "check that the folder exists, is writable, and has free space";
            return Self::with_help(format!("{target}: {error}"), help);
        }
        let help = "results are lost: free some space, or choose another destination, and run the command \
                    again";
        Self::Output { report: miette::miette!(help = help, "{target}: cannot be written: {error}") }
    }

    /// Returns the exit code.
    pub(crate) const fn exit(&self) -> Exit {
        match self {
            Self::Refused { .. } => Exit::Refused,
            Self::Output { .. } => Exit::Unwritten,
            Self::Bug { .. } => Exit::Bug,
        }
    }
}

/// Returns whether the error of the operating system is about the given path rather than the disk.
const fn is_about_the_path(kind: ErrorKind) -> bool {
    matches!(
        kind,
        ErrorKind::NotFound
            | ErrorKind::NotADirectory
            | ErrorKind::IsADirectory
            | ErrorKind::PermissionDenied
            | ErrorKind::ReadOnlyFilesystem
            | ErrorKind::InvalidInput
            | ErrorKind::InvalidFilename
            | ErrorKind::AlreadyExists
    )
}

/// Every library error is a refused input, except a full disk.
impl<E: std::error::Error + Send + Sync + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        let Some(kind) = io_kind(&error) else {
            return Self::Refused { report: miette::Report::from_err(error) };
        };
        if (&error as &dyn std::any::Any)
            .downcast_ref::<ServerError>()
            .is_some_and(|e| matches!(e, ServerError::Listen { .. }))
        {
            // It is about an address, not a file, and names its remedy.
            return Self::refused(error);
        }
        let help = remedy_of_io(kind);
        if matches!(kind, ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge) {
            return Self::Output { report: miette::miette!(help = help, "{error}") };
        }
        Self::with_help(error, help)
    }
}

/// Returns the kind of the underlying I/O error, if there is one.
fn io_kind(error: &(dyn std::error::Error + 'static)) -> Option<ErrorKind> {
    let mut causes = std::iter::successors(Some(error), |e| e.source());
    causes.find_map(|e| e.downcast_ref::<std::io::Error>()).map(std::io::Error::kind)
}

/// Returns the remedy for an I/O error: the libraries name the file and the error, but no remedy.
pub(crate) const fn remedy_of_io(kind: ErrorKind) -> &'static str {
    match kind {
        ErrorKind::NotFound | ErrorKind::NotADirectory => "check the path, and that its folder exists",
        ErrorKind::IsADirectory => "check the path: it is a folder, and a file is expected",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
            "check the permissions of the file and of its folder, or choose another path"
        }
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => {
            "free some space on the disk, or choose another path"
        }
        ErrorKind::UnexpectedEof | ErrorKind::InvalidData | ErrorKind::InvalidInput => {
            "the file is truncated or damaged; copy it again or create it again"
        }
        _ => "check the path, and that the file and its folder are readable and writable",
    }
}

/// Result of a command.
pub(crate) type Outcome = Result<Exit, Failure>;

/// Runs a command; converts a panic, which is always a bug, to a failure that has its location but not its message.
///
/// # Errors
/// The command's own errors, and [`Failure::Bug`] for a panic.
pub(crate) fn catch_panics(command: impl FnOnce() -> Outcome) -> Outcome {
    let previous = std::panic::take_hook();
    let locations = Arc::new(PanicLocations::default());
    let recorder = locations.clone();
    std::panic::set_hook(Box::new(move |info| recorder.record(info)));
    let result = catch_unwind(AssertUnwindSafe(command));
    std::panic::set_hook(previous);
    result.unwrap_or_else(|_| Err(Failure::Bug { location: locations.last() }))
}

/// Locations of panics, per thread, in order.
#[derive(Default)]
struct PanicLocations(Mutex<Vec<(ThreadId, String)>>);

impl PanicLocations {
    fn record(&self, info: &PanicHookInfo<'_>) {
        let location = info.location().map_or_else(|| "an unknown location".to_owned(), ToString::to_string);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push((thread::current().id(), location));
    }

    /// Returns the last location of this thread. The panic of a helper thread is resumed without the hook: then the
    /// last location of any thread.
    fn last(&self) -> String {
        let locations = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let own = locations.iter().rev().find(|(id, _)| *id == thread::current().id());
        own.or(locations.last())
            .map_or_else(|| "an unknown location".to_owned(), |(_, location)| location.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_disk_and_wrong_path_have_different_exit_codes() {
        for (kind, exit) in [
            (ErrorKind::StorageFull, Exit::Unwritten),
            (ErrorKind::Other, Exit::Unwritten),
            (ErrorKind::NotFound, Exit::Refused),
            (ErrorKind::PermissionDenied, Exit::Refused),
        ] {
            assert_eq!(Failure::output("a", &kind.into()).exit(), exit, "{kind}");
        }
        let of_a_library = |kind: ErrorKind| Failure::from(std::io::Error::from(kind)).exit();
        assert_eq!(of_a_library(ErrorKind::StorageFull), Exit::Unwritten);
        assert_eq!(of_a_library(ErrorKind::NotFound), Exit::Refused);
    }

    #[test]
    fn panics_report_location_without_message() {
        for in_another_thread in [false, true] {
            let (line, breaks) = (line!(), || -> Outcome { std::panic::panic_any("secret".to_owned()) });
            let outcome = catch_panics(|| {
                if in_another_thread {
                    // As thread pools do.
                    return thread::spawn(breaks).join().unwrap_or_else(|p| std::panic::resume_unwind(p));
                }
                breaks()
            });
            let failure = outcome.expect_err("it panicked");
            assert_eq!(failure.exit(), Exit::Bug);
            let Failure::Bug { location } = failure else { panic!("another failure") };
            assert!(location.contains(&format!("exit.rs:{line}:")), "{location}");
        }
    }
}
