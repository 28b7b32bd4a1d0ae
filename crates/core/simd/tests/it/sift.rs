//! Kernels of SIFT compared with simple double-precision versions, on every backend, and bit for bit between backends.

use std::f64::consts::{PI, TAU};

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_simd::Backend;
use veiloc_simd::sift::{
    BINS, BlurredImage, DESCRIPTOR, Doubling, HalfKernel, LANES, MAX_RADIUS, PATCH_RADIUS, PatchMemory,
    Patches, blur_along, blur_down, differences, double_row, peaks,
};

/// Rows of noise, `[height, length]`.
fn noise(rng: &mut ChaCha8Rng, height: usize, length: usize) -> Vec<Vec<f32>> {
    (0..height).map(|_| (0..length).map(|_| rng.random_range(0.0..1.0)).collect()).collect()
}

fn slices(rows: &[Vec<f32>]) -> Vec<&[f32]> {
    rows.iter().map(Vec::as_slice).collect()
}

/// The same bits on every backend; returns the result.
fn on_every_backend<T: PartialEq + std::fmt::Debug>(work: impl Fn(Backend) -> T) -> T {
    let expected = work(Backend::PORTABLE);
    for backend in Backend::available() {
        assert!(work(backend) == expected, "{} differs from the portable version", backend.name());
    }
    expected
}

fn bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

#[test]
fn blurred_rows_agree_with_a_naive_sum() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for radius in 1..=MAX_RADIUS {
        let weights: Vec<f32> = (0..=radius).map(|_| rng.random_range(0.0..0.2)).collect();
        let kernel = HalfKernel::new(&weights);
        assert_eq!(kernel.radius(), radius);
        for (width, count) in [(1, 1), (16, 3), (29, 8), (80, 2)] {
            let length = usize::next_multiple_of(width, LANES);
            let rows = noise(&mut rng, 2 * radius + count, length);
            let found = on_every_backend(|backend| {
                let mut down = Vec::new();
                blur_down(backend, &kernel, &slices(&rows), length, width, &mut down);
                let mut out = vec![vec![0.0; length]; count];
                for (out, padded) in out.iter_mut().zip(down.chunks_exact(length + 2 * radius)) {
                    blur_along(backend, &kernel, padded, out);
                }
                out.iter().map(|row| bits(row)).collect::<Vec<_>>()
            });
            let weight = |k: isize| f64::from(weights[k.unsigned_abs()]);
            let reach = radius as isize;
            for (y, row) in found.iter().enumerate() {
                for x in 0..width {
                    let mut expected = 0.0;
                    for (dy, row) in (-reach..=reach).zip(&rows[y..]) {
                        for dx in -reach..=reach {
                            let column = (x as isize + dx).clamp(0, width as isize - 1) as usize;
                            expected += weight(dy) * weight(dx) * f64::from(row[column]);
                        }
                    }
                    let found = f64::from(f32::from_bits(row[x]));
                    assert!(
                        (found - expected).abs() < 1e-5 * (1.0 + expected),
                        "{radius} {width} {x}: {found}"
                    );
                }
            }
        }
    }
}

#[test]
fn doubled_rows_agree_with_a_naive_sum() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for (taps, width) in [(3, 5), (7, 16), (7, 37), (9, 64)] {
        let [down, even, odd]: [Vec<f32>; 3] =
            std::array::from_fn(|_| (0..taps).map(|_| rng.random_range(0.0..0.3)).collect());
        let length = usize::next_multiple_of(width, LANES);
        let rows = noise(&mut rng, taps, length);
        let found = on_every_backend(|backend| {
            let mut out = vec![0.0; 2 * length];
            let kernels = Doubling { down: &down, even: &even, odd: &odd };
            double_row(backend, kernels, &slices(&rows), width, &mut Vec::new(), &mut out);
            bits(&out)
        });
        for x in 0..2 * width {
            let mut expected = 0.0;
            for (row, down) in rows.iter().zip(&down) {
                for (k, weight) in [&even, &odd][x % 2].iter().enumerate() {
                    let column = (x / 2 + k).saturating_sub(taps / 2).min(width - 1);
                    expected += f64::from(*down) * f64::from(*weight) * f64::from(row[column]);
                }
            }
            let found = f64::from(f32::from_bits(found[x]));
            assert!((found - expected).abs() < 1e-5, "{taps} {width} {x}: {found}, not {expected}");
        }
    }
}

#[test]
fn differences_are_exact() {
    let rows = noise(&mut ChaCha8Rng::seed_from_u64(3), 4, 48);
    let rows: [&[f32]; 4] = std::array::from_fn(|k| rows[k].as_slice());
    let found = on_every_backend(|backend| {
        let mut out = vec![0.0; 3 * 48];
        differences(backend, &rows, &mut out);
        bits(&out)
    });
    for (k, &found) in found.iter().enumerate() {
        let expected = rows[k / 48 + 1][k % 48] - rows[k / 48][k % 48];
        assert_eq!(f32::from_bits(found), expected);
    }
}

/// Few values, so that many neighbours are equal; some are NaN, as after an overflow.
#[test]
fn peaks_are_not_exceeded_by_neighbours() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut peaks_found = 0;
    for width in [0_usize, 1, 2, 3, 15, 16, 17, 18, 31, 33, 48, 64, 65, 66, 67, 100, 126, 200] {
        for length in [width.max(1).next_multiple_of(LANES), width.next_multiple_of(LANES) + LANES] {
            for most in [2_i32, 40] {
                let mut number = || match rng.random_range(-most..=most) {
                    0 if most > 2 => f32::NAN,
                    value => value as f32,
                };
                let rows: Vec<Vec<f32>> = (0..9).map(|_| (0..length).map(|_| number()).collect()).collect();
                let near: [[&[f32]; 3]; 3] =
                    std::array::from_fn(|level| std::array::from_fn(|row| rows[3 * level + row].as_slice()));
                let threshold = 0.4 * most as f32;
                let found = on_every_backend(|backend| {
                    let mut columns = Vec::new();
                    peaks(backend, &near, width, threshold, &mut columns);
                    columns
                });
                let expected: Vec<u32> = (1..width.saturating_sub(1))
                    .filter(|&x| {
                        let here = rows[4][x];
                        let mut others = rows.iter().flat_map(|row| &row[x - 1..=x + 1]);
                        (here > threshold && !others.clone().any(|&other| other > here))
                            || (here < -threshold && !others.any(|&other| other < here))
                    })
                    .map(|x| x as u32)
                    .collect();
                assert_eq!(found, expected, "{width} of {length}");
                peaks_found += found.len();
            }
        }
    }
    assert!(peaks_found > 20, "{peaks_found}");
}

/// An image of smooth waves, `[height, stride]`.
struct Waves {
    width: usize,
    height: usize,
    stride: usize,
    data: Vec<f32>,
}

impl Waves {
    fn new(width: usize, height: usize) -> Self {
        let stride = width.next_multiple_of(LANES);
        let value = |k: usize| {
            let (x, y) = ((k % stride) as f32, (k / stride) as f32);
            (0.31 * x + 0.07 * y).sin() * (0.11 * x - 0.23 * y).cos() + 0.3 * (0.011 * x * y).sin()
        };
        Self { width, height, stride, data: (0..stride * height).map(value).collect() }
    }

    fn view(&self) -> BlurredImage<'_> {
        BlurredImage::new(&self.data, self.stride, self.width, self.height).expect("a whole image")
    }

    /// Bilinear; `None` when one of the four samples is outside.
    fn at(&self, x: f64, y: f64) -> Option<f64> {
        let inside = |at: f64, size: usize| at >= 0.0 && at.floor() as usize + 2 <= size;
        if !(inside(x, self.width) && inside(y, self.height)) {
            return None;
        }
        let sample = |x: f64, y: f64| f64::from(self.data[y as usize * self.stride + x as usize]);
        let (left, top) = (x.floor(), y.floor());
        let row = |y: f64| sample(left, y) * (1.0 - x + left) + sample(left + 1.0, y) * (x - left);
        Some(row(top) * (1.0 - y + top) + row(top + 1.0) * (y - top))
    }

    /// Length and direction, from the first axis towards the second, of the gradient at a step of a rotated grid.
    fn gradient(&self, [x, y]: [f64; 2], [cos, sin]: [f64; 2], [a, b]: [f64; 2]) -> Option<(f64, f64)> {
        let at = |a: f64, b: f64| self.at(x + a * cos - b * sin, y + a * sin + b * cos);
        let (da, db) = (at(a + 1.0, b)? - at(a - 1.0, b)?, at(a, b + 1.0)? - at(a, b - 1.0)?);
        Some((da.hypot(db), db.atan2(da)))
    }
}

/// Directions with nine steps of 4.5 sigma over eight samples each way; smoothed six times over three bins.
fn naive_directions(image: &Waves, middle: [f64; 2], sigma: f64) -> [f64; BINS] {
    let mut bins = [0.0; BINS];
    for (i, j) in (-8..=8).flat_map(|i| (-8..=8).map(move |j| (i, j))) {
        let square = f64::from(i * i + j * j);
        let step = 4.5 * sigma / 8.0;
        let gradient = image.gradient(middle, [step, 0.0], [f64::from(i), f64::from(j)]);
        let Some((length, angle)) = gradient.filter(|_| square <= 64.0) else { continue };
        let vote = length * (-square * step * step / (2.0 * (1.5 * sigma).powi(2))).exp();
        let position = (angle + PI) / TAU * BINS as f64 - 0.5 + BINS as f64;
        let share = position - position.floor();
        bins[position as usize % BINS] += vote * (1.0 - share);
        bins[(position as usize + 1) % BINS] += vote * share;
    }
    for _ in 0..6 {
        let old = bins;
        bins = std::array::from_fn(|k| (old[(k + BINS - 1) % BINS] + old[k] + old[(k + 1) % BINS]) / 3.0);
    }
    bins
}

/// Four cells of 3 sigma along a side, five samples a cell, as RootSIFT.
fn naive_descriptor(image: &Waves, middle: [f64; 2], sigma: f64, orientation: f64) -> [u8; DESCRIPTOR] {
    let mut bins = [0.0; DESCRIPTOR];
    let step = 0.6 * sigma;
    let (sin, cos) = orientation.sin_cos();
    for (i, j) in (0..25).flat_map(|i| (0..25).map(move |j| (i, j))) {
        let steps = [f64::from(i) - 12.0, f64::from(j) - 12.0];
        let Some((length, angle)) = image.gradient(middle, [step * cos, step * sin], steps) else { continue };
        let in_cells = steps.map(|steps| steps / 5.0);
        let window = (-(in_cells[0].powi(2) + in_cells[1].powi(2)) / 8.0).exp();
        let turn = (-angle / TAU * 8.0).rem_euclid(8.0);
        for (k, bin) in bins.iter_mut().enumerate() {
            // Cells have their centres at -1.5, -0.5, 0.5 and 1.5.
            let [column, row] = [k / 8 % 4, k / 32].map(|cell| cell as f64 - 1.5);
            let near = |distance: f64| (1.0 - distance.abs()).max(0.0);
            let apart = (turn - (k % 8) as f64).abs();
            let weight = near(in_cells[0] - column) * near(in_cells[1] - row) * near(apart.min(8.0 - apart));
            *bin += length * window * weight;
        }
    }
    let limit = 0.2 * bins.iter().map(|bin| bin * bin).sum::<f64>().sqrt();
    let sum: f64 = bins.iter().map(|bin| bin.min(limit)).sum();
    bins.map(
        |bin| if sum > 0.0 { (512.0 * (bin.min(limit) / sum).sqrt()).round().min(255.0) as u8 } else { 0 },
    )
}

#[test]
fn patches_agree_with_naive_sums() {
    let image = Waves::new(90, 70);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut at_border = 0;
    for _ in 0..200 {
        let middle = [rng.random_range(1.0..88.0_f32), rng.random_range(1.0..68.0_f32)];
        let (sigma, orientation) = (rng.random_range(1.5..3.6_f32), rng.random_range(-3.2..3.2_f32));
        let (directions, bytes) = on_every_backend(|backend| {
            let (patches, mut memory) = (Patches::new(backend), PatchMemory::new());
            let directions = patches.directions(image.view(), middle, sigma, &mut memory);
            let bytes = patches.describe(image.view(), middle, sigma, orientation, &mut memory);
            // Old content of the memory does not matter.
            assert_eq!(bytes, patches.describe(image.view(), middle, sigma, orientation, &mut memory));
            (bits(&directions), bytes)
        });
        let wide = middle.map(f64::from);
        at_border += u32::from(wide[0].min(wide[1]) < 10.0);
        let expected = naive_directions(&image, wide, f64::from(sigma));
        let highest = expected.iter().copied().fold(0.0, f64::max);
        for (k, (&found, expected)) in directions.iter().zip(expected).enumerate() {
            let found = f64::from(f32::from_bits(found));
            assert!((found - expected).abs() < 1e-3 * highest, "{middle:?} {k}: {found}, not {expected}");
        }
        let expected = naive_descriptor(&image, wide, f64::from(sigma), f64::from(orientation));
        // Directions are rounded to 256 per turn; a byte of a nearly empty bin is most sensitive.
        let apart: Vec<u8> = bytes.iter().zip(&expected).map(|(a, b)| a.abs_diff(*b)).collect();
        let mean = apart.iter().map(|&d| f64::from(d)).sum::<f64>() / DESCRIPTOR as f64;
        assert!(mean < 0.3 && apart.iter().all(|&d| d <= 6), "{middle:?}: {mean}, {apart:?}");
    }
    assert!(at_border > 20, "{at_border}");
}

/// Hash of the results of each kernel: the vector code of one architecture gives the bits of the others. The numbers
/// were the same on x86-64 (portable, AVX2, AVX-512) and on aarch64 (NEON, under emulation).
#[test]
fn bits_are_those_of_other_machines() {
    let fnv = |bits: Vec<u32>| {
        let bytes = bits.into_iter().flat_map(u32::to_le_bytes);
        bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
        })
    };
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let rows = noise(&mut rng, 19, 80);
    let views = slices(&rows);
    let weights: Vec<f32> = (0..7).map(|_| rng.random_range(0.0..0.2)).collect();
    let kernel = HalfKernel::new(&weights[..6]);
    let image = Waves::new(90, 70);
    let hashes = on_every_backend(|backend| {
        let (mut down, mut along, mut doubled) = (Vec::new(), vec![0.0; 80], vec![0.0; 160]);
        blur_down(backend, &kernel, &views, 80, 77, &mut down);
        blur_along(backend, &kernel, &down[..90], &mut along);
        let kernels = Doubling { down: &weights, even: &weights, odd: &weights };
        double_row(backend, kernels, &views[..7], 77, &mut Vec::new(), &mut doubled);
        let mut subtracted = vec![0.0; 3 * 80];
        differences(backend, &[views[0], views[1], views[2], views[3]], &mut subtracted);
        let (mut columns, near) =
            (Vec::new(), [0, 3, 6].map(|level| [0, 1, 2].map(|row| views[level + row])));
        peaks(backend, &near, 77, 0.5, &mut columns);
        let (patches, mut memory) = (Patches::new(backend), PatchMemory::new());
        let mut directions = Vec::new();
        let mut descriptors = Vec::new();
        for middle in [[40.3, 30.8], [12.5, 60.0], [85.1, 4.4]] {
            directions.extend(patches.directions(image.view(), middle, 2.1, &mut memory));
            descriptors.extend(patches.describe(image.view(), middle, 2.1, 0.7, &mut memory).map(u32::from));
        }
        [
            bits(&down),
            bits(&along),
            bits(&doubled),
            bits(&subtracted),
            columns,
            bits(&directions),
            descriptors,
        ]
        .map(fnv)
    });
    assert_eq!(
        hashes,
        [
            0x9b71_b6d8_bf89_6820,
            0x9ab2_2548_a88a_86ba,
            0xf3a7_c4fc_db83_7fe9,
            0x4158_2865_d30e_4c48,
            0xd3d9_a682_4497_31bb,
            0x4576_fe17_acc6_ad51,
            0x4be3_d96b_91b5_2a12,
        ]
    );
}

#[test]
fn flat_images_have_zero_histograms() {
    let (patches, mut memory) = (Patches::new(Backend::best()), PatchMemory::new());
    let flat = vec![0.5; 32 * 32];
    let view = BlurredImage::new(&flat, 32, 32, 32).expect("a whole image");
    assert_eq!(patches.describe(view, [16.0, 16.0], 2.0, 1.0, &mut memory), [0; DESCRIPTOR]);
    assert_eq!(patches.directions(view, [16.0, 16.0], 2.0, &mut memory), [0.0; BINS]);
    for outside in [[1e5, 3.0], [4.0, -1e5], [-40.0, -40.0]] {
        assert_eq!(patches.describe(view, outside, 2.0, 1.0, &mut memory), [0; DESCRIPTOR]);
        assert_eq!(patches.directions(view, outside, 2.0, &mut memory), [0.0; BINS]);
    }
    // Outside of the image nothing is read.
    for middle in [[1e9, 3.0], [-1e20, 5.0], [f32::NAN, f32::INFINITY]] {
        patches.describe(view, middle, 2.0, 1.0, &mut memory);
        patches.directions(view, middle, f32::NAN, &mut memory);
    }
    for (stride, width, height) in [(32, 33, 4), (32, 1, 4), (32, 8, 33), (32, 8, 1)] {
        assert!(BlurredImage::new(&flat, stride, width, height).is_none());
    }
}

/// An image that gets brighter to the right of `from` and is dark to the left of it, described in its middle.
fn ramp(from: f32, orientation: f32) -> [u8; DESCRIPTOR] {
    let data: Vec<f32> = (0..96 * 96).map(|k| ((k % 96) as f32 - from).max(0.0)).collect();
    let view = BlurredImage::new(&data, 96, 96, 96).expect("a whole image");
    let memory = &mut PatchMemory::new();
    Patches::new(Backend::best()).describe(view, [48.0, 48.0], 3.0, orientation, memory)
}

/// The cell and direction of each byte, as in docs/reference/wire-format.md.
#[test]
fn byte_order_agrees_with_the_documentation() {
    for eighth in 0..8 {
        let orientation = eighth as f32 * std::f32::consts::TAU / 8.0;
        // A gradient along u has this angle to the orientation, from v towards u.
        let bytes = ramp(0.0, orientation);
        for cell in bytes.chunks_exact(8) {
            let strongest = (0..8).max_by_key(|k| cell[*k]);
            assert_eq!(strongest, Some(eighth), "{cell:?}");
        }
    }
    // Gradients more than one and a half cells to the right: the last column, and with the axes rotated by a quarter
    // turn the first row, because rows then run to the left.
    let sum = |bytes: &[u8; DESCRIPTOR], of: fn(usize) -> usize, which: usize| {
        let cells = bytes.chunks_exact(8).enumerate().filter(|(cell, _)| of(*cell) == which);
        cells.flat_map(|(_, cell)| cell).map(|byte| u32::from(*byte)).sum::<u32>()
    };
    let row: fn(usize) -> usize = |cell| cell / 4;
    let column: fn(usize) -> usize = |cell| cell % 4;
    let quarter = std::f32::consts::FRAC_PI_2;
    let (upright, turned) = (ramp(48.0 + 15.5, 0.0), ramp(48.0 + 15.5, quarter));
    assert!(sum(&upright, column, 3) > 0 && sum(&upright, column, 0) + sum(&upright, column, 1) == 0);
    assert!(sum(&turned, row, 0) > 0 && sum(&turned, row, 2) + sum(&turned, row, 3) == 0);
}

/// No sample farther away changes a byte, but some of those nearly as far do.
#[test]
fn patches_extend_to_the_reach() {
    let (sigma, middle) = (2.0_f32, [64.0_f32, 64.0]);
    let image = Waves::new(128, 128);
    let described = |radius: f32| {
        let changed = image.data.iter().enumerate().map(|(k, &sample)| {
            let far = ((k % 128) as f32 - middle[0]).hypot((k / 128) as f32 - middle[1]) > radius;
            if far { 1.0 - sample } else { sample }
        });
        let data: Vec<f32> = changed.collect();
        let view = BlurredImage::new(&data, 128, 128, 128).expect("a whole image");
        let (patches, mut memory) = (Patches::new(Backend::best()), PatchMemory::new());
        let turn = std::f32::consts::FRAC_PI_4;
        patches.describe(view, middle, sigma, turn, &mut memory)
    };
    // Between samples, two on each side count.
    assert_eq!(described(PATCH_RADIUS * sigma + 1.5), described(1000.0));
    assert_ne!(described(0.8 * PATCH_RADIUS * sigma), described(1000.0));
}
