//! Images in the scene (posters, screens, paper): drawn once, stored as an image pyramid, sampled with a filter.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

use crate::colour::Colour;

/// An image with square texels and its image pyramid.
pub(crate) struct Raster {
    levels: Vec<Level>,
}

struct Level {
    width: usize,
    height: usize,
    texels: Vec<Colour>,
}

impl Level {
    fn at(&self, x: isize, y: isize) -> Colour {
        let x = x.clamp(0, self.width as isize - 1) as usize;
        let y = y.clamp(0, self.height as isize - 1) as usize;
        self.texels[y * self.width + x]
    }

    fn bilinear(&self, a: f32, b: f32) -> Colour {
        let (x, y) = (a * self.width as f32 - 0.5, b * self.height as f32 - 0.5);
        let (fx, fy) = (x - x.floor(), y - y.floor());
        let (x, y) = (x.floor() as isize, y.floor() as isize);
        let row = |y| self.at(x, y) * (1.0 - fx) + self.at(x + 1, y) * fx;
        row(y) * (1.0 - fy) + row(y + 1) * fy
    }
}

impl Raster {
    fn new(width: usize, height: usize, texels: Vec<Colour>) -> Self {
        let mut levels = vec![Level { width, height, texels }];
        while let Some(last) = levels.last().filter(|l| l.width.min(l.height) > 2) {
            let (w, h) = (last.width / 2, last.height / 2);
            let mut texels = Vec::with_capacity(w * h);
            for y in 0..h as isize {
                for x in 0..w as isize {
                    let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| last.at(2 * x + i, 2 * y + j));
                    texels.push(four.into_iter().fold(Colour::zeros(), |s, c| s + c) * 0.25);
                }
            }
            levels.push(Level { width: w, height: h, texels });
        }
        Self { levels }
    }

    /// Colour at `(a, b)` in [0, 1]², if the sample is `footprint` level-0 texels wide.
    pub(crate) fn sample(&self, a: f32, b: f32, footprint: f32) -> Colour {
        let texels = footprint * self.levels[0].width as f32;
        let level = texels.max(1.0).log2().min((self.levels.len() - 1) as f32);
        let (fine, blend) = (level.floor() as usize, level.fract());
        let near = self.levels[fine].bilinear(a, b);
        match self.levels.get(fine + 1) {
            Some(coarse) if blend > 0.0 => near * (1.0 - blend) + coarse.bilinear(a, b) * blend,
            _ => near,
        }
    }
}

/// A canvas: positions in texels, drawing with soft edges one texel wide.
pub(crate) struct Painter {
    width: usize,
    height: usize,
    texels: Vec<Colour>,
}

impl Painter {
    pub(crate) fn new(width: usize, height: usize, ground: Colour) -> Self {
        Self { width, height, texels: vec![ground; width * height] }
    }

    pub(crate) const fn size(&self) -> (f32, f32) {
        (self.width as f32, self.height as f32)
    }

    pub(crate) fn finish(self) -> Raster {
        Raster::new(self.width, self.height, self.texels)
    }

    /// Recolours every texel.
    pub(crate) fn each(&mut self, mut recolour: impl FnMut(f32, f32, Colour) -> Colour) {
        for y in 0..self.height {
            for x in 0..self.width {
                let texel = &mut self.texels[y * self.width + x];
                *texel = recolour(x as f32 + 0.5, y as f32 + 0.5, *texel);
            }
        }
    }

    /// Paints where a signed distance, in texels, is negative; evaluated in the square around `center`.
    fn fill(&mut self, center: [f32; 2], reach: f32, colour: Colour, distance: impl Fn(f32, f32) -> f32) {
        let span = |c: f32, n: usize| {
            ((c - reach - 1.0).max(0.0) as usize).min(n)..((c + reach + 2.0).max(0.0) as usize).min(n)
        };
        for y in span(center[1], self.height) {
            for x in span(center[0], self.width) {
                let cover = (0.5 - distance(x as f32 + 0.5, y as f32 + 0.5)).clamp(0.0, 1.0);
                let texel = &mut self.texels[y * self.width + x];
                *texel = *texel * (1.0 - cover) + colour * cover;
            }
        }
    }

    pub(crate) fn disc(&mut self, center: [f32; 2], radius: f32, colour: Colour) {
        self.fill(center, radius, colour, |x, y| (x - center[0]).hypot(y - center[1]) - radius);
    }

    pub(crate) fn ring(&mut self, center: [f32; 2], radius: f32, pen: f32, colour: Colour) {
        self.fill(center, radius + pen, colour, |x, y| {
            ((x - center[0]).hypot(y - center[1]) - radius).abs() - pen * 0.5
        });
    }

    pub(crate) fn bar(&mut self, center: [f32; 2], half: [f32; 2], angle: f32, colour: Colour) {
        let (s, c) = angle.sin_cos();
        self.fill(center, half[0].hypot(half[1]), colour, |x, y| {
            let (dx, dy) = (x - center[0], y - center[1]);
            ((c * dx + s * dy).abs() - half[0]).max((c * dy - s * dx).abs() - half[1])
        });
    }

    /// A convex polygon with corners around `center`.
    pub(crate) fn polygon(&mut self, center: [f32; 2], radius: f32, colour: Colour, rng: &mut ChaCha8Rng) {
        let sides = rng.random_range(3..8);
        let turn = rng.random_range(0.0..std::f32::consts::TAU);
        let edges: Vec<(f32, f32, f32)> = (0..sides)
            .map(|k| {
                let angle =
                    turn + std::f32::consts::TAU * (k as f32 + rng.random_range(-0.3..0.3)) / sides as f32;
                (angle.cos(), angle.sin(), radius * rng.random_range(0.35..0.7))
            })
            .collect();
        self.fill(center, radius * 1.4, colour, |x, y| {
            let (dx, dy) = (x - center[0], y - center[1]);
            edges.iter().map(|(nx, ny, d)| nx * dx + ny * dy - d).fold(f32::NEG_INFINITY, f32::max)
        });
    }

    /// Lines of illegible letters: each letter is a few strokes. `corner` is the upper left one.
    pub(crate) fn text(
        &mut self,
        corner: [f32; 2],
        width: f32,
        lines: usize,
        letter: f32,
        colour: Colour,
        rng: &mut ChaCha8Rng,
    ) {
        for line in 0..lines {
            let y = corner[1] + (line as f32 + 0.5) * letter * 1.7;
            let mut x = corner[0];
            let end = corner[0] + width * if line + 1 == lines { rng.random_range(0.3..1.0) } else { 1.0 };
            while x + letter * 0.7 < end {
                if rng.random_bool(0.16) {
                    x += letter * 0.6;
                    continue;
                }
                self.letter([x + letter * 0.3, y], letter, colour, rng);
                x += letter * rng.random_range(0.72..0.95);
            }
        }
    }

    fn letter(&mut self, center: [f32; 2], size: f32, colour: Colour, rng: &mut ChaCha8Rng) {
        let pen = (size * 0.09).max(0.45);
        let (w, h) = (size * 0.26, size * 0.5);
        for _ in 0..rng.random_range(2..5) {
            let [x, y] = center;
            match rng.random_range(0..6) {
                0 => self.bar([x - w, y], [pen, h], 0.0, colour),
                1 => self.bar([x + w, y], [pen, h], 0.0, colour),
                2 => self.bar([x, y + h * [-1.0, 0.0, 1.0][rng.random_range(0..3)]], [w, pen], 0.0, colour),
                3 => self.bar([x, y], [h * 0.9, pen], rng.random_range(0.9..2.2), colour),
                4 => self.ring([x, y + h * 0.45], w, pen * 2.0, colour),
                _ => self.ring([x, y - h * 0.45], w, pen * 2.0, colour),
            }
        }
    }
}
