//! What is extracted from a map's images, wherever a map is built.

use veiloc_mapping::BuildOptions;

/// What is extracted from an image, and what devices are asked to do.
#[derive(clap::Args)]
pub struct ExtractionArgs {
    /// Kind of features.
    #[arg(long, default_value = "sift", value_name = "KIND")]
    features: String,
    /// Keypoints of an image at most, the strongest.
    #[arg(long, default_value_t = 4096, value_name = "N", value_parser = clap::value_parser!(u32).range(64..=65536))]
    max_keypoints: u32,
    /// Keypoints devices are asked for at most, the strongest; it is published in the profile.
    #[arg(long, default_value_t = 2048, value_name = "N", value_parser = clap::value_parser!(u32).range(256..=4096))]
    query_keypoints: u32,
}

impl ExtractionArgs {
    /// The library's options.
    pub fn options(&self) -> BuildOptions {
        let mut options = BuildOptions::default();
        options.settings.extraction.max_keypoints = self.max_keypoints;
        options.device.max_keypoints = self.query_keypoints;
        options.features.clone_from(&self.features);
        options
    }
}
