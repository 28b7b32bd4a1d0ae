//! Hashed lattice noise: random numbers as a function of position, the same for every thread and every view.

/// Mixes a seed and two lattice coordinates into 32 random bits.
pub(crate) fn hash(seed: u32, x: i32, y: i32) -> u32 {
    let mut h = seed ^ (x as u32).wrapping_mul(0x8da6_b343) ^ (y as u32).wrapping_mul(0xd816_3841);
    h = (h ^ (h >> 16)).wrapping_mul(0x7feb_352d);
    h = (h ^ (h >> 15)).wrapping_mul(0x846c_a68b);
    h ^ (h >> 16)
}

/// The `k`-th further number in [0, 1) derived from a hash.
pub(crate) fn unit(h: u32, k: u32) -> f32 {
    let mut x = h.wrapping_add(k.wrapping_mul(0x9e37_79b9));
    x = (x ^ (x >> 16)).wrapping_mul(0x21f0_aaad);
    x = (x ^ (x >> 15)).wrapping_mul(0x735a_2d97);
    ((x ^ (x >> 15)) >> 8) as f32 / 16_777_216.0
}

/// Remaining contrast of a detail of this wavelength if one sample averages over `footprint` metres, 0 to 1.
pub(crate) fn fade(wavelength: f32, footprint: f32) -> f32 {
    ((wavelength / footprint.max(1e-6) - 1.5) / 1.5).clamp(0.0, 1.0)
}

/// Smooth noise in [-1, 1] with one random value per unit square.
pub(crate) fn value(seed: u32, u: f32, v: f32) -> f32 {
    let (x, y) = (u.floor(), v.floor());
    let (fx, fy) = (u - x, v - y);
    let (sx, sy) = (fx * fx * (3.0 - 2.0 * fx), fy * fy * (3.0 - 2.0 * fy));
    let (x, y) = (x as i32, y as i32);
    let at = |dx, dy| (hash(seed, x + dx, y + dy) >> 8) as f32 / 8_388_608.0 - 1.0;
    let top = at(0, 0) + (at(1, 0) - at(0, 0)) * sx;
    let bottom = at(0, 1) + (at(1, 1) - at(0, 1)) * sx;
    top + (bottom - top) * sy
}

/// Sum of octaves of [`value`], the first with the given wavelength in metres, each next one with half of it; about
/// [-1, 1]. Octaves too fine for the footprint are left out.
pub(crate) fn octaves(
    seed: u32,
    u: f32,
    v: f32,
    wavelength: f32,
    count: u32,
    gain: f32,
    footprint: f32,
) -> f32 {
    let (mut sum, mut total, mut amplitude, mut length) = (0.0, 0.0, 1.0, wavelength);
    for octave in 0..count {
        let contrast = fade(length, footprint);
        total += amplitude;
        if contrast > 0.0 {
            // Rotated from octave to octave, so that the lattices do not align.
            let (c, s) = [(1.0, 0.0), (0.8, 0.6), (0.28, 0.96), (-0.352, 0.936)][(octave % 4) as usize];
            let (a, b) = ((c * u - s * v) / length, (s * u + c * v) / length);
            sum += contrast * amplitude * value(seed.wrapping_add(octave * 0x1234_5677), a, b);
        }
        amplitude *= gain;
        length *= 0.5;
    }
    sum / total
}

/// A random flat shape (disc, bar or triangle) in a square cell of this size, if the cell has one.
#[derive(Clone, Copy)]
pub(crate) struct Splat {
    /// Coverage of the sample, 0 to 1.
    pub(crate) coverage: f32,
    /// Random bits of the shape, for its colour.
    pub(crate) bits: u32,
}

/// Returns the shape at a position, if shapes lie in cells of `cell` metres and a share `density` of the cells contains
/// one.
pub(crate) fn splat(seed: u32, u: f32, v: f32, cell: f32, density: f32, footprint: f32) -> Option<Splat> {
    let contrast = fade(cell * 0.7, footprint);
    if contrast <= 0.0 {
        return None;
    }
    // Each layer has its own rotated grid, so that rows of shapes are not visible.
    let (s, c) = (unit(seed, 1) * std::f32::consts::TAU).sin_cos();
    let (a, b) = ((c * u - s * v) / cell, (s * u + c * v) / cell);
    let (x, y) = (a.floor(), b.floor());
    let bits = hash(seed, x as i32, y as i32);
    if unit(bits, 0) > density {
        return None;
    }
    let radius = 0.12 + 0.36 * unit(bits, 1);
    let room = 1.0 - 2.0 * radius;
    let (px, py) = (a - x - radius - room * unit(bits, 2), b - y - radius - room * unit(bits, 3));
    let (ts, tc) = (unit(bits, 4) * std::f32::consts::TAU).sin_cos();
    let (qx, qy) = (tc * px - ts * py, ts * px + tc * py);
    let distance = match bits % 3 {
        0 => qx.hypot(qy) - radius,
        1 => (qx.abs() - radius * 0.9).max(qy.abs() - radius * (0.15 + 0.25 * unit(bits, 5))),
        _ => (qx.abs() * 0.866 + qy * 0.5).max(-qy) - radius * 0.5,
    };
    let coverage = (0.5 - distance * cell / footprint.max(1e-6)).clamp(0.0, 1.0) * contrast;
    (coverage > 0.0).then_some(Splat { coverage, bits })
}
