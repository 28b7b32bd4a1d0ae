//! Input and output of the attack: frames, model parameters, and the estimate of a keypoint.

use crate::{AttackError, DecodedDescriptors, Observation};
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel};

/// One sealed query with the pose that the server estimated.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// The camera of the query, without distortion.
    pub camera: Pinhole,
    /// The pose of the query, as the server estimated it.
    pub cam_from_world: CameraFromWorld,
    /// `[N]`: the sent observations. Known positions are used in the attacked frame only; in other frames they are
    /// ignored, because they say nothing about lines.
    pub observations: &'a [Observation],
    /// `[N]`: the sent descriptors.
    pub descriptors: &'a DecodedDescriptors,
}

/// Options of the triangulation of keypoints from lines.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct FramesOptions {
    /// Ratio test: a match is accepted when its descriptor distance is below this ratio of the second best.
    pub ratio: f64,
    /// Standard deviation of a projection across a line, pixels: detector, dither, angle quantization and pose
    /// together.
    pub noise_px: f64,
    /// Probability that a match is wrong.
    pub wrong: f64,
    /// Depth limits of the attacked frame, map units: positive, finite.
    pub depths: [f64; 2],
    /// Map points in the attacked frame: position in pixels, depth in map units.
    pub known: Vec<(Pixel, f64)>,
    /// `[N]`: which keypoints of the attacked frame are attacked; the others get the answer of a keypoint without
    /// matches. `None`: all.
    pub attacked: Option<Vec<bool>>,
}

impl FramesOptions {
    /// Options with these depth limits, from the server's map around the query, map units.
    pub const fn with_depths(depths: [f64; 2]) -> Self {
        Self { ratio: 0.9, noise_px: 1.4, wrong: 0.2, depths, known: Vec::new(), attacked: None }
    }

    /// Checks the depth limits.
    pub(crate) fn check(&self) -> Result<(), AttackError> {
        let [least, most] = self.depths;
        // Written so that NaN is refused.
        if least > 0.0 && most >= least && most.is_finite() { Ok(()) } else { Err(AttackError::Depths) }
    }

    /// Restricts the attack to these keypoints of the attacked frame, `[N]`.
    #[must_use]
    pub fn for_keypoints(self, attacked: Vec<bool>) -> Self {
        Self { attacked: Some(attacked), ..self }
    }

    /// Adds map points that the server sees in the attacked frame: keypoints near them probably have a similar depth.
    #[must_use]
    pub fn with_known_points(self, known: Vec<(Pixel, f64)>) -> Self {
        Self { known, ..self }
    }
}

/// Estimate of one keypoint of the first frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangulatedKeypoint {
    /// Its position, pixels; `None` without a match in another frame.
    pub pixel: Option<Pixel>,
    /// Number of other frames with a match.
    pub matched: usize,
    /// Number of matched frames that agree with the answer.
    pub agreeing: usize,
    /// Root of the expected squared error of the answer under the posterior, pixels; infinite without an answer.
    pub sigma_px: f64,
    /// Posterior probability that the answer is within 10 px.
    pub within: f64,
    /// Expected number of such agreements among wrong matches.
    pub by_chance: f64,
}

impl TriangulatedKeypoint {
    /// A keypoint with a known position.
    pub(crate) const fn known(pixel: Pixel) -> Self {
        Self { pixel: Some(pixel), matched: 0, agreeing: 0, sigma_px: 0.0, within: 1.0, by_chance: 0.0 }
    }

    pub(crate) const NO_MATCH: Self = Self {
        pixel: None,
        matched: 0,
        agreeing: 0,
        sigma_px: f64::INFINITY,
        within: 0.0,
        by_chance: f64::INFINITY,
    };

    /// Whether chance cannot explain the agreement, and the posterior is concentrated within a few pixels.
    pub fn is_accepted(&self) -> bool {
        self.by_chance < MAX_CHANCE && self.within >= MIN_WITHIN
    }
}

const MAX_CHANCE: f64 = 0.1;
const MIN_WITHIN: f64 = 0.9;
/// Distance of [`TriangulatedKeypoint::within`], pixels.
pub(crate) const NEAR_PX: f64 = 10.0;
