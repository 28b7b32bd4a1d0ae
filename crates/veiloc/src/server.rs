//! The server's road: posed images to a map, and a sealed query with a map to a pose.
//!
//! A map can be tested before it is kept: `self_test` gives what belongs into
//! [`MapModel::self_test`], as `veiloc map build` does it; without it answers have the covariances of other maps.
//!
//! [`build`], [`add`], [`remove`] make and change a map, [`write_map`] and [`MapFile`] keep it, [`localize`] asks it. The
//! HTTP service itself is the crate `veiloc-service`. Building a map extracts features, of map images; localizing depends on
//! nothing that could name a keypoint of a query.

pub use veiloc_features::{Extractor, Extractors, Progress};
pub use veiloc_localization::{GravityUse, Localization, LocalizeError, LocalizeOptions, localize};
pub use veiloc_map::colmap::{read_model, read_posed};
pub use veiloc_map::{
    Down, DownError, MapError, MapFile, MapModel, PosedImage, PosedImages, write as write_map,
};
pub use veiloc_mapping::calibration::{SelfTest, SelfTestOptions, self_test};
pub use veiloc_mapping::{
    BuildOptions, BuildReport, Input, MappingError, OnBadImage, Words, add, build, import, remove,
};
pub use veiloc_protocol::{Profile, SealedQuery};
