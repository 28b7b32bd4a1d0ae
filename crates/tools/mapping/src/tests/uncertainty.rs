//! Tests the stored covariance of a point against the scatter of its triangulation under repeated noise.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::nalgebra::{Matrix3, Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Point3};
use veiloc_map::{BuildSettings, MapFile, MapImage, MapModel, MapPoint, Observation, PointId};
use veiloc_protocol::Profile;
use veiloc_synthetic::problems::normal;

use crate::triangulation::scene::Scene;
use crate::triangulation::triangulate::triangulate;

const NOISE_PX: f64 = 0.4;
const DRAWS: usize = 10;

/// Images on an arc of this many degrees around the points, with keypoints of all points in all images.
fn noisy_map(images: usize, degrees: f64, points: &[Vector3<f64>], rng: &mut ChaCha8Rng) -> MapModel {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![30; 128]).unwrap();
    let profile = Profile::vlad(Vocabulary::new(words).unwrap());
    let mut model = MapModel::empty(profile, BuildSettings::default());
    let camera: Intrinsics = "OPENCV,640,480,500,505,322,238,-0.08,0.02,0.001,-0.0005".parse().unwrap();
    model.cameras.push(camera);
    let mut noise = || NOISE_PX * normal(rng);
    for i in 0..images {
        let a = (i as f64 / (images - 1) as f64 - 0.5) * degrees.to_radians();
        let center = Vector3::new(5.0 * a.sin(), 0.2 * (i % 2) as f64, -5.0 * a.cos());
        let look = Rotation3::look_at_lh(&-center, &Vector3::y());
        let pose = CameraFromWorld::new(look, -(look * center));
        let view = crate::triangulation::view::View::new(camera, pose, &[], 3.0, 3.0);
        let keypoints: Vec<[f32; 2]> = points
            .iter()
            .map(|p| view.pixel_inside(p).expect("all points are in view"))
            .map(|p| [(p.u + noise()) as f32, (p.v + noise()) as f32])
            .collect();
        let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![20; 128 * points.len()]).unwrap();
        model.images.push(MapImage {
            name: format!("{i}.jpg"),
            camera: 0,
            cam_from_world: pose,
            global: model.profile.global_model().of_rows(descriptors.view()).unwrap(),
            point_of_keypoint: vec![None; points.len()],
            keypoints,
            descriptors,
        });
    }
    let scene = Scene::of(&model, &model.settings);
    let triangulated: Vec<MapPoint> = (0..points.len() as u32)
        .map(|k| {
            let track: Vec<(u32, u32)> = (0..images as u32).map(|i| (i, k)).collect();
            let (_, observations) = scene.observations(&track);
            let found = triangulate(&observations, 2, 0.1).expect("all keypoints are inliers");
            let track = track.into_iter().map(|(image, keypoint)| Observation { image, keypoint });
            MapPoint { position: Point3::from_vector(found.position), track: track.collect(), error: 0.5 }
        })
        .collect();
    model.points = triangulated;
    model.link_keypoints();
    model
}

/// Two views and ten, wide and narrow: the scatter of triangulated points equals the stored covariance.
#[test]
fn point_scatter_matches_covariances() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let points: Vec<Vector3<f64>> = (0..200)
        .map(|_| {
            Vector3::new(
                rng.random_range(-1.0..1.0),
                rng.random_range(-0.8..0.8),
                rng.random_range(-0.8..0.8),
            )
        })
        .collect();
    for (images, degrees) in [(2, 20.0), (3, 25.0), (4, 8.0), (10, 40.0)] {
        // Mean over all points and draws of the normalized squared error, in total and along the worst and best
        // determined axes; and shares within 90 %.
        let (mut sum, mut within, mut along) = (0.0, 0, Vector3::zeros());
        for _ in 0..DRAWS {
            let model = noisy_map(images, degrees, &points, &mut rng);
            let map = MapFile::of_model(&model).unwrap();
            for (id, truth) in points.iter().enumerate() {
                let c = map.point_covariance(PointId(id as u32));
                let c = Matrix3::from_fn(|i, j| c[i][j]);
                let error = map.point(PointId(id as u32)).coords - truth;
                let squared = error.dot(&c.cholesky().unwrap().solve(&error));
                (sum, within) = (sum + squared, within + usize::from(squared < 6.251));
                let axes = c.symmetric_eigen();
                let mut order = [0, 1, 2];
                order.sort_by(|a, b| axes.eigenvalues[*a].total_cmp(&axes.eigenvalues[*b]));
                for (k, axis) in order.into_iter().enumerate() {
                    along[k] += axes.eigenvectors.column(axis).dot(&error).powi(2) / axes.eigenvalues[axis];
                }
            }
        }
        let n = (DRAWS * points.len()) as f64;
        let (mean, share, along) = (sum / n, within as f64 / n, along / n);
        // A mean of chi-squared with three degrees of freedom has a standard deviation of √(6/n) = 0.05, with one of
        // √(2/n) = 0.03; the noise of two views is determined to √(2/200) = 0.1 in each of ten draws.
        assert!((mean - 3.0).abs() < 0.4, "{images} views over {degrees}°: {mean}");
        assert!((share - 0.9).abs() < 0.03, "{images} views over {degrees}°: {share}");
        assert!(along.iter().all(|a| (a - 1.0).abs() < 0.15), "{images} views over {degrees}°: {along}");
    }
}
