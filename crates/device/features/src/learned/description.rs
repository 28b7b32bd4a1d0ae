//! What a network file is: a short text file (TOML) beside it, or one of those built in (`models/`).
//!
//! ```toml
//! name = "mine"                     # of the kind of descriptors, too
//! source = "https://…"              # where its file is got
//! export = "python …"               # what makes its file of what is got there; left out where nothing need be made
//! licence = "MIT"
//! files = ["mine.onnx"]             # the first that is found is taken
//!
//! [input]
//! channels = 1                      # 1: gray; 3: gray in all three
//! normalize = "none"                # samples from 0 to 1; "image": of mean 0 and variance 1 in each image;
//!                                   # { mean = [0.5], deviation = [0.25] }
//! multiple = 8                      # sides are multiples of it; left out where the file says the size
//! longest_side = 1024               # larger images are made smaller; left out: as large as they come
//! margin = 32                       # pixels of mirror image around the image
//!
//! [scores]
//! layer = "scores"                  # a layer's name, or the number of an output
//! channels_last = false             # [1, C, H, W]; true: [1, H, W, C]
//! form = "cells"                    # "cells": stride² positions and "none", before the softmax; "map": one score a pixel
//! stride = 8                        # pixels a cell is wide and high
//! factor = 2                        # a layer by which scores are multiplied; may be left out
//! threshold = 0.005                 # least score
//! radius = 3                        # pixels around a keypoint where there is no other
//! rounds = 2                        # rounds of looking for those that a suppressed one suppressed
//! border = 4                        # pixels along the image's border without keypoints
//! refine = "none"                   # "mean": of the positions around, weighed; "parabola": through the neighbours' scores
//!
//! [descriptors]
//! layer = "descriptors"
//! channels_last = false
//! numbers = 256                     # of a descriptor
//! stride = 8
//! interpolation = "linear"          # or "cubic"
//! grid = "centers"                  # where cells lie: "centers", "corners", "superpoint", "xfeat"
//! length = 512                      # of a vector in bytes' units: 32 times the root of `numbers`, unless measured
//! sight = 32                        # pixels around a keypoint that its descriptor looks at
//!
//! [projection]                      # of the descriptors to numbers of 4 bits; may be left out
//! file = "mine.bin"                 # beside this file, as scripts/train_compact.py writes it, or built in (`projections/`)
//! numbers = 48                      # of a descriptor then
//! shift = 16                        # as the script has it
//! length = 299                      # of a vector then, as the script prints it
//! ```
//!
//! `of = "alike-t"` at the top stands for all that another model says and this file does not: a table of this file takes the place
//! of that model's whole table.

use std::path::Path;

use crate::FeatureError;
use crate::Projection;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use veiloc_descriptor::{DescriptorError, DescriptorKind, Encoding};

use crate::learned::projected::Projected;
use crate::learned::{Layer, built_in};

/// A model: where its file is got, and how its numbers are meant.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    name: String,
    /// In a few words.
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
    /// What the file that `projection` names holds.
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
    pub(crate) form: Form,
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
pub(crate) enum Form {
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
    pub(crate) sight: f64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Interpolation {
    #[default]
    Linear,
    Cubic,
}

/// Where the middle of a cell lies in the image.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Grid {
    /// In the middle of the pixels it is of.
    #[default]
    Centers,
    /// The first and the last cell in the first and the last pixel.
    Corners,
    /// As Magic Leap's program samples: the first cell in the middle of its pixels, the last nearly so.
    Superpoint,
    /// As XFeat's program samples: half a pixel off the middle, as pixels are counted from the first to the last.
    Xfeat,
}

const fn one() -> usize {
    1
}

/// Part of the root of `numbers`: with 4 standard deviations of a number in a random direction a byte is full.
const LENGTH: f64 = 32.0;
/// Names the kind of descriptors that are to be projected; none of it leaves this room.
const PLAIN: &str = "plain";
/// Largest network input, pixels a side.
const MOST_SIDE: u32 = 8192;

/// A description of any kind from its text.
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

/// A description with all that the model it is `of` says and it does not; `None` when it is of none.
fn completed(text: &str) -> Result<Option<toml::Table>, String> {
    // What is no table is refused where the description is read, with its line.
    let Ok(mut own) = toml::from_str::<toml::Table>(text) else { return Ok(None) };
    let Some(of) = own.remove("of") else { return Ok(None) };
    let name = of.as_str().unwrap_or_default();
    let text = built_in::of(name)
        .ok_or_else(|| format!("it is of {name:?}, and no model of this name is built in"))?;
    let mut whole = match completed(text)? {
        Some(whole) => whole,
        None => toml::from_str(text).map_err(|error| words(&error))?,
    };
    whole.extend(own);
    Ok(Some(whole))
}

impl Description {
    /// Reads a description, and the file of its projection from beside it, where it has one of its own.
    ///
    /// # Errors
    /// [`FeatureError::Description`] naming the file, or what stands for it; [`FeatureError::Projection`] and [`FeatureError::Read`].
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

    /// The name of the model, and of its kind of descriptors.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// In a few words.
    pub fn about(&self) -> &str {
        &self.about
    }

    /// Where its file is got.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The command that makes its file of what is got there; `None` where nothing need be made.
    pub fn export(&self) -> Option<&str> {
        self.export.as_deref()
    }

    /// On what terms.
    pub fn licence(&self) -> &str {
        &self.licence
    }

    /// Names of files that would do, the best first.
    pub fn files(&self) -> &[String] {
        &self.files
    }

    /// The kind of its descriptors: signed bytes, a unit vector times the length; or numbers of 4 bits after a projection.
    pub fn kind(&self) -> DescriptorKind {
        self.checked_kind().expect("it was checked when it was read")
    }

    /// The kind of its descriptors before any projection.
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
        if self.projection.as_ref().is_some_and(|projection| !plain(&projection.file)) {
            return refused("projection.file", "the name of a file without folders");
        }
        self.input.check()?;
        let Scores { form, stride, threshold, radius, rounds, border, .. } = &self.scores;
        if !(1..=64).contains(stride) || (*form == Form::Map && *stride != 1) {
            return refused("scores.stride", "1 to 64, and 1 for a map");
        }
        if !threshold.is_finite() || *radius > 64 || *rounds > 8 || *border > 1024 {
            return refused(
                "scores",
                "of a finite threshold, a radius of at most 64, 8 rounds, a border of 1024",
            );
        }
        let Descriptors { stride, sight, .. } = &self.descriptors;
        if !(1..=64).contains(stride) || !(0.0..=4096.0).contains(sight) {
            return refused("descriptors.stride and .sight", "1 to 64, and 0 to 4096");
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
        if longest_side.is_some_and(|side| !(64..=MOST_SIDE).contains(&side)) {
            return refused("input.longest_side", "64 to 8192");
        }
        Ok(())
    }
}
