//! Options of feature extraction that all map-building commands share.

use veiloc_features::Extractors;
use veiloc_mapping::BuildOptions;

use crate::args::feature_args::ModelFileArgs;
use crate::args::global_args::{VLAD, global_extractor};
use crate::output::exit::Failure;

/// Which features the map holds, and which features devices send.
#[derive(clap::Args)]
pub(crate) struct ExtractionArgs {
    /// Local features: compact (SIFT with a quarter of the bytes), sift, the name of a model (`veiloc models`), or a
    /// .toml file that describes a model.
    #[arg(long, default_value = Extractors::DEFAULT, value_name = "KIND|FILE")]
    features: String,
    #[command(flatten)]
    file: ModelFileArgs,
    /// Global descriptor for retrieval: vlad (computed from the local descriptors that a query sends anyway), the name
    /// of a model (`veiloc models`), or a .toml file that describes a model. Every global descriptor except vlad is
    /// computed from the whole image and reveals more of it: a device refuses such a map unless its owner consents
    /// (`seal --image-global`).
    #[arg(long, default_value = VLAD, value_name = "MODEL|FILE")]
    global: String,
    /// Maximum number of keypoints per map image; the strongest are used.
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Maximum number of keypoints that the profile requests from devices; devices send the strongest.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    query_keypoints: u32,
}

impl ExtractionArgs {
    /// Returns the library's options.
    ///
    /// # Errors
    /// The model is unknown, has no file, or cannot be used.
    pub(crate) fn options(&self) -> Result<BuildOptions, Failure> {
        let mut options = BuildOptions::default();
        options.settings.extraction.max_keypoints = self.max_keypoints;
        options.device.max_keypoints = self.query_keypoints;
        (options.features, options.extractors) = self.file.extractors(&self.features)?;
        options.global = global_extractor(&self.file.models(), &self.global)?;
        Ok(options)
    }
}
