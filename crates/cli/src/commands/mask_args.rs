//! Options that hide parts of an image, for all commands that seal images.

use std::path::{Path, PathBuf};

use veiloc_features::detector::{HideOptions, ObjectMasker};
use veiloc_features::{FeatureError, Mask, load_mask};

use crate::output::exit::Failure;
use crate::output::items::{InputError, InputErrorKind};

/// Parts of an image of which no feature is sent.
#[derive(clap::Args)]
pub(crate) struct MaskArgs {
    /// Hide what is black in this image (darker than half), of the size of the sealed image: no feature is
    /// extracted from it, and no keypoint is sent whose descriptor covers it. White may be sent, as in COLMAP's masks.
    /// Default: nothing is hidden.
    #[arg(long, value_name = "IMAGE")]
    mask: Option<PathBuf>,
    /// Hide the objects of these classes that a detector finds, for example person,car: their boxes with a margin, as
    /// if a mask covered them. Objects that it misses are sent; the number of detections is reported. If the detector
    /// cannot run, nothing is sealed. Default: no detection.
    #[arg(long, value_name = "CLASS,…", value_delimiter = ',', requires = "detector")]
    hide: Vec<String>,
    /// The detector: an ONNX file in YOLO's form (versions 8 to 11) with the names of its classes. veiloc does not
    /// include one.
    #[arg(long, value_name = "FILE", requires = "hide")]
    detector: Option<PathBuf>,
    /// Margin of the boxes on each side, as a share of their width and height. Default: 0.15.
    #[arg(long, value_name = "SHARE", requires = "hide", value_parser = margin)]
    hide_margin: Option<f32>,
}

fn margin(text: &str) -> Result<f32, String> {
    let share = text.parse::<f32>().ok().filter(|share| (0.0..=1.0).contains(share));
    share.ok_or_else(|| "a share from 0 to 1 is needed".to_owned())
}

/// The detector, ready to run.
pub(crate) struct MaskedRegionDetector(Option<ObjectMasker>);

/// The hidden part of one image.
#[derive(Default)]
pub(crate) struct MaskedRegion {
    /// `None` if nothing is hidden.
    pub(crate) mask: Option<Mask>,
    /// Number of detections per class; `None` if no detector ran.
    pub(crate) found: Option<Vec<(String, usize)>>,
}

impl MaskArgs {
    /// Returns whether a mask is given, which is valid for one image only.
    pub(crate) const fn has_mask(&self) -> bool {
        self.mask.is_some()
    }

    /// Returns the file of the mask, if given.
    pub(crate) fn file(&self) -> Option<&Path> {
        self.mask.as_deref()
    }

    /// Returns the detector's file, if given.
    pub(crate) const fn detector(&self) -> Option<&PathBuf> {
        self.detector.as_ref()
    }

    /// Loads the detector if requested: a command whose detector cannot be used seals nothing.
    pub(crate) fn open(&self) -> Result<MaskedRegionDetector, Failure> {
        let Some(file) = &self.detector else { return Ok(MaskedRegionDetector(None)) };
        let mut options = HideOptions::default();
        options.margin = self.hide_margin.unwrap_or(options.margin);
        Ok(MaskedRegionDetector(Some(
            ObjectMasker::open(file, &self.hide, options).map_err(Failure::refused)?,
        )))
    }
}

impl MaskedRegionDetector {
    /// Returns the hidden part of an image, from the mask file and the detections. An unusable mask is an error of the
    /// image, which is then not sealed.
    pub(crate) fn of(&self, image: &Path, mask: Option<&Path>) -> Result<MaskedRegion, InputError> {
        let mask = mask.map(|path| load_mask(path).map_err(|error| mask_error(&error))).transpose()?;
        let Some(masker) = &self.0 else { return Ok(MaskedRegion { mask, found: None }) };
        let hidden = masker.hide(image).map_err(|error| mask_error(&error))?;
        let both = match (mask, hidden.mask) {
            (Some(mask), Some(found)) => Some(mask.and(&found).map_err(|error| mask_error(&error))?),
            (mask, found) => mask.or(found),
        };
        Ok(MaskedRegion { mask: both, found: Some(hidden.found) })
    }
}

impl MaskedRegion {
    /// Returns the hidden share of the image; `None` if nothing is hidden.
    pub(crate) fn share(&self) -> Option<f64> {
        self.mask.as_ref().map(Mask::share)
    }

    /// Describes how much is hidden, in words before the number of keypoints, so that an inverted mask is noticed.
    pub(crate) fn description(&self) -> String {
        let share = self.share().map(|share| format!("{:.1} % of the image hidden", 100.0 * share));
        let found = self.found.as_ref().map(|found| match found.as_slice() {
            [] => "no objects found to hide".to_owned(),
            found => {
                let each: Vec<String> = found.iter().map(|(class, n)| format!("{n} × {class}")).collect();
                format!("found {}", each.join(" and "))
            }
        });
        found.into_iter().chain(share).map(|words| words + ", ").collect()
    }
}

fn mask_error(error: &FeatureError) -> InputError {
    let kind = match error {
        FeatureError::Read { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            InputErrorKind::Missing
        }
        FeatureError::Read { .. } => InputErrorKind::Unreadable,
        FeatureError::Decode { .. } => InputErrorKind::Damaged,
        _ => InputErrorKind::Unfit,
    };
    InputError::new(kind, error)
}
