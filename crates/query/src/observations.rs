//! What a sealed query tells about where its keypoints are.

use veiloc_geometry::{Anchor, DualAnchors, Pixel, PixelLine};

/// What is known about the position of each keypoint, `[N]` in the order of the rows.
#[derive(Clone, PartialEq)]
pub enum Observations {
    /// The positions themselves: `points`.
    Points(Vec<Pixel>),
    /// A line through each: `random-lines`.
    Lines(Vec<PixelLine>),
    /// Two lines, the horizontal and then the vertical one, of which one goes through the keypoint:
    /// `coordinate-permutation`.
    EitherLine(Vec<[PixelLine; 2]>),
    /// A half-line from one of two anchors: `dcl`.
    Anchored {
        /// Where the anchors are.
        anchors: DualAnchors,
        /// `[N]`
        lines: Vec<AnchoredLine>,
    },
}

/// A half-line of Dual Convergent Lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnchoredLine {
    /// Where it starts.
    pub anchor: Anchor,
    /// Its angle, as [`DualAnchors::angle_of`]: radians in `(0, π)`.
    pub angle: f64,
}

impl Observations {
    /// How many keypoints are told about.
    pub const fn len(&self) -> usize {
        match self {
            Self::Points(rows) => rows.len(),
            Self::Lines(rows) => rows.len(),
            Self::EitherLine(rows) => rows.len(),
            Self::Anchored { lines, .. } => lines.len(),
        }
    }

    /// True when it is none.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

// What a query tells about positions must never reach a log (leak L8).
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
