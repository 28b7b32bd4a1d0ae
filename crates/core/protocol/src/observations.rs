//! What a sealed query reveals about the positions of its keypoints.

use veiloc_geometry::{Anchor, Pencils, Pixel, PixelLine};

/// What is known about the position of each keypoint, `[N]` in the order of the rows.
#[derive(Clone, PartialEq)]
pub enum Observations {
    /// The positions themselves: `points`.
    Points(Vec<Pixel>),
    /// A line through each: `random-lines`.
    Lines(Vec<PixelLine>),
    /// Two lines, first the horizontal and then the vertical one; one of them goes through the keypoint:
    /// `coordinate-permutation`.
    EitherLine(Vec<[PixelLine; 2]>),
    /// A half-plane about one of the anchors: `dcl`.
    Anchored {
        /// The anchors and sectors.
        pencils: Pencils,
        /// `[N]`
        lines: Vec<AnchoredLine>,
    },
}

/// A line of Dual Convergent Lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnchoredLine {
    /// The anchor of its pencil.
    pub anchor: Anchor,
    /// Its angle, as [`Pencils::angle_of`]: radians in `[0, 2π)`.
    pub angle: f64,
}

impl Observations {
    /// Number of keypoints.
    pub const fn len(&self) -> usize {
        match self {
            Self::Points(rows) => rows.len(),
            Self::Lines(rows) => rows.len(),
            Self::EitherLine(rows) => rows.len(),
            Self::Anchored { lines, .. } => lines.len(),
        }
    }

    /// True when there are none.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

// Positions must never reach a log (rule L8).
impl std::fmt::Debug for Observations {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = match self {
            Self::Points(_) => "Points",
            Self::Lines(_) => "Lines",
            Self::EitherLine(_) => "EitherLine",
            Self::Anchored { .. } => "Anchored",
        };
        write!(f, "Observations::{name}({})", self.len())
    }
}
