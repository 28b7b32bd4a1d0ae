//! Position transfer by a server that knows the pose: only what can lie on the half-line is compared.
//!
//! [`crate::transfer()`] asks a whole map image for the most similar descriptor. A server that has localized the
//! query knows where its inliers lie in the query *and* in its map images, hence how a map image flows into the
//! query. Warped by that flow, the map image has only a handful of keypoints near a given half-line, and the most
//! similar of a handful is right far more often than the most similar of thousands.
//!
//! For each hidden keypoint the candidates are the keypoints of several warped map images within a few standard
//! deviations of its line. With `s` the logarithm of the descriptors' distance over the least among keypoints far from
//! the line, distance `e` from the line and standard deviation `σ`, a candidate weighs
//!
//! ```text
//! w = p(s | the same place) / p(s | another place) · exp(−e² / 2σ²)
//! ```
//!
//! where both densities are normal and learned from the query's own inliers, of which the server knows which
//! candidate is right. All candidates may be wrong, so "none of them" has a weight too. Candidates of several
//! images that land together add up; the heaviest place is the answer, and is **believed** when it outweighs
//! everything else.

use rayon::prelude::*;
use veiloc_geometry::Pixel;

use super::known;
use super::warp::{Candidate, MapView, Matched, Similarities};
use crate::error::AttackError;
use crate::features::{Descriptors, KnownImage};
use crate::observation::Observation;
use crate::prior::KnownSegment;

/// How the guided transfer works.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GuidedOptions {
    /// Map images that are asked, those with most mutual matches.
    pub images: usize,
    /// Standard deviations from the line within which a warped keypoint is a candidate.
    pub gate: f64,
    /// Share of keypoints that are found again in one map image that shows their place, 0 to 1.
    pub repeatability: f64,
    /// Pixels within which candidates say the same.
    pub together_px: f64,
}

impl Default for GuidedOptions {
    fn default() -> Self {
        Self { images: 5, gate: 3.0, repeatability: 0.3, together_px: 6.0 }
    }
}

/// What the server says of one keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guided {
    /// Where it is, pixels; `None` without any candidate.
    pub pixel: Option<Pixel>,
    /// How sure the server is, 0 to 1; 1 for a known position.
    pub belief: f64,
}

impl Guided {
    /// Whether the answer outweighs all others together.
    pub fn is_believed(&self) -> bool {
        self.belief > BELIEVED
    }
}

/// Positions of hidden keypoints from map images, warped into the query by the flow of its known keypoints: `[N]`.
///
/// `query`: one descriptor an observation. `size`: width and height of the query image, pixels. A map image in
/// which too few known keypoints are found again says nothing; without any such image nothing is answered.
///
/// # Errors
/// [`AttackError::Dimensions`] when a map image has descriptors of another dimension,
/// [`AttackError::FrameDescriptors`] when there is not one descriptor per observation.
pub fn guided_transfer(
    query: &Descriptors,
    observations: &[Observation],
    map: &[KnownImage],
    size: (u32, u32),
    options: &GuidedOptions,
) -> Result<Vec<Guided>, AttackError> {
    if query.len() != observations.len() {
        let (observations, descriptors) = (observations.len(), query.len());
        return Err(AttackError::FrameDescriptors { frame: 0, observations, descriptors });
    }
    let expected = query.columns().nrows();
    if let Some(bad) = map.iter().find(|p| p.descriptors().columns().nrows() != expected) {
        return Err(AttackError::Dimensions { expected, found: bad.descriptors().columns().nrows() });
    }
    let known = known(observations);
    let mut matched: Vec<Matched<'_>> = map.par_iter().map(|p| Matched::new(query, p)).collect();
    // Stable: equal counts stay in the order of the map.
    matched.sort_by_key(|m| std::cmp::Reverse(m.mutual.len()));
    matched.truncate(options.images);
    let views: Vec<MapView> =
        matched.into_par_iter().filter_map(|m| MapView::new(m, &known, size, options.gate)).collect();

    let similarities = Similarities::learn(&views, &known, options.gate);
    let answer = |(i, o): (usize, &Observation)| match known[i] {
        Some(pixel) => Guided { pixel: Some(pixel), belief: 1.0 },
        None => one(i, o, &views, &similarities, size, options),
    };
    Ok(observations.par_iter().enumerate().map(answer).collect())
}

fn one(
    i: usize,
    observation: &Observation,
    views: &[MapView],
    similarities: &Similarities,
    (width, height): (u32, u32),
    options: &GuidedOptions,
) -> Guided {
    let segments = KnownSegment::of(observation, width, height);
    let mut candidates: Vec<Candidate> = Vec::new();
    let mut none = 0.0;
    for view in views {
        let first = candidates.len();
        for segment in segments.iter().filter(|s| !s.is_empty()) {
            view.near(i, segment, options.gate, similarities, &mut candidates);
        }
        // One of the candidates is right with the probability of repetition, each as likely before it is looked at.
        none += (candidates.len() - first) as f64 * (1.0 - options.repeatability) / options.repeatability;
    }
    // "None of them" holds for all images together, where each image's candidates compete with its own.
    none /= views.len().max(1) as f64;
    let total = candidates.iter().map(|c| c.weight).sum::<f64>() + none;
    // Hundreds of candidates weigh nothing; only few can lead.
    let heavy: Vec<&Candidate> = candidates.iter().filter(|c| c.weight >= LIGHT * total).collect();
    let together = |c: &&Candidate| {
        let group = heavy.iter().filter(|d| d.pixel.distance(&c.pixel) <= options.together_px);
        group.fold((0.0, 0.0, 0.0), |(w, u, v), d| {
            (w + d.weight, u + d.weight * d.pixel.u, v + d.weight * d.pixel.v)
        })
    };
    let heaviest = heavy.iter().map(together).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some((weight, u, v)) = heaviest.filter(|h| h.0 > 0.0) else {
        return Guided { pixel: None, belief: 0.0 };
    };
    Guided { pixel: Some(Pixel::new(u / weight, v / weight)), belief: weight / total }
}

/// Share of the whole weight below which a candidate leads nowhere.
const LIGHT: f64 = 1e-3;
/// Belief above which an answer outweighs all others together.
const BELIEVED: f64 = 0.5;
