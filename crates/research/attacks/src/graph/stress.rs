//! The initial layout: keypoints on their segments such that image distances follow graph distances.
//!
//! With graph distances `g_li` from landmarks `l`, minimises the stress
//!
//! ```text
//! Σ_l Σ_i w_li (c g_li − ‖x_l − x_i‖)²          w_li = 1 / g_li
//! ```
//!
//! over positions on the segments and the scale `c` (pixels per unit of graph distance), by majorisation: each
//! keypoint moves to the point of its segment nearest to the mean of the positions that the landmarks suggest. For
//! lines through anchors the scale is not free: keypoints on either side of the dividing line have common neighbours,
//! and the two sets of half-lines meet there at one scale only.

use veiloc_geometry::nalgebra::Vector2;

use super::line_constraint::{LineConstraint, positions};

/// Improves `t` by this many rounds; returns the mean stress per pair, relative to the squared distance.
pub(super) fn minimise(
    constraints: &[LineConstraint],
    landmarks: &[usize],
    graph: &[Vec<f64>],
    t: &mut [f64],
    rounds: usize,
) -> f64 {
    let mut stress = f64::INFINITY;
    for _ in 0..rounds {
        let x = positions(constraints, t);
        let scale = scale(&x, landmarks, graph);
        let mut target = vec![Vector2::<f64>::zeros(); t.len()];
        let mut weight = vec![0.0; t.len()];
        let (mut sum, mut whole) = (0.0, 0.0);
        for (&l, row) in landmarks.iter().zip(graph) {
            for (i, &g) in row.iter().enumerate() {
                if !g.is_finite() || g <= 0.0 {
                    continue;
                }
                let w = 1.0 / g.max(0.1);
                let away = x[i] - x[l];
                let distance = away.norm().max(1e-6);
                target[i] += (x[l] + away * (scale * g / distance)) * w;
                weight[i] += w;
                sum += w * (scale * g - distance).powi(2);
                whole += w * distance * distance;
            }
        }
        stress = sum / whole.max(f64::MIN_POSITIVE);
        for (i, line_constraint) in constraints.iter().enumerate() {
            if weight[i] > 0.0 {
                t[i] = line_constraint.nearest(target[i] / weight[i]);
            }
        }
    }
    stress
}

/// The scale with the least stress.
fn scale(x: &[Vector2<f64>], landmarks: &[usize], graph: &[Vec<f64>]) -> f64 {
    let (mut over, mut under) = (0.0, 0.0);
    for (&l, row) in landmarks.iter().zip(graph) {
        for (i, &g) in row.iter().enumerate().filter(|(_, g)| g.is_finite() && **g > 0.0) {
            over += (x[i] - x[l]).norm();
            under += g;
        }
    }
    over / under.max(f64::MIN_POSITIVE)
}
