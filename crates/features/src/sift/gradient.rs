//! Gradients of a blurred image, one stretch of a row at a time.

use std::f32::consts::{FRAC_PI_2, PI};

use super::plane::Plane;

/// Gradients are computed this many at a time: shorter than a row of the blur, as keypoints are small.
pub(super) const LANES: usize = 8;

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
        let outputs = self.magnitude.as_chunks_mut().0.iter_mut().zip(self.angle.as_chunks_mut().0);
        for (chunk, (magnitude, angle)) in outputs.enumerate() {
            let at = y * plane.stride + first + chunk * LANES;
            let starts = [at - 1, at + 1, at - plane.stride, at + plane.stride];
            let near = starts.map(|start| plane.data.get(start..).and_then(|rest| rest.first_chunk()));
            if let [Some(left), Some(right), Some(above), Some(below)] = near {
                polar(left, right, above, below, magnitude, angle);
            } else {
                let [left, right, above, below] = starts.map(|start| last_lanes(&plane.data, start));
                polar(&left, &right, &above, &below, magnitude, angle);
            }
        }
    }
}

/// The samples from `at` on; those behind the end are 0, and belong to no column that was asked for.
#[cold]
fn last_lanes(samples: &[f32], at: usize) -> [f32; LANES] {
    std::array::from_fn(|i| samples.get(at + i).copied().unwrap_or(0.0))
}

/// Lengths and directions of `LANES` gradients. Kept free of branches and checks, so that it becomes vector code.
fn polar(
    left: &[f32; LANES],
    right: &[f32; LANES],
    above: &[f32; LANES],
    below: &[f32; LANES],
    magnitude: &mut [f32; LANES],
    angle: &mut [f32; LANES],
) {
    let (mut dx, mut dy) = ([0.0; LANES], [0.0; LANES]);
    for i in 0..LANES {
        dx[i] = 0.5 * (right[i] - left[i]);
        dy[i] = 0.5 * (below[i] - above[i]);
    }
    for i in 0..LANES {
        magnitude[i] = (dx[i] * dx[i] + dy[i] * dy[i]).sqrt();
    }
    for i in 0..LANES {
        angle[i] = atan2(dy[i], dx[i]);
    }
}

/// `atan2` to 3e-5 rad without a branch, the same on every machine.
///
/// Minimax polynomial of odd degree 11 on [0, 1], mirrored into the other octants.
#[inline]
fn atan2(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = (ax.min(ay), ax.max(ay));
    let a = low / high.max(f32::MIN_POSITIVE);
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
