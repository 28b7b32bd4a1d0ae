//! What a device sends, and what only an evaluation keeps of it.

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::{Extractors, Features, SharedGlobal};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::audit::{SealTruth, seal_with_truth};
use veiloc_obfuscation::{SealError, SealOptions};
use veiloc_protocol::Profile;

/// The same for a device that has what the map is built with, and whose owner consents to a global descriptor of the image
/// where the map's are such.
pub(crate) fn equipped(
    options: SealOptions,
    extractors: &Extractors,
    global: Option<&SharedGlobal>,
) -> SealOptions {
    let options = options.with_extractors(extractors.sealing());
    match global {
        Some(global) => options.with_image_global(global.clone()),
        None => options,
    }
}

/// A query on its way.
pub(crate) struct Sent {
    /// What crosses the network.
    pub(crate) bytes: Vec<u8>,
    /// What the sealed query hides, row by row.
    pub(crate) truth: SealTruth,
}

/// Seals a query.
///
/// A device draws from the operating system; here the draw must be repeatable, so it is made of the seed, the query's
/// name and the scheme.
pub(crate) fn send(
    features: &Features,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
    name: &str,
    seed: u64,
) -> Result<Sent, SealError> {
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[name, &options.scheme().to_string()]));
    let (sealed, truth) = seal_with_truth(features.clone(), camera, profile, options, &mut rng)?;
    Ok(Sent { bytes: sealed.encode(), truth })
}
