//! Description of a global descriptor: a short text file (TOML), or one of the built-in ones (`globals/`).
//!
//! ```toml
//! name = "mine"                     # of the model of global descriptors
//! source = "https://…"              # where to get its files
//! export = "python …"               # command that makes the files from the source; optional
//! licence = "MIT"
//! numbers = 512                     # dimension of a vector
//!
//! [[networks]]                      # one, or several that run one after the other
//! files = ["mine.onnx"]             # the first that is found is used
//! inputs = ["image"]                # in the file's order: "image", and "before" for the previous result.
//!                                   # default: "image" for the first, "before" for the others
//! layer = 0                         # its result: a layer's name, or the number of an output
//! channels_last = false             # [1, C, H, W]; true: [1, H, W, C]
//! middle = [80, 60]                 # crop of the result: columns and rows in the middle; optional
//!
//! [networks.image]                  # the "image" input; fixed sides of the file have priority
//! channels = 3                      # 1: gray; 3: gray in all three
//! normalize = "none"                # as for local features (`description.rs`)
//! size = [640, 480]                 # resize to this width and height; optional
//! longest_side = 1024               # larger images are scaled down; optional
//! multiple = 1                      # sides are multiples of it
//! ```

use std::path::Path;

use serde::Deserialize;
use veiloc_descriptor::NamedGlobal;

use crate::FeatureError;
use crate::learned::Layer;
use crate::learned::description::{Input, Normalize, parsed};

/// Maximum number of networks that run one after the other.
const MAX_NETWORKS: usize = 8;

/// A model of global descriptors: the source of its files, and the meaning of its outputs.
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
    pub(super) networks: Vec<NetworkPart>,
}

/// One of the networks.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NetworkPart {
    pub(super) files: Vec<String>,
    #[serde(default)]
    inputs: Vec<InputSource>,
    #[serde(default = "first")]
    pub(super) layer: Layer,
    #[serde(default)]
    pub(super) channels_last: bool,
    pub(super) middle: Option<[usize; 2]>,
    pub(super) image: Option<ImageInput>,
}

/// The source of an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum InputSource {
    Image,
    Before,
}

/// The image input of a network.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ImageInput {
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

impl ImageInput {
    pub(super) fn input(&self) -> Input {
        let Self { channels, normalize, longest_side, multiple, .. } = self.clone();
        Input { channels, normalize, multiple, longest_side, margin: 0 }
    }
}

impl NetworkPart {
    /// The sources of its inputs; `is_first` for the first network.
    pub(super) fn inputs(&self, is_first: bool) -> &[InputSource] {
        match &self.inputs[..] {
            [] if is_first => &[InputSource::Image],
            [] => &[InputSource::Before],
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
        let of = |from: InputSource| inputs.iter().filter(|own| **own == from).count();
        if of(InputSource::Before) > usize::from(!is_first) || of(InputSource::Image) > 1 {
            return refused(
                "networks.inputs",
                "the image, and the result of the previous network, each once",
            );
        }
        if (of(InputSource::Image) == 1) != self.image.is_some() {
            return refused("networks.image", "given for networks with an image input only");
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
    /// Parses a description.
    ///
    /// # Errors
    /// [`FeatureError::Description`] naming the file.
    pub fn parse(text: &str, file: &Path) -> Result<Self, FeatureError> {
        parsed(text, file, Self::check)
    }

    fn check(&self) -> Result<(), String> {
        self.checked_model()?;
        let count = self.networks.len();
        if !(1..=MAX_NETWORKS).contains(&count) {
            return Err(format!("networks must be 1 to {MAX_NETWORKS}"));
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

    /// A short text.
    pub fn about(&self) -> &str {
        &self.about
    }

    /// Where to get its files.
    pub fn source(&self) -> &str {
        &self.source
    }

    /// The command that makes its files from the source; `None` when it is not needed.
    pub fn export(&self) -> Option<&str> {
        self.export.as_deref()
    }

    /// The licence.
    pub fn licence(&self) -> &str {
        &self.licence
    }

    /// For each of its networks, the possible file names, the best first.
    pub fn files(&self) -> impl Iterator<Item = &[String]> {
        self.networks.iter().map(|part| &part.files[..])
    }

    /// The model, as named by maps and profiles.
    pub fn model(&self) -> NamedGlobal {
        self.checked_model().expect("it was checked when it was read")
    }
}
