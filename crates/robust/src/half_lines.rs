//! Anchored lines as what they are: half-lines that begin at their anchor and lead into its side of the image.

use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{DualAnchors, Pixel};
use veiloc_solvers::HalfLine;

use veiloc_likelihood::Matches;

/// The half-line of each correspondence on the plane `z = 1`, unit directions, `[N]`.
pub(crate) fn half_lines(matches: &Matches<'_>, anchors: &DualAnchors) -> Vec<HalfLine> {
    let c = &matches.camera;
    (0..matches.len())
        .map(|i| {
            let line = &matches.observed[i];
            let position = anchors.position(matches.anchor[i]);
            let along = Vector2::new(line.y, -line.x);
            let ahead = Pixel::new(position.u + along.x, position.v + along.y);
            // Of the line's two directions, the one that leads into the anchor's own side.
            let inward = matches.anchor[i].sign() * anchors.signed_side(ahead) >= 0.0;
            let along = if inward { along } else { -along };
            let direction = Vector2::new(along.x / c.focal[0], along.y / c.focal[1]);
            HalfLine {
                origin: c.unproject(position),
                direction: direction / direction.norm().max(f64::MIN_POSITIVE),
            }
        })
        .collect()
}
