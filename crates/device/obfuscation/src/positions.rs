//! Distinct positions of keypoints, and their dither: the steps before any scheme.

use std::collections::BTreeMap;

use rand::Rng;
use veiloc_geometry::Pixel;

/// Positions without repetition, and the index of each keypoint's position.
///
/// An extractor returns several features at one position when it finds several orientations there, and a list of
/// matches can repeat a keypoint. Two different lines for one position would cross in it (rule L7), so dither, line and
/// permutation partner belong to the position, not to the feature.
pub(crate) struct DistinctPositions {
    /// Each position once, in order of first appearance.
    pub(crate) pixels: Vec<Pixel>,
    /// `[N]`: the position of each keypoint, as an index into `pixels`.
    pub(crate) index: Vec<usize>,
}

impl DistinctPositions {
    pub(crate) fn new(positions: impl IntoIterator<Item = Pixel>) -> Self {
        let mut known = BTreeMap::new();
        let mut distinct = Self { pixels: Vec::new(), index: Vec::new() };
        for pixel in positions {
            // Adding zero turns −0 into 0, so that equal numbers have equal bits.
            let key = [(pixel.u + 0.0).to_bits(), (pixel.v + 0.0).to_bits()];
            let position = *known.entry(key).or_insert(distinct.pixels.len());
            if position == distinct.pixels.len() {
                distinct.pixels.push(pixel);
            }
            distinct.index.push(position);
        }
        distinct
    }
}

/// Moves a position by up to half a pixel in each direction, so that a position on a pixel lattice cannot be identified
/// (rule L2).
pub(crate) fn dither<R: Rng + ?Sized>(pixel: Pixel, rng: &mut R) -> Pixel {
    let mut step = || rng.random::<f64>() - 0.5;
    Pixel::new(pixel.u + step(), pixel.v + step())
}
