//! Observations: what an attacker holds of one keypoint.

use veiloc_geometry::{Anchor, PencilLine, Pencils, Pixel, PixelLine, Span};
use veiloc_protocol::Observations;

/// Constraint of one sealed row on the position of its keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Observation {
    /// The keypoint lies on this line: random lines.
    Line(PixelLine),
    /// The keypoint lies on this line of a pencil, in one of a few spans: Dual Convergent Lines.
    Pencil(PencilRow),
    /// The keypoint lies on one of these two lines: coordinate permutation. One coordinate of the sent position `(u,
    /// v)` is that of the keypoint, so the keypoint lies on the vertical or on the horizontal line through it.
    EitherLine([PixelLine; 2]),
    /// The keypoint has this position: a server that has found the pose projects the map point it matched.
    Known(Pixel),
}

/// A line of a pencil, and its spans that can hold the keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PencilRow {
    /// Lines of one anchor meet only in it.
    pub anchor: Anchor,
    /// The line; its direction leads away from the anchor.
    pub line: PencilLine,
    spans: [Span; PencilRow::MAX_SPANS],
    count: usize,
}

impl PencilRow {
    /// Maximum number of spans; with finer sectors, spans are joined at the smallest gaps.
    pub const MAX_SPANS: usize = 8;

    /// A line with these spans, in order.
    pub fn new(anchor: Anchor, line: PencilLine, mut all: Vec<Span>) -> Self {
        while all.len() > Self::MAX_SPANS {
            let gap = |k: &usize| all[k + 1].near - all[*k].far;
            let closest = (0..all.len() - 1).min_by(|a, b| gap(a).total_cmp(&gap(b))).unwrap_or(0);
            all[closest].far = all.remove(closest + 1).far;
        }
        let mut spans = [Span { near: 0.0, far: 0.0 }; Self::MAX_SPANS];
        spans[..all.len()].copy_from_slice(&all);
        Self { anchor, line, spans, count: all.len() }
    }

    /// The spans that can hold the keypoint, in order; empty when the line misses the image.
    pub fn spans(&self) -> &[Span] {
        &self.spans[..self.count]
    }

    /// The origin of the line, unless it is too far away.
    pub fn origin(&self) -> Option<Pixel> {
        (self.line.offset == 0.0).then_some(self.line.origin)
    }

    /// Whether a pixel near the line is in one of its spans, or at most `margin` pixels outside one.
    pub fn holds(&self, pixel: Pixel, margin: f64) -> bool {
        let t = self.line.direction.dot(&(pixel.vector() - self.line.origin.vector()));
        self.spans().iter().any(|s| s.near - margin <= t && t <= s.far + margin)
    }
}

impl Observation {
    /// The line of Dual Convergent Lines with this anchor and angle (as [`Pencils::angle_of`]).
    ///
    /// # Panics
    /// When the half-plane does not meet the image plane; decoded queries are checked for this.
    pub fn anchored(pencils: &Pencils, anchor: Anchor, angle: f64) -> Self {
        let line = pencils.along(anchor, angle).expect("it meets the image plane");
        Self::Pencil(PencilRow::new(anchor, line, pencils.spans(anchor, angle)))
    }

    /// The candidates of a permuted position: the vertical line, then the horizontal one.
    pub fn permuted(sent: Pixel) -> Self {
        Self::EitherLine([
            PixelLine::through(sent, std::f64::consts::FRAC_PI_2),
            PixelLine::through(sent, 0.0),
        ])
    }

    /// The sent observations as an attacker reads them: `[N]` in the order of the rows.
    pub fn of_sent(sent: &Observations) -> Vec<Self> {
        match sent {
            Observations::Points(pixels) => pixels.iter().copied().map(Self::Known).collect(),
            Observations::Lines(lines) => lines.iter().copied().map(Self::Line).collect(),
            Observations::EitherLine(pairs) => pairs.iter().copied().map(Self::EitherLine).collect(),
            Observations::Anchored { pencils, lines } => {
                lines.iter().map(|l| Self::anchored(pencils, l.anchor, l.angle)).collect()
            }
        }
    }

    /// The candidate lines of the keypoint; the second is `None` for a single line, both are `None` for a known
    /// position.
    pub fn lines(&self) -> [Option<PixelLine>; 2] {
        match *self {
            Self::Line(line) => [Some(line), None],
            Self::Pencil(PencilRow { line, .. }) => {
                [Some(PixelLine::through(line.origin, line.direction.y.atan2(line.direction.x))), None]
            }
            Self::EitherLine([a, b]) => [Some(a), Some(b)],
            Self::Known(_) => [None, None],
        }
    }

    /// Distance of a pixel from the constraint, pixels: from the line, from the nearer of two candidates, or from the
    /// known position.
    pub fn distance(&self, pixel: Pixel) -> f64 {
        if let Self::Known(known) = self {
            return known.distance(&pixel);
        }
        let along = |line: Option<PixelLine>| line.map_or(f64::INFINITY, |l| l.signed_distance(pixel).abs());
        let [a, b] = self.lines();
        along(a).min(along(b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_protocol::AnchoredLine;

    #[test]
    fn sent_observations_are_read_unchanged() {
        let p = Pixel::new(100.0, 200.0);
        let pencils = Pencils::paper(640, 480);
        let anchor = pencils.anchor_of(p);
        let lines = vec![AnchoredLine { anchor, angle: pencils.angle_of(anchor, p) }];
        let sent = [
            Observations::Points(vec![p]),
            Observations::Lines(vec![PixelLine::through(p, 1.0)]),
            Observations::EitherLine(vec![[PixelLine::through(p, 0.0), PixelLine::through(p, 1.5)]]),
            Observations::Anchored { pencils, lines },
        ];
        for sent in sent {
            let read = Observation::of_sent(&sent);
            assert_eq!(read.len(), 1);
            assert!(
                read[0].distance(p) < 1e-9 && read[0].distance(Pixel::new(90.0, 215.0)) > 1.0,
                "{read:?}"
            );
        }
    }
}
