//! A second pose that the matches support beside the best one.
//!
//! The best pose explains its matches, but the others may not be wrong at random: a part of the map that looks alike
//! proposes its own points for the same keypoints, and an object that was moved carries its matches with it. Both
//! support a pose of their own, and the number of matches does not say which of the two is right: it depends on how
//! often each place was photographed. The difference in likelihood to another pose ([`crate::confidence::ambiguity`]) is large for
//! both of them. Therefore the matches that the best pose does not explain are searched for a pose of their own, whose
//! evidence is compared with that of the best pose.
//!
//! Local optimisation of the first search starts at samples that beat all earlier ones, so it rarely finds this pose.
//! The second search is short: a pose that explains a considerable share of so few matches is found by few samples. It
//! is left out when the weight of the other matches is too small, which is so for nearly all queries.

use std::collections::HashSet;

use rand::Rng;
use veiloc_geometry::{CameraFromWorld, Pinhole, RigFromWorld};

use super::estimate::RigEstimate;
use super::frame::RigFrame;
use super::images::Images;
use crate::confidence::MIN_RIVAL_SHARE;
use crate::likelihood::duplicates::spread;
use crate::likelihood::{FocalPrior, Matches, PoseProblem};
use crate::options::PoseOptions;
use crate::ransac::Budget;

/// A match within this multiple of the noise of the best pose belongs to that pose: a rival explains others.
const NEAR: f64 = 4.0;

/// Probability to find a rival of the smallest weight that counts.
const FOUND: f64 = 0.99;

/// Least and largest number of samples, of a frame.
const SAMPLES: [usize; 2] = [20, 400];

/// The matches of a frame that a pose does not explain.
struct OtherMatches {
    /// Their indices, ascending.
    indices: Vec<usize>,
    /// Weight of the matches that agree with the pose, and of the others.
    weights: [Weight; 2],
}

/// Weight of a set of matches.
#[derive(Debug, Clone, Copy, Default)]
struct Weight {
    /// Sum of the priors: samples are drawn in proportion to it.
    drawn: f64,
    /// Sum of their squares: the expected weight of right matches, to which many improbable ones hardly contribute.
    expected: f64,
}

impl Weight {
    fn of(matches: &Matches<'_>, indices: &[usize]) -> Self {
        let add = |sum: Self, &i: &usize| sum + Self::of_prior(matches.inlier_prior[i]);
        indices.iter().fold(Self::default(), add)
    }

    fn of_prior(prior: f64) -> Self {
        Self { drawn: prior, expected: prior * prior }
    }
}

impl std::ops::Add for Weight {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { drawn: self.drawn + other.drawn, expected: self.expected + other.expected }
    }
}

impl OtherMatches {
    /// The matches that do not agree with a pose, without those that are near to what it predicts, and few of many
    /// on one spot. `camera` is that of the pose.
    fn of(
        matches: &Matches<'_>,
        problem: &PoseProblem,
        inliers: &[bool],
        pose: &CameraFromWorld,
        camera: Pinhole,
        noise: f64,
    ) -> Self {
        let (own, mut others): (Vec<usize>, Vec<usize>) = (0..matches.len()).partition(|&i| inliers[i]);
        let weights = |others: &[usize]| [Weight::of(matches, &own), Weight::of(matches, others)];
        if has_weight(weights(&others)) {
            // Of the two lines that a keypoint was sent as, one is wrong.
            let explained: HashSet<(usize, usize)> = own.iter().map(|&i| matches.pair(i)).collect();
            let matches = matches.with_camera(camera);
            let is_near =
                |i| matches.log_likelihood_ratio(i, pose, NEAR * noise).is_some_and(|llr| llr > 0.0);
            others.retain(|&i| !explained.contains(&matches.pair(i)) && !is_near(i));
            others = spread(problem, others);
        }
        Self { weights: weights(&others), indices: others }
    }
}

/// Whether the other matches have enough weight for a rival, relative to those that agree with the pose.
fn has_weight([own, others]: [Weight; 2]) -> bool {
    others.expected >= MIN_RIVAL_SHARE * own.expected
}

/// Number of samples that find a rival of the smallest weight that counts, with this number of matches in a sample.
fn budget([own, others]: [Weight; 2], sample_size: usize) -> Budget {
    let share = (MIN_RIVAL_SHARE * own.drawn / others.drawn).min(1.0);
    let hit = share.powi(sample_size as i32);
    let [min, max] = SAMPLES;
    let samples = ((1.0 - FOUND).ln() / (-hit).ln_1p()).ceil() as usize;
    Budget { min, max: samples.clamp(min, max), confidence: FOUND }
}

/// The problem of these matches alone, for the camera of a pose. A camera prior may have chosen that pose, so it must not
/// hide another one.
fn problem_of(problem: &PoseProblem, indices: &[usize], camera: Pinhole) -> PoseProblem {
    let mut rest = problem.subset(indices);
    (rest.camera, rest.gravity, rest.position, rest.focal) = (camera, None, None, FocalPrior::Calibrated);
    rest
}

/// The best pose from the matches that do not agree with an estimate, of all frames together, and its log evidence from
/// them; `None` if they have too little weight, or support no pose.
pub(super) fn find_rival<R: Rng + ?Sized>(
    images: &Images<'_>,
    estimate: &RigEstimate,
    options: &PoseOptions,
    rng: &mut R,
) -> Option<(RigFromWorld, f64)> {
    let mut weights = [Weight::default(); 2];
    let mut rest: Vec<RigFrame> = Vec::new();
    for (f, matches) in images.with_matches() {
        let (frame, found) = (&images.frames[f], &estimate.frames[f]);
        let (camera, pose) = (found.camera_of(&frame.problem.camera), &found.cam_from_world);
        let others =
            OtherMatches::of(matches, &frame.problem, &found.inliers, pose, camera, options.noise_px);
        let [own, other] = others.weights;
        // A frame that contradicts the others supports a pose of its own; the others outvote it.
        if images.frames.len() > 1 && !has_weight([other, own]) {
            continue;
        }
        weights = [0, 1].map(|k| weights[k] + others.weights[k]);
        rest.push(RigFrame { problem: problem_of(&frame.problem, &others.indices, camera), ..frame.clone() });
    }
    rest.retain(|frame| !frame.problem.points.is_empty());
    let count: usize = rest.iter().map(|frame| frame.problem.points.len()).sum();
    if !has_weight(weights) || count < options.min_inliers {
        return None;
    }
    let sample_size = rest.first()?.problem.observations.sample_size();
    let budget = budget(weights, sample_size);
    let options = PoseOptions {
        min_hypotheses: budget.min,
        max_hypotheses: budget.max,
        confidence: budget.confidence,
        ..options.clone()
    };
    // The evidence is below the gain, so most poses need no refinement.
    let least = estimate.confidence.min_rival_log_evidence();
    let others = Images::new(&rest, &options).ok()?;
    let found = others.search_at(1.0, &options, 1, rng).ok()?;
    if -found.search.raw_cost(found.poses.as_ref()?) < least {
        return None;
    }
    let rival = others.refine(found, &options).ok()?;
    Some((rival.rig_from_world, estimate.confidence.rival(&rival.confidence)?))
}
