//! Camera priors beside the matches: the gravity direction and an approximate position.
//!
//! Both enter the objective as heavy-tailed distributions (Student's t with four degrees of freedom): within some
//! deviations they act as normal distributions, and a gross error (a phone that was shaken, a GPS position between tall
//! buildings) loses its influence instead of distorting the pose.
//!
//! Both come from the client. They select and improve a pose; evidence, margin and what holds the pose are those of the
//! matches alone (`estimate.rs`). A gravity direction that the matches confirm is evidence too
//! ([`GravityTest`](crate::likelihood::GravityTest)), and one that they contradict is removed.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};

use crate::likelihood::problem::{Gravity, PoseProblem};
use crate::likelihood::system::System;

/// Degrees of freedom of both distributions.
const FREEDOM: f64 = 4.0;

/// All priors; an empty one changes nothing.
#[derive(Debug, Clone, Default)]
pub struct PosePriors {
    /// Unit vectors in the camera and in the world, standard deviation in radians.
    gravity: Option<(Vector3<f64>, Vector3<f64>, f64)>,
    /// Middle and standard deviation, map units.
    position: Option<(Vector3<f64>, f64)>,
}

/// Three residuals in units of their deviation, with their derivatives by the pose.
struct Term {
    residual: Vector3<f64>,
    jacobian: SMatrix<f64, 3, 6>,
    dimensions: f64,
}

impl Term {
    /// `(ν + d)/2 · log(1 + e²/ν)`.
    fn loss(&self) -> f64 {
        0.5 * (FREEDOM + self.dimensions) * (self.residual.norm_squared() / FREEDOM).ln_1p()
    }

    /// Weight of the squared residual in the normal equations.
    fn weight(&self) -> f64 {
        weight(self.dimensions, self.residual.norm_squared())
    }
}

/// Weight of a squared residual, in squared standard deviations, of this many dimensions.
fn weight(dimensions: f64, squared: f64) -> f64 {
    (FREEDOM + dimensions) / (FREEDOM + squared)
}

/// Weight of the gravity direction at this squared deviation.
pub(crate) fn gravity_weight(squared: f64) -> f64 {
    weight(2.0, squared)
}

impl PosePriors {
    /// The priors of a problem that has passed its check.
    pub fn of(problem: &PoseProblem) -> Self {
        let of_gravity = problem.gravity.as_ref().map(Self::of_gravity).unwrap_or_default();
        Self { position: problem.position.map(|p| (p.center.coords, p.sd)), ..of_gravity }
    }

    /// That of a gravity direction alone.
    pub(crate) fn of_gravity(g: &Gravity) -> Self {
        let gravity = (g.in_camera.normalize(), g.in_world.normalize(), g.sd_deg.to_radians());
        Self { gravity: Some(gravity), position: None }
    }

    /// Whether a gravity direction is among them.
    pub(crate) const fn has_gravity(&self) -> bool {
        self.gravity.is_some()
    }

    /// The others.
    #[must_use]
    pub(crate) fn without_gravity(&self) -> Self {
        Self { gravity: None, ..self.clone() }
    }

    /// Whether there is no prior.
    pub const fn is_empty(&self) -> bool {
        self.gravity.is_none() && self.position.is_none()
    }

    /// Minus the log likelihood of the pose, 0 at the most likely one.
    pub fn loss(&self, pose: &CameraFromWorld) -> f64 {
        self.terms(pose).map(|term| term.loss()).sum()
    }

    /// Distance of a pose from the given position, in standard deviations of that position and of the pose's centre
    /// (`center_sd`, map units); `None` without a position.
    pub fn position_deviation(&self, pose: &CameraFromWorld, center_sd: f64) -> Option<f64> {
        let (center, sd) = self.position?;
        Some((pose.center().coords - center).norm() / sd.hypot(center_sd))
    }

    /// Adds loss and derivatives at the pose.
    pub fn add_to(&self, pose: &CameraFromWorld, system: &mut System) {
        for term in self.terms(pose) {
            let weighted = term.jacobian.transpose() * term.weight();
            system.loss += term.loss();
            system.gradient += weighted * term.residual;
            system.hessian += weighted * term.jacobian;
        }
    }

    /// Information about the six parameters of the pose.
    pub fn information(&self, pose: &CameraFromWorld) -> Matrix6<f64> {
        let mut system = System::empty();
        self.add_to(pose, &mut system);
        system.hessian
    }

    fn terms(&self, pose: &CameraFromWorld) -> impl Iterator<Item = Term> {
        let down = self.gravity.map(|(in_camera, in_world, sd)| {
            let turned = pose.rotation() * in_world;
            // The norm of the cross product is the sine; beyond a right angle it must not decrease again.
            let cross = turned.cross(&in_camera);
            let behind = turned.dot(&in_camera) < 0.0;
            let residual = if behind { cross.try_normalize(1e-12).unwrap_or_else(Vector3::x) } else { cross };
            let turn = in_camera.dot(&turned) * Matrix3::identity() - turned * in_camera.transpose();
            let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
            if !behind {
                jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-turn / sd));
            }
            Term { residual: residual / sd, jacobian, dimensions: 2.0 }
        });
        let position = self.position.map(|(center, sd)| {
            let back = pose.rotation().inverse();
            let mut jacobian = SMatrix::<f64, 3, 6>::zeros();
            jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-back.matrix() / sd));
            Term { residual: (back * -pose.translation() - center) / sd, jacobian, dimensions: 3.0 }
        });
        down.into_iter().chain(position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_geometry::nalgebra::Rotation3;
    use veiloc_geometry::{Point3, Rigid3};

    fn priors() -> PosePriors {
        PosePriors {
            gravity: Some((
                Vector3::new(0.1, 0.9, 0.2).normalize(),
                Vector3::new(0.0, 0.1, -1.0).normalize(),
                0.03,
            )),
            position: Some((Point3::<veiloc_geometry::frames::World>::new(1.0, -2.0, 0.5).coords, 0.7)),
        }
    }

    fn pose() -> CameraFromWorld {
        let turn = Rotation3::rotation_between(&Vector3::new(0.0, 0.1, -1.0), &Vector3::new(0.1, 0.9, 0.2));
        let off = Rotation3::from_euler_angles(0.03, -0.02, 0.04) * turn.expect("not opposite");
        Rigid3::new(off, Vector3::new(0.4, 2.0, 1.0))
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let (priors, pose) = (priors(), pose());
        let mut system = System::empty();
        priors.add_to(&pose, &mut system);
        assert!((system.loss - priors.loss(&pose)).abs() < 1e-12);
        for k in 0..6 {
            let at = |h: f64| {
                let mut step = [0.0; 6];
                step[k] = h;
                priors.loss(&pose.perturbed(&step))
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((numeric - system.gradient[k]).abs() < 1e-4 * (1.0 + numeric.abs()), "{k}");
        }
        assert!(system.hessian.symmetric_eigenvalues().min() > -1e-9);
    }

    #[test]
    fn empty_prior_is_neutral_and_gross_errors_are_downweighted() {
        let none = PosePriors::default();
        assert_eq!((none.loss(&pose()), none.information(&pose())), (0.0, Matrix6::zeros()));
        let near = priors();
        let mut far = near.clone();
        far.position = Some((Vector3::new(500.0, 0.0, 0.0), 0.7));
        assert!(far.information(&pose())[(3, 3)] < 0.01 * near.information(&pose())[(3, 3)]);
        let upside_down = Rigid3::new(
            Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI) * pose().rotation(),
            *pose().translation(),
        );
        assert!(near.loss(&upside_down) > near.loss(&pose()) + 10.0);
    }
}
