//! Errors of the camera model that all matches of an image share: they do not average out over the matches.
//!
//! Six parameters beside the pose describe a camera that is not quite the given one: focal length, aspect ratio, skew,
//! principal point, and the first radial term. Aspect ratio and skew are also the first order of a rolling shutter
//! during a rotation. With `θ` these parameters, `δ` the step of the pose, `H` the Gauss–Newton matrix of the
//! likelihood over both, `g` its gradient, `P` the information of the prior of `θ`, `P₀` that of a camera of which nothing
//! is known, and `c` the variance of errors that neighbouring keypoints share,
//!
//! ```text
//! S = H_θθ − H_θδ H_δδ⁻¹ H_δθ        Σ(P) = (S/c + P)⁻¹        μ(P) = −Σ(P) (g_θ − H_θδ H_δδ⁻¹ g_δ) / c
//! J = −H_δδ⁻¹ H_δθ        C_camera = J [(1 − w) (Σ(P) + μ(P) μ(P)ᵀ) + w (Σ(P₀) + μ(P₀) μ(P₀)ᵀ)] Jᵀ
//! log w/(1 − w) = G/c − ½ log det(I + P₀⁻¹ S/c) + log prior odds
//! ```
//!
//! `J` is how the pose moves with the camera when the matches are fixed, so `C_camera` is the covariance that the
//! camera model adds to a pose that was estimated with the given camera: what the matches leave open about it, and
//! what they say against it. `G = −½ gᵀ (δ, θ)` is the gain of log likelihood; a camera that the matches clearly
//! contradict is estimated together with the pose ([`CameraObjective::better_camera`]).

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::Pinhole;
use veiloc_geometry::nalgebra::{Matrix6, SMatrix, SVector, Vector2};

use crate::likelihood::descent::{Convergence, levenberg_marquardt};
use crate::likelihood::design_effect::ScoreCells;
use crate::likelihood::fisher::Symmetric6;
use crate::likelihood::focal::FocalVerdict;
use crate::likelihood::matches::{LikelihoodTerm, Matches};
use crate::likelihood::pose_priors::PosePriors;
use crate::likelihood::problem::FocalPrior;
use crate::likelihood::refine::System;

/// Number of parameters of the camera.
pub(crate) const CAMERA: usize = 6;
/// And with the pose.
const ALL: usize = 6 + CAMERA;

type MatrixAll = SMatrix<f64, ALL, ALL>;
type VectorAll = SVector<f64, ALL>;
type MatrixC = SMatrix<f64, CAMERA, CAMERA>;
type Vector6C = SVector<f64, CAMERA>;

/// Prior standard deviations of [`CameraChange`] for a calibrated camera: half a per cent of the width for the
/// principal point, as calibrations of one camera differ; the others move a pixel at the border by about as much.
const CALIBRATED_SD: [f64; CAMERA] = [0.003, 0.003, 0.003, 0.005, 0.005, 0.01];

/// For the cameras of a map: the nominal principal point of RedKitchen's images is 1 % of the width off, and a camera that
/// is estimated against them takes part of their errors over.
const MAP_SD: [f64; CAMERA] = [0.006, 0.006, 0.003, 0.015, 0.015, 0.015];

/// For a camera that is not calibrated: a phone's principal point is within some per cent of the middle, and its
/// distortion is small.
const UNCALIBRATED_SD: [f64; CAMERA] = [0.003, 0.005, 0.003, 0.015, 0.015, 0.03];

/// For a camera that is not what the query says: a cropped image, distortion that was not removed.
const OPEN_SD: [f64; CAMERA] = [0.3, 0.1, 0.01, 0.2, 0.2, 0.3];

/// For a camera that is estimated without distortion.
const STRAIGHT_SD: [f64; CAMERA] = [0.3, 0.1, 1e-4, 0.2, 0.2, 1e-4];

/// Logarithm of the prior odds that a query's camera is not what it says: one of 150.
const LOG_PRIOR_ODDS: f64 = -5.0;

/// Changes from which on a camera is called wrong. Smaller ones are caused by errors of the map's own cameras too:
/// correcting them in the query alone would make query and map inconsistent.
const MIN_WRONG: [f64; CAMERA] = [0.05, 0.03, f64::INFINITY, 0.03, 0.03, f64::INFINITY];

/// Log odds from which on another camera is estimated: beyond doubt, because the given one is then left.
const MIN_LOG_ODDS: f64 = 20.0;

/// Share of the gain that a camera without distortion must reach.
const MIN_STRAIGHT_GAIN: f64 = 0.9;

/// Fewer agreeing matches than this do not determine six parameters of a camera beside the pose.
const MIN_AGREEING: usize = 100;

/// How a camera differs from a given one: logarithm of the focal length, logarithm of `fx / fy`, skew, shift of the
/// principal point as shares of the image's width, first radial term.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CameraChange(pub [f64; CAMERA]);

impl CameraChange {
    /// A change of the focal length only.
    pub fn of_focal(factor: f64) -> Self {
        Self([factor.ln(), 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// The changed camera, without skew and radial term.
    pub fn pinhole(&self, given: &Pinhole) -> Pinhole {
        let [log_focal, log_aspect, _, cx, cy, _] = self.0;
        let width = f64::from(given.width);
        Pinhole {
            focal: [
                given.focal[0] * (log_focal + 0.5 * log_aspect).exp(),
                given.focal[1] * (log_focal - 0.5 * log_aspect).exp(),
            ],
            principal: [given.principal[0] + cx * width, given.principal[1] + cy * width],
            ..*given
        }
    }

    /// The focal length relative to the given one.
    pub fn factor(&self) -> f64 {
        self.0[0].exp()
    }

    /// Shift of the principal point, pixels.
    pub fn principal_shift_px(&self, given: &Pinhole) -> [f64; 2] {
        [3, 4].map(|k| self.0[k] * f64::from(given.width))
    }

    /// The same change without skew and radial term.
    #[must_use]
    pub const fn without_bending(self) -> Self {
        let [focal, aspect, _, cx, cy, _] = self.0;
        Self([focal, aspect, 0.0, cx, cy, 0.0])
    }
}

/// The camera of a residual: a pinhole with skew and a radial term.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BentCamera {
    pub(crate) pinhole: Pinhole,
    skew: f64,
    radial: f64,
}

impl BentCamera {
    pub(crate) const fn straight(pinhole: Pinhole) -> Self {
        Self { pinhole, skew: 0.0, radial: 0.0 }
    }

    pub(crate) fn changed(given: &Pinhole, change: &CameraChange) -> Self {
        Self { pinhole: change.pinhole(given), skew: change.0[2], radial: change.0[5] }
    }

    /// The bent coordinates of a point of the image plane, and their derivatives by it.
    pub(crate) fn bend(&self, plane: &Vector2<f64>) -> (Vector2<f64>, SMatrix<f64, 2, 2>) {
        let squared = plane.norm_squared();
        let grow = 1.0 + self.radial * squared;
        let bent = Vector2::new(plane.x * grow + self.skew * plane.y, plane.y * grow);
        let mut by_plane = plane * plane.transpose() * (2.0 * self.radial);
        by_plane[(0, 0)] += grow;
        by_plane[(1, 1)] += grow;
        by_plane[(0, 1)] += self.skew;
        (bent, by_plane)
    }

    /// Derivatives of the pixel by the parameters of [`CameraChange`].
    pub(crate) fn pixel_by_change(
        &self,
        plane: &Vector2<f64>,
        bent: &Vector2<f64>,
    ) -> [Vector2<f64>; CAMERA] {
        let [fx, fy] = self.pinhole.focal;
        let width = f64::from(self.pinhole.width);
        let zoom = Vector2::new(fx * bent.x, fy * bent.y);
        let squared = plane.norm_squared();
        [
            zoom,
            Vector2::new(0.5 * zoom.x, -0.5 * zoom.y),
            Vector2::new(fx * plane.y, 0.0),
            Vector2::new(width, 0.0),
            Vector2::new(0.0, width),
            Vector2::new(fx * plane.x * squared, fy * plane.y * squared),
        ]
    }
}

/// A pose with a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseWithCamera {
    /// The pose.
    pub pose: CameraFromWorld,
    /// The camera.
    pub change: CameraChange,
}

/// The likelihood over chosen correspondences with the camera as parameters.
pub struct CameraObjective<'a> {
    /// With the camera as given.
    pub matches: &'a Matches<'a>,
    /// The camera priors.
    pub priors: &'a PosePriors,
    /// The correspondences that may be right.
    pub active: Vec<usize>,
    /// Scale of the noise, pixels.
    pub noise: f64,
    /// How well the camera is known.
    pub known: FocalPrior,
    /// Whether the focal length is a parameter here. If not, it was estimated before, and its uncertainty is in the
    /// covariance of the pose.
    pub with_focal: bool,
}

/// Gauss–Newton system over the pose and the camera.
struct CameraSystem {
    cells: ScoreCells,
    agreeing: usize,
    loss: f64,
    gradient: VectorAll,
    hessian: MatrixAll,
}

impl CameraSystem {
    /// The system with the pose eliminated; `None` when the matches do not determine the pose.
    fn without_pose(&self, shared_variance: f64) -> Option<WithoutPose> {
        let pose = self.hessian.fixed_view::<6, 6>(0, 0).into_owned();
        let mixed = self.hessian.fixed_view::<6, CAMERA>(0, 6).into_owned();
        // Radians and map units differ in scale.
        let unit = pose.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
        if !(unit.min() > 0.0) {
            return None;
        }
        let unit = Matrix6::from_diagonal(&unit);
        let inverse = unit * (unit * pose * unit).cholesky()?.inverse() * unit;
        Some(WithoutPose {
            pose_by_camera: -inverse * mixed,
            information: self.hessian.fixed_view::<CAMERA, CAMERA>(6, 6)
                - mixed.transpose() * inverse * mixed,
            gradient: self.gradient.fixed_rows::<CAMERA>(6)
                - mixed.transpose() * inverse * self.gradient.fixed_rows::<6>(0),
            shared_variance,
        })
    }
}

/// What the matches say about the camera.
struct WithoutPose {
    /// `J`: how the pose moves with the camera.
    pose_by_camera: MatrixC,
    /// `S`.
    information: MatrixC,
    gradient: Vector6C,
    shared_variance: f64,
}

impl WithoutPose {
    /// Log odds that the camera is not what the query says, for this gain of log likelihood under the open prior: the
    /// gain, less what six free parameters gain by their freedom, and the prior odds.
    fn log_odds(&self, gain: f64) -> Option<f64> {
        let unit = MatrixC::from_diagonal(&Vector6C::from(OPEN_SD));
        let freedom = unit * self.information * unit / self.shared_variance + MatrixC::identity();
        let log_det: f64 = freedom.cholesky()?.l().diagonal().iter().map(|d| d.ln()).sum();
        Some(gain / self.shared_variance - log_det + LOG_PRIOR_ODDS)
    }
}

impl CameraObjective<'_> {
    /// The covariance that the camera model adds to a pose estimated with this camera, `C_camera`; 0 when the matches
    /// do not determine the pose.
    pub fn covariance(&self, at: &PoseWithCamera) -> Symmetric6 {
        let sd = match self.known {
            FocalPrior::Calibrated => CALIBRATED_SD,
            FocalPrior::Exif | FocalPrior::Unknown => UNCALIBRATED_SD,
        };
        let here = self.linearize(at);
        let shared_variance = self.shared_variance(&here, at);
        covariance_in(&here, &self.with_fixed_focal(sd), shared_variance, false).unwrap_or([[0.0; 6]; 6])
    }

    /// The same for a camera that was estimated: what the matches leave open, and how the map's own cameras differ from
    /// the true ones.
    pub fn covariance_of_estimated(&self, at: &PoseWithCamera) -> Symmetric6 {
        let mut system = self.linearize(at);
        system.gradient = VectorAll::zeros();
        let shared_variance = system.cells.design_effect();
        let covariance = |sd, prior_only| {
            covariance_in(&system, &self.with_fixed_focal(sd), shared_variance, prior_only)
                .unwrap_or([[0.0; 6]; 6])
        };
        let (open, of_map) = (covariance(OPEN_SD, false), covariance(MAP_SD, true));
        std::array::from_fn(|i| std::array::from_fn(|j| open[i][j] + of_map[i][j]))
    }

    /// Variance of errors that neighbouring keypoints share, in multiples of that of independent errors: as the
    /// residuals show it when the camera is free, so that the error of a wrong camera does not count.
    fn shared_variance(&self, here: &CameraSystem, at: &PoseWithCamera) -> f64 {
        let free =
            solved(here, &self.with_fixed_focal(OPEN_SD), &at.change, 0.0).and_then(|step| moved(at, &step));
        let of_given = here.cells.design_effect();
        // A long step may lose matches.
        free.map_or(of_given, |free| self.linearize(&free).cells.design_effect().min(of_given))
    }

    fn with_fixed_focal(&self, mut sd: [f64; CAMERA]) -> [f64; CAMERA] {
        if !self.with_focal {
            sd[0] = 1e-9;
        }
        sd
    }

    /// Another camera that explains the matches clearly better, with its pose; `at` is an optimum for the given camera.
    ///
    /// One linearized step decides whether to refine. The refinement is necessary because matches that the wrong camera
    /// lost return only during it.
    pub fn better_camera(&self, at: &PoseWithCamera) -> Option<PoseWithCamera> {
        let here = self.linearize(at);
        if here.agreeing < MIN_AGREEING {
            return None;
        }
        let min_gain = FocalVerdict::min_gain(self.matches.observations, here.agreeing);
        let step = solved(&here, &OPEN_SD, &at.change, 0.0)?;
        // Half of the thresholds: the linear step is shorter than the refined one while matches are lost.
        let is_near = (0..CAMERA).all(|k| step[6 + k].abs() < 0.5 * MIN_WRONG[k]);
        if is_near {
            return None;
        }
        let log_odds = |gain: f64, shared_variance: f64| {
            here.without_pose(shared_variance).and_then(|e| e.log_odds(gain)).unwrap_or(f64::NEG_INFINITY)
        };
        if log_odds(-step.dot(&here.gradient), self.shared_variance(&here, at)) < 0.0 {
            return None;
        }
        let open = self.descend(at, &OPEN_SD);
        let shared_variance = self.linearize(&open).cells.design_effect();
        let gain = self.gain(&here, at, &open, &OPEN_SD);
        if gain / shared_variance < min_gain || log_odds(gain, shared_variance) < MIN_LOG_ODDS {
            return None;
        }
        let straight = PoseWithCamera { change: open.change.without_bending(), ..open };
        let other = self.descend(&straight, &STRAIGHT_SD);
        let is_large = (0..CAMERA).any(|k| (other.change.0[k] - at.change.0[k]).abs() > MIN_WRONG[k]);
        // Where distortion explains much of it, other parameters would only stand for the distortion.
        let gain_of_other = self.gain(&here, at, &other, &STRAIGHT_SD);
        (is_large && gain_of_other > MIN_STRAIGHT_GAIN * gain).then_some(other)
    }

    /// What another camera gains in log likelihood under a prior.
    fn gain(
        &self,
        here: &CameraSystem,
        at: &PoseWithCamera,
        other: &PoseWithCamera,
        sd: &[f64; CAMERA],
    ) -> f64 {
        penalized(here, &at.change, sd) - penalized(&self.linearize(other), &other.change, sd)
    }

    fn descend(&self, start: &PoseWithCamera, sd: &[f64; CAMERA]) -> PoseWithCamera {
        let step = |at: &PoseWithCamera, (here, _): &(CameraSystem, f64), damping| {
            Some((moved(at, &solved(here, sd, &at.change, damping)?)?, f64::INFINITY))
        };
        let look = |at: &PoseWithCamera| {
            let system = self.linearize(at);
            let loss = penalized(&system, &at.change, sd);
            (system, loss)
        };
        let convergence = Convergence { steps: 20, min_gain: 1e-6 };
        levenberg_marquardt(*start, convergence, look, |(_, loss)| *loss, step).at
    }

    /// Loss and derivatives at a pose and camera.
    fn linearize(&self, at: &PoseWithCamera) -> CameraSystem {
        let matches = self.matches;
        let camera = BentCamera::changed(&matches.camera, &at.change);
        let mut system = CameraSystem {
            cells: ScoreCells::new(&matches.camera),
            agreeing: 0,
            loss: 0.0,
            gradient: VectorAll::zeros(),
            hessian: MatrixAll::zeros(),
        };
        let column = |pose: &[f64; 6], camera: &[f64; CAMERA]| {
            VectorAll::from_fn(|k, _| if k < 6 { pose[k] } else { camera[k - 6] })
        };
        for &i in &self.active {
            let Some(residual) = matches.residual_of(&camera, i, &at.pose, true) else { continue };
            let term = matches.likelihood_term(i, &residual, self.noise);
            let LikelihoodTerm { log_ratio, right, weight, loss } = term;
            system.cells.add(&residual.pixel, &residual.score(&term));
            system.agreeing += usize::from(log_ratio > 0.0);
            system.loss += loss;
            for row in 0..matches.residuals() {
                let j = column(&residual.jacobian[row], &residual.by_camera[row]);
                system.gradient += j * (weight * residual.error[row]);
                system.hessian += j * j.transpose() * weight;
            }
            system.gradient -= column(&residual.radius_jacobian, &residual.radius_by_camera) * right;
        }
        let mut six = System::empty();
        self.priors.add_to(&at.pose, &mut six);
        system.loss += six.loss;
        let mut first = system.gradient.fixed_rows_mut::<6>(0);
        first += six.gradient;
        let mut block = system.hessian.fixed_view_mut::<6, 6>(0, 0);
        block += six.hessian;
        system
    }
}

/// `C_camera` for these prior deviations; `prior_only` leaves the matches out of `Σ`.
fn covariance_in(
    system: &CameraSystem,
    sd: &[f64; CAMERA],
    shared_variance: f64,
    prior_only: bool,
) -> Option<Symmetric6> {
    let eliminated = system.without_pose(shared_variance)?;
    let WithoutPose { pose_by_camera, information, gradient, shared_variance } = &eliminated;
    let prior = |sd: &[f64; CAMERA]| MatrixC::from_diagonal(&Vector6C::from_fn(|k, _| sd[k].powi(-2)));
    let spread = if prior_only {
        prior(sd).try_inverse()?
    } else {
        let mut open = OPEN_SD;
        // A focal length that is no parameter here.
        open[0] = if sd[0] < 1e-6 { sd[0] } else { open[0] };
        let full: Vector6C = -(information + prior(&open)).cholesky()?.solve(gradient);
        let log_odds = eliminated.log_odds(-0.5 * full.dot(gradient))?;
        let is_wrong = 1.0 / (1.0 + (-log_odds).exp());
        // Second moment about the given camera under a prior.
        let moment = |sd: &[f64; CAMERA]| {
            let factor = (information / *shared_variance + prior(sd)).cholesky()?;
            let mean: Vector6C = -factor.solve(&(gradient / *shared_variance));
            Some(factor.inverse() + mean * mean.transpose())
        };
        moment(sd)? * (1.0 - is_wrong) + moment(&open)? * is_wrong
    };
    let covariance = pose_by_camera * spread * pose_by_camera.transpose();
    let symmetric = |i: usize, j: usize| 0.5 * (covariance[(i, j)] + covariance[(j, i)]);
    covariance
        .iter()
        .all(|c| c.is_finite())
        .then(|| std::array::from_fn(|i| std::array::from_fn(|j| symmetric(i, j))))
}

/// The loss with a prior of the camera.
fn penalized(system: &CameraSystem, change: &CameraChange, sd: &[f64; CAMERA]) -> f64 {
    system.loss + change.0.iter().zip(sd).map(|(c, sd)| 0.5 * (c / sd).powi(2)).sum::<f64>()
}

fn solved(
    system: &CameraSystem,
    sd: &[f64; CAMERA],
    change: &CameraChange,
    damping: f64,
) -> Option<VectorAll> {
    let (mut h, mut g) = (system.hessian, system.gradient);
    for k in 0..CAMERA {
        h[(6 + k, 6 + k)] += sd[k].powi(-2);
        g[6 + k] += change.0[k] / (sd[k] * sd[k]);
    }
    for k in 0..ALL {
        h[(k, k)] += damping * h[(k, k)].max(1e-12);
    }
    let step = h.cholesky()?.solve(&-g);
    step.iter().all(|s| s.is_finite()).then_some(step)
}

fn moved(at: &PoseWithCamera, step: &VectorAll) -> Option<PoseWithCamera> {
    let pose = at.pose.perturbed(&[step[0], step[1], step[2], step[3], step[4], step[5]]);
    let change = CameraChange(std::array::from_fn(|k| at.change.0[k] + step[6 + k].clamp(-0.2, 0.2)));
    (change.0.iter().all(|c| c.abs() <= 0.7)).then_some(PoseWithCamera { pose, change })
}
