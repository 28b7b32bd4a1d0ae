//! A focal length that is estimated with the pose: a seventh parameter.
//!
//! A wrong focal length can be detected: the projections of right matches miss by amounts that grow towards the image's
//! border, and no pose compensates for this unless the scene is flat. A score test on one linearized system estimates
//! how much the log likelihood would rise if the focal length were free. If the gain is large enough, pose and focal
//! length are refined together.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{SMatrix, SVector};

use crate::likelihood::camera_error::BentCamera;
use crate::likelihood::descent::{Convergence, levenberg_marquardt};
use crate::likelihood::design_effect::ScoreCells;
use crate::likelihood::matches::{LikelihoodTerm, Matches};
use crate::likelihood::pose_priors::PosePriors;
use crate::likelihood::problem::{Correspondences, FocalPrior};
use crate::likelihood::refine::System;

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;

/// A calibrated focal length is contradicted by at least this gain in log likelihood ...
const MIN_GAIN: f64 = 3.5;

/// ... and at least this change of its logarithm.
const MIN_CHANGE: f64 = 0.002;

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
        other: PoseWithFocal,
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

    /// Whether a linearized step of the logarithm of the focal length gains enough to refine it.
    pub fn warrants_refinement(gain: f64, log_step: f64) -> bool {
        gain > MIN_GAIN && log_step.abs() > MIN_CHANGE
    }

    /// From the gain of another focal length, and the required gain ([`Self::min_gain`]).
    pub fn of(gain: f64, other: &PoseWithFocal, min_gain: f64) -> Self {
        let change = other.factor.ln().abs();
        if gain > min_gain && change > MIN_WRONG_CHANGE {
            Self::Wrong
        } else if gain > MIN_GAIN && change > MIN_CHANGE {
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
                (other.factor.ln().abs() > MIN_DOUBTED_CHANGE).then_some(other.factor)
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

/// Maximum change of the focal length, in the logarithm: a factor of 2.
const MAX_LOG_CHANGE: f64 = std::f64::consts::LN_2;

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
}

/// A pose with a focal length relative to the given one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseWithFocal {
    /// The pose.
    pub pose: CameraFromWorld,
    /// The focal length relative to the given one.
    pub factor: f64,
}

/// The objective: the soft likelihood over chosen correspondences, the camera priors, and the prior of the focal
/// length.
pub struct FocalObjective<'a> {
    /// With the focal length as given.
    pub matches: &'a Matches<'a>,
    /// The camera priors.
    pub priors: PosePriors,
    /// The correspondences that may be right.
    pub active: Vec<usize>,
    /// Scale of the noise, pixels.
    pub noise: f64,
    /// Standard deviation of the logarithm of the focal length.
    pub sd: f64,
}

/// Gauss–Newton system `H δ = −g` over the six parameters of a pose and the logarithm of the focal length.
pub struct FocalSystem {
    /// Number of correspondences that are likelier right than wrong.
    pub agreeing: usize,
    /// The loss there.
    pub loss: f64,
    /// `g`, its derivative.
    pub gradient: SVector<f64, 7>,
    /// `H`, symmetric.
    pub hessian: SMatrix<f64, 7, 7>,
    /// The scores of the matches.
    pub cells: ScoreCells,
}

impl FocalObjective<'_> {
    /// The likelihood's verdict on the given focal length, at the optimum for it.
    ///
    /// One linearized step decides whether to refine. The refinement is necessary because matches that the wrong focal
    /// length lost return only during it.
    pub fn verdict(&self, pose: &CameraFromWorld) -> FocalVerdict {
        let given = PoseWithFocal { pose: *pose, factor: 1.0 };
        let system = self.linearize(&given);
        let Some(step) = solved(&system, 0.0) else { return FocalVerdict::Fine };
        if !FocalVerdict::warrants_refinement(-0.5 * step.dot(&system.gradient), step[6]) {
            return FocalVerdict::Fine;
        }
        let other = self.descend(&given, Convergence { steps: 12, min_gain: 1e-6 });
        let there = self.linearize(&other);
        let gain = (system.loss - there.loss) / there.cells.design_effect();
        FocalVerdict::of(gain, &other, FocalVerdict::min_gain(self.matches.observations, system.agreeing))
    }

    /// Levenberg–Marquardt from a start; never returns a larger loss than the start's.
    pub fn refine(&self, start: &PoseWithFocal) -> PoseWithFocal {
        self.descend(start, Convergence::OF_FOCAL)
    }

    fn descend(&self, start: &PoseWithFocal, convergence: Convergence) -> PoseWithFocal {
        let step = |at: &PoseWithFocal, here: &FocalSystem, damping| {
            Some((moved(at, &solved(here, damping)?)?, f64::INFINITY))
        };
        levenberg_marquardt(*start, convergence, |at| self.linearize(at), |here| here.loss, step).at
    }

    /// Loss and derivatives at a pose and focal length.
    pub fn linearize(&self, at: &PoseWithFocal) -> FocalSystem {
        let matches = self.matches;
        let camera = BentCamera::straight(matches.camera_with_focal(at.factor));
        let mut system = FocalSystem {
            agreeing: 0,
            loss: 0.0,
            gradient: Vector7::zeros(),
            hessian: Matrix7::zeros(),
            cells: ScoreCells::new(&matches.camera),
        };
        for &i in &self.active {
            let Some(residual) = matches.residual_of(&camera, i, &at.pose, true) else { continue };
            let term = matches.likelihood_term(i, &residual, self.noise);
            let LikelihoodTerm { log_ratio, right, weight, loss } = term;
            system.cells.add(&residual.pixel, &residual.score(&term));
            system.agreeing += usize::from(log_ratio > 0.0);
            system.loss += loss;
            let column = |six: &[f64; 6], seventh: f64| {
                Vector7::from([six[0], six[1], six[2], six[3], six[4], six[5], seventh])
            };
            for row in 0..matches.residuals() {
                let j = column(&residual.jacobian[row], residual.by_camera[row][0]);
                system.gradient += j * (weight * residual.error[row]);
                system.hessian += j * j.transpose() * weight;
            }
            system.gradient -= column(&residual.radius_jacobian, residual.radius_by_camera[0]) * right;
        }
        let mut six = System::empty();
        self.priors.add_to(&at.pose, &mut six);
        let log = at.factor.ln();
        system.loss += six.loss + 0.5 * (log / self.sd).powi(2);
        let mut first = system.gradient.fixed_rows_mut::<6>(0);
        first += six.gradient;
        let mut block = system.hessian.fixed_view_mut::<6, 6>(0, 0);
        block += six.hessian;
        system.gradient[6] += log / (self.sd * self.sd);
        system.hessian[(6, 6)] += (self.sd * self.sd).recip();
        system
    }
}

fn solved(system: &FocalSystem, damping: f64) -> Option<Vector7> {
    let mut h = system.hessian;
    for k in 0..7 {
        h[(k, k)] += damping * h[(k, k)].max(1e-12);
    }
    let step = h.cholesky()?.solve(&-system.gradient);
    step.iter().all(|s| s.is_finite()).then_some(step)
}

fn moved(at: &PoseWithFocal, step: &Vector7) -> Option<PoseWithFocal> {
    let pose = at.pose.perturbed(&[step[0], step[1], step[2], step[3], step[4], step[5]]);
    step_focal(at.factor, step[6]).map(|factor| PoseWithFocal { pose, factor })
}

/// The relative focal length after a step of its logarithm, limited to 0.2 per step; `None` outside of the allowed
/// range.
pub fn step_focal(factor: f64, log_step: f64) -> Option<f64> {
    let log = factor.ln() + log_step.clamp(-0.2, 0.2);
    (log.abs() <= MAX_LOG_CHANGE).then(|| log.exp())
}
