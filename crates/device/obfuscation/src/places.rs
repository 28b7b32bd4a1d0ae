//! Distinct positions of keypoints, and their dither: what happens before any scheme.

use std::collections::BTreeMap;

use rand::Rng;
use veiloc_geometry::Pixel;

/// Positions without repetition, and which of them each keypoint has.
///
/// An extractor gives several features with one position when it finds several orientations there, and a list of
/// matches repeats a keypoint. Two different lines for one position would cross in it (rule L7), so dither, line and
/// permutation partner belong to the place, not to the feature.
pub(crate) struct Places {
    /// Each position once, in order of first appearance.
    pub(crate) pixels: Vec<Pixel>,
    /// `[N]`: the place of each keypoint.
    pub(crate) of: Vec<usize>,
}

impl Places {
    pub(crate) fn new(positions: impl IntoIterator<Item = Pixel>) -> Self {
        let mut known = BTreeMap::new();
        let mut places = Self { pixels: Vec::new(), of: Vec::new() };
        for pixel in positions {
            // Adding zero turns −0 into 0, so that equal numbers have equal bits.
            let key = [(pixel.u + 0.0).to_bits(), (pixel.v + 0.0).to_bits()];
            let place = *known.entry(key).or_insert(places.pixels.len());
            if place == places.pixels.len() {
                places.pixels.push(pixel);
            }
            places.of.push(place);
        }
        places
    }
}

/// Moves a position by up to half a pixel each way, so that one on a lattice cannot be named (rule L2).
pub(crate) fn dither<R: Rng + ?Sized>(pixel: Pixel, rng: &mut R) -> Pixel {
    let mut step = || rng.random::<f64>() - 0.5;
    Pixel::new(pixel.u + step(), pixel.v + step())
}
