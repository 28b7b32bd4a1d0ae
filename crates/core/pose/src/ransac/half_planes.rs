//! Anchored lines as half-planes that begin at their anchor's direction.

use crate::likelihood::Matches;
use crate::solvers::HalfPlane;
use veiloc_geometry::nalgebra::Vector3;
use veiloc_geometry::{Anchor, Pencils};

/// The direction of an anchor in the camera of these correspondences, any length. The camera may differ from the
/// device's when another focal length is tried.
pub(crate) fn direction(matches: &Matches<'_>, pencils: &Pencils, anchor: Anchor) -> Vector3<f64> {
    let (at, c) = (pencils.homogeneous(anchor), &matches.camera);
    Vector3::new(
        (at.x - c.principal[0] * at.z) / c.focal[0],
        (at.y - c.principal[1] * at.z) / c.focal[1],
        at.z,
    )
}

/// The half-plane of each correspondence, `[N]`.
pub(crate) fn half_planes(
    matches: &Matches<'_>,
    pencils: &Pencils,
    lines: &[(Anchor, f64)],
) -> Vec<HalfPlane> {
    let c = &matches.camera;
    let axes: Vec<Vector3<f64>> =
        pencils.anchors().map(|anchor| direction(matches, pencils, anchor)).collect();
    lines
        .iter()
        .map(|&(anchor, angle)| {
            let axis = axes[anchor.index()];
            // A ray in the plane on the right side of the axis: perpendicular to the axis within the plane, of either
            // sign.
            let line = pencils.line(anchor, angle).expect("lines that miss the image plane are refused");
            let across = line.back_project(c).normal().cross(&axis);
            // The device's camera decides on which side a ray is, in pixels: `(K r)` is `(u, v, 1)` times any positive
            // number.
            let side = |ray: &Vector3<f64>| {
                let on_pixels = Vector3::new(
                    c.focal[0] * ray.x + c.principal[0] * ray.z,
                    c.focal[1] * ray.y + c.principal[1] * ray.z,
                    ray.z,
                );
                pencils.ahead(anchor, angle).dot(&on_pixels)
            };
            let inward = if side(&across) < 0.0 { -across } else { across };
            HalfPlane { axis, inward }
        })
        .collect()
}
