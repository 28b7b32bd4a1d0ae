//! What goes in and comes out: a frame, what is supposed of all, and what they tell about a keypoint.

use crate::{AttackError, Descriptors, Observation};
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel};

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
    /// `[N]`: the keypoints of the attacked frame that are asked for; the others are answered as if no frame showed them.
    /// All when none.
    pub asked: Option<Vec<bool>>,
}

impl FramesOptions {
    /// With the depths of the scene as the server's map has them around the query, map units.
    pub const fn with_depths(depths: [f64; 2]) -> Self {
        Self { ratio: 0.9, noise_px: 1.4, wrong: 0.2, depths, known: Vec::new(), asked: None }
    }

    /// Whether the depths are depths.
    pub(crate) fn check(&self) -> Result<(), AttackError> {
        let [least, most] = self.depths;
        // Written so that NaN is refused.
        if least > 0.0 && most >= least && most.is_finite() { Ok(()) } else { Err(AttackError::Depths) }
    }

    /// Of these keypoints of the attacked frame alone, `[N]`.
    #[must_use]
    pub fn asking(self, asked: Vec<bool>) -> Self {
        Self { asked: Some(asked), ..self }
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
    pub(crate) const fn given(pixel: Pixel) -> Self {
        Self { pixel: Some(pixel), matched: 0, agreeing: 0, sigma_px: 0.0, within: 1.0, by_chance: 0.0 }
    }

    pub(crate) const UNSEEN: Self = Self {
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
pub(crate) const NEAR_PX: f64 = 10.0;
