//! A focal length that is estimated with the pose: a seventh parameter.
//!
//! A wrong focal length can be detected: the projections of right matches miss by amounts that grow towards the image's
//! border, and no pose compensates for this unless the scene is flat. A score test on one linearized system estimates
//! how much the log likelihood would rise if the focal length were free. If the gain is large enough, pose and focal
//! length are refined together.

use crate::likelihood::camera::{CAMERA, PoseWithCamera};
use crate::likelihood::problem::{Correspondences, FocalPrior};

/// A calibrated focal length is contradicted by at least this gain in log likelihood.
const MIN_GAIN: f64 = 3.5;

/// Smaller changes are caused by ignored lens distortion or by errors of the map's own calibration: correcting them in
/// the query alone would make query and map inconsistent. The pose is then not changed, and its covariance includes the
/// effect of the change.
const MIN_WRONG_CHANGE: f64 = 0.02;

/// Relative change of the focal length above which the pose is doubted: right focal lengths of half-hidden images,
/// whose matches determine it poorly, deviated by up to 2.3 %.
const MIN_DOUBTED_CHANGE: f64 = 0.03;

/// A focal length is called wrong, and estimated, when the gain per agreeing match exceeds this; below, it is only
/// suspicious. A half-pixel convention error also resembles a focal length, and its gain grows with the number of
/// matches: on the problems of `redkitchen_r08`, whose keypoints are half a pixel too far left, it gained 0.15 to 0.2
/// per point. Lines are less sensitive to both: 3 % of focal length gain less than 0.15 per line of dcl.
const GAIN_PER_POINT: f64 = 0.2;
const GAIN_PER_LINE: f64 = 0.06;

/// The verdict on a calibrated focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FocalVerdict {
    /// The matches are consistent with it.
    Fine,
    /// Another, at another pose, would explain the matches better, but not enough to replace it.
    Suspicious {
        /// The other one.
        other: PoseWithCamera,
        /// What it gains in log likelihood.
        gain: f64,
    },
    /// It is wrong.
    Wrong,
}

impl FocalVerdict {
    /// Required gain of another focal length before the given one is called wrong, for this number of agreeing matches.
    pub fn min_gain(observations: &Correspondences, agreeing: usize) -> f64 {
        Self::min_gain_of([(observations, agreeing)])
    }

    /// The same for agreeing matches in several images.
    pub fn min_gain_of<'a>(images: impl IntoIterator<Item = (&'a Correspondences, usize)>) -> f64 {
        let of_a_match = |observations: &Correspondences| match observations {
            Correspondences::Points { .. } => GAIN_PER_POINT,
            Correspondences::Lines { .. } | Correspondences::Anchored { .. } => GAIN_PER_LINE,
        };
        let each =
            images.into_iter().map(|(observations, agreeing)| of_a_match(observations) * agreeing as f64);
        MIN_GAIN + each.sum::<f64>()
    }

    /// Whether a linearized step of the focal length gains enough to refine it.
    pub fn warrants_refinement(gain: f64) -> bool {
        gain > MIN_GAIN
    }

    /// From the gain of another focal length, and the required gain ([`Self::min_gain`]).
    pub fn of(gain: f64, other: &PoseWithCamera, min_gain: f64) -> Self {
        let change = other.change.0[0].abs();
        if gain > min_gain && change > MIN_WRONG_CHANGE {
            Self::Wrong
        } else if gain > MIN_GAIN {
            Self::Suspicious { other: *other, gain }
        } else {
            Self::Fine
        }
    }

    /// Whether no focal length with a large change is suspected.
    pub fn is_near(&self) -> bool {
        *self != Self::Wrong && self.suspected_focal_scale(0.0).is_none()
    }

    /// The suspected focal length relative to the given one, if it differs so much that the pose may be wrong, and gains
    /// more than this.
    pub fn suspected_focal_scale(&self, min_gain: f64) -> Option<f64> {
        match self {
            Self::Suspicious { other, gain } if *gain > min_gain => {
                (other.change.0[0].abs() > MIN_DOUBTED_CHANGE).then(|| other.change.factor())
            }
            Self::Suspicious { .. } | Self::Fine | Self::Wrong => None,
        }
    }

    /// What a suspected focal length gains that differs so much that the pose may be wrong; 0 without one.
    pub fn suspected_gain(&self) -> f64 {
        match self {
            Self::Suspicious { gain, .. } if !self.is_near() => *gain,
            Self::Suspicious { .. } | Self::Fine | Self::Wrong => 0.0,
        }
    }
}

impl FocalPrior {
    /// Prior standard deviation of the logarithm of the true focal length relative to the given one, where it is
    /// estimated.
    pub const fn sd(self) -> f64 {
        match self {
            // Estimated only when the calibration is wrong; then nothing is known about it.
            Self::Calibrated | Self::Unknown => 0.3,
            Self::Exif => 0.05,
        }
    }

    /// The same for all parameters of a camera, of which only the focal length is free.
    pub(crate) const fn free_sd(self) -> [f64; CAMERA] {
        [self.sd(); CAMERA]
    }
}
