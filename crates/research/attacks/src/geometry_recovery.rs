//! The geometry-recovery attack in closed form (paper Eq. 3, Proposition 1; Chelani et al., 2024).
//!
//! The recovered position is where the keypoint's own line comes nearest to the lines of its neighbours.
//! On `x(t) = o + t v` the signed distance to neighbour line `l_j` is linear:
//! `d_j(t) = α_j t + β_j` with `α_j = n_jᵀ v = ±sin θ_ij`. So
//!
//! ```text
//! f(t) = Σ_j (α_j t + β_j)²        t* = −Σ α_j β_j / Σ α_j²  =  Σ w_ij t_ij / Σ w_ij,   w_ij = sin² θ_ij
//! ```
//!
//! where the two lines cross at `t_ij = −β_j / α_j`. The sums need no crossing point, so nearly parallel neighbours
//! do no numerical harm.
//!
//! # Two candidate lines
//! A permuted position stands for the union of two lines, whose distance is the smaller of two. Then `f` is a
//! quadratic between breakpoints, where a neighbour's two distances are equal (`d = ±d'`, at most two per neighbour).
//! The breakpoints are sorted and each piece is solved in closed form; the result is the exact global minimum. A
//! target with two candidates tries both and keeps the one of smaller cost.
//!
//! # Variants
//! An attacker who knows the scheme can improve on the paper's attack. [`ClosedFormOptions`] selects the
//! improvements: half-lines or segments in place of infinite lines (more breakpoints, solved by the same minimizer),
//! answers restricted to the image, neighbours of the other anchor only, and a filter for falsely predicted
//! neighbours. A neighbour with a known position contributes its distance as a point (the paper's server-side
//! attack).
//!
//! # Singular cases
//! - All neighbours share the target's anchor: every `t_ij` is the anchor, so the answer is the anchor, exactly
//!   (half-lines are measured from it, hence `β_j = 0`). The paper's mode 1.
//! - All neighbours are parallel to the target (or there are none): every point has the same cost. The answer is the
//!   anchor of a half-line, or the middle of the line's part in the image, with `determined: false`. With
//!   [`ClosedFormOptions::other_anchor_only`] the answer is then the prior-only baseline.
//! - Neighbours nearly parallel: the answer is far away and unstable, (the paper's mode 2), often outside the image,
//!   unless [`AnswerRegion::Image`] restricts it to the image.

mod consensus;
mod piecewise;

use rayon::prelude::*;
use veiloc_geometry::Pixel;

use crate::error::AttackError;
use crate::neighbours::NeighbourLists;
use crate::observation::Observation;
use crate::prior::KnownSegment;

use piecewise::{NeighbourConstraint, PiecewiseQuadratic, Quadratic};

/// Where the answer may lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AnswerRegion {
    /// Anywhere on the line, also outside the image and behind the anchor: the paper's attack.
    #[default]
    WholeLine,
    /// On the part of the line in the image and in front of the anchor. `f` is minimised there exactly. This attacker
    /// is stronger: it knows the image's size and the scheme.
    Image,
}

/// Which part of a neighbour's line is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum NeighbourExtent {
    /// The infinite line: the paper's attack.
    #[default]
    Line,
    /// The half-line, where the neighbour has one.
    HalfLine,
    /// The part in the image. For two alternative lines both whole lines are used: lines of coordinate permutation
    /// are parallel to the image's sides, so for answers inside the image the result is the same.
    Segment,
}

/// Options of the closed form. The default is the paper's attack.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct ClosedFormOptions {
    /// Where the answer may lie; the paper's default is the whole line.
    pub reach: AnswerRegion,
    /// Which part of a neighbour's line is used; the paper's default is the whole line.
    pub extent: NeighbourExtent,
    /// Ignore neighbours whose half-line starts at the keypoint's own anchor: each of them votes for the anchor,
    /// which an attacker knows to be wrong. Default: false.
    pub other_anchor_only: bool,
    /// Keep only the neighbours that agree within this many pixels with the best single neighbour; for predicted
    /// neighbours, many of which are false. Default: all neighbours are kept.
    pub consensus_px: Option<f64>,
}

impl ClosedFormOptions {
    /// The attack whose answers stay in the image.
    pub const fn in_image() -> Self {
        Self {
            reach: AnswerRegion::Image,
            extent: NeighbourExtent::Line,
            other_anchor_only: false,
            consensus_px: None,
        }
    }

    /// Answers in the image, the lines' parts in the image, and neighbours of the other anchor only.
    pub const fn informed() -> Self {
        Self {
            reach: AnswerRegion::Image,
            extent: NeighbourExtent::Segment,
            other_anchor_only: true,
            consensus_px: None,
        }
    }

    /// The same options, plus a filter for falsely predicted neighbours: those farther than `px` pixels from the
    /// consensus are ignored.
    #[must_use]
    pub const fn with_consensus(mut self, px: f64) -> Self {
        self.consensus_px = Some(px);
        self
    }
}

/// The recovered position of one keypoint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecoveredKeypoint {
    /// The position, pixels; possibly outside the image.
    pub pixel: Pixel,
    /// `f` at this position, squared pixels, summed over the neighbours that were used.
    pub cost: f64,
    /// Whether the minimum is a single point.
    pub determined: bool,
}

/// Recovers each keypoint from its own observation and those of its neighbours (module docs).
///
/// `width`, `height`: the image, pixels. One answer per observation; the result does not depend on the number of
/// threads. The answer for a known position is that position.
///
/// # Errors
/// [`AttackError::ListCount`] when the numbers of neighbour lists and observations differ.
pub fn closed_form(
    observations: &[Observation],
    neighbours: &NeighbourLists,
    width: u32,
    height: u32,
    options: &ClosedFormOptions,
) -> Result<Vec<RecoveredKeypoint>, AttackError> {
    if observations.len() != neighbours.len() {
        return Err(AttackError::ListCount { observations: observations.len(), lists: neighbours.len() });
    }
    let constraints: Vec<NeighbourConstraint> =
        observations.iter().map(|o| NeighbourConstraint::of(o, options.extent, width, height)).collect();
    Ok((0..observations.len())
        .into_par_iter()
        .with_min_len(128)
        .map_init(Minimizer::default, |minimizer, i| {
            if let Observation::Known(pixel) = observations[i] {
                return RecoveredKeypoint { pixel, cost: 0.0, determined: true };
            }
            let candidates = KnownSegment::of(&observations[i], width, height);
            let solve =
                |segment: KnownSegment| minimizer.solve(&segment, neighbours.of(i), &constraints, options);
            let answers: Vec<RecoveredKeypoint> = candidates.into_iter().map(solve).collect();
            best(&answers)
        })
        .collect())
}

/// The answer with the smallest cost; ties go to the first.
fn best(answers: &[RecoveredKeypoint]) -> RecoveredKeypoint {
    let nowhere =
        RecoveredKeypoint { pixel: Pixel::new(f64::NAN, f64::NAN), cost: f64::NAN, determined: false };
    answers.iter().fold(nowhere, |best, a| if best.cost <= a.cost { best } else { *a })
}

/// Buffers of the minimisation, reused for all keypoints.
#[derive(Default)]
struct Minimizer {
    /// End of each piece: the position, and the index in insertion order.
    breaks: Vec<(f64, u32)>,
    /// Change of the sum at each break, in insertion order; stored separately so that sorting moves little data.
    gains: Vec<Quadratic>,
}

/// Squared sine below which two lines are treated as parallel: an angle of 1e-9 rad.
const PARALLEL: f64 = 1e-18;

impl Minimizer {
    fn solve(
        &mut self,
        segment: &KnownSegment,
        list: &[u32],
        constraints: &[NeighbourConstraint],
        options: &ClosedFormOptions,
    ) -> RecoveredKeypoint {
        let limits = match options.reach {
            AnswerRegion::WholeLine => (f64::NEG_INFINITY, f64::INFINITY),
            AnswerRegion::Image if segment.is_empty() => (0.0, 0.0),
            AnswerRegion::Image => (segment.near, segment.far),
        };
        let counts =
            |j: &u32| !(options.other_anchor_only && constraints[*j as usize].shares_anchor(segment));
        let filtered;
        let list = if options.other_anchor_only || options.consensus_px.is_some() {
            let counted: Vec<u32> = list.iter().copied().filter(counts).collect();
            filtered = match options.consensus_px {
                Some(px) => consensus::agreeing(segment, &counted, constraints, px, limits),
                None => counted,
            };
            &filtered[..]
        } else {
            list
        };

        let mut sum = Quadratic::default();
        self.breaks.clear();
        self.gains.clear();
        for &j in list {
            let pieces = PiecewiseQuadratic::of(&constraints[j as usize], segment);
            sum.add(&pieces.first, 1.0);
            let mut previous = pieces.first;
            for (t, piece) in pieces.then.into_iter().flatten() {
                let mut gain = piece;
                gain.add(&previous, -1.0);
                self.breaks.push((t, self.gains.len() as u32));
                self.gains.push(gain);
                previous = piece;
            }
        }
        self.breaks.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));

        let mut best: Option<(f64, f64, bool)> = None; // t, cost, determined
        let mut low = f64::NEG_INFINITY;
        for k in 0..=self.breaks.len() {
            let next = self.breaks.get(k);
            let high = next.map_or(f64::INFINITY, |b| b.0);
            let piece = (low.max(limits.0), high.min(limits.1));
            if piece.0 <= piece.1 {
                let (t, determined) = minimum(&sum, piece, segment, list.len(), options);
                let cost = sum.at(t);
                if best.is_none_or(|b| cost < b.1) {
                    best = Some((t, cost, determined));
                }
            }
            let Some(&(t, gain)) = next else { break };
            sum.add(&self.gains[gain as usize], 1.0);
            low = t;
        }
        let (t, cost, determined) = best.unwrap_or((f64::NAN, f64::NAN, false));
        RecoveredKeypoint { pixel: segment.at(t), cost, determined }
    }
}

/// The minimum of the sum on one piece, and whether it is a single point.
fn minimum(
    sum: &Quadratic,
    piece: (f64, f64),
    segment: &KnownSegment,
    neighbours: usize,
    options: &ClosedFormOptions,
) -> (f64, bool) {
    if sum.a > PARALLEL * neighbours.max(1) as f64 {
        return ((-sum.b / sum.a).max(piece.0).min(piece.1), true);
    }
    // Constant cost: use the anchor where the line begins, otherwise the middle of the part in the image.
    let t = if segment.anchor.is_some() {
        if options.other_anchor_only || segment.growth[0] != 0.0 { segment.expected() } else { 0.0 }
    } else if segment.is_empty() {
        segment.expected()
    } else {
        let (low, high) = (piece.0.max(segment.near), piece.1.min(segment.far));
        if low <= high { f64::midpoint(low, high) } else { segment.expected() }
    };
    (t.max(piece.0).min(piece.1), false)
}
