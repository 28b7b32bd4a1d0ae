//! Extrema of the differences of Gaussians, refined to a fraction of a sample.

use veiloc_simd::Backend;
use veiloc_simd::sift::peaks;

use super::SiftOptions;
use super::blur::{LEVELS, SCALES};
use super::rows::Rows;

/// Maximum number of steps to a neighbouring sample before refinement stops.
const MAX_MOVES: usize = 5;
/// Refinement reads at most this many rows above and below.
pub(super) const MARGIN: usize = MAX_MOVES + 1;
/// A sample is a candidate from this share of the threshold on; its refined peak may be higher.
const CANDIDATE_SHARE: f32 = 0.8;

/// Level of the first octave whose keypoints are described before the next octave: the finest, where the weakest are.
pub(super) const EARLY: usize = 1;

/// A refined extremum, in samples of its octave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extremum {
    /// Index of its octave.
    pub(super) octave: usize,
    /// The sample it was refined from: level in `1..=SCALES`, column, row.
    pub(super) cell: [usize; 3],
    /// Level with fraction.
    pub(super) level: f32,
    /// Column with fraction.
    pub(super) x: f32,
    /// Row with fraction.
    pub(super) y: f32,
    /// |difference of Gaussians| at the refined peak.
    pub(super) response: f32,
}

impl Extremum {
    /// The level at which it is described.
    pub(super) fn plane(&self) -> usize {
        (self.level.round() as usize).clamp(1, SCALES)
    }

    /// Whether it is described before the next octave.
    pub(super) fn is_early(&self) -> bool {
        self.octave == 0 && self.plane() == EARLY
    }
}

/// Number of rows of differences in memory, a power of two: those of a row and its neighbours.
const ROWS_IN_MEMORY: usize = 4;

/// Differences of neighbouring levels in the last rows, `[ROWS_IN_MEMORY, LEVELS - 1, stride]`.
pub(super) struct Differences {
    stride: usize,
    data: Vec<f32>,
}

impl Differences {
    /// Without rows.
    pub(super) fn new(stride: usize) -> Self {
        Self { stride, data: vec![0.0; (LEVELS - 1) * ROWS_IN_MEMORY * stride] }
    }

    fn row(&self, level: usize, y: usize) -> &[f32] {
        &self.data[(y % ROWS_IN_MEMORY * (LEVELS - 1) + level) * self.stride..][..self.stride]
    }

    /// The differences of all levels in row `y`, `[LEVELS - 1, stride]`.
    pub(super) fn rows_mut(&mut self, y: usize) -> &mut [f32] {
        let length = (LEVELS - 1) * self.stride;
        &mut self.data[y % ROWS_IN_MEMORY * length..][..length]
    }
}

/// Appends the samples of row `y` that no neighbour in level, row and column exceeds; of equal neighbours the first.
/// `columns` is memory that calls may share.
pub(super) fn candidates(
    differences: &Differences,
    y: usize,
    width: usize,
    options: &SiftOptions,
    backend: Backend,
    columns: &mut Vec<u32>,
    cells: &mut Vec<[usize; 3]>,
) {
    let threshold = CANDIDATE_SHARE * options.peak_threshold;
    for level in 1..=SCALES {
        let near =
            [level - 1, level, level + 1].map(|level| [y - 1, y, y + 1].map(|y| differences.row(level, y)));
        columns.clear();
        peaks(backend, &near, width, threshold, columns);
        let columns = columns.iter().map(|&x| x as usize).filter(|&x| first_of_equals(&near, x));
        cells.extend(columns.map(|x| [level, x, y]));
    }
}

/// Removes duplicates: neighbouring candidates may move to the same sample.
pub(super) fn without_repeated(mut found: Vec<Extremum>) -> Vec<Extremum> {
    let mut seen: Vec<([usize; 3], usize)> = found.iter().enumerate().map(|(i, e)| (e.cell, i)).collect();
    seen.sort_unstable();
    let mut repeated = vec![false; found.len()];
    for pair in seen.windows(2) {
        repeated[pair[1].1] = pair[0].0 == pair[1].0;
    }
    let mut repeated = repeated.into_iter();
    found.retain(|_| !repeated.next().unwrap_or(false));
    found
}

/// Whether a peak in the middle row has no equal among its preceding neighbours: in levels below, in rows above, to its
/// left.
fn first_of_equals(near: &[[&[f32]; 3]; 3], x: usize) -> bool {
    let here = near[1][1][x];
    let before = near.iter().flatten().flat_map(|row| &row[x - 1..=x + 1]).take(13);
    before.copied().all(|other| other != here)
}

/// Fits a quadric around a candidate, moves to the sample nearest its peak, and accepts high peaks that are not on an
/// edge.
pub(super) fn refine(
    levels: &[Rows<'_>],
    [width, height]: [usize; 2],
    index: usize,
    cell: [usize; 3],
    options: &SiftOptions,
) -> Option<Extremum> {
    let [level, mut x, mut y] = cell;
    let mut fit = Fit::around(levels, level, x, y);
    for _ in 0..MAX_MOVES {
        let [dx, dy, _] = fit.offset()?;
        let move_x = step_towards(dx, x, width);
        let move_y = step_towards(dy, y, height);
        if move_x == 0 && move_y == 0 {
            break;
        }
        x = x.checked_add_signed(move_x)?;
        y = y.checked_add_signed(move_y)?;
        fit = Fit::around(levels, level, x, y);
    }
    let [dx, dy, ds] = fit.offset()?;
    let [gx, gy, gs] = fit.gradient;
    let response = (fit.value + 0.5 * (gx * dx + gy * dy + gs * ds)).abs();
    let ratio = options.edge_threshold;
    let well_placed = dx.abs() < 1.5 && dy.abs() < 1.5 && ds.abs() < 1.5;
    let corner = fit.edge_score().is_some_and(|score| score < (ratio + 1.0).powi(2) / ratio);
    (well_placed && corner && response > options.peak_threshold).then_some(Extremum {
        octave: index,
        cell: [level, x, y],
        level: level as f32 + ds,
        x: x as f32 + dx,
        y: y as f32 + dy,
        response,
    })
}

/// One sample towards a peak that is nearer to the neighbour, unless the border is there.
fn step_towards(offset: f32, at: usize, size: usize) -> isize {
    if offset > 0.6 && at < size - 2 {
        1
    } else if offset < -0.6 && at > 1 {
        -1
    } else {
        0
    }
}

/// Second-order expansion of the difference of Gaussians around one sample; axes are column, row, level.
struct Fit {
    value: f32,
    gradient: [f32; 3],
    /// xx, yy, ss, xy, xs, ys
    hessian: [f32; 6],
}

impl Fit {
    fn around(levels: &[Rows<'_>], level: usize, x: usize, y: usize) -> Self {
        let mut cube = [[[0.0; 3]; 3]; 3];
        for (row, y) in (y - 1..=y + 1).enumerate() {
            let near = |level: usize| <[f32; 3]>::try_from(&levels[level].row(y)[x - 1..=x + 1]);
            let samples =
                [level - 1, level, level + 1, level + 2].map(|level| near(level).unwrap_or_default());
            for (ds, pair) in samples.windows(2).enumerate() {
                for dx in 0..3 {
                    cube[ds][row][dx] = pair[1][dx] - pair[0][dx];
                }
            }
        }
        let dog =
            |dx: isize, dy: isize, ds: isize| cube[(ds + 1) as usize][(dy + 1) as usize][(dx + 1) as usize];
        let value = dog(0, 0, 0);
        let first = |[dx, dy, ds]: [isize; 3]| 0.5 * (dog(dx, dy, ds) - dog(-dx, -dy, -ds));
        let second = |[dx, dy, ds]: [isize; 3]| dog(dx, dy, ds) + dog(-dx, -dy, -ds) - 2.0 * value;
        let (xy, xs, ys) = (
            0.25 * (dog(1, 1, 0) + dog(-1, -1, 0) - dog(1, -1, 0) - dog(-1, 1, 0)),
            0.25 * (dog(1, 0, 1) + dog(-1, 0, -1) - dog(1, 0, -1) - dog(-1, 0, 1)),
            0.25 * (dog(0, 1, 1) + dog(0, -1, -1) - dog(0, 1, -1) - dog(0, -1, 1)),
        );
        let axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
        let [xx, yy, ss] = axes.map(second);
        Self { value, gradient: axes.map(first), hessian: [xx, yy, ss, xy, xs, ys] }
    }

    /// Position of the quadric's peak, relative to the sample; `None` when it has none.
    fn offset(&self) -> Option<[f32; 3]> {
        let [xx, yy, ss, xy, xs, ys] = self.hessian.map(f64::from);
        let [gx, gy, gs] = self.gradient.map(f64::from);
        // Cramer's rule on H d = -g, with the cofactors of the symmetric H.
        let (cxx, cxy, cxs) = (yy * ss - ys * ys, xs * ys - xy * ss, xy * ys - xs * yy);
        let (cyy, cys, css) = (xx * ss - xs * xs, xy * xs - xx * ys, xx * yy - xy * xy);
        let determinant = xx * cxx + xy * cxy + xs * cxs;
        let offset = [
            -(cxx * gx + cxy * gy + cxs * gs) / determinant,
            -(cxy * gx + cyy * gy + cys * gs) / determinant,
            -(cxs * gx + cys * gy + css * gs) / determinant,
        ];
        offset.iter().all(|d| d.is_finite()).then(|| offset.map(|d| d as f32))
    }

    /// trace² / determinant of the curvature in the image, which increases with the ratio of the two; `None` at a
    /// saddle.
    fn edge_score(&self) -> Option<f32> {
        let [xx, yy, _, xy, ..] = self.hessian;
        let determinant = xx * yy - xy * xy;
        (determinant > 0.0).then(|| (xx + yy).powi(2) / determinant)
    }
}
