//! Random exact problems with known poses, shared by all solver tests.
#![allow(dead_code, reason = "each test binary uses its own part of this module")]

use rand::Rng;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use veiloc_geometry::{
    Anchor, CameraFromWorld, Pencils, Pinhole, Pixel, PixelLine, PlaneLine, Point3, Rigid3,
};

/// A 640 × 480 camera such as those of the data sets.
pub(crate) const CAMERA: Pinhole =
    Pinhole { width: 640, height: 480, focal: [525.0, 525.0], principal: [320.0, 240.0] };

pub(crate) fn random_rotation(rng: &mut impl Rng) -> Rotation3<f64> {
    loop {
        let [w, x, y, z]: [f64; 4] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let q = Quaternion::new(w, x, y, z);
        if q.norm() > 0.1 && q.norm() < 1.0 {
            return UnitQuaternion::from_quaternion(q).to_rotation_matrix();
        }
    }
}

pub(crate) fn random_direction(rng: &mut impl Rng) -> Vector3<f64> {
    random_rotation(rng) * Vector3::z()
}

/// Any rotation, a centre within ten units of the world's origin.
pub(crate) fn random_pose(rng: &mut impl Rng) -> CameraFromWorld {
    let r = random_rotation(rng);
    let center = Vector3::from_fn(|_, _| rng.random_range(-10.0..10.0));
    Rigid3::new(r, -(r * center))
}

/// A pixel of the image and a map point that projects there, one to eleven units deep.
pub(crate) fn random_match(rng: &mut impl Rng, pose: &CameraFromWorld) -> (Pixel, Point3<World>) {
    let pixel = Pixel::new(rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
    (pixel, lift(pose, pixel, rng.random_range(1.0..11.0)))
}

pub(crate) fn lift(pose: &CameraFromWorld, pixel: Pixel, depth: f64) -> Point3<World> {
    let ray = CAMERA.unproject(pixel).homogeneous();
    pose.inverse().transform(&Point3::from_vector(ray * depth))
}

pub(crate) fn random_line(rng: &mut impl Rng, pixel: Pixel) -> PlaneLine {
    PixelLine::through(pixel, rng.random_range(0.0..std::f64::consts::PI)).back_project(&CAMERA)
}

/// The line that Dual Convergent Lines give this pixel.
pub(crate) fn dcl_line(pixel: Pixel) -> PlaneLine {
    let dcl = Pencils::paper(640, 480);
    let anchor = dcl.anchor_of(pixel);
    dcl.line(anchor, dcl.angle_of(anchor, pixel)).expect("it meets the image").back_project(&CAMERA)
}

/// The direction of an anchor of the paper's layout in the camera.
pub(crate) fn ray_of(anchor: Anchor) -> Vector3<f64> {
    let position = Pencils::paper(640, 480).position(anchor).expect("at the image's edge");
    CAMERA.unproject(position).homogeneous()
}

/// The other of the two.
pub(crate) fn other(anchor: Anchor) -> Anchor {
    Anchor::BOTH[1 - anchor.index()]
}

/// A match whose pixel lies on the given anchor's side.
pub(crate) fn random_match_on(
    rng: &mut impl Rng,
    pose: &CameraFromWorld,
    anchor: Anchor,
) -> (Pixel, Point3<World>) {
    let dcl = Pencils::paper(640, 480);
    loop {
        let (pixel, point) = random_match(rng, pose);
        if dcl.anchor_of(pixel) == anchor {
            return (pixel, point);
        }
    }
}

/// Difference of two poses: the larger of rotation (radians) and centre distance (units).
pub(crate) fn difference(a: &CameraFromWorld, b: &CameraFromWorld) -> f64 {
    a.rotation_error_degrees(b).to_radians().max(a.translation_error(b))
}
