//! The device: sealing of a query, with its ground truth for the evaluation.

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::{Extractors, Features, SharedGlobal};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::audit::{SealTruth, seal_with_truth};
use veiloc_obfuscation::{SealError, SealOptions};
use veiloc_protocol::Profile;

/// Adds the extractors of the map, and the extractor of global image descriptors if the map uses them (the owner's
/// consent is implied).
pub(crate) fn with_extractors(
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

/// A sealed query.
pub(crate) struct SealedBytes {
    /// The sent bytes.
    pub(crate) bytes: Vec<u8>,
    /// The hidden positions, row by row.
    pub(crate) truth: SealTruth,
}

/// Seals a query.
///
/// A device uses random numbers of the operating system; here they must be reproducible, so they are seeded with the
/// seed, the query's name and the scheme.
pub(crate) fn seal_query(
    features: &Features,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
    name: &str,
    seed: u64,
) -> Result<SealedBytes, SealError> {
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[name, &options.scheme().to_string()]));
    let (sealed, truth) = seal_with_truth(features.clone(), camera, profile, options, &mut rng)?;
    Ok(SealedBytes { bytes: sealed.encode(), truth })
}
