//! Levenberg–Marquardt on the poses of a rig and of its frames together, and on parameters of a camera that several
//! frames share.
//!
//! Frames are connected only to the rig and to their camera, so the normal equations have arrowhead structure: each
//! frame's six unknowns are eliminated on their own, and the shared ones `ε` remain, the rig's six and those of the
//! camera.
//!
//! ```text
//! | B_1          M_1 | | δ_1 |   | -g_1 - W_1 r_1          |   B_i = H_i + W_i,  M_i = [-W_i A_i | h_i]
//! |      B_2     M_2 | | δ_2 | = | -g_2 - W_2 r_2          |   H_i, g_i of frame i's matches, h_i by the camera
//! | M_1ᵀ M_2ᵀ    S   | |  ε  |   |  Σ A_iᵀ W_i r_i | -Σ g_φ |   r_i, W_i, A_i of its odometry
//! ```

use veiloc_geometry::nalgebra::{Matrix6, Rotation3, SMatrix, SVector, Vector6};
use veiloc_geometry::{CameraFromWorld, RigFromWorld};

use super::odometry::{Deviation, OdometryConstraint};
use crate::likelihood::{Convergence, POSE, System, damped, levenberg_marquardt};

/// The poses of a rig and its frames.
#[derive(Debug, Clone)]
pub(super) struct Poses {
    pub(super) rig: RigFromWorld,
    /// `[F]`
    pub(super) cams: Vec<CameraFromWorld>,
}

impl Poses {
    /// All frames at the poses given by the odometry.
    pub(super) fn rigid(constraints: &[OdometryConstraint], rig: RigFromWorld) -> Self {
        Self { cams: constraints.iter().map(|constraint| constraint.camera(&rig)).collect(), rig }
    }

    /// Loss of all frames' deviations from the odometry.
    pub(super) fn odometry_loss(&self, constraints: &[OdometryConstraint]) -> f64 {
        constraints
            .iter()
            .zip(&self.cams)
            .map(|(constraint, cam)| constraint.deviation(&self.rig, cam).loss)
            .sum()
    }

    pub(super) fn moved<const N: usize>(&self, constraints: &[OdometryConstraint], step: &Step<N>) -> Self {
        let rig = self.rig.perturbed(&step.of_rig().into());
        let cam = |((constraint, cam), step): ((&OdometryConstraint, &CameraFromWorld), &Vector6<f64>)| {
            if constraint.is_rigid() { constraint.camera(&rig) } else { cam.perturbed(&(*step).into()) }
        };
        Self { cams: constraints.iter().zip(&self.cams).zip(&step.cams).map(cam).collect(), rig }
    }

    fn reorthonormalized(mut self, constraints: &[OdometryConstraint]) -> Self {
        let clean = |rotation: &Rotation3<f64>| {
            let mut rotation = *rotation;
            rotation.renormalize();
            rotation
        };
        self.rig = RigFromWorld::new(clean(self.rig.rotation()), *self.rig.translation());
        for (constraint, cam) in constraints.iter().zip(&mut self.cams) {
            *cam = if constraint.is_rigid() {
                constraint.camera(&self.rig)
            } else {
                CameraFromWorld::new(clean(cam.rotation()), *cam.translation())
            };
        }
        self
    }

    /// The deviation of each frame from its odometry, `[F]`.
    pub(super) fn deviations(&self, constraints: &[OdometryConstraint]) -> Vec<Deviation> {
        let deviation = |(constraint, cam): (&OdometryConstraint, _)| constraint.deviation(&self.rig, cam);
        constraints.iter().zip(&self.cams).map(deviation).collect()
    }
}

/// A step of all poses, and of the parameters of the camera.
pub(super) struct Step<const N: usize> {
    /// The rig's six, then those of the camera.
    shared: SVector<f64, N>,
    /// `[F]`
    cams: Vec<Vector6<f64>>,
    /// Gain predicted by the quadratic model.
    pub(super) promised: f64,
}

impl<const N: usize> Step<N> {
    fn of_rig(&self) -> Vector6<f64> {
        self.shared.fixed_rows::<POSE>(0).into()
    }

    /// Of the parameters of the camera.
    pub(super) fn of_camera(&self) -> &[f64] {
        &self.shared.as_slice()[POSE..]
    }
}

/// The linearization at one point: of each frame's matches, and of its odometry.
pub(super) struct Linearized<const N: usize> {
    systems: Vec<System<N>>,
    deviations: Vec<Deviation>,
    pub(super) loss: f64,
}

/// One frame's six unknowns, eliminated: its step is `alone − bound ε`.
struct Eliminated<const N: usize> {
    alone: Vector6<f64>,
    bound: SMatrix<f64, POSE, N>,
}

impl<const N: usize> Linearized<N> {
    /// `objective` linearizes one frame at a pose of its camera.
    pub(super) fn new(
        poses: &Poses,
        constraints: &[OdometryConstraint],
        objective: impl Fn(usize, &CameraFromWorld) -> System<N>,
    ) -> Self {
        let systems: Vec<_> = poses.cams.iter().enumerate().map(|(i, cam)| objective(i, cam)).collect();
        let deviations = poses.deviations(constraints);
        let loss =
            systems.iter().map(|s| s.loss).sum::<f64>() + deviations.iter().map(|p| p.loss).sum::<f64>();
        Self { systems, deviations, loss }
    }

    /// The step under a damping; `None` when the system does not determine one.
    pub(super) fn damped_step(&self, constraints: &[OdometryConstraint], damping: f64) -> Option<Step<N>> {
        let (mut hessian, mut gradient) = (SMatrix::<f64, N, N>::zeros(), SVector::<f64, N>::zeros());
        let mut eliminated = Vec::with_capacity(constraints.len());
        for ((constraint, system), deviation) in constraints.iter().zip(&self.systems).zip(&self.deviations) {
            if constraint.is_rigid() {
                let over = constraint.with_camera::<N>();
                hessian += over.transpose() * system.hessian * over;
                gradient += over.transpose() * system.gradient;
                eliminated.push(None);
                continue;
            }
            let (slope, of_pose) = system.of_pose();
            let w = Matrix6::from_diagonal(&deviation.precision);
            let strain = deviation.precision.component_mul(&deviation.step);
            let own = (damped(of_pose, damping) + w).cholesky()?;
            // How the shared parameters act on the frame.
            let mut acting = SMatrix::<f64, POSE, N>::zeros();
            acting.fixed_columns_mut::<POSE>(0).copy_from(&-constraint.carried_by(&w));
            let (mut direct, mut direct_slope) = (system.hessian, system.gradient);
            for k in POSE..N {
                acting.set_column(k, &system.hessian.fixed_view::<POSE, 1>(0, k));
                direct.fixed_view_mut::<POSE, 1>(0, k).fill(0.0);
                direct.fixed_view_mut::<1, POSE>(k, 0).fill(0.0);
            }
            direct.fixed_view_mut::<POSE, POSE>(0, 0).copy_from(&constraint.over_rig(&w));
            direct_slope.fixed_rows_mut::<POSE>(0).copy_from(&-constraint.gradient_over_rig(&strain));
            let frame = Eliminated { alone: own.solve(&-(slope + strain)), bound: own.solve(&acting) };
            hessian += direct - acting.transpose() * frame.bound;
            gradient += direct_slope + acting.transpose() * frame.alone;
            eliminated.push(Some(frame));
        }
        let shared = damped(hessian, damping).cholesky()?.solve(&-gradient);
        let rig: Vector6<f64> = shared.fixed_rows::<POSE>(0).into();
        let mut slope = 0.0;
        let mut cams = Vec::with_capacity(constraints.len());
        let parts = constraints.iter().zip(&self.systems).zip(&self.deviations).zip(&eliminated);
        for (((constraint, system), deviation), eliminated) in parts {
            let carried = constraint.carried(&rig);
            let cam = match eliminated {
                None => carried,
                Some(Eliminated { alone, bound }) => {
                    let strain = deviation.precision.component_mul(&deviation.step);
                    let cam = alone - bound * shared;
                    slope += strain.dot(&(cam - carried));
                    cam
                }
            };
            slope +=
                system.of_pose().0.dot(&cam) + (POSE..N).map(|k| system.gradient[k] * shared[k]).sum::<f64>();
            cams.push(cam);
        }
        let finite = shared.iter().chain(cams.iter().flat_map(Vector6::iter)).all(|s| s.is_finite());
        finite.then_some(Step { shared, cams, promised: -0.5 * slope })
    }
}

/// Minimises the sum of all frames' losses and odometry losses, with at most `steps` accepted or rejected steps; ends
/// when a step gains less than this share of the loss. `objective` linearizes one frame at a pose of its camera.
///
/// Never returns poses with a larger loss than the start's.
pub(super) fn descend(
    constraints: &[OdometryConstraint],
    objective: impl Fn(usize, &CameraFromWorld) -> System,
    start: &Poses,
    steps: usize,
    min_gain: f64,
) -> Poses {
    let linearize = |poses: &Poses| Linearized::new(poses, constraints, &objective);
    let step = |poses: &Poses, here: &Linearized<POSE>, damping| {
        let step = here.damped_step(constraints, damping)?;
        Some((poses.moved(constraints, &step), step.promised))
    };
    let convergence = Convergence { steps, min_gain };
    let found = levenberg_marquardt(start.clone(), convergence, linearize, |here| here.loss, step);
    found.at.reorthonormalized(constraints)
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::Rigid3;
    use veiloc_geometry::nalgebra::Vector3;

    /// A quadratic loss with minimum at `wanted` and this information.
    fn spring(wanted: &CameraFromWorld, information: f64, cam: &CameraFromWorld) -> System {
        let step = Vector6::from(wanted.step_to(cam));
        System {
            loss: 0.5 * information * step.norm_squared(),
            gradient: step * information,
            hessian: Matrix6::identity() * information,
        }
    }

    fn pose(x: f64) -> CameraFromWorld {
        Rigid3::new(Rotation3::from_euler_angles(x, 0.3, -x), Vector3::new(x, 1.0, 2.0 - x))
    }

    #[test]
    fn consistent_frames_converge() {
        let rig = RigFromWorld::new(*pose(0.2).rotation(), Vector3::new(0.4, -0.2, 1.0));
        let on_rig =
            |x: f64| veiloc_geometry::CameraFromRig::new(*pose(x).rotation(), *pose(x).translation());
        for sd in [0.0, 0.05] {
            let constraints: Vec<OdometryConstraint> =
                [0.1, 0.9, -0.7].map(|x| OdometryConstraint::new(on_rig(x), sd, sd, 3.0)).into();
            let truth = Poses::rigid(&constraints, rig);
            let start = Poses::rigid(&constraints, rig.perturbed(&[0.05, -0.04, 0.02, 0.1, 0.1, -0.1]));
            let wanted = |i: usize, cam: &CameraFromWorld| spring(&truth.cams[i], 400.0, cam);
            let found = descend(&constraints, wanted, &start, 60, 1e-14);
            assert!(found.rig.translation_error(&rig) < 1e-5, "{sd}");
            assert!(found.rig.rotation_error_degrees(&rig) < 1e-3, "{sd}");
            assert!(found.odometry_loss(&constraints) < 1e-6);
        }
    }

    #[test]
    fn odometry_outlier_does_not_move_the_rig() {
        let identity = veiloc_geometry::CameraFromRig::identity();
        let constraints: Vec<OdometryConstraint> =
            (0..4).map(|_| OdometryConstraint::new(identity, 0.01, 0.01, 3.0)).collect();
        let truth = pose(0.1);
        let slipped = truth.perturbed(&[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        let wanted =
            |i: usize, cam: &CameraFromWorld| spring(if i == 0 { &slipped } else { &truth }, 1e6, cam);
        let start = Poses::rigid(&constraints, RigFromWorld::new(*truth.rotation(), *truth.translation()));
        let found = descend(&constraints, wanted, &start, 60, 1e-14);
        assert!(found.cams[0].translation_error(&slipped) < 0.01);
        assert!((found.rig.translation() - truth.translation()).norm() < 0.03, "{:?}", found.rig);
    }
}
