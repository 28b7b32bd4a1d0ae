//! Talk to people: progress and remarks on stderr, results on stdout.

use std::io::{ErrorKind, IsTerminal, Write as _};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;

use crate::output::exit::Failure;
use crate::output::progress::Stage;

/// Where the program talks.
pub(crate) struct Ui {
    quiet: bool,
    /// Whether a person watches stderr.
    terminal: bool,
    /// Why results did not all reach stdout.
    lost: Mutex<Option<std::io::Error>>,
}

impl Ui {
    /// Bars only where a person watches.
    pub(crate) fn new(quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        // Names of files must stay whole, to be copied or searched for.
        let options = move || miette::MietteHandlerOpts::new().wrap_lines(terminal).break_words(false);
        // Fails only when there is a hook already; then that one was meant.
        let _ = miette::set_hook(Box::new(move |_| Box::new(options().build())));
        Self { quiet, terminal, lost: Mutex::new(None) }
    }

    /// Whether remarks are not wanted.
    pub(crate) const fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// A remark for people.
    pub(crate) fn say(&self, text: impl std::fmt::Display) {
        if !self.quiet {
            tell(text);
        }
    }

    /// Something that went wrong, but does not end the work.
    #[expect(clippy::unused_self, reason = "all that is printed is printed by one value")]
    pub(crate) fn complain(&self, text: impl std::fmt::Display) {
        tell(text);
    }

    /// A result: the table or text a person asked for.
    pub(crate) fn print(&self, text: impl std::fmt::Display) {
        self.print_bytes(text.to_string().as_bytes());
    }

    /// A result that is no text.
    ///
    /// A reader that closed the pipe has read enough; that is no error. Anything else that keeps a result from stdout
    /// is remembered, so that no command can end well without it: see [`Self::lost_output`].
    pub(crate) fn print_bytes(&self, bytes: &[u8]) {
        let mut out = std::io::stdout().lock();
        match out.write_all(bytes).and_then(|()| out.flush()) {
            Err(error) if error.kind() != ErrorKind::BrokenPipe => self.lose(error),
            _ => {}
        }
    }

    /// Remembers why a result did not reach stdout; the first cause counts.
    fn lose(&self, error: std::io::Error) {
        self.lost.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }

    /// Why results did not all reach stdout, once.
    pub(crate) fn lost_output(&self) -> Option<Failure> {
        let error = self.lost.lock().unwrap_or_else(PoisonError::into_inner).take()?;
        Some(Failure::output("stdout", &error))
    }

    /// One JSON document on stdout.
    ///
    /// # Errors
    /// When it is no JSON; what does not reach stdout is told by [`Self::lost_output`].
    pub(crate) fn json(&self, document: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(document)?;
        self.print(text + "\n");
        Ok(())
    }

    /// What went wrong, with the remedy.
    #[expect(clippy::unused_self, reason = "all that is printed is printed by one value")]
    pub(crate) fn failure(&self, failure: &Failure) {
        match failure {
            Failure::Refused { report } | Failure::Output { report } => tell(format_args!("{report:?}")),
            Failure::Bug { place } => tell(format_args!(
                "veiloc broke at {place}\nThis is a bug in veiloc; please report it with the command you ran."
            )),
        }
    }

    /// A stage of `total` steps.
    pub(crate) fn stage(&self, name: &str, total: u64) -> Stage {
        match (self.quiet, self.terminal) {
            (true, _) => Stage::silent(),
            (false, true) => Stage::bar(name, total),
            (false, false) => Stage::lines(name, total),
        }
    }
}

/// A line on stderr. Where even that is closed there is nobody left to tell.
fn tell(text: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr(), "{text}");
}
