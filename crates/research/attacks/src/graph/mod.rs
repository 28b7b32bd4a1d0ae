//! The graph attack: positions from half-lines and a neighbour graph alone.
//!
//! The paper's attack computes, for each keypoint, the point of its line nearest to its neighbours' lines. For lines
//! that converge in two anchors this is ill-posed, as the paper says; but the neighbour *graph* carries more
//! information. Neighbour lists give distances along the graph, and a layout of the graph in the plane with each
//! keypoint on its own half-line has one unknown per keypoint and `k` equations.
//!
//! 1. [`edges`]: false edges are those whose ends have no neighbours in common; lengths from shared neighbours.
//! 2. [`geodesic`], [`stress`]: a layout by distances along the graph, each keypoint on its segment, from several
//!    starts; the layout with the least stress is kept. For schemes whose lines cross, the closed form is one more
//!    start, and the likelier layout is kept.
//! 3. [`likelihood`]: the layout with the largest likelihood of the lists: listed neighbours are nearer than other
//!    keypoints. It needs no distances, so the density of keypoints does not matter, and a single false entry has
//!    little weight.
//!
//! Known positions (a server that found the pose projects its map) are observations like others and stay fixed
//! ([`Observation::Known`]).

mod distinct_positions;
mod edges;
mod geodesic;
mod likelihood;
mod line_constraint;
mod newton;
mod stress;

use rand::Rng;
use rand::seq::index::sample;
use veiloc_geometry::Pixel;

use crate::error::AttackError;
use crate::geometry_recovery::{ClosedFormOptions, closed_form};
use crate::neighbours::NeighbourLists;
use crate::observation::Observation;
use crate::prior::KnownSegment;

use distinct_positions::DistinctPositions;
use edges::Edges;
use likelihood::ListLikelihood;
use line_constraint::{LineConstraint, pixels};

/// Options of the graph attack. The defaults were tuned on synthetic keypoints and transfer to images.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GraphOptions {
    /// Landmarks: keypoints from which graph distances are measured. More landmarks cost time and do not improve the
    /// result.
    pub landmarks: usize,
    /// Number of initial layouts: the first from the prior-only baseline, the others from random positions on the
    /// segments; the layout with the least stress is kept.
    pub starts: usize,
    /// Rounds of stress majorisation per start.
    pub stress_rounds: usize,
    /// Maximum number of reweightings: edge lengths are adapted to the density of the layout and the stress is
    /// minimised again, as long as it decreases.
    pub reweighings: usize,
    /// Sweeps that maximise the likelihood; 0 keeps the layout of least stress.
    pub sweeps: usize,
    /// Maximum number of restarts of the likelihood sweeps with wide edges, as long as the cost decreases enough.
    /// They undo folds of the first layout where keypoints are dense.
    pub restarts: usize,
    /// Share of false entries in the lists, 0 to 1, if known; `None`: estimated.
    pub false_share: Option<f64>,
    /// `[N]`: initial positions from another attack, pixels; projected on the segments they are one more start, and
    /// the likeliest layout is the answer.
    pub initial_positions: Option<Vec<Pixel>>,
}

impl GraphOptions {
    /// The same options with initial positions as one more start ([`Self::initial_positions`]).
    #[must_use]
    pub fn with_initial_positions(self, pixels: Vec<Pixel>) -> Self {
        Self { initial_positions: Some(pixels), ..self }
    }
}

impl Default for GraphOptions {
    fn default() -> Self {
        Self {
            landmarks: 150,
            starts: 2,
            stress_rounds: 40,
            reweighings: 3,
            sweeps: 80,
            restarts: 3,
            false_share: None,
            initial_positions: None,
        }
    }
}

/// Result of the graph attack.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct GraphAnswer {
    /// `[N]`: the position of each keypoint, inside the image, pixels.
    pub pixels: Vec<Pixel>,
    /// Estimated share of false entries in the lists, 0 to 1.
    pub false_share: f64,
    /// Cost per keypoint of the lists under these positions, in nats; lower is likelier.
    pub cost: f64,
}

/// Relative width of the soft edge around a radius, at the first sweep and at the last.
const WIDE: f64 = 0.4;
const NARROW: f64 = 0.03;
/// Smallest relative decrease of the cost for which another restart is tried.
const MIN_RESTART_GAIN: f64 = 0.002;

/// Recovers all keypoints together from their observations and the graph of their neighbours (module docs).
///
/// `width`, `height`: the image, pixels. Order within a list does not matter. The answer depends on the generator's
/// state, not on the number of threads.
///
/// # Errors
/// [`AttackError::ListCount`] when the numbers of neighbour lists and observations differ,
/// [`AttackError::InitialPositionCount`] when the numbers of initial positions and observations differ.
pub fn graph(
    observations: &[Observation],
    neighbours: &NeighbourLists,
    width: u32,
    height: u32,
    options: &GraphOptions,
    rng: &mut impl Rng,
) -> Result<GraphAnswer, AttackError> {
    if let Some(initial_positions) =
        options.initial_positions.as_ref().filter(|b| b.len() != observations.len())
    {
        return Err(AttackError::InitialPositionCount {
            observations: observations.len(),
            positions: initial_positions.len(),
        });
    }
    if neighbours.len() != observations.len() {
        return Err(AttackError::ListCount { observations: observations.len(), lists: neighbours.len() });
    }
    let positions = DistinctPositions::of(observations, neighbours);
    if positions.all_distinct() {
        return lay_out(observations, neighbours, width, height, options, rng);
    }
    let initial_positions = options.initial_positions.as_ref().map(|b| positions.first_of(b));
    let options = GraphOptions { initial_positions, ..options.clone() };
    let (sent, lists) = (positions.first_of(observations), positions.lists(neighbours));
    let answer = lay_out(&sent, &lists, width, height, &options, rng)?;
    Ok(GraphAnswer { pixels: positions.to_rows(&answer.pixels), ..answer })
}

/// [`graph`] for rows with distinct positions.
fn lay_out(
    observations: &[Observation],
    neighbours: &NeighbourLists,
    width: u32,
    height: u32,
    options: &GraphOptions,
    rng: &mut impl Rng,
) -> Result<GraphAnswer, AttackError> {
    let edges = Edges::accepted(neighbours);
    let candidates: Vec<Vec<KnownSegment>> =
        observations.iter().map(|o| KnownSegment::of(o, width, height)).collect();
    let crossed = closed_form(observations, &edges.lists(), width, height, &ClosedFormOptions::informed())?;
    let crossed: Vec<Pixel> = crossed.iter().map(|r| r.pixel).collect();
    let constraints: Vec<LineConstraint> = candidates
        .iter()
        .zip(&crossed)
        .map(|(c, near)| LineConstraint::of(&nearest_candidate(c, *near)))
        .collect();

    let mut layouts = vec![by_stress(&constraints, &edges, options, rng)];
    if observations.iter().any(|o| matches!(o, Observation::Line(_) | Observation::EitherLine(_))) {
        layouts.push(constraints.iter().zip(&crossed).map(|(r, p)| r.nearest(p.vector())).collect());
    }
    if let Some(initial_positions) = &options.initial_positions {
        layouts.push(constraints.iter().zip(initial_positions).map(|(r, p)| r.nearest(p.vector())).collect());
    }
    let mut best: Option<(GraphAnswer, Vec<f64>)> = None;
    let improve = |mut t: Vec<f64>, best: &mut Option<(GraphAnswer, Vec<f64>)>| {
        let mut likelihood =
            ListLikelihood::new(&constraints, neighbours, edges.rejected, options.false_share);
        let cost = likelihood.improve(&mut t, options.sweeps, WIDE, NARROW);
        let gain = best.as_ref().map_or(f64::INFINITY, |b| b.0.cost - cost);
        if gain > 0.0 {
            let false_share = likelihood.false_share();
            *best = Some((GraphAnswer { pixels: pixels(&constraints, &t), false_share, cost }, t));
        }
        gain / cost.abs()
    };
    for layout in layouts {
        improve(layout, &mut best);
    }
    for _ in 0..options.restarts {
        let Some(t) = best.as_ref().map(|b| b.1.clone()) else { break };
        if improve(t, &mut best) < MIN_RESTART_GAIN {
            break;
        }
    }
    Ok(best
        .map_or(GraphAnswer { pixels: crossed, false_share: edges.rejected, cost: f64::INFINITY }, |b| b.0))
}

/// The candidate segment nearest to a position.
fn nearest_candidate(candidates: &[KnownSegment], near: Pixel) -> KnownSegment {
    let distance = |s: &KnownSegment| {
        let line_constraint = LineConstraint::of(s);
        (line_constraint.at(line_constraint.nearest(near.vector())) - near.vector()).norm()
    };
    let nearest = candidates.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
    nearest.copied().unwrap_or_else(|| KnownSegment::of(&Observation::Known(near), 0, 0)[0])
}

/// The layout with the least stress among several starts, refined with edge lengths that follow its density.
fn by_stress(
    constraints: &[LineConstraint],
    edges: &Edges,
    options: &GraphOptions,
    rng: &mut impl Rng,
) -> Vec<f64> {
    let n = constraints.len();
    let landmarks = sample(rng, n, options.landmarks.min(n)).into_vec();
    let graph = geodesic::from_landmarks(edges, &landmarks, &vec![1.0; n]);
    let mut best: (f64, Vec<f64>) = (f64::INFINITY, constraints.iter().map(|r| r.prior).collect());
    for start in 0..options.starts.max(1) {
        let mut t: Vec<f64> = constraints
            .iter()
            .map(|r| if start == 0 { r.prior } else { r.near + (r.far - r.near) * rng.random::<f64>() })
            .collect();
        let stress = stress::minimise(constraints, &landmarks, &graph, &mut t, options.stress_rounds);
        if stress < best.0 {
            best = (stress, t);
        }
    }
    for _ in 0..options.reweighings {
        let graph = geodesic::from_landmarks(edges, &landmarks, &local_scale(constraints, edges, &best.1));
        let mut t = best.1.clone();
        let stress = stress::minimise(constraints, &landmarks, &graph, &mut t, options.stress_rounds);
        if stress >= best.0 {
            break;
        }
        best = (stress, t);
    }
    best.1
}

/// Mean distance to neighbours around each keypoint in a layout, relative to the overall mean: edges are short where
/// keypoints are dense. Smoothed over accepted edges.
fn local_scale(constraints: &[LineConstraint], edges: &Edges, t: &[f64]) -> Vec<f64> {
    let at = pixels(constraints, t);
    let near = NeighbourLists::nearest(&at, LOCAL_NEIGHBOURS);
    let mut scale: Vec<f64> =
        (0..at.len()).map(|i| near.of(i).last().map_or(1.0, |j| at[i].distance(&at[*j as usize]))).collect();
    for _ in 0..2 {
        scale = (0..at.len())
            .map(|i| {
                let around = edges.of(i);
                let sum = around.iter().map(|e| scale[e.to as usize]).sum::<f64>() + scale[i];
                sum / (around.len() + 1) as f64
            })
            .collect();
    }
    let mean = scale.iter().sum::<f64>() / scale.len().max(1) as f64;
    // The lower bound keeps edges from vanishing where the layout collapses.
    scale.iter().map(|s| (s / mean.max(1e-9)).clamp(0.2, 5.0)).collect()
}

/// Number of keypoints from which the local density is estimated.
const LOCAL_NEIGHBOURS: usize = 20;
