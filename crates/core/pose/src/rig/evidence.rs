//! What several frames together speak for and against the pose of their rig.
//!
//! # Evidence
//! Frames that see the same thing are not independent witnesses: if its descriptor is mistaken for a map point's once, it
//! is so in every frame, and the frames agree with each other about a place where the device has never been. The evidence
//! is therefore counted by map point: a keypoint whose likeliest point has spoken in `m` frames alike (for the pose, or
//! against it) counts an `m`-th in each. The same image sealed many times is worth what it is worth once.
//!
//! ```text
//! log evidence = max_i G_i − log F + Σ_others log(0.1 + 0.9 exp G_i) + ½ log det(2π C) − log(8π² V)
//! G_i = Σ_keypoints gain / m + (what the frame's freedom to deviate from its odometry costs)
//! ```
//!
//! or what one frame says for itself, if that is more. One frame must speak for the pose; any other may have been hidden, or the odometry may have lost it, and then costs the
//! logarithm of a tenth. `C` is the covariance that the same shares of the frames' information give.

use std::collections::{BTreeMap, BTreeSet};

use veiloc_geometry::deviations::rotation_sd_degrees;
use veiloc_geometry::nalgebra::{Matrix6, Vector3, Vector6};
use veiloc_geometry::statistics::upper_median;
use veiloc_geometry::{Anchor, CameraFromWorld};

use super::joint::Poses;
use super::odometry::{Pull, Tie};
use crate::confidence::{
    Confidence, LEAST_MARGIN, free_direction, gains, least_log_evidence, log_det, log_poses,
};
use crate::likelihood::{
    Correspondences, Estimated, Matches, PosePriors, Symmetric6, inverse_or_infinite, with_shift,
};
use crate::ransac::search::Search;

/// Probability that a frame shows what its rig saw.
const SHOWS: f64 = 0.9;

/// Bits of a map point's coordinates: points are told apart by where they are.
type PointKey = [u64; 3];

/// One frame at the joint pose.
pub(super) struct Witness<'a> {
    pub(super) search: &'a Search<'a>,
    /// Log likelihood ratio of each correspondence, `[N]`.
    pub(super) likelihoods: Vec<f64>,
    pub(super) inliers: Vec<usize>,
    pub(super) information: Matrix6<f64>,
    /// What is known beside the matches says of the camera.
    known: Matrix6<f64>,
    pull: Pull,
    /// Of each keypoint: its gain, and the point that it speaks of, `[K]`.
    gains: Vec<(f64, PointKey)>,
    /// In how many frames that point speaks alike, `[K]`.
    frames: Vec<usize>,
}

/// What is said of a rig's pose.
pub(super) struct FrameEvidence {
    /// Of the rig's pose, by the matches and what is known beside them.
    pub(super) covariance: Symmetric6,
    /// The same by the matches alone.
    pub(super) by_matches: Symmetric6,
    /// Share of the gains that is not said again by another frame, 0 to 1.
    share: f64,
    log_evidence: f64,
}

fn key(point: &Vector3<f64>) -> PointKey {
    [point.x, point.y, point.z].map(f64::to_bits)
}

impl<'a> Witness<'a> {
    /// `focal_sd` is the standard deviation that the logarithm of the focal length had before; `None` when it was not
    /// estimated.
    pub(super) fn new(
        search: &'a Search<'a>,
        tie: &Tie,
        poses: &Poses,
        frame: usize,
        noise: f64,
        focal_sd: Option<f64>,
    ) -> Self {
        let (matches, cam) = (search.matches(), &poses.cams[frame]);
        let likelihoods = search.kernel().likelihoods(cam, noise);
        let inliers = search.agreeing(cam, &likelihoods);
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
        Self {
            search,
            known: search.priors().information(cam),
            information: held_by(search, cam, &likelihoods, &inliers, noise, focal_sd),
            likelihoods,
            inliers,
            pull: tie.pull(&poses.rig, cam),
            gains,
            frames: Vec::new(),
        }
    }

    /// Length of the deviation from the odometry in standard deviations; 0 for a fixed frame.
    pub(super) fn deviation(&self) -> f64 {
        self.pull.step.component_mul(&self.pull.step).dot(&self.pull.precision).sqrt()
    }

    /// Standard deviation that the inliers show, pixels; `None` without inliers.
    pub(super) fn noise_px(&self, cam: &CameraFromWorld) -> Option<f64> {
        let matches = self.search.matches();
        let (mut sum, mut count) = (0.0, 0.0);
        for &i in &self.inliers {
            let right = 1.0 / (1.0 + (-self.likelihoods[i]).exp());
            sum += right * matches.squared_error(i, cam).unwrap_or(0.0);
            count += right * matches.residuals() as f64;
        }
        (count > 0.0).then(|| (sum / count).sqrt())
    }

    /// What the frame gains by the pose, its freedom to deviate paid for, when a point that speaks alike in so many frames
    /// counts for this share.
    fn speaks(&self, tie: &Tie, share: &dyn Fn(usize) -> f64) -> f64 {
        let gained: f64 =
            self.gains.iter().zip(&self.frames).map(|((gain, _), frames)| gain * share(*frames)).sum();
        gained + tie.log_share_left(&(self.information * self.mean(share)), &self.pull) - self.pull.loss
    }

    /// Mean of a weight over what speaks for the pose.
    fn mean(&self, weight: &dyn Fn(usize) -> f64) -> f64 {
        let speaking = || self.gains.iter().zip(&self.frames).filter(|((gain, _), _)| *gain > 0.0);
        let total: f64 = speaking().map(|((gain, _), _)| gain).sum();
        let weighed: f64 = speaking().map(|((gain, _), frames)| gain * weight(*frames)).sum();
        if total > 0.0 { weighed / total } else { 1.0 }
    }
}

/// What a frame's matches alone say of its camera. Where the lines of one anchor give no evidence
/// that they hold the direction that the other's leave free, nothing is said of that.
fn held_by(
    search: &Search<'_>,
    cam: &CameraFromWorld,
    likelihoods: &[f64],
    inliers: &[usize],
    noise: f64,
    focal_sd: Option<f64>,
) -> Matrix6<f64> {
    let (matches, nothing) = (search.matches(), &PosePriors::default());
    let estimated =
        Estimated { matches, priors: nothing, pose: cam, likelihoods, noise, focal_sd, free: None };
    let information = estimated.information();
    let covariance = estimated.covariance();
    let free = (covariance[3][3] < f64::INFINITY)
        .then(|| free_direction(matches, cam, inliers, likelihoods, &covariance))
        .flatten();
    let Some((ray, _)) = free else { return information };
    let direction = Vector6::new(0.0, 0.0, 0.0, ray.x, ray.y, ray.z);
    let along = information * direction;
    let held = direction.dot(&along);
    if held > 0.0 { information - along * along.transpose() / held } else { information }
}

/// Counts in how many frames each point speaks alike.
fn compare(witnesses: &mut [Witness<'_>]) {
    let mut frames: BTreeMap<(PointKey, bool), BTreeSet<usize>> = BTreeMap::new();
    for (f, witness) in witnesses.iter().enumerate() {
        for (gain, point) in &witness.gains {
            frames.entry((*point, *gain > 0.0)).or_default().insert(f);
        }
    }
    for witness in witnesses {
        let of = |(gain, point): &(f64, PointKey)| frames[&(*point, *gain > 0.0)].len();
        witness.frames = witness.gains.iter().map(of).collect();
    }
}

/// What the frames say of the rig's pose, `[F]` in both lists.
pub(super) fn verdict(witnesses: &mut [Witness<'_>], ties: &[Tie]) -> FrameEvidence {
    compare(witnesses);
    let all = |_: usize| 1.0;
    let once = |frames: usize| (frames as f64).recip();
    // Half of the variance of a residual is taken to be the map point's own, which more frames do not average out.
    let averaged = |frames: usize| 2.0 / (1.0 + frames as f64);
    let alone = over_rig(witnesses, ties, &all);
    let together =
        |share: &dyn Fn(usize) -> f64| over_rig(witnesses, ties, share).iter().sum::<Matrix6<f64>>();

    let points = || witnesses.iter().flat_map(|w| w.search.matches().points.iter());
    let log_evidence = |gained: f64, information: &Matrix6<f64>| {
        let log_det = log_det(&(information / std::f64::consts::TAU));
        log_det.map_or(f64::NEG_INFINITY, |log_det| gained - 0.5 * log_det - log_poses(points()))
    };
    let log_frames = (witnesses.len() as f64).ln();
    let mut spoken: Vec<f64> = witnesses.iter().zip(ties).map(|(w, tie)| w.speaks(tie, &once)).collect();
    spoken.sort_by(|a, b| b.total_cmp(a));
    let softly = |gained: &f64| (gained + SHOWS.ln()).max((1.0 - SHOWS).ln());
    let gained = spoken[0] + spoken[1..].iter().map(softly).sum::<f64>();
    let joint = log_evidence(gained - log_frames, &together(&once));
    // What one frame says for itself is not less for what the others say.
    let of_one = |((w, tie), own): ((&Witness<'_>, &Tie), &Matrix6<f64>)| {
        log_evidence(w.speaks(tie, &all) - log_frames, own)
    };
    let evidence = witnesses.iter().zip(ties).zip(&alone).map(of_one).fold(joint, f64::max);

    // Nor is the rig held less firmly for them.
    let log_held = |information: &Matrix6<f64>| log_det(information).unwrap_or(f64::NEG_INFINITY);
    let joint = together(&averaged);
    let held = alone.into_iter().fold(joint, |a, b| if log_held(&b) > log_held(&a) { b } else { a });
    let known = witnesses.iter().zip(ties).map(|(w, tie)| tie.information_over_rig(&w.known, &w.pull));
    let with_known = held + known.sum::<Matrix6<f64>>();

    let (total, single) = witnesses.iter().fold((0.0, 0.0), |(total, single), w| {
        let gained: f64 = w.gains.iter().map(|(gain, _)| gain.max(0.0)).sum();
        (total + gained, single + gained * w.mean(&once))
    });
    FrameEvidence {
        covariance: inverse_or_infinite(&with_known),
        by_matches: inverse_or_infinite(&held),
        share: if total > 0.0 { single / total } else { 1.0 },
        log_evidence: evidence,
    }
}

/// What each frame says of the rig, `[F]`, when a point that speaks alike in so many frames counts for this share.
fn over_rig(witnesses: &[Witness<'_>], ties: &[Tie], share: &dyn Fn(usize) -> f64) -> Vec<Matrix6<f64>> {
    let of =
        |(w, tie): (&Witness<'_>, &Tie)| tie.information_over_rig(&(w.information * w.mean(share)), &w.pull);
    witnesses.iter().zip(ties).map(of).collect()
}

impl FrameEvidence {
    /// The pose may be off by this step beside its noise.
    pub(super) fn shift(&mut self, step: &[f64; 6]) {
        self.covariance = with_shift(&self.covariance, step);
        self.by_matches = with_shift(&self.by_matches, step);
    }

    /// What the best other pose must be beaten by, before it is told how much of that counts once.
    pub(super) fn least_margin(&self) -> f64 {
        LEAST_MARGIN / self.share
    }

    /// All that speaks for and against the pose, when it beats the best other one by `margin`.
    pub(super) fn confidence(&self, witnesses: &[Witness<'_>], poses: &Poses, margin: f64) -> Confidence {
        let mut distances: Vec<f64> = witnesses
            .iter()
            .zip(&poses.cams)
            .flat_map(|(w, cam)| {
                let points = &w.search.matches().points;
                w.inliers.iter().map(|&i| (cam.rotation() * points[i] + cam.translation()).norm())
            })
            .collect();
        let least = witnesses.iter().map(|w| least_log_evidence(w.search.matches()));
        let told = Confidence {
            least_log_evidence: least.fold(0.0, f64::max),
            log_evidence: self.log_evidence,
            margin: margin * self.share,
            center_sd: 0.0,
            center_sd_relative: 0.0,
            held_relative: 0.0,
            held_rotation_deg: rotation_sd_degrees(&self.by_matches),
            distance: upper_median(&mut distances).unwrap_or(f64::NAN),
            rotation_sd_deg: 0.0,
            other_focal: None,
            sides: sides(witnesses),
        };
        told.with_covariances(&self.covariance, &self.by_matches)
    }
}

/// Different map points that agree with the anchor that has most of them and with all others, over all frames; `None` where no
/// frame has anchors.
fn sides(witnesses: &[Witness<'_>]) -> Option<[usize; 2]> {
    let anchored: Vec<(&Matches<'_>, &[usize])> = witnesses
        .iter()
        .map(|w| (w.search.matches(), w.inliers.as_slice()))
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
    let richest = Anchor::first(Anchor::MOST).rev().max_by_key(|a| own(*a))?;
    Some([own(richest), different(&|a| a != richest)])
}
