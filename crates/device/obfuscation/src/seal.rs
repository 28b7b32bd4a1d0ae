//! Sealing: from the features of one image to the one message that leaves the device.

use rand::CryptoRng;
use rand::seq::SliceRandom;
use veiloc_features::Features;
use veiloc_geometry::{Intrinsics, Pixel};
use veiloc_protocol::{CanonicalCamera, Profile, QueryError, QueryParts, Scheme, SealedQuery, SizeClass};

use crate::decoy;
use crate::positions::{DistinctPositions, dither};
use crate::rule::{FrameRule, RowHistory};
use crate::schemes::dcl::{AnchorAngle, DclLift};
use crate::schemes::{lift, select};
use crate::{SealError, SealOptions};

/// Seals the features of one image: the only function that turns keypoints into lines.
///
/// The scheme is that of `options`, regardless of the profile.
///
/// 1. Each keypoint is undistorted and re-projected into the canonical camera (L6). Those without a ray, outside
///    its window (L11), or within one pixel of an anchor are dropped.
/// 2. The strongest are selected: as many as the largest size class not above their count, the profile's limit and the
///    device's. Below the smallest class, decoys made of the sent rows fill the query up (L5).
/// 3. Position, dithered by up to half a pixel (L2); anchor, line, code (L1, L9). Features with one position share one
///    dither and one line (L7).
/// 4. Rows are shuffled (L3); strength, scale and orientation are not sent (L4).
/// 5. A global descriptor of the image is sent only where the map requests one and the owner consented to it (L14).
///
/// The features are taken by value: an image is sealed once (L7). When the network fails, send the same bytes again.
/// Sealing a second time would draw second lines through the same keypoints, and these lines cross in the keypoints.
///
/// ```compile_fail,E0382
/// # use veiloc_obfuscation::{SealOptions, device_rng, seal};
/// # fn f(features: veiloc_features::Features, camera: veiloc_geometry::Intrinsics, profile: veiloc_protocol::Profile) {
/// let options = SealOptions::default();
/// let first = seal(features, &camera, &profile, &options, &mut device_rng().unwrap());
/// let retry = seal(features, &camera, &profile, &options, &mut device_rng().unwrap()); // the image is used up
/// # }
/// ```
///
/// `rng`: [`crate::device_rng`] on a device; tests pass a seeded generator.
///
/// # Errors
/// [`SealError`]: no usable keypoint, all of one anchor (dcl), a position that is not finite, an invalid camera,
/// descriptors of another kind than the profile's, a profile that requests more than the device allows, or too few
/// keypoints of a kind that has no decoys.
pub fn seal(
    features: Features,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
    rng: &mut impl CryptoRng,
) -> Result<SealedQuery, SealError> {
    seal_frame(&features, camera, profile, options, &FrameRule::default(), rng, |_| ())
        .map(|(query, ())| query)
}

/// A keypoint that is selected for sending.
#[derive(Clone, Copy)]
pub(crate) struct SelectedKeypoint {
    pub(crate) source: usize,
    pixel: Pixel,
    /// The row to repeat, when the keypoint was sent in an earlier frame.
    sent: Option<AnchorAngle>,
}

/// What a sealed query hides; discarded after sealing. Only the evaluation build reads it.
#[cfg_attr(not(feature = "ground-truth"), expect(dead_code, reason = "only the audit reads it"))]
pub(crate) struct HiddenState<'a> {
    /// The real keypoints, `[real]`.
    pub(crate) selected: &'a [SelectedKeypoint],
    /// Positions of all rows, before dither.
    pub(crate) positions: &'a DistinctPositions,
    /// `[positions]`: their anchor and angle, under `dcl`.
    pub(crate) sent: &'a [AnchorAngle],
    /// `[rows]`: index before the shuffle, real keypoints first.
    pub(crate) order: &'a [usize],
}

/// Seals, and calls `look` with the hidden values before they are discarded.
pub(crate) fn seal_frame<T>(
    features: &Features,
    camera: &Intrinsics,
    profile: &Profile,
    options: &SealOptions,
    rule: &FrameRule,
    rng: &mut impl CryptoRng,
    look: impl FnOnce(&HiddenState<'_>) -> T,
) -> Result<(SealedQuery, T), SealError> {
    options.bounded(profile)?;
    check(features, profile)?;
    let (scheme, angle_bits) = (options.scheme(), options.angle_bits());
    let canonical = CanonicalCamera::for_intrinsics(camera)?;
    let window = canonical.window(camera)?;
    let (size, pinhole) = ([canonical.width(), canonical.height()], canonical.pinhole());
    let turn = rule.turn;
    let dcl = match scheme {
        Scheme::Dcl(layout) => Some(DclLift::new(layout, &pinhole, rule, angle_bits)),
        Scheme::Points | Scheme::RandomLines | Scheme::CoordinatePermutation => None,
    };
    let clear =
        |pixel| window.contains(pixel) && dcl.as_ref().is_none_or(|dcl| dcl.is_clear(pixel, rule.band));

    let mut usable = strongest_first(features)
        .into_iter()
        .filter_map(|source| {
            let pixel = reproject(features.keypoints[source].pixel, camera, canonical)?;
            let (is_sendable, sent) = match rule.history(source) {
                RowHistory::New => (clear(pixel), None),
                // It was sent before. Dropping it now would reveal that it came near a border.
                RowHistory::Repeat(sent) => (window.contains(pixel), Some(sent)),
                RowHistory::OtherAnchor => (false, None),
            };
            is_sendable.then_some(SelectedKeypoint { source, pixel, sent })
        })
        .take(options.most(profile))
        .collect::<Vec<_>>();
    if usable.is_empty() {
        return Err(SealError::NoKeypoints { extracted: features.keypoints.len() });
    }
    let rows = SizeClass::for_count(usable.len()).rows();
    usable.truncate(rows);

    let mut positions = DistinctPositions::new(usable.iter().map(|selected| selected.pixel));
    let real_positions = positions.pixels.len();
    let decoys = rows - usable.len();
    let mut descriptors = features.descriptors.select(usable.iter().map(|selected| selected.source));
    decoy::add(&mut positions, &mut descriptors, decoys, size, clear, rng)?;

    // With a session's grid, angles must repeat; dither would prevent that.
    let dithered: Vec<Pixel> = match rule.grid {
        Some(_) => positions.pixels.clone(),
        None => positions.pixels.iter().map(|p| dither(*p, rng)).collect(),
    };
    let (lifted, sent) = match &dcl {
        Some(dcl) => {
            let mut sent = dcl.anchor_angles(&dithered);
            // In reverse order, so that the strongest of several keypoints at one position decides.
            for (selected, position) in usable.iter().zip(&positions.index).rev() {
                sent[*position] = selected.sent.unwrap_or(sent[*position]);
            }
            let mut of = sent[..real_positions].iter().map(|sent| sent.anchor);
            let first = of.next();
            if of.all(|anchor| Some(anchor) == first) {
                return Err(SealError::OneSided { keypoints: usable.len() });
            }
            (dcl.rows(&sent), sent)
        }
        None => (lift(&dithered, &pinhole, scheme, angle_bits, rng)?, Vec::new()),
    };

    let image_global = match options.image_global(profile)? {
        Some(_) => Some(features.global.clone().ok_or(SealError::NoGlobal)?),
        None => None,
    };
    let mut order: Vec<usize> = (0..rows).collect();
    order.shuffle(rng);
    let parts = QueryParts {
        camera: canonical,
        scheme,
        angle_bits,
        rows: select(&lifted, order.iter().map(|&row| positions.index[row])),
        descriptors: descriptors.select(order.iter().copied()),
        image_global,
        hints: options.hints(),
        turn,
    };
    let query = SealedQuery::new(profile, parts)?;
    let seen = look(&HiddenState { selected: &usable, positions: &positions, sent: &sent, order: &order });
    Ok((query, seen))
}

pub(crate) fn check(features: &Features, profile: &Profile) -> Result<(), SealError> {
    let (keypoints, descriptors) = (features.keypoints.len(), features.descriptors.len());
    if keypoints != descriptors {
        return Err(SealError::Unpaired { keypoints, descriptors });
    }
    if let Some(index) = features.keypoints.iter().position(|k| !k.pixel.is_finite()) {
        return Err(SealError::NotFinite { index });
    }
    let (expected, actual) = (profile.descriptor_kind(), features.descriptors.kind());
    if expected != actual {
        return Err(SealError::Query(QueryError::Mismatch {
            what: "descriptor kind",
            expected: format!("{expected:?}"),
            actual: format!("{actual:?}"),
        }));
    }
    Ok(())
}

/// Indices by falling response, equal ones in the given order; a response that is NaN counts as the weakest.
fn strongest_first(features: &Features) -> Vec<usize> {
    let strength = |i: &usize| {
        let response = features.keypoints[*i].response;
        if response.is_nan() { f32::NEG_INFINITY } else { response }
    };
    let mut order: Vec<usize> = (0..features.keypoints.len()).collect();
    order.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    order
}

fn reproject(pixel: Pixel, camera: &Intrinsics, canonical: CanonicalCamera) -> Option<Pixel> {
    Some(canonical.pinhole().project(camera.unproject(pixel)?))
}
