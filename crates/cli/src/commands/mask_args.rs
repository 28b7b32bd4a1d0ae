//! Options that hide parts of an image, for all commands that seal images.

use std::path::{Path, PathBuf};

use veiloc_features::detector::{HideOptions, ObjectMasker};
use veiloc_features::{FeatureError, Mask, PersonSegmenter, load_mask};

use crate::commands::user_folder::user_data;
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
    /// Hide what a detector finds, with a margin, as if a mask covered it: people, with MediaPipe's selfie segmentation; or
    /// the boxes of classes of another detector, for example person,car. What it misses is sent; what it finds is
    /// reported. If the detector cannot run, nothing is sealed. Default: no detection.
    #[arg(long, value_name = "CLASS,…", value_delimiter = ',')]
    hide: Vec<String>,
    /// The detector: selfie_segmentation.tflite of MediaPipe, or an ONNX file in YOLO's form (versions 8 to 11) with the
    /// names of its classes. veiloc includes none. Default for people: veiloc/selfie_segmentation.tflite in
    /// $XDG_DATA_HOME or in .local/share of your home folder.
    #[arg(long, value_name = "FILE", requires = "hide")]
    detector: Option<PathBuf>,
    /// Margin: of boxes on each side, as a share of their width and height, default 0.15; of people, as a share of the
    /// image, default 0.02.
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
    /// Number of detections per class, of people the number of regions; `None` if no detector ran.
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
        if self.hide.is_empty() {
            return Ok(MaskedRegionDetector(None));
        }
        let file = self.detector.clone().map_or_else(|| default_detector(&self.hide), Ok)?;
        let mut options = HideOptions::default();
        options.margin = self.hide_margin;
        Ok(MaskedRegionDetector(Some(
            ObjectMasker::open(&file, &self.hide, options).map_err(Failure::refused)?,
        )))
    }
}

/// The user's copy of MediaPipe's selfie segmentation.
fn default_detector(classes: &[String]) -> Result<PathBuf, Failure> {
    if classes != [PersonSegmenter::CLASS] {
        return Err(Failure::with_help(
            format!("--hide {} needs a detector of these classes", classes.join(",")),
            "give one with --detector, or use --hide people",
        ));
    }
    let file = user_data().map(|folder| folder.join("selfie_segmentation.tflite"));
    match file {
        Some(file) if file.is_file() => Ok(file),
        missing => {
            let place = missing.map_or("--detector".to_owned(), |file| file.display().to_string());
            Err(Failure::with_help(
                format!("--hide people needs MediaPipe's selfie segmentation: {place} is missing"),
                SOURCE,
            ))
        }
    }
}

/// Where the network comes from.
const SOURCE: &str = "get it (Apache-2.0) with `npm pack @mediapipe/selfie_segmentation@0.1.1675465747 && tar -xzf \
    mediapipe-selfie_segmentation-0.1.1675465747.tgz package/selfie_segmentation.tflite`; its SHA-256 is \
    8d13b7fae74af625c641226813616a2117bd6bca19eb3b75574621fc08557f27; put it there, or give it with --detector";

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
            [(class, 0)] => format!("0 {class} found: nothing was hidden"),
            [(class, n)] if class == PersonSegmenter::CLASS => {
                format!("{class} found in {n} region{}", if *n == 1 { "" } else { "s" })
            }
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
