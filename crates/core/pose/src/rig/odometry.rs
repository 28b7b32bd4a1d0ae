//! The odometry of a frame: its measured pose on the rig, and the uncertainty of it.

use veiloc_geometry::frames::{Camera, Rig};
use veiloc_geometry::nalgebra::{Matrix6, SMatrix, Vector3, Vector6};
use veiloc_geometry::{CameraFromRig, CameraFromWorld, RigFromWorld, Rigid3};

use crate::likelihood::{Symmetric6, infinite, propagated};

/// Smaller standard deviations, in radians and relative to the scene's size, are replaced by this where the other one
/// is not 0: below it the normal equations lose the information of the matches.
const MIN_DEVIATION: f64 = 1e-6;

/// Standardised norm of a deviation up to which its loss is quadratic; for six normal variables it is below this in
/// 98.6 % of cases. Beyond, the loss is linear: a gross odometry error does not displace the rig.
const QUADRATIC_LIMIT: f64 = 4.0;

/// The constraint between a frame and its rig.
///
/// A deviation is the step of [`CameraFromWorld::perturbed`] from the camera pose given by the odometry to the actual
/// one: `ω` about the camera's axes, `v` along them.
#[derive(Debug, Clone)]
pub(super) struct OdometryConstraint {
    cam_from_rig: CameraFromRig,
    rig_from_cam: Rigid3<Rig, Camera>,
    /// Maps a step of the rig to the resulting step of the camera.
    adjoint: Matrix6<f64>,
    /// Inverse variance of each component of a deviation; `None` when the frame is fixed to the rig.
    precision: Option<Vector6<f64>>,
}

/// A deviation under its constraint.
#[derive(Debug, Clone, Copy)]
pub(super) struct Deviation {
    /// The deviation.
    pub(super) step: Vector6<f64>,
    /// Precision of each component, after robust weighting.
    pub(super) precision: Vector6<f64>,
    /// Its loss: half the squared standardised norm for ordinary deviations.
    pub(super) loss: f64,
}

impl OdometryConstraint {
    /// Standard deviations in radians and map units; `scene` is the size of the scene, map units.
    pub(super) fn new(
        cam_from_rig: CameraFromRig,
        rotation_sd: f64,
        translation_sd: f64,
        scene: f64,
    ) -> Self {
        let turn = *cam_from_rig.rotation().matrix();
        let shift = cam_from_rig.translation().cross_matrix() * turn;
        let mut adjoint = Matrix6::zeros();
        adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&turn);
        adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&turn);
        adjoint.fixed_view_mut::<3, 3>(3, 0).copy_from(&shift);
        let least = [MIN_DEVIATION, MIN_DEVIATION * scene.max(f64::MIN_POSITIVE)];
        let precision = (rotation_sd > least[0] || translation_sd > least[1]).then(|| {
            let [r, t] =
                [rotation_sd.max(least[0]), translation_sd.max(least[1])].map(|sd| (sd * sd).recip());
            Vector6::new(r, r, r, t, t, t)
        });
        Self { cam_from_rig, rig_from_cam: cam_from_rig.inverse(), adjoint, precision }
    }

    /// The same constraint without deviation.
    pub(super) fn rigid(&self) -> Self {
        Self { precision: None, ..self.clone() }
    }

    /// Covariance of the rig's pose from that of the camera, of a frame that cannot deviate.
    pub(super) fn covariance_of_rig(&self, of_camera: &Symmetric6) -> Symmetric6 {
        let of_camera = Matrix6::from_fn(|i, j| of_camera[i][j]);
        let adjoint = self.adjoint.try_inverse().and_then(|inverse| propagated(&inverse, &of_camera));
        adjoint.unwrap_or_else(infinite)
    }

    /// The inverse; infinite when a direction is free.
    pub(super) fn covariance_of_camera(&self, of_rig: &Symmetric6) -> Symmetric6 {
        let of_rig = Matrix6::from_fn(|i, j| of_rig[i][j]);
        propagated(&self.adjoint, &of_rig).unwrap_or_else(infinite)
    }

    /// A direction of translation of the camera, by the axes of the rig.
    pub(super) fn direction_of_rig(&self, of_camera: &Vector3<f64>) -> Vector3<f64> {
        self.cam_from_rig.rotation().inverse() * of_camera
    }

    /// Whether the frame cannot deviate.
    pub(super) const fn is_rigid(&self) -> bool {
        self.precision.is_none()
    }

    /// The camera pose given by the odometry.
    pub(super) fn camera(&self, rig: &RigFromWorld) -> CameraFromWorld {
        self.cam_from_rig.compose(rig)
    }

    /// The rig pose given by the odometry.
    pub(super) fn rig(&self, cam: &CameraFromWorld) -> RigFromWorld {
        self.rig_from_cam.compose(cam)
    }

    /// Deviation of a camera from its pose on the rig; zero for a fixed frame.
    pub(super) fn deviation(&self, rig: &RigFromWorld, cam: &CameraFromWorld) -> Deviation {
        let Some(precision) = self.precision else {
            return Deviation { step: Vector6::zeros(), precision: Vector6::zeros(), loss: 0.0 };
        };
        let step = Vector6::from(self.camera(rig).step_to(cam));
        let length = step.component_mul(&step).dot(&precision).sqrt();
        let ordinary = length <= QUADRATIC_LIMIT;
        let loss =
            if ordinary { 0.5 * length * length } else { QUADRATIC_LIMIT * (length - 0.5 * QUADRATIC_LIMIT) };
        let weight = if ordinary { 1.0 } else { QUADRATIC_LIMIT / length };
        Deviation { step, precision: precision * weight, loss }
    }

    /// Transforms a camera's information (or any quadratic form over its steps) to steps of the rig.
    pub(super) fn over_rig(&self, of_camera: &Matrix6<f64>) -> Matrix6<f64> {
        self.adjoint.transpose() * of_camera * self.adjoint
    }

    /// The same for a gradient.
    pub(super) fn gradient_over_rig(&self, of_camera: &Vector6<f64>) -> Vector6<f64> {
        self.adjoint.transpose() * of_camera
    }

    /// The step of the camera that results from a step of the rig.
    pub(super) fn carried(&self, of_rig: &Vector6<f64>) -> Vector6<f64> {
        self.adjoint * of_rig
    }

    /// `W A` for a matrix `W` over steps of the camera.
    pub(super) fn carried_by(&self, of_camera: &Matrix6<f64>) -> Matrix6<f64> {
        of_camera * self.adjoint
    }

    /// Maps steps of the rig and of the parameters of the camera to those of the camera's pose and these parameters.
    pub(super) fn with_camera<const N: usize>(&self) -> SMatrix<f64, N, N> {
        let mut all = SMatrix::<f64, N, N>::identity();
        all.fixed_view_mut::<6, 6>(0, 0).copy_from(&self.adjoint);
        all
    }

    /// A camera's information about the rig, with the camera's own deviation marginalised out.
    pub(super) fn information_over_rig(
        &self,
        of_camera: &Matrix6<f64>,
        deviation: &Deviation,
    ) -> Matrix6<f64> {
        self.over_rig(&self.information_left(of_camera, deviation))
    }

    /// The force on the rig when the camera's best pose moves by each column of `steps`, with the camera's own deviation
    /// marginalised out.
    pub(super) fn force_over_rig(
        &self,
        of_camera: &Matrix6<f64>,
        deviation: &Deviation,
        steps: &Matrix6<f64>,
    ) -> Matrix6<f64> {
        self.adjoint.transpose() * self.information_left(of_camera, deviation) * steps
    }

    /// A camera's information with its own deviation marginalised out: `(I⁻¹ + W⁻¹)⁻¹`, where `I` may be singular.
    fn information_left(&self, of_camera: &Matrix6<f64>, deviation: &Deviation) -> Matrix6<f64> {
        if self.is_rigid() {
            return *of_camera;
        }
        let constraint = Matrix6::from_diagonal(&deviation.precision);
        (of_camera + constraint)
            .cholesky()
            .map_or_else(Matrix6::zeros, |sum| constraint - constraint * sum.solve(&constraint))
    }

    /// Logarithm of the share of the previously possible deviations that remains with the matches: the cost in evidence
    /// of the freedom to deviate.
    pub(super) fn log_share_left(&self, of_camera: &Matrix6<f64>, deviation: &Deviation) -> f64 {
        if self.is_rigid() {
            return 0.0;
        }
        let scale = deviation.precision.map(|p| p.sqrt().recip());
        let scaled = Matrix6::from_diagonal(&scale) * of_camera * Matrix6::from_diagonal(&scale);
        let log_det = (scaled + Matrix6::identity())
            .cholesky()
            .map_or(f64::INFINITY, |factor| 2.0 * factor.l().diagonal().iter().map(|d| d.ln()).sum::<f64>());
        -0.5 * log_det
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::nalgebra::Rotation3;

    fn constraint(rotation_sd: f64, translation_sd: f64) -> OdometryConstraint {
        let turn = Rotation3::from_euler_angles(0.3, -0.8, 1.2);
        OdometryConstraint::new(
            Rigid3::new(turn, Vector3::new(0.4, -1.0, 0.7)),
            rotation_sd,
            translation_sd,
            3.0,
        )
    }

    fn rig() -> RigFromWorld {
        Rigid3::new(Rotation3::from_euler_angles(-0.4, 0.5, 2.0), Vector3::new(1.0, 2.0, -3.0))
    }

    #[test]
    fn rig_steps_transfer_to_the_camera() {
        let constraint = constraint(0.01, 0.01);
        let camera = constraint.camera(&rig());
        assert!(constraint.rig(&camera).translation_error(&rig()) < 1e-12);
        for k in 0..6 {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let moved = Vector6::from(camera.step_to(&constraint.camera(&rig().perturbed(&step.into()))));
            assert!((moved - constraint.carried(&step)).norm() < 1e-10, "{k}");
        }
    }

    #[test]
    fn deviation_loss_is_quadratic_then_linear() {
        let constraint = constraint(0.01, 0.1);
        let camera = constraint.camera(&rig()).perturbed(&[0.02, 0.0, 0.0, 0.0, 0.1, 0.0]);
        assert!((constraint.deviation(&rig(), &camera).loss - 2.5).abs() < 1e-9);
        let slipped = constraint.camera(&rig()).perturbed(&[0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
        let deviation = constraint.deviation(&rig(), &slipped);
        assert!(
            (deviation.loss - (4.0 * 50.0 - 8.0)).abs() < 1e-9 && deviation.precision[3] < 10.0,
            "{deviation:?}"
        );
    }

    #[test]
    fn odometry_adds_variance_to_information() {
        let of_camera = Matrix6::identity() * 100.0;
        let weaker = |rotation_sd, translation_sd| {
            let constraint = constraint(rotation_sd, translation_sd);
            let deviation = constraint.deviation(&rig(), &constraint.camera(&rig()));
            (constraint.information_over_rig(&of_camera, &deviation), constraint.over_rig(&of_camera))
        };
        let (fixed, all) = weaker(0.0, 0.0);
        assert_eq!(fixed, all);
        // Variances add: a hundredth of the matches and one of the odometry.
        let (left, all) = weaker(0.1, 0.1);
        assert!((left * 2.0 - all).norm() < 1e-9 * all.norm());
        let singular = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 1.0, 1.0, 0.0));
        let constraint = constraint(0.1, 0.1);
        let deviation = constraint.deviation(&rig(), &constraint.camera(&rig()));
        let left = constraint.information_over_rig(&singular, &deviation);
        assert!(left.iter().all(|x| x.is_finite()) && left.symmetric_eigenvalues().min().abs() < 1e-9);
    }
}
