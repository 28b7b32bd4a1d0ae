//! Samples of an image on a rotated and scaled grid, and the gradients between them.
//!
//! The grid is aligned with the keypoint, so the weights and cells of its samples are the same for all keypoints.
//! Samples are less than the keypoint's blur apart: nothing is lost between them.

use std::f32::consts::{FRAC_PI_2, PI};

use super::lanes::{LANES, Lanes};

/// A blurred image: `[height, stride]` samples, the first `width` of each row.
#[derive(Debug, Clone, Copy)]
pub struct BlurredImage<'a> {
    data: &'a [f32],
    stride: usize,
    width: usize,
    height: usize,
}

impl<'a> BlurredImage<'a> {
    /// `None` when there are fewer than two columns or rows, or too few samples.
    pub fn new(data: &'a [f32], stride: usize, width: usize, height: usize) -> Option<Self> {
        let whole = width >= 2 && height >= 2 && width <= stride && data.len() / stride >= height;
        (whole && i32::try_from(data.len()).is_ok()).then_some(Self { data, stride, width, height })
    }
}

/// Position of a grid: its middle, and the step along its first axis, in samples of the image.
#[derive(Debug, Clone, Copy)]
pub(super) struct Placement {
    pub(super) middle: [f32; 2],
    pub(super) axis: [f32; 2],
}

/// `SIZE` samples at steps of the grid from its middle; a multiple of [`LANES`].
pub(super) struct Samples<const SIZE: usize> {
    /// Two neighbours in a row, and the two below.
    upper: [[f32; 2]; SIZE],
    lower: [[f32; 2]; SIZE],
    /// Distance right and down from the first, in [0, 1].
    share: [[f32; SIZE]; 2],
    pub(super) value: [f32; SIZE],
    /// 1 inside the image, 0 outside.
    pub(super) inside: [f32; SIZE],
}

/// Adding it rounds to the nearest integer, which is then in the low bits.
pub(super) const ROUND: f32 = 12_582_912.0;

impl<const SIZE: usize> Samples<SIZE> {
    pub(super) const EMPTY: Self = Self {
        upper: [[0.0; 2]; SIZE],
        lower: [[0.0; 2]; SIZE],
        share: [[0.0; SIZE]; 2],
        value: [0.0; SIZE],
        inside: [0.0; SIZE],
    };

    /// Samples between pixels, bilinear; `steps[k]` along the first and the second axis, which is the first rotated by
    /// a quarter turn from the columns' axis to the rows'. True when all are inside the image.
    #[inline(always)]
    pub(super) fn take(&mut self, view: BlurredImage<'_>, at: Placement, steps: &[[f32; SIZE]; 2]) -> bool {
        let whole = at.middle.map(|m| (m - 0.5 + ROUND) - ROUND);
        let rest = [at.middle[0] - whole[0], at.middle[1] - whole[1]];
        let [x, y] = whole.map(|w| w as i32);
        let [cos, sin] = at.axis;
        let (stride, last) = (view.stride as i32, (view.data.len() - view.stride - 2) as u32);
        let (right, bottom) = (view.width as i32 - 2, view.height as i32 - 2);
        let mut outside = 0;
        for start in (0..SIZE).step_by(LANES) {
            let mut index = [0_u32; LANES];
            for i in 0..LANES {
                let k = start + i;
                let (along, across) = (steps[0][k], steps[1][k]);
                let u = rest[0] + (cos * along - sin * across);
                let v = rest[1] + (sin * along + cos * across);
                let (floor_u, floor_v) = ((u - 0.5) + ROUND, (v - 0.5) + ROUND);
                self.share[0][k] = u - (floor_u - ROUND);
                self.share[1][k] = v - (floor_v - ROUND);
                let column = x.wrapping_add((floor_u.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32));
                let row = y.wrapping_add((floor_v.to_bits() as i32).wrapping_sub(ROUND.to_bits() as i32));
                let out = u32::from(column < 0)
                    | u32::from(column > right)
                    | u32::from(row < 0)
                    | u32::from(row > bottom);
                self.inside[k] = if out == 0 { 1.0 } else { 0.0 };
                outside |= out;
                index[i] = (row.wrapping_mul(stride).wrapping_add(column) as u32).min(last);
            }
            for i in 0..LANES {
                let first = index[i] as usize;
                // SAFETY: `first` is at most `last`, from which a row and two samples more follow.
                unsafe {
                    let from = view.data.as_ptr().add(first);
                    self.upper[start + i] = from.cast::<[f32; 2]>().read();
                    self.lower[start + i] = from.add(view.stride).cast::<[f32; 2]>().read();
                }
            }
        }
        for k in 0..SIZE {
            let ([a, b], [c, d]) = (self.upper[k], self.lower[k]);
            let (upper, lower) = (a + self.share[0][k] * (b - a), c + self.share[0][k] * (d - c));
            self.value[k] = upper + self.share[1][k] * (lower - upper);
        }
        outside == 0
    }

    /// Lengths and directions, [-π, π] from the first axis towards the second, of the gradients at the `LANES` samples
    /// from `at` on, by central differences; rows of the grid are `pitch` samples. If a neighbour is outside the image,
    /// the length is 0.
    #[inline(always)]
    pub(super) fn gradients(&self, at: usize, pitch: usize, whole: bool) -> [Lanes; 2] {
        let near = |values: &[f32; SIZE]| {
            let starts = [at - 1, at + 1, at - pitch, at + pitch];
            assert!(at >= pitch && at + pitch + LANES <= SIZE);
            // SAFETY: just checked.
            starts.map(|start| unsafe { Lanes::load(values, start) })
        };
        let [left, right, above, below] = near(&self.value);
        let (dx, dy) = (right - left, below - above);
        let mut length = dx * dx + dy * dy;
        for l in &mut length.0 {
            *l = l.sqrt();
        }
        if !whole {
            let [left, right, above, below] = near(&self.inside);
            length = length * (left * right) * (above * below);
        }
        let mut angle = dx;
        for i in 0..LANES {
            angle.0[i] = atan2(dy.0[i], dx.0[i]);
        }
        [length, angle]
    }
}

/// `atan2` to 3e-5 rad without a branch, 0 for the zero vector.
///
/// Minimax polynomial of odd degree 11 on [0, 1], mirrored into the other octants.
#[inline(always)]
fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ay > ax { (ax, ay) } else { (ay, ax) };
    let high = if high > f32::MIN_POSITIVE { high } else { f32::MIN_POSITIVE };
    let a = low / high;
    let s = a * a;
    let mut angle = -0.011_721_2_f32;
    for c in [0.052_653_32, -0.116_432_87, 0.193_543_46, -0.332_623_47, 0.999_977_26] {
        angle = angle * s + c;
    }
    angle *= a;
    angle = if ay > ax { FRAC_PI_2 - angle } else { angle };
    angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn atan2_agrees_with_the_standard_library() {
        for i in 0..20_000 {
            let angle = (f64::from(i) / 10_000.0 - 1.0) * std::f64::consts::PI;
            let (y, x) = ((0.3 * angle.sin()) as f32, (0.3 * angle.cos()) as f32);
            let error = (atan2(y, x) - y.atan2(x)).abs();
            assert!(error < 3e-5, "{angle}: {error}");
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }
}
