//! Uncertainty of map points: the covariance of each, from its observations.
//!
//! With the Jacobian rows `J` of all projections with respect to the point, in pixels of each image, and the keypoint
//! noise `σ` along each axis,
//!
//! ```text
//! C = (Σ JᵀJ / σ² + I / d²)⁻¹
//! ```
//!
//! `d` is the distance to the farthest observing image. The second term is a weak prior: the point lies somewhere
//! within about this distance. It bounds the variance along nearly parallel rays, and is negligible when there is
//! parallax.
//!
//! # The noise
//! Three keypoints have six coordinates, and a point takes three degrees of freedom: the remaining residuals are half
//! of the noise on average, and by chance much less. So the noise is pooled over the whole map (squared residuals
//! over degrees of freedom, `2n − 3` per point), and a point's own residuals are combined with it: the pooled noise
//! counts as [`MAP_FREEDOM`] degrees of freedom.
//!
//! The covariance does not include errors of poses and intrinsics, which points share. These are part of the
//! [`CovarianceCalibration`](crate::CovarianceCalibration) of a map.

use std::sync::OnceLock;

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, RowVector3, Vector2, Vector3};
use veiloc_geometry::{Pixel, Point3};

use super::view::{ImageView, MapFile};
use crate::model::{Observation, PointId};

impl MapFile {
    /// Covariance of a point's position in the world frame, map units squared: finite, symmetric, positive definite.
    ///
    /// Computed from the track on first use, and cached; poses and cameras are assumed exact. A compressed map
    /// returns the covariance of the whole map. The covariance is large along the rays of a point with little
    /// parallax, and never NaN.
    pub fn point_covariance(&self, id: PointId) -> [[f64; 3]; 3] {
        if let Some(summary) = self.point_summary(id) {
            return summary.covariance();
        }
        let cache =
            self.covariances.get_or_init(|| (0..self.point_count()).map(|_| OnceLock::new()).collect());
        let compute = || {
            let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = self.covariance_of(&self.point(id), self.track(id));
            [xx, xy, xz, yy, yz, zz]
        };
        // Most matched points were matched by earlier queries too: without the cache this took a quarter of the pose
        // stage.
        let [xx, xy, xz, yy, yz, zz] = *cache[id.index()].get_or_init(compute);
        [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    }

    /// Standard deviation of keypoints along each axis, pixels, estimated from the residuals.
    ///
    /// Uses up to [`NOISE_POINTS`] points spread over the map; computed on first use.
    pub fn keypoint_noise_px(&self) -> f64 {
        *self.noise.get_or_init(|| {
            let step = self.point_count().div_ceil(NOISE_POINTS).max(1);
            let (mut squares, mut freedom) = (0.0, 0.0);
            for id in (0..self.point_count()).step_by(step).map(|i| PointId(i as u32)) {
                let residuals = self.residuals(&self.point(id), self.track(id));
                if residuals.count >= 2 && residuals.squares.is_finite() {
                    squares += residuals.squares;
                    freedom += 2.0 * residuals.count as f64 - 3.0;
                }
            }
            let noise = f64::sqrt(squares / freedom);
            // Single-view points have no residuals, and keypoints are stored as 32-bit floats, so the noise has a
            // lower bound.
            if noise.is_finite() { noise.max(MIN_NOISE_PX) } else { DEFAULT_NOISE_PX }
        })
    }

    /// [`Self::point_covariance`] for any position and track.
    pub(super) fn covariance_of(
        &self,
        point: &Point3<World>,
        track: impl Iterator<Item = Observation>,
    ) -> [[f64; 3]; 3] {
        let residuals = self.residuals(point, track);
        let pooled = self.keypoint_noise_px().powi(2);
        let own = (2.0 * residuals.count as f64 - 3.0).max(0.0);
        let variance = if own > 0.0 && residuals.squares.is_finite() {
            (MAP_FREEDOM * pooled + residuals.squares) / (MAP_FREEDOM + own)
        } else {
            pooled
        };
        // A point at the centre of its only camera: one map unit is an arbitrary choice.
        let distance = if residuals.farthest > 0.0 { residuals.farthest } else { 1.0 };
        // In units of the distance, so that the result does not depend on the map unit.
        let information = residuals.information * (distance * distance / variance) + Matrix3::identity();
        let covariance = information.cholesky().map(|c| c.inverse() * (distance * distance));
        match covariance {
            Some(c) if c.iter().all(|v| v.is_finite()) => {
                std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (c[(i, j)] + c[(j, i)])))
            }
            // Overflow: the point is unconstrained.
            _ => std::array::from_fn(|i| std::array::from_fn(|j| if i == j { UNBOUNDED } else { 0.0 })),
        }
    }

    fn residuals(&self, point: &Point3<World>, track: impl Iterator<Item = Observation>) -> TrackResiduals {
        let mut residuals =
            TrackResiduals { information: Matrix3::zeros(), squares: 0.0, count: 0, farthest: 0.0 };
        for observation in track {
            let image = self.image(observation.image as usize);
            let in_camera = image.cam_from_world().transform(point).coords;
            residuals.farthest = residuals.farthest.max(in_camera.norm());
            if let Some((residual, rows)) =
                linearize_observation(&image, observation.keypoint as usize, &in_camera)
            {
                residuals.squares += residual.norm_squared();
                residuals.count += 1;
                for row in rows {
                    residuals.information += row.transpose() * row;
                }
            }
        }
        residuals
    }
}

/// Accumulated normal equations of a track.
struct TrackResiduals {
    /// `Σ JᵀJ`, pixels² per map unit².
    information: Matrix3<f64>,
    /// Sum of squared residuals, pixels².
    squares: f64,
    /// Number of observations in front of their cameras.
    count: usize,
    /// Distance of the farthest image, map units.
    farthest: f64,
}

/// Residual (projection minus keypoint, undistorted pixels) and its Jacobian rows with respect to the point in the
/// world, for a point `x` in the camera frame; `None` behind the camera or where undistortion fails.
fn linearize_observation(
    image: &ImageView<'_>,
    keypoint: usize,
    x: &Vector3<f64>,
) -> Option<(Vector2<f64>, [RowVector3<f64>; 2])> {
    if x.z <= 0.0 {
        return None;
    }
    let [u, v] = image.keypoints()[keypoint];
    let observed = image.camera().unproject(Pixel::new(f64::from(u), f64::from(v)))?;
    let r = image.cam_from_world().rotation().matrix();
    let focal = image.camera().pinhole().focal;
    let p = [x.x / x.z, x.y / x.z];
    let row = |i: usize| (r.row(i) - r.row(2) * p[i]) * (focal[i] / x.z);
    let residual = Vector2::new((p[0] - observed.x) * focal[0], (p[1] - observed.y) * focal[1]);
    Some((residual, [row(0), row(1)]))
}

/// Degrees of freedom that the pooled noise counts for.
const MAP_FREEDOM: f64 = 10.0;
/// Maximum number of points for the noise estimate.
const NOISE_POINTS: usize = 2000;
/// Lower bound of the noise, pixels.
const MIN_NOISE_PX: f64 = 1e-3;
/// Default noise if no point has two views, pixels: that of SIFT keypoints.
const DEFAULT_NOISE_PX: f64 = 1.0;
/// Variance of an unconstrained point, map units squared.
const UNBOUNDED: f64 = 1e200;

#[cfg(test)]
mod tests {
    use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
    use veiloc_geometry::nalgebra::{Rotation3, SymmetricEigen};
    use veiloc_geometry::{CameraFromWorld, PlanePoint};
    use veiloc_protocol::Profile;

    use super::*;
    use crate::{BuildSettings, MapImage, MapModel, MapPoint};

    /// Cameras in a row with spacing `apart` that look along z, and a point in front of them, observed with these
    /// errors.
    fn map(cameras: usize, apart: f64, point: [f64; 3], shift: impl Fn(usize) -> [f64; 2]) -> MapFile {
        let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![30; 128]).unwrap();
        let profile = Profile::vlad(Vocabulary::new(words).unwrap());
        let mut model = MapModel::empty(profile, BuildSettings::default());
        model.cameras.push("PINHOLE,640,480,500,500,320,240".parse().unwrap());
        let position = Point3::<World>::new(point[0], point[1], point[2]);
        for i in 0..cameras {
            let pose = CameraFromWorld::new(Rotation3::identity(), Vector3::new(-apart * i as f64, 0.0, 0.0));
            let plane = PlanePoint::from_camera_point(&pose.transform(&position));
            let pixel = model.cameras[0].project(plane.unwrap_or(PlanePoint::new(0.0, 0.0)));
            let [du, dv] = shift(i);
            let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![20; 128]).unwrap();
            model.images.push(MapImage {
                name: format!("{i}.jpg"),
                camera: 0,
                cam_from_world: pose,
                keypoints: vec![[(pixel.u + du) as f32, (pixel.v + dv) as f32]],
                global: model.profile.global_model().of_rows(descriptors.view()).unwrap(),
                descriptors,
                point_of_keypoint: vec![None],
            });
        }
        let track = (0..cameras as u32).map(|image| Observation { image, keypoint: 0 }).collect();
        model.points.push(MapPoint { position, track, error: 0.5 });
        model.link_keypoints();
        MapFile::of_model(&model).unwrap()
    }

    fn deviations(covariance: [[f64; 3]; 3]) -> [f64; 3] {
        [0, 1, 2].map(|k| covariance[k][k].sqrt())
    }

    #[test]
    fn covariance_matches_parallax_and_distance() {
        // Errors in v only. Of six coordinates three degrees of freedom remain.
        let shift = |i: usize| [0.0, if i == 1 { 1.0 } else { -0.5 }];
        let wide = map(3, 1.0, [1.0, 0.0, 5.0], shift);
        let sigma = wide.keypoint_noise_px();
        assert!((sigma - (1.5_f64 / 3.0).sqrt()).abs() < 1e-3, "{sigma}");
        let [x, y, z] = deviations(wide.point_covariance(PointId(0)));
        // Across the ray: σ z / (f √3); along: the baseline is √2 units.
        let across = sigma * 5.0 / 500.0 / 3.0_f64.sqrt();
        assert!((y / across - 1.0).abs() < 0.01 && (x / across - 1.0).abs() < 0.01, "{x} {y} {across}");
        let along = sigma * 25.0 / 500.0 / 2.0_f64.sqrt();
        assert!((z / along - 1.0).abs() < 0.02, "{z} {along}");
        let narrow = map(3, 0.01, [0.01, 0.0, 5.0], shift);
        let [_, _, far] = deviations(narrow.point_covariance(PointId(0)));
        assert!(far > 50.0 * z / 100.0 * 50.0 && far <= 5.1, "{far}");
    }

    #[test]
    fn covariance_is_valid_for_degenerate_tracks() {
        let none = |_: usize| [0.0, 0.0];
        for (cameras, apart, point) in [
            (1, 0.0, [0.0, 0.0, 5.0]),
            (3, 0.0, [0.0, 0.0, 5.0]),
            (2, 1e-9, [0.0, 0.0, 1e9]),
            (2, 1.0, [0.0, 0.0, -3.0]),
            (1, 0.0, [0.0, 0.0, 0.0]),
            (2, 1.0, [1e150, -1e150, 1e150]),
            (2, 1e-20, [0.0, 0.0, 1e-20]),
            (2, 1e300, [1e300, 0.0, 1e300]),
        ] {
            let map = map(cameras, apart, point, none);
            let c = map.point_covariance(PointId(0));
            assert!(c.iter().flatten().all(|v| v.is_finite()), "{cameras} {apart} {point:?} {c:?}");
            let m = Matrix3::from_fn(|i, j| c[i][j]);
            assert_eq!(m, m.transpose());
            let scale = m.diagonal().max();
            assert!(scale > 0.0 && SymmetricEigen::new(m / scale).eigenvalues.min() > -1e-9, "{c:?}");
        }
    }
}
