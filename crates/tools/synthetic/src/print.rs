//! Prints in the scene: posters, paintings, screens, sheets of paper, labels. No two are equal.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::colour::{Colour, colour};
use crate::noise::octaves;
use crate::painter::{Painter, Raster};

/// Kinds of printed things.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PrintKind {
    Poster,
    Landscape,
    Screen,
    Paper,
    Label,
}

/// Texels per metre.
const DENSITY: f32 = 420.0;

/// Draws a print of this kind and size in metres.
pub(crate) fn print(kind: PrintKind, size: [f32; 2], seed: u64) -> Raster {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let texels = |metres: f32| ((metres * DENSITY) as usize).clamp(24, 640);
    let ground = match kind {
        PrintKind::Paper => colour(0.86, 0.85, 0.8),
        PrintKind::Screen => colour(0.05, 0.07, 0.1),
        PrintKind::Label => colour(0.85, 0.8, 0.7),
        PrintKind::Poster | PrintKind::Landscape => any_colour(&mut rng, 0.25..0.95),
    };
    let mut painter = Painter::new(texels(size[0]), texels(size[1]), ground);
    match kind {
        PrintKind::Poster => poster(&mut painter, &mut rng),
        PrintKind::Landscape => landscape(&mut painter, &mut rng),
        PrintKind::Screen => screen(&mut painter, &mut rng),
        PrintKind::Paper => paper(&mut painter, &mut rng),
        PrintKind::Label => label(&mut painter, &mut rng),
    }
    if kind != PrintKind::Screen {
        let seed = rng.random();
        painter.each(|x, y, c| c * (1.0 + 0.12 * octaves(seed, x / DENSITY, y / DENSITY, 0.15, 5, 0.7, 0.0)));
    }
    painter.finish()
}

/// A saturated colour whose largest channel is in the range.
pub(crate) fn any_colour(rng: &mut ChaCha8Rng, light: std::ops::Range<f32>) -> Colour {
    let top = rng.random_range(light);
    // Typical indoor colours: many reds, oranges and yellows, some blues and greens, little violet.
    let hue =
        [0.0, 0.3, 0.6, 1.0, 1.9, 3.2, 3.7, 4.0][rng.random_range(0..8)] + rng.random_range(-0.2..0.2f32);
    let hue = (hue + 6.0) % 6.0;
    let grey = rng.random_range(0.08..0.85f32);
    let channel = |shift: f32| {
        let h = (hue + shift) % 6.0;
        let on = ((h - 3.0).abs() - 1.0).clamp(0.0, 1.0);
        top * (grey + (1.0 - grey) * on)
    };
    colour(channel(0.0), channel(4.0), channel(2.0))
}

fn anywhere(painter: &Painter, rng: &mut ChaCha8Rng) -> [f32; 2] {
    let (w, h) = painter.size();
    [rng.random_range(0.0..w), rng.random_range(0.0..h)]
}

fn shapes(painter: &mut Painter, rng: &mut ChaCha8Rng, count: usize, smallest: f32, largest: f32) {
    for _ in 0..count {
        let at = anywhere(painter, rng);
        // Many small ones, few large ones.
        let size = smallest * (largest / smallest).powf(rng.random_range(0.0..1.0f32).powf(1.7));
        let c = any_colour(rng, 0.05..1.0);
        match rng.random_range(0..5) {
            0 => painter.disc(at, size * 0.6, c),
            1 => painter.ring(at, size * 0.6, size * 0.2, c),
            2 => painter.bar(at, [size, size * rng.random_range(0.1..0.5)], rng.random_range(0.0..3.2), c),
            _ => painter.polygon(at, size, c, rng),
        }
    }
}

fn frame(painter: &mut Painter, width: f32, c: Colour) {
    let (w, h) = painter.size();
    for (center, half) in [
        ([w / 2.0, 0.0], [w, width]),
        ([w / 2.0, h], [w, width]),
        ([0.0, h / 2.0], [width, h]),
        ([w, h / 2.0], [width, h]),
    ] {
        painter.bar(center, half, 0.0, c);
    }
}

fn poster(painter: &mut Painter, rng: &mut ChaCha8Rng) {
    let (w, h) = painter.size();
    let small = w.min(h);
    shapes(painter, rng, 10, small * 0.12, small * 0.45);
    shapes(painter, rng, 34, 3.0, small * 0.12);
    for _ in 0..rng.random_range(1..4) {
        let letter = rng.random_range(8.0..(small * 0.16).max(9.0));
        let corner = [rng.random_range(0.04..0.3) * w, rng.random_range(0.02..0.8) * h];
        let lines = rng.random_range(1..4);
        let ink = any_colour(rng, 0.02..1.0);
        painter.text(corner, w * rng.random_range(0.4..0.75), lines, letter, ink, rng);
    }
    let edge = any_colour(rng, 0.03..0.9);
    frame(painter, rng.random_range(3.0..9.0), edge);
}

fn landscape(painter: &mut Painter, rng: &mut ChaCha8Rng) {
    let (_, h) = painter.size();
    let sky = any_colour(rng, 0.6..0.95);
    let (cloud, seed) = (colour(0.95, 0.93, 0.9), rng.random());
    painter.each(|x, y, _| {
        let mix = (0.5 + 1.6 * octaves(seed, x / DENSITY, y / DENSITY, 0.25, 6, 0.65, 0.0)).clamp(0.0, 1.0);
        sky * (1.0 - mix) * (0.5 + 0.5 * y / h) + cloud * mix
    });
    for layer in 0..4 {
        let base = h * (0.35 + 0.17 * layer as f32);
        let (rock, light) = (any_colour(rng, 0.1..0.6), any_colour(rng, 0.3..0.95));
        let (ridge, grain): (u32, u32) = (rng.random(), rng.random());
        painter.each(|x, y, c| {
            let top = base + 0.22 * h * octaves(ridge, x / DENSITY, 0.5, 0.35, 6, 0.55, 0.0);
            let inside = (y - top).clamp(0.0, 1.0);
            let tone = 0.5 + octaves(grain, x / DENSITY, y / DENSITY, 0.06, 4, 0.8, 0.0);
            c * (1.0 - inside) + (rock * (1.0 - tone) + light * tone) * inside
        });
    }
    let wood = any_colour(rng, 0.1..0.4);
    frame(painter, 10.0, wood);
}

fn screen(painter: &mut Painter, rng: &mut ChaCha8Rng) {
    let (w, h) = painter.size();
    painter.bar([w / 2.0, 4.0], [w, 5.0], 0.0, colour(0.3, 0.35, 0.45));
    let mut y = 14.0;
    while y < h - 10.0 {
        let indent = w * [0.04, 0.09, 0.14, 0.2][rng.random_range(0..4)];
        let ink = any_colour(rng, 0.5..1.0);
        let long = w * rng.random_range(0.15..0.55);
        painter.text([indent, y], long, 1, 6.0, ink, rng);
        y += 11.0;
    }
    for _ in 0..14 {
        let at = [w * rng.random_range(0.66..0.96), h * rng.random_range(0.15..0.95)];
        let c = any_colour(rng, 0.4..1.0);
        painter.bar(at, [w * 0.02, h * rng.random_range(0.02..0.2)], 0.0, c);
    }
    frame(painter, 5.0, colour(0.02, 0.02, 0.02));
}

fn paper(painter: &mut Painter, rng: &mut ChaCha8Rng) {
    let (w, h) = painter.size();
    let ink = any_colour(rng, 0.03..0.3);
    painter.text([w * 0.1, h * 0.06], w * 0.6, 1, (h * 0.08).max(6.0), ink, rng);
    painter.text([w * 0.1, h * 0.2], w * 0.8, (h * 0.4 / 8.0) as usize, 5.0, ink, rng);
    for _ in 0..9 {
        let at = [w * rng.random_range(0.15..0.85), h * rng.random_range(0.65..0.95)];
        let c = any_colour(rng, 0.1..0.8);
        painter.polygon(at, w * rng.random_range(0.03..0.16), c, rng);
    }
}

fn label(painter: &mut Painter, rng: &mut ChaCha8Rng) {
    let (w, h) = painter.size();
    shapes(painter, rng, 4, 4.0, w.min(h) * 0.3);
    painter.text([w * 0.08, h * 0.1], w * 0.84, 2, (h * 0.16).max(5.0), colour(0.05, 0.05, 0.05), rng);
    let mut x = w * 0.1;
    while x < w * 0.7 {
        let thick = rng.random_range(0.6..2.4);
        painter.bar([x, h * 0.8], [thick, h * 0.12], 0.0, colour(0.03, 0.03, 0.03));
        x += thick * 2.0 + rng.random_range(1.0..4.0);
    }
    let edge = any_colour(rng, 0.1..0.9);
    frame(painter, 2.0, edge);
}
