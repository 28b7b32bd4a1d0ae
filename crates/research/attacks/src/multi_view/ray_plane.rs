//! Planes through the lines of another frame, relative to the attacked frame: each viewing ray intersects such a
//! plane, or lies in it.

use crate::{Observation, PencilRow};
use veiloc_geometry::nalgebra::{Matrix3, Vector3};
use veiloc_geometry::{Pinhole, Pixel};

use crate::multi_view::frame::Frame;

/// Another frame relative to the attacked one: `x_other = rotation · x + translation` from camera to camera.
pub(crate) struct RelativeFrame {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    camera: Pinhole,
}

impl RelativeFrame {
    pub(crate) fn new(first: &Frame<'_>, other: &Frame<'_>) -> Self {
        let relative = other.cam_from_world.compose(&first.cam_from_world.inverse());
        Self {
            rotation: *relative.rotation().matrix(),
            translation: *relative.translation(),
            camera: other.camera,
        }
    }

    /// The line or lines of one keypoint of that frame.
    pub(crate) fn planes(&self, observation: &Observation) -> Vec<Plane<'_>> {
        let row = match *observation {
            Observation::Pencil(row) => Some(row),
            _ => None,
        };
        let lines: Vec<_> = observation.lines().into_iter().flatten().collect();
        let share = 1.0 / lines.len().max(1) as f64;
        let plane = |line: &Vector3<f64>| {
            let c = &self.camera;
            let normal = Vector3::new(
                c.focal[0] * line.x,
                c.focal[1] * line.y,
                c.principal[0] * line.x + c.principal[1] * line.y + line.z,
            );
            let across = line.x.abs() * f64::from(c.width) + line.y.abs() * f64::from(c.height);
            Plane { relative: self, normal, by_depth: normal.dot(&self.translation), row, share, across }
        };
        lines.iter().map(|line| plane(line.coefficients())).collect()
    }
}

/// One candidate line of the keypoint in another frame.
pub(crate) struct Plane<'a> {
    relative: &'a RelativeFrame,
    /// `Kᵀ l` with a line of unit normal: the plane in that frame, pixels.
    normal: Vector3<f64>,
    /// `normal · translation`.
    by_depth: f64,
    /// For a pencil: its origin, and the spans that can hold the keypoint.
    row: Option<PencilRow>,
    /// Prior probability of this line: one over the number of candidates.
    share: f64,
    /// Width of the image across the line, pixels.
    across: f64,
}

/// Tolerance of the image's border for projections, pixels.
const MARGIN: f64 = 3.0;

/// A plane and a viewing ray of the attacked frame: all terms that do not depend on depth.
pub(crate) struct RayPlane<'a, 'b> {
    plane: &'a Plane<'b>,
    /// `rotation · ray`.
    in_other: Vector3<f64>,
    /// `normal · in_other`.
    off: f64,
}

/// The residual of a plane at one depth along a ray.
pub(crate) struct PlaneResidual {
    /// Signed distance of the projection from the line, pixels; not finite behind the camera.
    pub(crate) distance: f64,
    /// Its derivative with respect to log depth, pixels.
    pub(crate) depth_derivative: f64,
    /// Ratio of two densities of the sent line, for a right projection and for a wrong match, times the noise and
    /// `√2π`, at distance zero: pixels. Zero if the frame could not have sent this line: behind the camera, outside
    /// the image, behind the anchor, in another anchor's sectors.
    pub(crate) spread: f64,
}

impl<'b> Plane<'b> {
    /// The plane with the ray `(x, y, 1)` of the attacked camera.
    pub(crate) fn along(&self, ray: Vector3<f64>) -> RayPlane<'_, 'b> {
        let in_other = self.relative.rotation * ray;
        RayPlane { plane: self, in_other, off: self.normal.dot(&in_other) }
    }
}

impl RayPlane<'_, '_> {
    /// The residual at a depth in the attacked frame, given by its reciprocal; 0 is infinity.
    ///
    /// The density of a line is that of its sent parameters. A half-line is sent as an angle: noise of `σ` pixels at
    /// distance `r` from the anchor spreads over `σ/r` radians and wrong matches over the half circle, so `spread` is
    /// `π r`. Other lines are sent as an offset, and wrong matches spread over the image.
    pub(crate) fn at(&self, reciprocal: f64) -> PlaneResidual {
        let (plane, relative) = (self.plane, self.plane.relative);
        let in_other = self.in_other + relative.translation * reciprocal;
        if in_other.z <= 1e-9 {
            return PlaneResidual { distance: f64::INFINITY, depth_derivative: 0.0, spread: 0.0 };
        }
        let distance = (self.off + reciprocal * plane.by_depth) / in_other.z;
        let slope = plane.by_depth * self.in_other.z - self.off * relative.translation.z;
        let depth_derivative = -reciprocal * slope / (in_other.z * in_other.z);
        let c = &relative.camera;
        let at = Pixel::new(
            c.focal[0] * in_other.x / in_other.z + c.principal[0],
            c.focal[1] * in_other.y / in_other.z + c.principal[1],
        );
        let spread = match &plane.row {
            _ if !c.contains(at, MARGIN) => 0.0,
            Some(row) if !row.holds(at, MARGIN) => 0.0,
            Some(row) => match row.origin() {
                Some(anchor) => std::f64::consts::PI * at.distance(&anchor),
                None => plane.across,
            },
            None => plane.share * plane.across,
        };
        PlaneResidual { distance, depth_derivative, spread }
    }
}
