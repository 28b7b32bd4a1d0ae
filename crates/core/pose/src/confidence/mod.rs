//! Whether to trust a pose: its evidence against chance, other poses that explain the matches, and its uncertainty.
//!
//! # Evidence
//! Under one pose, the matches of a keypoint explain the observation better than "all of them are wrong" by the factor
//! `1 − Σ γᵢ + Σ γᵢ ρᵢ`, with `γᵢ` the prior of match `i` and `ρᵢ` the likelihood ratio of its observation between
//! right and wrong (`veiloc_pose::likelihood`). At most one match of a keypoint is right;
//! [`crate::PoseProblem::keypoints`] assigns matches to keypoints. The product over keypoints, integrated by Laplace's
//! approximation over all possible poses (any orientation, anywhere in the mapped region), is the Bayes factor of
//! "taken in this map" against "out of map":
//!
//! ```text
//! log evidence = Σ log(1 − Σ γ + Σ γ ρ) + ½ log det(2π C) − log(8π² V)
//! ```
//!
//! with the pose's covariance `C` and the volume `V` of the region. If wrong matches were as random as the model
//! assumes, a pose of evidence `B` would occur by chance at most once in `B` queries in any scene: the evidence
//! accounts for the number of poses that were tried. Real wrong matches are not random (repeated structures agree with
//! each other), so [`Confidence::is_trusted`] requires more; `docs/results/trust.md` reports measured false positives.

pub(crate) mod ambiguity;

use std::fmt;

use veiloc_geometry::deviations::{position_sd, rotation_sd_degrees};
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, Vector3};
use veiloc_geometry::statistics::upper_median;
use veiloc_geometry::{Anchor, CameraFromWorld};

use crate::likelihood::{Correspondences, GravityAgreement, Matches, Symmetric6};
use crate::ransac::half_planes::direction;

/// Minimum log evidence of a trusted pose from lines: once in three million by chance. Of 1,550 out-of-map images none
/// reached more than 1; right poses began at 17 (`docs/results/trust.md`).
const MIN_LOG_EVIDENCE: f64 = 15.0;

/// Minimum log evidence of a trusted pose from points. Points hold so much information that scenes with a common object
/// have evidence of each other, by matches that are right; right poses began at 101.
const MIN_LOG_EVIDENCE_POINTS: f64 = 60.0;

/// Log evidence below which a pose is no better than chance, and the query counts as not found.
const CHANCE_LOG_EVIDENCE: f64 = 0.0;

/// Minimum log likelihood by which a trusted pose beats the best other one.
pub(crate) const MIN_MARGIN: f64 = 8.0;

/// Share of a pose's log evidence from which on that of another pose, from the other matches, is a doubt. Of poses of
/// seven places without twins all had less than 0.02, and 0.11 on a facade of equal windows (entry); of 32 queries in
/// maps in which 8 to 24 of 91 images exist twice all had 0.27 or more.
pub(crate) const MIN_RIVAL_SHARE: f64 = 0.2;

/// Largest distance of a trusted position from the given one, in standard deviations of both. Beyond it are one in
/// 60,000 of normally distributed errors.
const MAX_POSITION_DEVIATION: f64 = 5.0;

/// Largest deviation of a gravity direction from that of a trusted pose, in standard deviations of both: beyond are one in
/// 3,000 right ones.
const MAX_GRAVITY_DEVIATION: f64 = 4.0;

/// Largest standard deviation of a trusted camera centre, relative to the distance of the observed points, and of a trusted
/// orientation, degrees, both calibrated. No tests of the pose: above them the ± itself is a guess, as it linearizes.
/// A caller that needs more says so ([`Precision`]).
const MAX_RELATIVE_SD: f64 = 0.2;
const MAX_ROTATION_SD_DEG: f64 = 5.0;

/// The same for another pose from the remaining matches: weakly determined poses agree with anything.
const MAX_RIVAL_RELATIVE_SD: f64 = 0.05;
const MAX_RIVAL_ROTATION_SD_DEG: f64 = 2.0;

/// Minimum log evidence of the other anchors' lines for the camera's position along the ray of the richest anchor.
const MIN_SIDE_EVIDENCE: f64 = 2.5;

/// Minimum number of agreeing keypoints beside those of the richest anchor.
const MIN_KEYPOINTS_PER_SIDE: usize = 4;

/// Measures for and against an estimated pose.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Confidence {
    /// Natural logarithm of the Bayes factor of "some pose in this map explains the matches" against "all are wrong".
    pub log_evidence: f64,
    /// Required log evidence of a trusted pose: 15, and 60 from points.
    pub min_log_evidence: f64,
    /// Log likelihood by which the pose beats the best other one; infinite when no other was found.
    pub margin: f64,
    /// Log evidence of another pose from the matches that do not agree with this one; `None` when they support no other
    /// pose. Two parts of a map that look alike, or an object that was moved, give both poses much evidence.
    pub rival_log_evidence: Option<f64>,
    /// Distance of the camera centre from the given approximate position, in standard deviations of that position and
    /// of the centre; `None` without one.
    pub position_deviation: Option<f64>,
    /// How the measured gravity direction agrees with the pose of the matches alone; `None` without one.
    pub gravity: Option<GravityAgreement>,
    /// Standard deviation of the camera centre in its least certain direction, map units: the square root of the
    /// largest eigenvalue of the centre's covariance. The `±` of a printed or answered position is always this value.
    pub center_sd: f64,
    /// [`Self::center_sd`] relative to [`Self::distance`].
    pub center_sd_relative: f64,
    /// The same ratio from the matches alone; camera priors do not count for trust.
    pub held_relative: f64,
    /// Median distance of the agreeing points, map units.
    pub distance: f64,
    /// Standard deviation of the orientation about its least certain axis, degrees.
    pub rotation_sd_deg: f64,
    /// The same from the matches alone; camera priors do not count for trust.
    pub held_rotation_deg: f64,
    /// The precision that the caller needs.
    pub needed: Precision,
    /// A focal length, relative to the given one, that explains the matches better, but not enough to replace the given
    /// one; `None` when the given one is consistent or another was estimated.
    pub other_focal: Option<f64>,
    /// Whether the matches contradict the camera of the query more than the map's own images contradict theirs, and no
    /// other camera was estimated.
    pub is_camera_contradicted: bool,
    /// Agreeing keypoints of the anchor that has most of them, and of all other anchors; `None` without anchors.
    pub sides: Option<[usize; 2]>,
}

/// The precision that a caller needs; a pose with a larger ± is doubtful.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Precision {
    /// Largest standard deviation of the camera centre in its least certain direction, map units; infinite for any.
    pub position: f64,
    /// Largest standard deviation of the orientation about its least certain axis, degrees; infinite for any.
    pub rotation_deg: f64,
}

impl Precision {
    /// Any ±.
    pub const ANY: Self = Self { position: f64::INFINITY, rotation_deg: f64::INFINITY };
}

impl Default for Precision {
    fn default() -> Self {
        Self::ANY
    }
}

/// State of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// There are no doubts about the pose.
    Trusted,
    /// There is a pose with at least one [`Doubt`].
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
    /// The agreement of this many matches could be chance.
    WeakEvidence {
        /// [`Confidence::log_evidence`].
        log_evidence: f64,
    },
    /// Another pose explains the matches nearly as well.
    Ambiguous {
        /// [`Confidence::margin`].
        margin: f64,
    },
    /// The other matches support another pose: parts of the map look alike, or an object was moved.
    Rival {
        /// [`Confidence::rival_log_evidence`].
        rival: f64,
        /// [`Confidence::log_evidence`].
        log_evidence: f64,
    },
    /// The pose is far from the approximate position that came with the query.
    FarFromPosition {
        /// [`Confidence::position_deviation`].
        deviation: f64,
    },
    /// The measured gravity direction contradicts the pose.
    Gravity {
        /// [`GravityAgreement::deviation`].
        deviation: f64,
    },
    /// The agreeing matches hardly determine a direction of translation or rotation.
    Imprecise {
        /// The larger of [`Confidence::center_sd_relative`] and [`Confidence::held_relative`].
        center_sd_relative: f64,
        /// [`Confidence::held_rotation_deg`].
        rotation_sd_deg: f64,
    },
    /// The ± is larger than the caller needs.
    LessThanNeeded {
        /// [`Confidence::center_sd`].
        center_sd: f64,
        /// [`Confidence::rotation_sd_deg`].
        rotation_sd_deg: f64,
    },
    /// Another focal length would explain the matches better.
    FocalLength {
        /// [`Confidence::other_focal`].
        scale: f64,
    },
    /// Another camera would explain the matches better: principal point, `fx / fy` or distortion are not what the query
    /// says.
    Camera,
    /// Nearly all agreeing lines belong to one anchor.
    OneSided {
        /// [`Confidence::sides`].
        sides: [usize; 2],
    },
}

impl Doubt {
    /// Whether it says that the camera of the query is wrong.
    pub const fn is_of_camera(&self) -> bool {
        matches!(self, Self::FocalLength { .. } | Self::Camera)
    }
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
            Self::Rival { rival, log_evidence } => write!(
                f,
                "the other matches support another pose (log evidence {rival:.0}, of this pose {log_evidence:.0}): parts \
                 of the map look alike, or something was moved"
            ),
            Self::FarFromPosition { deviation } => write!(
                f,
                "the pose is {deviation:.0} standard deviations away from the given approximate position"
            ),
            Self::Gravity { deviation } => write!(
                f,
                "the measured gravity direction is {deviation:.0} standard deviations away from that of the pose: the \
                 device accelerated, or its axes or the map's direction of gravity are wrong"
            ),
            Self::Imprecise { center_sd_relative, rotation_sd_deg } => write!(
                f,
                "the matches determine the camera only to {:.0} % of its distance from the scene and \
                 {rotation_sd_deg:.1}°",
                100.0 * center_sd_relative
            ),
            Self::LessThanNeeded { center_sd, rotation_sd_deg } => {
                write!(f, "a smaller ± is needed than {center_sd:.3} map units and {rotation_sd_deg:.1}°")
            }
            Self::FocalLength { scale } => write!(
                f,
                "the focal length seems to be wrong by {:.1} %; calibrate the camera, or say that it is not calibrated",
                100.0 * (scale - 1.0).abs()
            ),
            Self::Camera => f.write_str(
                "the camera seems to be wrong (principal point, fx/fy or distortion, as after cropping or scaling the \
                 image); give the camera of the image as it is",
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
    /// From the log evidence and the required one; nothing else is known yet, and the covariance is 0.
    pub(crate) const fn new(
        [log_evidence, min_log_evidence]: [f64; 2],
        margin: f64,
        distance: f64,
        sides: Option<[usize; 2]>,
    ) -> Self {
        Self {
            log_evidence,
            min_log_evidence,
            margin,
            rival_log_evidence: None,
            position_deviation: None,
            gravity: None,
            center_sd: 0.0,
            center_sd_relative: 0.0,
            held_relative: 0.0,
            held_rotation_deg: 0.0,
            distance,
            rotation_sd_deg: 0.0,
            needed: Precision::ANY,
            other_focal: None,
            is_camera_contradicted: false,
            sides,
        }
    }

    /// Whether there are no doubts about the pose.
    pub fn is_trusted(&self) -> bool {
        self.doubts().is_empty()
    }

    /// The state of the pose.
    pub fn state(&self) -> State {
        if !(self.log_evidence >= CHANCE_LOG_EVIDENCE) {
            State::NotFound
        } else if self.is_trusted() {
            State::Trusted
        } else {
            State::Doubtful
        }
    }

    /// These measures with another covariance, and another one from the matches alone, both in the chart of
    /// [`CameraFromWorld::perturbed`]: the standard deviations are computed again; the evidence does
    /// not change, and free directions stay free.
    #[must_use]
    pub fn with_covariances(self, covariance: &[[f64; 6]; 6], by_matches: &[[f64; 6]; 6]) -> Self {
        let is_held = self.center_sd.is_finite();
        let sd = |of: &[[f64; 6]; 6]| if is_held { position_sd(of) } else { f64::INFINITY };
        let center_sd = sd(covariance);
        Self {
            center_sd,
            center_sd_relative: center_sd / self.distance,
            held_relative: sd(by_matches) / self.distance,
            held_rotation_deg: rotation_sd_degrees(by_matches),
            rotation_sd_deg: rotation_sd_degrees(covariance),
            ..self
        }
    }

    /// [`Self::log_evidence`] with that of a gravity direction which agrees.
    fn log_evidence_with_gravity(&self) -> f64 {
        self.log_evidence + self.gravity.map_or(0.0, |gravity| gravity.log_evidence)
    }

    /// Log evidence of another pose from which on this one is ambiguous.
    pub(crate) fn min_rival_log_evidence(&self) -> f64 {
        self.min_log_evidence.max(MIN_RIVAL_SHARE * self.log_evidence)
    }

    /// Log evidence of another pose, if it makes this one ambiguous. Matches on one spot agree with many poses and
    /// determine none; lines of one anchor determine all but the position along its ray.
    pub(crate) fn rival(&self, other: &Self) -> Option<f64> {
        let is_one_sided =
            other.center_sd == f64::INFINITY && other.held_rotation_deg <= MAX_RIVAL_ROTATION_SD_DEG;
        let is_determined = other.is_held(MAX_RIVAL_RELATIVE_SD, MAX_RIVAL_ROTATION_SD_DEG) || is_one_sided;
        let is_rival = other.log_evidence >= self.min_rival_log_evidence() && is_determined;
        is_rival.then_some(other.log_evidence)
    }

    /// Whether the matches determine centre and orientation to these standard deviations.
    fn is_held(&self, relative_sd: f64, rotation_sd_deg: f64) -> bool {
        self.center_sd_relative.max(self.held_relative) <= relative_sd
            && self.held_rotation_deg <= rotation_sd_deg
    }

    /// All reasons not to trust the pose.
    pub fn doubts(&self) -> Vec<Doubt> {
        let mut doubts = Vec::new();
        if !(self.log_evidence_with_gravity() >= self.min_log_evidence) {
            doubts.push(Doubt::WeakEvidence { log_evidence: self.log_evidence });
        }
        if !(self.margin >= MIN_MARGIN) {
            doubts.push(Doubt::Ambiguous { margin: self.margin });
        }
        if let Some(rival) = self.rival_log_evidence.filter(|rival| *rival >= self.min_rival_log_evidence()) {
            doubts.push(Doubt::Rival { rival, log_evidence: self.log_evidence });
        }
        if let Some(deviation) = self.position_deviation.filter(|d| !(*d <= MAX_POSITION_DEVIATION)) {
            doubts.push(Doubt::FarFromPosition { deviation });
        }
        if let Some(gravity) = self.gravity.filter(|gravity| !(gravity.deviation <= MAX_GRAVITY_DEVIATION)) {
            doubts.push(Doubt::Gravity { deviation: gravity.deviation });
        }
        // The one-sided doubt already covers a free direction.
        let one_sided =
            self.sides.filter(|s| s[0].min(s[1]) < MIN_KEYPOINTS_PER_SIDE || self.center_sd == f64::INFINITY);
        let center_sd_relative = self.center_sd_relative.max(self.held_relative);
        let rotation_sd_deg = self.held_rotation_deg;
        if one_sided.is_none() && !self.is_held(MAX_RELATIVE_SD, MAX_ROTATION_SD_DEG) {
            doubts.push(Doubt::Imprecise { center_sd_relative, rotation_sd_deg });
        }
        let (center_sd, rotation_sd_deg) = (self.center_sd, self.rotation_sd_deg);
        if !(center_sd <= self.needed.position && rotation_sd_deg <= self.needed.rotation_deg) {
            doubts.push(Doubt::LessThanNeeded { center_sd, rotation_sd_deg });
        }
        if let Some(scale) = self.other_focal {
            doubts.push(Doubt::FocalLength { scale });
        }
        if self.is_camera_contradicted {
            doubts.push(Doubt::Camera);
        }
        if let Some(sides) = one_sided {
            doubts.push(Doubt::OneSided { sides });
        }
        doubts
    }
}

/// Computes the confidence of a pose from the log likelihood ratios of all correspondences under it, its covariance,
/// and its margin over the best other pose.
pub(crate) fn assess(
    matches: &Matches<'_>,
    pose: &CameraFromWorld,
    inliers: &[usize],
    likelihoods: &[f64],
    covariance: &Symmetric6,
    margin: f64,
) -> Confidence {
    let log_evidence = log_evidence(matches, likelihoods, &Matrix6::from_fn(|i, j| covariance[i][j]));
    let sides =
        matches!(matches.observations, Correspondences::Anchored { .. }).then(|| richest(matches, inliers).1);
    let distance = typical_distance(matches, pose, inliers);
    Confidence::new([log_evidence, min_log_evidence(matches)], margin, distance, sides)
        .with_covariances(covariance, covariance)
}

/// Minimum log evidence of a trusted pose from such observations.
pub(crate) const fn min_log_evidence(matches: &Matches<'_>) -> f64 {
    match matches.observations {
        Correspondences::Points { .. } => MIN_LOG_EVIDENCE_POINTS,
        Correspondences::Lines { .. } | Correspondences::Anchored { .. } => MIN_LOG_EVIDENCE,
    }
}

impl Confidence {
    /// The same measures for a pose with one free direction of translation.
    pub(crate) const fn with_free_direction(self) -> Self {
        Self {
            center_sd: f64::INFINITY,
            center_sd_relative: f64::INFINITY,
            held_relative: f64::INFINITY,
            ..self
        }
    }
}

/// The free direction of translation, a unit vector of the camera frame, with the distance of the observed points: the
/// ray of one anchor, when the lines of the others give no evidence for the position along it. Lines of an anchor do
/// not constrain the translation along its ray.
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
    // Evidence of the others for this position along the ray, against all positions within the distance of the scene.
    let mut gains = gains(matches, likelihoods);
    for (i, keypoint) in matches.keypoint.iter().enumerate() {
        if matches.anchor[i] == rich {
            gains[*keypoint] = 0.0;
        }
    }
    let places = (2.0 * distance / ((std::f64::consts::TAU).sqrt() * sd)).max(1.0);
    let evidence = gains.iter().sum::<f64>() - places.ln();
    let is_held = others >= MIN_KEYPOINTS_PER_SIDE && evidence >= MIN_SIDE_EVIDENCE;
    (!is_held).then_some((ray, distance))
}

/// Median distance of the agreeing points from the camera, map units.
fn typical_distance(matches: &Matches<'_>, pose: &CameraFromWorld, inliers: &[usize]) -> f64 {
    let mut distances: Vec<f64> =
        inliers.iter().map(|&i| (pose.rotation() * matches.points[i] + pose.translation()).norm()).collect();
    upper_median(&mut distances).unwrap_or(f64::NAN)
}

/// The anchor with most distinct keypoints among the inliers (the first of equals), its number of keypoints, and that
/// of all others.
fn richest(matches: &Matches<'_>, inliers: &[usize]) -> (Anchor, [usize; 2]) {
    let keypoints = |of_anchor: &dyn Fn(Anchor) -> bool| {
        matches.keypoints_among(inliers.iter().copied().filter(|&i| of_anchor(matches.anchor[i])))
    };
    let richest = Anchor::first(Anchor::MAX_COUNT)
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

/// Logarithm of the volume of all possible poses of a camera that sees these points: any orientation, anywhere in their
/// region.
pub(crate) fn log_poses<'a>(points: impl Iterator<Item = &'a Vector3<f64>> + Clone) -> f64 {
    (8.0 * std::f64::consts::PI.powi(2)).ln() + log_region(points)
}

/// Log likelihood ratio of each keypoint between this pose and "all its matches are wrong", natural logarithm.
pub(crate) fn gains(matches: &Matches<'_>, likelihoods: &[f64]) -> Vec<f64> {
    // Σ γ and Σ γ ρ of each keypoint.
    let mut keypoints = vec![(0.0, 0.0); matches.keypoints];
    for (i, &llr) in likelihoods.iter().enumerate() {
        let prior = matches.inlier_prior[i];
        let (right, explained): &mut (f64, f64) = &mut keypoints[matches.keypoint[i]];
        *right += prior;
        *explained += (1.0 - prior) * (llr - matches.log_clutter_density[i]).exp();
    }
    keypoints
        .iter()
        .map(|(right, explained)| {
            // At most one match can be right: the priors are scaled to a sum below 1.
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

/// Logarithm of the volume of possible camera positions: the box of the middle 90 % of the points, doubled.
fn log_region<'a>(points: impl Iterator<Item = &'a Vector3<f64>> + Clone) -> f64 {
    let extents = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = points.clone().map(|p| p[axis]).collect();
        values.sort_by(f64::total_cmp);
        let at = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
        2.0 * (at(0.95) - at(0.05))
    });
    // A camera sees a flat scene from outside of it: no side is shorter than half the longest.
    let longest = extents.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    extents.iter().map(|e| e.max(0.5 * longest).ln()).sum()
}
