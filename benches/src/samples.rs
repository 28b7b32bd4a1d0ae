//! Minimal samples with known poses for the solvers: random and nearly degenerate ones.
//!
//! The camera has 640 × 480 pixels and DCL's two anchors on its vertical midline. Map points are one to eight units
//! deep, rotations uniform, translations within three units.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Quaternion, UnitQuaternion, Vector2, Vector3};
use veiloc_geometry::{
    CameraFromWorld, Pencils, Pinhole, Pixel, PixelLine, PlaneLine, PlanePoint, Point3, Rigid3,
};
use veiloc_pose::solvers::HalfPlane;

/// Arrangement of the map points in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Layout {
    /// Anywhere in the image, any depth.
    General,
    /// Within a thousandth of a unit of one slanted plane.
    NearPlanar,
    /// A focal length sixteen times the usual: four degrees across.
    Narrow,
    /// All lines but the last pass within a twentieth of a pixel of one image point.
    NearConcurrent,
}

/// Directions of the lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lines {
    /// In any direction.
    Random,
    /// Through the first anchor if true, otherwise through the second.
    Anchored([bool; 6]),
    /// Through the anchor of the keypoint's side.
    AnchoredAnywhere,
}

/// Six matches of one camera; solvers of smaller samples take the first few.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    /// The camera's true pose.
    pub truth: CameraFromWorld,
    /// Unit rays towards the keypoints.
    pub bearings: [Vector3<f64>; 6],
    /// The lines through the keypoints.
    pub lines: [PlaneLine; 6],
    /// The same as half-planes about their anchors (meaningful for anchored lines only).
    pub half_planes: [HalfPlane; 6],
    /// The map points.
    pub points: [Point3<World>; 6],
    /// Down in the camera frame.
    pub down_in_camera: Vector3<f64>,
    /// Down in the world.
    pub down_in_world: Vector3<f64>,
}

/// Makes samples of one kind.
pub struct Samples {
    rng: ChaCha8Rng,
    layout: Layout,
    lines: Lines,
    camera: Pinhole,
}

impl Samples {
    /// Equal seeds make equal samples.
    pub fn new(seed: u64, layout: Layout, lines: Lines) -> Self {
        let focal = if layout == Layout::Narrow { 16.0 * 525.0 } else { 525.0 };
        let camera = Pinhole { width: 640, height: 480, focal: [focal; 2], principal: [320.0, 240.0] };
        Self { rng: ChaCha8Rng::seed_from_u64(seed), layout, lines, camera }
    }

    fn pose(&mut self) -> CameraFromWorld {
        let rotation = loop {
            let [w, x, y, z]: [f64; 4] = std::array::from_fn(|_| self.rng.random_range(-1.0..1.0));
            let q = Quaternion::new(w, x, y, z);
            if q.norm() > 0.1 && q.norm() < 1.0 {
                break UnitQuaternion::from_quaternion(q).to_rotation_matrix();
            }
        };
        Rigid3::new(rotation, Vector3::from_fn(|_, _| self.rng.random_range(-3.0..3.0)))
    }

    fn pixel(&mut self, i: usize) -> Pixel {
        let rng = &mut self.rng;
        let (mut u, v) = (rng.random_range(0.0..640.0), rng.random_range(0.0..480.0));
        if let Lines::Anchored(first) = self.lines {
            u = if first[i] { 0.5 * u } else { 320.0 + 0.5 * u };
        }
        Pixel::new(u, v)
    }

    fn depth(&mut self, at: PlanePoint) -> f64 {
        if self.layout == Layout::NearPlanar {
            return 5.0 / (1.0 + 0.3 * at.x - 0.2 * at.y) + self.rng.random_range(-1e-3..1e-3);
        }
        self.rng.random_range(1.0..8.0)
    }

    fn line(&mut self, i: usize, pixel: Pixel, crossing: Pixel) -> (PixelLine, Pixel) {
        let dcl = Pencils::paper(640, 480);
        let anchor = dcl.anchor_of(pixel);
        let origin = dcl.position(anchor).expect("at the edge of the image");
        let line = match (self.layout, self.lines) {
            (Layout::NearConcurrent, _) if i < 5 => {
                let mut off = || self.rng.random_range(-0.05..0.05);
                let near = Pixel::new(crossing.u + off(), crossing.v + off());
                PixelLine::joining(near, pixel)
            }
            (_, Lines::Random) => None,
            (_, Lines::Anchored(_) | Lines::AnchoredAnywhere) => {
                dcl.line(anchor, dcl.angle_of(anchor, pixel))
            }
        };
        let any = PixelLine::through(pixel, self.rng.random_range(0.0..std::f64::consts::PI));
        (line.unwrap_or(any), origin)
    }
}

impl Iterator for Samples {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        let truth = self.pose();
        let crossing = self.pixel(0);
        let mut half_planes = [HalfPlane { axis: Vector3::zeros(), inward: Vector3::zeros() }; 6];
        let mut points = [Point3::new(0.0, 0.0, 0.0); 6];
        let mut bearings = [Vector3::zeros(); 6];
        let lines = std::array::from_fn(|i| {
            let pixel = self.pixel(i);
            let at = self.camera.unproject(pixel);
            let depth = self.depth(at);
            points[i] = truth.inverse().transform(&Point3::from_vector(at.homogeneous() * depth));
            bearings[i] = at.bearing();
            let (line, origin) = self.line(i, pixel, crossing);
            let origin = self.camera.unproject(origin);
            half_planes[i] = HalfPlane::of_half_line(origin, Vector2::new(at.x - origin.x, at.y - origin.y));
            line.back_project(&self.camera)
        });
        let down_in_world = self.pose().rotation() * Vector3::y();
        let down_in_camera = truth.rotation() * down_in_world;
        Some(Sample { truth, bearings, lines, half_planes, points, down_in_camera, down_in_world })
    }
}

/// Five keypoints of the first anchor and, last, one of the second.
pub const FIVE_AND_ONE: Lines = Lines::Anchored([true, true, true, true, true, false]);

/// Three of each anchor, alternating.
pub const THREE_AND_THREE: Lines = Lines::Anchored([true, false, true, false, true, false]);
