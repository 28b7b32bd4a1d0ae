//! How far a long job is.

/// Told about the stages of a job, one after another, from whatever thread works. A progress bar implements this.
pub trait Progress: Sync {
    /// A stage of `total` steps begins; the one before it, if any, is done.
    fn start(&self, stage: &str, total: usize);

    /// So many more steps of the stage are done.
    fn advance(&self, steps: usize);

    /// The last stage is done.
    fn finish(&self);
}

/// Nobody watches.
impl Progress for () {
    fn start(&self, _stage: &str, _total: usize) {}

    fn advance(&self, _steps: usize) {}

    fn finish(&self) {}
}
