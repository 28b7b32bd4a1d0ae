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
//! E(P) = G(P)/c − ½ log det(I + P⁻¹ S/c)        log w/(1 − w) = E(P₀) − E(P) + log prior odds
//! ```
//!
//! `J` is how the pose moves with the camera when the matches are fixed, so `C_camera` is the covariance that the
//! camera model adds to a pose that was estimated with the given camera: what the matches leave open about it, and
//! what they say against it. `G(P)` is the gain of log likelihood of the best camera under a prior, `E` its evidence.
//! `P` includes the errors of the map's own cameras ([`MapCameras`]). A camera that the matches clearly contradict is
//! estimated together with the pose ([`CameraObjective::test`]).

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::Pinhole;
use veiloc_geometry::nalgebra::{Matrix6, SMatrix, SVector, Vector2};

use crate::likelihood::descent::{Convergence, levenberg_marquardt};
use crate::likelihood::design_effect::ScoreCells;
use crate::likelihood::fisher::{Symmetric6, propagated};
use crate::likelihood::focal::{FocalVerdict, PoseWithFocal};
use crate::likelihood::map_cameras::{BestCamera, CameraEvidence, LOG_PRIOR_ODDS, MapCameras, OPEN_SD};
use crate::likelihood::matches::{LikelihoodTerm, Matches, Residual};
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

/// Prior standard deviations of [`CameraChange`] between calibrations of one camera: half a per cent of the width for
/// the principal point; the others move a pixel at the border by about as much.
const CALIBRATED_SD: [f64; CAMERA] = [0.003, 0.003, 0.003, 0.005, 0.005, 0.01];

/// For the ± of a pose. Wider than calibrations differ: a principal point that is some per cent of the width off (a
/// cropped image, a nominal camera) is too frequent to be ruled out where the matches do not show it.
const ASSUMED_SD: [f64; CAMERA] = [0.003, 0.01, 0.003, 0.015, 0.015, 0.02];

/// For the ± of a pose whose camera was estimated: it takes part of the errors of the map's cameras over.
const ESTIMATED_SD: [f64; CAMERA] = [0.006, 0.006, 0.003, 0.015, 0.015, 0.015];

/// For a camera that is estimated without distortion.
const STRAIGHT_SD: [f64; CAMERA] = [0.3, 0.1, 1e-4, 0.2, 0.2, 1e-4];

/// Changes from which on a camera is called wrong. Smaller ones are caused by errors of the map's own cameras too:
/// correcting them in the query alone would make query and map inconsistent.
const MIN_WRONG: [f64; CAMERA] = [0.05, 0.03, f64::INFINITY, 0.03, 0.03, 0.1];

/// Standard deviations of the map's cameras that a change must exceed.
const MIN_WRONG_SDS: f64 = 3.0;

/// Log odds of one linear step from which on the best camera is estimated. The step finds much less than the
/// estimation, in which matches return that the wrong camera lost.
const MIN_LINEAR_LOG_ODDS: f64 = -15.0;

/// Log odds from which on another camera is estimated: beyond doubt, because the given one is then left.
const MIN_ESTIMATED_LOG_ODDS: f64 = 20.0;

/// Share of the gain that a camera without distortion must reach, unless the rest may be due to chance.
const MIN_STRAIGHT_GAIN: f64 = 0.9;

/// Skew and radial term gain up to this by chance (98 % quantile of half a chi-squared with two degrees of freedom).
const CHANCE_GAIN: f64 = 3.9;

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
    /// Errors of the map's own cameras.
    pub map: MapCameras,
    /// How well the given focal length is known.
    pub known: FocalPrior,
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
    fn without_pose(&self, shared_variance: f64) -> Option<CameraInfluence> {
        let pose = self.hessian.fixed_view::<6, 6>(0, 0).into_owned();
        let mixed = self.hessian.fixed_view::<6, CAMERA>(0, 6).into_owned();
        // Radians and map units differ in scale.
        let unit = pose.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
        if !(unit.min() > 0.0) {
            return None;
        }
        let unit = Matrix6::from_diagonal(&unit);
        let inverse = unit * (unit * pose * unit).cholesky()?.inverse() * unit;
        let information =
            self.hessian.fixed_view::<CAMERA, CAMERA>(6, 6) - mixed.transpose() * inverse * mixed;
        let gradient = self.gradient.fixed_rows::<CAMERA>(6)
            - mixed.transpose() * inverse * self.gradient.fixed_rows::<6>(0);
        let evidence = CameraEvidence {
            information: std::array::from_fn(|i| std::array::from_fn(|j| information[(i, j)])),
            gradient: gradient.into(),
            shared_variance,
            best: None,
            focal_gain: 0.0,
        };
        Some(CameraInfluence { pose_by_camera: -inverse * mixed, evidence })
    }
}

/// What the matches say about the camera, and how the pose follows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraInfluence {
    /// `J`: the step of the pose by each parameter of the camera.
    pub pose_by_camera: SMatrix<f64, 6, CAMERA>,
    /// What the matches say, with the pose free.
    pub evidence: CameraEvidence,
}

/// The matches linearized at a pose with its camera ([`CameraObjective::look`]).
pub struct CameraLook {
    at: PoseWithCamera,
    system: CameraSystem,
    /// How the pose follows the camera, and what the matches say about it; `None` when they do not determine the pose.
    pub influence: Option<CameraInfluence>,
}

/// Result of [`CameraObjective::test_focal`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalTest {
    /// The verdict on the given focal length.
    pub verdict: FocalVerdict,
    /// The best pose with about the given focal length.
    pub pose_of_given: CameraFromWorld,
}

/// What another focal length gains over the given one.
struct FocalGain {
    /// In log likelihood, over the design effect.
    gain: f64,
    /// Matches that agree with the given one.
    agreeing: usize,
    /// The best pose with any focal length.
    other: PoseWithFocal,
    /// The best pose with about the given one.
    pose_of_given: CameraFromWorld,
}

/// Whether the matches contradict the camera of a query.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CameraVerdict {
    /// Not more than the map's own cameras.
    Fine,
    /// Another camera without distortion explains them, with this pose.
    Other(PoseWithCamera),
    /// They contradict it, and no camera without distortion explains them.
    Contradicted,
}

impl CameraObjective<'_> {
    /// The matches linearized at a pose with its camera, which is an optimum.
    pub fn look(&self, at: &PoseWithCamera) -> CameraLook {
        let system = self.linearize(at);
        let influence = system.without_pose(self.shared_variance(&system, at));
        CameraLook { at: *at, system, influence }
    }

    /// The covariance that the camera model adds to a pose estimated with this camera, `C_camera`; 0 when the matches
    /// do not determine the pose.
    pub fn covariance(&self, here: &CameraLook) -> Symmetric6 {
        let covariance =
            |found: &CameraInfluence| found.of_pose(&self.assumed_spread(&found.evidence, &here.at.change)?);
        here.influence.as_ref().and_then(covariance).unwrap_or([[0.0; 6]; 6])
    }

    /// Second moment of the camera's errors that the ± of a pose with this camera assumes. That of an estimated focal
    /// length alone is left out: it is in the covariance of the pose already.
    pub fn assumed_spread(
        &self,
        evidence: &CameraEvidence,
        camera: &CameraChange,
    ) -> Option<SMatrix<f64, CAMERA, CAMERA>> {
        let [given, open] =
            [evidence.posterior(&self.assumed_about(camera, &ASSUMED_SD))?, evidence.posterior(&OPEN_SD)?];
        let log_odds = open.log_evidence - given.log_evidence + self.log_prior_odds(camera);
        let is_wrong = 1.0 / (1.0 + (-log_odds).exp());
        let spread = given.second_moment() * (1.0 - is_wrong) + open.second_moment() * is_wrong;
        if !self.is_focal_estimated(camera) {
            return Some(spread);
        }
        let mut focal_alone = [1e-9; CAMERA];
        focal_alone[0] = self.known.sd();
        Some(spread - evidence.posterior(&focal_alone)?.covariance)
    }

    /// The same for a camera that was estimated: what the matches leave open, and how the map's own cameras differ from
    /// the true ones.
    pub fn covariance_of_estimated(&self, at: &PoseWithCamera) -> Symmetric6 {
        let mut system = self.linearize(at);
        system.gradient = VectorAll::zeros();
        let shared_variance = system.cells.design_effect();
        let covariance = |found: CameraInfluence| {
            let open = found.evidence.posterior(&OPEN_SD)?;
            let of_map = Vector6C::from(self.beyond_map(&ESTIMATED_SD)).map(|sd| sd * sd);
            found.of_pose(&(open.covariance + MatrixC::from_diagonal(&of_map)))
        };
        system.without_pose(shared_variance).and_then(covariance).unwrap_or([[0.0; 6]; 6])
    }

    /// Whether the focal length was estimated before: it is not calibrated, or the calibration was found to be wrong. The
    /// rest of the camera is not to be relied on then either: the image may have been cropped.
    fn is_focal_estimated(&self, camera: &CameraChange) -> bool {
        self.known != FocalPrior::Calibrated || camera.0[0] != 0.0
    }

    /// Logarithm of the prior odds that there is more wrong with this camera.
    fn log_prior_odds(&self, camera: &CameraChange) -> f64 {
        if self.is_focal_estimated(camera) { 0.0 } else { LOG_PRIOR_ODDS }
    }

    /// Standard deviations of errors about this camera: these, or those of the map's own cameras if they are larger; a
    /// focal length that was estimated is free within its prior.
    fn assumed_about(&self, camera: &CameraChange, sd: &[f64; CAMERA]) -> [f64; CAMERA] {
        let mut sd = self.beyond_map(sd);
        if self.is_focal_estimated(camera) {
            sd[0] = sd[0].max(self.known.sd());
        }
        sd
    }

    /// These standard deviations, or those of the map's own cameras if they are larger.
    fn beyond_map(&self, sd: &[f64; CAMERA]) -> [f64; CAMERA] {
        std::array::from_fn(|k| sd[k].max(self.map.sd[k]))
    }

    /// Variance of errors that neighbouring keypoints share, in multiples of that of independent errors: as the
    /// residuals show it when the camera is free, so that the error of a wrong camera does not count.
    fn shared_variance(&self, here: &CameraSystem, at: &PoseWithCamera) -> f64 {
        let free = solved(here, &OPEN_SD, &at.change, 0.0).and_then(|step| moved(at, &step));
        let of_given = here.cells.design_effect();
        // A long step may lose matches.
        free.map_or(of_given, |free| self.cells(&free).design_effect().min(of_given))
    }

    /// Tests the given camera, seen at an optimum for it.
    ///
    /// One linearized step decides whether to estimate the camera. The estimation is necessary because matches that the
    /// wrong camera lost return only during it.
    pub fn test(&self, look: &CameraLook) -> CameraVerdict {
        let CameraLook { at, system: here, influence } = look;
        let Some(CameraInfluence { evidence: linear, .. }) = influence else { return CameraVerdict::Fine };
        let Some(step) = solved(here, &OPEN_SD, &at.change, 0.0) else { return CameraVerdict::Fine };
        let min_wrong: [f64; CAMERA] =
            std::array::from_fn(|k| MIN_WRONG[k].max(MIN_WRONG_SDS * self.map.sd[k]));
        // Half of the thresholds: the linear step is shorter than the refined one while matches are lost.
        let is_near = (0..CAMERA).all(|k| step[6 + k].abs() < 0.5 * min_wrong[k]);
        let calibrated = self.assumed_about(&at.change, &CALIBRATED_SD);
        let log_odds_of = |of: &CameraEvidence| {
            of.log_odds(&calibrated).map(|odds| odds - LOG_PRIOR_ODDS + self.log_prior_odds(&at.change))
        };
        if is_near || !(log_odds_of(linear) >= Some(MIN_LINEAR_LOG_ODDS)) {
            return CameraVerdict::Fine;
        }
        let open = self.descend(at, &OPEN_SD);
        let best = self.best(here, at, &open);
        let log_odds = log_odds_of(&CameraEvidence { best: Some(best), ..*linear });
        // A camera that is not calibrated need not be contradicted beyond doubt.
        let (min_gain, min_estimated) = if self.is_focal_estimated(&at.change) {
            (0.0, 0.0)
        } else {
            (FocalVerdict::min_gain(self.matches.observations, here.agreeing), MIN_ESTIMATED_LOG_ODDS)
        };
        if best.gain / best.shared_variance < min_gain || !(log_odds > Some(self.map.min_log_odds)) {
            return CameraVerdict::Fine;
        }
        let straight = PoseWithCamera { change: open.change.without_bending(), ..open };
        let other = self.descend(&straight, &STRAIGHT_SD);
        let is_large = (0..CAMERA).any(|k| (other.change.0[k] - at.change.0[k]).abs() > min_wrong[k]);
        // Where distortion explains much of it, other parameters would only stand for the distortion.
        let gain_of_other = self.gain(here, at, &other, &STRAIGHT_SD);
        let left = best.gain - gain_of_other;
        let is_straight =
            left < (1.0 - MIN_STRAIGHT_GAIN) * best.gain || left < CHANCE_GAIN * best.shared_variance;
        let is_explained = is_large && is_straight && log_odds >= Some(min_estimated);
        if is_explained && here.agreeing >= MIN_AGREEING {
            CameraVerdict::Other(other)
        } else {
            CameraVerdict::Contradicted
        }
    }

    /// Tests a focal length that was estimated instead of the given one: distortion that the map's own cameras lack, too,
    /// resembles another focal length where the matches are few. Compares the best camera with any focal length with
    /// the best one with the given focal length, when the other parameters differ as those of the map's cameras.
    pub fn test_focal(&self, at: &PoseWithFocal) -> FocalTest {
        let FocalGain { gain, agreeing, other, pose_of_given } =
            self.focal_gain(at, &self.beyond_map(&CALIBRATED_SD));
        let min_gain =
            FocalVerdict::min_gain(self.matches.observations, agreeing).max(self.map.min_focal_gain);
        FocalTest { verdict: FocalVerdict::of(gain, &other, min_gain), pose_of_given }
    }

    /// The gains of an estimated focal length over the given one when the other parameters differ as those of the map's
    /// cameras, and when they are nearly exact.
    pub fn focal_gains(&self, at: &PoseWithFocal) -> [f64; 2] {
        [self.beyond_map(&CALIBRATED_SD), CALIBRATED_SD].map(|given| self.focal_gain(at, &given).gain)
    }

    fn focal_gain(&self, at: &PoseWithFocal, given: &[f64; CAMERA]) -> FocalGain {
        let mut open = *given;
        open[0] = OPEN_SD[0];
        let at = PoseWithCamera { pose: at.pose, change: CameraChange::of_focal(at.factor) };
        let [at_given, at_open] = [given, &open].map(|sd| self.descend(&at, sd));
        let [loss, open_loss] = [(&at_given, given), (&at_open, &open)].map(|(at, sd)| {
            let here = self.linearize(at);
            (penalized(&here, &at.change, sd), here)
        });
        FocalGain {
            gain: (loss.0 - open_loss.0) / open_loss.1.cells.design_effect(),
            agreeing: loss.1.agreeing,
            other: PoseWithFocal { pose: at_open.pose, factor: at_open.change.factor() },
            pose_of_given: at_given.pose,
        }
    }

    /// What the matches say about the given camera, with the best camera estimated; seen at an optimum for the given one.
    /// `None` when they do not determine the pose.
    pub fn evidence(&self, look: &CameraLook) -> Option<CameraEvidence> {
        let linear = look.influence.as_ref()?.evidence;
        let best = self.best(&look.system, &look.at, &self.descend(&look.at, &OPEN_SD));
        Some(CameraEvidence { best: Some(best), ..linear })
    }

    fn best(&self, here: &CameraSystem, at: &PoseWithCamera, open: &PoseWithCamera) -> BestCamera {
        BestCamera {
            gain: self.gain(here, at, open, &OPEN_SD),
            shared_variance: self.cells(open).design_effect(),
        }
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

    /// The best camera under a prior, from a start. Not gated: matches that leave the image or their sector at a step
    /// make the loss jump, and a large shift of the principal point needs many steps.
    fn descend(&self, start: &PoseWithCamera, sd: &[f64; CAMERA]) -> PoseWithCamera {
        let step = |at: &PoseWithCamera, (here, _): &(CameraSystem, f64), damping| {
            Some((moved(at, &solved(here, sd, &at.change, damping)?)?, f64::INFINITY))
        };
        let look = |at: &PoseWithCamera| {
            let system = self.system(at, false);
            let loss = penalized(&system, &at.change, sd);
            (system, loss)
        };
        let convergence = Convergence { steps: 20, min_gain: 1e-6 };
        levenberg_marquardt(*start, convergence, look, |(_, loss)| *loss, step).at
    }

    /// Loss and derivatives at a pose and camera.
    fn linearize(&self, at: &PoseWithCamera) -> CameraSystem {
        self.system(at, true)
    }

    /// The same; when not `gated`, also of matches whose points project outside of the image or of their sector.
    fn system(&self, at: &PoseWithCamera, gated: bool) -> CameraSystem {
        let rows = self.matches.residuals();
        let mut cells = ScoreCells::new(&self.matches.camera);
        let (mut agreeing, mut loss) = (0, 0.0);
        let mut gradient = [0.0; ALL];
        let mut hessian = [[0.0; ALL]; ALL];
        self.each(at, gated, |residual, term| {
            cells.add(&residual.pixel, &residual.score(term));
            agreeing += usize::from(term.log_ratio > 0.0);
            loss += term.loss;
            for row in 0..rows {
                let j = column(&residual.jacobian[row], &residual.by_camera[row]);
                let weighted = j.map(|j| term.weight * j);
                for k in 0..ALL {
                    gradient[k] += weighted[k] * residual.error[row];
                    for l in 0..ALL {
                        hessian[k][l] += weighted[k] * j[l];
                    }
                }
            }
            let radius = column(&residual.radius_jacobian, &residual.radius_by_camera);
            for k in 0..ALL {
                gradient[k] -= radius[k] * term.right;
            }
        });
        let (gradient, hessian) = (VectorAll::from(gradient), MatrixAll::from(hessian));
        let mut system = CameraSystem { cells, agreeing, loss, gradient, hessian };
        let mut six = System::empty();
        self.priors.add_to(&at.pose, &mut six);
        system.loss += six.loss;
        let mut first = system.gradient.fixed_rows_mut::<6>(0);
        first += six.gradient;
        let mut block = system.hessian.fixed_view_mut::<6, 6>(0, 0);
        block += six.hessian;
        system
    }

    /// The scores of the matches at a pose and camera.
    fn cells(&self, at: &PoseWithCamera) -> ScoreCells {
        let mut cells = ScoreCells::new(&self.matches.camera);
        self.each(at, true, |residual, term| cells.add(&residual.pixel, &residual.score(term)));
        cells
    }

    /// Visits the matches that may be right.
    fn each(&self, at: &PoseWithCamera, gated: bool, mut visit: impl FnMut(&Residual, &LikelihoodTerm)) {
        let camera = BentCamera::changed(&self.matches.camera, &at.change);
        for &i in &self.active {
            let Some(residual) = self.matches.residual_of(&camera, i, &at.pose, gated) else { continue };
            visit(&residual, &self.matches.likelihood_term(i, &residual, self.noise));
        }
    }
}

/// Derivatives by the pose and by the camera.
fn column(pose: &[f64; 6], camera: &[f64; CAMERA]) -> [f64; ALL] {
    std::array::from_fn(|k| if k < 6 { pose[k] } else { camera[k - 6] })
}

impl CameraInfluence {
    /// The covariance of the pose for this one of the camera.
    fn of_pose(&self, camera: &MatrixC) -> Option<Symmetric6> {
        propagated(&self.pose_by_camera, camera)
    }
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
