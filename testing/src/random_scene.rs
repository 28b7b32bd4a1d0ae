//! A scene of random points with random descriptors and exact observations: tests of the whole server side without
//! images.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel, PlanePoint, Point3, Rigid3};
use veiloc_map::{BuildSettings, MapImage, MapModel, MapPoint, Observation};
use veiloc_protocol::Profile;

/// Points with descriptors, in a box 6 wide, 4 high and 4 to 9 in front of the cameras, and the camera.
pub struct RandomScene {
    /// The camera of all images.
    pub camera: Intrinsics,
    /// The profile of its maps: VLAD.
    pub profile: Profile,
    points: Vec<Point3<World>>,
    descriptors: Vec<[u8; 128]>,
}

impl RandomScene {
    /// A scene with this many points and visual words, and this camera (in the text format of [`Intrinsics`]).
    ///
    /// # Panics
    /// When there are fewer points than words, or the camera's text is invalid.
    pub fn new(seed: u64, points: usize, words: usize, camera: &str) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut within = |a: f64| rng.random_range(-a..a);
        let points_in_world =
            (0..points).map(|_| Point3::new(within(3.0), within(2.0), 6.5 + within(2.5))).collect();
        let descriptors: Vec<[u8; 128]> =
            (0..points).map(|_| std::array::from_fn(|_| rng.random_range(0..120))).collect();
        let rows = Descriptors::new(DescriptorKind::ROOT_SIFT, descriptors.concat()).expect("whole rows");
        let vocabulary = Vocabulary::train(rows.view(), words, &mut rng).expect("enough samples");
        let camera = camera.parse().expect("a camera");
        Self { camera, profile: Profile::vlad(vocabulary), points: points_in_world, descriptors }
    }

    /// The points that a camera sees, with their pixels.
    fn project(&self, pose: &CameraFromWorld) -> Vec<(usize, Pixel)> {
        let size = [self.camera.width, self.camera.height].map(f64::from);
        let inside = |p: &Pixel| p.u > 0.0 && p.v > 0.0 && p.u < size[0] && p.v < size[1];
        (0..self.points.len())
            .filter_map(|i| {
                let plane = PlanePoint::from_camera_point(&pose.transform(&self.points[i]))?;
                Some((i, self.camera.project(plane))).filter(|(_, p)| inside(p))
            })
            .collect()
    }

    /// Descriptors of these points as one image has them.
    fn observed(&self, seen: &[(usize, Pixel)], rng: &mut impl Rng) -> Descriptors {
        let bytes = seen.iter().flat_map(|(p, _)| {
            let noise: [u8; 128] = std::array::from_fn(|_| rng.random_range(0..12));
            std::array::from_fn::<u8, 128, _>(|i| self.descriptors[*p][i].saturating_add(noise[i]))
        });
        Descriptors::new(DescriptorKind::ROOT_SIFT, bytes.collect()).expect("whole rows")
    }

    /// A map of this many images (at most ten) in a row, all looking along `z`, with the points that at least two of
    /// them see.
    ///
    /// # Panics
    /// Never.
    pub fn map(&self, images: u32) -> MapModel {
        let mut rng = ChaCha8Rng::seed_from_u64(99);
        let mut model = MapModel::empty(self.profile.clone(), BuildSettings::default());
        model.cameras.push(self.camera);
        let mut tracks = vec![Vec::new(); self.points.len()];
        for i in 0..images {
            let pose = pose_in_scene(f64::from(i) * 0.1 - 0.05 * f64::from(images), f64::from(i % 3) * 0.3);
            let seen = self.project(&pose);
            let descriptors = self.observed(&seen, &mut rng);
            for (keypoint, (point, _)) in seen.iter().enumerate() {
                tracks[*point].push(Observation { image: i, keypoint: keypoint as u32 });
            }
            model.images.push(MapImage {
                name: format!("{i}.jpg"),
                camera: 0,
                cam_from_world: pose,
                keypoints: seen.iter().map(|(_, p)| [p.u as f32, p.v as f32]).collect(),
                global: self.profile.global_model().of_rows(descriptors.view()).expect("VLAD"),
                descriptors,
                point_of_keypoint: vec![None; seen.len()],
            });
        }
        for (position, track) in self.points.iter().zip(tracks) {
            if track.len() >= 2 {
                model.points.push(MapPoint { position: *position, track, error: 0.5 });
            }
        }
        model.link_keypoints();
        model
    }

    /// The features that a device extracts from an image with this pose.
    ///
    /// # Panics
    /// Never.
    pub fn features(&self, pose: &CameraFromWorld) -> Features {
        let seen = self.project(pose);
        let keypoint = |(i, (_, pixel)): (usize, &(usize, Pixel))| Keypoint {
            pixel: *pixel,
            scale: 2.0,
            orientation: 0.0,
            response: 1.0 / (1.0 + i as f32),
        };
        Features {
            keypoints: seen.iter().enumerate().map(keypoint).collect(),
            descriptors: self.observed(&seen, &mut ChaCha8Rng::seed_from_u64(5)),
            global: None,
        }
    }
}

/// A camera looking along `z`, rotated (radians) and moved to the side.
pub fn pose_in_scene(yaw: f64, shift: f64) -> CameraFromWorld {
    Rigid3::new(Rotation3::from_scaled_axis(Vector3::new(0.05, yaw, -0.02)), Vector3::new(shift, 0.1, 0.4))
}
