//! Split of an image set into two halves: one for design, the other untouched until the final figures.

use std::path::Path;

use serde::Serialize;
use veiloc_datasets::problem_files::is_in_design_split;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub(super) enum Split {
    /// The half for design and calibration.
    Design,
    /// The half for final figures only.
    Final,
    /// All images.
    All,
}

impl Split {
    pub(super) fn holds(self, file: &Path) -> bool {
        self == Self::All || is_in_design_split(file) == (self == Self::Design)
    }
}
