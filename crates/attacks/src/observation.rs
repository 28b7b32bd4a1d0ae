//! What an attacker holds of one keypoint.

use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{Anchor, DualAnchors, Pixel, PixelLine};

/// What one sealed row tells about the position of its keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Observation {
    /// The keypoint lies on this line: random lines.
    Line(PixelLine),
    /// The keypoint lies on this half-line: Dual Convergent Lines.
    HalfLine {
        /// Where it starts, pixels.
        anchor: Pixel,
        /// Its unit direction, away from the anchor, into the anchor's side of the picture.
        direction: Vector2<f64>,
    },
    /// The keypoint lies on one of these two lines: coordinate permutation, where a sent position `(u, v)` has
    /// kept one of its two coordinates, so the keypoint is somewhere on the vertical line through it or somewhere
    /// on the horizontal one.
    EitherLine([PixelLine; 2]),
}

impl Observation {
    /// The half-line of Dual Convergent Lines with this anchor and angle (as [`DualAnchors::angle_of`]).
    pub fn anchored(anchors: &DualAnchors, anchor: Anchor, angle: f64) -> Self {
        Self::HalfLine { anchor: anchors.position(anchor), direction: anchors.ray_direction(anchor, angle) }
    }

    /// The candidates of a position that kept one of its coordinates: the vertical line, then the horizontal one.
    pub fn permuted(sent: Pixel) -> Self {
        Self::EitherLine([
            PixelLine::through(sent, std::f64::consts::FRAC_PI_2),
            PixelLine::through(sent, 0.0),
        ])
    }

    /// The lines on one of which the keypoint lies; the second is `None` where there is one.
    pub fn lines(&self) -> [Option<PixelLine>; 2] {
        match *self {
            Self::Line(line) => [Some(line), None],
            Self::HalfLine { anchor, direction } => {
                [Some(PixelLine::through(anchor, direction.y.atan2(direction.x))), None]
            }
            Self::EitherLine([a, b]) => [Some(a), Some(b)],
        }
    }

    /// Distance of a pixel from what is known, in pixels: from the line, or from the nearer of two candidates.
    pub fn distance(&self, pixel: Pixel) -> f64 {
        let along = |line: Option<PixelLine>| line.map_or(f64::INFINITY, |l| l.signed_distance(pixel).abs());
        let [a, b] = self.lines();
        along(a).min(along(b))
    }
}
