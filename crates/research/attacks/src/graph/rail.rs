//! What a keypoint of the graph attack can still do: slide along its segment, or stand still.

use veiloc_geometry::Pixel;
use veiloc_geometry::nalgebra::Vector2;

use crate::prior::KnownSegment;

/// `x(t) = origin + t · direction`, `near ≤ t ≤ far`, pixels. A known position has direction zero.
#[derive(Debug, Clone, Copy)]
pub(super) struct Rail {
    pub(super) origin: Vector2<f64>,
    pub(super) direction: Vector2<f64>,
    pub(super) near: f64,
    pub(super) far: f64,
    /// The guess that uses no neighbours.
    pub(super) guess: f64,
}

impl Rail {
    /// Of a segment; one that misses the image, or is not finite, stands still where the guess is.
    pub(super) fn of(segment: &KnownSegment) -> Self {
        let origin = segment.origin.vector();
        let guess = segment.expected();
        if segment.is_empty() {
            let at = segment.at(guess).vector();
            let at = if at.iter().all(|c| c.is_finite()) { at } else { Vector2::zeros() };
            return Self { origin: at, direction: Vector2::zeros(), near: 0.0, far: 0.0, guess: 0.0 };
        }
        Self { origin, direction: segment.direction, near: segment.near, far: segment.far, guess }
    }

    pub(super) fn at(&self, t: f64) -> Vector2<f64> {
        self.origin + self.direction * t
    }

    pub(super) fn held(&self, t: f64) -> f64 {
        t.max(self.near).min(self.far)
    }

    /// The `t` of the rail's point nearest to `x`.
    pub(super) fn nearest(&self, x: Vector2<f64>) -> f64 {
        self.held(self.direction.dot(&(x - self.origin)))
    }
}

/// All positions.
pub(super) fn positions(rails: &[Rail], t: &[f64]) -> Vec<Vector2<f64>> {
    rails.iter().zip(t).map(|(r, t)| r.at(*t)).collect()
}

/// The same as pixels.
pub(super) fn pixels(rails: &[Rail], t: &[f64]) -> Vec<Pixel> {
    positions(rails, t).iter().map(|p| Pixel::new(p.x, p.y)).collect()
}
