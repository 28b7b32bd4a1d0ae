//! Which half of a set of images is used: one is to design with, the other untouched until the final figure.

use std::path::Path;

use serde::Serialize;
use veiloc_datasets::problem_files::is_for_design;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(super) enum Half {
    /// The half to design and calibrate with.
    Design,
    /// The half that only final figures may be of.
    Final,
    /// All of them.
    All,
}

impl Half {
    pub(super) fn holds(self, file: &Path) -> bool {
        self == Self::All || is_for_design(file) == (self == Self::Design)
    }
}
