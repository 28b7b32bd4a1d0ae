//! How well the map knows where its points are: the covariance of each, from the keypoints that see it.
//!
//! With the rows `J` of the derivative of all projections by the point, in pixels of each image, and the noise `σ` of a
//! keypoint along each axis,
//!
//! ```text
//! C = (Σ JᵀJ / σ² + I / d²)⁻¹
//! ```
//!
//! `d` is the distance to the farthest image that sees the point. The second term says that a point lies somewhere about
//! as far as it seems to, and nothing else: it bounds the variance along the rays where these are nearly parallel, and is
//! negligible beside any real parallax.
//!
//! # The noise
//! Three keypoints have six coordinates, of which a point takes three: what is left of the residuals is half, and by
//! chance much less. So the noise is that of the whole map, squared residuals over degrees of freedom (`2n − 3` a point),
//! and a point's own residuals move it as far as they can speak: the map counts as [`MAP_FREEDOM`] degrees of freedom.
//!
//! What it does not know: errors of the images' poses and lenses, which points share. They are part of a map's
//! [`Calibration`](crate::Calibration).

use std::sync::OnceLock;

use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Matrix3, RowVector3, Vector2, Vector3};
use veiloc_geometry::{Pixel, Point3};

use super::view::{ImageView, MapFile};
use crate::model::{Observation, PointId};

impl MapFile {
    /// Covariance of a point's position in the world frame, map units squared: finite, symmetric, positive definite.
    ///
    /// Computed from the keypoints of its track when it is first asked for, and kept; poses and cameras are taken for exact.
    /// A compressed map tells what the whole one knew.
    /// It is large along the rays of a point that is seen under a small angle, and never NaN.
    pub fn point_covariance(&self, id: PointId) -> [[f64; 3]; 3] {
        if let Some(remembered) = self.remembered(id) {
            return remembered.covariance();
        }
        let kept =
            self.covariances.get_or_init(|| (0..self.point_count()).map(|_| OnceLock::new()).collect());
        let compute = || {
            let [[xx, xy, xz], [_, yy, yz], [_, _, zz]] = self.covariance_of(&self.point(id), self.track(id));
            [xx, xy, xz, yy, yz, zz]
        };
        // Most matches of queries are of points that earlier ones matched: it took a quarter of the pose stage.
        let [xx, xy, xz, yy, yz, zz] = *kept[id.index()].get_or_init(compute);
        [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    }

    /// Standard deviation of a keypoint of the map along each axis, pixels, as the residuals of its points show it.
    ///
    /// Of up to some thousand points spread over the map; computed when it is first asked for.
    pub fn keypoint_noise_px(&self) -> f64 {
        *self.noise.get_or_init(|| {
            let step = self.point_count().div_ceil(NOISE_POINTS).max(1);
            let (mut squares, mut freedom) = (0.0, 0.0);
            for id in (0..self.point_count()).step_by(step).map(|i| PointId(i as u32)) {
                let sights = self.sights(&self.point(id), self.track(id));
                if sights.count >= 2 && sights.squares.is_finite() {
                    squares += sights.squares;
                    freedom += 2.0 * sights.count as f64 - 3.0;
                }
            }
            let noise = f64::sqrt(squares / freedom);
            // Not of points without a second view, nor exact to the last bit: keypoints are kept as 32-bit numbers.
            if noise.is_finite() { noise.max(LEAST_NOISE_PX) } else { NOISE_UNKNOWN_PX }
        })
    }

    /// [`Self::point_covariance`] of any point and those who see it.
    pub(super) fn covariance_of(
        &self,
        point: &Point3<World>,
        track: impl Iterator<Item = Observation>,
    ) -> [[f64; 3]; 3] {
        let sights = self.sights(point, track);
        let pooled = self.keypoint_noise_px().powi(2);
        let own = (2.0 * sights.count as f64 - 3.0).max(0.0);
        let variance = if own > 0.0 && sights.squares.is_finite() {
            (MAP_FREEDOM * pooled + sights.squares) / (MAP_FREEDOM + own)
        } else {
            pooled
        };
        // A point at the very place of its only camera: one map unit is as good a guess as any.
        let distance = if sights.farthest > 0.0 { sights.farthest } else { 1.0 };
        // In units of the distance, so that no map unit is too small or too large for the numbers.
        let information = sights.information * (distance * distance / variance) + Matrix3::identity();
        let covariance = information.cholesky().map(|c| c.inverse() * (distance * distance));
        match covariance {
            Some(c) if c.iter().all(|v| v.is_finite()) => {
                std::array::from_fn(|i| std::array::from_fn(|j| 0.5 * (c[(i, j)] + c[(j, i)])))
            }
            // Numbers beyond all bounds: nothing is known of the point.
            _ => std::array::from_fn(|i| std::array::from_fn(|j| if i == j { UNBOUNDED } else { 0.0 })),
        }
    }

    fn sights(&self, point: &Point3<World>, track: impl Iterator<Item = Observation>) -> Sights {
        let mut sights = Sights { information: Matrix3::zeros(), squares: 0.0, count: 0, farthest: 0.0 };
        for observation in track {
            let image = self.image(observation.image as usize);
            let in_camera = image.cam_from_world().transform(point).coords;
            sights.farthest = sights.farthest.max(in_camera.norm());
            if let Some((residual, rows)) = sight(&image, observation.keypoint as usize, &in_camera) {
                sights.squares += residual.norm_squared();
                sights.count += 1;
                for row in rows {
                    sights.information += row.transpose() * row;
                }
            }
        }
        sights
    }
}

/// What the keypoints of a track say of a point together.
struct Sights {
    /// `Σ JᵀJ`, pixels² per map unit².
    information: Matrix3<f64>,
    /// Sum of squared residuals, pixels².
    squares: f64,
    /// Keypoints that can see the point.
    count: usize,
    /// Distance of the farthest image, map units.
    farthest: f64,
}

/// Projection minus keypoint in undistorted pixels, and its derivative by the point in the world, row by row, of a point in
/// the camera's frame; `None` behind the camera or where the distortion cannot be undone.
fn sight(
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

/// Degrees of freedom for which the map's noise counts beside a point's own residuals.
const MAP_FREEDOM: f64 = 10.0;
/// Points that the noise is measured on.
const NOISE_POINTS: usize = 2000;
/// Noise never falls below this, pixels.
const LEAST_NOISE_PX: f64 = 1e-3;
/// Noise of a map in which no point has two views, pixels: that of SIFT keypoints.
const NOISE_UNKNOWN_PX: f64 = 1.0;
/// Variance of a point of which nothing is known, map units squared.
const UNBOUNDED: f64 = 1e200;

#[cfg(test)]
mod tests {
    use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
    use veiloc_geometry::nalgebra::{Rotation3, SymmetricEigen};
    use veiloc_geometry::{CameraFromWorld, PlanePoint};
    use veiloc_protocol::Profile;

    use super::*;
    use crate::{BuildSettings, MapImage, MapModel, MapPoint};

    /// Cameras side by side `apart` from each other that look along z, and a point in front of them, seen with this error.
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
    fn parallax_decides_along_the_ray_and_the_distance_across_it() {
        // One pixel of error in v, plus and minus: two degrees of freedom... of six coordinates three are left.
        let shift = |i: usize| [0.0, if i == 1 { 1.0 } else { -0.5 }];
        let wide = map(3, 1.0, [1.0, 0.0, 5.0], shift);
        let sigma = wide.keypoint_noise_px();
        assert!((sigma - (1.5_f64 / 3.0).sqrt()).abs() < 1e-3, "{sigma}");
        let [x, y, z] = deviations(wide.point_covariance(PointId(0)));
        // Across: σ z / (f √3); along: the parallax has a lever of √2 units.
        let across = sigma * 5.0 / 500.0 / 3.0_f64.sqrt();
        assert!((y / across - 1.0).abs() < 0.01 && (x / across - 1.0).abs() < 0.01, "{x} {y} {across}");
        let along = sigma * 25.0 / 500.0 / 2.0_f64.sqrt();
        assert!((z / along - 1.0).abs() < 0.02, "{z} {along}");
        let narrow = map(3, 0.01, [0.01, 0.0, 5.0], shift);
        let [_, _, far] = deviations(narrow.point_covariance(PointId(0)));
        assert!(far > 50.0 * z / 100.0 * 50.0 && far <= 5.1, "{far}");
    }

    #[test]
    fn no_track_gives_what_is_not_a_covariance() {
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
