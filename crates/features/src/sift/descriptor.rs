//! The SIFT histogram of gradients around a keypoint, as RootSIFT bytes.
//!
//! Layout and direction of the bins are Lowe's, so bytes compare with those of COLMAP and OpenCV:
//! `[4 rows, 4 columns, 8 directions]`, rows and columns along the keypoint's own axes, directions counted from the
//! keypoint's orientation and against the turn from the `u` to the `v` axis.

use std::f32::consts::TAU;

use super::gradient::GradientRow;
use super::orientation::inner_range;
use super::plane::Plane;

/// Bytes of one descriptor.
pub(super) const DIM: usize = CELLS * CELLS * DIRECTIONS;
/// Cells along one side.
const CELLS: usize = 4;
/// Directions per cell.
const DIRECTIONS: usize = 8;
/// Side of a cell, in sigmas of the keypoint.
const CELL_SIDE: f32 = 3.0;
/// The weight of a gradient falls off with this sigma, in cells.
const WINDOW: f32 = 2.0;
/// No bin holds more than this share of the length of the whole vector.
const CLIP: f32 = 0.2;

/// Cells with a margin on each side, which catches votes of gradients just outside.
const PADDED: usize = CELLS + 2;
/// Directions with one behind, which is the first again.
const TURN: usize = DIRECTIONS + 1;

/// Histogram of the gradients around (`x`, `y`), unit length, clipped, as RootSIFT bytes.
///
/// `x`, `y` and `sigma` are in samples of `plane`, `orientation` in radians. All zero where there is no gradient.
pub(super) fn describe(
    plane: &Plane,
    [x, y]: [f32; 2],
    sigma: f32,
    orientation: f32,
    gradients: &mut GradientRow,
) -> [u8; DIM] {
    root_sift(&histogram(plane, [x, y], sigma, orientation, gradients))
}

fn histogram(
    plane: &Plane,
    [x, y]: [f32; 2],
    sigma: f32,
    orientation: f32,
    gradients: &mut GradientRow,
) -> [f32; DIM] {
    let side = CELL_SIDE * sigma;
    let reach = std::f32::consts::SQRT_2 * side * (CELLS as f32 + 1.0) / 2.0;
    let (left, right) = inner_range(x, reach, plane.width);
    let (top, bottom) = inner_range(y, reach, plane.height);
    let mut bins = [0.0f32; PADDED * PADDED * TURN];
    if left < right {
        let (sin, cos) = f64::from(orientation).sin_cos();
        let (sin, cos) = (sin as f32 / side, cos as f32 / side);
        // Round, so the weight is a product of one factor for the column and one for the row.
        let weight = |distance: f32| (-(distance / side).powi(2) / (2.0 * WINDOW * WINDOW)).exp();
        let column_weights: Vec<f32> = (left..right).map(|column| weight(column as f32 - x)).collect();
        for row in top..bottom {
            let dy = row as f32 - y;
            let row_weight = weight(dy);
            let (first, last) = columns_inside(x, dy, [cos, sin], left, right);
            if first >= last {
                continue;
            }
            gradients.compute(plane, row, first, last);
            for i in 0..last - first {
                let column = first + i;
                let dx = column as f32 - x;
                // Cell coordinates: the centre of cell `k` is at `k + 1`, margin included.
                let across = cos * dx + sin * dy + f32::midpoint(CELLS as f32, 1.0);
                let down = cos * dy - sin * dx + f32::midpoint(CELLS as f32, 1.0);
                let inside = across >= 0.0 && across < CELLS as f32 + 1.0;
                if !(inside && down >= 0.0 && down < CELLS as f32 + 1.0) {
                    continue;
                }
                let vote = row_weight * column_weights[column - left] * gradients.magnitude[i];
                let turn =
                    (orientation - gradients.angle[i]) * (DIRECTIONS as f32 / TAU) + 2.0 * DIRECTIONS as f32;
                add(&mut bins, vote, across, down, turn);
            }
        }
    }
    collect(&bins)
}

/// Columns of `left..right` that may lie under the turned square in the row `dy` below the keypoint.
fn columns_inside(x: f32, dy: f32, [cos, sin]: [f32; 2], left: usize, right: usize) -> (usize, usize) {
    let half = f32::midpoint(CELLS as f32, 1.0);
    let (mut low, mut high) = (left as f32 - x, right as f32 - 1.0 - x);
    // |slope * dx + start| <= half along both axes of the square
    for (slope, start) in [(cos, sin * dy), (-sin, cos * dy)] {
        if slope.abs() > 1e-6 {
            let (a, b) = ((-half - start) / slope, (half - start) / slope);
            low = low.max(a.min(b));
            high = high.min(a.max(b));
        } else if start.abs() > half {
            return (left, left);
        }
    }
    let first = (low + x).ceil().max(left as f32) as usize;
    let last = (high + x).floor().min(right as f32 - 1.0);
    if last < first as f32 { (first, first) } else { (first, last as usize + 1) }
}

/// Shares a vote among the eight nearest bins. `across` and `down` in [0, CELLS + 1), `turn` at least 0.
#[inline]
fn add(bins: &mut [f32; PADDED * PADDED * TURN], vote: f32, across: f32, down: f32, turn: f32) {
    let (column, row, direction) = (across as usize, down as usize, turn as usize);
    let (fx, fy, ft) = (across - column as f32, down - row as f32, turn - direction as f32);
    let direction = direction % DIRECTIONS;
    let lower = vote * fy;
    let upper = vote - lower;
    for (row, vote) in [(row, upper), (row + 1, lower)] {
        let right = vote * fx;
        for (column, vote) in [(column, vote - right), (column + 1, right)] {
            let at = (row * PADDED + column) * TURN + direction;
            let next = vote * ft;
            bins[at] += vote - next;
            bins[at + 1] += next;
        }
    }
}

/// The bins without their margin, `[CELLS, CELLS, DIRECTIONS]`.
fn collect(bins: &[f32; PADDED * PADDED * TURN]) -> [f32; DIM] {
    let mut histogram = [0.0; DIM];
    for (i, cell) in histogram.chunks_exact_mut(DIRECTIONS).enumerate() {
        let from = ((i / CELLS + 1) * PADDED + i % CELLS + 1) * TURN;
        cell.copy_from_slice(&bins[from..from + DIRECTIONS]);
        cell[0] += bins[from + DIRECTIONS];
    }
    histogram
}

/// Unit length, clipped (against single strong edges), then the square root of each bin's share of the sum, times
/// 512, rounded, cut at 255: the code that COLMAP stores too.
fn root_sift(histogram: &[f32; DIM]) -> [u8; DIM] {
    let length = histogram.iter().map(|v| v * v).sum::<f32>().sqrt();
    let limit = CLIP * length;
    let sum: f32 = histogram.iter().map(|v| v.min(limit)).sum();
    if sum <= 0.0 {
        return [0; DIM];
    }
    histogram.map(|v| (512.0 * (v.min(limit) / sum).sqrt()).round().min(255.0) as u8)
}
