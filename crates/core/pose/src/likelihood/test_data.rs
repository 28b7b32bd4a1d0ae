//! Observations of given pixels, for the unit tests of this crate.

use veiloc_geometry::{Pencils, Pixel, PixelLine};

use crate::likelihood::problem::Correspondences;

/// Kind 0: the points themselves; 1: lines through them in the directions `angle` gives; 2: lines of the anchors.
pub(crate) fn observe(
    kind: usize,
    pixels: Vec<Pixel>,
    pencils: &Pencils,
    mut angle: impl FnMut() -> f64,
) -> Correspondences {
    match kind {
        0 => Correspondences::Points { pixels },
        1 => {
            Correspondences::Lines { lines: pixels.iter().map(|p| PixelLine::through(*p, angle())).collect() }
        }
        _ => {
            let line = |p: &Pixel| (pencils.anchor_of(*p), pencils.angle_of(pencils.anchor_of(*p), *p));
            Correspondences::Anchored { pencils: pencils.clone(), lines: pixels.iter().map(line).collect() }
        }
    }
}
