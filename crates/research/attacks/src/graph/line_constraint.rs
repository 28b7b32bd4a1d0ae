//! Degree of freedom of a keypoint in the graph attack: it moves along its segment, or is fixed.

use veiloc_geometry::Pixel;
use veiloc_geometry::nalgebra::Vector2;

use crate::prior::KnownSegment;

/// `x(t) = origin + t · direction`, `near ≤ t ≤ far`, pixels. The direction of a known position is zero.
#[derive(Debug, Clone, Copy)]
pub(super) struct LineConstraint {
    pub(super) origin: Vector2<f64>,
    pub(super) direction: Vector2<f64>,
    pub(super) near: f64,
    pub(super) far: f64,
    /// `t` of the prior-only baseline.
    pub(super) prior: f64,
}

impl LineConstraint {
    /// The constraint of a segment; a segment that misses the image, or is not finite, is fixed at the prior-only
    /// baseline.
    pub(super) fn of(segment: &KnownSegment) -> Self {
        let origin = segment.origin.vector();
        let prior = segment.expected();
        if segment.is_empty() {
            let at = segment.at(prior).vector();
            let at = if at.iter().all(|c| c.is_finite()) { at } else { Vector2::zeros() };
            return Self { origin: at, direction: Vector2::zeros(), near: 0.0, far: 0.0, prior: 0.0 };
        }
        Self { origin, direction: segment.direction, near: segment.near, far: segment.far, prior }
    }

    pub(super) fn at(&self, t: f64) -> Vector2<f64> {
        self.origin + self.direction * t
    }

    pub(super) fn clamp(&self, t: f64) -> f64 {
        t.max(self.near).min(self.far)
    }

    /// The `t` of the point nearest to `x`.
    pub(super) fn nearest(&self, x: Vector2<f64>) -> f64 {
        self.clamp(self.direction.dot(&(x - self.origin)))
    }
}

/// All positions.
pub(super) fn positions(constraints: &[LineConstraint], t: &[f64]) -> Vec<Vector2<f64>> {
    constraints.iter().zip(t).map(|(r, t)| r.at(*t)).collect()
}

/// All positions as pixels.
pub(super) fn pixels(constraints: &[LineConstraint], t: &[f64]) -> Vec<Pixel> {
    positions(constraints, t).iter().map(|p| Pixel::new(p.x, p.y)).collect()
}
