//! What of an image is hidden: the same words wherever images are sealed.

use std::path::{Path, PathBuf};

use veiloc_features::{FeatureError, Mask, load_mask};

use crate::exit::Failure;
use crate::items::{Fault, FaultKind};

/// Parts of an image that nobody is to be told of.
#[derive(clap::Args)]
pub(crate) struct MaskArgs {
    /// Hide what is black in this image (anything darker than half), JPEG or PNG, of the size of the image that is sealed: nothing of
    /// it is looked at, and no keypoint that looks there is sent. As COLMAP's masks; what may be sent is white.
    #[arg(long, value_name = "IMAGE")]
    mask: Option<PathBuf>,
}

impl MaskArgs {
    /// Whether a mask is given, which is of one image.
    pub(crate) const fn is_of_one_image(&self) -> bool {
        self.mask.is_some()
    }

    /// The file of the mask, if there is one.
    pub(crate) fn file(&self) -> Option<&Path> {
        self.mask.as_deref()
    }

    /// What is hidden, for a command of one image; `None` when nothing is asked to be hidden.
    pub(crate) fn open(&self) -> Result<Option<Mask>, Failure> {
        self.mask
            .as_deref()
            .map(|path| read(path).map_err(|fault| Failure::refused(fault.message)))
            .transpose()
    }
}

/// Reads a mask. One that cannot be used is a fault of its image, which is then not sealed.
pub(crate) fn read(path: &Path) -> Result<Mask, Fault> {
    load_mask(path).map_err(|error| {
        let kind = match &error {
            FeatureError::Read { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
                FaultKind::Missing
            }
            FeatureError::Read { .. } => FaultKind::Unreadable,
            FeatureError::Decode { .. } => FaultKind::Damaged,
            _ => FaultKind::Unfit,
        };
        Fault::new(kind, error)
    })
}

/// How much is hidden, in words that go before the number of keypoints: one that is the wrong way round shows.
pub(crate) fn said(share: f64) -> String {
    format!("{:.1} % of the image hidden, ", 100.0 * share)
}
