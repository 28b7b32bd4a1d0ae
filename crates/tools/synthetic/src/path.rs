//! Camera positions: a hand-held walk around the room for the map, and views beside it as queries.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_geometry::CameraFromWorld;

use crate::bvh::Vec3;
use crate::scene::RenderedRoom;

/// Number and seed of the views.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub struct PathOptions {
    /// Map views; 40 by default.
    pub mapping: usize,
    /// Query views; 12 by default.
    pub queries: usize,
    /// Seed of hand jitter and query positions; it is combined with the scene's own seed.
    pub seed: u64,
}

impl Default for PathOptions {
    fn default() -> Self {
        Self { mapping: 40, queries: 12, seed: 0 }
    }
}

impl PathOptions {
    /// The defaults with other numbers of views.
    pub fn with_counts(mapping: usize, queries: usize) -> Self {
        Self { mapping, queries, ..Self::default() }
    }
}

/// True poses of the views.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraPath {
    /// In the order of the trajectory.
    pub mapping: Vec<CameraFromWorld>,
    /// Between and beside the mapping views, never at the same position.
    pub queries: Vec<CameraFromWorld>,
}

/// Deviation of a hand-held camera from the ideal trajectory.
struct Stray {
    /// Along the trajectory, as a share of its length.
    along: f64,
    /// Across and up, metres.
    metres: f64,
    /// Of the look-at point, metres.
    target: f64,
}

impl RenderedRoom {
    /// A trajectory around the middle of the room at chest height, looking across it, and queries near it.
    ///
    /// No camera is nearer than 0.3 m to any surface, and the nearest visible surface is at least 0.6 m away.
    pub fn camera_path(&self, options: &PathOptions) -> CameraPath {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed.rotate_left(17) ^ options.seed ^ 0x70a7);
        let calm = Stray { along: 0.2 / options.mapping.max(1) as f64, metres: 0.12, target: 0.25 };
        let bold = Stray { along: 0.8 / options.mapping.max(1) as f64, metres: 0.28, target: 0.5 };
        let mapping = (0..options.mapping)
            .map(|k| self.view(k as f64 / options.mapping as f64, &calm, &mut rng))
            .collect();
        let queries = (0..options.queries)
            .map(|k| self.view((k as f64 + 0.37) / options.queries as f64, &bold, &mut rng))
            .collect();
        CameraPath { mapping, queries }
    }

    fn view(&self, share: f64, stray: &Stray, rng: &mut ChaCha8Rng) -> CameraFromWorld {
        let mut last = None;
        for _ in 0..200 {
            let mut off = |reach: f64| rng.random_range(-reach..=reach);
            let angle = TAU * (share + off(stray.along));
            let (s, c) = angle.sin_cos();
            let from = Vector3::new(
                c * (1.95 + off(stray.metres)),
                s * (1.5 + off(stray.metres)),
                1.45 + off(stray.metres),
            );
            // Across the room, slightly beside the middle and slightly down.
            let target = Vector3::new(
                -1.3 * c - 0.5 * s + off(stray.target),
                -1.1 * s + 0.5 * c + off(stray.target),
                1.1 + off(0.6 * stray.target),
            );
            let Some(pose) = look_at(from, target, off(0.05)) else { continue };
            if self.is_free(from.into(), 0.3) && self.nearest_ahead(&pose) > 0.6 {
                return pose;
            }
            last = Some(pose);
        }
        last.unwrap_or_else(CameraFromWorld::identity)
    }

    /// Smallest depth on a coarse grid of rays of a typical camera.
    fn nearest_ahead(&self, pose: &CameraFromWorld) -> f32 {
        let single = |v: Vector3<f64>| v.map(|x| x as f32);
        let from: Vec3 = single(pose.center().coords);
        let back = pose.rotation().inverse();
        let mut nearest = f32::INFINITY;
        for k in 0..35 {
            let plane = Vector3::new(f64::from(k % 7 - 3) * 0.2, f64::from(k / 7 - 2) * 0.22, 1.0);
            let hit = self.bvh.first_hit(&self.quads, from, single(back * plane), 50.0, u32::MAX);
            nearest = nearest.min(hit.map_or(0.0, |h| h.t));
        }
        nearest
    }
}

/// The pose at `from` that looks at `target`, upright except for a `roll` in radians. `None` if it looks straight up.
fn look_at(from: Vector3<f64>, target: Vector3<f64>, roll: f64) -> Option<CameraFromWorld> {
    let forward = (target - from).try_normalize(1e-9)?;
    let right = forward.cross(&Vector3::z()).try_normalize(1e-9)?;
    let down = forward.cross(&right);
    let (s, c) = roll.sin_cos();
    let (x, y) = (right * c + down * s, down * c - right * s);
    let rotation = Matrix3::from_rows(&[x.transpose(), y.transpose(), forward.transpose()]);
    CameraFromWorld::from_matrix(rotation, -(rotation * from))
}
