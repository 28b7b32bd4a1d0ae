//! Rows of a separable blur.

use super::lanes::{LANES, Lanes, store_pairs};
use crate::{Backend, dispatch};

/// Maximum radius of a kernel, in samples.
pub const MAX_RADIUS: usize = 11;

/// A symmetric kernel: weights at 0, 1, 2, ... samples from its centre.
#[derive(Debug, Clone, PartialEq)]
pub struct HalfKernel {
    radius: usize,
    weights: [f32; MAX_RADIUS + 1],
}

impl HalfKernel {
    /// From the weights of the centre and of one side.
    ///
    /// # Panics
    /// Without weights, or with one farther than [`MAX_RADIUS`].
    pub fn new(weights: &[f32]) -> Self {
        let radius = weights.len().checked_sub(1).expect("a kernel has a centre");
        let mut all = [0.0; MAX_RADIUS + 1];
        all[..=radius].copy_from_slice(weights);
        Self { radius, weights: all }
    }

    /// Its radius, in samples.
    pub fn radius(&self) -> usize {
        self.radius
    }
}

/// Rows of an image blurred down its columns, `[count, length + 2 radius]`: the input of [`blur_along`], row by row.
///
/// `rows` are the rows from `radius` above the first to `radius` below the last, each at least `length` long, a
/// multiple of [`LANES`]. The first `width` samples are the image. A row of the result is `length + 2 radius` long: the
/// image's border samples are repeated to its left and right.
///
/// # Panics
/// When lengths do not match.
// Not inlined, so that profiles and counters show it.
#[inline(never)]
pub fn blur_down(
    backend: Backend,
    kernel: &HalfKernel,
    rows: &[&[f32]],
    length: usize,
    width: usize,
    out: &mut Vec<f32>,
) {
    let radius = kernel.radius;
    check(rows, 2 * radius + 1, width, length);
    let count = rows.len() - 2 * radius;
    out.resize(count * (length + 2 * radius), 0.0);
    dispatch::run(backend, Down { kernel, rows, length, out });
    for row in out.chunks_exact_mut(length + 2 * radius) {
        continue_ends(row, radius, width);
    }
}

/// Written out for each radius of an octave, so that weights stay in registers.
macro_rules! written_out {
    ($blur:ident) => {
        match $blur.kernel.radius {
            4 => $blur.of_radius(4),
            5 => $blur.of_radius(5),
            6 => $blur.of_radius(6),
            8 => $blur.of_radius(8),
            10 => $blur.of_radius(10),
            radius => $blur.of_radius(radius),
        }
    };
}

struct Down<'a> {
    kernel: &'a HalfKernel,
    rows: &'a [&'a [f32]],
    length: usize,
    out: &'a mut [f32],
}

impl dispatch::Kernel for Down<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        written_out!(self);
    }
}

impl Down<'_> {
    /// `radius` is the kernel's, passed so that it may be a constant.
    #[inline(always)]
    fn of_radius(self, radius: usize) {
        let Self { kernel, rows, length, out } = self;
        let weights = &kernel.weights[..=radius];
        let pitch = length + 2 * radius;
        // All rows of a few columns, whose samples are then still in cache for the next row.
        for at in (0..length).step_by(LANES) {
            for (y, rows) in rows.windows(2 * radius + 1).enumerate() {
                // SAFETY: every row of `rows` has `length` samples, a multiple of `LANES`, and `out` has as many rows
                // of `pitch` as there are windows.
                unsafe {
                    let mut sum = Lanes::all(weights[0]) * Lanes::load(rows[radius], at);
                    for k in 1..=radius {
                        let pair = Lanes::load(rows[radius - k], at) + Lanes::load(rows[radius + k], at);
                        sum = sum + Lanes::all(weights[k]) * pair;
                    }
                    sum.store(out, y * pitch + radius + at);
                }
            }
        }
    }
}

/// A row blurred along itself: `padded` is longer than `out` by the kernel's radius on each side, and the length of
/// `out` is a multiple of [`LANES`]. Output to the right of the image is finite and undefined.
///
/// # Panics
/// When lengths do not match.
// Not inlined, so that profiles and counters show it.
#[inline(never)]
pub fn blur_along(backend: Backend, kernel: &HalfKernel, padded: &[f32], out: &mut [f32]) {
    assert!(out.len().is_multiple_of(LANES) && padded.len() == out.len() + 2 * kernel.radius);
    dispatch::run(backend, Along { kernel, padded, out });
}

struct Along<'a> {
    kernel: &'a HalfKernel,
    padded: &'a [f32],
    out: &'a mut [f32],
}

impl dispatch::Kernel for Along<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        written_out!(self);
    }
}

impl Along<'_> {
    /// `radius` is the kernel's, passed so that it may be a constant.
    #[inline(always)]
    fn of_radius(self, radius: usize) {
        let Self { kernel, padded, out } = self;
        let weights = &kernel.weights[..=radius];
        for at in (0..out.len()).step_by(LANES) {
            // SAFETY: `out` is a multiple of `LANES` long, and `padded` longer by twice the radius.
            unsafe {
                let mut sum = Lanes::all(weights[0]) * Lanes::load(padded, at + radius);
                for k in 1..=radius {
                    let pair = Lanes::load(padded, at + radius - k) + Lanes::load(padded, at + radius + k);
                    sum = sum + Lanes::all(weights[k]) * pair;
                }
                sum.store(out, at);
            }
        }
    }
}

/// Asymmetric kernels of one length: down the columns, and along the rows for the even and odd samples of a row of
/// twice the width.
#[derive(Debug, Clone, Copy)]
pub struct Doubling<'a> {
    /// Down the columns.
    pub down: &'a [f32],
    /// Along the rows, for the even samples.
    pub even: &'a [f32],
    /// Along the rows, for the odd samples.
    pub odd: &'a [f32],
}

/// One row of an image of twice the width. Sample `k` of a kernel of `2 r + 1` is the weight of the sample at `k - r`.
///
/// `rows` are the `2 r + 1` rows around it from top to bottom, each at least half as long as `out`, and that half is a
/// multiple of [`LANES`]; the first `width` samples are the image, and its border samples are repeated. `scratch` is
/// memory that calls may share. Output from `2 width` on is finite and undefined.
///
/// # Panics
/// When lengths do not match.
// Not inlined, so that profiles and counters show it.
#[inline(never)]
pub fn double_row(
    backend: Backend,
    kernels: Doubling<'_>,
    rows: &[&[f32]],
    width: usize,
    scratch: &mut Vec<f32>,
    out: &mut [f32],
) {
    let taps = kernels.down.len();
    assert!(out.len().is_multiple_of(2) && kernels.even.len() == taps && kernels.odd.len() == taps);
    check(rows, taps, width, out.len() / 2);
    assert!(rows.len() == taps, "{} rows for {taps} weights", rows.len());
    scratch.resize(out.len() / 2 + taps - 1, 0.0);
    dispatch::run(backend, Double { kernels, rows, width, scratch, out });
}

struct Double<'a> {
    kernels: Doubling<'a>,
    rows: &'a [&'a [f32]],
    width: usize,
    scratch: &'a mut [f32],
    out: &'a mut [f32],
}

impl dispatch::Kernel for Double<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        match self.kernels.down.len() {
            7 => doubling_blur(7, self),
            taps => doubling_blur(taps, self),
        }
    }
}

#[inline(always)]
fn doubling_blur(taps: usize, task: Double<'_>) {
    let Double { kernels, rows, width, scratch, out } = task;
    let [down, even, odd] = [kernels.down, kernels.even, kernels.odd].map(|kernel| &kernel[..taps]);
    let rows = &rows[..taps];
    let half = out.len() / 2;
    let radius = taps / 2;
    for at in (0..half).step_by(LANES) {
        // SAFETY: every row has `half` samples, a multiple of `LANES`; `scratch` has `taps - 1` more.
        unsafe {
            let mut sum = Lanes::all(0.0);
            for k in 0..taps {
                sum = sum + Lanes::all(down[k]) * Lanes::load(rows[k], at);
            }
            sum.store(scratch, radius + at);
        }
    }
    continue_ends(scratch, radius, width);
    for at in (0..half).step_by(LANES) {
        let (mut left, mut right) = (Lanes::all(0.0), Lanes::all(0.0));
        for k in 0..taps {
            // SAFETY: as above.
            let near = unsafe { Lanes::load(scratch, at + k) };
            left = left + Lanes::all(even[k]) * near;
            right = right + Lanes::all(odd[k]) * near;
        }
        // SAFETY: `out` has twice `half` samples.
        unsafe { store_pairs(left, right, out, 2 * at) };
    }
}

/// Repeats the border samples of the `width` samples from `radius` on to both ends.
fn continue_ends(padded: &mut [f32], radius: usize, width: usize) {
    let (first, last) = (padded[radius], padded[radius + width - 1]);
    padded[..radius].fill(first);
    padded[radius + width..].fill(last);
}

fn check(rows: &[&[f32]], count: usize, width: usize, length: usize) {
    assert!(rows.len() >= count && count % 2 == 1, "{} rows for {count} weights", rows.len());
    assert!(length.is_multiple_of(LANES) && (1..=length).contains(&width), "{width} of {length} samples");
    assert!(rows.iter().all(|row| row.len() >= length), "a row is shorter than {length}");
}
