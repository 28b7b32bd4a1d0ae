//! The geometry-recovery attack in closed form (paper Eq. 3, Proposition 1; Chelani et al., 2024).
//!
//! A keypoint is put where its own line comes nearest to the lines of its neighbours. On `x(t) = o + t v` the signed
//! distance to neighbour line `l_j` is linear, `d_j(t) = α_j t + β_j` with `α_j = n_jᵀ v = ±sin θ_ij`, so
//!
//! ```text
//! f(t) = Σ_j (α_j t + β_j)²        t* = −Σ α_j β_j / Σ α_j²  =  Σ w_ij t_ij / Σ w_ij,   w_ij = sin² θ_ij
//! ```
//!
//! with `t_ij = −β_j / α_j` where the two lines cross. The sums need no crossing point, so nearly parallel
//! neighbours do no numerical harm.
//!
//! # Two candidate lines
//! A permuted position stands for the union of two lines, whose distance is the smaller of two. Then `f` is a
//! quadratic between breakpoints, where a neighbour's two distances are equal (`d = ±d'`, at most two per neighbour).
//! The breakpoints are sorted and each piece is solved in closed form; the result is the exact global minimum. A
//! target with two candidates tries both and keeps the one of smaller cost.
//!
//! # Singular cases
//! - All neighbours share the target's anchor: every `t_ij` is the anchor, so the answer is the anchor, exactly
//!   (half-lines are measured from it, hence `β_j = 0`). The paper's mode 1.
//! - All neighbours are parallel to the target (or there are none): every point is as good. The answer is the anchor
//!   of a half-line and the middle of a line's part in the picture, with `determined: false`.
//! - Neighbours nearly parallel: the answer is far away and unstable, as the mathematics says (the paper's mode 2),
//!   often outside the picture, unless [`Reach::Picture`] holds it inside.

use rayon::prelude::*;
use veiloc_geometry::Pixel;

use crate::error::AttackError;
use crate::neighbours::NeighbourLists;
use crate::observation::Observation;
use crate::prior::KnownSegment;

/// Where the answer may lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reach {
    /// Anywhere on the line, also outside the picture and behind the anchor: the paper's attack.
    #[default]
    WholeLine,
    /// On the part in the picture, and before the anchor. `f` is minimised there exactly. A stronger attacker, who
    /// knows the picture's size and the scheme.
    Picture,
}

/// How the closed form is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct ClosedFormOptions {
    /// Where the answer may lie; the paper's default is the whole line.
    pub reach: Reach,
}

impl ClosedFormOptions {
    /// The attack whose answers stay in the picture.
    pub const fn in_picture() -> Self {
        Self { reach: Reach::Picture }
    }
}

/// An attacker's answer for one keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Recovered {
    /// The position, pixels; possibly outside the picture.
    pub pixel: Pixel,
    /// `f` there, squared pixels, summed over the neighbours.
    pub cost: f64,
    /// Whether the minimum is a single point.
    pub determined: bool,
}

/// Recovers each keypoint from its own observation and those of its neighbours (module docs).
///
/// `width`, `height`: the picture, pixels. One answer per observation, the same for any number of threads.
///
/// # Errors
/// [`AttackError::ListCount`] when there is not one neighbour list per observation.
pub fn closed_form(
    observations: &[Observation],
    neighbours: &NeighbourLists,
    width: u32,
    height: u32,
    options: &ClosedFormOptions,
) -> Result<Vec<Recovered>, AttackError> {
    if observations.len() != neighbours.len() {
        return Err(AttackError::ListCount { observations: observations.len(), lists: neighbours.len() });
    }
    let lines: Vec<Lines> = observations.iter().map(Lines::of).collect();
    Ok((0..observations.len())
        .into_par_iter()
        .with_min_len(128)
        .map_init(Sweep::default, |sweep, i| {
            let candidates = KnownSegment::of(&observations[i], width, height);
            let solve =
                |segment: KnownSegment| sweep.solve(&segment, neighbours.of(i), &lines, options.reach);
            let answers: Vec<Recovered> = candidates.into_iter().flatten().map(solve).collect();
            best(&answers)
        })
        .collect())
}

/// The answer of smaller cost, the first among equals.
fn best(answers: &[Recovered]) -> Recovered {
    let nowhere = Recovered { pixel: Pixel::new(f64::NAN, f64::NAN), cost: f64::NAN, determined: false };
    answers.iter().fold(nowhere, |best, a| if best.cost <= a.cost { best } else { *a })
}

/// Homogeneous coordinates of the one or two lines of an observation, unit normals.
#[derive(Clone, Copy)]
struct Lines {
    first: [f64; 3],
    second: Option<[f64; 3]>,
}

impl Lines {
    fn of(observation: &Observation) -> Self {
        let [first, second] = observation.lines().map(|l| l.map(|l| (*l.coefficients()).into()));
        Self { first: first.unwrap_or([f64::NAN; 3]), second }
    }
}

/// `f(t) = a t² + 2 b t + c` on a piece of the line.
#[derive(Clone, Copy, Default)]
struct Quadratic {
    a: f64,
    b: f64,
    c: f64,
}

impl Quadratic {
    fn add(&mut self, [alpha, beta]: [f64; 2], sign: f64) {
        self.a += sign * alpha * alpha;
        self.b += sign * alpha * beta;
        self.c += sign * beta * beta;
    }

    fn at(&self, t: f64) -> f64 {
        ((self.a * t + 2.0 * self.b) * t + self.c).max(0.0)
    }
}

/// A neighbour with two candidate lines, as `[α, β]` each, and which of them is nearer on the current piece.
struct Pair {
    distances: [[f64; 2]; 2],
    active: usize,
}

/// Buffers of the minimisation, kept from one keypoint to the next.
#[derive(Default)]
struct Sweep {
    pairs: Vec<Pair>,
    /// Where which pair changes its nearer line.
    breaks: Vec<(f64, u32)>,
}

/// Squared sine below which lines are parallel for all purposes: an angle of 1e-9 rad.
const PARALLEL: f64 = 1e-18;

impl Sweep {
    fn solve(&mut self, segment: &KnownSegment, list: &[u32], lines: &[Lines], reach: Reach) -> Recovered {
        let (o, v) = (segment.origin, segment.direction);
        let along = |l: [f64; 3]| [l[0] * v.x + l[1] * v.y, l[0] * o.u + l[1] * o.v + l[2]];
        let mut sum = Quadratic::default();
        self.pairs.clear();
        self.breaks.clear();
        for &j in list {
            let neighbour = lines[j as usize];
            let mut first = along(neighbour.first);
            if let Some(second) = neighbour.second {
                self.push_pair([first, along(second)]);
            } else {
                if segment.radial && first[1].abs() < 1e-9 {
                    first[1] = 0.0; // the same anchor: it crosses there and nowhere else
                }
                sum.add(first, 1.0);
            }
        }
        let limits = match reach {
            Reach::WholeLine => (f64::NEG_INFINITY, f64::INFINITY),
            Reach::Picture if segment.is_empty() => (0.0, 0.0),
            Reach::Picture => (segment.near, segment.far),
        };
        self.breaks.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for pair in &self.pairs {
            sum.add(pair.distances[pair.active], 1.0);
        }

        let mut best: Option<(f64, f64, bool)> = None; // t, cost, determined
        let mut low = f64::NEG_INFINITY;
        for k in 0..=self.breaks.len() {
            let next = self.breaks.get(k).copied();
            let high = next.map_or(f64::INFINITY, |b| b.0);
            let piece = (low.max(limits.0), high.min(limits.1));
            if piece.0 <= piece.1 {
                let (t, determined) = minimum(&sum, piece, segment, list.len());
                let cost = sum.at(t);
                if best.is_none_or(|b| cost < b.1) {
                    best = Some((t, cost, determined));
                }
            }
            let Some((t, p)) = next else { break };
            let pair = &mut self.pairs[p as usize];
            sum.add(pair.distances[pair.active], -1.0);
            pair.active = 1 - pair.active;
            sum.add(pair.distances[pair.active], 1.0);
            low = t;
        }
        let (t, cost, determined) = best.unwrap_or((f64::NAN, f64::NAN, false));
        Recovered { pixel: segment.at(t), cost, determined }
    }

    fn push_pair(&mut self, distances: [[f64; 2]; 2]) {
        let [[a1, b1], [a2, b2]] = distances;
        let index = self.pairs.len() as u32;
        // d₁ = d₂ and d₁ = −d₂; slopes of equal size leave one or none of the two.
        let crossing = |slope: f64, offset: f64| (slope.abs() > 1e-12).then(|| -offset / slope);
        let roots = [crossing(a1 - a2, b1 - b2), crossing(a1 + a2, b1 + b2)];
        let leftmost = roots.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        // Left of all crossings the order of the two distances does not change; ask well before the first one.
        let probe = if leftmost.is_finite() { leftmost - 1.0 - leftmost.abs() * 1e-3 } else { 0.0 };
        let nearer = (a1 * probe + b1).abs() <= (a2 * probe + b2).abs();
        self.pairs.push(Pair { distances, active: usize::from(!nearer) });
        self.breaks.extend(roots.into_iter().flatten().map(|t| (t, index)));
    }
}

/// The minimum of the sum on one piece, and whether it is a single point.
fn minimum(sum: &Quadratic, piece: (f64, f64), segment: &KnownSegment, neighbours: usize) -> (f64, bool) {
    if sum.a > PARALLEL * neighbours.max(1) as f64 {
        return ((-sum.b / sum.a).max(piece.0).min(piece.1), true);
    }
    // Flat: the anchor of a half-line, otherwise the middle of what is in the picture.
    let t = if segment.radial {
        0.0
    } else if segment.is_empty() {
        segment.expected()
    } else {
        let (low, high) = (piece.0.max(segment.near), piece.1.min(segment.far));
        if low <= high { f64::midpoint(low, high) } else { segment.expected() }
    };
    (t.max(piece.0).min(piece.1), false)
}
