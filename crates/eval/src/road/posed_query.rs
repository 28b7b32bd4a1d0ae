//! Queries whose poses are known, and what crosses the network for them.

use std::path::{Path, PathBuf};

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_datasets::seed_for;
use veiloc_features::Features;
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::PosedImages;
use veiloc_obfuscation::audit::options_for;
use veiloc_obfuscation::{SealError, seal};
use veiloc_query::{Profile, Scheme};

use crate::error::EvalError;

/// An image whose pose is known.
#[derive(Debug, Clone)]
pub(crate) struct PosedQuery {
    /// Its name.
    pub(crate) name: String,
    /// Its file.
    pub(crate) path: PathBuf,
    /// Its camera.
    pub(crate) camera: Intrinsics,
    /// Where it truly was taken.
    pub(crate) cam_from_world: CameraFromWorld,
}

pub(crate) fn posed_queries(
    posed: &PosedImages,
    images: &Path,
    names: &[String],
) -> Result<Vec<PosedQuery>, EvalError> {
    names
        .iter()
        .map(|name| {
            let image = posed.get(name).ok_or_else(|| {
                EvalError::DataSet(format!(
                    "{name}: in the query list, but it has no pose; take it from the list or add its pose"
                ))
            })?;
            Ok(PosedQuery {
                name: name.clone(),
                path: images.join(name),
                camera: image.camera,
                cam_from_world: image.cam_from_world,
            })
        })
        .collect()
}

/// What crosses the network for a query.
///
/// A device draws from the operating system; here the draw must be repeatable.
pub(crate) fn send(
    features: &Features,
    camera: &Intrinsics,
    profile: &Profile,
    scheme: Scheme,
    name: &str,
    seed: u64,
) -> Result<Vec<u8>, SealError> {
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[name, &scheme.to_string()]));
    let sealed = seal(features.clone(), camera, profile, &options_for(scheme), &mut rng)?;
    Ok(sealed.encode())
}
