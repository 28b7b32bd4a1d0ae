//! The Gaussian scale space, one octave at a time.

use rayon::prelude::*;
use veiloc_geometry::Stop;
use veiloc_simd::Backend;
use veiloc_simd::sift::LANES;

use super::SiftOptions;
use super::blur::{FIRST_SIGMA, LEVELS, SCALES, half_kernel, quarter_kernels, sigma_of_level};
use super::extrema::{Extremum, without_repeated};
use super::plane::{Plane, View};
use super::strip::{Blurs, Source, Strip};
use crate::GrayImage;

/// An octave narrower than this is too small for a descriptor.
const MIN_SIDE: usize = 12;
/// Minimum number of rows of a strip: it blurs some 40 rows of each of its neighbours again.
const STRIP: usize = 160;

/// The blurred images of one octave at which keypoints are described, and the position of their samples in the image.
#[derive(Debug)]
pub(super) struct Octave {
    /// The levels `1..=SCALES`; those that were dropped are empty.
    levels: Vec<Plane>,
    /// Pixels of the image per sample.
    pub(super) step: f64,
    /// The sample in column `x` lies at `x * step + offset` in the image.
    pub(super) offset: f64,
}

impl Octave {
    /// The first octave, of the image itself or of the doubled image, and its extrema.
    pub(super) fn first(
        image: &GrayImage,
        options: &SiftOptions,
        backend: Backend,
        stop: &Stop,
    ) -> (Self, Vec<Extremum>) {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let mut padded;
        // Doubling reads whole vectors: most images have rows of them, and are not copied.
        let view = if options.upsample && width.is_multiple_of(LANES) {
            View { width, height, stride: width, data: image.data() }
        } else {
            padded = Plane::new(width, height);
            let stride = padded.stride;
            for (padded, row) in padded.data.chunks_exact_mut(stride).zip(image.data().chunks_exact(width)) {
                padded[..width].copy_from_slice(row);
            }
            View { width, height, stride, data: &padded.data }
        };
        // Lowe subtracts 0.5 pixels for the blur of the camera. Full blurring has better repeatability on images (81
        // against 79 % of keypoints, 448 against 426 correct matches per pair: docs/results/features.md).
        if options.upsample {
            let source = Source::Doubled(view, quarter_kernels(0.5 * FIRST_SIGMA));
            Self::of(&source, [0.5, 0.25], 0, options, backend, stop)
        } else {
            let source = Source::Blurred(view, half_kernel(FIRST_SIGMA));
            Self::of(&source, [1.0, 0.5], 0, options, backend, stop)
        }
    }

    /// The next octave, half as wide, with index `index`; `None` when it would be too small.
    pub(super) fn next(
        &self,
        index: usize,
        options: &SiftOptions,
        backend: Backend,
        stop: &Stop,
    ) -> Option<(Self, Vec<Extremum>)> {
        let twice_first = self.level(SCALES);
        let big_enough = twice_first.width.min(twice_first.height).div_ceil(2) >= MIN_SIDE;
        let source = Source::Halved(twice_first);
        big_enough.then(|| Self::of(&source, [2.0 * self.step, self.offset], index, options, backend, stop))
    }

    fn of(
        source: &Source<'_>,
        [step, offset]: [f64; 2],
        index: usize,
        options: &SiftOptions,
        backend: Backend,
        stop: &Stop,
    ) -> (Self, Vec<Extremum>) {
        let (width, height) = source.size();
        let blurs = Blurs::new((1..LEVELS).map(|level| {
            let [below, here] = [level - 1, level].map(|level| sigma_of_level(level as f64));
            half_kernel((here * here - below * below).sqrt())
        }));
        let mut levels: Vec<Plane> = (0..SCALES).map(|_| Plane::new(width, height)).collect();
        let stride = levels[0].stride;

        // Rows do not depend on the division into strips, so the number of threads changes only the time.
        let strips = rayon::current_num_threads().min(height / STRIP).max(1);
        let rows = height.div_ceil(strips).max(1);
        let mut parts: Vec<_> = levels.iter_mut().map(|level| level.data.chunks_mut(rows * stride)).collect();
        let found: Vec<Vec<Extremum>> = (0..height.div_ceil(rows))
            .map(|k| {
                let own = parts.iter_mut().filter_map(Iterator::next).collect();
                Strip {
                    source,
                    blurs: &blurs,
                    size: [width, height],
                    stride,
                    first: k * rows,
                    own,
                    backend,
                    stop,
                }
            })
            .collect::<Vec<_>>()
            .into_par_iter()
            .map(|strip| strip.extrema(index, options))
            .collect();
        (Self { levels, step, offset }, without_repeated(found.concat()))
    }

    /// A level at which keypoints are described, of `1..=SCALES`.
    pub(super) fn level(&self, level: usize) -> &Plane {
        &self.levels[level - 1]
    }

    /// Frees the memory of a level, for good. Not of the last one, of which the next octave is made.
    pub(super) fn drop_level(&mut self, level: usize) {
        self.levels[level - 1] = Plane::default();
    }

    /// Columns of every level.
    pub(super) fn width(&self) -> usize {
        self.level(SCALES).width
    }

    /// Rows of every level.
    pub(super) fn height(&self) -> usize {
        self.level(SCALES).height
    }
}
