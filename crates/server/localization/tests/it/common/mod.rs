//! A scene of random points, its map, and its sealed queries.

use rand_chacha::ChaCha20Rng;
use veiloc_features::Features;
use veiloc_map::{MapFile, MapModel};
use veiloc_obfuscation::{Extracted, SealOptions, Sealer};
use veiloc_protocol::{Scheme, SealedQuery};
use veiloc_testing::RandomScene;

/// A scene of 1500 points, and a camera with distortion.
pub(crate) fn random_scene(seed: u64) -> RandomScene {
    RandomScene::new(seed, 1500, 16, "OPENCV,640,480,520,521,322,238,-0.05,0.01,0.0005,-0.0003")
}

/// Opens a model like a file.
pub(crate) fn open(model: &MapModel) -> MapFile {
    MapFile::of_model(model).expect("a map")
}

/// A device that seals for a scene under a scheme.
pub(crate) fn sealer(scene: &RandomScene, scheme: &str) -> Sealer {
    let options = match scheme.parse::<Scheme>().expect("a scheme") {
        Scheme::Points => SealOptions::unprotected_points(),
        other => SealOptions::new(other).expect("it hides positions"),
    };
    Sealer::new(&scene.profile, options).expect("its profile")
}

/// Features of the scene's camera, sealed under a scheme.
pub(crate) fn seal(
    scene: &RandomScene,
    features: Features,
    scheme: &str,
    rng: &mut ChaCha20Rng,
) -> SealedQuery {
    sealer(scene, scheme).seal(Extracted::new(features, scene.camera), rng).expect("sealed")
}
