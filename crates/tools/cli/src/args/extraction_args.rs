//! What is extracted from a map's images, wherever a map is built.

use veiloc_features::Extractors;
use veiloc_mapping::BuildOptions;

use crate::args::feature_args::ModelFileArgs;
use crate::args::global_args::{VLAD, global_named};
use crate::exit::Failure;

/// What is extracted from an image, and what devices are asked to do.
#[derive(clap::Args)]
pub(crate) struct ExtractionArgs {
    /// What makes the features: compact, which is sift in a quarter of the bytes; sift; the name of a model (`veiloc models`), or a
    /// .toml file that describes one.
    #[arg(long, default_value = Extractors::DEFAULT, value_name = "KIND|FILE")]
    features: String,
    #[command(flatten)]
    file: ModelFileArgs,
    /// What makes the vector of a whole image by which retrieval ranks: vlad, which is summed up from the descriptors that are
    /// sent; the name of a model (`veiloc models`), or a .toml file that describes one. All but vlad are made of the image and tell
    /// more of it: devices refuse such a map unless their owners consent (`seal --image-global`).
    #[arg(long, default_value = VLAD, value_name = "MODEL|FILE")]
    global: String,
    /// Keypoints of an image at most, the strongest.
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Keypoints devices are asked for at most, the strongest; it is published in the profile.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    query_keypoints: u32,
}

impl ExtractionArgs {
    /// The library's options.
    ///
    /// # Errors
    /// A model that is unknown, has no file, or cannot be used.
    pub(crate) fn options(&self) -> Result<BuildOptions, Failure> {
        let mut options = BuildOptions::default();
        options.settings.extraction.max_keypoints = self.max_keypoints;
        options.device.max_keypoints = self.query_keypoints;
        (options.features, options.extractors) = self.file.extractors(&self.features)?;
        options.global = global_named(&self.file.models(), &self.global)?;
        Ok(options)
    }
}
