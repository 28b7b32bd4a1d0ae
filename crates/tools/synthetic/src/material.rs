//! Appearance of surfaces: reflectance as a function of the position on the surface in metres, at any level of detail.

use std::sync::Arc;

use crate::colour::{Colour, colour};
use crate::noise::{fade, hash, octaves, splat, unit};
use crate::painter::Raster;

/// The kinds of surface. Lengths in metres.
#[derive(Clone)]
pub(crate) enum Pattern {
    /// Painted wall with stains, scratches and specks.
    Plaster(Colour),
    /// Wall paper: random shapes of three sizes.
    Wallpaper(Colour, Colour),
    /// Bricks, each with its own tint.
    Brick(Colour),
    /// Wooden boards along `u`, with grain and knots.
    Planks(Colour, f32),
    /// Square tiles of this width, each with its own tint and marbling.
    Tiles(Colour, f32),
    /// A rug: nested shapes.
    Rug([Colour; 4]),
    /// Cloth: weave, folds, and dots.
    Cloth(Colour),
    /// The back of a book: bands and letters.
    Spine(Colour, Colour),
    /// Cardboard with wear.
    Cardboard(Colour),
    /// Scratched metal or plastic.
    Shell(Colour),
    /// A drawn image.
    Print(Arc<Raster>),
    /// A lamp: it emits light and is not lit.
    Lamp(Colour),
}

/// A pattern on one surface, with its own seed, so that no two surfaces are equal.
#[derive(Clone)]
pub(crate) struct Material {
    pub(crate) pattern: Pattern,
    pub(crate) seed: u32,
}

impl Material {
    /// Reflectance at `(u, v)` metres on a surface of this size, averaged over about `footprint` metres.
    pub(crate) fn reflectance(&self, u: f32, v: f32, size: [f32; 2], footprint: f32) -> Colour {
        let seed = self.seed;
        let noise = |k: u32, wavelength: f32, count: u32, gain: f32| {
            octaves(seed.wrapping_add(k), u, v, wavelength, count, gain, footprint)
        };
        let layer = |c: Colour, k: u32, cell: f32, density: f32, strength: f32| match splat(
            seed.wrapping_mul(31).wrapping_add(k),
            u,
            v,
            cell,
            density,
            footprint,
        ) {
            Some(s) => {
                let tint = 1.0 + strength * (2.0 * unit(s.bits, 9) - 1.0);
                c * (1.0 - s.coverage) + c * tint * s.coverage
            }
            None => c,
        };
        match &self.pattern {
            Pattern::Plaster(base) => {
                let mut c = base * (1.0 + 0.55 * noise(1, 0.9, 8, 0.78));
                c = layer(c, 2, 0.34, 0.45, 0.5);
                c = layer(c, 3, 0.13, 0.5, 0.6);
                layer(c, 4, 0.05, 0.45, 0.7)
            }
            Pattern::Wallpaper(base, ink) => {
                let mut c = base * (1.0 + 0.25 * noise(1, 0.7, 7, 0.75));
                for (k, cell, density) in [(2, 0.42, 0.7), (3, 0.17, 0.6), (4, 0.07, 0.5)] {
                    if let Some(s) = splat(seed.wrapping_add(k * 77), u, v, cell, density, footprint) {
                        let mix = 0.3 + 0.7 * unit(s.bits, 8);
                        c = c * (1.0 - s.coverage) + (ink * mix + base * (1.0 - mix) * 0.8) * s.coverage;
                    }
                }
                c
            }
            Pattern::Brick(base) => {
                let (h, w, gap) = (0.085, 0.24, 0.006);
                let row = (v / h).floor();
                let shift = unit(hash(seed, row as i32, 7), 0) * w;
                let column = ((u + shift) / w).floor();
                let (du, dv) = (u + shift - column * w, v - row * h);
                let bits = hash(seed, column as i32, row as i32);
                let edge = du.min(w - du).min(dv).min(h - dv);
                let inside = blend((edge - gap) / footprint) * fade(0.1, footprint);
                let tint = 0.45 + 0.9 * unit(bits, 1);
                let warm = colour(1.0, 0.85 + 0.3 * unit(bits, 2), 0.8 + 0.4 * unit(bits, 3));
                let brick = base.component_mul(&warm) * tint;
                let flat = 1.0 - fade(0.1, footprint);
                let c = colour(0.5, 0.47, 0.43) * (1.0 - inside - flat) + brick * inside + base * 0.9 * flat;
                layer(c * (1.0 + 0.6 * noise(1, 0.25, 7, 0.8)), 5, 0.06, 0.4, 0.6)
            }
            Pattern::Planks(base, width) => {
                let row = (v / width).floor();
                let long = 0.5 + 0.9 * unit(hash(seed, row as i32, 3), 0);
                let column = (u / long + unit(hash(seed, row as i32, 4), 0)).floor();
                let bits = hash(seed, column as i32, row as i32);
                let dv = v - row * width;
                let edge = dv.min(width - dv);
                let groove = 1.0 - 0.6 * (1.0 - blend((edge - 0.002) / footprint)) * fade(0.05, footprint);
                let tint = 0.55 + 0.75 * unit(bits, 1);
                let grain = octaves(bits, u * 0.14, v, 0.05, 5, 0.75, footprint);
                let knots = octaves(bits ^ 5, u, v, 0.16, 4, 0.75, footprint);
                let c = base * (tint * groove * (1.0 + 0.38 * grain + 0.5 * knots));
                layer(layer(c, 6, 0.12, 0.4, 0.5), 7, 0.045, 0.4, 0.6)
            }
            Pattern::Tiles(base, width) => {
                let (column, row) = ((u / width).floor(), (v / width).floor());
                let bits = hash(seed, column as i32, row as i32);
                let (du, dv) = (u - column * width, v - row * width);
                let edge = du.min(width - du).min(dv).min(width - dv);
                let inside = blend((edge - 0.004) / footprint);
                let tone = 0.5 + 0.8 * unit(bits, 1);
                let veins = octaves(bits, u, v, width * 0.9, 7, 0.75, footprint);
                let tile =
                    base.component_mul(&colour(1.0, 0.8 + 0.3 * unit(bits, 2), 0.7 + 0.5 * unit(bits, 3)));
                let c = tile * (tone * (1.0 + 0.8 * veins)) * inside + colour(0.3, 0.3, 0.3) * (1.0 - inside);
                layer(c, 8, width * 0.4, 0.4, 0.6)
            }
            Pattern::Rug(palette) => {
                let mut c = palette[0] * (1.0 + 0.3 * noise(1, 0.3, 6, 0.8));
                for (k, cell, density) in [(2, 0.55, 0.9), (3, 0.26, 0.8), (4, 0.12, 0.7), (5, 0.05, 0.6)] {
                    if let Some(s) = splat(seed.wrapping_add(k * 101), u, v, cell, density, footprint) {
                        let ink = palette[(s.bits >> 9) as usize % 4] * (0.6 + 0.7 * unit(s.bits, 8));
                        c = c * (1.0 - s.coverage) + ink * s.coverage;
                    }
                }
                let border = u.min(size[0] - u).min(v.min(size[1] - v));
                let rim = 1.0 - blend((border - 0.06) / footprint);
                c * (1.0 - rim) + palette[3] * (0.5 + 0.4 * noise(9, 0.05, 3, 0.7)) * rim
            }
            Pattern::Cloth(base) => {
                let folds = noise(1, 0.45, 3, 0.6);
                let weave = noise(2, 0.05, 4, 0.9);
                let c = base * (1.0 + 0.45 * folds + 0.35 * weave);
                layer(layer(c, 3, 0.15, 0.6, 0.7), 4, 0.06, 0.6, 0.7)
            }
            Pattern::Spine(base, ink) => self.spine(u, v, size, footprint, *base, *ink),
            Pattern::Cardboard(base) => {
                let c = base * (1.0 + 0.4 * noise(1, 0.3, 7, 0.8));
                layer(layer(c, 2, 0.14, 0.4, 0.6), 3, 0.05, 0.5, 0.6)
            }
            Pattern::Shell(base) => {
                let c = base * (1.0 + 0.4 * noise(1, 0.2, 6, 0.8));
                layer(c, 2, 0.06, 0.35, 0.6)
            }
            Pattern::Print(raster) => raster.sample(u / size[0], 1.0 - v / size[1], footprint / size[0]),
            Pattern::Lamp(glow) => *glow,
        }
    }

    fn spine(&self, u: f32, v: f32, size: [f32; 2], footprint: f32, base: Colour, ink: Colour) -> Colour {
        let seed = self.seed;
        let wear = octaves(seed, u, v, 0.12, 6, 0.8, footprint);
        let mut c = base * (1.0 + 0.4 * wear);
        // Bands across, letters along the back.
        for k in 0..3 {
            let at = size[1] * unit(seed, 10 + k);
            let half = 0.002 + 0.012 * unit(seed, 20 + k);
            let cover = blend((half - (v - at).abs()) / footprint) * fade(half * 3.0, footprint);
            c = c * (1.0 - cover) + ink * (0.5 + 0.5 * unit(seed, 30 + k)) * cover;
        }
        let letter = size[0].min(0.03) * 0.75;
        let row = (v / letter).floor();
        let (x, y) = ((u - size[0] / 2.0) / letter + 0.5, v / letter - row);
        let bits = hash(seed ^ 0x55, row as i32, 1);
        let written = (0.15..0.85).contains(&(v / size[1])) && unit(bits, 0) < 0.8;
        if written && (0.05..0.95).contains(&x) && (0.1..0.9).contains(&y) {
            let cell = ((x * 4.0) as u32) + 4 * ((y * 4.0) as u32);
            if (bits >> cell) & 1 == 1 {
                c = c * 0.2
                    + ink * 0.8 * fade(letter * 0.5, footprint)
                    + c * 0.8 * (1.0 - fade(letter * 0.5, footprint));
            }
        }
        c
    }
}

/// A soft step from 0 to 1 around zero, one unit wide.
fn blend(x: f32) -> f32 {
    (x + 0.5).clamp(0.0, 1.0)
}
