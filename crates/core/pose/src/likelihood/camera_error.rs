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
use veiloc_geometry::nalgebra::{Matrix6, SMatrix, SVector};

use crate::likelihood::camera::{CAMERA, CameraChange, PoseWithCamera};
use crate::likelihood::descent::Convergence;
use crate::likelihood::fisher::{Symmetric6, propagated};
use crate::likelihood::focal::FocalVerdict;
use crate::likelihood::map_cameras::{BestCamera, CameraEvidence, LOG_PRIOR_ODDS, MapCameras, OPEN_SD};
use crate::likelihood::objective::{Objective, Scores};
use crate::likelihood::problem::FocalPrior;
use crate::likelihood::system::{POSE, POSE_AND_CAMERA, System, camera_loss};

type MatrixC = SMatrix<f64, CAMERA, CAMERA>;
type Vector6C = SVector<f64, CAMERA>;
type CameraSystem = System<POSE_AND_CAMERA>;

/// Prior standard deviations of [`CameraChange`] between calibrations of one camera: half a per cent of the width for
/// the principal point; the others move a pixel at the border by about as much.
const CALIBRATED_SD: [f64; CAMERA] = [0.003, 0.003, 0.003, 0.005, 0.005, 0.01];

/// For the ± of a pose. Wider than calibrations differ: a principal point that is some per cent of the width off (a
/// cropped image, a nominal camera) is too frequent to be ruled out where the matches do not show it.
const ASSUMED_SD: [f64; CAMERA] = [0.003, 0.01, 0.003, 0.015, 0.015, 0.02];

/// For the ± of a pose whose camera was estimated: it takes part of the errors of the map's cameras over.
const ESTIMATED_SD: [f64; CAMERA] = [0.006, 0.006, 0.003, 0.015, 0.015, 0.015];

/// For a camera that is estimated without distortion.
const UNDISTORTED_SD: [f64; CAMERA] = [0.3, 0.1, 1e-4, 0.2, 0.2, 1e-4];

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
const MIN_UNDISTORTED_GAIN: f64 = 0.9;

/// Skew and radial term gain up to this by chance (98 % quantile of half a chi-squared with two degrees of freedom).
const CHANCE_GAIN: f64 = 3.9;

/// Fewer agreeing matches than this do not determine six parameters of a camera beside the pose.
const MIN_AGREEING: usize = 100;

/// The likelihood of an image with its camera as parameters.
pub struct CameraObjective<'a> {
    /// With the camera as given.
    pub objective: Objective<'a>,
    /// Errors of the map's own cameras.
    pub map: MapCameras,
    /// How well the given focal length is known.
    pub known: FocalPrior,
}

/// What a system says about the camera when the pose is eliminated; `None` when the matches do not determine the pose.
fn without_pose(system: &CameraSystem, shared_variance: f64) -> Option<CameraInfluence> {
    let (gradient_of_pose, pose) = system.of_pose();
    let mixed = system.hessian.fixed_view::<POSE, CAMERA>(0, POSE).into_owned();
    // Radians and map units differ in scale.
    let unit = pose.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 0.0 });
    if !(unit.min() > 0.0) {
        return None;
    }
    let unit = Matrix6::from_diagonal(&unit);
    let inverse = unit * (unit * pose * unit).cholesky()?.inverse() * unit;
    let information =
        system.hessian.fixed_view::<CAMERA, CAMERA>(POSE, POSE) - mixed.transpose() * inverse * mixed;
    let gradient =
        system.gradient.fixed_rows::<CAMERA>(POSE) - mixed.transpose() * inverse * gradient_of_pose;
    let evidence = CameraEvidence {
        information: std::array::from_fn(|i| std::array::from_fn(|j| information[(i, j)])),
        gradient: gradient.into(),
        shared_variance,
        best: None,
        focal_gain: 0.0,
    };
    Some(CameraInfluence { pose_by_camera: -inverse * mixed, evidence })
}

/// What the matches say about the camera, and how the pose follows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraInfluence {
    /// `J`: the step of the pose by each parameter of the camera.
    pub pose_by_camera: SMatrix<f64, 6, CAMERA>,
    /// What the matches say, with the pose free.
    pub evidence: CameraEvidence,
}

/// The matches linearized at a pose with its camera ([`CameraObjective::linearize`]).
pub struct CameraLinearization {
    at: PoseWithCamera,
    system: CameraSystem,
    scores: Scores,
    /// How the pose follows the camera, and what the matches say about it; `None` when they do not determine the pose.
    pub influence: Option<CameraInfluence>,
}

/// What an estimated focal length gains over the given one ([`CameraObjective::focal_test`]).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FocalTest {
    /// In log likelihood, over the design effect.
    pub gain: f64,
    /// Matches that agree with the given one.
    pub agreeing: usize,
    /// The best pose with any focal length.
    pub other: PoseWithCamera,
    /// The best pose with about the given one.
    pub pose_of_given: CameraFromWorld,
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
    pub fn linearize(&self, at: &PoseWithCamera) -> CameraLinearization {
        let (system, scores) = self.objective.linearize_with_scores(at);
        let influence = without_pose(&system, self.shared_variance(&system, &scores, at));
        CameraLinearization { at: *at, system, scores, influence }
    }

    /// The covariance that the camera model adds to a pose estimated with this camera, `C_camera`; 0 when the matches
    /// do not determine the pose.
    pub fn covariance(&self, here: &CameraLinearization) -> Symmetric6 {
        let covariance =
            |found: &CameraInfluence| found.of_pose(&self.assumed_spread(&found.evidence, &here.at.change)?);
        here.influence.as_ref().and_then(covariance).unwrap_or([[0.0; 6]; 6])
    }

    /// Second moment of the camera's errors that the ± of a pose with this camera assumes. That of an estimated focal
    /// length alone is left out: it is in the covariance of the pose already.
    pub fn assumed_spread(&self, evidence: &CameraEvidence, camera: &CameraChange) -> Option<MatrixC> {
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
        let mut system: CameraSystem = self.objective.linearize(at);
        system.gradient.fill(0.0);
        let shared_variance = self.objective.scores(at).cells.design_effect();
        let covariance = |found: CameraInfluence| {
            let open = found.evidence.posterior(&OPEN_SD)?;
            let of_map = Vector6C::from(self.beyond_map(&ESTIMATED_SD)).map(|sd| sd * sd);
            found.of_pose(&(open.covariance + MatrixC::from_diagonal(&of_map)))
        };
        without_pose(&system, shared_variance).and_then(covariance).unwrap_or([[0.0; 6]; 6])
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
    fn shared_variance(&self, here: &CameraSystem, scores: &Scores, at: &PoseWithCamera) -> f64 {
        let free = open_step(here, at).and_then(|step| at.moved(step.as_slice()));
        let of_given = scores.cells.design_effect();
        // A long step may lose matches.
        free.map_or(of_given, |free| self.objective.scores(&free).cells.design_effect().min(of_given))
    }

    /// Tests the given camera, seen at an optimum for it.
    ///
    /// One linearized step decides whether to estimate the camera. The estimation is necessary because matches that the
    /// wrong camera lost return only during it.
    pub fn test(&self, here: &CameraLinearization) -> CameraVerdict {
        let CameraLinearization { at, system, scores, influence } = here;
        let Some(CameraInfluence { evidence: linear, .. }) = influence else { return CameraVerdict::Fine };
        let Some(step) = open_step(system, at) else { return CameraVerdict::Fine };
        let min_wrong: [f64; CAMERA] =
            std::array::from_fn(|k| MIN_WRONG[k].max(MIN_WRONG_SDS * self.map.sd[k]));
        // Half of the thresholds: the linear step is shorter than the refined one while matches are lost.
        let is_near = (0..CAMERA).all(|k| step[POSE + k].abs() < 0.5 * min_wrong[k]);
        let calibrated = self.assumed_about(&at.change, &CALIBRATED_SD);
        let log_odds_of = |of: &CameraEvidence| {
            of.log_odds(&calibrated).map(|odds| odds - LOG_PRIOR_ODDS + self.log_prior_odds(&at.change))
        };
        if is_near || !(log_odds_of(linear) >= Some(MIN_LINEAR_LOG_ODDS)) {
            return CameraVerdict::Fine;
        }
        let open = self.best_camera(at, &OPEN_SD);
        let best = self.gain_of_open(system, at, &open);
        let log_odds = log_odds_of(&CameraEvidence { best: Some(best), ..*linear });
        // A camera that is not calibrated need not be contradicted beyond doubt.
        let (min_gain, min_estimated) = if self.is_focal_estimated(&at.change) {
            (0.0, 0.0)
        } else {
            let observations = self.objective.matches.observations;
            (FocalVerdict::min_gain(observations, scores.agreeing), MIN_ESTIMATED_LOG_ODDS)
        };
        if best.gain / best.shared_variance < min_gain || !(log_odds > Some(self.map.min_log_odds)) {
            return CameraVerdict::Fine;
        }
        let undistorted = PoseWithCamera { change: open.change.without_distortion(), ..open };
        let other = self.best_camera(&undistorted, &UNDISTORTED_SD);
        let is_large = (0..CAMERA).any(|k| (other.change.0[k] - at.change.0[k]).abs() > min_wrong[k]);
        // Where distortion explains much of it, other parameters would only stand for the distortion.
        let left = best.gain - self.gain(system, at, &other, &UNDISTORTED_SD);
        let is_undistorted =
            left < (1.0 - MIN_UNDISTORTED_GAIN) * best.gain || left < CHANCE_GAIN * best.shared_variance;
        let is_explained = is_large && is_undistorted && log_odds >= Some(min_estimated);
        if is_explained && scores.agreeing >= MIN_AGREEING {
            CameraVerdict::Other(other)
        } else {
            CameraVerdict::Contradicted
        }
    }

    /// Tests a focal length that was estimated instead of the given one: distortion that the map's own cameras lack, too,
    /// resembles another focal length where the matches are few. Compares the best camera with any focal length with
    /// the best one with the given focal length, when the other parameters differ as those of the map's cameras, or,
    /// where they are nearly exact, as those of other calibrations.
    pub fn focal_test(&self, at: &PoseWithCamera, is_map_exact: bool) -> FocalTest {
        let given = if is_map_exact { CALIBRATED_SD } else { self.beyond_map(&CALIBRATED_SD) };
        let mut open = given;
        open[0] = OPEN_SD[0];
        let [at_given, at_open] = [&given, &open].map(|sd| self.best_camera(at, sd));
        let scores = self.objective.scores(&at_open);
        let loss = |at: &PoseWithCamera, sd| self.penalized(at, sd).loss;
        FocalTest {
            gain: (loss(&at_given, &given) - loss(&at_open, &open)) / scores.cells.design_effect(),
            agreeing: self.objective.scores(&at_given).agreeing,
            other: PoseWithCamera { change: CameraChange::of_focal(at_open.change.factor()), ..at_open },
            pose_of_given: at_given.pose,
        }
    }

    /// What the matches say about the given camera, with the best camera estimated; seen at an optimum for the given one.
    /// `None` when they do not determine the pose.
    pub fn evidence(&self, here: &CameraLinearization) -> Option<CameraEvidence> {
        let linear = here.influence.as_ref()?.evidence;
        let open = self.best_camera(&here.at, &OPEN_SD);
        Some(CameraEvidence { best: Some(self.gain_of_open(&here.system, &here.at, &open)), ..linear })
    }

    fn gain_of_open(&self, here: &CameraSystem, at: &PoseWithCamera, open: &PoseWithCamera) -> BestCamera {
        BestCamera {
            gain: self.gain(here, at, open, &OPEN_SD),
            shared_variance: self.objective.scores(open).cells.design_effect(),
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
        here.loss + camera_loss(&at.change, sd) - self.penalized(other, sd).loss
    }

    /// The best camera under a prior, from a start.
    fn best_camera(&self, start: &PoseWithCamera, sd: &[f64; CAMERA]) -> PoseWithCamera {
        let convergence = Convergence { steps: 20, min_gain: 1e-5 };
        self.objective.descend::<POSE_AND_CAMERA>(start, sd, false, convergence)
    }

    fn penalized(&self, at: &PoseWithCamera, sd: &[f64; CAMERA]) -> CameraSystem {
        self.objective.linearize(at).with_camera_prior(&at.change, sd)
    }
}

/// The linearized step to the best pose with any camera.
fn open_step(here: &CameraSystem, at: &PoseWithCamera) -> Option<SVector<f64, POSE_AND_CAMERA>> {
    here.clone().with_camera_prior(&at.change, &OPEN_SD).damped_step(0.0)
}

impl CameraInfluence {
    /// The covariance of the pose for this one of the camera.
    fn of_pose(&self, camera: &MatrixC) -> Option<Symmetric6> {
        propagated(&self.pose_by_camera, camera)
    }
}
