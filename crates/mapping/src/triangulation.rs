//! A point from the keypoints that may see it.
//!
//! Hypotheses come from pairs of rays (the point nearest to both), are scored by the reprojection errors of all
//! observations (truncated squares, so that outliers cost a constant), and the best is refined on its inliers: Gauss–
//! Newton with Levenberg's damping and Cauchy weights, on the three coordinates only. A point must lie in front of every
//! camera that counts as seeing it, and be seen under a sufficient angle.

use veiloc_geometry::nalgebra::{Matrix3, Vector2, Vector3};

use crate::view::View;

/// One keypoint that may see the point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sight<'a> {
    pub(crate) view: &'a View,
    /// The keypoint on the plane `z = 1`.
    pub(crate) plane: Vector2<f64>,
}

impl Sight<'_> {
    /// Reprojection error, pixels; infinite behind the camera.
    pub(crate) fn error(&self, point: &Vector3<f64>) -> f64 {
        self.view.residual(&self.plane, point).map_or(f64::INFINITY, |r| r.norm())
    }

    /// Whether the keypoint sees the point as far as its position tells.
    pub(crate) fn agrees(&self, point: &Vector3<f64>) -> bool {
        self.error(point) <= self.view.max_error
    }
}

/// A triangulated point.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Triangulated {
    /// Where, in the world.
    pub(crate) position: Vector3<f64>,
    /// `[N]`, which observations agree.
    pub(crate) agree: Vec<bool>,
}

/// The point that most observations agree on; `None` when fewer than `min_sights` do, or only under small angles.
pub(crate) fn triangulate(
    sights: &[Sight<'_>],
    min_sights: usize,
    min_angle_deg: f64,
) -> Option<Triangulated> {
    let min_cos = min_angle_deg.to_radians().cos();
    let mut best: Option<(f64, Vector3<f64>)> = None;
    for (a, b) in pairs(sights.len()) {
        let Some(point) = nearest_to_both_rays(&sights[a], &sights[b]) else { continue };
        if cos_between(&sights[a], &sights[b], &point) > min_cos {
            continue;
        }
        let score = score(sights, &point);
        if best.is_none_or(|(least, _)| score < least) {
            best = Some((score, point));
        }
    }
    let (_, start) = best?;
    settle(sights, start, min_sights, min_angle_deg)
}

/// Refines a point on the observations that agree with it until these no longer change, and checks the result.
pub(crate) fn settle(
    sights: &[Sight<'_>],
    start: Vector3<f64>,
    min_sights: usize,
    min_angle_deg: f64,
) -> Option<Triangulated> {
    let mut position = start;
    let mut agree: Vec<bool> = sights.iter().map(|s| s.agrees(&position)).collect();
    for _ in 0..MAX_ROUNDS {
        let seen: Vec<Sight<'_>> = sights.iter().zip(&agree).filter_map(|(s, a)| a.then_some(*s)).collect();
        if seen.len() < min_sights.max(2) {
            return None;
        }
        position = refine(&seen, position);
        let now: Vec<bool> = sights.iter().map(|s| s.agrees(&position)).collect();
        if now == agree {
            break;
        }
        agree = now;
    }
    let seen: Vec<Sight<'_>> = sights.iter().zip(&agree).filter_map(|(s, a)| a.then_some(*s)).collect();
    let enough = seen.len() >= min_sights.max(2) && widest_angle_deg(&seen, &position) >= min_angle_deg;
    enough.then_some(Triangulated { position, agree })
}

/// The point that minimizes the robust sum of squared reprojection errors, from a start in front of all cameras.
///
/// Never returns a point worse than `start`, or one behind a camera.
pub(crate) fn refine(sights: &[Sight<'_>], start: Vector3<f64>) -> Vector3<f64> {
    let Some(mut cost) = robust_cost(sights, &start) else { return start };
    let mut point = start;
    let mut damping = 1e-6;
    for _ in 0..MAX_STEPS {
        let mut normal = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        for sight in sights {
            let Some((r, rows)) = sight.view.residual_and_rows(&sight.plane, &point) else { return point };
            let weight = cauchy_weight(r.norm_squared(), sight.view.max_error);
            for (value, row) in r.iter().zip(&rows) {
                normal += row * row.transpose() * weight;
                gradient += row * (value * weight);
            }
        }
        // Damping relative to each coordinate's own curvature: the depth of a far point is badly known.
        let mut damped = normal;
        for i in 0..3 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else { return point };
        let next = point - step;
        match robust_cost(sights, &next) {
            Some(lower) if lower <= cost => {
                let done = step.norm() <= 1e-10 * (1.0 + next.norm()) || cost - lower <= 1e-12 * cost;
                (point, cost) = (next, lower);
                damping = f64::max(damping * 0.1, 1e-12);
                if done {
                    break;
                }
            }
            _ => {
                damping = f64::max(damping * 10.0, 1e-3);
                if damping > 1e8 {
                    break;
                }
            }
        }
    }
    point
}

/// The largest angle between two of the rays to a point, degrees.
pub(crate) fn widest_angle_deg(sights: &[Sight<'_>], point: &Vector3<f64>) -> f64 {
    let toward: Vec<Vector3<f64>> = sights.iter().map(|s| (s.view.center - point).normalize()).collect();
    let mut least: f64 = 1.0;
    for (i, a) in toward.iter().enumerate() {
        for b in &toward[i + 1..] {
            least = least.min(a.dot(b));
        }
    }
    least.clamp(-1.0, 1.0).acos().to_degrees()
}

/// The point midway between two rays where they come nearest; `None` when it is not in front of both cameras or the
/// rays are parallel.
pub(crate) fn nearest_to_both_rays(a: &Sight<'_>, b: &Sight<'_>) -> Option<Vector3<f64>> {
    let (d, e) = (a.view.ray(&a.plane), b.view.ray(&b.plane));
    let w = b.view.center - a.view.center;
    let (dd, ee, de) = (d.norm_squared(), e.norm_squared(), d.dot(&e));
    // sin² of the angle between the rays, times dd·ee.
    let determinant = dd * ee - de * de;
    if determinant <= 1e-12 * dd * ee {
        return None;
    }
    let along_a = (ee * d.dot(&w) - de * e.dot(&w)) / determinant;
    let along_b = (de * d.dot(&w) - dd * e.dot(&w)) / determinant;
    if along_a <= 0.0 || along_b <= 0.0 {
        return None;
    }
    let point = (a.view.center + d * along_a + b.view.center + e * along_b) / 2.0;
    (a.view.in_camera(&point).z > 0.0 && b.view.in_camera(&point).z > 0.0).then_some(point)
}

fn cos_between(a: &Sight<'_>, b: &Sight<'_>, point: &Vector3<f64>) -> f64 {
    (a.view.center - point).normalize().dot(&(b.view.center - point).normalize())
}

/// Sum of squared errors in units of each image's threshold, each at most 1.
fn score(sights: &[Sight<'_>], point: &Vector3<f64>) -> f64 {
    sights.iter().map(|s| (s.error(point) / s.view.max_error).powi(2).min(1.0)).sum()
}

/// Cauchy loss with half the inlier threshold as its scale; `None` when the point is not in front of all cameras.
fn robust_cost(sights: &[Sight<'_>], point: &Vector3<f64>) -> Option<f64> {
    sights.iter().try_fold(0.0, |sum, sight| {
        let squared = sight.view.residual(&sight.plane, point)?.norm_squared();
        let scale = (LOSS_SCALE * sight.view.max_error).powi(2);
        Some(sum + scale * (squared / scale).ln_1p())
    })
}

fn cauchy_weight(squared: f64, max_error: f64) -> f64 {
    1.0 / (1.0 + squared / (LOSS_SCALE * max_error).powi(2))
}

/// All pairs of few observations; of many, about [`MAX_PAIRS`] spread over all of them, wide and narrow.
fn pairs(count: usize) -> Vec<(usize, usize)> {
    let all = count * count.saturating_sub(1) / 2;
    if all <= MAX_PAIRS {
        return (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b))).collect();
    }
    // Steps of a golden share of the count give pairs of every distance in the (sorted) track.
    (0..MAX_PAIRS)
        .map(|i| {
            let a = i * count / MAX_PAIRS;
            let gap = 1 + ((i as f64 * 0.618_033_988_749_895).fract() * (count - 1) as f64) as usize;
            let b = (a + gap.min(count - 1)) % count;
            (a.min(b), a.max(b))
        })
        .collect()
}

/// Two-view hypotheses tried for one track.
const MAX_PAIRS: usize = 45;
/// Rounds of choosing inliers and refining on them.
const MAX_ROUNDS: usize = 4;
/// Gauss–Newton steps of one refinement; three or four do, unless the start is poor.
const MAX_STEPS: usize = 20;
/// Scale of the robust loss in units of the inlier threshold.
const LOSS_SCALE: f64 = 0.5;
