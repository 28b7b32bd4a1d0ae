//! The pose of a rig: several frames of one device, whose poses relative to each other it has measured, and one pose for
//! all of them.
//!
//! [`estimate_rig_pose`] is the door. Hypotheses come from each frame's own minimal solver, the more often the more a
//! frame promises, and are carried to the rig by the odometry (`odometry.rs`); each is scored on all frames (`search.rs`).
//! Local optimisation and the final refinement (`joint.rs`, `polish.rs`) move all poses together: six numbers of the rig and
//! six of each frame that may deviate, tied by the odometry. A frame that is too poor for a pose of its own helps as much as
//! it can, and one that contradicts the others has no say. Whether to trust the result, and why many frames are not many
//! witnesses: `evidence.rs`.

mod evidence;
mod frame;
mod joint;
mod odometry;
mod polish;
mod search;
mod zoom;

use rand::Rng;
use veiloc_geometry::{CameraFromRig, CameraFromWorld, RigFromWorld};

use self::evidence::{Witness, verdict};
use self::frame::{Frame, scene_size, stands_alone};
use self::joint::Poses;
use self::odometry::Tie;
use self::search::RigSearch;
use self::zoom::{Lens, RefinedRig, refine_focal_lengths, worst_known};
use crate::confidence::Confidence;
use crate::error::PoseError;
use crate::focal_search::{WithConfidence, is_clear, over_focal_lengths};
use crate::likelihood::{FocalKnowledge, FocalVerdict, Matches, PoseProblem};
use crate::options::{PoseOptions, ScoreKind};
use crate::ransac::lo_ransac;

/// One image of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct RigFrame {
    /// Its correspondences with the map; may be too few for a pose.
    pub problem: PoseProblem,
    /// Where on the rig it was taken, by the device's odometry.
    pub cam_from_rig: CameraFromRig,
    /// Standard deviation of that rotation about each axis, degrees; deviations of different frames are taken to be
    /// independent. With 0 here and in [`Self::translation_sd`] the frame is fixed to the rig.
    pub rotation_sd_deg: f64,
    /// Standard deviation of the camera's place on the rig along each axis, map units.
    pub translation_sd: f64,
}

/// Where a rig was, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct RigEstimate {
    /// The pose of the rig.
    pub rig_from_world: RigFromWorld,
    /// Its covariance in the chart of [`RigFromWorld::perturbed`] (radians, then map units), the frames' deviations
    /// marginalised out. Infinite on the diagonal when the frames leave a direction free.
    pub covariance: [[f64; 6]; 6],
    /// The same by the matches alone, without what was told beside them: what trust is told by.
    pub covariance_by_matches: [[f64; 6]; 6],
    /// Whether to trust the pose.
    pub confidence: Confidence,
    /// Each frame, `[F]`, in the order given.
    pub frames: Vec<FrameEstimate>,
    /// Minimal samples drawn, of all frames together, with the focal length that was searched with in the end.
    pub hypotheses: usize,
    /// What the search minimised, lower is better: minus what the frames gain by the pose, natural logarithm; a frame's
    /// gain counts less the more of it there is.
    pub score: f64,
    /// Whether the final refinement was kept. It is dropped when it made the objective worse.
    pub refined: bool,
}

/// One frame of a rig at the joint pose.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FrameEstimate {
    /// The pose of its camera: where the odometry puts it, moved as far as its matches ask and the odometry allows.
    pub cam_from_world: CameraFromWorld,
    /// Which correspondences agree with it, `[N]`.
    pub inliers: Vec<bool>,
    /// How many do.
    pub inlier_count: usize,
    /// How many keypoints they belong to.
    pub inlier_keypoints: usize,
    /// Estimated focal length over the given one, the same for all frames of one camera; 1 when it was not estimated.
    pub focal_scale: f64,
    /// Standard deviation that the inliers show, pixels; `None` without inliers.
    pub noise_px: Option<f64>,
    /// How far the camera is from where the odometry puts it, in standard deviations (the length of six numbers: 2.4 on
    /// average when the odometry errs as it says); 0 for a frame that is fixed to the rig.
    pub odometry_deviation: f64,
}

impl RigEstimate {
    /// Covariance of the rig's origin in the world frame, map units squared.
    pub fn center_covariance(&self) -> [[f64; 3]; 3] {
        self.rig_from_world.center_covariance(&self.covariance)
    }
}

/// Estimates where a rig was from all its frames.
///
/// Frames without correspondences, with too few of them, or with all lines of one anchor are welcome beside one that could
/// stand alone. Equal frames, options and generator states give equal estimates; a single frame without deviation gives
/// what [`crate::estimate_pose`] gives.
///
/// # Errors
/// [`PoseError`]: no frame, a frame that is inconsistent or not finite, no frame that hypotheses can be drawn from, the
/// score [`ScoreKind::Msac`] (which cannot weigh frames), or no pose with enough inliers.
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
    let mut alone = Vec::with_capacity(frames.len());
    for (frame, given) in frames.iter().enumerate() {
        let of_frame = |source| PoseError::Frame { frame, source: Box::new(source) };
        given.check_odometry().map_err(of_frame)?;
        alone.push(stands_alone(&given.problem).map_err(of_frame)?);
    }
    // Frames that show something.
    let shown: Vec<usize> = (0..frames.len()).filter(|&i| !frames[i].problem.points.is_empty()).collect();
    let given: Vec<Matches<'_>> =
        shown.iter().map(|&i| Matches::new(&frames[i].problem, options.expected_inlier_ratio)).collect();
    let asked = Asked { frames, alone, shown, given };
    let focal = worst_known(asked.shown.iter().map(|&i| frames[i].problem.focal));
    let best = over_focal_lengths(focal, |factor| {
        let search = |times, rng: &mut R| {
            let found = asked.search_at(factor, focal, options, times, rng);
            found.map(|estimate| OfFrames { estimate, frames })
        };
        let found = search(1, rng);
        if factor != 1.0 || !asked.may_have_missed(&found, options) {
            return found;
        }
        let again = search(THOROUGH, rng);
        let score =
            |of: &Result<OfFrames<'_>, PoseError>| of.as_ref().map_or(f64::INFINITY, |of| of.estimate.score);
        if score(&again) < score(&found) { again } else { found }
    });
    if options.stop.is_set() { Err(PoseError::Stopped) } else { best.map(|best| best.estimate) }
}

/// Where a search of several frames leaves a doubt it is repeated with so many times the least number of samples for every
/// frame: matches are many in all frames together and few in each, and odometry that is as loose as the matches are fine
/// lets enough of them agree with a wrong pose for the search to think itself done. On RedKitchen's walk with every tenth
/// image mapped, recall of dcl at 5 cm/5°: 79, 86 and 97 % of two, four and eight frames without, 83, 90 and 100 % with
/// (`veiloc eval rig --stress sparse-map`).
const THOROUGH: usize = 4;

/// Frames that have passed their check.
struct Asked<'a> {
    frames: &'a [RigFrame],
    /// Which of them hypotheses can be drawn from, `[F]`.
    alone: Vec<bool>,
    /// Which of them show something.
    shown: Vec<usize>,
    /// The correspondences of those, with their focal lengths as given.
    given: Vec<Matches<'a>>,
}

impl Asked<'_> {
    /// Frames that hypotheses can be drawn from.
    fn drawn(&self) -> usize {
        self.alone.iter().filter(|alone| **alone).count()
    }

    /// Whether more samples may find what a search did not. Of one frame a search knows itself when it is done.
    fn may_have_missed(&self, found: &Result<OfFrames<'_>, PoseError>, options: &PoseOptions) -> bool {
        self.drawn() > 1 && options.fixed_hypotheses.is_none() && !is_clear(found)
    }

    /// Searches with focal lengths so many times as long as the given ones, of those frames whose focal length is known no
    /// better than this. With `times` above 1 it draws at least so many times as many samples of every frame as a search of
    /// one frame draws.
    fn search_at<R: Rng + ?Sized>(
        &self,
        factor: f64,
        focal: FocalKnowledge,
        options: &PoseOptions,
        times: usize,
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
        let ties = self.shown.iter().zip(&self.given).map(|(&i, m)| frames[i].tie(scene_size(m, &frames[i])));
        let mut search = RigSearch::new(ready.collect(), ties.collect(), options.noise_px)
            .ok_or(PoseError::NoFrameAlone { frames: frames.len() })?
            .until(&options.stop);
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
        let Some(best) = found.model else { return Err(no_consensus(0)) };
        let RefinedRig { polished, lenses } = refine_focal_lengths(&mut search, &best, factor, options);
        let poses = &polished.poses;
        let lens_of = |f: usize| lenses.iter().find(|lens| lens.frames.contains(&f));
        let mut witnesses: Vec<Witness<'_>> = search
            .frames
            .iter()
            .enumerate()
            .map(|(f, frame)| {
                let focal_sd = lens_of(f).and_then(Lens::estimated_sd);
                Witness::new(&frame.search, &search.ties[f], poses, f, polished.noise[f], focal_sd)
            })
            .collect();
        let inlier_keypoints: usize =
            witnesses.iter().map(|w| w.search.matches().keypoints_among(w.inliers.iter().copied())).sum();
        if inlier_keypoints < options.min_inliers {
            return Err(no_consensus(inlier_keypoints));
        }
        let mut verdict = verdict(&mut witnesses, &search.ties);
        let margin = search.margin(poses, &verdict.by_matches, verdict.least_margin(), options);
        let mut confidence = verdict.confidence(&witnesses, poses, margin);
        confidence.log_evidence -= search.disbelief(&poses.cams);
        // A pose may be off by what another focal length would do to it, where that is too little to be estimated.
        for lens in &lenses {
            if let FocalVerdict::Suspicious(other) = lens.verdict {
                let rig = RigFromWorld::new(*other.pose.rotation(), *other.pose.translation());
                verdict.shift(&poses.rig.step_to(&rig));
            }
        }
        confidence = confidence.with_covariances(&verdict.covariance, &verdict.by_matches);
        confidence.other_focal = lenses.iter().find_map(|lens| lens.verdict.doubted());
        let mut told = told(frames, &search.frames, &witnesses, poses);
        for (f, frame) in search.frames.iter().enumerate() {
            told[frame.index].focal_scale = lens_of(f).map_or(1.0, |lens| lens.factor);
        }
        Ok(RigEstimate {
            rig_from_world: poses.rig,
            covariance: verdict.covariance,
            covariance_by_matches: verdict.by_matches,
            confidence,
            frames: told,
            hypotheses: found.samples,
            score: search.settled_cost(poses),
            refined: polished.kept,
        })
    }
}

/// An estimate with the frames it is of.
struct OfFrames<'a> {
    estimate: RigEstimate,
    frames: &'a [RigFrame],
}

impl WithConfidence for OfFrames<'_> {
    fn confidence(&self) -> &Confidence {
        &self.estimate.confidence
    }

    fn least_gain(&self) -> f64 {
        let told = self.frames.iter().zip(&self.estimate.frames);
        FocalVerdict::least_gain_of(
            told.map(|(frame, told)| (&frame.problem.observations, told.inlier_count)),
        )
    }
}

/// What is told of each frame, those that show nothing included.
fn told(
    given: &[RigFrame],
    shown: &[Frame<'_>],
    witnesses: &[Witness<'_>],
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
    for ((frame, witness), cam) in shown.iter().zip(witnesses).zip(&poses.cams) {
        let estimate = &mut all[frame.index];
        estimate.cam_from_world = *cam;
        for &i in &witness.inliers {
            estimate.inliers[i] = true;
        }
        estimate.inlier_count = witness.inliers.len();
        estimate.inlier_keypoints = witness.search.matches().keypoints_among(witness.inliers.iter().copied());
        estimate.noise_px = witness.noise_px(cam);
        estimate.odometry_deviation = witness.deviation();
    }
    all
}

impl RigFrame {
    /// Refuses what no frame can have measured.
    fn check_odometry(&self) -> Result<(), PoseError> {
        if !self.cam_from_rig.is_finite() {
            return Err(PoseError::OdometryNotFinite);
        }
        for (what, value) in [
            ("standard deviation of the rotation on the rig", self.rotation_sd_deg),
            ("standard deviation of the place on the rig", self.translation_sd),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(PoseError::BadValue { what, value });
            }
        }
        Ok(())
    }

    fn tie(&self, scene: f64) -> Tie {
        Tie::new(self.cam_from_rig, self.rotation_sd_deg.to_radians(), self.translation_sd, scene)
    }
}
