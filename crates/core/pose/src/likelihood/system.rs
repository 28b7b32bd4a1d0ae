//! Gauss–Newton systems over a pose and the first parameters of its camera.

use veiloc_geometry::nalgebra::{Matrix6, SMatrix, SVector, Vector6};

use crate::likelihood::camera::{CAMERA, CameraChange};
use crate::likelihood::matches::Residual;

/// A pose alone.
pub const POSE: usize = 6;

/// A pose with the logarithm of the focal length.
pub const POSE_AND_FOCAL: usize = 7;

/// A pose with a whole camera.
pub const POSE_AND_CAMERA: usize = POSE + CAMERA;

/// Gauss–Newton system `H δ = −g` at one pose and camera, over the six parameters of
/// [`CameraFromWorld::perturbed`](veiloc_geometry::CameraFromWorld::perturbed) and the first `N − 6` of
/// [`CameraChange`].
#[derive(Debug, Clone)]
pub struct System<const N: usize = POSE> {
    /// The loss there.
    pub loss: f64,
    /// `g`, its derivative.
    pub gradient: SVector<f64, N>,
    /// `H`, symmetric.
    pub hessian: SMatrix<f64, N, N>,
}

impl<const N: usize> System<N> {
    /// Of no correspondence.
    pub fn empty() -> Self {
        Self { loss: 0.0, gradient: SVector::zeros(), hessian: SMatrix::zeros() }
    }

    /// Adds a residual to the gradient and to the upper half of the Hessian ([`Self::mirrored`]), with the weight of
    /// its square and that of `−log r`.
    #[inline]
    pub(crate) fn add(&mut self, residual: &Residual, weight: f64, radial: f64, rows: usize) {
        if weight <= 0.0 {
            return;
        }
        for row in 0..rows {
            let (e, j) =
                (residual.error[row], column::<N>(&residual.jacobian[row], &residual.by_camera[row]));
            for a in 0..N {
                let wj = weight * j[a];
                self.gradient[a] += wj * e;
                for b in a..N {
                    self.hessian[(a, b)] += wj * j[b];
                }
            }
        }
        if radial > 0.0 {
            let j = column::<N>(&residual.radius_jacobian, &residual.radius_by_camera);
            for a in 0..N {
                self.gradient[a] -= radial * j[a];
            }
        }
    }

    /// With the lower half of the Hessian from the upper one.
    #[must_use]
    pub(crate) fn mirrored(mut self) -> Self {
        self.hessian.fill_lower_triangle_with_upper_triangle();
        self
    }

    /// Adds terms of the pose alone.
    #[must_use]
    pub(crate) fn with_pose_terms(mut self, of_pose: &System) -> Self {
        self.loss += of_pose.loss;
        for a in 0..POSE {
            self.gradient[a] += of_pose.gradient[a];
            for b in 0..POSE {
                self.hessian[(a, b)] += of_pose.hessian[(a, b)];
            }
        }
        self
    }

    /// Adds a normal prior of the camera about the given one, of these standard deviations.
    #[must_use]
    pub(crate) fn with_camera_prior(mut self, change: &CameraChange, sd: &[f64; CAMERA]) -> Self {
        self.loss += camera_loss(change, sd);
        for k in POSE..N {
            let precision = sd[k - POSE].powi(-2);
            self.gradient[k] += change.0[k - POSE] * precision;
            self.hessian[(k, k)] += precision;
        }
        self
    }

    /// The step under a damping; `None` when the system does not determine one.
    pub(crate) fn damped_step(&self, damping: f64) -> Option<SVector<f64, N>> {
        let step = damped(self.hessian, damping).cholesky()?.solve(&-self.gradient);
        step.iter().all(|s| s.is_finite()).then_some(step)
    }

    /// The block of the pose.
    pub(crate) fn of_pose(&self) -> (Vector6<f64>, Matrix6<f64>) {
        (self.gradient.fixed_rows::<POSE>(0).into(), self.hessian.fixed_view::<POSE, POSE>(0, 0).into())
    }
}

/// Marquardt's damping: a share of the diagonal is added.
pub(crate) fn damped<const N: usize>(mut hessian: SMatrix<f64, N, N>, damping: f64) -> SMatrix<f64, N, N> {
    for k in 0..N {
        hessian[(k, k)] += damping * hessian[(k, k)].max(1e-12);
    }
    hessian
}

/// Minus the logarithm of the normal prior of a camera.
pub(crate) fn camera_loss(change: &CameraChange, sd: &[f64; CAMERA]) -> f64 {
    change.0.iter().zip(sd).map(|(of, sd)| 0.5 * (of / sd).powi(2)).sum()
}

/// Derivatives by the pose and by the first parameters of the camera.
fn column<const N: usize>(pose: &[f64; POSE], camera: &[f64; CAMERA]) -> [f64; N] {
    std::array::from_fn(|k| if k < POSE { pose[k] } else { camera[k - POSE] })
}
