//! The server side: posed images to a map, and a sealed query with a map to a pose.
//!
//! [`build`], [`add`] and [`remove`] create and change a map, and [`finish`] tests it, as in `veiloc map build`: this
//! calibrates the covariances of its answers, and a map in which nothing can be localized is refused. [`write_map`] and
//! [`MapFile`] store it, [`localize`] uses it. The HTTP service is the crate `veiloc-service`. Building a map extracts features from map images;
//! localization depends on no type that could hold a keypoint of a query.

pub use veiloc_features::{Extractor, Extractors, Progress};
pub use veiloc_localization::{Localization, LocalizeError, LocalizeOptions, localize};
pub use veiloc_map::colmap::{read_model, read_posed};
pub use veiloc_map::{
    GravityDirection, GravityDirectionError, MapError, MapFile, MapModel, PosedImage, PosedImages,
    write as write_map,
};
pub use veiloc_mapping::{
    BuildOptions, BuildReport, FinishOptions, Input, MappingError, OnBadImage, VocabularyUpdate, add, build,
    finish, import, remove,
};
pub use veiloc_protocol::{Profile, SealedQuery};
