//! A second pose that the matches support beside the best one.
//!
//! The best pose explains its matches, but the others may not be wrong at random: a part of the map that looks alike
//! proposes its own points for the same keypoints, and an object that was moved carries its matches with it. Both
//! support a pose of their own, and the number of matches does not say which of the two is right: it depends on how
//! often each place was photographed. The difference in likelihood to another pose ([`crate::ambiguity`]) is large for
//! both of them. Therefore the matches that the best pose does not explain are searched for a pose of their own, whose
//! evidence is compared with that of the best pose.
//!
//! Local optimisation of the first search starts at samples that beat all earlier ones, so it rarely finds this pose.
//! The second search is short: a pose that explains a considerable share of so few matches is found by few samples. It
//! is left out when the weight of the other matches is too small, which is so for nearly all queries.

use std::collections::HashSet;

use rand::Rng;
use veiloc_geometry::{CameraFromWorld, Pinhole};

use crate::confidence::MIN_RIVAL_SHARE;
use crate::copies::spread;
use crate::estimate::{conclude, search};
use crate::likelihood::{FocalPrior, Matches, PoseProblem, PoseWithFocal};
use crate::options::PoseOptions;
use crate::pose_estimate::{PoseEstimate, Rival};
use crate::ransac::{Budget, lo_ransac};

/// A match within this multiple of the noise of the best pose belongs to that pose: a rival explains others.
const NEAR: f64 = 4.0;

/// Probability to find a rival of the smallest weight that counts.
const FOUND: f64 = 0.99;

/// Least and largest number of samples, of a frame.
const SAMPLES: [usize; 2] = [20, 400];

/// The matches that a pose does not explain.
pub(crate) struct OtherMatches {
    /// Their indices, ascending.
    pub(crate) indices: Vec<usize>,
    /// Weight of the matches that agree with the pose, and of the others.
    pub(crate) weights: [Weight; 2],
}

/// Weight of a set of matches.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Weight {
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
    pub(crate) fn of(
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
pub(crate) fn has_weight([own, others]: [Weight; 2]) -> bool {
    others.expected >= MIN_RIVAL_SHARE * own.expected
}

/// Number of samples that find a rival of the smallest weight that counts, with this number of matches in a sample.
pub(crate) fn budget([own, others]: [Weight; 2], sample_size: usize) -> Budget {
    let share = (MIN_RIVAL_SHARE * own.drawn / others.drawn).min(1.0);
    let hit = share.powi(sample_size as i32);
    let [min, max] = SAMPLES;
    let samples = ((1.0 - FOUND).ln() / (-hit).ln_1p()).ceil() as usize;
    Budget { min, max: samples.clamp(min, max), confidence: FOUND }
}

/// The problem of these matches alone, for the camera of a pose. A camera prior may have chosen that pose, so it must not
/// hide another one.
pub(crate) fn problem_of(problem: &PoseProblem, indices: &[usize], camera: Pinhole) -> PoseProblem {
    let mut rest = problem.subset(indices);
    (rest.camera, rest.gravity, rest.position, rest.focal) = (camera, None, None, FocalPrior::Calibrated);
    rest
}

/// The best pose from the matches that do not agree with an estimate, and its evidence from them; `None` if they have too
/// little weight, or support no pose.
pub(crate) fn find_rival<R: Rng + ?Sized>(
    matches: &Matches<'_>,
    problem: &PoseProblem,
    estimate: &PoseEstimate,
    options: &PoseOptions,
    rng: &mut R,
) -> Option<Rival> {
    let camera = estimate.camera_of(&problem.camera);
    let pose = &estimate.cam_from_world;
    let others = OtherMatches::of(matches, problem, &estimate.inliers, pose, camera, options.noise_px);
    if !has_weight(others.weights) || others.indices.len() < options.min_inliers {
        return None;
    }
    let rest = problem_of(problem, &others.indices, camera);
    rest.check().ok()?;
    let matches = Matches::new(&rest, options.expected_inlier_ratio);
    let mut search = search(&matches, &rest, options);
    let found = lo_ransac(&mut search, &budget(others.weights, rest.observations.sample_size()), rng);
    // The evidence is below the gain, so most poses need no refinement.
    let least = estimate.confidence.min_rival_log_evidence();
    if !(-found.cost >= least) {
        return None;
    }
    let start = found.model.map(|pose| PoseWithFocal { pose, factor: 1.0 });
    let rival = conclude(search, &matches, start, found.samples, &rest, options).ok()?;
    let log_evidence = estimate.confidence.rival(&rival.confidence)?;
    Some(Rival { cam_from_world: rival.cam_from_world, log_evidence })
}
