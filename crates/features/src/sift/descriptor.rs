//! The SIFT histogram of gradients around a keypoint, as RootSIFT bytes.
//!
//! Layout and direction of the bins are Lowe's, so bytes compare with those of COLMAP and OpenCV:
//! `[4 rows, 4 columns, 8 directions]`, rows and columns along the keypoint's own axes, directions counted from the
//! keypoint's orientation and against the turn from the `u` to the `v` axis.

use std::f32::consts::TAU;

use super::gradient::{GradientRow, LANES};
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
/// How far from the keypoint gradients count, whatever its orientation, in sigmas: to the corner of the square of cells
/// and of half a cell around them.
pub(super) const REACH: f32 = std::f32::consts::SQRT_2 * CELL_SIDE * (CELLS as f32 + 1.0) / 2.0;
/// No bin holds more than this share of the length of the whole vector.
const CLIP: f32 = 0.2;

/// Every second row is counted: gradients of an image blurred by at least 1.6 samples are that smooth. Half the time,
/// and no difference beyond the noise (docs/features.md).
const ROW_STEP: usize = 2;

/// Cells with a margin on each side, which catches votes of gradients just outside.
const PADDED: usize = CELLS + 2;
/// Directions with one behind, which is the first again.
const TURN: usize = DIRECTIONS + 1;
/// All bins, `[PADDED rows, PADDED columns, TURN]`.
const BINS: usize = PADDED * PADDED * TURN;
/// From the first to the last of the eight bins that share a vote.
const SPAN: usize = PADDED * TURN + TURN + 2;

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
    let reach = REACH * sigma;
    let (left, right) = inner_range(x, reach, plane.width);
    let (top, bottom) = inner_range(y, reach, plane.height);
    let mut bins = [0.0f32; BINS];
    if left < right {
        let (sin, cos) = f64::from(orientation).sin_cos();
        let axes = [cos as f32 / side, sin as f32 / side];
        // Round, so the weight is a product of one factor for the column and one for the row.
        let weight = |distance: f32| (-(distance / side).powi(2) / (2.0 * WINDOW * WINDOW)).exp();
        let column_weights: Vec<f32> = (left..right).map(|column| weight(column as f32 - x)).collect();
        for row in (top..bottom).step_by(ROW_STEP) {
            let dy = row as f32 - y;
            let (first, last) = columns_inside(x, dy, axes, left, right);
            if first >= last {
                continue;
            }
            gradients.compute(plane, row, first, last);
            let magnitudes = gradients.magnitude.chunks(LANES);
            let angles = gradients.angle.chunks(LANES);
            let weights = column_weights[first - left..last - left].chunks(LANES);
            let row_weight = weight(dy);
            for (chunk, ((magnitudes, angles), weights)) in magnitudes.zip(angles).zip(weights).enumerate() {
                let mut votes = Votes::default();
                votes.vote[..weights.len()].copy_from_slice(weights);
                let dx = (first + chunk * LANES) as f32 - x;
                votes.cast(row_weight, magnitudes, angles, orientation, [dx, dy], axes);
                for i in 0..weights.len() {
                    votes.count(i, &mut bins);
                }
            }
        }
    }
    collect(&bins)
}

/// Votes of `LANES` neighbouring gradients: worked out side by side, counted one after another.
#[derive(Default)]
struct Votes {
    /// The bin of least row, column and direction among the eight that share the vote.
    bin: [i32; LANES],
    /// Share of the farther column, row and direction.
    share: [[f32; LANES]; 3],
    /// Weight of the window along the row; then the whole vote, 0 outside the square.
    vote: [f32; LANES],
}

impl Votes {
    #[inline]
    fn cast(
        &mut self,
        row_weight: f32,
        magnitudes: &[f32],
        angles: &[f32],
        orientation: f32,
        [dx, dy]: [f32; 2],
        [cos, sin]: [f32; 2],
    ) {
        const END: f32 = CELLS as f32 + 1.0;
        const MIDDLE: f32 = 0.5 * END;
        let (magnitudes, angles) = (&magnitudes[..LANES], &angles[..LANES]);
        for i in 0..LANES {
            let dx = dx + i as f32;
            // Cell coordinates: the centre of cell `k` is at `k + 1`, margin included.
            let across = cos * dx + sin * dy + MIDDLE;
            let down = cos * dy - sin * dx + MIDDLE;
            let turn = (orientation - angles[i]) * (DIRECTIONS as f32 / TAU) + 2.0 * DIRECTIONS as f32;
            let inside = (0.0..END).contains(&across) && (0.0..END).contains(&down);
            let (across, down) = (across.clamp(0.0, END - 0.5), down.clamp(0.0, END - 0.5));
            let (column, row, direction) = (across as i32, down as i32, turn as i32);
            self.share[0][i] = across - column as f32;
            self.share[1][i] = down - row as f32;
            self.share[2][i] = turn - direction as f32;
            self.bin[i] =
                (row * PADDED as i32 + column) * TURN as i32 + (direction & (DIRECTIONS as i32 - 1));
            let vote = row_weight * self.vote[i] * magnitudes[i];
            self.vote[i] = if inside { vote } else { 0.0 };
        }
    }

    /// Shares vote `i` among the eight nearest bins.
    #[inline]
    fn count(&self, i: usize, bins: &mut [f32; BINS]) {
        let first = self.bin[i] as usize;
        let Some(bins) = bins[first.min(BINS)..].first_chunk_mut::<SPAN>() else { return };
        let [right, down, turned] = [self.share[0][i], self.share[1][i], self.share[2][i]];
        let lower = self.vote[i] * down;
        let upper = self.vote[i] - lower;
        let (upper_right, lower_right) = (upper * right, lower * right);
        let cells = [upper - upper_right, upper_right, lower - lower_right, lower_right];
        for (at, vote) in [0, TURN, PADDED * TURN, PADDED * TURN + TURN].into_iter().zip(cells) {
            let next = vote * turned;
            bins[at] += vote - next;
            bins[at + 1] += next;
        }
    }
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

/// The bins without their margin, `[CELLS, CELLS, DIRECTIONS]`.
fn collect(bins: &[f32; BINS]) -> [f32; DIM] {
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
