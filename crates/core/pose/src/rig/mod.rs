//! The pose of a rig: one pose for several frames of a device that measured their relative poses.
//!
//! [`estimate_rig_pose`] is the entry point. Hypotheses come from each frame's own minimal solver, more often from
//! promising frames, and are transferred to the rig by the odometry (`odometry.rs`); each is scored on all frames
//! (`search.rs`). Local optimisation and the final refinement (`joint.rs`, `polish.rs`) move all poses together: six
//! parameters of the rig and six of each frame that may deviate, constrained by the odometry. A frame with too few
//! matches for a pose of its own still contributes, and one that contradicts the others has no influence. `evidence.rs`
//! decides whether to trust the result, and why many frames are not independent.

mod cameras;
mod evidence;
mod focal;
mod frame;
mod joint;
mod odometry;
mod polish;
mod search;

use rand::Rng;
use veiloc_geometry::{CameraFromRig, CameraFromWorld, RigFromWorld};

use self::cameras::RigCameras;
use self::evidence::{FrameContribution, combine_evidence};
use self::focal::{Lens, RefinedRig, refine_focal_lengths, worst_known};
use self::frame::{Frame, has_minimal_sample, scene_size};
use self::joint::Poses;
use self::odometry::OdometryConstraint;
use self::search::RigSearch;
use crate::confidence::Confidence;
use crate::copies::WithoutCopies;
use crate::error::PoseError;
use crate::focal_search::{BestCost, WithConfidence, is_clear, over_focal_lengths};
use crate::likelihood::{FocalPrior, FocalVerdict, Matches, PoseProblem};
use crate::options::{PoseOptions, ScoreKind};
use crate::ransac::lo_ransac;
use crate::rival::{OtherMatches, Weight, budget, has_weight, problem_of};

/// One image of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigFrame {
    /// Its correspondences with the map; may be too few for a pose.
    pub problem: PoseProblem,
    /// Its pose on the rig, from the device's odometry.
    pub cam_from_rig: CameraFromRig,
    /// Standard deviation of that rotation about each axis, degrees; deviations of different frames are assumed to be
    /// independent. With 0 here and in [`Self::translation_sd`] the frame is fixed to the rig.
    pub rotation_sd_deg: f64,
    /// Standard deviation of the camera's position on the rig along each axis, map units.
    pub translation_sd: f64,
}

/// The pose of a rig, and its uncertainty.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RigEstimate {
    /// The pose of the rig.
    pub rig_from_world: RigFromWorld,
    /// Its covariance in the chart of [`RigFromWorld::perturbed`] (radians, then map units), the frames' deviations
    /// marginalised out. Infinite on the diagonal when the frames leave a direction free.
    pub covariance: [[f64; 6]; 6],
    /// The same from the matches alone, without camera priors: the basis of trust.
    pub covariance_by_matches: [[f64; 6]; 6],
    /// What errors of the cameras add to both, included in them.
    pub camera_covariance: [[f64; 6]; 6],
    /// Whether to trust the pose.
    pub confidence: Confidence,
    /// Each frame, `[F]`, in the order given.
    pub frames: Vec<FrameEstimate>,
    /// Minimal samples drawn, of all frames together, with the focal length of the final search.
    pub hypotheses: usize,
    /// The minimised cost, lower is better: minus the gain of the frames by the pose, natural logarithm; large gains of
    /// a frame are saturated.
    pub score: f64,
    /// Whether the final refinement was accepted. It is rejected when it makes the objective worse.
    pub refined: bool,
}

/// One frame of a rig at the joint pose.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FrameEstimate {
    /// The pose of its camera: given by the odometry, corrected as far as its matches require and the odometry allows.
    pub cam_from_world: CameraFromWorld,
    /// Which correspondences agree with it, `[N]`.
    pub inliers: Vec<bool>,
    /// How many do.
    pub inlier_count: usize,
    /// How many keypoints they belong to.
    pub inlier_keypoints: usize,
    /// Estimated focal length relative to the given one, the same for all frames of one camera; 1 when it was not
    /// estimated.
    pub focal_scale: f64,
    /// Standard deviation that the inliers show, pixels; `None` without inliers.
    pub noise_px: Option<f64>,
    /// Distance of the camera from its pose by the odometry, in standard deviations (the norm of six numbers: 2.4 on
    /// average when the odometry's deviations are correct); 0 for a frame that is fixed to the rig.
    pub odometry_deviation: f64,
}

impl RigEstimate {
    /// [`Self::covariance`] without the part that is due to the camera models: the noise of keypoints and map points
    /// alone.
    pub fn noise_covariance(&self) -> [[f64; 6]; 6] {
        std::array::from_fn(|i| std::array::from_fn(|j| self.covariance[i][j] - self.camera_covariance[i][j]))
    }

    /// Covariance of the rig's origin in the world frame, map units squared.
    pub fn center_covariance(&self) -> [[f64; 3]; 3] {
        self.rig_from_world.center_covariance(&self.covariance)
    }
}

/// Estimates the pose of a rig from all its frames.
///
/// Frames without correspondences, with too few of them, or with all lines of one anchor are allowed beside one that
/// has enough for a hypothesis. Equal frames, options and generator states give equal estimates; a single frame without
/// deviation gives the result of [`crate::estimate_pose`], unless its camera is wrong: a rig's cameras are doubted, and
/// only their focal lengths are estimated.
///
/// # Errors
/// [`PoseError`]: no frame, a frame that is inconsistent or not finite, no frame with enough correspondences for a
/// hypothesis, the score [`ScoreKind::Msac`] (which cannot weigh frames), or no pose with enough inliers.
pub fn estimate_rig_pose<R: Rng + ?Sized>(
    frames: &[RigFrame],
    options: &PoseOptions,
    rng: &mut R,
) -> Result<RigEstimate, PoseError> {
    options.check()?;
    if options.score == Some(ScoreKind::Msac) {
        return Err(PoseError::ScoreOfRig);
    }
    if frames.is_empty() {
        return Err(PoseError::NoFrames);
    }
    for (frame, given) in frames.iter().enumerate() {
        has_minimal_sample(&given.problem)
            .map_err(|source| PoseError::Frame { frame, source: Box::new(source) })?;
    }
    let without: Vec<Option<WithoutCopies>> =
        frames.iter().map(|frame| WithoutCopies::of(&frame.problem)).collect();
    if without.iter().all(Option::is_none) {
        return estimate_without_copies(frames, options, rng);
    }
    let fewer: Vec<RigFrame> = frames
        .iter()
        .zip(&without)
        .map(|(frame, without)| match without {
            Some(without) => RigFrame { problem: without.problem.clone(), ..frame.clone() },
            None => frame.clone(),
        })
        .collect();
    let mut estimate = estimate_without_copies(&fewer, options, rng)?;
    for (frame, without) in estimate.frames.iter_mut().zip(&without) {
        if let Some(without) = without {
            frame.inliers = without.expand(&frame.inliers);
            frame.inlier_count = frame.inliers.iter().filter(|is_inlier| **is_inlier).count();
        }
    }
    Ok(estimate)
}

/// [`estimate_rig_pose`] for frames without copies.
fn estimate_without_copies<R: Rng + ?Sized>(
    frames: &[RigFrame],
    options: &PoseOptions,
    rng: &mut R,
) -> Result<RigEstimate, PoseError> {
    let mut alone = Vec::with_capacity(frames.len());
    for (frame, given) in frames.iter().enumerate() {
        let of_frame = |source| PoseError::Frame { frame, source: Box::new(source) };
        given.check_odometry().map_err(of_frame)?;
        alone.push(has_minimal_sample(&given.problem).map_err(of_frame)?);
    }
    // Frames with correspondences.
    let shown: Vec<usize> = (0..frames.len()).filter(|&i| !frames[i].problem.points.is_empty()).collect();
    let given: Vec<Matches<'_>> =
        shown.iter().map(|&i| Matches::new(&frames[i].problem, options.expected_inlier_ratio)).collect();
    let checked = CheckedFrames { frames, alone, shown, given };
    let focal = worst_known(checked.shown.iter().map(|&i| frames[i].problem.focal));
    let mut cost = BestCost::default();
    let best = over_focal_lengths(focal, options, |factor, options| {
        let mut search = |times, rng: &mut R| {
            let found = checked.search_at(factor, focal, options, times, &mut cost, rng);
            found.map(|estimate| RigResult { estimate, frames })
        };
        let found = search(1, rng);
        if factor != 1.0 || !checked.may_have_missed(&found, options) {
            return found;
        }
        let again = search(RETRY_SAMPLE_FACTOR, rng);
        let score =
            |of: &Result<RigResult<'_>, PoseError>| of.as_ref().map_or(f64::INFINITY, |of| of.estimate.score);
        if score(&again) < score(&found) { again } else { found }
    });
    if options.stop.is_set() {
        return Err(PoseError::Stopped);
    }
    let mut best = best?.estimate;
    if options.fixed_hypotheses.is_none() {
        best.confidence.rival_log_evidence = find_rival(&checked, &best, options, rng);
    }
    Ok(best)
}

/// Log evidence of the best pose from the matches that do not agree with an estimate, of all frames together, as for a
/// single image ([`crate::rival`]).
fn find_rival<R: Rng + ?Sized>(
    checked: &CheckedFrames<'_>,
    estimate: &RigEstimate,
    options: &PoseOptions,
    rng: &mut R,
) -> Option<f64> {
    let mut weights = [Weight::default(); 2];
    let mut rest: Vec<RigFrame> = Vec::with_capacity(checked.shown.len());
    for (&f, matches) in checked.shown.iter().zip(&checked.given) {
        let (frame, found) = (&checked.frames[f], &estimate.frames[f]);
        let camera = matches.camera_with_focal(found.focal_scale);
        let others = OtherMatches::of(
            matches,
            &frame.problem,
            &found.inliers,
            &found.cam_from_world,
            camera,
            options.noise_px,
        );
        // A frame that contradicts the others supports a pose of its own; the others outvote it.
        let [own, other] = others.weights;
        if !has_weight([other, own]) {
            continue;
        }
        weights = [0, 1].map(|k| weights[k] + others.weights[k]);
        rest.push(RigFrame { problem: problem_of(&frame.problem, &others.indices, camera), ..frame.clone() });
    }
    rest.retain(|frame| !frame.problem.points.is_empty());
    if !has_weight(weights) {
        return None;
    }
    let alone: Vec<bool> =
        rest.iter().map(|frame| has_minimal_sample(&frame.problem)).collect::<Result<_, _>>().ok()?;
    let sample_size = rest.first()?.problem.observations.sample_size();
    let budget = budget(weights, sample_size);
    let options = PoseOptions {
        min_hypotheses: budget.min,
        max_hypotheses: budget.max,
        confidence: budget.confidence,
        ..options.clone()
    };
    let given = rest.iter().map(|f| Matches::new(&f.problem, options.expected_inlier_ratio)).collect();
    let others = CheckedFrames { frames: &rest, alone, shown: (0..rest.len()).collect(), given };
    let cost = &mut BestCost::default();
    let rival = others.search_at(1.0, FocalPrior::Calibrated, &options, 1, cost, rng).ok()?;
    estimate.confidence.rival(&rival.confidence)
}

/// If a search over several frames leaves a doubt, it is repeated with this multiple of the minimum number of samples
/// per frame: there are many matches in all frames together and few in each, and loose odometry with precise matches
/// lets enough of them agree with a wrong pose for the search to stop early. On RedKitchen's trajectory with every
/// tenth image mapped, recall of dcl at 5 cm/5°: 79, 86 and 97 % for two, four and eight frames without, 83, 90 and 100
/// % with (`veiloc eval rig --stress sparse-map`).
const RETRY_SAMPLE_FACTOR: usize = 4;

/// Frames that have passed their check.
struct CheckedFrames<'a> {
    frames: &'a [RigFrame],
    /// Which of them can give hypotheses, `[F]`.
    alone: Vec<bool>,
    /// Indices of those with correspondences.
    shown: Vec<usize>,
    /// Their correspondences, with the given focal lengths.
    given: Vec<Matches<'a>>,
}

impl CheckedFrames<'_> {
    /// Number of frames that can give hypotheses.
    fn drawn(&self) -> usize {
        self.alone.iter().filter(|alone| **alone).count()
    }

    /// Whether more samples may find a better pose. For one frame the search itself decides when it is complete.
    fn may_have_missed(&self, found: &Result<RigResult<'_>, PoseError>, options: &PoseOptions) -> bool {
        self.drawn() > 1 && options.fixed_hypotheses.is_none() && !is_clear(found)
    }

    /// Searches with the given focal lengths multiplied by a factor, for those frames whose focal length is known no
    /// better than this. With `times` above 1 it draws at least this multiple of the samples of a single-frame search
    /// for every frame.
    fn search_at<R: Rng + ?Sized>(
        &self,
        factor: f64,
        focal: FocalPrior,
        options: &PoseOptions,
        times: usize,
        best_cost: &mut BestCost,
        rng: &mut R,
    ) -> Result<RigEstimate, PoseError> {
        if options.stop.is_set() {
            return Err(PoseError::Stopped);
        }
        let frames = self.frames;
        let zoomed: Vec<Matches<'_>> = (self.shown.iter().zip(&self.given))
            .map(|(&i, m)| m.with_focal(if frames[i].problem.focal == focal { factor } else { 1.0 }))
            .collect();
        let ready =
            self.shown.iter().zip(self.given.iter().zip(&zoomed)).map(|(&i, (given, zoomed))| {
                Frame::new(i, &frames[i], given, zoomed, self.alone[i], options)
            });
        let constraints =
            self.shown.iter().zip(&self.given).map(|(&i, m)| frames[i].constraint(scene_size(m, &frames[i])));
        let mut search = RigSearch::new(ready.collect(), constraints.collect(), options.noise_px)
            .ok_or(PoseError::NoFrameAlone { frames: frames.len() })?
            .with_stop(&options.stop);
        let mut budget = options.budget(self.drawn());
        if times > 1 {
            budget.min = budget.min.saturating_mul(times * self.drawn()).min(budget.max);
        }
        let found = lo_ransac(&mut search, &budget, rng);
        if options.stop.is_set() {
            return Err(PoseError::Stopped);
        }
        let no_consensus = |inliers| PoseError::NoConsensus {
            inliers,
            required: options.min_inliers,
            hypotheses: found.samples,
        };
        let Some(best) = found.model.filter(|_| best_cost.is_near(found.cost)) else {
            return Err(no_consensus(0));
        };
        let RefinedRig { polished, lenses } =
            refine_focal_lengths(&mut search, &best, factor, frames, options);
        let poses = &polished.poses;
        let lens_of = |f: usize| lenses.iter().find(|lens| lens.frames.contains(&f));
        let mut contributions: Vec<FrameContribution<'_>> = search
            .frames
            .iter()
            .enumerate()
            .map(|(f, frame)| {
                let focal_sd = lens_of(f).and_then(Lens::estimated_sd);
                FrameContribution::new(
                    &frame.search,
                    &search.constraints[f],
                    poses,
                    f,
                    polished.noise[f],
                    focal_sd,
                )
            })
            .collect();
        let inlier_keypoints: usize =
            contributions.iter().map(|w| w.search.matches().keypoints_among(w.inliers.iter().copied())).sum();
        if inlier_keypoints < options.min_inliers {
            return Err(no_consensus(inlier_keypoints));
        }
        let mut evidence = combine_evidence(&mut contributions, &search.constraints);
        let margin = search.margin(poses, &evidence.by_matches, evidence.min_margin(), options);
        let mut confidence = evidence.confidence(&contributions, poses, margin);
        confidence.log_evidence -= search.prior_loss(&poses.cams);
        let cameras = RigCameras::new(&search, &polished, &lenses, &contributions, frames, options);
        evidence.add(&cameras.covariance);
        confidence.is_camera_contradicted = cameras.is_contradicted;
        // A pose may be wrong by the effect of another focal length, where the effect is too small to estimate that.
        for lens in &lenses {
            if let FocalVerdict::Suspicious { other, .. } = lens.verdict {
                let rig = RigFromWorld::new(*other.pose.rotation(), *other.pose.translation());
                evidence.shift(&poses.rig.step_to(&rig));
            }
        }
        confidence = confidence.with_covariances(&evidence.covariance, &evidence.by_matches);
        confidence.position_deviation = search.position_deviation(&poses.cams, &evidence.by_matches);
        // What the map's cameras cause, they cause in each frame.
        let of_map = |lens: &Lens| -> f64 {
            lens.frames
                .iter()
                .map(|&f| frames[search.frames[f].index].problem.map_cameras.min_focal_gain)
                .sum()
        };
        confidence.other_focal =
            lenses.iter().find_map(|lens| lens.verdict.suspected_focal_scale(of_map(lens)));
        let mut frame_estimates = frame_estimates(frames, &search.frames, &contributions, poses);
        for (f, frame) in search.frames.iter().enumerate() {
            frame_estimates[frame.index].focal_scale = lens_of(f).map_or(1.0, |lens| lens.factor);
        }
        Ok(RigEstimate {
            rig_from_world: poses.rig,
            covariance: evidence.covariance,
            covariance_by_matches: evidence.by_matches,
            camera_covariance: cameras.covariance,
            confidence,
            frames: frame_estimates,
            hypotheses: found.samples,
            score: search.settled_cost(poses),
            refined: polished.accepted,
        })
    }
}

/// An estimate with its input frames.
struct RigResult<'a> {
    estimate: RigEstimate,
    frames: &'a [RigFrame],
}

impl WithConfidence for RigResult<'_> {
    fn confidence(&self) -> &Confidence {
        &self.estimate.confidence
    }

    fn min_gain(&self) -> f64 {
        let frame_estimates = self.frames.iter().zip(&self.estimate.frames);
        FocalVerdict::min_gain_of(
            frame_estimates
                .map(|(frame, frame_estimates)| (&frame.problem.observations, frame_estimates.inlier_count)),
        )
    }
}

/// The estimate of each frame, including those without correspondences.
fn frame_estimates(
    given: &[RigFrame],
    shown: &[Frame<'_>],
    contributions: &[FrameContribution<'_>],
    poses: &Poses,
) -> Vec<FrameEstimate> {
    let mut all: Vec<FrameEstimate> = given
        .iter()
        .map(|frame| FrameEstimate {
            cam_from_world: frame.cam_from_rig.compose(&poses.rig),
            inliers: vec![false; frame.problem.points.len()],
            inlier_count: 0,
            inlier_keypoints: 0,
            focal_scale: 1.0,
            noise_px: None,
            odometry_deviation: 0.0,
        })
        .collect();
    for ((frame, contribution), cam) in shown.iter().zip(contributions).zip(&poses.cams) {
        let estimate = &mut all[frame.index];
        estimate.cam_from_world = *cam;
        for &i in &contribution.inliers {
            estimate.inliers[i] = true;
        }
        estimate.inlier_count = contribution.inliers.len();
        estimate.inlier_keypoints =
            contribution.search.matches().keypoints_among(contribution.inliers.iter().copied());
        estimate.noise_px = contribution.noise_px(cam);
        estimate.odometry_deviation = contribution.deviation();
    }
    all
}

impl RigFrame {
    /// Rejects invalid odometry.
    fn check_odometry(&self) -> Result<(), PoseError> {
        if !self.cam_from_rig.is_finite() {
            return Err(PoseError::OdometryNotFinite);
        }
        for (what, value) in [
            ("standard deviation of the rotation on the rig", self.rotation_sd_deg),
            ("standard deviation of the position on the rig", self.translation_sd),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(PoseError::BadValue { what, value });
            }
        }
        Ok(())
    }

    fn constraint(&self, scene: f64) -> OdometryConstraint {
        OdometryConstraint::new(
            self.cam_from_rig,
            self.rotation_sd_deg.to_radians(),
            self.translation_sd,
            scene,
        )
    }
}
