//! Light on each surface: computed once, since nothing moves and there are no reflections.
//!
//! Each surface has a coarse grid of light values, read with bilinear interpolation: direct light from the lamps with
//! soft shadows, and ambient light with ambient occlusion. It does not depend on the view, so a surface looks the same
//! from every direction.

use rayon::prelude::*;

use crate::bvh::{Bvh, Quad, Vec3};
use crate::room::Lamp;

/// Distance of grid points, metres.
const SPACING: f32 = 0.11;

/// The light on one surface.
pub(crate) struct LightGrid {
    columns: usize,
    rows: usize,
    /// `[rows · columns]`, linear.
    values: Vec<f32>,
}

impl LightGrid {
    /// Light at `(a, b)` in [0, 1]².
    pub(crate) fn at(&self, a: f32, b: f32) -> f32 {
        let (x, y) =
            (a.clamp(0.0, 1.0) * (self.columns - 1) as f32, b.clamp(0.0, 1.0) * (self.rows - 1) as f32);
        let (i, j) = ((x as usize).min(self.columns - 2), (y as usize).min(self.rows - 2));
        let (fx, fy) = (x - i as f32, y - j as f32);
        let row = |j: usize| {
            let k = j * self.columns + i;
            self.values[k] * (1.0 - fx) + self.values[k + 1] * fx
        };
        row(j) * (1.0 - fy) + row(j + 1) * fy
    }
}

/// Computes the light on every surface; only surfaces in `casting` throw shadows.
pub(crate) fn bake(quads: &[Quad], casting: &[Quad], lamps: &[Lamp]) -> Vec<LightGrid> {
    let around = hemisphere();
    let bvh = Bvh::new(casting);
    quads
        .par_iter()
        .map(|quad| {
            let count = |length: f32| ((length / SPACING).ceil() as usize + 1).clamp(2, 96);
            let (columns, rows) = (count(quad.size[0]), count(quad.size[1]));
            let inset = |k: usize, n: usize| 0.02 + 0.96 * k as f32 / (n - 1) as f32;
            let values = (0..rows * columns)
                .map(|k| {
                    let at = quad.at(inset(k % columns, columns), inset(k / columns, rows));
                    light_at(at + quad.normal * 0.012, quad.normal, casting, &bvh, lamps, &around)
                })
                .collect();
            LightGrid { columns, rows, values }
        })
        .collect()
}

fn light_at(at: Vec3, normal: Vec3, quads: &[Quad], bvh: &Bvh, lamps: &[Lamp], around: &[Vec3]) -> f32 {
    let mut direct = 0.0;
    for lamp in lamps {
        for k in 0..4 {
            let (s, t) = ((k as f32 + 0.5) / 4.0, (0.5 + 0.618_034 * k as f32).fract());
            // A little below the lamp, so that the lamp does not shadow itself.
            let to = lamp.corner + lamp.edge_u * s + lamp.edge_v * t - at - Vec3::new(0.0, 0.0, 0.02);
            let square = to.norm_squared();
            let facing = normal.dot(&to) / square.sqrt();
            let leaving = to.z / square.sqrt();
            if facing > 0.0 && leaving > 0.0 && bvh.first_hit(quads, at, to, 0.999, u32::MAX).is_none() {
                direct += lamp.power * facing * leaving / square / 4.0;
            }
        }
    }
    // Two axes perpendicular to the normal.
    let side = if normal.z.abs() < 0.9 { Vec3::z() } else { Vec3::x() };
    let x = normal.cross(&side).normalize();
    let y = normal.cross(&x);
    let open: f32 = around
        .iter()
        .map(|d| {
            let ray = x * d.x + y * d.y + normal * d.z;
            bvh.first_hit(quads, at, ray, 1.6, u32::MAX).map_or(1.0, |h| (h.t / 1.6).sqrt())
        })
        .sum();
    direct + 0.5 * open / around.len() as f32
}

/// Directions on the hemisphere around `z`, with cosine-weighted density.
fn hemisphere() -> Vec<Vec3> {
    let n = 16;
    (0..n)
        .map(|k| {
            let r = ((k as f32 + 0.5) / n as f32).sqrt();
            let angle = 2.399_963 * k as f32;
            Vec3::new(r * angle.cos(), r * angle.sin(), (1.0 - r * r).sqrt())
        })
        .collect()
}
