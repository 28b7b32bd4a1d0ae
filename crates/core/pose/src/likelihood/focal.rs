//! A focal length that is estimated with the pose: a seventh number.
//!
//! A wrong focal length shows: the projections of right matches miss by amounts that grow towards the image's border, and
//! no pose takes that away unless the scene is flat. Whether it does is read off one linearized system: how much the log
//! likelihood would rise if the focal length were free (a score test). Where it pays, pose and focal length are refined
//! together.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{SMatrix, SVector};

use crate::likelihood::descent::{Convergence, levenberg_marquardt};
use crate::likelihood::matches::Matches;
use crate::likelihood::pose_priors::PosePriors;
use crate::likelihood::problem::{Correspondences, FocalKnowledge};
use crate::likelihood::refine::System;

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;

/// What contradicts a calibrated focal length: so much gained in log likelihood ...
const LEAST_GAIN: f64 = 3.5;

/// ... by a change of so much in its logarithm.
const LEAST_CHANGE: f64 = 0.002;

/// A change below this is what lenses differ by whose distortion was left out, and what the map's own calibration may be
/// wrong by: undoing it in the query alone tears the two apart. The pose stays as it is then, and its covariance says what
/// the change would do to it.
const LEAST_WRONG: f64 = 0.02;

/// What a focal length must change by before the pose is doubted for it: right ones of half-hidden images, whose matches say
/// little of it, were suspected of up to 2.3 %.
const LEAST_DOUBTED: f64 = 0.03;

/// A focal length is called wrong, and estimated, when it gains so much more for each agreeing match; below that it is only
/// suspicious. What a pipeline does with half a pixel also looks like a focal length, and grows with the matches: on the
/// problems of `redkitchen_r08`, whose keypoints lie half a pixel left of where they should, it gained 0.15 to 0.2 a point.
/// A line sees less of either: 3 % of focal length gain less than 0.15 a line of dcl.
const GAIN_A_POINT: f64 = 0.2;
const GAIN_A_LINE: f64 = 0.06;

/// What is to be thought of a calibrated focal length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FocalVerdict {
    /// Nothing speaks against it.
    Fine,
    /// Another, at another pose, would explain the matches better, by too little to change it.
    Suspicious(Zoomed),
    /// It is wrong.
    Wrong,
}

impl FocalVerdict {
    /// What another focal length must gain before the given one is called wrong, when so many matches agree.
    pub fn least_gain(observations: &Correspondences, agreeing: usize) -> f64 {
        Self::least_gain_of([(observations, agreeing)])
    }

    /// The same when so many matches agree in each of several images.
    pub fn least_gain_of<'a>(images: impl IntoIterator<Item = (&'a Correspondences, usize)>) -> f64 {
        let of_a_match = |observations: &Correspondences| match observations {
            Correspondences::Points { .. } => GAIN_A_POINT,
            Correspondences::Lines { .. } | Correspondences::Anchored { .. } => GAIN_A_LINE,
        };
        let each =
            images.into_iter().map(|(observations, agreeing)| of_a_match(observations) * agreeing as f64);
        LEAST_GAIN + each.sum::<f64>()
    }

    /// Whether a linearized step of the logarithm of the focal length gains so much that it is worth looking there.
    pub fn is_worth_a_look(gain: f64, log_step: f64) -> bool {
        gain > LEAST_GAIN && log_step.abs() > LEAST_CHANGE
    }

    /// Of what another focal length gains, and what it must gain to be estimated ([`Self::least_gain`]).
    pub fn of(gain: f64, other: &Zoomed, least_gain: f64) -> Self {
        let change = other.factor.ln().abs();
        if gain > least_gain && change > LEAST_WRONG {
            Self::Wrong
        } else if gain > LEAST_GAIN && change > LEAST_CHANGE {
            Self::Suspicious(*other)
        } else {
            Self::Fine
        }
    }

    /// Whether nothing is known that another focal length would change much.
    pub fn is_near(&self) -> bool {
        *self != Self::Wrong && self.doubted().is_none()
    }

    /// The focal length that a doubt is about, over the given one: one that differs by so much that the pose may be wrong.
    pub fn doubted(&self) -> Option<f64> {
        match self {
            Self::Suspicious(other) if other.factor.ln().abs() > LEAST_DOUBTED => Some(other.factor),
            Self::Suspicious(_) | Self::Fine | Self::Wrong => None,
        }
    }
}

/// The focal length stays within this factor of the one given, in the logarithm: 2.
const LARGEST_CHANGE: f64 = std::f64::consts::LN_2;

impl FocalKnowledge {
    /// Standard deviation of the logarithm of the true focal length over the given one, where it is estimated.
    pub const fn sd(self) -> f64 {
        match self {
            // Estimated only when it is known to be wrong; then nothing is known.
            Self::Calibrated | Self::Unknown => 0.3,
            Self::Exif => 0.05,
        }
    }
}

/// A pose with a focal length over the given one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Zoomed {
    /// The pose.
    pub pose: CameraFromWorld,
    /// The focal length over the given one.
    pub factor: f64,
}

/// What is minimised: the soft likelihood over chosen correspondences, what is known beside them, and of the focal length.
pub struct ZoomObjective<'a> {
    /// With the focal length as given.
    pub matches: &'a Matches<'a>,
    /// What is known beside them.
    pub priors: PosePriors,
    /// The correspondences that may be right.
    pub active: Vec<usize>,
    /// Scale of the noise, pixels.
    pub noise: f64,
    /// Standard deviation of the logarithm of the focal length.
    pub sd: f64,
}

/// Gauss–Newton system `H δ = −g` over the six numbers of a pose and the logarithm of the focal length.
pub struct ZoomSystem {
    /// Correspondences that are likelier right than wrong.
    pub agreeing: usize,
    /// The loss there.
    pub loss: f64,
    /// `g`, its derivative.
    pub gradient: SVector<f64, 7>,
    /// `H`, symmetric.
    pub hessian: SMatrix<f64, 7, 7>,
}

impl ZoomObjective<'_> {
    /// What the likelihood says of the given focal length, at the optimum for it.
    ///
    /// One linearized step tells whether to look; what is there is then refined, because the matches that a wrong focal
    /// length lost come back only on the way.
    pub fn verdict(&self, pose: &CameraFromWorld) -> FocalVerdict {
        let given = Zoomed { pose: *pose, factor: 1.0 };
        let system = self.linearize(&given);
        let Some(step) = solved(&system, 0.0) else { return FocalVerdict::Fine };
        if !FocalVerdict::is_worth_a_look(-0.5 * step.dot(&system.gradient), step[6]) {
            return FocalVerdict::Fine;
        }
        let other = self.descend(&given, Convergence { steps: 12, least_gain: 1e-6 });
        let gain = system.loss - self.linearize(&other).loss;
        FocalVerdict::of(gain, &other, FocalVerdict::least_gain(self.matches.observations, system.agreeing))
    }

    /// Levenberg–Marquardt from a start; never a larger loss than the start's.
    pub fn refine(&self, start: &Zoomed) -> Zoomed {
        self.descend(start, Convergence::OF_FOCAL)
    }

    fn descend(&self, start: &Zoomed, convergence: Convergence) -> Zoomed {
        let step = |at: &Zoomed, here: &ZoomSystem, damping| {
            Some((moved(at, &solved(here, damping)?)?, f64::INFINITY))
        };
        levenberg_marquardt(*start, convergence, |at| self.linearize(at), |here| here.loss, step).at
    }

    /// Loss and derivatives at a pose and focal length.
    pub fn linearize(&self, at: &Zoomed) -> ZoomSystem {
        let (matches, camera) = (self.matches, self.matches.zoomed_camera(at.factor));
        let mut system =
            ZoomSystem { agreeing: 0, loss: 0.0, gradient: Vector7::zeros(), hessian: Matrix7::zeros() };
        let scale = matches.freedom() * self.noise * self.noise;
        let noise_term = matches.noise_term(self.noise);
        for &i in &self.active {
            let Some(residual) = matches.residual_of(&camera, i, &at.pose, true) else { continue };
            let squared = residual.squared();
            let llr = matches.log_likelihood_const[i] + noise_term + residual.log_radius
                - 3.0 * (squared / scale).ln_1p();
            let right = 1.0 / (1.0 + (-llr).exp());
            let weight = 6.0 * right / (scale + squared);
            system.agreeing += usize::from(llr > 0.0);
            system.loss -= llr.max(0.0) + (-llr.abs()).exp().ln_1p();
            let column = |six: &[f64; 6], seventh: f64| {
                Vector7::from([six[0], six[1], six[2], six[3], six[4], six[5], seventh])
            };
            for row in 0..matches.residuals() {
                let j = column(&residual.jacobian[row], residual.by_log_focal[row]);
                system.gradient += j * (weight * residual.error[row]);
                system.hessian += j * j.transpose() * weight;
            }
            system.gradient -= column(&residual.radius_jacobian, residual.radius_by_log_focal) * right;
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

fn solved(system: &ZoomSystem, damping: f64) -> Option<Vector7> {
    let mut h = system.hessian;
    for k in 0..7 {
        h[(k, k)] += damping * h[(k, k)].max(1e-12);
    }
    let step = h.cholesky()?.solve(&-system.gradient);
    step.iter().all(|s| s.is_finite()).then_some(step)
}

fn moved(at: &Zoomed, step: &Vector7) -> Option<Zoomed> {
    let pose = at.pose.perturbed(&[step[0], step[1], step[2], step[3], step[4], step[5]]);
    stretched(at.factor, step[6]).map(|factor| Zoomed { pose, factor })
}

/// A focal length over the given one after a step of its logarithm, of which no more than a fifth is taken at once; `None`
/// where no focal length is looked for any more.
pub fn stretched(factor: f64, log_step: f64) -> Option<f64> {
    let log = factor.ln() + log_step.clamp(-0.2, 0.2);
    (log.abs() <= LARGEST_CHANGE).then(|| log.exp())
}
