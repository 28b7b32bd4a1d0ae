//! Progress of a long task.

/// Receives the stages of a task, one after another, from any thread. A progress bar implements this.
pub trait Progress: Sync {
    /// A stage of `total` steps begins; the previous one, if any, is done.
    fn start(&self, stage: &str, total: usize);

    /// A number of further steps of the stage are done.
    fn advance(&self, steps: usize);

    /// The last stage is done.
    fn finish(&self);
}

/// No progress display.
impl Progress for () {
    fn start(&self, _stage: &str, _total: usize) {}

    fn advance(&self, _steps: usize) {}

    fn finish(&self) {}
}
