//! Sets of 2D–3D matches with ground truth, for tests and benches of solvers and estimators.

use nalgebra::{Rotation3, Vector3};
use rand::Rng;
use veiloc_geometry::frames::{Camera, World};
use veiloc_geometry::{CameraFromWorld, Pinhole, Pixel, PlanePoint, Point3};

/// Options of the generated matches.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct PointProblemOptions {
    /// Number of matches; 200 by default.
    pub matches: usize,
    /// Outlier ratio, 0 to 1; 0 by default. An outlier keeps its pixel and gets another point.
    pub outlier_ratio: f64,
    /// Standard deviation of the pixels, each coordinate; 0 by default.
    pub noise_px: f64,
    /// The camera; 640 x 480 with a focal length of 525 px by default.
    pub camera: Pinhole,
    /// Smallest and largest depth, map units; 2 to 6 by default.
    pub depth: [f64; 2],
    /// If set, all points lie within this distance of one slanted plane through the middle of the depths.
    pub plane_thickness: Option<f64>,
}

impl Default for PointProblemOptions {
    fn default() -> Self {
        let camera = Pinhole { width: 640, height: 480, focal: [525.0, 525.0], principal: [320.0, 240.0] };
        Self {
            matches: 200,
            outlier_ratio: 0.0,
            noise_px: 0.0,
            camera,
            depth: [2.0, 6.0],
            plane_thickness: None,
        }
    }
}

impl PointProblemOptions {
    /// Options for this many exact matches.
    pub fn exact(matches: usize) -> Self {
        Self { matches, ..Self::default() }
    }

    /// Sets the noise in pixels.
    pub fn noise(mut self, px: f64) -> Self {
        self.noise_px = px;
        self
    }

    /// Sets the outlier ratio.
    pub fn outliers(mut self, share: f64) -> Self {
        self.outlier_ratio = share;
        self
    }

    /// Sets the camera.
    pub fn camera(mut self, camera: Pinhole) -> Self {
        self.camera = camera;
        self
    }

    /// Sets the depths.
    pub fn depth(mut self, nearest: f64, farthest: f64) -> Self {
        self.depth = [nearest, farthest];
        self
    }

    /// Sets the distance to one plane.
    pub fn near_planar(mut self, thickness: f64) -> Self {
        self.plane_thickness = Some(thickness);
        self
    }
}

/// Matches and their ground truth; element `i` of each list belongs together.
#[derive(Debug, Clone, PartialEq)]
pub struct PointProblem {
    /// The camera.
    pub camera: Pinhole,
    /// Its true pose.
    pub cam_from_world: CameraFromWorld,
    /// Observed pixels, noise included.
    pub pixels: Vec<Pixel>,
    /// The matched map points.
    pub points: Vec<Point3<World>>,
    /// Which matches are correct.
    pub inliers: Vec<bool>,
}

impl PointProblem {
    /// Draws a random pose, and matches all over the image.
    pub fn generate(options: &PointProblemOptions, rng: &mut impl Rng) -> Self {
        let cam_from_world = random_pose(rng);
        let world_from_cam = cam_from_world.inverse();
        let camera = options.camera;
        let slant = [rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5)];
        let mut pixels = Vec::with_capacity(options.matches);
        let mut points = Vec::with_capacity(options.matches);
        for _ in 0..options.matches {
            let exact = Pixel::new(
                rng.random_range(0.0..f64::from(camera.width.max(1))),
                rng.random_range(0.0..f64::from(camera.height.max(1))),
            );
            let in_camera = at_depth(options, slant, &camera.unproject(exact), rng);
            points.push(world_from_cam.transform(&in_camera));
            pixels.push(Pixel::new(
                exact.u + options.noise_px * normal(rng),
                exact.v + options.noise_px * normal(rng),
            ));
        }
        let wrong = (options.outlier_ratio.clamp(0.0, 1.0) * options.matches as f64).round() as usize;
        let chosen = rand::seq::index::sample(rng, options.matches, wrong);
        let mut inliers = vec![true; options.matches];
        for i in chosen {
            let other_point = camera.unproject(Pixel::new(
                rng.random_range(0.0..f64::from(camera.width.max(1))),
                rng.random_range(0.0..f64::from(camera.height.max(1))),
            ));
            // Another point of the same scene: in a near-planar scene it is near the plane as well.
            points[i] = world_from_cam.transform(&at_depth(options, slant, &other_point, rng));
            inliers[i] = false;
        }
        Self { camera, cam_from_world, pixels, points, inliers }
    }
}

/// A point of the scene along a ray, camera frame; `slant` has the slopes of a near-planar scene's plane.
fn at_depth(
    options: &PointProblemOptions,
    slant: [f64; 2],
    ray: &PlanePoint,
    rng: &mut impl Rng,
) -> Point3<Camera> {
    let [near, far] = options.depth;
    let z = match options.plane_thickness {
        None => rng.random_range(near..=far.max(near)),
        // The plane z = middle + slant · (x, y), along this ray, and an offset within the thickness.
        Some(thickness) => {
            let z = f64::midpoint(near, far) / (1.0 - slant[0] * ray.x - slant[1] * ray.y).max(0.2);
            z + rng.random_range(-thickness.abs()..=thickness.abs())
        }
    };
    Point3::new(ray.x * z, ray.y * z, z)
}

/// A pose with a uniformly distributed rotation, and a centre within a few map units of the origin.
pub fn random_pose(rng: &mut impl Rng) -> CameraFromWorld {
    // Four normal numbers are uniformly distributed on the unit quaternions after normalization.
    let q = [normal(rng), normal(rng), normal(rng), normal(rng)];
    let t = [0; 3].map(|_| rng.random_range(-3.0..3.0));
    CameraFromWorld::from_quaternion(q, t)
        .unwrap_or_else(|| CameraFromWorld::new(Rotation3::identity(), Vector3::from(t)))
}

/// Draws from the standard normal distribution.
pub fn normal(rng: &mut impl Rng) -> f64 {
    normal_pair(rng)[0]
}

/// Draws two independent standard normal numbers (Box and Muller). Implemented here because rendered scenes and
/// published figures depend on the exact numbers per seed.
pub fn normal_pair(rng: &mut impl Rng) -> [f64; 2] {
    let (u, v): (f64, f64) = (rng.random(), rng.random());
    let radius = (-2.0 * (1.0 - u).ln()).sqrt();
    let (sin, cos) = (std::f64::consts::TAU * v).sin_cos();
    [radius * cos, radius * sin]
}
