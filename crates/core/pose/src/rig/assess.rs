//! From refined poses to an estimate: covariance, camera priors, confidence.

use veiloc_geometry::RigFromWorld;
use veiloc_geometry::deviations::position_sd;
use veiloc_geometry::nalgebra::Matrix6;

use super::cameras::CameraTest;
use super::estimate::{FrameEstimate, RigEstimate};
use super::evidence::{FrameContribution, FrameEvidence, combine_evidence};
use super::frame::{Frame, RigFrame};
use super::joint::Poses;
use super::lens::Refined;
use super::search::Search;
use crate::error::PoseError;
use crate::likelihood::{
    FocalVerdict, GravityTest, Symmetric6, free_along, inverse_or_infinite, sum, with_shift,
};
use crate::options::PoseOptions;

/// Poses that a search found.
pub(super) struct Found<'s> {
    pub(super) poses: &'s Poses,
    /// The search's factor on the focal lengths that are known worst.
    pub(super) factor: f64,
    /// Samples drawn.
    pub(super) hypotheses: usize,
}

/// Two covariances of a pose: with the camera priors, and from the matches alone.
#[derive(Clone, Copy)]
struct Covariances {
    all: Symmetric6,
    by_matches: Symmetric6,
}

impl Covariances {
    fn map(self, of: impl Fn(&Symmetric6) -> Symmetric6) -> Self {
        Self { all: of(&self.all), by_matches: of(&self.by_matches) }
    }
}

/// Refines the poses of a search, and assesses them. A gravity direction that the matches contradict has no influence on
/// the pose. `frames` are those of the caller.
pub(super) fn refine_and_assess(
    search: &mut Search<'_>,
    found: &Found<'_>,
    frames: &[RigFrame],
    options: &PoseOptions,
) -> Result<RigEstimate, PoseError> {
    let estimate = with_priors(search, found, frames, options)?;
    let has_gravity = search.frames.iter().any(|frame| frame.priors().has_gravity());
    if !has_gravity || estimate.confidence.gravity.is_some_and(|gravity| gravity.is_close()) {
        return Ok(estimate);
    }
    search.frames.iter_mut().for_each(Frame::without_gravity);
    with_priors(search, found, frames, options)
}

/// The same with the camera priors of the search.
fn with_priors(
    search: &mut Search<'_>,
    found: &Found<'_>,
    frames: &[RigFrame],
    options: &PoseOptions,
) -> Result<RigEstimate, PoseError> {
    let mut refined = Refined::new(search, found.poses, found.factor, options);
    let camera = CameraTest::new(search, &mut refined, options);
    let search = &*search;
    let poses = &refined.polished.poses;
    let is_alone = search.frames.len() == 1;
    let mut contributions: Vec<FrameContribution<'_>> = search
        .frames
        .iter()
        .zip(poses.deviations(&search.constraints))
        .enumerate()
        .map(|(f, (frame, deviation))| {
            let focal_sd = refined.camera_of(f).estimated_sd();
            let noise = refined.polished.noise[f];
            FrameContribution::new(frame, deviation, &poses.cams[f], noise, focal_sd, is_alone)
        })
        .collect();
    let inliers: usize = contributions.iter().map(FrameContribution::inlier_keypoints).sum();
    if inliers < options.min_inliers {
        let (required, hypotheses) = (options.min_inliers, found.hypotheses);
        return Err(PoseError::NoConsensus { inliers, required, hypotheses });
    }
    let evidence = combine_evidence(&mut contributions, &search.constraints);
    let camera_covariance = camera.covariance(search, &refined, &contributions);
    let gravity = gravity_tests(search, poses, &evidence);
    let by_matches = inverse_or_infinite(&evidence.information);
    let margin = search.margin(poses, &by_matches, evidence.min_margin(), options);
    let by_matches = sum(&by_matches, &camera_covariance);
    let mut confidence = evidence.confidence(&contributions, poses, margin);
    // The frame that agrees least decides.
    let agreements = gravity.iter().zip(&search.constraints).filter_map(|(test, constraint)| {
        Some(test.as_ref()?.judge(&constraint.covariance_of_camera(&by_matches)))
    });
    confidence.gravity =
        agreements.reduce(|worst, next| if next.deviation > worst.deviation { next } else { worst });
    // Only a gravity direction that the matches confirm makes the ± smaller.
    let is_confirmed = confidence.gravity.is_some_and(|gravity| gravity.log_evidence > 0.0);
    let known = information_of_priors(search, &contributions, poses, is_confirmed);
    let mut covariances = Covariances {
        all: sum(&inverse_or_infinite(&(evidence.information + known)), &camera_covariance),
        by_matches,
    };
    let sd = position_sd(&covariances.by_matches);
    let deviation = |(frame, cam): (&Frame<'_>, _)| frame.priors().position_deviation(cam, sd);
    confidence.position_deviation =
        search.frames.iter().zip(&poses.cams).filter_map(deviation).reduce(f64::max);
    // A pose may be wrong by the effect of another focal length, where the effect is too small to estimate that.
    for of in &refined.cameras {
        if let FocalVerdict::Suspicious { other, .. } = of.verdict {
            let rig = RigFromWorld::new(*other.pose.rotation(), *other.pose.translation());
            covariances = covariances.map(|of| with_shift(of, &poses.rig.step_to(&rig)));
        }
    }
    confidence = confidence.with_covariances(&covariances.all, &covariances.by_matches);
    confidence.other_focal =
        refined.cameras.iter().find_map(|of| of.verdict.suspected_focal_scale(of.min_gain_of_map));
    confidence.is_camera_contradicted = camera.is_contradicted;
    let free = contributions[0].free.map(|(direction, _)| direction);
    if let Some(direction) = &free {
        let of_rig = search.constraints[0].direction_of_rig(direction);
        covariances = covariances.map(|of| free_along(of, &of_rig));
        confidence = confidence.with_free_direction();
    }
    let mut all = frame_estimates(search, frames, &contributions, poses);
    for (f, frame) in search.frames.iter().enumerate() {
        let change = &refined.camera_of(f).change;
        all[frame.index].focal_scale = change.factor();
        all[frame.index].principal_shift_px = change.principal_shift_px(frame.camera());
        all[frame.index].gravity_test = gravity[f];
    }
    if is_alone {
        all[search.frames[0].index].camera_evidence = camera.evidence;
    }
    Ok(RigEstimate {
        rig_from_world: poses.rig,
        covariance: covariances.all,
        covariance_by_matches: covariances.by_matches,
        camera_covariance,
        confidence,
        free_direction: free.map(|direction| (poses.cams[0].rotation().inverse() * direction).into()),
        frames: all,
        hypotheses: found.hypotheses,
        score: search.settled_cost(poses),
        rival: None,
        refined: refined.polished.accepted,
    })
}

/// The gravity direction of each frame against its pose by the matches alone; `None` for frames without one.
fn gravity_tests(search: &Search<'_>, poses: &Poses, evidence: &FrameEvidence) -> Vec<Option<GravityTest>> {
    let frames = search.frames.iter().zip(&search.constraints).zip(&poses.cams);
    frames
        .map(|((frame, constraint), cam)| {
            let test = GravityTest::new(frame.problem.gravity.as_ref()?, cam);
            Some(if frame.priors().has_gravity() {
                test.without_influence(&constraint.covariance_of_camera(&evidence.independent))
            } else {
                test
            })
        })
        .collect()
}

/// Information of the camera priors about the rig.
fn information_of_priors(
    search: &Search<'_>,
    contributions: &[FrameContribution<'_>],
    poses: &Poses,
    with_gravity: bool,
) -> Matrix6<f64> {
    let mut all = Matrix6::zeros();
    for (f, frame) in search.frames.iter().enumerate() {
        let priors = if with_gravity { frame.priors().clone() } else { frame.priors().without_gravity() };
        let of_camera = priors.information(&poses.cams[f]);
        all += search.constraints[f].information_over_rig(&of_camera, &contributions[f].deviation);
    }
    all
}

/// The estimate of each frame, including those without correspondences.
fn frame_estimates(
    search: &Search<'_>,
    given: &[RigFrame],
    contributions: &[FrameContribution<'_>],
    poses: &Poses,
) -> Vec<FrameEstimate> {
    let of = |frame: &RigFrame| {
        FrameEstimate::unseen(frame.cam_from_rig.compose(&poses.rig), frame.problem.points.len())
    };
    let mut all: Vec<FrameEstimate> = given.iter().map(of).collect();
    for ((frame, contribution), cam) in search.frames.iter().zip(contributions).zip(&poses.cams) {
        let estimate = &mut all[frame.index];
        estimate.cam_from_world = *cam;
        for &i in &contribution.inliers {
            estimate.inliers[i] = true;
        }
        estimate.inlier_count = contribution.inliers.len();
        estimate.inlier_keypoints = contribution.inlier_keypoints();
        estimate.noise_px = contribution.noise_px(cam);
        estimate.odometry_deviation = contribution.deviation();
    }
    all
}
