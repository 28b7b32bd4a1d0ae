//! The measured gravity direction as evidence for a pose: compared with the direction that the matches alone give.
//!
//! With `r` the rotation from the predicted to the measured direction, `J` its derivative by the pose, `C` the covariance
//! of the pose by the matches alone and `σ` the standard deviation of the measurement, `S = J C Jᵀ + σ² I` is the
//! covariance of `r`. Any direction is equally likely where the pose is wrong, so a measurement that agrees has the log
//! evidence
//!
//! ```text
//! log N(r; 0, S) − log(1 / 4π) = log(2 / √det S) − ½ rᵀ S⁻¹ r
//! ```
//!
//! in the plane across the direction: about 8 for 1°.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

use crate::likelihood::fisher::Symmetric6;
use crate::likelihood::pose_priors::gravity_weight;
use crate::likelihood::problem::Gravity;

/// Largest deviation of a measurement that counts, in standard deviations; one in 90 right ones is beyond.
const MAX_AGREEING: f64 = 3.0;

/// Largest standard deviation of the difference at which agreement counts, degrees: the gravity direction of a device that
/// accelerates may be wrong by 5°, and the matches must be able to notice this.
const MAX_SD_DEG: f64 = 1.5;

/// A measured gravity direction against a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GravityTest {
    /// `r`, in two directions across the predicted one, radians.
    residual: Vector2<f64>,
    /// `J`, by the rotation in the chart of [`CameraFromWorld::perturbed`].
    by_rotation: Matrix2x3<f64>,
    /// `σ`, radians.
    sd: f64,
}

/// How a measured gravity direction agrees with a pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GravityAgreement {
    /// Difference of the two directions in standard deviations of both.
    pub deviation: f64,
    /// Log evidence of the measurement for the pose; 0 where it does not count: it deviates, or the matches hold the
    /// direction too weakly.
    pub log_evidence: f64,
}

impl GravityAgreement {
    /// Whether the measurement may improve the pose.
    pub fn is_close(&self) -> bool {
        self.deviation <= MAX_AGREEING
    }
}

impl GravityTest {
    /// At a pose of the matches alone; directions of any length but zero.
    pub fn new(gravity: &Gravity, pose: &CameraFromWorld) -> Self {
        let predicted = (pose.rotation() * gravity.in_world).normalize();
        let measured = gravity.in_camera.normalize();
        let cross = predicted.cross(&measured);
        let angle = cross.norm().atan2(predicted.dot(&measured));
        // Opposite directions have no axis: any serves.
        let aside = if predicted.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
        let across = predicted.cross(&aside).normalize();
        let rotation = cross.try_normalize(1e-12).unwrap_or(across) * angle;
        let plane = Matrix2x3::from_rows(&[across.transpose(), predicted.cross(&across).transpose()]);
        // A step of the pose rotates the prediction with it.
        Self { residual: plane * rotation, by_rotation: -plane, sd: gravity.sd_deg.to_radians() }
    }

    /// The same at the pose that the matches alone would have, to first order: this one was estimated with the
    /// measurement ([`PosePriors`](crate::likelihood::PosePriors)), and `independent` is its covariance by the matches
    /// alone, as the estimate weighed them.
    #[must_use]
    pub fn without_influence(self, independent: &Symmetric6) -> Self {
        let weight = gravity_weight(self.residual.norm_squared() / (self.sd * self.sd));
        let by_matches = self.of_prediction(independent) * (weight / (self.sd * self.sd));
        Self { residual: (Matrix2::identity() + by_matches) * self.residual, ..self }
    }

    /// The agreement for this covariance of the pose by the matches alone.
    pub fn judge(&self, by_matches: &Symmetric6) -> GravityAgreement {
        let of_both = self.of_prediction(by_matches) + Matrix2::identity() * (self.sd * self.sd);
        let largest_sd = of_both.symmetric_eigenvalues().max().max(0.0).sqrt();
        let squared =
            of_both.cholesky().map_or(f64::INFINITY, |s| self.residual.dot(&s.solve(&self.residual)));
        let counts = squared <= MAX_AGREEING * MAX_AGREEING && largest_sd <= MAX_SD_DEG.to_radians();
        let log_evidence =
            if counts { (2.0 / of_both.determinant().sqrt()).ln() - 0.5 * squared } else { 0.0 };
        GravityAgreement { deviation: squared.sqrt(), log_evidence }
    }

    /// Covariance of the predicted direction.
    fn of_prediction(&self, covariance: &Symmetric6) -> Matrix2<f64> {
        let rotation = Matrix3::from_fn(|i, j| covariance[i][j]);
        self.by_rotation * rotation * self.by_rotation.transpose()
    }
}

#[cfg(test)]
mod tests {
    use veiloc_geometry::Rigid3;
    use veiloc_geometry::nalgebra::{Matrix6, Rotation3, Unit, Vector6};

    use super::*;
    use crate::likelihood::pose_priors::PosePriors;
    use crate::likelihood::system::System;

    fn pose() -> CameraFromWorld {
        Rigid3::new(Rotation3::from_euler_angles(0.3, -0.5, 1.1), Vector3::new(0.4, 2.0, 1.0))
    }

    /// Gravity as measured at [`pose`], rotated by some degrees about an axis across it.
    fn measured(degrees: f64, sd_deg: f64) -> Gravity {
        let in_world = Vector3::new(0.1, 0.2, -3.0);
        let felt = pose().rotation() * in_world;
        let axis = Unit::new_normalize(felt.cross(&Vector3::new(0.3, 0.5, -0.8)));
        Gravity {
            in_camera: Rotation3::from_axis_angle(&axis, degrees.to_radians()) * felt,
            in_world,
            sd_deg,
        }
    }

    fn covariance(sd_deg: f64) -> Symmetric6 {
        let variance = sd_deg.to_radians().powi(2);
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { variance } else { 0.0 }))
    }

    #[test]
    fn deviation_is_in_standard_deviations_of_both_directions() {
        for degrees in [0.0, 1.0, 5.0, 90.0, 180.0] {
            let found = GravityTest::new(&measured(degrees, 0.3), &pose()).judge(&covariance(0.4));
            assert!((found.deviation - degrees / 0.5).abs() < 1e-6 * (1.0 + degrees), "{degrees}: {found:?}");
            assert_eq!(found.is_close(), degrees <= 1.0);
        }
    }

    /// The evidence is the density of the direction over that of a uniform one, `1 / 4π`.
    #[test]
    fn evidence_is_a_ratio_of_densities() {
        let sd: f64 = 0.5_f64.to_radians();
        for degrees in [0.0, 1.0, 1.4] {
            let found = GravityTest::new(&measured(degrees, 0.3), &pose()).judge(&covariance(0.4));
            let density = (-0.5 * (degrees / 0.5_f64).powi(2)).exp() / (std::f64::consts::TAU * sd * sd);
            let expected = (density * 4.0 * std::f64::consts::PI).ln();
            assert!((found.log_evidence - expected).abs() < 1e-9, "{degrees}: {found:?} {expected}");
        }
        let far = GravityTest::new(&measured(2.0, 0.3), &pose()).judge(&covariance(0.4));
        let weakly_held = GravityTest::new(&measured(0.0, 0.3), &pose()).judge(&covariance(2.0));
        let free = GravityTest::new(&measured(0.0, 0.3), &pose()).judge(&covariance(f64::INFINITY));
        assert_eq!([far, weakly_held, free].map(|found| found.log_evidence), [0.0; 3]);
    }

    /// A pose between the matches' own and the measured direction gives the same test as the matches' own.
    #[test]
    fn influence_of_the_measurement_is_removed() {
        let (gravity, by_matches) = (measured(2.0, 1.0), covariance(0.7));
        let own = GravityTest::new(&gravity, &pose());
        let priors = PosePriors::of_gravity(&gravity);
        let information = Matrix6::from_fn(|i, j| by_matches[i][j]).try_inverse().expect("positive");
        // The optimum of the matches' quadratic and the measurement, by steps of Gauss and Newton.
        let mut both = pose();
        for _ in 0..40 {
            let mut system = System::empty();
            priors.add_to(&both, &mut system);
            let from = Vector6::from(pose().step_to(&both));
            let gradient = system.gradient + information * from;
            let step = -(system.hessian + information).try_inverse().expect("positive") * gradient;
            both = both.perturbed(&step.into());
        }
        let pulled = GravityTest::new(&gravity, &both);
        let restored = pulled.without_influence(&by_matches);
        let [own, pulled, restored] = [own, pulled, restored].map(|test| test.judge(&by_matches).deviation);
        assert!(pulled < 0.8 * own, "{pulled} {own}");
        assert!((restored / own - 1.0).abs() < 0.15, "{restored} {own}");
    }
}
