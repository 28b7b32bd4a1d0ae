//! Talk to people: progress bars and remarks on stderr, results on stdout.

use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::time::Duration;

use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use veiloc_features::Progress;

use crate::exit::Failure;

/// Where the program talks.
pub(crate) struct Ui {
    quiet: bool,
    bars: bool,
}

impl Ui {
    /// Bars only where a person watches.
    pub(crate) fn new(quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        // Names of files must stay whole, to be copied or searched for.
        let options = move || miette::MietteHandlerOpts::new().wrap_lines(terminal).break_words(false);
        // Fails only when there is a hook already; then that one was meant.
        let _ = miette::set_hook(Box::new(move |_| Box::new(options().build())));
        Self { quiet, bars: !quiet && terminal }
    }

    /// A remark for people.
    #[expect(clippy::print_stderr, reason = "remarks go to stderr, by design")]
    pub(crate) fn say(&self, text: impl std::fmt::Display) {
        if !self.quiet {
            eprintln!("{text}");
        }
    }

    /// A result: the table or text a person asked for.
    ///
    /// A reader that closed the pipe has read enough; that is no error.
    #[expect(clippy::unused_self, reason = "all output goes through the Ui")]
    pub(crate) fn print(&self, text: impl std::fmt::Display) {
        let _ = write!(std::io::stdout(), "{text}");
    }

    /// One JSON document on stdout.
    pub(crate) fn json(&self, document: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(document)?;
        self.print(text + "\n");
        Ok(())
    }

    /// What went wrong, with the remedy.
    #[expect(clippy::print_stderr, reason = "errors go to stderr, by design")]
    #[expect(clippy::unused_self, reason = "all output goes through the Ui")]
    pub(crate) fn failure(&self, failure: &Failure) {
        match failure {
            Failure::Refused { report } => eprintln!("{report:?}"),
            Failure::Bug { message } => {
                eprintln!(
                    "veiloc broke: {message}\nThis is a bug in veiloc; please report it with the command you ran."
                );
            }
        }
    }

    /// A bar for a stage of `total` steps; silent where nobody watches.
    pub(crate) fn bar(&self, stage: &str, total: u64) -> ProgressBar {
        if !self.bars {
            return ProgressBar::hidden();
        }
        let style = ProgressStyle::with_template("{msg:28} {wide_bar:.cyan/dim} {pos}/{len} {eta:>4}")
            .unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::new(total).with_style(style).with_message(stage.to_owned());
        bar.enable_steady_tick(Duration::from_millis(200));
        bar
    }
}

/// Shows the stages of a library's long work as bars, one after another.
pub(crate) struct Bars<'a> {
    ui: &'a Ui,
    current: Mutex<ProgressBar>,
}

impl<'a> Bars<'a> {
    /// No stage yet.
    pub(crate) fn new(ui: &'a Ui) -> Self {
        Self { ui, current: Mutex::new(ProgressBar::hidden()) }
    }

    fn with(&self, act: impl FnOnce(&mut ProgressBar)) {
        // A bar is only an image: one that another thread broke off in may still be drawn over.
        act(&mut self.current.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    }
}

impl Progress for Bars<'_> {
    fn start(&self, stage: &str, total: usize) {
        self.with(|bar| {
            bar.finish_and_clear();
            *bar = self.ui.bar(stage, total as u64);
        });
    }

    fn advance(&self, steps: usize) {
        self.with(|bar| bar.inc(steps as u64));
    }

    fn finish(&self) {
        self.with(|bar| bar.finish_and_clear());
    }
}
