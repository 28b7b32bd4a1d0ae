//! Squared distance from a point that slides along a line to a neighbour's line or position, as piecewise quadratics.
//!
//! On `x(t) = o + t v` the signed distance to a neighbour's line is linear, `d(t) = α t + β`, so its square is one
//! quadratic. Ends and alternatives break it into pieces:
//! - for a **segment or half-line** the distance is that to its line while the foot of the perpendicular lies on it,
//!   and that to its end otherwise: at most two breaks;
//! - for **two alternative lines** the distance is that to the nearer line, which changes where `d₁ = ±d₂`: at most
//!   two breaks;
//! - for a **known point** it is one quadratic, `t² − 2 t vᵀ(p − o) + |p − o|²`.

use veiloc_geometry::nalgebra::Vector2;
use veiloc_geometry::{Anchor, Pixel};

use crate::geometry_recovery::NeighbourExtent;
use crate::observation::Observation;
use crate::prior::KnownSegment;

/// `f(t) = a t² + 2 b t + c`.
#[derive(Clone, Copy, Default)]
pub(super) struct Quadratic {
    pub(super) a: f64,
    pub(super) b: f64,
    pub(super) c: f64,
}

impl Quadratic {
    fn of_line([alpha, beta]: [f64; 2]) -> Self {
        Self { a: alpha * alpha, b: alpha * beta, c: beta * beta }
    }

    fn of_point(along: f64, squared: f64) -> Self {
        Self { a: 1.0, b: -along, c: squared }
    }

    pub(super) fn add(&mut self, other: &Self, sign: f64) {
        self.a += sign * other.a;
        self.b += sign * other.b;
        self.c += sign * other.c;
    }

    pub(super) fn at(&self, t: f64) -> f64 {
        ((self.a * t + 2.0 * self.b) * t + self.c).max(0.0)
    }
}

/// Constraint that a neighbour's observation puts on positions, prepared for repeated distance evaluations.
#[derive(Clone, Copy)]
pub(super) enum NeighbourConstraint {
    /// A line `(a, b, c)` with unit normal and, if it has ends, its segment.
    Line { line: [f64; 3], ends: Option<KnownSegment>, anchor: Option<Anchor> },
    /// One of two lines.
    Either([[f64; 3]; 2]),
    /// A point.
    Point(Pixel),
}

impl NeighbourConstraint {
    pub(super) fn of(observation: &Observation, extent: NeighbourExtent, width: u32, height: u32) -> Self {
        let [first, second] = observation.lines().map(|l| l.map(|l| (*l.coefficients()).into()));
        match (*observation, first, second) {
            (Observation::Known(pixel), ..) => Self::Point(pixel),
            (_, Some(a), Some(b)) => Self::Either([a, b]),
            (observation, line, _) => {
                let anchor = match observation {
                    Observation::Pencil(row) => Some(row.anchor),
                    _ => None,
                };
                // Several spans of one line are merged into the span from the first to the last.
                let known = KnownSegment::hull(&observation, width, height);
                let ends =
                    match extent {
                        NeighbourExtent::Line => None,
                        NeighbourExtent::HalfLine if anchor.is_none() => None,
                        NeighbourExtent::HalfLine => known
                            .filter(|s| s.growth[0] == 0.0)
                            .map(|s| KnownSegment { near: 0.0, far: f64::INFINITY, ..s }),
                        NeighbourExtent::Segment => known.filter(|s| !s.is_empty()),
                    };
                Self::Line { line: line.unwrap_or([f64::NAN; 3]), ends, anchor }
            }
        }
    }

    /// Whether the line belongs to the same pencil as `segment`: such lines meet only in the anchor.
    pub(super) fn shares_anchor(&self, segment: &KnownSegment) -> bool {
        matches!(self, Self::Line { anchor: Some(anchor), .. } if segment.anchor == Some(*anchor))
    }
}

/// `[α, β]` of the signed distance of `o + t v` from a line.
fn slope(l: [f64; 3], o: Pixel, v: Vector2<f64>) -> [f64; 2] {
    [l[0] * v.x + l[1] * v.y, l[0] * o.u + l[1] * o.v + l[2]]
}

/// The squared distance along a line: the first piece, and the start of each following piece.
pub(super) struct PiecewiseQuadratic {
    pub(super) first: Quadratic,
    /// Ordered by `t`.
    pub(super) then: [Option<(f64, Quadratic)>; 2],
}

impl PiecewiseQuadratic {
    /// The squared distance to `constraint` along the whole line of `segment`.
    pub(super) fn of(constraint: &NeighbourConstraint, segment: &KnownSegment) -> Self {
        let (o, v) = (segment.origin, segment.direction);
        match constraint {
            NeighbourConstraint::Point(p) => Self { first: to_point(*p, o, v), then: [None; 2] },
            NeighbourConstraint::Either([a, b]) => Self::of_either(slope(*a, o, v), slope(*b, o, v)),
            NeighbourConstraint::Line { line, ends, .. } => {
                let mut along = slope(*line, o, v);
                if constraint.shares_anchor(segment) && segment.growth[0] == 0.0 {
                    along[1] = 0.0; // the same anchor: it crosses there and nowhere else
                }
                let middle = Quadratic::of_line(along);
                match ends {
                    None => Self { first: middle, then: [None; 2] },
                    Some(ends) => Self::of_segment(middle, ends, o, v),
                }
            }
        }
    }

    fn of_segment(middle: Quadratic, ends: &KnownSegment, o: Pixel, v: Vector2<f64>) -> Self {
        // The foot of the perpendicular lies at s(t) = s₀ + c t along the neighbour.
        let c = ends.direction.dot(&v);
        let s0 = ends.direction.dot(&(o.vector() - ends.origin.vector()));
        let beyond = |s: f64| to_point(ends.at(s), o, v);
        if c.abs() < 1e-12 {
            let first = if s0 < ends.near {
                beyond(ends.near)
            } else if s0 > ends.far {
                beyond(ends.far)
            } else {
                middle
            };
            return Self { first, then: [None; 2] };
        }
        let [low, high] = if c > 0.0 { [ends.near, ends.far] } else { [ends.far, ends.near] };
        let entry = low.is_finite().then(|| (low - s0) / c);
        let exit = high.is_finite().then(|| (high - s0) / c);
        match (entry, exit) {
            (None, None) => Self { first: middle, then: [None; 2] },
            (None, Some(x)) => Self { first: middle, then: [Some((x, beyond(high))), None] },
            (Some(e), exit) => {
                Self { first: beyond(low), then: [Some((e, middle)), exit.map(|x| (x, beyond(high)))] }
            }
        }
    }

    fn of_either([a1, b1]: [f64; 2], [a2, b2]: [f64; 2]) -> Self {
        // d₁ = d₂ and d₁ = −d₂; with slopes of equal size at most one of the two has a solution.
        let crossing = |slope: f64, offset: f64| (slope.abs() > 1e-12).then(|| -offset / slope);
        let mut breaks = [crossing(a1 - a2, b1 - b2), crossing(a1 + a2, b1 + b2)];
        if let [Some(x), Some(y)] = breaks
            && y < x
        {
            breaks = [Some(y), Some(x)];
        } else if breaks[0].is_none() {
            breaks.swap(0, 1);
        }
        // Left of all crossings the order of the two distances does not change; evaluate it well before the first
        // one.
        let probe = breaks[0].filter(|t| t.is_finite()).map_or(0.0, |t| t - 1.0 - t.abs() * 1e-3);
        let mut lines = [Quadratic::of_line([a1, b1]), Quadratic::of_line([a2, b2])];
        if (a1 * probe + b1).abs() > (a2 * probe + b2).abs() {
            lines.swap(0, 1);
        }
        let [nearer, farther] = lines;
        Self { first: nearer, then: [breaks[0].map(|t| (t, farther)), breaks[1].map(|t| (t, nearer))] }
    }
}

fn to_point(p: Pixel, o: Pixel, v: Vector2<f64>) -> Quadratic {
    let offset = p.vector() - o.vector();
    Quadratic::of_point(offset.dot(&v), offset.norm_squared())
}
