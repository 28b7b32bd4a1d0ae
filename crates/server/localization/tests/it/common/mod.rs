//! A scene of random points, its map, and seal options.

use veiloc_map::{MapFile, MapModel};
use veiloc_obfuscation::SealOptions;
use veiloc_protocol::Scheme;
use veiloc_testing::RandomScene;

/// A scene of 1500 points, and a camera with distortion.
pub(crate) fn random_scene(seed: u64) -> RandomScene {
    RandomScene::new(seed, 1500, 16, "OPENCV,640,480,520,521,322,238,-0.05,0.01,0.0005,-0.0003")
}

/// Opens a model like a file.
pub(crate) fn open(model: &MapModel) -> MapFile {
    MapFile::of_model(model).expect("a map")
}

/// Seal options for a scheme.
pub(crate) fn options(scheme: &str) -> SealOptions {
    match scheme.parse::<Scheme>().expect("a scheme") {
        Scheme::Points => SealOptions::unprotected_points(),
        other => SealOptions::new(other).expect("it hides positions"),
    }
}
