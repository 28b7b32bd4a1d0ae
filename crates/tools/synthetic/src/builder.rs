//! Adds surfaces to the scene: rectangles, boxes and columns.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::bvh::{Quad, Vec3};
use crate::material::{Material, Pattern};

/// An upright box that cameras must avoid: lower and upper corner.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Obstacle {
    pub(crate) low: Vec3,
    pub(crate) high: Vec3,
}

/// A scene under construction.
pub(crate) struct Builder {
    pub(crate) quads: Vec<Quad>,
    pub(crate) materials: Vec<Material>,
    /// The surfaces that throw shadows; flat things on walls and floors do not.
    pub(crate) casts: Vec<bool>,
    pub(crate) flat: bool,
    pub(crate) obstacles: Vec<Obstacle>,
    pub(crate) rng: ChaCha8Rng,
}

/// Local frame on the floor plan for building furniture: `x` along its front, `y` to its back.
#[derive(Clone, Copy)]
pub(crate) struct LocalFrame {
    origin: Vec3,
    x: Vec3,
    y: Vec3,
}

impl LocalFrame {
    /// A frame at `(x, y, z)`, its `x` axis rotated by `yaw` radians from the room's.
    pub(crate) fn new(x: f32, y: f32, z: f32, yaw: f32) -> Self {
        let (s, c) = yaw.sin_cos();
        Self { origin: Vec3::new(x, y, z), x: Vec3::new(c, s, 0.0), y: Vec3::new(-s, c, 0.0) }
    }

    /// A frame given in the axes of this one.
    pub(crate) fn moved(&self, x: f32, y: f32, z: f32, turn: f32) -> Self {
        let (s, c) = turn.sin_cos();
        Self { origin: self.at(x, y, z), x: self.x * c + self.y * s, y: self.y * c - self.x * s }
    }

    pub(crate) fn at(&self, x: f32, y: f32, z: f32) -> Vec3 {
        self.origin + self.x * x + self.y * y + Vec3::new(0.0, 0.0, z)
    }

    pub(crate) const fn across(&self) -> Vec3 {
        self.x
    }

    pub(crate) const fn back(&self) -> Vec3 {
        self.y
    }
}

impl Builder {
    pub(crate) const fn new(rng: ChaCha8Rng) -> Self {
        Self {
            quads: Vec::new(),
            materials: Vec::new(),
            casts: Vec::new(),
            flat: false,
            obstacles: Vec::new(),
            rng,
        }
    }

    /// Builds things that lie flat on others and throw no shadow.
    pub(crate) fn flat(&mut self, build: impl FnOnce(&mut Self)) {
        self.flat = true;
        build(self);
        self.flat = false;
    }

    /// A rectangle, visible from the side of `edge_u × edge_v`.
    pub(crate) fn quad(&mut self, origin: Vec3, edge_u: Vec3, edge_v: Vec3, pattern: &Pattern) {
        self.quads.push(Quad::new(origin, edge_u, edge_v));
        self.casts.push(!self.flat);
        let seed = self.rng.random();
        self.materials.push(Material { pattern: pattern.clone(), seed });
    }

    /// A box with its front lower left corner at the frame's origin, `size` along the frame's axes.
    pub(crate) fn block(&mut self, frame: &LocalFrame, size: [f32; 3], pattern: &Pattern) {
        self.faces(frame, size, [pattern; 6]);
    }

    /// The same with patterns for front, back, left, right, top and bottom.
    pub(crate) fn faces(&mut self, frame: &LocalFrame, [w, d, h]: [f32; 3], patterns: [&Pattern; 6]) {
        let (x, y, z) = (frame.across() * w, frame.back() * d, Vec3::new(0.0, 0.0, h));
        let o = frame.at(0.0, 0.0, 0.0);
        let [front, back, left, right, top, bottom] = patterns;
        self.quad(o, x, z, front);
        self.quad(o + x + y, -x, z, back);
        self.quad(o + y, -y, z, left);
        self.quad(o + x, y, z, right);
        self.quad(o + z, x, y, top);
        self.quad(o, y, x, bottom);
        let corners = [o, o + x, o + y, o + x + y, o + z, o + x + y + z, o + x + z, o + y + z];
        let low = corners.iter().fold(corners[0], |m, c| m.inf(c));
        let high = corners.iter().fold(corners[0], |m, c| m.sup(c));
        self.obstacles.push(Obstacle { low, high });
    }

    /// An upright column with eight sides around the frame's origin.
    pub(crate) fn column(
        &mut self,
        frame: &LocalFrame,
        radius: f32,
        height: f32,
        pattern: &Pattern,
        top: &Pattern,
    ) {
        let corner = |k: u32| {
            let angle = std::f32::consts::FRAC_PI_4 * k as f32;
            frame.at(radius * angle.cos(), radius * angle.sin(), 0.0)
        };
        let up = Vec3::new(0.0, 0.0, height);
        for k in 0..8 {
            self.quad(corner(k), corner(k + 1) - corner(k), up, pattern);
        }
        // Two rectangles form the lid; the small triangles between them are narrower than the rim.
        for turn in [0.0, std::f32::consts::FRAC_PI_4] {
            let lid = frame.moved(0.0, 0.0, height, turn);
            let half = radius * 0.707;
            self.quad(lid.at(-half, -half, 0.0), lid.across() * 2.0 * half, lid.back() * 2.0 * half, top);
        }
        let c = frame.at(0.0, 0.0, 0.0);
        let reach = Vec3::new(radius, radius, 0.0);
        self.obstacles.push(Obstacle { low: c - reach, high: c + reach + up });
    }
}
