//! Position transfer by a server that knows the pose: descriptors are compared only near the half-line.
//!
//! [`crate::transfer()`] searches a whole map image for the most similar descriptor. A server that has localized the
//! query knows the positions of its inliers in the query *and* in its map images, and therefore the flow from a map
//! image to the query. After warping by this flow, only a few keypoints of the map image are near a given half-line,
//! and the most similar of a few is right far more often than the most similar of thousands.
//!
//! For each hidden keypoint the candidates are the keypoints of several warped map images within a few standard
//! deviations of its line. With `s` the logarithm of the descriptors' distance over the least distance among
//! keypoints far from the line, distance `e` from the line and standard deviation `σ`, the weight of a candidate is
//!
//! ```text
//! w = p(s | same point) / p(s | other point) · exp(−e² / 2σ²)
//! ```
//!
//! where both densities are normal and estimated from the query's own inliers, for which the server knows the right
//! candidate. All candidates may be wrong, so the hypothesis "no candidate" has a weight too. Weights of candidates
//! from several images with nearly the same position are added; the answer is the position with the largest weight,
//! and it is **accepted** when it outweighs all others together.

use rayon::prelude::*;
use veiloc_geometry::Pixel;

use super::known;
use super::warp::{Candidate, DescriptorLikelihood, MapView, MatchedMapImage};
use crate::error::AttackError;
use crate::features::{DecodedDescriptors, KnownImage};
use crate::observation::Observation;
use crate::prior::KnownSegment;

/// Options of the guided transfer.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GuidedOptions {
    /// Number of map images that are used, those with the most mutual matches.
    pub images: usize,
    /// Largest distance of a candidate from the line, standard deviations.
    pub gate: f64,
    /// Repeatability: probability that a keypoint is re-detected in a map image that shows the same point.
    pub repeatability: f64,
    /// Candidates within this distance support the same position, pixels.
    pub together_px: f64,
}

impl Default for GuidedOptions {
    fn default() -> Self {
        Self { images: 5, gate: 3.0, repeatability: 0.3, together_px: 6.0 }
    }
}

/// Estimate of one keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidedEstimate {
    /// Its position, pixels; `None` without candidates.
    pub pixel: Option<Pixel>,
    /// Probability of the position, 0 to 1; 1 for a known position.
    pub probability: f64,
}

impl GuidedEstimate {
    /// Whether the answer outweighs all others together.
    pub fn is_accepted(&self) -> bool {
        self.probability > ACCEPTED
    }
}

/// Positions of hidden keypoints from map images, warped into the query by the flow of its known keypoints: `[N]`.
///
/// `query`: one descriptor per observation. `size`: width and height of the query image, pixels. Map images with too
/// few matches of known keypoints are ignored; if none remains, there are no answers.
///
/// # Errors
/// [`AttackError::Dimensions`] when the descriptors of a map image have another dimension,
/// [`AttackError::FrameDescriptors`] when the numbers of descriptors and observations differ.
pub fn guided_transfer(
    query: &DecodedDescriptors,
    observations: &[Observation],
    map: &[KnownImage],
    size: (u32, u32),
    options: &GuidedOptions,
) -> Result<Vec<GuidedEstimate>, AttackError> {
    if query.len() != observations.len() {
        let (observations, descriptors) = (observations.len(), query.len());
        return Err(AttackError::FrameDescriptors { frame: 0, observations, descriptors });
    }
    let expected = query.columns().nrows();
    if let Some(bad) = map.iter().find(|p| p.descriptors().columns().nrows() != expected) {
        return Err(AttackError::Dimensions { expected, found: bad.descriptors().columns().nrows() });
    }
    let known = known(observations);
    let mut matched: Vec<MatchedMapImage<'_>> =
        map.par_iter().map(|p| MatchedMapImage::new(query, p)).collect();
    // A stable sort keeps the order of the map for equal counts.
    matched.sort_by_key(|m| std::cmp::Reverse(m.mutual.len()));
    matched.truncate(options.images);
    let views: Vec<MapView> =
        matched.into_par_iter().filter_map(|m| MapView::new(m, &known, size, options.gate)).collect();

    let similarities = DescriptorLikelihood::learn(&views, &known, options.gate);
    let answer = |(i, o): (usize, &Observation)| match known[i] {
        Some(pixel) => GuidedEstimate { pixel: Some(pixel), probability: 1.0 },
        None => one(i, o, &views, &similarities, size, options),
    };
    Ok(observations.par_iter().enumerate().map(answer).collect())
}

fn one(
    i: usize,
    observation: &Observation,
    views: &[MapView],
    similarities: &DescriptorLikelihood,
    (width, height): (u32, u32),
    options: &GuidedOptions,
) -> GuidedEstimate {
    let segments = KnownSegment::of(observation, width, height);
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut none = 0.0;
    for view in views {
        let first = candidates.len();
        for segment in segments.iter().filter(|s| !s.is_empty()) {
            view.near(i, segment, options.gate, similarities, &mut candidates);
        }
        // One candidate is right with the probability of re-detection, and all are equally likely a priori.
        none += (candidates.len() - first) as f64 * (1.0 - options.repeatability) / options.repeatability;
    }
    // "No candidate" is counted once over all images, while the candidates of each image compete with each other.
    none /= views.len().max(1) as f64;
    let total = candidates.iter().map(|c| c.weight).sum::<f64>() + none;
    // Of hundreds of candidates only a few have weight enough to lead.
    let heavy: Vec<&Candidate> = candidates.iter().filter(|c| c.weight >= LIGHT * total).collect();
    let together = |c: &&Candidate| {
        let group = heavy.iter().filter(|d| d.pixel.distance(&c.pixel) <= options.together_px);
        group.fold((0.0, 0.0, 0.0), |(w, u, v), d| {
            (w + d.weight, u + d.weight * d.pixel.u, v + d.weight * d.pixel.v)
        })
    };
    let heaviest = heavy.iter().map(together).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some((weight, u, v)) = heaviest.filter(|h| h.0 > 0.0) else {
        return GuidedEstimate { pixel: None, probability: 0.0 };
    };
    GuidedEstimate { pixel: Some(Pixel::new(u / weight, v / weight)), probability: weight / total }
}

/// Candidates below this share of the total weight are skipped.
const LIGHT: f64 = 1e-3;
/// Probability above which an answer outweighs all others together.
const ACCEPTED: f64 = 0.5;
