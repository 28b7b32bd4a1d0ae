//! Levenberg–Marquardt on the poses of a rig and of its frames together.
//!
//! Frames are connected only to the rig, so the normal equations have arrowhead structure: each frame's six unknowns
//! are eliminated on their own, and the rig's six remain.
//!
//! ```text
//! | B_1          -W_1 A_1 | | δ_1 |   | -g_1 - W_1 r_1        |     B_i = H_i + W_i
//! |      B_2     -W_2 A_2 | | δ_2 | = | -g_2 - W_2 r_2        |     H_i, g_i of frame i's matches
//! |  ·    ·         ·     | |  ε  |   |  Σ A_iᵀ W_i r_i       |     r_i, W_i, A_i of its tie
//! |  ·    ·         ·     | |  ε  |   |  Σ A_iᵀ W_i r_i       |     r_i, W_i, A_i of its odometry

use veiloc_geometry::nalgebra::{Matrix6, Rotation3, Vector6};
use veiloc_geometry::{CameraFromWorld, RigFromWorld};

use super::odometry::{Deviation, OdometryConstraint};
use crate::likelihood::{Convergence, System, levenberg_marquardt};

/// The poses of a rig and its frames.
#[derive(Debug, Clone)]
pub(super) struct Poses {
    pub(super) rig: RigFromWorld,
    /// `[F]`
    pub(super) cams: Vec<CameraFromWorld>,
}

/// The linearization at one point: of each frame's matches, and of its odometry.
struct Linearized {
    systems: Vec<System>,
    deviations: Vec<Deviation>,
    loss: f64,
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

    pub(super) fn moved(&self, constraints: &[OdometryConstraint], step: &Step) -> Self {
        let rig = self.rig.perturbed(&step.rig.into());
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

/// A step of all poses.
pub(super) struct Step {
    pub(super) rig: Vector6<f64>,
    /// `[F]`
    pub(super) cams: Vec<Vector6<f64>>,
    /// Gain predicted by the quadratic model.
    pub(super) promised: f64,
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
    let linearize = |poses: &Poses| {
        let systems: Vec<System> = poses.cams.iter().enumerate().map(|(i, cam)| objective(i, cam)).collect();
        let deviations = poses.deviations(constraints);
        let loss =
            systems.iter().map(|s| s.loss).sum::<f64>() + deviations.iter().map(|p| p.loss).sum::<f64>();
        Linearized { systems, deviations, loss }
    };
    let step = |poses: &Poses, here: &Linearized, damping| {
        let step = damped_step(constraints, here, damping)?;
        Some((poses.moved(constraints, &step), step.promised))
    };
    let convergence = Convergence { steps, min_gain };
    let found = levenberg_marquardt(start.clone(), convergence, linearize, |here| here.loss, step);
    found.at.reorthonormalized(constraints)
}

fn damped_step(constraints: &[OdometryConstraint], here: &Linearized, damping: f64) -> Option<Step> {
    let damped = |mut h: Matrix6<f64>| {
        for k in 0..6 {
            h[(k, k)] += damping * h[(k, k)].max(1e-12);
        }
        h
    };
    let (mut hessian, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
    let mut eliminated = Vec::with_capacity(constraints.len());
    for ((constraint, system), deviation) in constraints.iter().zip(&here.systems).zip(&here.deviations) {
        if constraint.is_rigid() {
            hessian += constraint.over_rig(&system.hessian);
            gradient += constraint.gradient_over_rig(&system.gradient);
            eliminated.push(None);
            continue;
        }
        let w = Matrix6::from_diagonal(&deviation.precision);
        let strain = deviation.precision.component_mul(&deviation.step);
        let own = (damped(system.hessian) + w).cholesky()?;
        let alone = own.solve(&-(system.gradient + strain));
        hessian += constraint.over_rig(&(w - w * own.solve(&w)));
        gradient -= constraint.gradient_over_rig(&(strain + w * alone));
        eliminated.push(Some((own, alone)));
    }
    let rig = damped(hessian).cholesky()?.solve(&-gradient);
    let mut slope = 0.0;
    let mut cams = Vec::with_capacity(constraints.len());
    for (((constraint, system), deviation), eliminated) in
        constraints.iter().zip(&here.systems).zip(&here.deviations).zip(&eliminated)
    {
        let carried = constraint.carried(&rig);
        let cam = match eliminated {
            None => carried,
            Some((own, alone)) => {
                let strain = deviation.precision.component_mul(&deviation.step);
                let cam = alone + own.solve(&deviation.precision.component_mul(&carried));
                slope += strain.dot(&(cam - carried));
                cam
            }
        };
        slope += system.gradient.dot(&cam);
        cams.push(cam);
    }
    let finite = rig.iter().chain(cams.iter().flat_map(Vector6::iter)).all(|s| s.is_finite());
    finite.then_some(Step { rig, cams, promised: -0.5 * slope })
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
