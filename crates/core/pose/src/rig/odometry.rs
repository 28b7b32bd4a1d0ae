//! How a frame hangs on its rig: the relative pose that the device measured, and how far off that may be.

use veiloc_geometry::frames::{Camera, Rig};
use veiloc_geometry::nalgebra::{Matrix6, Vector6};
use veiloc_geometry::{CameraFromRig, CameraFromWorld, RigFromWorld, Rigid3};

/// Standard deviations below this, in radians and in shares of the scene's size, are taken for it where the other one is
/// not 0: beyond it the normal equations lose what the matches say.
const LEAST_DEVIATION: f64 = 1e-6;

/// Standardised length of a deviation up to which it costs what a normal distribution says; six numbers of one stay below
/// in 98.6 % of cases. Beyond, each further unit costs the same: a slip of the odometry does not drag the rig along.
const ORDINARY: f64 = 4.0;

/// The tie between a frame and its rig.
///
/// A deviation is the step of [`CameraFromWorld::perturbed`] from where the odometry puts the camera to where it is:
/// `ω` about the camera's axes, `v` along them.
#[derive(Debug, Clone)]
pub(super) struct Tie {
    cam_from_rig: CameraFromRig,
    rig_from_cam: Rigid3<Rig, Camera>,
    /// Takes a step of the rig to the step of the camera that it causes.
    adjoint: Matrix6<f64>,
    /// One over the variance of each number of a deviation; `None` when there is none: the frame is fixed to the rig.
    precision: Option<Vector6<f64>>,
}

/// A deviation under its tie.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pull {
    /// The deviation.
    pub(super) step: Vector6<f64>,
    /// Precision of each number once its length is heeded.
    pub(super) precision: Vector6<f64>,
    /// What it costs: half the squared standardised length, for ordinary ones.
    pub(super) loss: f64,
}

impl Tie {
    /// Standard deviations in radians and map units; `scene` is the size of what is seen, map units.
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
        let least = [LEAST_DEVIATION, LEAST_DEVIATION * scene.max(f64::MIN_POSITIVE)];
        let precision = (rotation_sd > least[0] || translation_sd > least[1]).then(|| {
            let [r, t] =
                [rotation_sd.max(least[0]), translation_sd.max(least[1])].map(|sd| (sd * sd).recip());
            Vector6::new(r, r, r, t, t, t)
        });
        Self { cam_from_rig, rig_from_cam: cam_from_rig.inverse(), adjoint, precision }
    }

    /// Whether the frame cannot deviate.
    pub(super) const fn is_rigid(&self) -> bool {
        self.precision.is_none()
    }

    /// Where the odometry puts the camera.
    pub(super) fn camera(&self, rig: &RigFromWorld) -> CameraFromWorld {
        self.cam_from_rig.compose(rig)
    }

    /// Where it puts the rig.
    pub(super) fn rig(&self, cam: &CameraFromWorld) -> RigFromWorld {
        self.rig_from_cam.compose(cam)
    }

    /// How a camera deviates from its place on the rig; nothing for a fixed frame.
    pub(super) fn pull(&self, rig: &RigFromWorld, cam: &CameraFromWorld) -> Pull {
        let Some(precision) = self.precision else {
            return Pull { step: Vector6::zeros(), precision: Vector6::zeros(), loss: 0.0 };
        };
        let step = Vector6::from(self.camera(rig).step_to(cam));
        let length = step.component_mul(&step).dot(&precision).sqrt();
        let ordinary = length <= ORDINARY;
        let loss = if ordinary { 0.5 * length * length } else { ORDINARY * (length - 0.5 * ORDINARY) };
        let weight = if ordinary { 1.0 } else { ORDINARY / length };
        Pull { step, precision: precision * weight, loss }
    }

    /// What a camera's information (or any quadratic form over its steps) is over steps of the rig.
    pub(super) fn over_rig(&self, of_camera: &Matrix6<f64>) -> Matrix6<f64> {
        self.adjoint.transpose() * of_camera * self.adjoint
    }

    /// The same for a gradient.
    pub(super) fn gradient_over_rig(&self, of_camera: &Vector6<f64>) -> Vector6<f64> {
        self.adjoint.transpose() * of_camera
    }

    /// The step of the camera that a step of the rig causes.
    pub(super) fn carried(&self, of_rig: &Vector6<f64>) -> Vector6<f64> {
        self.adjoint * of_rig
    }

    /// What a camera's information says of the rig, the camera's own deviation marginalised out.
    pub(super) fn information_over_rig(&self, of_camera: &Matrix6<f64>, pull: &Pull) -> Matrix6<f64> {
        if self.is_rigid() {
            return self.over_rig(of_camera);
        }
        let tie = Matrix6::from_diagonal(&pull.precision);
        // (I⁻¹ + W⁻¹)⁻¹ where I may be singular.
        let left = (of_camera + tie).cholesky().map(|sum| tie - tie * sum.solve(&tie));
        left.map_or_else(Matrix6::zeros, |m| self.over_rig(&m))
    }

    /// Logarithm of the share of the deviations that were possible before that is left once the matches are known: what
    /// the freedom to deviate costs in evidence.
    pub(super) fn log_share_left(&self, of_camera: &Matrix6<f64>, pull: &Pull) -> f64 {
        if self.is_rigid() {
            return 0.0;
        }
        let scale = pull.precision.map(|p| p.sqrt().recip());
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
    use veiloc_geometry::nalgebra::{Rotation3, Vector3};

    fn tie(rotation_sd: f64, translation_sd: f64) -> Tie {
        let turn = Rotation3::from_euler_angles(0.3, -0.8, 1.2);
        Tie::new(Rigid3::new(turn, Vector3::new(0.4, -1.0, 0.7)), rotation_sd, translation_sd, 3.0)
    }

    fn rig() -> RigFromWorld {
        Rigid3::new(Rotation3::from_euler_angles(-0.4, 0.5, 2.0), Vector3::new(1.0, 2.0, -3.0))
    }

    #[test]
    fn a_step_of_the_rig_is_carried_to_its_camera() {
        let tie = tie(0.01, 0.01);
        let camera = tie.camera(&rig());
        assert!(tie.rig(&camera).translation_error(&rig()) < 1e-12);
        for k in 0..6 {
            let mut step = Vector6::zeros();
            step[k] = 1e-6;
            let moved = Vector6::from(camera.step_to(&tie.camera(&rig().perturbed(&step.into()))));
            assert!((moved - tie.carried(&step)).norm() < 1e-10, "{k}");
        }
    }

    #[test]
    fn deviations_cost_what_they_should() {
        let tie = tie(0.01, 0.1);
        let camera = tie.camera(&rig()).perturbed(&[0.02, 0.0, 0.0, 0.0, 0.1, 0.0]);
        assert!((tie.pull(&rig(), &camera).loss - 2.5).abs() < 1e-9);
        let slipped = tie.camera(&rig()).perturbed(&[0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
        let pull = tie.pull(&rig(), &slipped);
        assert!((pull.loss - (4.0 * 50.0 - 8.0)).abs() < 1e-9 && pull.precision[3] < 10.0, "{pull:?}");
    }

    #[test]
    fn information_passes_a_tie_as_a_series_of_two_springs() {
        let of_camera = Matrix6::identity() * 100.0;
        let weaker = |rotation_sd, translation_sd| {
            let tie = tie(rotation_sd, translation_sd);
            let pull = tie.pull(&rig(), &tie.camera(&rig()));
            (tie.information_over_rig(&of_camera, &pull), tie.over_rig(&of_camera))
        };
        let (fixed, all) = weaker(0.0, 0.0);
        assert_eq!(fixed, all);
        // Variances add: a hundredth of the matches and one of the odometry.
        let (left, all) = weaker(0.1, 0.1);
        assert!((left * 2.0 - all).norm() < 1e-9 * all.norm());
        let singular = Matrix6::from_diagonal(&Vector6::new(1.0, 1.0, 1.0, 1.0, 1.0, 0.0));
        let tie = tie(0.1, 0.1);
        let pull = tie.pull(&rig(), &tie.camera(&rig()));
        let left = tie.information_over_rig(&singular, &pull);
        assert!(left.iter().all(|x| x.is_finite()) && left.symmetric_eigenvalues().min().abs() < 1e-9);
    }
}
