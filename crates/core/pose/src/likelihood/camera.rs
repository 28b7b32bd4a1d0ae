//! A camera that differs a little from a given one, and a pose with such a camera.

use veiloc_geometry::nalgebra::{SMatrix, Vector2};
use veiloc_geometry::{CameraFromWorld, Pinhole};

/// Number of parameters of the camera.
pub(crate) const CAMERA: usize = 6;

/// Largest change of one parameter, in all and in one step.
const MAX_CHANGE: f64 = 0.7;
const MAX_STEP: f64 = 0.2;

/// How a camera differs from a given one: logarithm of the focal length, logarithm of `fx / fy`, skew, shift of the
/// principal point as shares of the image's width, first radial term.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CameraChange(pub [f64; CAMERA]);

impl CameraChange {
    /// A change of the focal length only.
    pub fn of_focal(factor: f64) -> Self {
        Self([factor.ln(), 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// The changed camera, without skew and radial term.
    pub fn pinhole(&self, given: &Pinhole) -> Pinhole {
        let [log_focal, log_aspect, _, cx, cy, _] = self.0;
        let width = f64::from(given.width);
        Pinhole {
            focal: [
                given.focal[0] * (log_focal + 0.5 * log_aspect).exp(),
                given.focal[1] * (log_focal - 0.5 * log_aspect).exp(),
            ],
            principal: [given.principal[0] + cx * width, given.principal[1] + cy * width],
            ..*given
        }
    }

    /// The focal length relative to the given one.
    pub fn factor(&self) -> f64 {
        self.0[0].exp()
    }

    /// Shift of the principal point, pixels.
    pub fn principal_shift_px(&self, given: &Pinhole) -> [f64; 2] {
        [3, 4].map(|k| self.0[k] * f64::from(given.width))
    }

    /// The same change without skew and radial term.
    #[must_use]
    pub const fn without_distortion(self) -> Self {
        let [focal, aspect, _, cx, cy, _] = self.0;
        Self([focal, aspect, 0.0, cx, cy, 0.0])
    }

    /// The change after a step of its first parameters, of limited length; `None` when the camera would be too
    /// different.
    pub fn moved(mut self, step: &[f64]) -> Option<Self> {
        self.0.iter_mut().zip(step).for_each(|(of, step)| *of += step.clamp(-MAX_STEP, MAX_STEP));
        self.0.iter().all(|of| of.abs() <= MAX_CHANGE).then_some(self)
    }
}

/// A pose with a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseWithCamera {
    /// The pose.
    pub pose: CameraFromWorld,
    /// The camera.
    pub change: CameraChange,
}

/// The camera of a residual: a pinhole with skew and a radial term.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DistortedCamera {
    pub(crate) pinhole: Pinhole,
    skew: f64,
    radial: f64,
}

impl DistortedCamera {
    pub(crate) const fn undistorted(pinhole: Pinhole) -> Self {
        Self { pinhole, skew: 0.0, radial: 0.0 }
    }

    pub(crate) fn changed(given: &Pinhole, change: &CameraChange) -> Self {
        Self { pinhole: change.pinhole(given), skew: change.0[2], radial: change.0[5] }
    }

    /// The distorted coordinates of a point of the image plane, and their derivatives by it.
    pub(crate) fn distort(&self, plane: &Vector2<f64>) -> (Vector2<f64>, SMatrix<f64, 2, 2>) {
        let squared = plane.norm_squared();
        let grow = 1.0 + self.radial * squared;
        let distorted = Vector2::new(plane.x * grow + self.skew * plane.y, plane.y * grow);
        let mut by_plane = plane * plane.transpose() * (2.0 * self.radial);
        by_plane[(0, 0)] += grow;
        by_plane[(1, 1)] += grow;
        by_plane[(0, 1)] += self.skew;
        (distorted, by_plane)
    }

    /// Derivatives of the pixel by the parameters of [`CameraChange`].
    pub(crate) fn pixel_by_change(
        &self,
        plane: &Vector2<f64>,
        distorted: &Vector2<f64>,
    ) -> [Vector2<f64>; CAMERA] {
        let [fx, fy] = self.pinhole.focal;
        let width = f64::from(self.pinhole.width);
        let zoom = Vector2::new(fx * distorted.x, fy * distorted.y);
        let squared = plane.norm_squared();
        [
            zoom,
            Vector2::new(0.5 * zoom.x, -0.5 * zoom.y),
            Vector2::new(fx * plane.y, 0.0),
            Vector2::new(width, 0.0),
            Vector2::new(0.0, width),
            Vector2::new(fx * plane.x * squared, fy * plane.y * squared),
        ]
    }
}
