//! Whether to trust a pose: its evidence against chance, its rivals, and how firmly it is held.
//!
//! # Evidence
//! For one pose, the matches of a keypoint explain what was observed better than "all of them are wrong" by the factor
//! `1 − Σ γᵢ + Σ γᵢ ρᵢ`, with `γᵢ` the prior of match `i` and `ρᵢ` how much likelier its observation is when right than
//! when wrong (`veiloc_pose::likelihood`). Of one keypoint's matches at most one is right, and [`crate::PoseProblem::keypoints`] says which
//! are one keypoint's. The product over keypoints, integrated over all poses that might have been (any orientation,
//! anywhere in the mapped region) by Laplace's approximation, is the Bayes factor of "taken here" against "taken
//! elsewhere":
//!
//! ```text
//! log evidence = Σ log(1 − Σ γ + Σ γ ρ) + ½ log det(2π C) − log(8π² V)
//! ```
//!
//! with the pose's covariance `C` and the volume `V` of the region. If wrong matches were as random as the model says,
//! a pose of evidence `B` would come up by chance at most once in `B` queries, whatever the scene: the number of poses
//! that were tried is paid for. Real wrong matches are not random (repeated structures agree with each other), so
//! [`Confidence::is_trusted`] asks for more than that; false positives are measured in `docs/results/trust.md`.

use std::fmt;

use veiloc_geometry::deviations::{position_sd, rotation_sd_degrees};
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, Vector3};
use veiloc_geometry::statistics::upper_median;
use veiloc_geometry::{Anchor, CameraFromWorld};

use crate::likelihood::{Correspondences, Matches, Symmetric6};
use crate::ransac::half_planes::direction;

/// Least natural logarithm of the evidence of a trusted pose from lines: once in three million by chance. Of 1,550
/// images of elsewhere none reached more than 1, right poses began at 17 (`docs/results/trust.md`).
const LEAST_LOG_EVIDENCE: f64 = 15.0;

/// The same from points. They tell so much that places which share an object have evidence of each other, by matches that
/// are right; right poses began at 101.
const LEAST_LOG_EVIDENCE_OF_POINTS: f64 = 60.0;

/// Log evidence below which a pose is no better than chance, and nothing was found.
const CHANCE_LOG_EVIDENCE: f64 = 0.0;

/// Least log likelihood by which a trusted pose beats the best other one.
pub(crate) const LEAST_MARGIN: f64 = 8.0;

/// Largest standard deviation of a trusted camera centre, as a share of the distance to what it sees.
const LOOSEST: f64 = 0.05;

/// Largest standard deviation of a trusted orientation, degrees: one that is 2° wrong is then two deviations off.
const LOOSEST_ROTATION_DEG: f64 = 1.0;

/// Least log evidence that the other anchors' lines must give for where the camera is along the ray of the richest anchor.
const LEAST_SIDE_EVIDENCE: f64 = 2.5;

/// Fewest keypoints that must agree beside those of the richest anchor.
const FEWEST_A_SIDE: usize = 4;

/// What speaks for and against an estimated pose.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Confidence {
    /// Natural logarithm of the Bayes factor of "some pose in this map explains the matches" against "all are wrong".
    pub log_evidence: f64,
    /// What that must be at least for a trusted pose: 15, and 60 from points.
    pub least_log_evidence: f64,
    /// Log likelihood by which the pose beats the best one found elsewhere; infinite when no other was found.
    pub margin: f64,
    /// Standard deviation of the camera centre in its least certain direction, map units: the square root of the largest
    /// eigenvalue of the centre's covariance. What is printed and answered as the `±` of a position is this and nothing
    /// else.
    pub center_sd: f64,
    /// The same as a share of [`Self::distance`].
    pub center_sd_relative: f64,
    /// The same share by the matches alone: what was told of the camera beside them holds nothing that is trusted.
    pub held_relative: f64,
    /// Median distance of the agreeing points, map units.
    pub distance: f64,
    /// Standard deviation of the orientation about its least certain axis, degrees.
    pub rotation_sd_deg: f64,
    /// The same by the matches alone and by the estimator's own covariance: a map's calibration, which stands for what all
    /// queries share, does not enter.
    pub held_rotation_deg: f64,
    /// A focal length over the given one that would explain the matches better, by too little to be believed; `None` where
    /// nothing speaks against the given one, or another was estimated.
    pub other_focal: Option<f64>,
    /// Keypoints that agree of the anchor that has most of them, and of all others; `None` without anchors.
    pub sides: Option<[usize; 2]>,
}

/// What an estimate is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// Nothing speaks against the pose.
    Trusted,
    /// There is a pose, and a [`Doubt`].
    Doubtful,
    /// There is no pose, or none that explains the matches better than chance does.
    NotFound,
}

impl State {
    /// All of them, best first.
    pub const ALL: [Self; 3] = [Self::Trusted, Self::Doubtful, Self::NotFound];
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Trusted => "trusted",
            Self::Doubtful => "doubtful",
            Self::NotFound => "not-found",
        })
    }
}

/// A reason not to trust a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Doubt {
    /// So many agreeing matches could be chance.
    WeakEvidence {
        /// [`Confidence::log_evidence`].
        log_evidence: f64,
    },
    /// Another pose explains the matches nearly as well.
    Ambiguous {
        /// [`Confidence::margin`].
        margin: f64,
    },
    /// The agreeing matches leave a direction or a turn nearly free.
    LooselyHeld {
        /// The larger of [`Confidence::center_sd_relative`] and [`Confidence::held_relative`].
        center_sd_relative: f64,
        /// [`Confidence::held_rotation_deg`].
        rotation_sd_deg: f64,
    },
    /// The matches would rather have another focal length.
    FocalLength {
        /// [`Confidence::other_focal`].
        scale: f64,
    },
    /// Nearly all agreeing lines run through one anchor.
    OneSided {
        /// [`Confidence::sides`].
        sides: [usize; 2],
    },
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WeakEvidence { log_evidence } => {
                write!(f, "the agreement could be chance (log evidence {log_evidence:.0})")
            }
            Self::Ambiguous { margin } => {
                write!(f, "another pose explains the matches nearly as well (margin {margin:.1})")
            }
            Self::LooselyHeld { center_sd_relative, rotation_sd_deg } => write!(
                f,
                "the matches hold the camera only to {:.0} % of its distance from the scene and {rotation_sd_deg:.1}°",
                100.0 * center_sd_relative
            ),
            Self::FocalLength { scale } => write!(
                f,
                "the focal length seems to be wrong by {:.1} %; calibrate the camera, or say that it is not calibrated",
                100.0 * (scale - 1.0).abs()
            ),
            Self::OneSided { sides: [a, b] } => {
                write!(
                    f,
                    "the agreeing lines run through one anchor ({a}, and {b} through others), and nothing says how far \
                     along its ray the camera is"
                )
            }
        }
    }
}

impl Confidence {
    /// Whether nothing speaks against the pose.
    pub fn is_trusted(&self) -> bool {
        self.doubts().is_empty()
    }

    /// What the pose is worth.
    pub fn state(&self) -> State {
        if !(self.log_evidence >= CHANCE_LOG_EVIDENCE) {
            State::NotFound
        } else if self.is_trusted() {
            State::Trusted
        } else {
            State::Doubtful
        }
    }

    /// The same pose under another covariance, and another one by the matches alone, both in the chart of
    /// [`CameraFromWorld::perturbed`]: how firmly it is held is told anew, the evidence and [`Self::held_rotation_deg`] stay,
    /// and what nothing holds stays free.
    #[must_use]
    pub fn with_covariances(self, covariance: &[[f64; 6]; 6], by_matches: &[[f64; 6]; 6]) -> Self {
        let is_held = self.center_sd.is_finite();
        let sd = |of: &[[f64; 6]; 6]| if is_held { position_sd(of) } else { f64::INFINITY };
        let center_sd = sd(covariance);
        Self {
            center_sd,
            center_sd_relative: center_sd / self.distance,
            held_relative: sd(by_matches) / self.distance,
            rotation_sd_deg: rotation_sd_degrees(covariance),
            ..self
        }
    }

    /// Everything that speaks against the pose.
    pub fn doubts(&self) -> Vec<Doubt> {
        let mut doubts = Vec::new();
        if !(self.log_evidence >= self.least_log_evidence) {
            doubts.push(Doubt::WeakEvidence { log_evidence: self.log_evidence });
        }
        if !(self.margin >= LEAST_MARGIN) {
            doubts.push(Doubt::Ambiguous { margin: self.margin });
        }
        // A direction that is left free is said by the sides.
        let one_sided =
            self.sides.filter(|s| s[0].min(s[1]) < FEWEST_A_SIDE || self.center_sd == f64::INFINITY);
        let center_sd_relative = self.center_sd_relative.max(self.held_relative);
        let rotation_sd_deg = self.held_rotation_deg;
        let is_firm = center_sd_relative <= LOOSEST && rotation_sd_deg <= LOOSEST_ROTATION_DEG;
        if one_sided.is_none() && !is_firm {
            doubts.push(Doubt::LooselyHeld { center_sd_relative, rotation_sd_deg });
        }
        if let Some(scale) = self.other_focal {
            doubts.push(Doubt::FocalLength { scale });
        }
        if let Some(sides) = one_sided {
            doubts.push(Doubt::OneSided { sides });
        }
        doubts
    }
}

/// Assesses a pose with the log likelihood ratios of all correspondences under it, its covariance, and what it beats the
/// best other pose by.
pub(crate) fn assess(
    matches: &Matches<'_>,
    pose: &CameraFromWorld,
    inliers: &[usize],
    likelihoods: &[f64],
    covariance: &Symmetric6,
    margin: f64,
) -> Confidence {
    let confidence = Confidence {
        least_log_evidence: least_log_evidence(matches),
        log_evidence: log_evidence(matches, likelihoods, &Matrix6::from_fn(|i, j| covariance[i][j])),
        margin,
        center_sd: 0.0,
        center_sd_relative: 0.0,
        held_relative: 0.0,
        held_rotation_deg: rotation_sd_degrees(covariance),
        distance: typical_distance(matches, pose, inliers),
        rotation_sd_deg: 0.0,
        other_focal: None,
        sides: matches!(matches.observations, Correspondences::Anchored { .. })
            .then(|| richest(matches, inliers).1),
    };
    confidence.with_covariances(covariance, covariance)
}

/// Log evidence that a trusted pose from such observations has at least.
pub(crate) const fn least_log_evidence(matches: &Matches<'_>) -> f64 {
    match matches.observations {
        Correspondences::Points { .. } => LEAST_LOG_EVIDENCE_OF_POINTS,
        Correspondences::Lines { .. } | Correspondences::Anchored { .. } => LEAST_LOG_EVIDENCE,
    }
}

impl Confidence {
    /// The same for a pose that nothing holds in one direction.
    pub(crate) const fn held_only_across(self) -> Self {
        Self {
            center_sd: f64::INFINITY,
            center_sd_relative: f64::INFINITY,
            held_relative: f64::INFINITY,
            ..self
        }
    }
}

/// The direction of translation that is left free, a unit vector of the camera frame, with the distance of what is seen:
/// the ray of one anchor, when the other's lines give no evidence that they hold it. Lines of an anchor say nothing along
/// its ray.
pub(crate) fn free_direction(
    matches: &Matches<'_>,
    pose: &CameraFromWorld,
    inliers: &[usize],
    likelihoods: &[f64],
    covariance: &Symmetric6,
) -> Option<(Vector3<f64>, f64)> {
    let Correspondences::Anchored { pencils, .. } = matches.observations else { return None };
    let (rich, [_, others]) = richest(matches, inliers);
    let ray = direction(matches, pencils, rich).normalize();
    let distance = typical_distance(matches, pose, inliers);
    let shift = Matrix3::from_fn(|i, j| covariance[3 + i][3 + j]);
    let sd = ray.dot(&(shift * ray)).max(0.0).sqrt();
    // What the others say for this place along the ray, against all others within the distance of the scene.
    let mut gains = gains(matches, likelihoods);
    for (i, keypoint) in matches.keypoint.iter().enumerate() {
        if matches.anchor[i] == rich {
            gains[*keypoint] = 0.0;
        }
    }
    let places = (2.0 * distance / ((std::f64::consts::TAU).sqrt() * sd)).max(1.0);
    let evidence = gains.iter().sum::<f64>() - places.ln();
    let is_held = others >= FEWEST_A_SIDE && evidence >= LEAST_SIDE_EVIDENCE;
    (!is_held).then_some((ray, distance))
}

/// Median distance of the agreeing points from the camera, map units.
fn typical_distance(matches: &Matches<'_>, pose: &CameraFromWorld, inliers: &[usize]) -> f64 {
    let mut distances: Vec<f64> =
        inliers.iter().map(|&i| (pose.rotation() * matches.points[i] + pose.translation()).norm()).collect();
    upper_median(&mut distances).unwrap_or(f64::NAN)
}

/// The anchor with most distinct keypoints among the inliers, the first of equals; how many it has, and how many all others.
fn richest(matches: &Matches<'_>, inliers: &[usize]) -> (Anchor, [usize; 2]) {
    let keypoints = |of_anchor: &dyn Fn(Anchor) -> bool| {
        matches.keypoints_among(inliers.iter().copied().filter(|&i| of_anchor(matches.anchor[i])))
    };
    let richest = Anchor::first(Anchor::MOST)
        .rev()
        .max_by_key(|anchor| keypoints(&|a| a == *anchor))
        .unwrap_or(Anchor::FIRST);
    (richest, [keypoints(&|a| a == richest), keypoints(&|a| a != richest)])
}

fn log_evidence(matches: &Matches<'_>, likelihoods: &[f64], covariance: &Matrix6<f64>) -> f64 {
    let log_volume = log_det(&(covariance * std::f64::consts::TAU));
    let Some(log_volume) = log_volume else { return f64::NEG_INFINITY };
    let gained: f64 = gains(matches, likelihoods).iter().sum();
    gained + 0.5 * log_volume - log_poses(matches.points.iter())
}

/// Logarithm of the volume of all poses that a camera that sees these points might have had: any orientation, anywhere in
/// their region.
pub(crate) fn log_poses<'a>(points: impl Iterator<Item = &'a Vector3<f64>> + Clone) -> f64 {
    (8.0 * std::f64::consts::PI.powi(2)).ln() + log_region(points)
}

/// By how much each keypoint is likelier at the pose than if all its matches were wrong, natural logarithm.
pub(crate) fn gains(matches: &Matches<'_>, likelihoods: &[f64]) -> Vec<f64> {
    // Σ γ and Σ γ ρ of each keypoint.
    let mut keypoints = vec![(0.0, 0.0); matches.keypoints];
    for (i, &llr) in likelihoods.iter().enumerate() {
        let prior = matches.weight[i];
        let (right, explained): &mut (f64, f64) = &mut keypoints[matches.keypoint[i]];
        *right += prior;
        *explained += (1.0 - prior) * (llr - matches.log_clutter_density[i]).exp();
    }
    keypoints
        .iter()
        .map(|(right, explained)| {
            // More than one match cannot be right: their priors then share what certainty there is.
            let share = (0.99 / right).min(1.0);
            (1.0 - share * right + share * explained).ln()
        })
        .collect()
}

/// Logarithm of the determinant of a covariance; `None` when it is not positive definite.
pub(crate) fn log_det(m: &Matrix6<f64>) -> Option<f64> {
    let factor = m.iter().all(|c| c.is_finite()).then(|| m.cholesky()).flatten()?;
    Some(2.0 * factor.l().diagonal().iter().map(|d| d.ln()).sum::<f64>())
}

/// Logarithm of the volume a camera might have been in: the box of the middle 90 % of the points, doubled.
fn log_region<'a>(points: impl Iterator<Item = &'a Vector3<f64>> + Clone) -> f64 {
    let extents = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = points.clone().map(|p| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
        2.0 * (at(0.95) - at(0.05))
    });
    // A flat scene is looked at from somewhere: no side shorter than half the longest.
    let longest = extents.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    extents.iter().map(|e| e.max(0.5 * longest).ln()).sum()
}
