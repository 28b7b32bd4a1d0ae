//! What makes a vector of a whole image: a short text file (TOML), or one of those built in (`globals/`).
//!
//! ```toml
//! name = "mine"                     # of the model of global descriptors
//! source = "https://…"              # where its files are got
//! export = "python …"               # what makes them of what is got there; left out where nothing need be made
//! licence = "MIT"
//! numbers = 512                     # of a vector
//!
//! [[networks]]                      # one, or several run one after the other
//! files = ["mine.onnx"]             # the first that is found is taken
//! inputs = ["image"]                # in the file's order: "image", and "before" for what the network before gave.
//!                                   # left out: "image" of the first, "before" of the others
//! layer = 0                         # what it gives: a layer's name, or the number of an output
//! channels_last = false             # [1, C, H, W]; true: [1, H, W, C]
//! middle = [80, 60]                 # of what it gives so many columns and rows in the middle; left out: all
//!
//! [networks.image]                  # what "image" is; sides that the file says are kept
//! channels = 3                      # 1: gray; 3: gray in all three
//! normalize = "none"                # as for local features (`description.rs`)
//! size = [640, 480]                 # made so wide and high, whatever its shape; left out: as it is
//! longest_side = 1024               # larger images are made smaller; left out: as large as they come
//! multiple = 1                      # sides are multiples of it
//! ```

use std::path::Path;

use serde::Deserialize;
use veiloc_descriptor::NamedGlobal;

use crate::FeatureError;
use crate::learned::Layer;
use crate::learned::description::{Input, Normalize, parsed};

/// Most networks that are run one after the other.
const MOST_NETWORKS: usize = 8;

/// A model of global descriptors: where its files are got, and how its numbers are meant.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GlobalDescription {
    name: String,
    #[serde(default)]
    about: String,
    source: String,
    export: Option<String>,
    licence: String,
    numbers: usize,
    pub(super) networks: Vec<Part>,
}

/// One of the networks.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Part {
    pub(super) files: Vec<String>,
    #[serde(default)]
    inputs: Vec<From>,
    #[serde(default = "first")]
    pub(super) layer: Layer,
    #[serde(default)]
    pub(super) channels_last: bool,
    pub(super) middle: Option<[usize; 2]>,
    pub(super) image: Option<Seen>,
}

/// What an input is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum From {
    Image,
    Before,
}

/// An image as a network wants it.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Seen {
    channels: usize,
    #[serde(default)]
    normalize: Normalize,
    pub(super) size: Option<[u32; 2]>,
    longest_side: Option<u32>,
    #[serde(default = "one")]
    multiple: usize,
}

const fn one() -> usize {
    1
}

const fn first() -> Layer {
    Layer::Output(0)
}

impl Seen {
    pub(super) fn input(&self) -> Input {
        let Self { channels, normalize, longest_side, multiple, .. } = self.clone();
        Input { channels, normalize, multiple, longest_side, margin: 0 }
    }
}

impl Part {
    /// What its inputs are given; `is_first` of the networks.
    pub(super) fn inputs(&self, is_first: bool) -> &[From] {
        match &self.inputs[..] {
            [] if is_first => &[From::Image],
            [] => &[From::Before],
            own => own,
        }
    }

    fn check(&self, is_first: bool) -> Result<(), String> {
        let refused = |what: &str, allowed: &str| Err(format!("{what} must be {allowed}"));
        let plain = |name: &String| {
            !name.is_empty() && Path::new(name).file_name().is_some_and(|own| own == name.as_str())
        };
        if self.files.is_empty() || !self.files.iter().all(plain) {
            return refused("networks.files", "names of files without folders, one or more");
        }
        let inputs = self.inputs(is_first);
        let of = |from: From| inputs.iter().filter(|own| **own == from).count();
        if of(From::Before) > usize::from(!is_first) || of(From::Image) > 1 {
            return refused("networks.inputs", "the image, and what the network before gave, each once");
        }
        if (of(From::Image) == 1) != self.image.is_some() {
            return refused("networks.image", "there for networks that are given the image, and no others");
        }
        if self.middle.is_some_and(|sides| sides.iter().any(|side| !(1..=8192).contains(side))) {
            return refused("networks.middle", "1 to 8192");
        }
        let Some(seen) = &self.image else { return Ok(()) };
        seen.input().check()?;
        if seen.size.is_some_and(|size| size.iter().any(|side| !(16..=4096).contains(side))) {
            return refused("networks.image.size", "16 to 4096");
        }
        Ok(())
    }
}

impl GlobalDescription {
    /// Reads a description.
    ///
    /// # Errors
    /// [`FeatureError::Description`] naming the file, or what stands for it.
    pub fn parse(text: &str, file: &Path) -> Result<Self, FeatureError> {
        parsed(text, file, Self::check)
    }

    fn check(&self) -> Result<(), String> {
        self.checked_model()?;
        let count = self.networks.len();
        if !(1..=MOST_NETWORKS).contains(&count) {
            return Err(format!("networks must be 1 to {MOST_NETWORKS}"));
        }
        let mut parts = self.networks.iter().enumerate();
        parts.try_for_each(|(at, part)| part.check(at == 0))
    }

    fn checked_model(&self) -> Result<NamedGlobal, String> {
        NamedGlobal::new(&self.name, self.numbers).map_err(|error| error.to_string())
    }

    /// The name of the model.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// In a few words.
    pub fn about(&self) -> &str {
        &self.about
    }

    /// Where its files are got.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The command that makes its files of what is got there; `None` where nothing need be made.
    pub fn export(&self) -> Option<&str> {
        self.export.as_deref()
    }

    /// On what terms.
    pub fn licence(&self) -> &str {
        &self.licence
    }

    /// For each of its networks, names of files that would do, the best first.
    pub fn files(&self) -> impl Iterator<Item = &[String]> {
        self.networks.iter().map(|part| &part.files[..])
    }

    /// The model that maps and profiles name.
    pub fn model(&self) -> NamedGlobal {
        self.checked_model().expect("it was checked when it was read")
    }
}
