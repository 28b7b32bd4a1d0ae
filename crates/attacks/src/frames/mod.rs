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

mod choice;
mod depth;
mod place;
mod resting;
mod sight;
mod tracks;

use rayon::prelude::*;
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel};

use crate::error::AttackError;
use crate::features::Descriptors;
use crate::observation::Observation;

pub use choice::most_telling;
use depth::DepthPrior;
use place::Own;
pub use resting::{RestingOptions, resting_camera};
use sight::Sight;
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
    /// Depths that the attacked frame may have, map units: positive, finite.
    pub depths: [f64; 2],
    /// Where the attacked frame shows map points, pixels, and at which depths, map units.
    pub known: Vec<(Pixel, f64)>,
}

impl FramesOptions {
    /// With the depths of the scene as the server's map has them around the query, map units.
    pub const fn with_depths(depths: [f64; 2]) -> Self {
        Self { ratio: 0.9, noise_px: 1.4, wrong: 0.2, depths, known: Vec::new() }
    }

    /// Whether the depths are depths.
    fn check(&self) -> Result<(), AttackError> {
        let [least, most] = self.depths;
        // Written so that NaN is refused.
        if least > 0.0 && most >= least && most.is_finite() { Ok(()) } else { Err(AttackError::Depths) }
    }

    /// With map points that the server sees in the attacked frame: a keypoint among them is likely as deep.
    #[must_use]
    pub fn beside(self, known: Vec<(Pixel, f64)>) -> Self {
        Self { known, ..self }
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
    /// Root of the expected squared error of the answer, by the posterior, pixels; infinite where there is none.
    pub sigma_px: f64,
    /// Probability that the answer is within 10 px, by the posterior.
    pub within: f64,
    /// Expected number of such agreements among wrong matches.
    pub by_chance: f64,
}

impl Sighted {
    /// Known beforehand.
    const fn given(pixel: Pixel) -> Self {
        Self { pixel: Some(pixel), matched: 0, agreeing: 0, sigma_px: 0.0, within: 1.0, by_chance: 0.0 }
    }

    const UNSEEN: Self = Self {
        pixel: None,
        matched: 0,
        agreeing: 0,
        sigma_px: f64::INFINITY,
        within: 0.0,
        by_chance: f64::INFINITY,
    };

    /// Whether wrong matches would hardly agree as much, and the posterior is sure to some pixels.
    pub fn is_believed(&self) -> bool {
        self.by_chance < MOST_BY_CHANCE && self.within >= LEAST_WITHIN
    }
}

const MOST_BY_CHANCE: f64 = 0.1;
const LEAST_WITHIN: f64 = 0.9;
/// What [`Sighted::within`] counts as near, pixels.
const NEAR_PX: f64 = 10.0;

/// Recovers the keypoints of the first frame from the lines of all: `[N]` of the first frame (module docs).
///
/// Keypoints are matched by descriptors, mutually and by ratio; only static content can be. Answers are the same for
/// any number of threads.
///
/// # Errors
/// [`AttackError::TooFewFrames`] for fewer than two frames, [`AttackError::FrameDescriptors`] and
/// [`AttackError::Dimensions`] when a frame's descriptors do not fit, [`AttackError::Depths`] when the depths are none.
pub fn several_frames(frames: &[Frame<'_>], options: &FramesOptions) -> Result<Vec<Sighted>, AttackError> {
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
    let matches: Vec<Vec<Option<usize>>> = others
        .par_iter()
        .map(|o| mutual_matches(first.descriptors, o.descriptors, options.ratio))
        .collect::<Result<_, _>>()?;
    let views: Vec<Sight> = others.iter().map(|o| Sight::new(first, o)).collect();
    let camera = &first.camera;
    let depths = DepthPrior::new(options.depths, &options.known, camera.width, camera.height);
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
        if seen.is_empty() { Sighted::UNSEEN } else { Own::new(first, i).sighted(&seen, &depths, options) }
    };
    Ok((0..first.observations.len()).into_par_iter().map(answer).collect())
}
