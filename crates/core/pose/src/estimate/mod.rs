//! Entry points: the pose of a query, for points, lines and anchored lines, and of a rig of several images.

pub(crate) mod cramer_rao;
mod msac;
pub(crate) mod pose_estimate;
pub(crate) mod refine_inliers;

use rand::Rng;
use veiloc_geometry::{CameraFromWorld, RigFromWorld};

use crate::error::PoseError;
use crate::estimate::msac::has_one_side;
use crate::estimate::pose_estimate::PoseEstimate;
use crate::likelihood::PoseProblem;
use crate::likelihood::duplicates::WithoutDuplicates;
use crate::options::{PoseOptions, ScoreKind};
use crate::rig::{Images, RigEstimate, RigFrame};

/// Estimates the pose of a camera.
///
/// LO-RANSAC with the solvers of the problem's kind, then a final refinement, which is accepted only when it does not
/// make the score worse. Equal problems, options and generator states give equal estimates.
///
/// Equal correspondences count as one, and of many for one map point, or on one spot of the image and the map, only the
/// four most probable count (not under [`ScoreKind::Msac`]): they have one cause. Equal ones have equal flags in
/// [`PoseEstimate::inliers`]; those that do not count are not inliers.
///
/// # Errors
/// [`PoseError`]: input that is inconsistent or not finite, too few correspondences, all lines of one anchor, or no
/// pose with enough inliers.
pub fn estimate_pose<R: Rng + ?Sized>(
    problem: &PoseProblem,
    options: &PoseOptions,
    rng: &mut R,
) -> Result<PoseEstimate, PoseError> {
    options.check()?;
    problem.check()?;
    if options.score.unwrap_or_default() == ScoreKind::Msac {
        return msac::estimate(problem, options, rng);
    }
    let frames = [RigFrame::alone(problem.clone())];
    let found = without_duplicates(&frames, |frames| Images::new(frames, options)?.estimate(options, rng));
    found.map(PoseEstimate::from).map_err(|error| match error {
        PoseError::NoConsensus { .. } if has_one_side(problem) => {
            PoseError::OneSided { lines: problem.points.len() }
        }
        error => error,
    })
}

/// Estimates the pose of a rig from all its frames.
///
/// Frames without correspondences, with too few of them, or with all lines of one anchor are allowed beside one that
/// has enough for a hypothesis. Equal frames, options and generator states give equal estimates; a single frame without
/// deviation gives the result of [`estimate_pose`]. Of the cameras of several frames only the focal lengths are
/// estimated; the rest of them is doubted.
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
    Images::check(frames)?;
    without_duplicates(frames, |frames| Images::new(frames, options)?.estimate(options, rng))
}

/// Estimates the pose of a camera from an initial pose, such as the pose of the previous frame.
///
/// The initial pose is optimised and refined with the objective of [`estimate_pose`], over all correspondences, without
/// sampling. From the true pose it gives the optimum that a search should find.
///
/// # Errors
/// As [`estimate_pose`]; the refined pose must agree with enough correspondences.
pub fn optimize_pose(
    problem: &PoseProblem,
    initial: &CameraFromWorld,
    options: &PoseOptions,
) -> Result<PoseEstimate, PoseError> {
    options.check()?;
    problem.check()?;
    if !initial.is_finite() {
        return Err(PoseError::NotFinite { what: "initial pose", index: 0 });
    }
    if options.score.unwrap_or_default() == ScoreKind::Msac {
        return msac::optimize(problem, initial, options);
    }
    let frames = [RigFrame::alone(problem.clone())];
    let initial = RigFromWorld::new(*initial.rotation(), *initial.translation());
    without_duplicates(&frames, |frames| Images::new(frames, options)?.optimize(&initial, options))
        .map(PoseEstimate::from)
}

/// Runs an estimation on the frames without duplicates.
fn without_duplicates(
    frames: &[RigFrame],
    estimate: impl FnOnce(&[RigFrame]) -> Result<RigEstimate, PoseError>,
) -> Result<RigEstimate, PoseError> {
    let without: Vec<Option<WithoutDuplicates>> =
        frames.iter().map(|frame| WithoutDuplicates::of(&frame.problem)).collect();
    if without.iter().all(Option::is_none) {
        return estimate(frames);
    }
    let fewer = |(frame, without): (&RigFrame, &Option<WithoutDuplicates>)| match without {
        Some(without) => RigFrame { problem: without.problem.clone(), ..frame.clone() },
        None => frame.clone(),
    };
    let fewer: Vec<RigFrame> = frames.iter().zip(&without).map(fewer).collect();
    let mut estimate = estimate(&fewer)?;
    for (frame, without) in estimate.frames.iter_mut().zip(&without) {
        if let Some(without) = without {
            frame.inliers = without.expand(&frame.inliers);
            frame.inlier_count = frame.inliers.iter().filter(|is_inlier| **is_inlier).count();
        }
    }
    Ok(estimate)
}
