//! Accuracy as ARCore states it: radii of 68 % confidence.

use veiloc_geometry::nalgebra::{Matrix2, Matrix3, Matrix6};
use veiloc_protocol::AnswerPose;

use crate::CameraFromAr;

/// How exactly a pose is known, in the axes of the AR world, whose `y` is up.
///
/// As in ARCore's `GeospatialPose`: the true value is within each of them with a probability of 68 %.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Accuracy {
    /// Radius of a circle on the ground, metres.
    pub horizontal: f64,
    /// Up and down, metres.
    pub vertical: f64,
    /// Rotation about the vertical, degrees.
    pub yaw_deg: f64,
}

impl Accuracy {
    /// Of the pose of an answer to a frame; all infinite where the matches leave a direction free.
    ///
    /// `metres_per_unit`: of the map.
    pub fn of_answer(pose: &AnswerPose, cam_from_ar: &CameraFromAr, metres_per_unit: f64) -> Self {
        if !pose.covariance.iter().flatten().all(|c| c.is_finite()) {
            return Self { horizontal: f64::INFINITY, vertical: f64::INFINITY, yaw_deg: f64::INFINITY };
        }
        let ar_from_cam = *cam_from_ar.inverse().rotation().matrix();
        let mut turned = Matrix6::zeros();
        // The centre of the camera moves by the translation's step, turned to the world.
        for (at, unit) in [(0, 1.0), (3, metres_per_unit)] {
            let block = Matrix3::from_fn(|i, j| pose.covariance[at + i][at + j]);
            let block = ar_from_cam * block * ar_from_cam.transpose() * (unit * unit);
            turned.fixed_view_mut::<3, 3>(at, at).copy_from(&block);
        }
        Self::of_covariance(&turned)
    }

    /// From a covariance in the axes of the AR world: rotation (radians), then position (metres).
    pub(crate) fn of_covariance(covariance: &Matrix6<f64>) -> Self {
        let ground =
            Matrix2::new(covariance[(3, 3)], covariance[(3, 5)], covariance[(5, 3)], covariance[(5, 5)]);
        let variances = ground.symmetric_eigenvalues();
        let sd = |variance: f64| variance.max(0.0).sqrt();
        Self {
            horizontal: radius_68([sd(variances[0]), sd(variances[1])]),
            vertical: SDS_68 * sd(covariance[(4, 4)]),
            yaw_deg: SDS_68 * sd(covariance[(1, 1)]).to_degrees(),
        }
    }
}

/// Half-width of the interval that holds 68 % of a normal distribution, in standard deviations.
const SDS_68: f64 = 0.994_457_883_209_753;

/// Radius of the circle that holds 68 % of a normal distribution in the plane.
///
/// With the standard deviations `a`, `b` along its axes, a direction `u` of the unit circle leaves the radius `r` at
/// `ρ(u) = r / |(a cos u, b sin u)|` standard deviations, so that
///
/// ```text
/// P(r) = 1 - 1/2π ∫ exp(-ρ(u)² / 2) du
/// ```
fn radius_68(sds: [f64; 2]) -> f64 {
    /// Points of the integral: it converges as fast as a periodic function allows.
    const POINTS: usize = 64;
    let [a, b] = sds;
    let largest = a.max(b);
    if !(largest > 0.0 && largest.is_finite()) {
        return largest;
    }
    let outside = |r: f64| {
        let beyond = |k: usize| {
            let (sin, cos) = ((k as f64 + 0.5) / POINTS as f64 * std::f64::consts::TAU).sin_cos();
            (-0.5 * (r * r) / ((a * cos).powi(2) + (b * sin).powi(2))).exp()
        };
        (0..POINTS).map(beyond).sum::<f64>() / POINTS as f64
    };
    let (mut low, mut high) = (0.0, 2.0 * largest);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if outside(middle) > 0.32 { low = middle } else { high = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radius_agrees_with_the_known_cases() {
        // Equal deviations: 1 - exp(-r²/2) = 0.68. One of them zero: the interval of one dimension.
        let round = (-2.0 * 0.32_f64.ln()).sqrt();
        assert!((radius_68([1.0, 1.0]) - round).abs() < 1e-9);
        assert!((radius_68([3.0, 3.0]) - 3.0 * round).abs() < 1e-9);
        assert!((radius_68([0.0, 2.0]) - 2.0 * SDS_68).abs() < 2e-3, "{}", radius_68([0.0, 2.0]));
        assert_eq!(radius_68([0.0, 0.0]), 0.0);
        assert_eq!(radius_68([f64::INFINITY, 1.0]), f64::INFINITY);
        // A quarter of a million points of a lattice with the normal weight.
        let (a, b) = (1.0, 0.4);
        let radius = radius_68([a, b]);
        let (mut inside, mut all) = (0.0, 0.0);
        for i in -250..=250 {
            for j in -250..=250 {
                let (x, y) = (f64::from(i) / 50.0, f64::from(j) / 50.0);
                let weight = (-0.5 * (x * x + y * y)).exp();
                all += weight;
                if (a * x).hypot(b * y) <= radius {
                    inside += weight;
                }
            }
        }
        assert!((inside / all - 0.68_f64).abs() < 2e-3, "{}", inside / all);
    }
}
