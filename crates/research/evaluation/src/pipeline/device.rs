//! The device: sealing of a query, with its ground truth for the evaluation.

use std::path::Path;

use rand::SeedableRng;
use rand_chacha::ChaCha20Rng;
use veiloc_datasets::problem_files::seed_for;
use veiloc_features::{Image, load_mask};
use veiloc_obfuscation::audit::SealTruth;
use veiloc_obfuscation::{Extracted, SealError, Sealer};

use crate::error::EvalError;

/// An image, without what its mask hides.
///
/// # Errors
/// [`EvalError`] when the image or its mask cannot be used.
pub(crate) fn image_of(path: &Path, mask: Option<&Path>) -> Result<Image, EvalError> {
    let image = Image::open(path)?;
    Ok(match mask {
        Some(mask) => image.without(&load_mask(mask)?)?,
        None => image,
    })
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
    sealer: &Sealer,
    extracted: Extracted,
    name: &str,
    seed: u64,
) -> Result<SealedBytes, SealError> {
    let scheme = sealer.options().scheme().to_string();
    let mut rng = ChaCha20Rng::seed_from_u64(seed_for(seed, &[name, &scheme]));
    let (sealed, truth) = sealer.seal_with_truth(extracted, &mut rng)?;
    Ok(SealedBytes { bytes: sealed.encode(), truth })
}
