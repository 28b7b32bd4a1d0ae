//! The levels of one octave in a strip of rows, from top to bottom, and its extrema.
//!
//! All levels advance together: level `l` is some rows behind level `l - 1`, by the radius of its blur. So rows are
//! read shortly after they are written, from the cache, and only the last rows are stored for levels that are not
//! needed later.

use veiloc_geometry::Stop;
use veiloc_simd::Backend;
use veiloc_simd::sift::{
    Doubling, HalfKernel, LANES, MAX_RADIUS, blur_along, blur_down, differences, double_row,
};

use super::SiftOptions;
use super::blur::{LEVELS, SCALES};
use super::extrema::{Differences, Extremum, MARGIN, candidates, refine};
use super::plane::{Plane, View};
use super::rows::Rows;

/// Rows by which all levels advance at once.
const BLOCK: usize = 8;

/// The source of an octave's first level.
pub(super) enum Source<'a> {
    /// The image, doubled and blurred in one step by the kernels for even and odd samples.
    Doubled(View<'a>, [Vec<f32>; 2]),
    /// The image, blurred.
    Blurred(View<'a>, HalfKernel),
    /// Every second sample of every second row, beginning with the first.
    Halved(&'a Plane),
}

/// The blurs from each level to the next.
pub(super) struct Blurs {
    kernels: Vec<HalfKernel>,
    /// How many rows the last level is behind each level, `[LEVELS]`.
    ahead: Vec<usize>,
    /// Rows of a level between the last one written and the oldest one that may be read, a power of two.
    ring: usize,
}

/// The rows from `first` on that fit into `own`, and their source.
pub(super) struct Strip<'a> {
    pub(super) source: &'a Source<'a>,
    pub(super) blurs: &'a Blurs,
    /// Columns and rows of the octave.
    pub(super) size: [usize; 2],
    pub(super) stride: usize,
    pub(super) first: usize,
    /// Memory for the rows of the levels `1..=SCALES`.
    pub(super) own: Vec<&'a mut [f32]>,
    pub(super) backend: Backend,
    /// Checked at each block of rows.
    pub(super) stop: &'a Stop,
}

impl Source<'_> {
    /// Columns and rows of the first level.
    pub(super) fn size(&self) -> (usize, usize) {
        match self {
            Self::Doubled(image, _) => (2 * image.width, 2 * image.height),
            Self::Blurred(image, _) => (image.width, image.height),
            Self::Halved(plane) => (plane.width.div_ceil(2), plane.height.div_ceil(2)),
        }
    }

    /// Row `y` of the first level.
    fn row(&self, y: usize, scratch: &mut Vec<f32>, out: &mut [f32], backend: Backend) {
        match self {
            Self::Doubled(image, [even, odd]) => {
                let reach = even.len() / 2;
                let near = image.rows_around((y / 2) as isize, reach);
                let down = if y.is_multiple_of(2) { even } else { odd };
                let out = &mut out[..2 * (image.width.next_multiple_of(LANES))];
                let near = &near[..even.len()];
                double_row(backend, Doubling { down, even, odd }, near, image.width, scratch, out);
            }
            Self::Blurred(image, kernel) => {
                let near = image.rows_around(y as isize, kernel.radius());
                let near = &near[..=2 * kernel.radius()];
                blur_down(backend, kernel, near, out.len(), image.width, scratch);
                blur_along(backend, kernel, scratch, out);
            }
            Self::Halved(plane) => {
                for (sample, pair) in out.iter_mut().zip(plane.row(2 * y).chunks_exact(2)) {
                    *sample = pair[0];
                }
            }
        }
    }
}

impl Blurs {
    /// From the kernels of the levels `1..LEVELS`.
    pub(super) fn new(kernels: impl Iterator<Item = HalfKernel>) -> Self {
        let kernels: Vec<HalfKernel> = kernels.collect();
        let mut ahead = vec![0; LEVELS];
        for level in (0..LEVELS - 1).rev() {
            ahead[level] = ahead[level + 1] + kernels[level].radius();
        }
        let ring = (ahead[0] + BLOCK + 2 * MARGIN).next_power_of_two();
        Self { kernels, ahead, ring }
    }
}

impl<'a> Strip<'a> {
    /// Fills the rows, and finds their extrema: by row, level and column of the sample of detection.
    pub(super) fn extrema(mut self, index: usize, options: &SiftOptions) -> Vec<Extremum> {
        let [width, height] = self.size;
        let end = self.first + self.own[0].len() / self.stride;
        let searched = self.first.max(1)..end.min(height.saturating_sub(1));
        let mut levels = self.levels(searched.start, end);
        let mut scratch = Vec::new();
        let mut differences = Differences::new(self.stride);
        let (mut columns, mut cells) = (Vec::new(), Vec::new());
        let mut found = Vec::new();
        if width < 3 {
            return found;
        }
        // The rows above the strip from which its first rows are computed, also a block at a time.
        let above = searched.start.min(2 * self.blurs.ahead[0]) / BLOCK;
        for behind in (1..=above).rev() {
            self.advance_all(&mut levels, searched.start - behind * BLOCK, &mut scratch);
        }
        for first in searched.clone().step_by(BLOCK).take_while(|_| !self.stop.is_set()) {
            let block = first..(first + BLOCK).min(searched.end);
            self.advance_all(&mut levels, block.end, &mut scratch);
            for y in block {
                if y == searched.start {
                    self.subtract(&levels, y - 1, &mut differences);
                    self.subtract(&levels, y, &mut differences);
                }
                self.subtract(&levels, y + 1, &mut differences);
                candidates(&differences, y, width, options, self.backend, &mut columns, &mut cells);
                for cell in cells.drain(..) {
                    found.extend(refine(&levels, [width, height], index, cell, options));
                }
            }
        }
        found
    }

    /// All levels, without rows.
    fn levels(&mut self, searched: usize, end: usize) -> Vec<Rows<'a>> {
        let mut own = std::mem::take(&mut self.own).into_iter();
        let alone = self.first == 0 && end == self.size[1];
        (0..LEVELS)
            .map(|level| {
                let own = if (1..=SCALES).contains(&level) { own.next() } else { None };
                let ring = if own.is_some() && alone { 0 } else { self.blurs.ring * self.stride };
                let next = searched.saturating_sub(MARGIN + self.blurs.ahead[level]);
                let own = own.unwrap_or_default();
                Rows { stride: self.stride, own, first: self.first, ring: vec![0.0; ring], next }
            })
            .collect()
    }

    /// Writes all rows that are needed for extrema above row `end`.
    fn advance_all(&self, levels: &mut [Rows<'_>], end: usize, scratch: &mut Vec<f32>) {
        for level in 0..LEVELS {
            let to = (end + MARGIN + self.blurs.ahead[level]).min(self.size[1]);
            self.advance(levels, level, to, scratch);
        }
    }

    /// Writes the rows of a level up to `to`.
    fn advance(&self, levels: &mut [Rows<'_>], level: usize, to: usize, scratch: &mut Vec<f32>) {
        let [width, height] = self.size;
        let (below, here) = levels.split_at_mut(level);
        let here = &mut here[0];
        while here.next < to {
            let y = here.next;
            let Some(below) = below.last() else {
                self.source.row(y, scratch, here.row_mut(y), self.backend);
                here.next += 1;
                continue;
            };
            let kernel = &self.blurs.kernels[level - 1];
            let radius = kernel.radius();
            let count = (to - y).min(BLOCK);
            let mut rows: [&[f32]; 2 * MAX_RADIUS + BLOCK] = [&[]; 2 * MAX_RADIUS + BLOCK];
            let rows = &mut rows[..2 * radius + count];
            for (k, row) in rows.iter_mut().enumerate() {
                *row = below.row((y + k).saturating_sub(radius).min(height - 1));
            }
            blur_down(self.backend, kernel, rows, self.stride, width, scratch);
            for (i, padded) in scratch.chunks_exact(self.stride + 2 * radius).enumerate() {
                blur_along(self.backend, kernel, padded, here.row_mut(y + i));
            }
            here.next += count;
        }
    }

    /// The differences of neighbouring levels in row `y`.
    fn subtract(&self, levels: &[Rows<'_>], y: usize, out: &mut Differences) {
        let rows: [&[f32]; LEVELS] = std::array::from_fn(|level| levels[level].row(y));
        differences(self.backend, &rows, out.rows_mut(y));
    }
}
