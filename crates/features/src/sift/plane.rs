//! Sample grids whose rows are padded to whole vectors.

/// Rows are this many samples or a multiple, so that inner loops have no remainder.
pub(super) const LANES: usize = 16;

/// A grid of samples, `[height, stride]`; what lies right of `width` is finite and means nothing.
#[derive(Debug, Clone, Default)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) stride: usize,
    pub(super) data: Vec<f32>,
}

impl Plane {
    /// Gives it a size; the samples keep no meaning. Memory is reused.
    pub(super) fn reshape(&mut self, width: usize, height: usize) {
        self.width = width;
        self.height = height;
        self.stride = width.next_multiple_of(LANES);
        self.data.resize(self.stride * height, 0.0);
    }

    /// One row with its padding, `[stride]`.
    #[inline]
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.data[y * self.stride..][..self.stride]
    }

    /// The row at `y`, the first or last one when `y` is outside.
    #[inline]
    pub(super) fn row_clamped(&self, y: isize) -> &[f32] {
        self.row(y.clamp(0, self.height as isize - 1) as usize)
    }

    #[inline]
    pub(super) fn at(&self, x: usize, y: usize) -> f32 {
        self.data[y * self.stride + x]
    }
}

impl Plane {
    /// The part of `width` columns and `height` rows from column `left` and row `top` on, the grid continued by its own
    /// mirror image without end. Not of an empty plane.
    pub(super) fn mirrored(&self, [left, top]: [isize; 2], [width, height]: [usize; 2]) -> Self {
        let inside = |at: isize, size: usize| {
            let at = at.rem_euclid(2 * size as isize) as usize;
            at.min(2 * size - 1 - at)
        };
        let mut part = Self::default();
        part.reshape(width, height);
        let columns: Vec<usize> = (0..width).map(|x| inside(left + x as isize, self.width)).collect();
        for (y, row) in part.data.chunks_exact_mut(part.stride).enumerate() {
            let source = self.row(inside(top + y as isize, self.height));
            for (sample, &column) in row.iter_mut().zip(&columns) {
                *sample = source[column];
            }
        }
        part
    }
}

/// Every second sample of every second row of `source`, starting with the first.
pub(super) fn halve(source: &Plane, target: &mut Plane) {
    target.reshape(source.width.div_ceil(2), source.height.div_ceil(2));
    let (stride, width) = (target.stride, target.width);
    for (y, row) in target.data.chunks_exact_mut(stride).enumerate() {
        for (sample, pair) in row[..width].iter_mut().zip(source.row(2 * y).chunks(2)) {
            *sample = pair[0];
        }
        row[width..].fill(0.0);
    }
}
