//! Several sealed queries of one place, their poses known: what keeps still is triangulated from lines alone.
//!
//! # What may be expected
//! A keypoint's line and the camera's centre span a **plane** in space, and the keypoint's 3D point lies in it.
//! - **A camera that turns and hardly moves** gives every matched keypoint away with two frames: both planes pass
//!   through nearly the same centre, and meet in the viewing ray of the keypoint whatever its depth.
//! - **A camera that moves**: two planes meet in a line in space, which projects onto the first line, each position at
//!   a depth of its own. What is known of depth is then what is known of the position.
//! - **Three frames in general position** fix the point; a fourth tells right matches from wrong ones.
//! - **Cameras that move and do not turn** fix nothing, however many: all planes of one anchor hold the direction of
//!   its ray, `Rᵀ K⁻¹ a`, and planes that share a direction meet in a line along it. A point that changes sides
//!   belongs to the other anchor, and is fixed. Lines of any other direction do not have that.
//! - **A camera that rests** tells by the scatter of the angles, which is that of the noise over the distance from the
//!   anchor: [`resting_camera`].
//!
//! # How
//! For each position `t` along the own line the likelihood of all other frames' lines is integrated over depth, with
//! a prior that is log-uniform within the scene's limits and may be sharpened by the map points that the server sees
//! around ([`FramesOptions::beside`]). Each frame counts as right within the noise or as wrong with some probability,
//! within the integral. A maximum over depth in place of the integral, among the depths at which the planes say the
//! point lies, is blind to the camera that turns: that depth, `−n·t / n·R b`, is zero for every position when `t` is.
//!
//! That times the guess's density is the posterior of `t`. The answer is its median, which has the smallest expected
//! error, and where half of it lies within some pixels the maximum, refined by least squares over position and depth.
//! An answer is **believed** when the posterior puts it within 10 px with 90 %, and more frames agree than any choice of
//! two matches could bring about by chance ([`Sighted::is_believed`]).

#![forbid(unsafe_code)]

mod choice;
mod depth;
mod frame;
mod place;
mod resting;
mod sight;

use crate::{AttackError, Observation, mutual_matches};
use rayon::prelude::*;

pub use choice::{most_telling, most_telling_matched};
use depth::DepthPrior;
pub use frame::{Frame, FramesOptions, Sighted};
use place::Own;
pub use resting::{RestingOptions, resting_camera};
use sight::Sight;

/// Recovers the keypoints of the first frame from the lines of all: `[N]` of the first frame (module docs).
///
/// Keypoints are matched by descriptors, mutually and by ratio; only static content can be. Answers are the same for
/// any number of threads.
///
/// # Errors
/// [`AttackError::TooFewFrames`] for fewer than two frames, [`AttackError::FrameDescriptors`] and
/// [`AttackError::Dimensions`] when a frame's descriptors do not fit, [`AttackError::Rows`] when
/// [`FramesOptions::asked`] does not, [`AttackError::Depths`] when the depths are none.
pub fn several_frames(frames: &[Frame<'_>], options: &FramesOptions) -> Result<Vec<Sighted>, AttackError> {
    let [first, others @ ..] = frames else { return Err(AttackError::TooFewFrames { frames: 0 }) };
    let matches: Vec<Vec<Option<usize>>> = others
        .par_iter()
        .map(|o| mutual_matches(first.descriptors, o.descriptors, options.ratio))
        .collect::<Result<_, _>>()?;
    several_matched_frames(frames, &matches.iter().map(Vec::as_slice).collect::<Vec<_>>(), options)
}

/// The same with matches that are already there: of each other frame, by row of the first, which of its rows shows the
/// same keypoint, `[frames - 1, N]`.
///
/// # Errors
/// As [`several_frames`]; [`AttackError::Rows`] also when the matches do not fit.
pub fn several_matched_frames(
    frames: &[Frame<'_>],
    matches: &[&[Option<usize>]],
    options: &FramesOptions,
) -> Result<Vec<Sighted>, AttackError> {
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
    let lengths = matches.iter().map(|m| m.len()).chain(options.asked.as_ref().map(Vec::len));
    if let Some(rows) = lengths.into_iter().find(|rows| *rows != expected) {
        return Err(AttackError::Rows { rows, expected });
    }
    let views: Vec<Sight> = others.iter().map(|o| Sight::new(first, o)).collect();
    let camera = &first.camera;
    let depths = DepthPrior::new(options.depths, &options.known, camera.width, camera.height);
    let answer = |i: usize| {
        if let Observation::Known(pixel) = first.observations[i] {
            return Sighted::given(pixel);
        }
        if options.asked.as_ref().is_some_and(|asked| !asked[i]) {
            return Sighted::UNSEEN;
        }
        let seen: Vec<(&Sight, &Observation)> = views
            .iter()
            .zip(matches)
            .zip(others)
            .filter_map(|((view, matches), frame)| Some((view, frame.observations.get(matches[i]?)?)))
            .filter(|(_, o)| !matches!(o, Observation::Known(_)))
            .collect();
        if seen.is_empty() { Sighted::UNSEEN } else { Own::new(first, i).sighted(&seen, &depths, options) }
    };
    Ok((0..first.observations.len()).into_par_iter().map(answer).collect())
}
