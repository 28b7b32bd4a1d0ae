//! Robust triangulation of a point from candidate keypoints.
//!
//! Hypotheses come from pairs of rays (the point nearest to both), are scored by the reprojection errors of all
//! observations (truncated squares, so that outliers cost a constant), and the best is refined on its inliers:
//! Gauss–Newton with Levenberg's damping and Cauchy weights, on the three coordinates only. A point must lie in front
//! of every camera that observes it, and be seen under a sufficient angle.

use veiloc_geometry::nalgebra::{Matrix3, Vector2, Vector3};

use crate::triangulation::view::View;

/// One keypoint that may observe the point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ViewObservation<'a> {
    pub(crate) view: &'a View,
    /// The keypoint on the plane `z = 1`.
    pub(crate) plane: Vector2<f64>,
}

impl ViewObservation<'_> {
    /// Reprojection error, pixels; infinite behind the camera.
    pub(crate) fn error(&self, point: &Vector3<f64>) -> f64 {
        self.view.residual(&self.plane, point).map_or(f64::INFINITY, |r| r.norm())
    }

    /// Returns whether the keypoint is an inlier of the point.
    pub(crate) fn agrees(&self, point: &Vector3<f64>) -> bool {
        self.error(point) <= self.view.max_error
    }
}

/// A triangulated point.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Triangulated {
    /// Where, in the world.
    pub(crate) position: Vector3<f64>,
    /// `[N]`, which observations are inliers.
    pub(crate) agree: Vec<bool>,
}

/// Returns the point with the most inliers; `None` if there are fewer than `min_observations`, or only small angles.
pub(crate) fn triangulate(
    observations: &[ViewObservation<'_>],
    min_observations: usize,
    min_angle_deg: f64,
) -> Option<Triangulated> {
    let min_cos = min_angle_deg.to_radians().cos();
    let mut best: Option<(f64, Vector3<f64>)> = None;
    for (a, b) in pairs(observations.len()) {
        let Some(point) = nearest_to_both_rays(&observations[a], &observations[b]) else { continue };
        if cos_between(&observations[a], &observations[b], &point) > min_cos {
            continue;
        }
        let score = score(observations, &point);
        if best.is_none_or(|(lowest, _)| score < lowest) {
            best = Some((score, point));
        }
    }
    let (_, start) = best?;
    refine_inliers(observations, start, min_observations, min_angle_deg)
}

/// Refines a point and its inlier set until the set no longer changes, and checks the result.
pub(crate) fn refine_inliers(
    observations: &[ViewObservation<'_>],
    start: Vector3<f64>,
    min_observations: usize,
    min_angle_deg: f64,
) -> Option<Triangulated> {
    let mut position = start;
    let mut agree: Vec<bool> = observations.iter().map(|s| s.agrees(&position)).collect();
    for _ in 0..MAX_ROUNDS {
        let seen: Vec<ViewObservation<'_>> =
            observations.iter().zip(&agree).filter_map(|(s, a)| a.then_some(*s)).collect();
        if seen.len() < min_observations.max(2) {
            return None;
        }
        position = refine(&seen, position);
        let now: Vec<bool> = observations.iter().map(|s| s.agrees(&position)).collect();
        if now == agree {
            break;
        }
        agree = now;
    }
    let seen: Vec<ViewObservation<'_>> =
        observations.iter().zip(&agree).filter_map(|(s, a)| a.then_some(*s)).collect();
    let enough = seen.len() >= min_observations.max(2) && widest_angle_deg(&seen, &position) >= min_angle_deg;
    enough.then_some(Triangulated { position, agree })
}

/// Minimizes the robust sum of squared reprojection errors, from a start in front of all cameras.
///
/// Never returns a point worse than `start`, or one behind a camera.
pub(crate) fn refine(observations: &[ViewObservation<'_>], start: Vector3<f64>) -> Vector3<f64> {
    let Some(mut cost) = robust_cost(observations, &start) else { return start };
    let mut point = start;
    let mut damping = 1e-6;
    for _ in 0..MAX_STEPS {
        let mut normal = Matrix3::zeros();
        let mut gradient = Vector3::zeros();
        for observation in observations {
            let Some((r, rows)) = observation.view.residual_and_rows(&observation.plane, &point) else {
                return point;
            };
            let weight = cauchy_weight(r.norm_squared(), observation.view.max_error);
            for (value, row) in r.iter().zip(&rows) {
                normal += row * row.transpose() * weight;
                gradient += row * (value * weight);
            }
        }
        // Damping is relative to each coordinate's curvature: the depth of a distant point is poorly determined.
        let mut damped = normal;
        for i in 0..3 {
            damped[(i, i)] *= 1.0 + damping;
        }
        let Some(step) = damped.cholesky().map(|c| c.solve(&gradient)) else { return point };
        let next = point - step;
        match robust_cost(observations, &next) {
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
pub(crate) fn widest_angle_deg(observations: &[ViewObservation<'_>], point: &Vector3<f64>) -> f64 {
    let toward: Vec<Vector3<f64>> =
        observations.iter().map(|s| (s.view.center - point).normalize()).collect();
    let mut min_cos: f64 = 1.0;
    for (i, a) in toward.iter().enumerate() {
        for b in &toward[i + 1..] {
            min_cos = min_cos.min(a.dot(b));
        }
    }
    min_cos.clamp(-1.0, 1.0).acos().to_degrees()
}

/// Returns the midpoint of the shortest segment between two rays; `None` if it is not in front of both cameras or the
/// rays are parallel.
pub(crate) fn nearest_to_both_rays(a: &ViewObservation<'_>, b: &ViewObservation<'_>) -> Option<Vector3<f64>> {
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

fn cos_between(a: &ViewObservation<'_>, b: &ViewObservation<'_>, point: &Vector3<f64>) -> f64 {
    (a.view.center - point).normalize().dot(&(b.view.center - point).normalize())
}

/// Sum of squared errors in units of each image's threshold, each at most 1.
fn score(observations: &[ViewObservation<'_>], point: &Vector3<f64>) -> f64 {
    observations.iter().map(|s| (s.error(point) / s.view.max_error).powi(2).min(1.0)).sum()
}

/// Cauchy loss with half the inlier threshold as its scale; `None` when the point is not in front of all cameras.
fn robust_cost(observations: &[ViewObservation<'_>], point: &Vector3<f64>) -> Option<f64> {
    observations.iter().try_fold(0.0, |sum, observation| {
        let squared = observation.view.residual(&observation.plane, point)?.norm_squared();
        let scale = (LOSS_SCALE * observation.view.max_error).powi(2);
        Some(sum + scale * (squared / scale).ln_1p())
    })
}

fn cauchy_weight(squared: f64, max_error: f64) -> f64 {
    1.0 / (1.0 + squared / (LOSS_SCALE * max_error).powi(2))
}

/// All pairs of few observations; for many, about [`MAX_PAIRS`] with wide and narrow baselines, spread over all
/// observations.
fn pairs(count: usize) -> Vec<(usize, usize)> {
    let all = count * count.saturating_sub(1) / 2;
    if all <= MAX_PAIRS {
        return (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b))).collect();
    }
    // Steps of the golden ratio of the count give pairs of every distance in the (sorted) track.
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
/// Rounds of inlier selection and refinement.
const MAX_ROUNDS: usize = 4;
/// Maximum number of Gauss–Newton steps; three or four suffice unless the start is poor.
const MAX_STEPS: usize = 20;
/// Scale of the robust loss in units of the inlier threshold.
const LOSS_SCALE: f64 = 0.5;

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use proptest::prelude::*;
    use proptest::test_runner::TestRunner;
    use veiloc_geometry::nalgebra::Rotation3;
    use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel};

    use super::*;

    /// A camera at `center` that looks approximately at the origin of the world.
    fn view(center: Vector3<f64>, roll: f64) -> View {
        let camera: Intrinsics = "PINHOLE,640,480,500,510,320,240".parse().unwrap();
        let look = Rotation3::look_at_lh(&-center, &Vector3::new(roll.sin(), roll.cos(), 0.3));
        View::new(camera, CameraFromWorld::new(look, -(look * center)), &[], 3.0, 3.0)
    }

    /// Cameras on an arc around the origin.
    fn arc(count: usize, degrees: f64) -> Vec<View> {
        let step = degrees.to_radians() / (count.max(2) - 1) as f64;
        (0..count)
            .map(|i| {
                let a = i as f64 * step - degrees.to_radians() / 2.0;
                view(Vector3::new(5.0 * a.sin(), 0.4 * (i % 3) as f64, -5.0 * a.cos()), 0.1 * i as f64)
            })
            .collect()
    }

    /// The keypoint of a point, shifted by some pixels.
    fn observation<'a>(view: &'a View, point: &Vector3<f64>, shift: [f64; 2]) -> ViewObservation<'a> {
        let x = view.in_camera(point);
        let pinhole = view.camera.pinhole();
        let pixel = pinhole.project(veiloc_geometry::PlanePoint::new(x.x / x.z, x.y / x.z));
        let plane = pinhole.unproject(Pixel::new(pixel.u + shift[0], pixel.v + shift[1]));
        ViewObservation { view, plane: Vector2::new(plane.x, plane.y) }
    }

    fn noise(i: usize, size: f64) -> [f64; 2] {
        [size * (i as f64 * 1.7).sin(), size * (i as f64 * 2.9).cos()]
    }

    const POINT: Vector3<f64> = Vector3::new(0.3, -0.2, 0.5);

    #[test]
    fn exact_rays_triangulate_exactly() {
        for count in [2, 3, 10, 40] {
            let views = arc(count, 30.0);
            let observations: Vec<ViewObservation<'_>> =
                views.iter().map(|v| observation(v, &POINT, [0.0; 2])).collect();
            let found = triangulate(&observations, 2, 1.5).unwrap();
            assert!((found.position - POINT).norm() < 1e-9);
            assert!(found.agree.iter().all(|a| *a));
        }
    }

    #[test]
    fn noise_error_matches_covariance() {
        let views = arc(12, 40.0);
        let observations: Vec<ViewObservation<'_>> =
            views.iter().enumerate().map(|(i, v)| observation(v, &POINT, noise(i, 0.5))).collect();
        let found = triangulate(&observations, 2, 1.5).unwrap();
        // Half a pixel at f = 500 and 5 units is 5 mm; with a 40 degree arc the depth is hardly worse.
        assert!((found.position - POINT).norm() < 0.01, "{}", (found.position - POINT).norm());
    }

    #[test]
    fn half_of_the_keypoints_may_be_outliers() {
        let views = arc(12, 40.0);
        let wrong = |i: usize| i % 2 == 1;
        let observations: Vec<ViewObservation<'_>> = views
            .iter()
            .enumerate()
            .map(|(i, v)| observation(v, &POINT, if wrong(i) { noise(3 * i, 60.0) } else { noise(i, 0.3) }))
            .collect();
        let found = triangulate(&observations, 2, 1.5).unwrap();
        assert!((found.position - POINT).norm() < 0.01);
        assert!(found.agree.iter().enumerate().all(|(i, a)| *a != wrong(i)));
    }

    #[test]
    fn points_behind_cameras_or_at_small_angles_are_rejected() {
        let two = [-0.04, 0.04].map(|x| view(Vector3::new(x, 0.0, -5.0), 0.0));
        let observations: Vec<ViewObservation<'_>> =
            two.iter().map(|v| observation(v, &POINT, [0.0; 2])).collect();
        assert!(triangulate(&observations, 2, 1.5).is_none(), "0.08 units at 5.5 are 0.83 degrees");
        assert!(triangulate(&observations, 2, 0.5).is_some());
        // Rays that intersect behind the cameras.
        let views = arc(2, 30.0);
        let behind = Vector3::new(0.0, 0.0, -20.0);
        let observations: Vec<ViewObservation<'_>> =
            views.iter().map(|v| observation(v, &behind, [0.0; 2])).collect();
        assert!(triangulate(&observations, 2, 1.5).is_none());
        assert!(triangulate(&observations[..1], 1, 1.5).is_none());
        assert!(triangulate(&[], 0, 0.0).is_none());
        // Two views at the same position.
        let same = [views[0].clone(), views[0].clone()];
        let observations: Vec<ViewObservation<'_>> =
            same.iter().map(|v| observation(v, &POINT, [0.0; 2])).collect();
        assert!(triangulate(&observations, 2, 0.0).is_none());
    }

    #[test]
    fn jacobian_matches_finite_differences() {
        let h = 1e-6;
        for v in arc(5, 60.0) {
            let s = observation(&v, &POINT, [3.0, -2.0]);
            let (r, rows) = v.residual_and_rows(&s.plane, &POINT).unwrap();
            assert!((r - v.residual(&s.plane, &POINT).unwrap()).norm() < 1e-12);
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = h;
                let ahead = v.residual(&s.plane, &(POINT + step)).unwrap();
                let behind = v.residual(&s.plane, &(POINT - step)).unwrap();
                let numeric = (ahead - behind) / (2.0 * h);
                assert!((numeric - Vector2::new(rows[0][axis], rows[1][axis])).norm() < 1e-4);
            }
        }
    }

    #[test]
    fn refinement_reaches_a_local_minimum() {
        let views = arc(7, 25.0);
        let observations: Vec<ViewObservation<'_>> =
            views.iter().enumerate().map(|(i, v)| observation(v, &POINT, noise(i, 2.0))).collect();
        let end = refine(&observations, POINT + Vector3::new(0.05, -0.03, 0.1));
        let cost = robust_cost(&observations, &end).unwrap();
        for axis in 0..3 {
            for h in [-1e-4, 1e-4] {
                let mut step = Vector3::zeros();
                step[axis] = h;
                assert!(robust_cost(&observations, &(end + step)).unwrap() >= cost);
            }
        }
    }

    #[test]
    fn pairs_are_valid_and_bounded() {
        for count in 0..200 {
            let all = pairs(count);
            assert!(all.iter().all(|(a, b)| a < b && *b < count), "{count}");
            assert!(all.len() <= MAX_PAIRS);
            assert!(count < 2 || !all.is_empty());
        }
    }

    /// For any keypoints, a returned point is finite, in front of its cameras, and its inliers are as reported.
    /// Keypoints have small and large errors, so that both outcomes occur.
    #[test]
    fn triangulated_points_satisfy_their_contract() {
        let shift = |limit: f64| (-limit..limit, -limit..limit);
        let shifts = prop::collection::vec(prop_oneof![shift(1.0), shift(400.0)], 2..9);
        let [returned, none] = [const { Cell::new(0) }; 2];
        let holds = |shifts: Vec<(f64, f64)>| {
            let views = arc(shifts.len(), 35.0);
            let observations: Vec<ViewObservation<'_>> =
                views.iter().zip(&shifts).map(|(v, (u, w))| observation(v, &POINT, [*u, *w])).collect();
            if let Some(found) = triangulate(&observations, 2, 1.5) {
                let seen: Vec<ViewObservation<'_>> =
                    observations.iter().zip(&found.agree).filter_map(|(s, a)| a.then_some(*s)).collect();
                prop_assert!(seen.len() >= 2);
                prop_assert!(found.position.iter().all(|c| c.is_finite()));
                prop_assert!(widest_angle_deg(&seen, &found.position) >= 1.5);
                returned.set(returned.get() + 1);
            } else {
                none.set(none.get() + 1);
            }
            Ok(())
        };
        TestRunner::new(ProptestConfig {
            cases: 256,
            failure_persistence: None,
            ..ProptestConfig::default()
        })
        .run(&shifts, holds)
        .unwrap();
        assert!(returned.get() >= 50 && none.get() >= 10, "{} returned, {} not", returned.get(), none.get());
    }
}
