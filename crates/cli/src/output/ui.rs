//! Terminal output: progress and messages on stderr, results on stdout.

use std::io::{ErrorKind, IsTerminal, Write as _};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;

use crate::output::exit::Failure;
use crate::output::progress::Stage;

/// Terminal output of the program.
pub(crate) struct Ui {
    quiet: bool,
    /// Whether stderr is a terminal.
    terminal: bool,
    /// Warnings that were not printed because of --quiet; an error prints them before itself.
    held_warnings: Mutex<Vec<String>>,
    /// The first error of writing results to stdout.
    lost_output_error: Mutex<Option<std::io::Error>>,
}

impl Ui {
    /// Progress bars appear only on a terminal.
    pub(crate) fn new(quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        // File names must not be broken, so that they can be copied and searched for.
        let options = move || miette::MietteHandlerOpts::new().wrap_lines(terminal).break_words(false);
        // Fails only if a hook exists already, which then takes precedence.
        let _ = miette::set_hook(Box::new(move |_| Box::new(options().build())));
        Self { quiet, terminal, held_warnings: Mutex::new(Vec::new()), lost_output_error: Mutex::new(None) }
    }

    /// Returns whether messages are suppressed.
    pub(crate) const fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// Prints a message, unless quiet.
    pub(crate) fn info(&self, text: impl std::fmt::Display) {
        if !self.quiet {
            print_line(text);
        }
    }

    /// Prints a warning about the result. When quiet, it is printed only if the command fails, before the error.
    pub(crate) fn warning(&self, text: impl std::fmt::Display) {
        let line = format!("warning: {text}");
        if self.quiet {
            self.held_warnings.lock().unwrap_or_else(PoisonError::into_inner).push(line);
        } else {
            print_line(line);
        }
    }

    /// Prints a problem that does not end the work.
    #[expect(clippy::unused_self, reason = "all printing goes through one value")]
    pub(crate) fn warn(&self, text: impl std::fmt::Display) {
        print_line(text);
    }

    /// Prints a result: a table or text.
    pub(crate) fn print(&self, text: impl std::fmt::Display) {
        self.print_bytes(text.to_string().as_bytes());
    }

    /// Prints a binary result.
    ///
    /// A closed pipe is not an error: the reader needs no more. Any other error is stored, so that no command can
    /// succeed without its output: see [`Self::lost_output`].
    pub(crate) fn print_bytes(&self, bytes: &[u8]) {
        let mut out = std::io::stdout().lock();
        match out.write_all(bytes).and_then(|()| out.flush()) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => self.record_lost_output(error),
            _ => {}
        }
    }

    /// Stores why a result did not reach stdout; the first cause counts.
    fn record_lost_output(&self, error: std::io::Error) {
        self.lost_output_error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }

    /// Takes the error of writing results to stdout.
    pub(crate) fn lost_output(&self) -> Option<Failure> {
        let error = self.lost_output_error.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        Some(Failure::output("stdout", &error))
    }

    /// Prints one JSON document to stdout.
    ///
    /// # Errors
    /// The document cannot be serialized; write errors are returned by [`Self::lost_output`].
    pub(crate) fn json(&self, document: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(document)?;
        self.print(text + "\n");
        Ok(())
    }

    /// Prints an error with its remedy, after the warnings that led to it.
    pub(crate) fn failure(&self, failure: &Failure) {
        self.held_warnings.lock().unwrap_or_else(PoisonError::into_inner).drain(..).for_each(print_line);
        match failure {
            Failure::Refused { report } | Failure::Output { report } => {
                print_line(format_args!("{report:?}"));
            }
            Failure::Bug { location } => print_line(format_args!(
                "veiloc panicked at {location}\nThis is a bug in veiloc; please report it with the command \
                 you ran."
            )),
        }
    }

    /// Begins a stage of `total` steps.
    pub(crate) fn stage(&self, name: &str, total: u64) -> Stage {
        match (self.quiet, self.terminal) {
            (true, _) => Stage::silent(),
            (false, true) => Stage::bar(name, total),
            (false, false) => Stage::lines(name, total),
        }
    }
}

/// Prints a line on stderr; if stderr is closed, the line is lost.
fn print_line(text: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
