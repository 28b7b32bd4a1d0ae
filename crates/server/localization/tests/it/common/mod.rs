//! A place of random points with random descriptors, seen exactly: the whole server side without an image.
#![allow(dead_code, reason = "each test program uses a part")]
#![expect(unreachable_pub, reason = "a module of each test program, not of the crate")]

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel, PlanePoint, Point3, Rigid3};
use veiloc_map::{BuildSettings, MapFile, MapImage, MapModel, MapPoint, Observation};
use veiloc_obfuscation::SealOptions;
use veiloc_protocol::{Profile, Scheme};

/// Points with descriptors, and the camera that sees them.
pub struct Place {
    pub camera: Intrinsics,
    points: Vec<Point3<World>>,
    descriptors: Vec<[u8; 128]>,
    pub profile: Profile,
}

impl Place {
    pub fn new(seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let n = 1500;
        let points = (0..n)
            .map(|_| {
                Point3::new(
                    rng.random_range(-3.0..3.0),
                    rng.random_range(-2.0..2.0),
                    rng.random_range(4.0..9.0),
                )
            })
            .collect();
        let descriptors: Vec<[u8; 128]> =
            (0..n).map(|_| std::array::from_fn(|_| rng.random_range(0..120))).collect();
        let rows = Descriptors::new(DescriptorKind::ROOT_SIFT, descriptors.concat()).expect("whole rows");
        let vocabulary = Vocabulary::train(rows.view(), 16, &mut rng).expect("enough samples");
        let profile = Profile::vlad(vocabulary);
        let camera = "OPENCV,640,480,520,521,322,238,-0.05,0.01,0.0005,-0.0003".parse().expect("a camera");
        Self { camera, points, descriptors, profile }
    }

    /// What a camera sees: point index and pixel.
    fn seen(&self, pose: &CameraFromWorld) -> Vec<(usize, Pixel)> {
        let inside = |p: &Pixel| p.u > 0.0 && p.v > 0.0 && p.u < 640.0 && p.v < 480.0;
        (0..self.points.len())
            .filter_map(|i| {
                let plane = PlanePoint::from_camera_point(&pose.transform(&self.points[i]))?;
                Some((i, self.camera.project(plane))).filter(|(_, p)| inside(p))
            })
            .collect()
    }

    /// The point's descriptor as one image shows it.
    fn observed(&self, point: usize, rng: &mut impl Rng) -> [u8; 128] {
        self.descriptors[point].map(|d| d.saturating_add(rng.random_range(0..12)))
    }

    /// Eight images that look along `z`, and the points that two of them see.
    pub fn map(&self) -> MapModel {
        let mut rng = ChaCha8Rng::seed_from_u64(99);
        let mut model = MapModel::empty(self.profile.clone(), BuildSettings::default());
        model.cameras.push(self.camera);
        let mut tracks = vec![Vec::new(); self.points.len()];
        for i in 0..8 {
            let pose = pose(f64::from(i) * 0.1 - 0.4, f64::from(i % 3) * 0.3);
            let seen = self.seen(&pose);
            let bytes = seen.iter().flat_map(|(p, _)| self.observed(*p, &mut rng)).collect();
            let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows");
            for (keypoint, (point, _)) in seen.iter().enumerate() {
                tracks[*point].push(Observation { image: i as u32, keypoint: keypoint as u32 });
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

    /// What a device extracts of an image taken here.
    pub fn query(&self, pose: &CameraFromWorld) -> Features {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let seen = self.seen(pose);
        let bytes = seen.iter().flat_map(|(p, _)| self.observed(*p, &mut rng)).collect();
        let keypoint = |(i, (_, pixel)): (usize, &(usize, Pixel))| Keypoint {
            pixel: *pixel,
            scale: 2.0,
            orientation: 0.0,
            response: 1.0 / (1.0 + i as f32),
        };
        Features {
            keypoints: seen.iter().enumerate().map(keypoint).collect(),
            descriptors: Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows"),
            global: None,
        }
    }
}

/// Looking along `z`, turned and moved to the side.
pub fn pose(yaw: f64, shift: f64) -> CameraFromWorld {
    Rigid3::new(Rotation3::from_scaled_axis(Vector3::new(0.05, yaw, -0.02)), Vector3::new(shift, 0.1, 0.4))
}

/// Written and opened again.
pub fn open(model: &MapModel) -> MapFile {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("m.vmap");
    veiloc_map::write(model, &path).expect("written");
    // A mapped file stays readable when its name is gone.
    MapFile::open(&path).expect("a map")
}

/// How a device seals that was told this scheme.
pub fn options(scheme: &str) -> SealOptions {
    match scheme.parse::<Scheme>().expect("a scheme") {
        Scheme::Points => SealOptions::unprotected_points(),
        other => SealOptions::new(other).expect("it hides positions"),
    }
}
