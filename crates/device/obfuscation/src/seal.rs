//! Sealing: from checked features to lines; the only code that sees both.

use rand::CryptoRng;
use rand::seq::SliceRandom;
use veiloc_features::Features;
use veiloc_geometry::{Intrinsics, Pixel};
use veiloc_protocol::{CanonicalCamera, QueryError, QueryParts, Scheme, SealedQuery, SizeClass};

use crate::decoy;
use crate::pack::{PlaceRows, RowContent};
use crate::positions::{DistinctPositions, dither};
use crate::rule::{FrameRule, RowHistory};
use crate::schemes::dcl::{AnchorAngle, DclLift};
use crate::schemes::{lift, select};
use crate::{Extracted, SealError, Sealer};

/// A keypoint that is selected for sending.
#[derive(Clone, Copy)]
pub(crate) struct SelectedKeypoint {
    pub(crate) source: usize,
    pub(crate) pixel: Pixel,
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

impl Sealer {
    /// Seals checked features, and calls `look` with the hidden values before they are discarded.
    pub(crate) fn seal_frame<T>(
        &self,
        extracted: &Extracted,
        rule: &FrameRule,
        rng: &mut impl CryptoRng,
        look: impl FnOnce(&HiddenState<'_>) -> T,
    ) -> Result<(SealedQuery, T), SealError> {
        let (features, camera) = (&extracted.features, &extracted.camera.intrinsics);
        let (profile, options) = (self.profile(), self.options());
        let (scheme, angle_bits) = (options.scheme(), options.angle_bits());
        let canonical = rule.camera.map_or_else(|| CanonicalCamera::for_intrinsics(camera), Ok)?;
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
        let known = match self.place() {
            Some(place) => Some(PlaceRows::select(place, options.pack_use(), features, &mut usable)?),
            None => None,
        };
        let rows = known.as_ref().map_or_else(|| SizeClass::for_count(usable.len()), PlaceRows::size).rows();
        usable.truncate(rows);

        let mut positions = DistinctPositions::new(usable.iter().map(|selected| selected.pixel));
        let real_positions = positions.pixels.len();
        let decoys = rows - usable.len();
        let content = if let Some(known) = known {
            decoy::scatter(&mut positions, decoys, size, clear, rng);
            known.content(features, &usable, decoys, rng)
        } else {
            let mut descriptors = features.descriptors.select(usable.iter().map(|s| s.source));
            decoy::add(&mut positions, &mut descriptors, decoys, size, clear, rng)?;
            RowContent::Descriptors(descriptors)
        };

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

        let image_global = match self.image_global() {
            Some(_) if content.is_described() => Some(features.global.clone().ok_or(SealError::NoGlobal)?),
            _ => None,
        };
        let mut order: Vec<usize> = (0..rows).collect();
        order.shuffle(rng);
        let parts = QueryParts {
            camera: canonical,
            scheme,
            angle_bits,
            rows: select(&lifted, order.iter().map(|&row| positions.index[row])),
            content: content.in_order(&order, image_global)?,
            hints: extracted.hints(options),
            turn,
        };
        let query = SealedQuery::new(profile, parts)?;
        let seen =
            look(&HiddenState { selected: &usable, positions: &positions, sent: &sent, order: &order });
        Ok((query, seen))
    }

    /// Whether features are well-formed, and of the profile's descriptor kind.
    pub(crate) fn check(&self, features: &Features) -> Result<(), SealError> {
        let (keypoints, descriptors) = (features.keypoints.len(), features.descriptors.len());
        if keypoints != descriptors {
            return Err(SealError::Unpaired { keypoints, descriptors });
        }
        if let Some(index) = features.keypoints.iter().position(|k| !k.pixel.is_finite()) {
            return Err(SealError::NotFinite { index });
        }
        let (expected, actual) = (self.profile().descriptor_kind(), features.descriptors.kind());
        if expected != actual {
            return Err(SealError::Query(QueryError::Mismatch {
                what: "descriptor kind",
                expected: format!("{expected:?}"),
                actual: format!("{actual:?}"),
            }));
        }
        Ok(())
    }

    /// Whether the query can determine a pose, where the device seals no other.
    pub(crate) fn check_sides(&self, query: &SealedQuery) -> Result<(), SealError> {
        if self.options().is_only_balanced() {
            query.check_sides()?;
        }
        Ok(())
    }
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
