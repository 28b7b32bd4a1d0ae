//! Attack on several sealed queries of one scene with known poses: static content is triangulated from lines alone.
//!
//! # What lines determine
//! A keypoint's line and the camera centre span a **plane** in space that contains the keypoint's 3D point.
//! - **A camera that rotates without translation** reveals every matched keypoint with two frames: both planes
//!   contain the same centre, and intersect in the viewing ray of the keypoint at any depth.
//! - **A camera that translates**: two planes intersect in a 3D line, whose projection is the first line, and each
//!   position on it has its own depth. Knowledge of depth is then knowledge of position.
//! - **Three frames in general position** determine the point; a fourth frame separates right matches from wrong
//!   ones.
//! - **Cameras that translate without rotation** determine nothing, at any number of frames: all planes of one anchor
//!   contain the direction of its ray, `Rᵀ K⁻¹ a`, and planes that share a direction intersect in a line along it. A
//!   point that changes sides belongs to the other anchor, and is determined. Lines of any other direction do not
//!   have this property.
//! - **A stationary camera** reveals distances by the scatter of the angles, which is the noise divided by the
//!   distance from the anchor: [`static_camera`].
//!
//! # Method
//! For each position `t` on the keypoint's own line, the likelihood of the lines of all other frames is integrated
//! over depth. The depth prior is log-uniform within the scene's limits; nearby map points that the server sees can
//! sharpen it ([`FramesOptions::with_known_points`]). Within the integral each frame is a mixture of a right match
//! with noise and a wrong match. Maximising over the depths at which the planes intersect instead of integrating
//! would fail for a camera that only rotates: that depth, `−n·t / n·R b`, is zero for every position when `t` is
//! zero.
//!
//! This likelihood times the prior density is the posterior of `t`. The answer is its median, which has the smallest
//! expected error. If half of the posterior lies within a few pixels, the answer is the maximum, refined by least
//! squares over position and depth. An answer is **accepted** when the posterior probability of an error below 10 px
//! is at least 90 %, and more frames agree than any two matches could cause by chance
//! ([`TriangulatedKeypoint::is_accepted`]).

#![forbid(unsafe_code)]

mod depth;
mod frame;
mod frame_selection;
mod line_posterior;
mod ray_plane;
mod static_camera;

use crate::{AttackError, Observation, mutual_matches};
use rayon::prelude::*;

use depth::DepthPrior;
pub use frame::{Frame, FramesOptions, TriangulatedKeypoint};
pub use frame_selection::{select_frames, select_frames_matched};
use line_posterior::AttackedKeypoint;
use ray_plane::RelativeFrame;
pub use static_camera::{StaticCameraOptions, static_camera};

/// Recovers the keypoints of the first frame from the lines of all frames: `[N]` of the first frame (module docs).
///
/// Keypoints are matched by descriptors (mutual nearest neighbours and ratio test), so only static content is
/// recovered. The answers do not depend on the number of threads.
///
/// # Errors
/// [`AttackError::TooFewFrames`] for fewer than two frames, [`AttackError::FrameDescriptors`] and
/// [`AttackError::Dimensions`] when a frame's descriptors have the wrong number or length, [`AttackError::Rows`] when
/// [`FramesOptions::attacked`] has the wrong length, [`AttackError::Depths`] when the depth limits are invalid.
pub fn multi_view_attack(
    frames: &[Frame<'_>],
    options: &FramesOptions,
) -> Result<Vec<TriangulatedKeypoint>, AttackError> {
    let [first, others @ ..] = frames else { return Err(AttackError::TooFewFrames { frames: 0 }) };
    let matches: Vec<Vec<Option<usize>>> = others
        .par_iter()
        .map(|o| mutual_matches(first.descriptors, o.descriptors, options.ratio))
        .collect::<Result<_, _>>()?;
    multi_view_attack_matched(frames, &matches.iter().map(Vec::as_slice).collect::<Vec<_>>(), options)
}

/// The same with given matches: for each other frame and each row of the first, the row of the other frame that shows
/// the same keypoint, `[frames - 1, N]`.
///
/// # Errors
/// As [`multi_view_attack`]; [`AttackError::Rows`] also when the number of matches is wrong.
pub fn multi_view_attack_matched(
    frames: &[Frame<'_>],
    matches: &[&[Option<usize>]],
    options: &FramesOptions,
) -> Result<Vec<TriangulatedKeypoint>, AttackError> {
    let [first, others @ ..] = frames else { return Err(AttackError::TooFewFrames { frames: 0 }) };
    if others.is_empty() {
        return Err(AttackError::TooFewFrames { frames: 1 });
    }
    options.check()?;
    for (frame, f) in frames.iter().enumerate() {
        let (observations, descriptors) = (f.observations.len(), f.descriptors.len());
        if observations != descriptors {
            return Err(AttackError::FrameDescriptors { frame, observations, descriptors });
        }
    }
    let expected = first.observations.len();
    let lengths = matches.iter().map(|m| m.len()).chain(options.attacked.as_ref().map(Vec::len));
    if let Some(rows) = lengths.into_iter().find(|rows| *rows != expected) {
        return Err(AttackError::Rows { rows, expected });
    }
    let views: Vec<RelativeFrame> = others.iter().map(|o| RelativeFrame::new(first, o)).collect();
    let camera = &first.camera;
    let depths = DepthPrior::new(options.depths, &options.known, camera.width, camera.height);
    let answer = |i: usize| {
        if let Observation::Known(pixel) = first.observations[i] {
            return TriangulatedKeypoint::known(pixel);
        }
        if options.attacked.as_ref().is_some_and(|attacked| !attacked[i]) {
            return TriangulatedKeypoint::NO_MATCH;
        }
        let matched_frames: Vec<(&RelativeFrame, &Observation)> = views
            .iter()
            .zip(matches)
            .zip(others)
            .filter_map(|((view, matches), frame)| Some((view, frame.observations.get(matches[i]?)?)))
            .filter(|(_, o)| !matches!(o, Observation::Known(_)))
            .collect();
        if matched_frames.is_empty() {
            TriangulatedKeypoint::NO_MATCH
        } else {
            AttackedKeypoint::new(first, i).triangulate(&matched_frames, &depths, options)
        }
    };
    Ok((0..first.observations.len()).into_par_iter().map(answer).collect())
}
