//! Similarity between two world frames, and its closed-form estimate from poses of the same images in both.

use veiloc_geometry::CameraFromWorld;
use veiloc_geometry::nalgebra::{
    DMatrix, DVector, Matrix3, Matrix6, Rotation3, UnitQuaternion, Vector3, Vector6,
};

/// The similarity from the coordinate frame of given poses to the coordinate frame of a map, `x_map = s R x_given + t`.
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

    /// The same rotation and scale, with the translation that fits the mean centre.
    fn through(self, pairs: &[PosePair]) -> Self {
        let apart = |p: &PosePair| p.map_center() - self.scale * (self.rotation * p.given_center());
        let translation = pairs.iter().map(apart).sum::<Vector3<f64>>() / pairs.len() as f64;
        Self { translation, ..self }
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
    /// Inverse of the covariance of the pose in the map.
    pub(crate) information: Matrix6<f64>,
}

impl PosePair {
    /// Step from the pose in the map to the transformed given one.
    fn step(&self, map_from_given: &Similarity3) -> Vector6<f64> {
        Vector6::from(self.in_map.step_to(&map_from_given.transform_pose(&self.given)))
    }

    fn given_center(&self) -> Vector3<f64> {
        self.given.center().coords
    }

    fn map_center(&self) -> Vector3<f64> {
        self.in_map.center().coords
    }

    fn center_weight(&self) -> f64 {
        self.center_sd.powi(-2)
    }

    /// Squared length of that step, in units of the covariance.
    pub(crate) fn squared_distance(&self, map_from_given: &Similarity3) -> f64 {
        let step = self.step(map_from_given);
        step.dot(&(self.information * step)).max(0.0)
    }
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

/// Estimates the similarity from at least one pair: the closed form, refined with the whole covariances of the poses,
/// because errors of centre and orientation are strongly correlated.
///
/// A single pair, and centres on one line, determine the rotation by their orientations. The scale is 1 if the centres
/// do not determine it, or if it differs from 1 by less than three standard deviations.
pub(crate) fn fit(pairs: &[PosePair]) -> Fit {
    let start = closed_form(pairs);
    let rigid = refine(pairs, Similarity3 { scale: 1.0, ..start }.through(pairs), 6);
    let free = (pairs.len() > 1).then(|| refine(pairs, start, 7)).filter(|free| free.scale_sd.is_some());
    let Some(free) = free else { return rigid };
    let (scale, sd) = (free.map_from_given.scale, free.scale_sd.unwrap_or(f64::INFINITY));
    if (scale - 1.0).abs() > 3.0 * sd {
        // Also an uncertain scale is better than 1 if it certainly is not 1.
        free
    } else {
        Fit { scale_sd: (sd < MAX_RELATIVE_SCALE_SD * scale).then_some(sd), ..rigid }
    }
}

/// Umeyama's closed form (PAMI 1991) for isotropic errors, with the relative orientations added to the covariance matrix
/// of the centres.
fn closed_form(pairs: &[PosePair]) -> Similarity3 {
    let of_centers: f64 = pairs.iter().map(PosePair::center_weight).sum();
    let mean = |center: fn(&PosePair) -> Vector3<f64>| -> Vector3<f64> {
        pairs.iter().map(|p| center(p) * p.center_weight()).sum::<Vector3<f64>>() / of_centers
    };
    let (mean_given, mean_map) = (mean(PosePair::given_center), mean(PosePair::map_center));
    let mut orientations = Matrix3::zeros();
    let mut centers = Matrix3::zeros();
    let mut spread = 0.0;
    for pair in pairs {
        orientations +=
            (pair.in_map.rotation().inverse() * pair.given.rotation()).matrix() * pair.rotation_sd.powi(-2);
        let (x, y) = (pair.given_center() - mean_given, pair.map_center() - mean_map);
        centers += y * x.transpose() * pair.center_weight();
        spread += pair.center_weight() * x.norm_squared();
    }
    let mut rotation = nearest_rotation(&orientations);
    let mut scale = 1.0;
    for _ in 0..ROUNDS {
        let free = (rotation.matrix().transpose() * centers).trace() / spread;
        scale = if free.is_finite() && free > 0.0 { free } else { 1.0 };
        rotation = nearest_rotation(&(orientations + centers * scale));
    }
    Similarity3 { scale, rotation, translation: mean_map - scale * (rotation * mean_given) }
}

/// Gauss-Newton from a start: rotation, translation of the mean centre, and with 7 parameters the logarithm of the
/// scale.
fn refine(pairs: &[PosePair], start: Similarity3, parameters: usize) -> Fit {
    let count = pairs.len() as f64;
    let mean: Vector3<f64> = pairs.iter().map(PosePair::given_center).sum::<Vector3<f64>>() / count;
    let stepped = |from: &Similarity3, step: &DVector<f64>| {
        let turn = Rotation3::from_scaled_axis(Vector3::new(step[0], step[1], step[2]));
        let moved = from.transform(&mean) + Vector3::new(step[3], step[4], step[5]);
        let scale = from.scale * step.get(6).map_or(1.0, |log| log.exp());
        let rotation = turn * from.rotation;
        Similarity3 { scale, rotation, translation: moved - scale * (rotation * mean) }
    };
    let cost = |at: &Similarity3| pairs.iter().map(|p| p.squared_distance(at)).sum::<f64>();
    let mut found = start;
    let mut inverse = None;
    for _ in 0..MAX_STEPS {
        let mut normal = DMatrix::zeros(parameters, parameters);
        let mut gradient = DVector::zeros(parameters);
        for pair in pairs {
            let at = pair.step(&found);
            let columns: Vec<Vector6<f64>> = (0..parameters)
                .map(|k| {
                    let mut step = DVector::zeros(parameters);
                    step[k] = DIFFERENCE;
                    (pair.step(&stepped(&found, &step)) - at) / DIFFERENCE
                })
                .collect();
            for (i, a) in columns.iter().enumerate() {
                let weighted = pair.information * a;
                gradient[i] += weighted.dot(&at);
                for (j, b) in columns.iter().enumerate() {
                    normal[(i, j)] += weighted.dot(b);
                }
            }
        }
        let Some(cholesky) = normal.cholesky() else { break };
        let next = stepped(&found, &-cholesky.solve(&gradient));
        inverse = Some(cholesky.inverse());
        let (before, after) = (cost(&found), cost(&next));
        if after.is_nan() || after >= before {
            break;
        }
        found = next;
        if before - after < 1e-6 * (1.0 + before) {
            break;
        }
    }
    let sd = |at: usize| {
        let block = inverse.as_ref().map(|c| Matrix3::from_fn(|i, j| c[(at + i, at + j)]));
        block.map_or(f64::INFINITY, |block| block.symmetric_eigenvalues().max().max(0.0).sqrt())
    };
    let log_scale_sd = inverse.as_ref().filter(|_| parameters == 7).map(|c| c[(6, 6)].sqrt());
    Fit {
        map_from_given: found,
        scale_sd: log_scale_sd.map(|sd| sd * found.scale).filter(|sd| sd.is_finite()),
        center_sd: sd(3),
        rotation_sd_deg: sd(0).to_degrees(),
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
/// Maximum number of Gauss-Newton steps.
const MAX_STEPS: usize = 8;
/// Step of numeric derivatives, radians and map units.
const DIFFERENCE: f64 = 1e-6;
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
                let variances = [1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-4];
                let information = Matrix6::from_diagonal(&Vector6::from(variances.map(f64::recip)));
                let in_map = exact.perturbed(&step);
                PosePair { given, in_map, center_sd: 0.01, rotation_sd: 0.001, information }
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
