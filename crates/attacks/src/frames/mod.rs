//! Several sealed queries of one place, their poses known: what keeps still is triangulated from lines alone.
//!
//! # What may be expected
//! A keypoint's line and the camera's centre span a **plane** in space, and the keypoint's 3D point lies in it: one
//! equation for three unknowns.
//! - **Two frames**: two planes meet in a line. It lies in the first plane and so projects onto the first line: *every*
//!   position on the line remains possible. Only limits cut it: in front of both cameras, inside both images, on the
//!   anchor's side of each, and within the depths that the map has there.
//! - **Three frames** fix the point. Any three planes do, also those of wrong matches: nothing is left to notice it by.
//! - **Four** leave the first check.
//! - **Cameras that do not turn** fix nothing, however many: all planes of one anchor hold the direction of its ray,
//!   `Rᵀ K⁻¹ a`, and planes that share a direction meet in a line along it. It takes a turn between the frames, or a
//!   point that changes sides and so belongs to the other anchor. Lines of any other direction do not have that.
//!
//! # How
//! Along the own line (parameter `t`, pixels) each other frame's plane says at which depth `z` the point must be, in
//! closed form. The sweep goes along `t`, tries the depths that the frames propose, and keeps for each `t` the
//! likeliest, counting each frame as right within the noise or wrong with some probability. That gives a likelihood of
//! `t`; its maximum is refined by least squares over `(t, z)` where the frames fix it, and where they do not the
//! answer is the mean of `t`.
//!
//! An answer is **believed** when more frames agree than any choice of two matches could bring about by chance
//! ([`Sighted::is_believed`]), and when they fix it.

mod place;
mod tracks;

use rayon::prelude::*;
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel};

use crate::error::AttackError;
use crate::features::Descriptors;
use crate::observation::Observation;

use place::{Own, Sight};
pub use tracks::mutual_matches;

/// One sealed query, and what the server found out about it.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// The camera of the query, without distortion.
    pub camera: Pinhole,
    /// Where the query was taken, as the server has it.
    pub cam_from_world: CameraFromWorld,
    /// `[N]`: what was sent of each keypoint. Known positions count as such in the attacked frame; in another they
    /// tell nothing, for what the map knows of them is no matter of lines.
    pub observations: &'a [Observation],
    /// `[N]`: what was sent beside them.
    pub descriptors: &'a Descriptors,
}

/// How keypoints are triangulated from lines.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FramesOptions {
    /// A match counts when the second best in the other frame is this much farther: ratio of descriptor distances.
    pub ratio: f64,
    /// Noise of a projection across a line, pixels: detector, dither, angle code and pose together.
    pub noise_px: f64,
    /// Probability that a match is wrong.
    pub wrong: f64,
    /// Depths that the attacked frame may have, map units.
    pub depths: [f64; 2],
}

impl FramesOptions {
    /// With the depths of the scene as the server's map has them around the query, map units.
    pub const fn with_depths(depths: [f64; 2]) -> Self {
        Self { ratio: 0.9, noise_px: 2.0, wrong: 0.2, depths }
    }
}

/// What several frames tell about one keypoint of the first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighted {
    /// Where it is, pixels; `None` where no other frame shows it.
    pub pixel: Option<Pixel>,
    /// Other frames with a match.
    pub matched: usize,
    /// Of these, those that agree with the answer.
    pub agreeing: usize,
    /// Standard deviation of the answer along its line as the agreeing frames fix it, pixels; infinite where they do
    /// not.
    pub sigma_px: f64,
    /// Expected number of such agreements among wrong matches.
    pub by_chance: f64,
}

impl Sighted {
    /// Known beforehand.
    const fn given(pixel: Pixel) -> Self {
        Self { pixel: Some(pixel), matched: 0, agreeing: 0, sigma_px: 0.0, by_chance: 0.0 }
    }

    const UNSEEN: Self =
        Self { pixel: None, matched: 0, agreeing: 0, sigma_px: f64::INFINITY, by_chance: f64::INFINITY };

    /// Whether wrong matches would hardly agree as much, and the frames fix the place to some pixels.
    pub fn is_believed(&self) -> bool {
        self.by_chance < MOST_BY_CHANCE && self.sigma_px < MOST_SIGMA
    }
}

const MOST_BY_CHANCE: f64 = 0.1;
const MOST_SIGMA: f64 = 10.0;

/// Recovers the keypoints of the first frame from the lines of all: `[N]` of the first frame (module docs).
///
/// Keypoints are matched by descriptors, mutually and by ratio; only static content can be. Answers are the same for
/// any number of threads.
///
/// # Errors
/// [`AttackError::TooFewFrames`] for fewer than two frames, [`AttackError::FrameDescriptors`] and
/// [`AttackError::Dimensions`] when a frame's descriptors do not fit.
pub fn several_frames(frames: &[Frame<'_>], options: &FramesOptions) -> Result<Vec<Sighted>, AttackError> {
    let [first, others @ ..] = frames else { return Err(AttackError::TooFewFrames { frames: 0 }) };
    if others.is_empty() {
        return Err(AttackError::TooFewFrames { frames: 1 });
    }
    for (frame, f) in frames.iter().enumerate() {
        let (observations, descriptors) = (f.observations.len(), f.descriptors.len());
        if observations != descriptors {
            return Err(AttackError::FrameDescriptors { frame, observations, descriptors });
        }
    }
    let matches: Vec<Vec<Option<usize>>> = others
        .par_iter()
        .map(|o| mutual_matches(first.descriptors, o.descriptors, options.ratio))
        .collect::<Result<_, _>>()?;
    let views: Vec<Sight> = others.iter().map(|o| Sight::new(first, o)).collect();
    let answer = |i: usize| {
        if let Observation::Known(pixel) = first.observations[i] {
            return Sighted::given(pixel);
        }
        let seen: Vec<(&Sight, &Observation)> = views
            .iter()
            .zip(&matches)
            .zip(others)
            .filter_map(|((view, matches), frame)| matches[i].map(|j| (view, &frame.observations[j])))
            .filter(|(_, o)| !matches!(o, Observation::Known(_)))
            .collect();
        if seen.is_empty() { Sighted::UNSEEN } else { Own::new(first, i).sighted(&seen, options) }
    };
    Ok((0..first.observations.len()).into_par_iter().map(answer).collect())
}
