//! `--pairs` of `eval scene` and `eval dataset`: images that another program retrieved.

use std::path::PathBuf;

use veiloc_evaluation::RetrievedImages;
use veiloc_mapping::importers::hloc::read_pairs;

use crate::output::exit::Failure;
use crate::output::ui::Ui;

/// Retrieval by another program.
#[derive(clap::Args)]
pub(super) struct PairsArgs {
    /// Match each query with the map images of this list, `QUERY MAP_IMAGE` in each line, the best first, as hloc writes
    /// it (such as its pairs of NetVLAD). Default: images are retrieved by the map's global descriptors.
    #[arg(long, value_name = "FILE")]
    pairs: Option<PathBuf>,
}

impl PairsArgs {
    /// Reads the list, if there is one.
    pub(super) fn retrieved(&self) -> Result<Option<RetrievedImages>, Failure> {
        let pairs = self.pairs.as_deref().map(read_pairs).transpose()?;
        Ok(pairs.map(RetrievedImages::of_pairs))
    }

    /// Refuses a list without an image for one of the queries, and warns of images that are not mapped.
    pub(super) fn check<'a>(
        &self,
        retrieved: &RetrievedImages,
        queries: impl IntoIterator<Item = &'a str>,
        mapped: &[String],
        ui: &Ui,
    ) -> Result<(), Failure> {
        let left_out = retrieved.check(queries, mapped)?;
        if let (Some(path), 1..) = (&self.pairs, left_out) {
            ui.warn(format!(
                "{}: {left_out} pairs are left out, because their images are not mapped",
                path.display()
            ));
        }
        Ok(())
    }
}
