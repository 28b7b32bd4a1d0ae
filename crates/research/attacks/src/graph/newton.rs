//! One step of Newton's method for costs of distances between keypoints on segments.
//!
//! For a cost `Σ φ(‖x_i − x_j‖)` with `φ' = w` and curvature `h ≥ 0`, the model of a pair with unit vector `u` from
//! `i` to `j` has the Hessian `h u uᵀ + max(w, 0)/d (I − u uᵀ)` in `x_j − x_i`: positive semidefinite, so that the
//! linear system is solved by conjugate gradients, preconditioned by its diagonal. Errors of long wavelength, which
//! gradient descent removes very slowly, vanish in a few steps.

use veiloc_geometry::nalgebra::Vector2;

use super::line_constraint::LineConstraint;

/// The cost of one pair at its current distance: slope `w` and curvature `h`.
#[derive(Debug, Clone, Copy)]
pub(super) struct PairCost {
    pub(super) i: u32,
    pub(super) j: u32,
    pub(super) slope: f64,
    pub(super) curvature: f64,
}

/// Relative increase of the Hessian's diagonal (damping).
const DAMPING: f64 = 1e-3;
const ITERATIONS: usize = 300;
const TOLERANCE: f64 = 1e-2;

/// Moves all keypoints by one step of at most `longest` pixels.
pub(super) fn step(
    constraints: &[LineConstraint],
    x: &[Vector2<f64>],
    pairs: &[PairCost],
    t: &mut [f64],
    longest: f64,
) {
    let n = t.len();
    let mut gradient = vec![0.0; n];
    let mut diagonal = vec![0.0; n];
    let mut rest: Vec<(u32, u32, f64)> = Vec::with_capacity(pairs.len());
    for pair in pairs {
        let (i, j) = (pair.i as usize, pair.j as usize);
        let away = x[j] - x[i];
        let distance = away.norm().max(1e-2);
        let u = away / distance;
        let (di, dj) = (constraints[i].direction, constraints[j].direction);
        let (ai, aj) = (-u.dot(&di), u.dot(&dj));
        gradient[i] += ai * pair.slope;
        gradient[j] += aj * pair.slope;
        let bend = pair.slope.max(0.0) / distance;
        let across = |a: f64, d: Vector2<f64>| bend * (d.norm_squared() - a * a);
        diagonal[i] += pair.curvature * ai * ai + across(ai, di);
        diagonal[j] += pair.curvature * aj * aj + across(aj, dj);
        let coupling = pair.curvature * ai * aj + bend * (-di.dot(&dj) - ai * aj);
        if coupling != 0.0 {
            rest.push((pair.i, pair.j, coupling));
        }
    }
    let mean = diagonal.iter().sum::<f64>() / n.max(1) as f64;
    for d in &mut diagonal {
        *d += DAMPING * *d + 1e-6 * mean + f64::MIN_POSITIVE;
    }
    let moves = conjugate_gradients(&diagonal, &rest, &gradient);
    for ((t, line_constraint), step) in t.iter_mut().zip(constraints).zip(moves) {
        *t = line_constraint.clamp(*t + (-step).max(-longest).min(longest));
    }
}

/// Solves `H s = g` for the symmetric matrix with this diagonal and these off-diagonal entries, each of which stands
/// for both triangles.
fn conjugate_gradients(diagonal: &[f64], rest: &[(u32, u32, f64)], g: &[f64]) -> Vec<f64> {
    let n = g.len();
    let rows = Rows::new(n, rest);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut s = vec![0.0; n];
    let mut residual = g.to_vec();
    let mut z: Vec<f64> = residual.iter().zip(diagonal).map(|(r, d)| r / d).collect();
    let mut direction = z.clone();
    let mut rz = dot(&residual, &z);
    let enough = TOLERANCE * TOLERANCE * dot(g, g);
    let mut product = vec![0.0; n];
    for _ in 0..ITERATIONS {
        if dot(&residual, &residual) <= enough {
            break;
        }
        rows.multiply(diagonal, &direction, &mut product);
        let curvature = dot(&direction, &product);
        if !(curvature > 0.0 && rz > 0.0) {
            break;
        }
        let along = rz / curvature;
        for i in 0..n {
            s[i] += along * direction[i];
            residual[i] -= along * product[i];
            z[i] = residual[i] / diagonal[i];
        }
        let next = dot(&residual, &z);
        let keep = next / rz;
        rz = next;
        direction.iter_mut().zip(&z).for_each(|(d, z)| *d = z + keep * *d);
    }
    s
}

/// The off-diagonal entries by rows.
struct Rows {
    starts: Vec<usize>,
    entries: Vec<(u32, f64)>,
}

impl Rows {
    fn new(n: usize, rest: &[(u32, u32, f64)]) -> Self {
        let mut starts = vec![0; n + 1];
        for &(i, j, _) in rest {
            starts[i as usize + 1] += 1;
            starts[j as usize + 1] += 1;
        }
        for i in 0..n {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut entries = vec![(0, 0.0); 2 * rest.len()];
        for &(i, j, c) in rest {
            for (a, b) in [(i, j), (j, i)] {
                let at = &mut next[a as usize];
                entries[*at] = (b, c);
                *at += 1;
            }
        }
        Self { starts, entries }
    }

    fn multiply(&self, diagonal: &[f64], x: &[f64], product: &mut [f64]) {
        for i in 0..x.len() {
            let row = &self.entries[self.starts[i]..self.starts[i + 1]];
            product[i] = diagonal[i] * x[i] + row.iter().map(|(j, c)| c * x[*j as usize]).sum::<f64>();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Springs of length 10 between neighbours on a line: one step finds the layout with that spacing.
    #[test]
    fn newton_step_solves_spring_chain() {
        let line_constraint = |fixed: bool| LineConstraint {
            origin: Vector2::zeros(),
            direction: Vector2::new(if fixed { 0.0 } else { 1.0 }, 0.0),
            near: 0.0,
            far: 1000.0,
            prior: 0.0,
        };
        let constraints: Vec<LineConstraint> = (0..60).map(|i| line_constraint(i == 0)).collect();
        let mut t: Vec<f64> = (0..60).map(|i| 11.0 * f64::from(i)).collect();
        for _ in 0..60 {
            let x: Vec<_> = constraints.iter().zip(&t).map(|(r, t)| r.at(*t)).collect();
            let pairs: Vec<PairCost> = (0..59u32)
                .map(|i| {
                    let d = (x[i as usize + 1] - x[i as usize]).norm();
                    PairCost { i, j: i + 1, slope: d - 10.0, curvature: 1.0 }
                })
                .collect();
            step(&constraints, &x, &pairs, &mut t, 50.0);
        }
        for (i, t) in t.iter().enumerate().skip(1) {
            assert!((t - 10.0 * i as f64).abs() < 0.5, "{i}: {t}");
        }
    }
}
