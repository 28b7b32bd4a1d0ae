//! What a query's matches say against its camera, and how much of it is due to the cameras of the map.
//!
//! The cameras of a map are not exact either: a term of the distortion is missing, or one principal point stands for
//! many images. Its own images contradict their cameras then, and queries do so as well, although their cameras are
//! right. A self-test measures by how much ([`MapCameras::fit`]), and only what goes beyond it speaks against the
//! camera of a query ([`CameraEvidence::log_odds`]).

use veiloc_geometry::nalgebra::{SMatrix, SVector};

use crate::likelihood::camera::CAMERA;

type MatrixC = SMatrix<f64, CAMERA, CAMERA>;
type Vector6C = SVector<f64, CAMERA>;

/// How much the cameras of a map differ from the true ones.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapCameras {
    /// Standard deviations of the parameters of [`CameraChange`](crate::likelihood::CameraChange).
    pub sd: [f64; CAMERA],
    /// Log odds ([`CameraEvidence::log_odds`]) from which on a query's camera is wrong: no image of the map contradicts
    /// its own camera as much.
    pub min_log_odds: f64,
    /// Gain in log likelihood of another focal length from which on it speaks against that of a query: no image of the map
    /// gains as much with a focal length that is not its own.
    pub min_focal_gain: f64,
}

/// Of a map without a self-test: about as in most of the maps that were tested.
const UNMEASURED_SD: [f64; CAMERA] = [0.003, 0.003, 0.003, 0.005, 0.005, 0.01];

/// Log odds beyond doubt, for a map that was not tested.
const UNMEASURED_LOG_ODDS: f64 = 20.0;

/// Log odds of at least 20 to 1 are needed in every map.
const MIN_LOG_ODDS: f64 = 3.0;

/// Prior standard deviations of a camera that is not what the query says: a cropped image, distortion that was not
/// removed.
pub(crate) const OPEN_SD: [f64; CAMERA] = [0.3, 0.1, 0.01, 0.2, 0.2, 0.3];

/// Logarithm of the prior odds that a query's camera is not what it says: one of 150.
pub(crate) const LOG_PRIOR_ODDS: f64 = -5.0;

/// The default deviations count like this many images.
const PRIOR_IMAGES: f64 = 2.0;

/// Steps of expectation and maximization; variances change by less than a hundredth after that.
const FIT_STEPS: usize = 100;

impl Default for MapCameras {
    fn default() -> Self {
        Self::UNMEASURED
    }
}

impl MapCameras {
    /// Of a map without a self-test.
    pub const UNMEASURED: Self =
        Self { sd: UNMEASURED_SD, min_log_odds: UNMEASURED_LOG_ODDS, min_focal_gain: 0.0 };

    /// The deviations under which the evidence of these images of a map, each left out of it, is most probable, and the
    /// largest log odds and gains of another focal length among them. Without any evidence, [`Self::UNMEASURED`].
    pub fn fit(images: &[CameraEvidence]) -> Self {
        if images.is_empty() {
            return Self::UNMEASURED;
        }
        let prior = Vector6C::from(UNMEASURED_SD).map(|sd| sd * sd);
        let mut variance = prior;
        for _ in 0..FIT_STEPS {
            let (mut sum, mut count) = (prior * PRIOR_IMAGES, PRIOR_IMAGES);
            for image in images {
                let Some(posterior) = image.posterior(&variance.map(f64::sqrt).into()) else { continue };
                sum += posterior.mean.component_mul(&posterior.mean) + posterior.covariance.diagonal();
                count += 1.0;
            }
            variance = sum / count;
        }
        let sd = variance.map(f64::sqrt).into();
        let largest = images.iter().filter_map(|image| image.log_odds(&sd)).fold(MIN_LOG_ODDS, f64::max);
        let min_focal_gain = images.iter().map(|image| image.focal_gain).fold(0.0, f64::max);
        Self { sd, min_log_odds: largest, min_focal_gain }
    }
}

/// What the matches of an image say about its camera, with the pose free: relative to the given camera, at the pose
/// that fits it best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraEvidence {
    /// Information about the parameters of [`CameraChange`](crate::likelihood::CameraChange), if the errors of
    /// neighbouring keypoints were independent.
    pub information: [[f64; CAMERA]; CAMERA],
    /// Gradient of minus the log likelihood, likewise.
    pub gradient: [f64; CAMERA],
    /// Variance of errors that neighbouring keypoints share, in multiples of that of independent errors.
    pub shared_variance: f64,
    /// What the camera that explains the matches best gains in log likelihood, and the shared variance there; `None`
    /// when it was not estimated.
    pub best: Option<BestCamera>,
    /// What another focal length gains in log likelihood, with the rest of the camera as given, if it differs so much that
    /// the pose may be wrong; 0 otherwise.
    pub focal_gain: f64,
}

/// See [`CameraEvidence::best`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BestCamera {
    /// Gain of log likelihood over the given camera.
    pub gain: f64,
    /// As [`CameraEvidence::shared_variance`].
    pub shared_variance: f64,
}

/// The parameters of the camera under a prior.
pub(crate) struct CameraPosterior {
    pub(crate) mean: Vector6C,
    pub(crate) covariance: MatrixC,
    /// Logarithm of the evidence, relative to that of the given camera.
    pub(crate) log_evidence: f64,
}

impl CameraPosterior {
    /// About the given camera.
    pub(crate) fn second_moment(&self) -> MatrixC {
        self.covariance + self.mean * self.mean.transpose()
    }
}

impl CameraEvidence {
    /// What several images say about the camera that took them.
    pub fn of_all<'e>(images: impl IntoIterator<Item = &'e Self>) -> Self {
        let (mut information, mut gradient) = (MatrixC::zeros(), Vector6C::zeros());
        for image in images {
            let (of_image, slope) = image.scaled(image.shared_variance);
            information += of_image;
            gradient += slope;
        }
        let information = std::array::from_fn(|i| std::array::from_fn(|j| information[(i, j)]));
        Self { information, gradient: gradient.into(), shared_variance: 1.0, best: None, focal_gain: 0.0 }
    }

    /// The parameters under this prior; `None` when the numbers are not finite.
    pub(crate) fn posterior(&self, sd: &[f64; CAMERA]) -> Option<CameraPosterior> {
        let (information, gradient) = self.scaled(self.shared_variance);
        let factor = (information + prior_information(sd)).cholesky()?;
        let mean = -factor.solve(&gradient);
        let log_evidence = -0.5 * mean.dot(&gradient) - freedom(&information, sd)?;
        log_evidence.is_finite().then(|| CameraPosterior { mean, covariance: factor.inverse(), log_evidence })
    }

    /// Logarithm of the odds that the camera is not what the image says, against an error with these standard
    /// deviations: of evidences, each the gain of log likelihood less what six free parameters gain by their freedom,
    /// and of the prior odds. By one linear step, unless the best camera was estimated.
    pub fn log_odds(&self, sd: &[f64; CAMERA]) -> Option<f64> {
        let shared_variance = self.best.map_or(self.shared_variance, |best| best.shared_variance);
        let at = Self { shared_variance, ..*self };
        let open = match &self.best {
            Some(best) => best.gain / shared_variance - freedom(&at.scaled(shared_variance).0, &OPEN_SD)?,
            None => at.posterior(&OPEN_SD)?.log_evidence,
        };
        Some(open - at.posterior(sd)?.log_evidence + LOG_PRIOR_ODDS)
    }

    fn scaled(&self, shared_variance: f64) -> (MatrixC, Vector6C) {
        let information = MatrixC::from_fn(|i, j| self.information[i][j]);
        (information / shared_variance, Vector6C::from(self.gradient) / shared_variance)
    }
}

fn prior_information(sd: &[f64; CAMERA]) -> MatrixC {
    MatrixC::from_diagonal(&Vector6C::from(*sd).map(|sd| sd.powi(-2)))
}

/// Half the log determinant of `I + P⁻¹ S`: what free parameters gain by their freedom.
fn freedom(information: &MatrixC, sd: &[f64; CAMERA]) -> Option<f64> {
    let unit = MatrixC::from_diagonal(&Vector6C::from(*sd));
    let factor = (unit * information * unit + MatrixC::identity()).cholesky()?;
    Some(factor.l().diagonal().iter().map(|d| d.ln()).sum())
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Images whose cameras differ by these deviations from the given ones, measured with a tenth of them as noise.
    fn images(sd: &[f64; CAMERA], count: usize, seed: u64) -> Vec<CameraEvidence> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || {
            let (radius, angle): (f64, f64) = (rng.random_range(1e-12..1.0), rng.random_range(0.0..1.0));
            (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * angle).cos()
        };
        (0..count)
            .map(|_| {
                let mut evidence = CameraEvidence {
                    information: [[0.0; CAMERA]; CAMERA],
                    gradient: [0.0; CAMERA],
                    shared_variance: 2.0,
                    best: None,
                    focal_gain: 0.0,
                };
                for k in 0..CAMERA {
                    let noise = 0.1 * sd[k];
                    let measured = sd[k] * normal() + noise * normal();
                    evidence.information[k][k] = evidence.shared_variance / (noise * noise);
                    evidence.gradient[k] = -evidence.information[k][k] * measured;
                }
                evidence
            })
            .collect()
    }

    #[test]
    fn deviations_of_cameras_are_recovered() {
        let sd = [0.004, 0.01, 0.002, 0.02, 0.005, 0.05];
        let found = MapCameras::fit(&images(&sd, 200, 1));
        for k in 0..CAMERA {
            assert!((found.sd[k] / sd[k]).ln().abs() < 0.15, "{k}: {found:?}");
        }
        assert_eq!(MapCameras::fit(&[]), MapCameras::UNMEASURED);
    }

    #[test]
    fn only_what_exceeds_the_cameras_of_the_map_speaks_against_a_camera() {
        let sd = [0.004, 0.01, 0.002, 0.02, 0.005, 0.05];
        let cameras = MapCameras::fit(&images(&sd, 50, 2));
        let odds = |of: &[CameraEvidence]| -> Vec<f64> {
            of.iter().map(|image| image.log_odds(&cameras.sd).expect("finite")).collect()
        };
        assert!(odds(&images(&sd, 50, 3)).iter().all(|odds| *odds < cameras.min_log_odds));
        let mut wrong = images(&sd, 20, 4);
        for image in &mut wrong {
            image.gradient[3] = -image.information[3][3] * 0.15;
        }
        assert!(odds(&wrong).iter().all(|odds| *odds > cameras.min_log_odds), "{:?}", odds(&wrong));
    }

    /// One parameter: the evidence is that of a normal distribution.
    #[test]
    fn evidence_is_the_integral_over_the_prior() {
        let mut image = images(&[0.01; CAMERA], 1, 5).remove(0);
        let sd = [0.02, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9];
        image.shared_variance = 1.0;
        let (information, gradient) = (image.information[0][0], image.gradient[0]);
        let (mut integral, steps, reach) = (0.0, 40_000, 0.2);
        for k in 0..steps {
            let x = reach * (2.0 * (f64::from(k) + 0.5) / f64::from(steps) - 1.0);
            let prior = (-0.5 * (x / sd[0]).powi(2)).exp() / (sd[0] * std::f64::consts::TAU.sqrt());
            let likelihood = (-gradient * x - 0.5 * information * x * x).exp();
            integral += prior * likelihood * 2.0 * reach / f64::from(steps);
        }
        let found = image.posterior(&sd).expect("finite").log_evidence;
        assert!((found - integral.ln()).abs() < 1e-4, "{found} {}", integral.ln());
    }
}
