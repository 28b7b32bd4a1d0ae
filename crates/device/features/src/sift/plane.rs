//! Sample grids whose rows are padded to whole vectors.

use veiloc_simd::sift::{LANES, MAX_RADIUS};

/// A grid of samples, `[height, stride]`; samples right of `width` are finite padding.
#[derive(Debug, Clone, Default)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) stride: usize,
    pub(super) data: Vec<f32>,
}

impl Plane {
    /// A grid with arbitrary samples.
    pub(super) fn new(width: usize, height: usize) -> Self {
        let stride = stride_of(width);
        Self { width, height, stride, data: vec![0.0; stride * height] }
    }

    /// One row with its padding, `[stride]`.
    #[inline]
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.stride..][..self.stride]
    }

    /// The part of `width` columns and `height` rows from column `left` and row `top` on, with the grid continued by
    /// its mirror image without end. Not for an empty plane. It is written to `part`, whose memory and that of `columns`
    /// calls may share.
    pub(super) fn mirrored(
        &self,
        [left, top]: [isize; 2],
        [width, height]: [usize; 2],
        part: &mut Self,
        columns: &mut Vec<usize>,
    ) {
        let inside = |at: isize, size: usize| {
            let at = at.rem_euclid(2 * size as isize) as usize;
            at.min(2 * size - 1 - at)
        };
        (part.width, part.height, part.stride) = (width, height, stride_of(width));
        part.data.resize(part.stride * height, 0.0);
        columns.clear();
        columns.extend((0..width).map(|x| inside(left + x as isize, self.width)));
        for (y, row) in part.data.chunks_exact_mut(part.stride).enumerate() {
            let source = self.row(inside(top + y as isize, self.height));
            for (sample, &column) in row.iter_mut().zip(&*columns) {
                *sample = source[column];
            }
        }
    }
}

/// Samples of a grid that others own, `[height, stride]`.
#[derive(Debug, Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) stride: usize,
    pub(super) data: &'a [f32],
}

impl<'a> View<'a> {
    /// The rows from `reach` above `y` to `reach` below, and empty ones after them; outside, the first or last row.
    #[inline]
    pub(super) fn rows_around(&self, y: isize, reach: usize) -> [&'a [f32]; 2 * MAX_RADIUS + 1] {
        let mut rows: [&[f32]; 2 * MAX_RADIUS + 1] = [&[]; 2 * MAX_RADIUS + 1];
        for (k, row) in rows[..=2 * reach].iter_mut().enumerate() {
            let at = (y + k as isize - reach as isize).clamp(0, self.height as isize - 1) as usize;
            *row = &self.data[at * self.stride..][..self.stride];
        }
        rows
    }
}

/// Row length for `width` samples: space for the vectors of two rows of half the width, and an odd number of vectors,
/// so that neighbours in a column do not compete for the same cache sets.
fn stride_of(width: usize) -> usize {
    (2 * width.div_ceil(2 * LANES) + 1) * LANES
}
