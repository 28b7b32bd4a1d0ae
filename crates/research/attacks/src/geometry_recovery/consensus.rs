//! Consensus among a keypoint's predicted neighbours: filtering of false ones.
//!
//! The attack of Chelani et al. (2024) draws a few predicted neighbours, recovers the keypoint from them, counts the
//! neighbours that agree, and keeps the largest consensus. A keypoint on a line has one unknown, so a sample is a
//! single neighbour: all samples are tried, without randomness.

use crate::geometry_recovery::piecewise::{NeighbourConstraint, PiecewiseQuadratic, Quadratic};
use crate::prior::KnownSegment;

/// The neighbours on `list` that agree with the best of all single-neighbour hypotheses within `limit` pixels.
///
/// The hypothesis of a neighbour is the point of the segment nearest to it. `low`, `high`: interval of allowed
/// hypotheses. Ties go to the first hypothesis.
pub(super) fn agreeing(
    segment: &KnownSegment,
    list: &[u32],
    constraints: &[NeighbourConstraint],
    limit: f64,
    (low, high): (f64, f64),
) -> Vec<u32> {
    let pieces: Vec<PiecewiseQuadratic> =
        list.iter().map(|&j| PiecewiseQuadratic::of(&constraints[j as usize], segment)).collect();
    let squared = |p: &PiecewiseQuadratic, t: f64| {
        p.then
            .iter()
            .flatten()
            .take_while(|piece| piece.0 <= t)
            .last()
            .map_or(&p.first, |piece| &piece.1)
            .at(t)
    };
    let agree = |t: f64| pieces.iter().map(move |p| squared(p, t) <= limit * limit);
    let mut best = (0, 0.0);
    for quadratic in pieces.iter().flat_map(all) {
        if quadratic.a < 1e-9 {
            continue; // parallel: it names no point
        }
        let t = (-quadratic.b / quadratic.a).max(low).min(high);
        let support = agree(t).filter(|a| *a).count();
        if support > best.0 {
            best = (support, t);
        }
    }
    if best.0 == 0 {
        return list.to_vec();
    }
    list.iter().zip(agree(best.1)).filter(|(_, a)| *a).map(|(j, _)| *j).collect()
}

fn all(pieces: &PiecewiseQuadratic) -> impl Iterator<Item = &Quadratic> {
    std::iter::once(&pieces.first).chain(pieces.then.iter().flatten().map(|p| &p.1))
}
