//! Makes a sealed query from the features that a map stores of an image.

use std::collections::BTreeMap;

use rand_chacha::ChaCha20Rng;
use veiloc_descriptor::{GlobalDescriptor, GlobalModel, NamedGlobal};
use veiloc_features::{FeatureError, Features, GlobalExtractor, Image, Keypoint, SharedGlobal};
use veiloc_geometry::Pixel;
use veiloc_localization::MatchResult;
use veiloc_map::{MapImage, MapModel};
use veiloc_obfuscation::{Extracted, SealError, SealOptions, Sealer};
use veiloc_protocol::{Profile, Scheme, SealedQuery};

/// Returns a device with default decisions under a scheme, with consent to the map's global descriptor.
///
/// # Errors
/// [`SealError::VocabularyTooLarge`].
pub(crate) fn sealer_for(scheme: Scheme, profile: &Profile) -> Result<Sealer, SealError> {
    let options = SealOptions::new(scheme).unwrap_or_else(|_| SealOptions::unprotected_points());
    let options = match profile.global_model() {
        GlobalModel::Vlad(_) => options,
        GlobalModel::Named(requested) => options.with_image_global(SharedGlobal::new(Stored(*requested))),
    };
    Sealer::new(profile, options)
}

/// The map's stored global descriptors of its own images, which are not computed again.
struct Stored(NamedGlobal);

impl GlobalExtractor for Stored {
    fn model(&self) -> NamedGlobal {
        self.0
    }

    fn describe(&self, _: &Image) -> Result<GlobalDescriptor, FeatureError> {
        let reason = "the map's own are used".to_owned();
        Err(FeatureError::Extractor { name: self.0.name().to_owned(), reason })
    }
}

/// Returns the stored features of a map image with their camera, scaled down as on a device if the image is larger than
/// the profile's limit.
pub(crate) fn stored_features(model: &MapModel, image: &MapImage, sealer: &Sealer) -> Extracted {
    let camera = model.cameras[image.camera];
    let max_side = sealer.limits().max_image_side;
    let longer = camera.width.max(camera.height);
    let shrunk = |side: u32| match f64::from(side) * f64::from(max_side) / f64::from(longer) {
        _ if longer <= max_side => side,
        smaller => (smaller.round() as u32).max(1),
    };
    let seen = camera.resized(shrunk(camera.width), shrunk(camera.height));
    let scale = |to: u32, from: u32| f64::from(to) / f64::from(from);
    let (along, down) = (scale(seen.width, camera.width), scale(seen.height, camera.height));
    let keypoint = |(rank, [u, v]): (usize, &[f32; 2])| Keypoint {
        pixel: Pixel::new(f64::from(*u) * along, f64::from(*v) * down),
        scale: 1.0,
        orientation: 0.0,
        // A map stores keypoints by descending response, but not the response itself.
        response: 1.0 / (1.0 + rank as f32),
    };
    let keypoints = image.keypoints.iter().enumerate().map(keypoint).collect();
    let global = model.profile.vocabulary().is_none().then(|| image.global.clone());
    Extracted::new(Features { keypoints, descriptors: image.descriptors.clone(), global }, seen)
}

/// Seals the features of an image with a seeded generator; a device uses the operating system's, but a self-test must
/// be repeatable.
pub(crate) fn sealed(
    sealer: &Sealer,
    extracted: Extracted,
    rng: &mut ChaCha20Rng,
) -> Result<SealedQuery, SealError> {
    let query = sealer.seal(extracted, rng)?;
    // Encoded and decoded, so that the test includes the wire format's precision.
    Ok(SealedQuery::decode(&query.encode())?)
}

/// Transfers the matches of a query to another query of the same image: its rows have the same descriptors in another
/// order, and matching takes most of the time. `None` if the descriptors differ, which is always the case for decoys.
pub(crate) fn transfer_matches(
    matched: &MatchResult,
    from: &SealedQuery,
    to: &SealedQuery,
) -> Option<MatchResult> {
    let (own, other) = (from.descriptors()?, to.descriptors()?);
    let mut rows: BTreeMap<&[u8], Option<usize>> = BTreeMap::new();
    for row in 0..to.len() {
        // Duplicate descriptors are ambiguous.
        rows.entry(other.row(row)).and_modify(|r| *r = None).or_insert(Some(row));
    }
    let row_of = |row: usize| rows.get(own.row(row)).copied().flatten();
    let known = (0..from.len()).filter(|row| row_of(*row).is_some()).count();
    if to.len() != from.len() || 100 * known < 98 * from.len() {
        return None;
    }
    let mut moved = matched.clone();
    moved.matches.retain_mut(|m| row_of(m.query).map(|row| m.query = row).is_some());
    moved.matches.sort_by_key(|m| (m.query, m.point));
    Some(moved)
}
