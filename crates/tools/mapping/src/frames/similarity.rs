//! Similarity between two world frames, and its closed-form estimate from poses of the same images in both.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// The similarity from the frame of given poses to the frame of a map, `x_map = s R x_given + t`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Similarity3 {
    /// `s`: length in the map of one unit of the given poses.
    pub scale: f64,
    /// `R`.
    pub rotation: Rotation3<f64>,
    /// `t`, map units.
    pub translation: Vector3<f64>,
}

impl Similarity3 {
    /// The identity.
    pub fn identity() -> Self {
        Self { scale: 1.0, rotation: Rotation3::identity(), translation: Vector3::zeros() }
    }

    /// Transforms a point.
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.scale * (self.rotation * point) + self.translation
    }

    /// Transforms the pose of a camera: its centre as a point, and its orientation.
    pub fn transform_pose(&self, cam_from_given: &CameraFromWorld) -> CameraFromWorld {
        let rotation = cam_from_given.rotation() * self.rotation.inverse();
        let center = self.transform(&cam_from_given.center().coords);
        CameraFromWorld::new(rotation, -(rotation * center))
    }

    /// Angle of the rotation, degrees.
    pub fn angle_deg(&self) -> f64 {
        UnitQuaternion::from_rotation_matrix(&self.rotation).angle().to_degrees()
    }
}

/// The poses of one image in both frames.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PosePair {
    pub(crate) given: CameraFromWorld,
    pub(crate) in_map: CameraFromWorld,
    /// Standard deviation of the centre, map units.
    pub(crate) center_sd: f64,
    /// Standard deviation of the orientation, radians.
    pub(crate) rotation_sd: f64,
}

/// An estimated similarity.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fit {
    pub(crate) map_from_given: Similarity3,
    /// Standard deviation of the scale; `None` if the centres do not determine it, and it is taken as 1.
    pub(crate) scale_sd: Option<f64>,
    /// Standard deviation of the position of the group, map units.
    pub(crate) center_sd: f64,
    /// Standard deviation of the rotation, degrees.
    pub(crate) rotation_sd_deg: f64,
}

/// Estimates the similarity from at least one pair by weighted least squares on centres and orientations: Umeyama's
/// closed form (PAMI 1991), whose covariance matrix of the centres is extended by the relative orientations.
///
/// A single pair, and centres on one line, determine the rotation by their orientations. The scale stays 1 if the
/// centres do not determine it, or if it differs from 1 by less than three standard deviations.
pub(crate) fn fit(pairs: &[PosePair]) -> Fit {
    let weights: Vec<(f64, f64)> =
        pairs.iter().map(|p| (p.center_sd.powi(-2), p.rotation_sd.powi(-2))).collect();
    let of_centers: f64 = weights.iter().map(|(c, _)| c).sum();
    let of_rotations: f64 = weights.iter().map(|(_, r)| r).sum();
    let mean = |center: &dyn Fn(&PosePair) -> Vector3<f64>| -> Vector3<f64> {
        pairs.iter().zip(&weights).map(|(p, (c, _))| center(p) * *c).sum::<Vector3<f64>>() / of_centers
    };
    let given_center = |p: &PosePair| p.given.center().coords;
    let map_center = |p: &PosePair| p.in_map.center().coords;
    let (mean_given, mean_map) = (mean(&given_center), mean(&map_center));
    let mut orientations = Matrix3::zeros();
    let mut centers = Matrix3::zeros();
    let mut spread = 0.0;
    for (pair, (c, r)) in pairs.iter().zip(&weights) {
        orientations += (pair.in_map.rotation().inverse() * pair.given.rotation()).matrix() * *r;
        let (x, y) = (given_center(pair) - mean_given, map_center(pair) - mean_map);
        centers += y * x.transpose() * *c;
        spread += c * x.norm_squared();
    }
    let mut rotation = nearest_rotation(&orientations);
    let scale_sd = spread.sqrt().recip();
    let scale_for = |rotation: &Rotation3<f64>| (rotation.matrix().transpose() * centers).trace() / spread;
    let mut scale = 1.0;
    let mut determined = false;
    for _ in 0..ROUNDS {
        let free = scale_for(&rotation);
        // Also an uncertain scale is better than 1 if it certainly is not 1.
        let differs = free > 0.0 && (free - 1.0).abs() > 3.0 * scale_sd;
        determined = differs || scale_sd < MAX_RELATIVE_SCALE_SD * free;
        scale = if differs { free } else { 1.0 };
        rotation = nearest_rotation(&(orientations + centers * scale));
    }
    let translation = mean_map - scale * (rotation * mean_given);
    Fit {
        map_from_given: Similarity3 { scale, rotation, translation },
        scale_sd: determined.then_some(scale_sd),
        center_sd: of_centers.sqrt().recip(),
        rotation_sd_deg: of_rotations.sqrt().recip().to_degrees(),
    }
}

/// The rotation that maximizes the trace of its transpose times a matrix.
fn nearest_rotation(matrix: &Matrix3<f64>) -> Rotation3<f64> {
    let svd = matrix.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Rotation3::identity() };
    // Singular values are in descending order: a reflection turns the least determined direction.
    let sign = (u * v_t).determinant().signum();
    Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t)
}

/// Alternations between rotation and scale; they change each other little.
const ROUNDS: usize = 4;
/// Standard deviation of the scale relative to the scale, from which the scale is not determined.
const MAX_RELATIVE_SCALE_SD: f64 = 0.1;

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(i: usize, spread: f64) -> CameraFromWorld {
        let a = i as f64;
        let axis = Vector3::new(0.3 * a.sin(), 0.5 * (2.0 * a).cos(), 0.2);
        CameraFromWorld::new(
            Rotation3::from_scaled_axis(axis),
            spread * Vector3::new(a.sin(), (1.7 * a).cos(), (0.6 * a).sin()),
        )
    }

    /// Pairs for a similarity; in the map, centres have a deterministic error of `noise`.
    fn pairs(count: usize, spread: f64, map_from_given: &Similarity3, noise: f64) -> Vec<PosePair> {
        (0..count)
            .map(|i| {
                let given = pose(i, spread);
                let exact = map_from_given.transform_pose(&given);
                let a = 3.1 * i as f64;
                let step = [0.0, 0.0, 0.0, noise * a.sin(), noise * a.cos(), noise * (2.0 * a).sin()];
                PosePair { given, in_map: exact.perturbed(&step), center_sd: 0.01, rotation_sd: 0.001 }
            })
            .collect()
    }

    fn other() -> Similarity3 {
        Similarity3 {
            scale: 2.3,
            rotation: Rotation3::from_scaled_axis(Vector3::new(0.1, 1.0, -0.2)),
            translation: Vector3::new(5.0, -3.0, 7.0),
        }
    }

    #[test]
    fn exact_similarity_is_recovered() {
        for count in [2, 3, 10] {
            let found = fit(&pairs(count, 2.0, &other(), 0.0));
            assert!((found.map_from_given.scale - 2.3).abs() < 1e-9, "{found:?}");
            assert!((found.map_from_given.translation - other().translation).norm() < 1e-8);
            assert!((found.map_from_given.angle_deg() - other().angle_deg()).abs() < 1e-6);
            assert!(found.scale_sd.is_some_and(|sd| sd < 0.01));
        }
    }

    #[test]
    fn error_is_within_standard_deviations() {
        let found = fit(&pairs(8, 2.0, &other(), 0.005));
        let sd = found.scale_sd.unwrap();
        assert!((found.map_from_given.scale - 2.3).abs() < 3.0 * sd, "{found:?}");
        let given = pose(3, 2.0).center().coords;
        let apart = found.map_from_given.transform(&given) - other().transform(&given);
        assert!(apart.norm() < 0.01, "{apart}");
    }

    #[test]
    fn one_pose_determines_everything_but_the_scale() {
        let rigid = Similarity3 { scale: 1.0, ..other() };
        for map_from_given in [rigid, other()] {
            let found = fit(&pairs(1, 2.0, &map_from_given, 0.0));
            assert_eq!((found.scale_sd, found.map_from_given.scale), (None, 1.0));
            let (given, exact) = (pose(0, 2.0), map_from_given.transform_pose(&pose(0, 2.0)));
            let aligned = found.map_from_given.transform_pose(&given);
            assert!(aligned.translation_error(&exact) < 1e-9);
            assert!(aligned.rotation_error_degrees(&exact) < 1e-9);
        }
    }

    #[test]
    fn scale_of_close_centers_is_not_determined() {
        let found = fit(&pairs(5, 0.002, &Similarity3::identity(), 0.004));
        assert_eq!((found.scale_sd, found.map_from_given.scale), (None, 1.0));
        let found = fit(&pairs(5, 2.0, &Similarity3::identity(), 0.004));
        assert!(found.map_from_given.scale == 1.0 && found.scale_sd.is_some(), "{found:?}");
    }
}
