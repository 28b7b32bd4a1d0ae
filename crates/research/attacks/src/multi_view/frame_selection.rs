//! Selection of the frames that carry the most information about the attacked frame: rotation against translation.
//!
//! If a frame was rotated and hardly translated, a projection moves across its line when the keypoint moves along its
//! own line, and does not move when the depth changes; translation without rotation mixes the two. The information of
//! a set of frames about a keypoint's position `t`, with unknown depth, is the Schur complement of the Fisher
//! information of `(t, ln depth)`:
//!
//! ```text
//! I = Σ_f J_f J_fᵀ / σ² + diag(0, 1 / var(ln depth)),    J_f = ∂(distance from the line of f) / ∂(t, ln depth)
//! bits = ½ log₂(1 + var(t) · (I_tt − I_tz² / I_zz))
//! ```
//!
//! summed over the attacked frame's keypoints, at the prior-only position and depth, and multiplied by the share of
//! right matches: a frame with a large rotation has more wrong ones. The share is estimated from the keypoints that
//! the map knows, since the server sees whether the lines of their matches pass through their map points. Frames are
//! chosen greedily: each one adds the most bits to the frames before it.

use crate::{AttackError, KnownSegment, Observation, mutual_matches};
use rayon::prelude::*;
use veiloc_geometry::nalgebra::{Matrix2, Vector2, Vector3};

use crate::multi_view::depth::DepthPrior;
use crate::multi_view::frame::{Frame, FramesOptions};
use crate::multi_view::ray_plane::{Plane, RelativeFrame};

/// One keypoint of the attacked frame: the prior variance of its position, and the information so far.
struct KeypointInformation {
    variance: f64,
    information: Matrix2<f64>,
}

impl KeypointInformation {
    fn bits(&self, added: &Matrix2<f64>) -> f64 {
        let i = self.information + added;
        let about_t = i[(0, 0)] - i[(0, 1)] * i[(0, 1)] / i[(1, 1)];
        0.5 * (1.0 + self.variance * about_t.max(0.0)).log2()
    }
}

/// The `count` most informative frames for an attack on `first`, best first (module docs): indices into `others`.
/// Fewer if there are fewer frames; ties go to the first frame.
///
/// # Errors
/// [`AttackError::Dimensions`] when descriptor lengths differ, [`AttackError::Depths`] when the depth limits are
/// invalid.
pub fn select_frames(
    first: &Frame<'_>,
    others: &[Frame<'_>],
    count: usize,
    options: &FramesOptions,
) -> Result<Vec<usize>, AttackError> {
    let matches: Vec<Vec<Option<usize>>> = others
        .par_iter()
        .map(|o| mutual_matches(first.descriptors, o.descriptors, options.ratio))
        .collect::<Result<_, _>>()?;
    select_frames_matched(
        first,
        others,
        &matches.iter().map(Vec::as_slice).collect::<Vec<_>>(),
        count,
        options,
    )
}

/// The same with given matches, as for [`crate::multi_view::multi_view_attack_matched`]: `[others, N]`.
///
/// # Errors
/// [`AttackError::Depths`] when the depth limits are invalid, [`AttackError::Rows`] when the number of matches is
/// wrong.
pub fn select_frames_matched(
    first: &Frame<'_>,
    others: &[Frame<'_>],
    matches: &[&[Option<usize>]],
    count: usize,
    options: &FramesOptions,
) -> Result<Vec<usize>, AttackError> {
    options.check()?;
    let expected = first.observations.len();
    if let Some(wrong) = matches.iter().find(|m| m.len() != expected) {
        return Err(AttackError::Rows { rows: wrong.len(), expected });
    }
    let depths = DepthPrior::new(options.depths, &options.known, first.camera.width, first.camera.height);
    let segments: Vec<Option<KnownSegment>> =
        first.observations.iter().map(|o| segment(o, first.camera.width, first.camera.height)).collect();
    // [N]: mean and variance of the log depth at the prior-only position.
    let depth_priors: Vec<[f64; 2]> = segments
        .iter()
        .map(|s| s.map_or([0.0, 1.0], |s| depths.median_and_variance(s.at(s.expected()))))
        .collect();
    let mut held: Vec<KeypointInformation> = segments
        .iter()
        .zip(&depth_priors)
        .map(|(s, [_, variance])| KeypointInformation {
            variance: s.map_or(0.0, |s| (s.far - s.near).powi(2) / 12.0),
            information: Matrix2::new(0.0, 0.0, 0.0, 1.0 / variance.max(1e-12)),
        })
        .collect();
    // [others][N], zero without information.
    let frame_information: Vec<(f64, Vec<Matrix2<f64>>)> = others
        .par_iter()
        .zip(matches)
        .map(|(other, matches)| {
            let relative = RelativeFrame::new(first, other);
            let right = right_match_share(first, other, &relative, matches, options);
            let one = |((segment, j), [depth, _]): ((&Option<KnownSegment>, &Option<usize>), &[f64; 2])| {
                let added = segment.zip(*j).map(|(s, j)| {
                    information(first, &s, &relative, &other.observations[j], (-depth).exp())
                        / options.noise_px.powi(2)
                });
                added.unwrap_or_else(Matrix2::zeros)
            };
            (right, segments.iter().zip(*matches).zip(&depth_priors).map(one).collect())
        })
        .collect();
    let mut left: Vec<usize> = (0..others.len()).collect();
    let mut chosen = Vec::new();
    while chosen.len() < count && !left.is_empty() {
        let nothing = Matrix2::zeros();
        let gain = |f: usize| {
            let (right, information) = &frame_information[f];
            let more = held.iter().zip(information).map(|(h, i)| h.bits(i) - h.bits(&nothing));
            right * more.sum::<f64>()
        };
        let gains: Vec<f64> = left.par_iter().map(|f| gain(*f)).collect();
        let best = (0..left.len()).fold(0, |best, k| if gains[k] > gains[best] { k } else { best });
        let f = left.remove(best);
        let (right, information) = &frame_information[f];
        held.iter_mut().zip(information).for_each(|(h, i)| h.information += i * *right);
        chosen.push(f);
    }
    Ok(chosen)
}

/// The segment of a keypoint that is attacked; of two candidates the longer one.
fn segment(observation: &Observation, width: u32, height: u32) -> Option<KnownSegment> {
    if let Observation::Known(_) = observation {
        return None;
    }
    let all = KnownSegment::of(observation, width, height).into_iter().filter(|s| !s.is_empty());
    all.max_by(|a, b| (a.far - a.near).total_cmp(&(b.far - b.near)))
}

/// Pseudo-count of matches of known keypoints, right with the probability in the options.
const PSEUDO_COUNT: f64 = 10.0;
/// Largest distance of a line from its map point, standard deviations.
const MAX_DEVIATION: f64 = 3.0;

/// The share of right matches, estimated from keypoints with known map points.
fn right_match_share(
    first: &Frame<'_>,
    other: &Frame<'_>,
    relative: &RelativeFrame,
    matches: &[Option<usize>],
    options: &FramesOptions,
) -> f64 {
    let (mut right, mut all) = (PSEUDO_COUNT * (1.0 - options.wrong), PSEUDO_COUNT);
    for (own, j) in first.observations.iter().zip(matches) {
        let (Observation::Known(pixel), Some(j)) = (own, j) else { continue };
        let same = options.known.iter().find(|k| k.0.distance(pixel) < 1e-9);
        let Some((_, depth)) = same else { continue };
        let p = first.camera.unproject(*pixel);
        let through = |plane: &Plane<'_>| {
            let residual = plane.along(Vector3::new(p.x, p.y, 1.0)).at(depth.recip());
            residual.spread > 0.0 && residual.distance.abs() <= MAX_DEVIATION * options.noise_px
        };
        all += 1.0;
        right += f64::from(u8::from(relative.planes(&other.observations[*j]).iter().any(through)));
    }
    right / all
}

/// Information of another frame's line at the prior-only position, if the match is right: in units of pixels with
/// unit noise.
fn information(
    first: &Frame<'_>,
    segment: &KnownSegment,
    relative: &RelativeFrame,
    observation: &Observation,
    reciprocal: f64,
) -> Matrix2<f64> {
    let ray = |t: f64| {
        let p = first.camera.unproject(segment.at(t));
        Vector3::new(p.x, p.y, 1.0)
    };
    let t = segment.expected();
    let mut sum = Matrix2::zeros();
    let planes = relative.planes(observation);
    for plane in &planes {
        let at = |t: f64| plane.along(ray(t)).at(reciprocal);
        let slope = (at(t + 0.5).distance - at(t - 0.5).distance) / 1.0;
        let j = Vector2::new(slope, at(t).depth_derivative);
        if j.iter().all(|x| x.is_finite()) {
            sum += j * j.transpose() / planes.len() as f64;
        }
    }
    sum
}
