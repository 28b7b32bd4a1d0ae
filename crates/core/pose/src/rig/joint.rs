//! Levenberg–Marquardt on the poses of a rig and of its frames together.
//!
//! Frames are tied to the rig and to nothing else, so the normal equations are an arrow: each frame's six unknowns are
//! eliminated on their own, and what is left are the rig's six.
//!
//! ```text
//! | B_1          -W_1 A_1 | | δ_1 |   | -g_1 - W_1 r_1        |     B_i = H_i + W_i
//! |      B_2     -W_2 A_2 | | δ_2 | = | -g_2 - W_2 r_2        |     H_i, g_i of frame i's matches
//! |  ·    ·         ·     | |  ε  |   |  Σ A_iᵀ W_i r_i       |     r_i, W_i, A_i of its tie
//! ```

use veiloc_geometry::nalgebra::{Matrix6, Rotation3, Vector6};
use veiloc_geometry::{CameraFromWorld, RigFromWorld};

use super::odometry::{Pull, Tie};
use crate::likelihood::{Convergence, System, levenberg_marquardt};

/// Where a rig and its frames are.
#[derive(Debug, Clone)]
pub(super) struct Poses {
    pub(super) rig: RigFromWorld,
    /// `[F]`
    pub(super) cams: Vec<CameraFromWorld>,
}

/// Everything at one place: what each frame's matches say, and what its tie says.
struct Linearized {
    systems: Vec<System>,
    pulls: Vec<Pull>,
    loss: f64,
}

impl Poses {
    /// All frames where the odometry puts them.
    pub(super) fn rigid(ties: &[Tie], rig: RigFromWorld) -> Self {
        Self { cams: ties.iter().map(|tie| tie.camera(&rig)).collect(), rig }
    }

    /// What the deviations of all frames cost.
    pub(super) fn tension(&self, ties: &[Tie]) -> f64 {
        ties.iter().zip(&self.cams).map(|(tie, cam)| tie.pull(&self.rig, cam).loss).sum()
    }

    pub(super) fn moved(&self, ties: &[Tie], step: &Step) -> Self {
        let rig = self.rig.perturbed(&step.rig.into());
        let cam = |((tie, cam), step): ((&Tie, &CameraFromWorld), &Vector6<f64>)| {
            if tie.is_rigid() { tie.camera(&rig) } else { cam.perturbed(&(*step).into()) }
        };
        Self { cams: ties.iter().zip(&self.cams).zip(&step.cams).map(cam).collect(), rig }
    }

    fn reorthonormalized(mut self, ties: &[Tie]) -> Self {
        let clean = |rotation: &Rotation3<f64>| {
            let mut rotation = *rotation;
            rotation.renormalize();
            rotation
        };
        self.rig = RigFromWorld::new(clean(self.rig.rotation()), *self.rig.translation());
        for (tie, cam) in ties.iter().zip(&mut self.cams) {
            *cam = if tie.is_rigid() {
                tie.camera(&self.rig)
            } else {
                CameraFromWorld::new(clean(cam.rotation()), *cam.translation())
            };
        }
        self
    }
}

/// A step of all poses.
pub(super) struct Step {
    pub(super) rig: Vector6<f64>,
    /// `[F]`
    pub(super) cams: Vec<Vector6<f64>>,
    /// What the quadratic model gains by it.
    pub(super) promised: f64,
}

/// Minimises what all frames' matches and ties cost, at most `steps` accepted or refused steps; ends when a step gains less
/// than this share of the loss. `objective` linearizes one frame at a pose of its camera.
///
/// Never returns poses with a larger loss than the start's.
pub(super) fn descend(
    ties: &[Tie],
    objective: impl Fn(usize, &CameraFromWorld) -> System,
    start: &Poses,
    steps: usize,
    least_gain: f64,
) -> Poses {
    let linearize = |poses: &Poses| {
        let systems: Vec<System> = poses.cams.iter().enumerate().map(|(i, cam)| objective(i, cam)).collect();
        let pulls: Vec<Pull> =
            ties.iter().zip(&poses.cams).map(|(tie, cam)| tie.pull(&poses.rig, cam)).collect();
        let loss = systems.iter().map(|s| s.loss).sum::<f64>() + pulls.iter().map(|p| p.loss).sum::<f64>();
        Linearized { systems, pulls, loss }
    };
    let step = |poses: &Poses, here: &Linearized, damping| {
        let step = damped_step(ties, here, damping)?;
        Some((poses.moved(ties, &step), step.promised))
    };
    let convergence = Convergence { steps, least_gain };
    let found = levenberg_marquardt(start.clone(), convergence, linearize, |here| here.loss, step);
    found.at.reorthonormalized(ties)
}

fn damped_step(ties: &[Tie], here: &Linearized, damping: f64) -> Option<Step> {
    let damped = |mut h: Matrix6<f64>| {
        for k in 0..6 {
            h[(k, k)] += damping * h[(k, k)].max(1e-12);
        }
        h
    };
    let (mut hessian, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
    let mut eliminated = Vec::with_capacity(ties.len());
    for ((tie, system), pull) in ties.iter().zip(&here.systems).zip(&here.pulls) {
        if tie.is_rigid() {
            hessian += tie.over_rig(&system.hessian);
            gradient += tie.gradient_over_rig(&system.gradient);
            eliminated.push(None);
            continue;
        }
        let w = Matrix6::from_diagonal(&pull.precision);
        let strain = pull.precision.component_mul(&pull.step);
        let own = (damped(system.hessian) + w).cholesky()?;
        let alone = own.solve(&-(system.gradient + strain));
        hessian += tie.over_rig(&(w - w * own.solve(&w)));
        gradient -= tie.gradient_over_rig(&(strain + w * alone));
        eliminated.push(Some((own, alone)));
    }
    let rig = damped(hessian).cholesky()?.solve(&-gradient);
    let mut slope = 0.0;
    let mut cams = Vec::with_capacity(ties.len());
    for (((tie, system), pull), eliminated) in
        ties.iter().zip(&here.systems).zip(&here.pulls).zip(&eliminated)
    {
        let carried = tie.carried(&rig);
        let cam = match eliminated {
            None => carried,
            Some((own, alone)) => {
                let strain = pull.precision.component_mul(&pull.step);
                let cam = alone + own.solve(&pull.precision.component_mul(&carried));
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

    /// A frame that wants its camera at `wanted`, with this information.
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
    fn frames_that_agree_are_all_reached() {
        let rig = RigFromWorld::new(*pose(0.2).rotation(), Vector3::new(0.4, -0.2, 1.0));
        let on_rig =
            |x: f64| veiloc_geometry::CameraFromRig::new(*pose(x).rotation(), *pose(x).translation());
        for sd in [0.0, 0.05] {
            let ties: Vec<Tie> = [0.1, 0.9, -0.7].map(|x| Tie::new(on_rig(x), sd, sd, 3.0)).into();
            let truth = Poses::rigid(&ties, rig);
            let start = Poses::rigid(&ties, rig.perturbed(&[0.05, -0.04, 0.02, 0.1, 0.1, -0.1]));
            let wanted = |i: usize, cam: &CameraFromWorld| spring(&truth.cams[i], 400.0, cam);
            let found = descend(&ties, wanted, &start, 60, 1e-14);
            assert!(found.rig.translation_error(&rig) < 1e-5, "{sd}");
            assert!(found.rig.rotation_error_degrees(&rig) < 1e-3, "{sd}");
            assert!(found.tension(&ties) < 1e-6);
        }
    }

    #[test]
    fn a_frame_that_slipped_keeps_its_own_place() {
        let identity = veiloc_geometry::CameraFromRig::identity();
        let ties: Vec<Tie> = (0..4).map(|_| Tie::new(identity, 0.01, 0.01, 3.0)).collect();
        let place = pose(0.1);
        let slipped = place.perturbed(&[0.0, 0.0, 0.0, 0.5, 0.0, 0.0]);
        let wanted =
            |i: usize, cam: &CameraFromWorld| spring(if i == 0 { &slipped } else { &place }, 1e6, cam);
        let start = Poses::rigid(&ties, RigFromWorld::new(*place.rotation(), *place.translation()));
        let found = descend(&ties, wanted, &start, 60, 1e-14);
        assert!(found.cams[0].translation_error(&slipped) < 0.01);
        assert!((found.rig.translation() - place.translation()).norm() < 0.03, "{:?}", found.rig);
    }
}
