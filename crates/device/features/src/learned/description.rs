//! Description of a network file: a short text file (TOML) beside it, or one of the built-in ones (`models/`).
//!
//! ```toml
//! name = "mine"                     # also of the descriptor kind
//! source = "https://…"              # where to get its file
//! export = "python …"               # command that makes the file from the source; optional
//! licence = "MIT"
//! files = ["mine.onnx"]             # the first that is found is used
//!
//! [input]
//! channels = 1                      # 1: gray; 3: gray in all three
//! normalize = "none"                # samples from 0 to 1; "image": of mean 0 and variance 1 in each image;
//!                                   # { mean = [0.5], deviation = [0.25] }
//! multiple = 8                      # sides are multiples of it; omitted when the file has a fixed size
//! longest_side = 1024               # larger images are scaled down; optional
//! margin = 32                       # pixels of mirror image around the image
//!
//! [scores]
//! layer = "scores"                  # a layer's name, or the number of an output
//! channels_last = false             # [1, C, H, W]; true: [1, H, W, C]
//! form = "cells"                    # "cells": stride² positions and "none", before softmax; "map": one per pixel
//! stride = 8                        # width and height of a cell in pixels
//! factor = 2                        # a layer by which scores are multiplied; optional
//! threshold = 0.005                 # minimum score
//! radius = 3                        # radius of non-maximum suppression, pixels
//! rounds = 2                        # rounds of non-maximum suppression
//! border = 4                        # width of the image border without keypoints, pixels
//! refine = "none"                   # "mean": weighted mean of positions; "parabola": through the neighbours' scores
//!
//! [descriptors]
//! layer = "descriptors"
//! head = "mine-head.onnx"           # a second network, beside the first, that samples the layer at keypoints; optional:
//!                                   # `features`, the layer, and `keypoints` [1, N, 2], column and row in the first
//!                                   # network's input (integers are pixel centres) -> `descriptors` [1, N, numbers]
//! channels_last = false
//! numbers = 256                     # dimension of a descriptor
//! stride = 8                        # this and the next two are not used with a head
//! interpolation = "linear"          # or "cubic"
//! grid = "centers"                  # position of cells: "centers", "corners", "superpoint", "xfeat"
//! length = 512                      # of a vector in byte units; default: 32 times the root of `numbers`
//! receptive_field = 32              # keypoints nearer than this to a mask are dropped, pixels
//!
//! [projection]                      # of the descriptors to numbers of 4 bits; optional
//! file = "mine.bin"                 # beside this file, from `study features projection`, or built in (`projections/`)
//! numbers = 48                      # dimension after the projection
//! shift = 16                        # as in the script
//! length = 299                      # of a projected vector, printed by the script
//! ```
//!
//! `of = "alike-t"` at the top includes another model's description: a table of this file replaces that model's whole
//! table.

use std::path::Path;

use crate::FeatureError;
use crate::Projection;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use veiloc_descriptor::{DescriptorError, DescriptorKind, Encoding};

use crate::learned::projected::Projected;
use crate::learned::{Layer, built_in};

/// A model: its source, and the meaning of its outputs.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    name: String,
    /// A short text.
    #[serde(default)]
    about: String,
    source: String,
    export: Option<String>,
    licence: String,
    files: Vec<String>,
    pub(crate) input: Input,
    pub(crate) scores: Scores,
    pub(crate) descriptors: Descriptors,
    projection: Option<Projected>,
    /// The content of the file that `projection` names.
    #[serde(skip)]
    pub(crate) read: Option<Projection>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Input {
    pub(crate) channels: usize,
    #[serde(default)]
    pub(crate) normalize: Normalize,
    #[serde(default = "one")]
    pub(crate) multiple: usize,
    pub(crate) longest_side: Option<u32>,
    #[serde(default)]
    pub(crate) margin: usize,
}

#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Normalize {
    #[default]
    None,
    Image,
    #[serde(untagged)]
    By {
        mean: Vec<f32>,
        deviation: Vec<f32>,
    },
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Scores {
    pub(crate) layer: Layer,
    #[serde(default)]
    pub(crate) channels_last: bool,
    pub(crate) form: ScoreForm,
    #[serde(default = "one")]
    pub(crate) stride: usize,
    pub(crate) factor: Option<Layer>,
    pub(crate) threshold: f32,
    pub(crate) radius: usize,
    #[serde(default)]
    pub(crate) rounds: usize,
    #[serde(default)]
    pub(crate) border: usize,
    #[serde(default)]
    pub(crate) refine: Refine,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum ScoreForm {
    Cells,
    Map,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Refine {
    #[default]
    None,
    Mean,
    Parabola,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Descriptors {
    pub(crate) layer: Layer,
    pub(crate) head: Option<String>,
    #[serde(default)]
    pub(crate) channels_last: bool,
    pub(crate) numbers: usize,
    #[serde(default = "one")]
    pub(crate) stride: usize,
    #[serde(default)]
    pub(crate) interpolation: Interpolation,
    #[serde(default)]
    pub(crate) grid: Grid,
    pub(crate) length: Option<u32>,
    pub(crate) receptive_field: f64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Interpolation {
    #[default]
    Linear,
    Cubic,
}

/// Position of the centre of a cell in the image.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Grid {
    /// In the centre of its pixels.
    #[default]
    Centers,
    /// The first and the last cell are at the first and the last pixel.
    Corners,
    /// As in Magic Leap's program: the first cell in the centre of its pixels, the last one almost.
    Superpoint,
    /// As in XFeat's program: half a pixel off the centre, as positions are counted from the first to the last pixel.
    Xfeat,
}

const fn one() -> usize {
    1
}

/// Factor on the root of `numbers`: a byte covers 4 standard deviations of a component in a random direction.
const LENGTH: f64 = 32.0;
/// Name of the descriptor kind before projection; it is not visible outside of this crate.
const PLAIN: &str = "plain";
/// Largest network input, pixels per side.
const MAX_SIDE: u32 = 8192;

/// Parses a description of any type.
pub(crate) fn parsed<T: DeserializeOwned>(
    text: &str,
    file: &Path,
    check: impl Fn(&T) -> Result<(), String>,
) -> Result<T, FeatureError> {
    let refused = |reason: String| FeatureError::Description { path: file.to_owned(), reason };
    let description = toml::from_str(text).map_err(|error| refused(words(&error)))?;
    check(&description).map_err(refused)?;
    Ok(description)
}

fn words(error: &toml::de::Error) -> String {
    error.to_string().trim().to_owned()
}

/// A description merged with the model it is `of`; `None` when it has no `of`.
fn completed(text: &str) -> Result<Option<toml::Table>, String> {
    // Invalid TOML is reported where the description is parsed, with its line.
    let Ok(mut own) = toml::from_str::<toml::Table>(text) else { return Ok(None) };
    let Some(of) = own.remove("of") else { return Ok(None) };
    let name = of.as_str().unwrap_or_default();
    let text = built_in::of(name)
        .ok_or_else(|| format!("it is of {name:?}, but no model of this name is built in"))?;
    let mut whole = match completed(text)? {
        Some(whole) => whole,
        None => toml::from_str(text).map_err(|error| words(&error))?,
    };
    whole.extend(own);
    Ok(Some(whole))
}

impl Description {
    /// Parses a description, and reads its projection file, if any, from the same folder.
    ///
    /// # Errors
    /// [`FeatureError::Description`] naming the file; [`FeatureError::Projection`] and [`FeatureError::Read`].
    pub fn parse(text: &str, file: &Path) -> Result<Self, FeatureError> {
        let refused = |reason: String| FeatureError::Description { path: file.to_owned(), reason };
        let mut description: Self = match completed(text).map_err(refused)? {
            Some(whole) => {
                let whole: Self = whole.try_into().map_err(|error| refused(words(&error)))?;
                whole.check().map_err(refused)?;
                whole
            }
            None => parsed(text, file, Self::check)?,
        };
        if let Some(projection) = &description.projection {
            description.read = Some(projection.read(file, description.plain_kind(), description.kind())?);
        }
        Ok(description)
    }

    /// The name of the model and of its descriptor kind.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// A short text.
    pub fn about(&self) -> &str {
        &self.about
    }

    /// Where to get its file.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The command that makes its file from the source; `None` when it is not needed.
    pub fn export(&self) -> Option<&str> {
        self.export.as_deref()
    }

    /// The licence.
    pub fn licence(&self) -> &str {
        &self.licence
    }

    /// Possible file names, the best first.
    pub fn files(&self) -> &[String] {
        &self.files
    }

    /// The descriptor kind: signed bytes, a unit vector times the length; or numbers of 4 bits after a projection.
    pub fn kind(&self) -> DescriptorKind {
        self.checked_kind().expect("it was checked when it was read")
    }

    /// The descriptor kind before projection.
    pub(crate) fn plain_kind(&self) -> DescriptorKind {
        let name = if self.projection.is_some() { PLAIN } else { &self.name };
        self.plain(name).expect("it was checked when it was read")
    }

    fn checked_kind(&self) -> Result<DescriptorKind, String> {
        let kind = match &self.projection {
            Some(Projected { numbers, length, .. }) => {
                DescriptorKind::new(&self.name, *numbers, Encoding::Coarse, *length)
            }
            None => self.plain(&self.name),
        };
        kind.map_err(|error| error.to_string())
    }

    fn plain(&self, name: &str) -> Result<DescriptorKind, DescriptorError> {
        let numbers = self.descriptors.numbers;
        let length = self.descriptors.length.unwrap_or((LENGTH * (numbers as f64).sqrt()).round() as u32);
        DescriptorKind::new(name, numbers, Encoding::Signed, length)
    }

    fn check(&self) -> Result<(), String> {
        let refused = |what: &str, allowed: &str| Err(format!("{what} must be {allowed}"));
        self.checked_kind()?;
        self.plain(PLAIN).map_err(|error| error.to_string())?;
        let plain = |name: &String| {
            !name.is_empty() && Path::new(name).file_name().is_some_and(|own| own == name.as_str())
        };
        if self.files.is_empty() || !self.files.iter().all(plain) {
            return refused("files", "names of files without folders, one or more");
        }
        if self.descriptors.head.as_ref().is_some_and(|head| !plain(head)) {
            return refused("descriptors.head", "the name of a file without folders");
        }
        if self.projection.as_ref().is_some_and(|projection| !plain(&projection.file)) {
            return refused("projection.file", "the name of a file without folders");
        }
        self.input.check()?;
        let Scores { form, stride, threshold, radius, rounds, border, .. } = &self.scores;
        if !(1..=64).contains(stride) || (*form == ScoreForm::Map && *stride != 1) {
            return refused("scores.stride", "1 to 64, and 1 for a map");
        }
        if !threshold.is_finite() || *radius > 64 || *rounds > 8 || *border > 1024 {
            return refused(
                "scores",
                "of a finite threshold, a radius of at most 64, 8 rounds, a border of 1024",
            );
        }
        let Descriptors { stride, receptive_field, .. } = &self.descriptors;
        if !(1..=64).contains(stride) || !(0.0..=4096.0).contains(receptive_field) {
            return refused("descriptors.stride and .receptive_field", "1 to 64, and 0 to 4096");
        }
        Ok(())
    }
}

impl Input {
    pub(crate) fn check(&self) -> Result<(), String> {
        let refused = |what: &str, allowed: &str| Err(format!("{what} must be {allowed}"));
        let Self { channels, normalize, multiple, longest_side, margin } = self;
        if ![1, 3].contains(channels) {
            return refused("input.channels", "1 or 3");
        }
        if let Normalize::By { mean, deviation } = normalize {
            let usable =
                deviation.iter().all(|d| d.is_finite() && *d > 0.0) && mean.iter().all(|m| m.is_finite());
            if mean.len() != *channels || deviation.len() != *channels || !usable {
                return refused("input.normalize", "one mean and one deviation, above 0, a channel");
            }
        }
        if !(1..=256).contains(multiple) || *margin > 256 {
            return refused("input.multiple and input.margin", "1 to 256, and at most 256");
        }
        if longest_side.is_some_and(|side| !(64..=MAX_SIDE).contains(&side)) {
            return refused("input.longest_side", "64 to 8192");
        }
        Ok(())
    }
}
