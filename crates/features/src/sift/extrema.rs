//! Extrema of the differences of Gaussians, refined to a fraction of a sample.

use rayon::prelude::*;

use super::SiftOptions;
use super::octave::{LEVELS, Octave, SCALES};
use super::plane::LANES;

/// Rows per unit of parallel work.
const ROWS: usize = 8;
/// Steps to a neighbouring sample before an extremum is given up to where it is.
const MAX_MOVES: usize = 5;
/// A sample is looked at when it has this share of the threshold; its refined peak may be higher.
const CANDIDATE_SHARE: f32 = 0.8;

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

/// All extrema of one octave, by row of the sample where they were found.
pub(super) fn find(octave: &Octave, index: usize, options: &SiftOptions) -> Vec<Extremum> {
    let (width, height) = (octave.width(), octave.height());
    if width < 3 || height < 3 {
        return Vec::new();
    }
    let blocks = (height - 2).div_ceil(ROWS);
    let mut found: Vec<Extremum> = (0..blocks)
        .into_par_iter()
        .flat_map_iter(|block| {
            let first = 1 + block * ROWS;
            let rows = first..(first + ROWS).min(height - 1);
            candidates(octave, rows, CANDIDATE_SHARE * options.peak_threshold)
                .into_iter()
                .filter_map(|cell| refine(octave, index, cell, options))
        })
        .collect();
    // Neighbouring candidates may move to one sample.
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

/// Samples of `rows` that no neighbour in level, row and column exceeds; of equal neighbours the first.
fn candidates(octave: &Octave, rows: std::ops::Range<usize>, threshold: f32) -> Vec<[usize; 3]> {
    let (width, stride) = (octave.width(), octave.levels[0].stride);
    let count = rows.len() + 2;
    let plane = count * stride;
    let mut dog = vec![0.0f32; (LEVELS - 1) * plane];
    for (level, dog) in dog.chunks_exact_mut(plane).enumerate() {
        let range = (rows.start - 1) * stride..(rows.end + 1) * stride;
        let (lower, upper) =
            (&octave.levels[level].data[range.clone()], &octave.levels[level + 1].data[range]);
        for ((dog, lower), upper) in dog.iter_mut().zip(lower).zip(upper) {
            *dog = upper - lower;
        }
    }

    let mut cells = Vec::new();
    for y in rows.clone() {
        for level in 1..=SCALES {
            let at = level * plane + (y + 1 - rows.start) * stride;
            for x in (1..width - 1).step_by(LANES) {
                let hits = peaks_in_row(&dog, at + x, threshold);
                if !hits.contains(&true) {
                    continue;
                }
                for (i, _) in hits.iter().enumerate().filter(|(i, hit)| **hit && x + i < width - 1) {
                    if is_extremum(&dog, at + x + i, stride, plane) {
                        cells.push([level, x + i, y]);
                    }
                }
            }
        }
    }
    cells
}

/// Which of the `LANES` samples from `at` on are over the threshold and over their neighbours left and right.
#[inline]
fn peaks_in_row(dog: &[f32], at: usize, threshold: f32) -> [bool; LANES] {
    let mut hits = [false; LANES];
    // There is always another row behind, so that lanes right of the image can be read; the caller drops them.
    let window = &dog[(at - 1)..=(at + LANES)];
    for i in 0..LANES {
        let (left, here, right) = (window[i], window[i + 1], window[i + 2]);
        hits[i] = ((here > threshold) && (here > left) && (here >= right))
            || ((here < -threshold) && (here < left) && (here <= right));
    }
    hits
}

/// True when no neighbour exceeds the sample; neighbours before it in memory must not even equal it.
fn is_extremum(dog: &[f32], at: usize, stride: usize, plane: usize) -> bool {
    let here = dog[at];
    let sign = if here > 0.0 { 1.0 } else { -1.0 };
    let here = here * sign;
    let neighbours = |level: usize| {
        let middle = at - plane + level * plane;
        (0..3).flat_map(move |row| {
            let middle = middle - stride + row * stride;
            middle - 1..middle + 2
        })
    };
    (0..3).flat_map(neighbours).all(|i| {
        let other = dog[i] * sign;
        if i < at { other < here } else { other <= here }
    })
}

/// Fits a quadric around a candidate, moves to the sample nearest its peak, and keeps what is high and no edge.
fn refine(octave: &Octave, index: usize, cell: [usize; 3], options: &SiftOptions) -> Option<Extremum> {
    let [level, mut x, mut y] = cell;
    let (width, height) = (octave.width(), octave.height());
    for _ in 0..MAX_MOVES {
        let fit = Fit::around(octave, level, x, y);
        let [dx, dy, _] = fit.offset()?;
        let move_x = step_towards(dx, x, width);
        let move_y = step_towards(dy, y, height);
        if move_x == 0 && move_y == 0 {
            break;
        }
        x = x.checked_add_signed(move_x)?;
        y = y.checked_add_signed(move_y)?;
    }
    let fit = Fit::around(octave, level, x, y);
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
    fn around(octave: &Octave, level: usize, x: usize, y: usize) -> Self {
        let dog = |dx: isize, dy: isize, ds: isize| {
            let level = level.wrapping_add_signed(ds);
            let (x, y) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            octave.levels[level + 1].at(x, y) - octave.levels[level].at(x, y)
        };
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

    /// Where the peak of the quadric lies, relative to the sample; `None` when it has none.
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

    /// trace² / determinant of the curvature in the image, which grows with the ratio of the two; `None` at a saddle.
    fn edge_score(&self) -> Option<f32> {
        let [xx, yy, _, xy, ..] = self.hessian;
        let determinant = xx * yy - xy * xy;
        (determinant > 0.0).then(|| (xx + yy).powi(2) / determinant)
    }
}
