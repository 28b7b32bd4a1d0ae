//! Gradients of a blurred picture, one stretch of a row at a time.

use std::f32::consts::{FRAC_PI_2, PI};

use super::plane::{LANES, Plane};

/// Lengths and directions of the gradients along a stretch of one row.
#[derive(Debug, Default)]
pub(super) struct GradientRow {
    /// Length, samples per step of the octave.
    pub(super) magnitude: Vec<f32>,
    /// Direction from the column axis towards the row axis, [-π, π].
    pub(super) angle: Vec<f32>,
}

impl GradientRow {
    /// Gradients by central differences in columns `first..last` of row `y`, none of which is on the border.
    pub(super) fn compute(&mut self, plane: &Plane, y: usize, first: usize, last: usize) {
        let count = last - first;
        let room = count.next_multiple_of(LANES);
        self.magnitude.resize(room, 0.0);
        self.angle.resize(room, 0.0);
        let (above, below) = (&plane.row(y - 1)[first..last], &plane.row(y + 1)[first..last]);
        let row = plane.row(y);
        let (left, right) = (&row[first - 1..last - 1], &row[(first + 1)..=last]);
        let mut dx = [0.0f32; LANES];
        let mut dy = [0.0f32; LANES];
        let outputs = self.magnitude.chunks_exact_mut(LANES).zip(self.angle.chunks_exact_mut(LANES));
        for (chunk, (magnitude, angle)) in outputs.enumerate() {
            let range = chunk * LANES..((chunk + 1) * LANES).min(count);
            for ((dx, right), left) in dx.iter_mut().zip(&right[range.clone()]).zip(&left[range.clone()]) {
                *dx = 0.5 * (right - left);
            }
            for ((dy, below), above) in dy.iter_mut().zip(&below[range.clone()]).zip(&above[range]) {
                *dy = 0.5 * (below - above);
            }
            for i in 0..LANES {
                magnitude[i] = (dx[i] * dx[i] + dy[i] * dy[i]).sqrt();
                angle[i] = atan2(dy[i], dx[i]);
            }
        }
    }
}

/// `atan2` to 2e-6 rad without a branch, the same on every machine.
///
/// Minimax polynomial of odd degree 15 on [0, 1], mirrored into the other octants.
#[inline]
fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = (ax.min(ay), ax.max(ay));
    let a = low / high.max(f32::MIN_POSITIVE);
    let s = a * a;
    let mut angle = -0.004_054_058_f32;
    for c in
        [0.021_861_23, -0.055_909_886, 0.096_420_04, -0.139_085_34, 0.199_465_4, -0.333_298_55, 0.999_999_34]
    {
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
            assert!(error < 3e-6, "{angle}: {error}");
        }
        assert_eq!(atan2(0.0, 0.0), 0.0);
    }
}
