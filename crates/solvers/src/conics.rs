//! Where two conics of the projective plane meet.
//!
//! A root of a cubic gives a member of their pencil that falls apart into two lines, and each line meets another
//! member in at most two points. Lines and points stay homogeneous, so nothing divides by a small number.

use arrayvec::ArrayVec;
use nalgebra::{Matrix3, Vector3};

use crate::polynomial::{cubic_roots, quadratic_roots};

/// Real common points of two conics given by symmetric matrices, as vectors of about unit length and either sign.
pub(crate) fn intersect(first: &Matrix3<f64>, second: &Matrix3<f64>) -> ArrayVec<Vector3<f64>, 4> {
    let mut points = ArrayVec::new();
    let (Some(d1), Some(d2)) = (unit(first), unit(second)) else { return points };
    let Some((conic, other)) = degenerate_member(&d1, &d2) else { return points };
    let Some(lines) = split(&conic) else { return points };
    for line in lines {
        let (u, v) = basis_of(&line);
        let c = [v.dot(&(other * v)), 2.0 * u.dot(&(other * v)), u.dot(&(other * u))];
        // Both ways round, so that the position `u` at infinity of the first chart is a plain root of the second.
        let one = quadratic_roots(&c).into_iter().filter(|s| s.abs() <= 1.0).map(|s| u * s + v);
        let reversed = quadratic_roots(&[c[2], c[1], c[0]]);
        let two = reversed.into_iter().filter(|s| s.abs() < 1.0).map(|s| u + v * s);
        for point in one.chain(two).take(2) {
            points.push(polished(&d1, &d2, point));
        }
    }
    points
}

fn unit(m: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let norm = m.norm();
    (norm.is_finite() && norm > 0.0).then(|| m / norm)
}

/// The member of the pencil `D1 + γ D2` that splits into the most clearly real lines, and the conic to meet it with.
fn degenerate_member(d1: &Matrix3<f64>, d2: &Matrix3<f64>) -> Option<(Matrix3<f64>, Matrix3<f64>)> {
    let (a1, a2) = (adjugate(d1), adjugate(d2));
    let c = [d1.determinant(), (a1 * d2).trace(), (a2 * d1).trace(), d2.determinant()];
    let reversed = [c[3], c[2], c[1], c[0]];
    let near = cubic_roots(&c).into_iter().filter(|g| g.abs() <= 1.0).map(|g| (d1 + d2 * g, *d2));
    let far = cubic_roots(&reversed).into_iter().filter(|g| g.abs() <= 1.0).map(|g| (d2 + d1 * g, *d1));
    // −adj(C) = p pᵀ for real lines meeting in p: its trace tells how clearly.
    near.chain(far)
        .map(|(conic, other)| (-adjugate(&conic).trace() / conic.norm_squared(), conic, other))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, conic, other)| (conic, other))
}

/// The two lines of a conic of rank two (or one, twice); `None` when they are complex.
fn split(conic: &Matrix3<f64>) -> Option<[Vector3<f64>; 2]> {
    let minus = -adjugate(conic);
    let i = (0..3).max_by(|&i, &j| minus[(i, i)].total_cmp(&minus[(j, j)]))?;
    let size = minus[(i, i)];
    // Rounding may push a double line's zero slightly below zero.
    if !(size > -1e-12 * conic.norm_squared()) {
        return None;
    }
    let meeting = if size > 0.0 { minus.column(i) / size.sqrt() } else { Vector3::zeros() };
    let rank_one = conic + meeting.cross_matrix();
    let at = (0..9).max_by(|&i, &j| rank_one[i].abs().total_cmp(&rank_one[j].abs()))?;
    let (row, column) = (at % 3, at / 3);
    Some([rank_one.row(row).transpose(), rank_one.column(column).into()])
}

/// Two orthonormal directions perpendicular to `line`.
fn basis_of(line: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let mut axis = Vector3::zeros();
    axis[line.iamin()] = 1.0;
    let u = line.cross(&axis);
    let u = u / u.norm().max(f64::MIN_POSITIVE);
    let v = line.cross(&u);
    (u, v / v.norm().max(f64::MIN_POSITIVE))
}

/// Newton's method on both conics and the unit sphere, each step kept only if it lowers what is left.
fn polished(d1: &Matrix3<f64>, d2: &Matrix3<f64>, start: Vector3<f64>) -> Vector3<f64> {
    let residual = |p: &Vector3<f64>| Vector3::new(p.dot(&(d1 * p)), p.dot(&(d2 * p)), 0.0);
    let mut point = start / start.norm().max(f64::MIN_POSITIVE);
    let mut now = residual(&point);
    for _ in 0..4 {
        if now.amax() < 1e-16 {
            break;
        }
        let rows = [2.0 * (d1 * point).transpose(), 2.0 * (d2 * point).transpose(), point.transpose()];
        let Some(inverse) = Matrix3::from_rows(&rows).try_inverse() else { break };
        let next = point - inverse * now;
        let next = next / next.norm().max(f64::MIN_POSITIVE);
        let then = residual(&next);
        if !(then.norm() < now.norm()) {
            break;
        }
        (point, now) = (next, then);
    }
    point
}

fn adjugate(m: &Matrix3<f64>) -> Matrix3<f64> {
    let (r0, r1, r2) = (m.row(0), m.row(1), m.row(2));
    Matrix3::from_columns(&[r1.cross(&r2).transpose(), r2.cross(&r0).transpose(), r0.cross(&r1).transpose()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn a_planted_common_point_is_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let (mut found, total) = (0, 20_000);
        for _ in 0..total {
            let point = Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0_f64)).normalize();
            let mut conic = || {
                let m = Matrix3::from_fn(|_, _| rng.random_range(-1.0..1.0));
                let m = m + m.transpose();
                m - Matrix3::identity() * point.dot(&(m * point))
            };
            let (d1, d2) = (conic(), conic());
            let points = intersect(&d1, &d2);
            found += usize::from(points.iter().any(|p| p.dot(&point).abs() > 1.0 - 1e-12));
        }
        assert!(found * 1000 >= total * 999, "{found} of {total}");
    }
}
