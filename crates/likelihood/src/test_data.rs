//! Observations of given pixels, for the unit tests of this crate.

use veiloc_geometry::{DualAnchors, Pixel, PixelLine};

use crate::problem::Correspondences;

/// Kind 0: the points themselves; 1: lines through them in the directions `angle` gives; 2: lines of the anchors.
pub(crate) fn observe(
    kind: usize,
    pixels: Vec<Pixel>,
    anchors: DualAnchors,
    mut angle: impl FnMut() -> f64,
) -> Correspondences {
    match kind {
        0 => Correspondences::Points { pixels },
        1 => {
            Correspondences::Lines { lines: pixels.iter().map(|p| PixelLine::through(*p, angle())).collect() }
        }
        _ => {
            let line = |p: &Pixel| (anchors.anchor_of(*p), anchors.angle_of(anchors.anchor_of(*p), *p));
            Correspondences::Anchored { anchors, lines: pixels.iter().map(line).collect() }
        }
    }
}
