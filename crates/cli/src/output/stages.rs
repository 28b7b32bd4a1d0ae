//! Shows the stages of a library's long work, one after another.

use std::sync::{Mutex, PoisonError};

use veiloc_features::Progress;

use crate::output::progress::Stage;
use crate::output::ui::Ui;

/// Shows the stages of a library's long work, one after another.
pub(crate) struct Stages<'a> {
    ui: &'a Ui,
    current: Mutex<Stage>,
}

impl<'a> Stages<'a> {
    /// Starts without a stage.
    pub(crate) fn new(ui: &'a Ui) -> Self {
        Self { ui, current: Mutex::new(Stage::silent()) }
    }

    fn with(&self, act: impl FnOnce(&mut Stage)) {
        // A poisoned lock is harmless: a stage is only output.
        act(&mut self.current.lock().unwrap_or_else(PoisonError::into_inner));
    }
}

impl Progress for Stages<'_> {
    fn start(&self, stage: &str, total: usize) {
        self.with(|current| {
            current.finish();
            *current = self.ui.stage(stage, total as u64);
        });
    }

    fn advance(&self, steps: usize) {
        self.with(|stage| stage.advance(steps as u64));
    }

    fn finish(&self) {
        self.with(|stage| {
            stage.finish();
            *stage = Stage::silent();
        });
    }
}
