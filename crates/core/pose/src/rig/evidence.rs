//! Confidence of a pose from one frame or several.
//!
//! # Evidence
//! Frames that see the same points are not independent: if a descriptor is mistaken for that of a map point once, it is
//! so in every frame, and the frames agree on a place where the device has never been. Therefore the evidence is
//! counted by map point: a keypoint whose likeliest point has evidence of the same sign (for the pose, or against it)
//! in `m` frames counts an `m`-th in each. Copies of one image count as one image.
//!
//! ```text
//! log evidence = max_i G_i − log F + Σ_others log(0.1 + 0.9 exp G_i) + ½ log det(2π C) − log(8π² V)
//! G_i = Σ_keypoints gain / m + (cost of the frame's freedom to deviate from its odometry)
//! ```
//!
//! or the evidence of one frame alone, if that is more. One frame must support the pose; any other may have been
//! hidden, or its odometry may be wrong, at the cost of the logarithm of a tenth. `C` is the covariance from the same
//! shares of the frames' information.

use std::collections::{BTreeMap, BTreeSet};

use veiloc_geometry::nalgebra::{Matrix6, Vector3, Vector6};
use veiloc_geometry::statistics::upper_median;
use veiloc_geometry::{Anchor, CameraFromWorld};

use super::frame::{Frame, agreeing};
use super::joint::Poses;
use super::odometry::{Deviation, OdometryConstraint};
use crate::confidence::{
    Confidence, MIN_MARGIN, free_direction, gains, log_det, log_poses, min_log_evidence,
};
use crate::likelihood::{
    Correspondences, CovarianceInputs, Matches, PosePriors, Symmetric6, inverse_or_infinite,
};

/// Probability that a frame shows the part of the scene that its pose predicts.
const VISIBLE_PROBABILITY: f64 = 0.9;

/// Bits of a map point's coordinates, which identify the point.
type PointKey = [u64; 3];

/// One frame at the joint pose.
pub(super) struct FrameContribution<'a> {
    pub(super) frame: &'a Frame<'a>,
    /// Log likelihood ratio of each correspondence, `[N]`.
    pub(super) likelihoods: Vec<f64>,
    pub(super) inliers: Vec<usize>,
    /// Information of the matches, as if their errors were independent.
    pub(super) information: Matrix6<f64>,
    /// Variance of errors that neighbouring matches share, in multiples of that of independent ones.
    design_effect: f64,
    /// A direction of translation that the matches of a frame leave free which is the only one, a unit vector of the
    /// camera frame, with the distance of the scene.
    pub(super) free: Option<(Vector3<f64>, f64)>,
    pub(super) deviation: Deviation,
    /// For each keypoint: its gain, and its likeliest map point, `[K]`.
    gains: Vec<(f64, PointKey)>,
    /// In how many frames that point has a gain of the same sign, `[K]`.
    frames: Vec<usize>,
}

/// Evidence and information of a pose, from the matches alone.
pub(super) struct FrameEvidence {
    /// Information, with the errors that neighbouring matches share and what frames repeat.
    pub(super) information: Matrix6<f64>,
    /// Covariance as if all errors were independent.
    pub(super) independent: Symmetric6,
    /// Share of the gains that no other frame repeats, 0 to 1.
    share: f64,
    log_evidence: f64,
}

fn key(point: &Vector3<f64>) -> PointKey {
    [point.x, point.y, point.z].map(f64::to_bits)
}

impl<'a> FrameContribution<'a> {
    /// `focal_sd` is the prior standard deviation of the logarithm of the focal length; `None` when it was not
    /// estimated. `is_alone`: there is no other frame.
    pub(super) fn new(
        frame: &'a Frame<'a>,
        deviation: Deviation,
        cam: &CameraFromWorld,
        noise: f64,
        focal_sd: Option<f64>,
        is_alone: bool,
    ) -> Self {
        let matches = frame.matches();
        let likelihoods = frame.kernel().likelihoods(cam, noise);
        let inliers = agreeing(&likelihoods);
        // The likeliest correspondence of each keypoint.
        let mut likeliest: Vec<Option<usize>> = vec![None; matches.keypoints];
        for i in 0..matches.len() {
            let known = &mut likeliest[matches.keypoint[i]];
            if known.is_none_or(|k| likelihoods[i] > likelihoods[k]) {
                *known = Some(i);
            }
        }
        let gains = gains(matches, &likelihoods)
            .into_iter()
            .zip(&likeliest)
            .filter_map(|(gain, i)| i.map(|i| (gain, key(&matches.points[i]))))
            .collect();
        let inputs = CovarianceInputs {
            matches,
            priors: &PosePriors::default(),
            pose: cam,
            likelihoods: &likelihoods,
            noise,
            focal_sd,
            design_effect: 1.0,
            free: None,
        };
        let (information, free) = information_from_matches(inputs, &inliers, is_alone);
        Self {
            frame,
            design_effect: frame.design_effect(cam, &likelihoods, noise),
            information,
            free,
            likelihoods,
            inliers,
            deviation,
            gains,
            frames: Vec::new(),
        }
    }

    /// Information of the matches, with the errors that they share with neighbouring matches and with other frames.
    pub(super) fn information_with_shared_errors(&self) -> Matrix6<f64> {
        self.information * (self.share() / self.design_effect)
    }

    /// The share of the frame's information that other frames do not repeat.
    pub(super) fn share(&self) -> f64 {
        self.mean(&averaged)
    }

    /// Number of keypoints that agree.
    pub(super) fn inlier_keypoints(&self) -> usize {
        self.frame.matches().keypoints_among(self.inliers.iter().copied())
    }

    /// Length of the deviation from the odometry in standard deviations; 0 for a fixed frame.
    pub(super) fn deviation(&self) -> f64 {
        self.deviation.step.component_mul(&self.deviation.step).dot(&self.deviation.precision).sqrt()
    }

    /// Standard deviation that the inliers show, pixels; `None` without inliers.
    pub(super) fn noise_px(&self, cam: &CameraFromWorld) -> Option<f64> {
        let matches = self.frame.matches();
        let (mut sum, mut count) = (0.0, 0.0);
        for &i in &self.inliers {
            let right = 1.0 / (1.0 + (-self.likelihoods[i]).exp());
            sum += right * matches.squared_error(i, cam).unwrap_or(0.0);
            count += right * matches.residuals() as f64;
        }
        (count > 0.0).then(|| (sum / count).sqrt())
    }

    /// The frame's gain by the pose, minus the cost of its freedom to deviate, when a point with the same sign in a
    /// number of frames counts for this share.
    fn net_gain(&self, constraint: &OdometryConstraint, share: &dyn Fn(usize) -> f64) -> f64 {
        let gained: f64 =
            self.gains.iter().zip(&self.frames).map(|((gain, _), frames)| gain * share(*frames)).sum();
        gained + constraint.log_share_left(&(self.information * self.mean(share)), &self.deviation)
            - self.deviation.loss
    }

    /// Mean of a weight over the positive gains.
    fn mean(&self, weight: &dyn Fn(usize) -> f64) -> f64 {
        let positive = || self.gains.iter().zip(&self.frames).filter(|((gain, _), _)| *gain > 0.0);
        let total: f64 = positive().map(|((gain, _), _)| gain).sum();
        let weighed: f64 = positive().map(|((gain, _), frames)| gain * weight(*frames)).sum();
        if total > 0.0 { weighed / total } else { 1.0 }
    }
}

/// Information of a frame's matches alone about its camera, as if errors were independent. If the lines of one anchor
/// give no evidence for the direction that those of the other leave free, other frames may hold it: the information
/// along it is removed. Without another frame the direction is returned, and the pose is anywhere along it within the
/// distance of the scene.
fn information_from_matches(
    inputs: CovarianceInputs<'_>,
    inliers: &[usize],
    is_alone: bool,
) -> (Matrix6<f64>, Option<(Vector3<f64>, f64)>) {
    let (covariance, information) = inputs.covariance_and_information();
    let free = (is_alone || covariance[3][3] < f64::INFINITY)
        .then(|| free_direction(inputs.matches, inputs.pose, inliers, inputs.likelihoods, &covariance))
        .flatten();
    match free {
        Some(_) if is_alone => (CovarianceInputs { free, ..inputs }.covariance_and_information().1, free),
        Some((ray, _)) => {
            let direction = Vector6::new(0.0, 0.0, 0.0, ray.x, ray.y, ray.z);
            let along = information * direction;
            let of_direction = direction.dot(&along);
            let rest = along * along.transpose() / of_direction;
            (if of_direction > 0.0 { information - rest } else { information }, None)
        }
        None => (information, None),
    }
}

/// Weight of a match in each of a number of frames: half of the variance of a residual is assumed to be the map point's
/// own, which more frames do not average out.
fn averaged(frames: usize) -> f64 {
    2.0 / (1.0 + frames as f64)
}

/// Counts in how many frames each point has a gain of the same sign.
fn count_shared_points(contributions: &mut [FrameContribution<'_>]) {
    if let [alone] = contributions {
        alone.frames = vec![1; alone.gains.len()];
        return;
    }
    let mut frames: BTreeMap<(PointKey, bool), BTreeSet<usize>> = BTreeMap::new();
    for (f, contribution) in contributions.iter().enumerate() {
        for (gain, point) in &contribution.gains {
            frames.entry((*point, *gain > 0.0)).or_default().insert(f);
        }
    }
    for contribution in contributions {
        let of = |(gain, point): &(f64, PointKey)| frames[&(*point, *gain > 0.0)].len();
        contribution.frames = contribution.gains.iter().map(of).collect();
    }
}

/// Combines the frames' evidence for the rig's pose, `[F]` in both lists.
pub(super) fn combine_evidence(
    contributions: &mut [FrameContribution<'_>],
    constraints: &[OdometryConstraint],
) -> FrameEvidence {
    count_shared_points(contributions);
    let all = |_: usize| 1.0;
    let once = |frames: usize| (frames as f64).recip();
    let alone = over_rig(contributions, constraints, &|_| 1.0);
    let repeated_once = over_rig(contributions, constraints, &|w| w.mean(&once));
    let independent = inverse_or_infinite(&alone.iter().sum());

    let points = || contributions.iter().flat_map(|w| w.frame.matches().points.iter());
    let log_evidence = |gained: f64, information: &Matrix6<f64>| {
        let log_det = log_det(&(information / std::f64::consts::TAU));
        log_det.map_or(f64::NEG_INFINITY, |log_det| gained - 0.5 * log_det - log_poses(points()))
    };
    let log_frames = (contributions.len() as f64).ln();
    let mut gains_by_frame: Vec<f64> =
        contributions.iter().zip(constraints).map(|(w, constraint)| w.net_gain(constraint, &once)).collect();
    gains_by_frame.sort_by(|a, b| b.total_cmp(a));
    let with_hidden_alternative =
        |gained: &f64| (gained + VISIBLE_PROBABILITY.ln()).max((1.0 - VISIBLE_PROBABILITY).ln());
    let gained = gains_by_frame[0] + gains_by_frame[1..].iter().map(with_hidden_alternative).sum::<f64>();
    let joint = log_evidence(gained - log_frames, &repeated_once.iter().sum());
    // The evidence of one frame alone is a lower bound.
    let of_one = |((w, constraint), own): ((&FrameContribution<'_>, &OdometryConstraint), &Matrix6<f64>)| {
        log_evidence(w.net_gain(constraint, &all) - log_frames, own)
    };
    let evidence = contributions.iter().zip(constraints).zip(&alone).map(of_one).fold(joint, f64::max);

    // So is its information, here with the errors that neighbouring matches share.
    let log_det_of = |information: &Matrix6<f64>| log_det(information).unwrap_or(f64::NEG_INFINITY);
    let alone = over_rig(contributions, constraints, &|w| w.design_effect.recip());
    let joint = over_rig(contributions, constraints, &|w| w.share() / w.design_effect);
    let information = alone
        .into_iter()
        .fold(joint.iter().sum(), |a: Matrix6<f64>, b| if log_det_of(&b) > log_det_of(&a) { b } else { a });
    let (total, single) = contributions.iter().fold((0.0, 0.0), |(total, single), w| {
        let gained: f64 = w.gains.iter().map(|(gain, _)| gain.max(0.0)).sum();
        (total + gained, single + gained * w.mean(&once))
    });
    FrameEvidence {
        information,
        independent,
        share: if total > 0.0 { single / total } else { 1.0 },
        log_evidence: evidence,
    }
}

/// Information of each frame about the rig, `[F]`, when that of the frame's matches counts for a share.
fn over_rig(
    contributions: &[FrameContribution<'_>],
    constraints: &[OdometryConstraint],
    share: &dyn Fn(&FrameContribution<'_>) -> f64,
) -> Vec<Matrix6<f64>> {
    let of = |(w, constraint): (&FrameContribution<'_>, &OdometryConstraint)| {
        constraint.information_over_rig(&(w.information * share(w)), &w.deviation)
    };
    contributions.iter().zip(constraints).map(of).collect()
}

impl FrameEvidence {
    /// Required margin over the best other pose, before repeated gains are discounted.
    pub(super) fn min_margin(&self) -> f64 {
        MIN_MARGIN / self.share
    }

    /// The confidence of the pose for a given margin over the best other one, as far as it does not depend on the final
    /// covariances.
    pub(super) fn confidence(
        &self,
        contributions: &[FrameContribution<'_>],
        poses: &Poses,
        margin: f64,
    ) -> Confidence {
        let mut distances: Vec<f64> = contributions
            .iter()
            .zip(&poses.cams)
            .flat_map(|(w, cam)| {
                let points = &w.frame.matches().points;
                w.inliers.iter().map(|&i| (cam.rotation() * points[i] + cam.translation()).norm())
            })
            .collect();
        let least = contributions.iter().map(|w| min_log_evidence(w.frame.matches())).fold(0.0, f64::max);
        let distance = upper_median(&mut distances).unwrap_or(f64::NAN);
        Confidence::new([self.log_evidence, least], margin * self.share, distance, sides(contributions))
    }
}

/// Numbers of different map points that agree with the richest anchor and with all others, over all frames; `None` when
/// no frame has anchors.
fn sides(contributions: &[FrameContribution<'_>]) -> Option<[usize; 2]> {
    let anchored: Vec<(&Matches<'_>, &[usize])> = contributions
        .iter()
        .map(|w| (w.frame.matches(), w.inliers.as_slice()))
        .filter(|(matches, _)| matches!(matches.observations, Correspondences::Anchored { .. }))
        .collect();
    if anchored.is_empty() {
        return None;
    }
    let different = |of: &dyn Fn(Anchor) -> bool| {
        let mut points = BTreeSet::new();
        let mut keypoints = 0;
        for (matches, inliers) in &anchored {
            let side: Vec<usize> = inliers.iter().copied().filter(|&i| of(matches.anchor[i])).collect();
            points.extend(side.iter().map(|&i| key(&matches.points[i])));
            keypoints += matches.keypoints_among(side.into_iter());
        }
        points.len().min(keypoints)
    };
    let own = |anchor: Anchor| different(&|a| a == anchor);
    let richest = Anchor::first(Anchor::MAX_COUNT).rev().max_by_key(|a| own(*a))?;
    Some([own(richest), different(&|a| a != richest)])
}
