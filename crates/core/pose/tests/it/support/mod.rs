//! Synthetic pose problems: a random scene, right and wrong matches, any scheme.

pub(crate) mod problems;
pub(crate) mod rigs;

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Pencils, Pinhole, Pixel, PixelLine, PlanePoint, Point3, Rigid3};
use veiloc_pose::{Correspondences, PoseProblem};

pub(crate) const CAMERA: Pinhole =
    Pinhole { width: 640, height: 480, focal: [525.0, 525.0], principal: [320.0, 240.0] };

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Scheme {
    Points,
    Lines,
    Dcl,
}

#[derive(Debug, Clone, Copy)]
pub(crate) struct Setup {
    pub(crate) scheme: Scheme,
    pub(crate) right: usize,
    pub(crate) wrong: usize,
    /// Standard deviation, pixels.
    pub(crate) noise: f64,
}

pub(crate) fn gauss(rng: &mut ChaCha8Rng) -> f64 {
    (-2.0 * (1.0 - rng.random::<f64>()).ln()).sqrt() * (std::f64::consts::TAU * rng.random::<f64>()).cos()
}

/// The problem and its true pose; right matches come first.
pub(crate) fn problem(setup: &Setup, rng: &mut ChaCha8Rng) -> (PoseProblem, CameraFromWorld) {
    let turn = Rotation3::from_euler_angles(
        rng.random_range(-3.0..3.0),
        rng.random_range(-1.5..1.5),
        rng.random_range(-3.0..3.0),
    );
    let truth: CameraFromWorld = Rigid3::new(turn, Vector3::from_fn(|_, _| rng.random_range(-5.0..5.0)));
    (seen_from(&truth, setup, rng), truth)
}

/// Gives the keypoints of a problem a radial distortion that its camera lacks.
pub(crate) fn bend(problem: &mut PoseProblem, truth: &CameraFromWorld, radial: f64) {
    let camera = problem.camera;
    for point in &mut problem.points {
        // The point moves to where the distorted ray goes.
        let seen = truth.transform(point);
        let plane = camera.project(PlanePoint::from_camera_point(&seen).expect("in front"));
        let bent = camera.unproject(plane);
        let squared = bent.x * bent.x + bent.y * bent.y;
        let ray = PlanePoint::new(bent.x * (1.0 + radial * squared), bent.y * (1.0 + radial * squared));
        *point = truth.inverse().transform(&Point3::from_vector(ray.homogeneous() * seen.coords.z));
    }
}

/// The problem of a camera with this pose; right matches come first.
pub(crate) fn seen_from(truth: &CameraFromWorld, setup: &Setup, rng: &mut ChaCha8Rng) -> PoseProblem {
    let mut pixels = Vec::new();
    let mut points = Vec::new();
    for i in 0..setup.right + setup.wrong {
        let random =
            |rng: &mut ChaCha8Rng| Pixel::new(rng.random_range(1.0..639.0), rng.random_range(1.0..479.0));
        let pixel = random(rng);
        let seen = if i < setup.right { pixel } else { random(rng) };
        let ray = CAMERA.unproject(seen).homogeneous();
        points.push(truth.inverse().transform(&Point3::from_vector(ray * rng.random_range(1.0..6.0))));
        pixels.push(Pixel::new(pixel.u + setup.noise * gauss(rng), pixel.v + setup.noise * gauss(rng)));
    }
    let observations = match setup.scheme {
        Scheme::Points => Correspondences::Points { pixels },
        Scheme::Lines => Correspondences::Lines {
            lines: pixels
                .iter()
                .map(|p| PixelLine::through(*p, rng.random_range(0.0..std::f64::consts::PI)))
                .collect(),
        },
        Scheme::Dcl => {
            let pencils = Pencils::paper(640, 480);
            let of = |p: &Pixel| (pencils.anchor_of(*p), pencils.angle_of(pencils.anchor_of(*p), *p));
            Correspondences::Anchored { lines: pixels.iter().map(of).collect(), pencils: pencils.clone() }
        }
    };
    let keypoints = (0..points.len()).collect();
    PoseProblem::new(CAMERA, observations, keypoints, points)
}
