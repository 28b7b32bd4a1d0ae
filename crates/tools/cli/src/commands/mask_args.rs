//! What of an image is hidden: the same words wherever images are sealed.

use std::path::{Path, PathBuf};

use veiloc_features::detector::{HideOptions, Hider};
use veiloc_features::{FeatureError, Mask, load_mask};

use crate::exit::Failure;
use crate::items::{Fault, FaultKind};

/// Parts of an image that nobody is to be told of.
#[derive(clap::Args)]
pub(crate) struct MaskArgs {
    /// Hide what is black in this image (anything darker than half), JPEG or PNG, of the size of the image that is sealed: nothing of
    /// it is looked at, and no keypoint that looks there is sent. As COLMAP's masks; what may be sent is white.
    /// Default: nothing is hidden.
    #[arg(long, value_name = "IMAGE")]
    mask: Option<PathBuf>,
    /// Hide what a detector finds of these classes, for example person,car: their boxes with a margin, as if a mask covered
    /// them. What it does not find is sent; how much was found is told. Where it cannot run nothing is sealed. Default: nothing
    /// is looked for.
    #[arg(long, value_name = "CLASS,…", value_delimiter = ',', requires = "detector")]
    hide: Vec<String>,
    /// The detector: an ONNX file of YOLO's form (versions 8 to 11) that tells the names of its classes. Bring your own.
    #[arg(long, value_name = "FILE", requires = "hide")]
    detector: Option<PathBuf>,
    /// By how much boxes are widened on each side, as a share of their width and height. Default: 0.15.
    #[arg(long, value_name = "SHARE", requires = "hide", value_parser = margin)]
    hide_margin: Option<f32>,
}

fn margin(text: &str) -> Result<f32, String> {
    let share = text.parse::<f32>().ok().filter(|share| (0.0..=1.0).contains(share));
    share.ok_or_else(|| "a share from 0 to 1 is needed".to_owned())
}

/// What finds things to hide, ready to look at images.
pub(crate) struct Hiding(Option<Hider>);

/// What is hidden of one image.
#[derive(Default)]
pub(crate) struct HiddenPart {
    /// `None` when nothing is.
    pub(crate) mask: Option<Mask>,
    /// Classes and how many of each were found; `None` when nothing was looked for.
    pub(crate) found: Option<Vec<(String, usize)>>,
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

    /// The detector's file, if there is one.
    pub(crate) const fn detector(&self) -> Option<&PathBuf> {
        self.detector.as_ref()
    }

    /// Opens the detector where one is asked for: a command whose detector cannot be used seals nothing.
    pub(crate) fn open(&self) -> Result<Hiding, Failure> {
        let Some(file) = &self.detector else { return Ok(Hiding(None)) };
        let mut options = HideOptions::default();
        options.margin = self.hide_margin.unwrap_or(options.margin);
        Ok(Hiding(Some(Hider::open(file, &self.hide, options).map_err(Failure::refused)?)))
    }
}

impl Hiding {
    /// What is hidden of an image, by a mask's file and by what is found in it. What cannot be used is a fault of the image,
    /// which is then not sealed.
    pub(crate) fn of(&self, image: &Path, mask: Option<&Path>) -> Result<HiddenPart, Fault> {
        let mask = mask.map(|path| load_mask(path).map_err(|error| fault(&error))).transpose()?;
        let Some(hider) = &self.0 else { return Ok(HiddenPart { mask, found: None }) };
        let hidden = hider.hide(image).map_err(|error| fault(&error))?;
        let both = match (mask, hidden.mask) {
            (Some(mask), Some(found)) => Some(mask.and(&found).map_err(|error| fault(&error))?),
            (mask, found) => mask.or(found),
        };
        Ok(HiddenPart { mask: both, found: Some(hidden.found) })
    }
}

impl HiddenPart {
    /// Share of the image; `None` when nothing is hidden.
    pub(crate) fn share(&self) -> Option<f64> {
        self.mask.as_ref().map(Mask::share)
    }

    /// How much is hidden, in words that go before the number of keypoints: a mask the wrong way round shows.
    pub(crate) fn said(&self) -> String {
        let share = self.share().map(|share| format!("{:.1} % of the image hidden", 100.0 * share));
        let found = self.found.as_ref().map(|found| match found.as_slice() {
            [] => "nothing found to hide".to_owned(),
            found => {
                let each: Vec<String> = found.iter().map(|(class, n)| format!("{n} × {class}")).collect();
                format!("found {}", each.join(" and "))
            }
        });
        found.into_iter().chain(share).map(|words| words + ", ").collect()
    }
}

fn fault(error: &FeatureError) -> Fault {
    let kind = match error {
        FeatureError::Read { source, .. } if source.kind() == std::io::ErrorKind::NotFound => {
            FaultKind::Missing
        }
        FeatureError::Read { .. } => FaultKind::Unreadable,
        FeatureError::Decode { .. } => FaultKind::Damaged,
        _ => FaultKind::Unfit,
    };
    Fault::new(kind, error)
}
