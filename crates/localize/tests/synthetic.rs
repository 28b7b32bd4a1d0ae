//! A place of random points with random descriptors, seen exactly: the whole server side without an image.

use rand::{Rng, SeedableRng};
use rand_chacha::{ChaCha8Rng, ChaCha20Rng};
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_features::{Features, Keypoint};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, Pixel, PlanePoint, Point3, Rigid3};
use veiloc_localize::{LocalizeError, LocalizeOptions, localize};
use veiloc_map::{BuildSettings, MapFile, MapImage, MapModel, MapPoint, Observation};
use veiloc_obfuscation::{SealOptions, seal};
use veiloc_query::{Profile, Scheme, SealedQuery};

struct Place {
    camera: Intrinsics,
    points: Vec<Point3<World>>,
    descriptors: Vec<[u8; 128]>,
    profile: Profile,
}

impl Place {
    fn new(seed: u64) -> Self {
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

    fn map(&self) -> MapModel {
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

    fn query(&self, pose: &CameraFromWorld) -> Features {
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
        }
    }
}

fn pose(yaw: f64, shift: f64) -> CameraFromWorld {
    Rigid3::new(Rotation3::from_scaled_axis(Vector3::new(0.05, yaw, -0.02)), Vector3::new(shift, 0.1, 0.4))
}

fn open(model: &MapModel) -> MapFile {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = folder.path().join("m.vmap");
    veiloc_map::write(model, &path).expect("written");
    // A mapped file stays readable when its name is gone.
    MapFile::open(&path).expect("a map")
}

/// How a device seals that was told this scheme.
fn options(scheme: &str) -> SealOptions {
    match scheme.parse::<Scheme>().expect("a scheme") {
        Scheme::Points => SealOptions::unprotected_points(),
        other => SealOptions::new(other).expect("it hides positions"),
    }
}

#[test]
fn every_scheme_finds_the_camera() {
    let place = Place::new(1);
    let map = open(&place.map());
    let truth = pose(0.13, 0.2);
    for (scheme, bound) in [
        ("points", 0.01),
        ("random-lines", 0.02),
        ("dcl", 0.03),
        ("dcl:horizontal", 0.03),
        ("coordinate-permutation", 0.05),
    ] {
        let mut rng = ChaCha20Rng::seed_from_u64(3);
        let options = options(scheme);
        let sealed =
            seal(place.query(&truth), &place.camera, &place.profile, &options, &mut rng).expect("sealed");
        let received = SealedQuery::decode(&sealed.encode()).expect("decodes");
        let found = localize(&received, &map, &LocalizeOptions::default()).expect("localized");
        let error = found.cam_from_world.translation_error(&truth);
        assert!(error < bound, "{scheme}: off by {error}");
        assert!(found.cam_from_world.rotation_error_degrees(&truth) < 0.5, "{scheme}");
        assert!(found.inliers > 100 && found.inliers <= found.matches, "{scheme}: {}", found.inliers);
        let again = localize(&received, &map, &LocalizeOptions::default()).expect("localized");
        assert_eq!(found.cam_from_world, again.cam_from_world, "equal seeds give equal poses");
    }
}

#[test]
fn rows_are_counted_whatever_number_of_points_they_are_matched_to() {
    // Every map point twice, each seen by half of the images, as unfinished tracks leave them: a row has two pairs.
    let place = Place::new(1);
    let whole = place.map();
    let mut halves = whole.clone();
    halves.points = whole
        .points
        .iter()
        .flat_map(|point| {
            let (first, second) = point.track.split_at(point.track.len() / 2);
            [first, second].map(|track| MapPoint { track: track.to_vec(), ..point.clone() })
        })
        .filter(|point| !point.track.is_empty())
        .collect();
    halves.link_keypoints();
    for scheme in ["points", "coordinate-permutation", "dcl"] {
        let options = options(scheme);
        let mut rng = ChaCha20Rng::seed_from_u64(3);
        let sealed = seal(place.query(&pose(0.13, 0.2)), &place.camera, &place.profile, &options, &mut rng)
            .expect("sealed");
        let [once, twice] = [&whole, &halves]
            .map(|map| localize(&sealed, &open(map), &LocalizeOptions::default()).expect("localized"));
        assert!(once.inliers <= once.matches && once.matches <= once.pairs, "{scheme}");
        assert_eq!(twice.matches, once.matches, "{scheme}: rows");
        assert!(twice.inliers <= twice.matches && twice.inliers > 100, "{scheme}: {}", twice.inliers);
        assert!(twice.pairs > once.pairs * 3 / 2, "{scheme}: {} pairs", twice.pairs);
        assert!(twice.inlier_pairs > twice.inliers * 3 / 2, "{scheme}: {} agree", twice.inlier_pairs);
        // The same rows see the same places: what they prove does not double.
        let (once, twice) = (once.confidence.log_evidence, twice.confidence.log_evidence);
        assert!(twice < 1.3 * once, "{scheme}: {twice} in place of {once}");
    }
}

#[test]
fn a_query_for_another_map_is_refused() {
    let (place, other) = (Place::new(1), Place::new(2));
    let map = open(&place.map());
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let sealed =
        seal(other.query(&pose(0.0, 0.0)), &other.camera, &other.profile, &SealOptions::default(), &mut rng)
            .expect("sealed");
    let refused = localize(&sealed, &map, &LocalizeOptions::default()).expect_err("another profile");
    assert!(matches!(refused, LocalizeError::WrongProfile { .. }), "{refused}");
    assert!(refused.to_string().contains("veiloc map profile"), "{refused}");
}

#[test]
fn a_place_never_mapped_is_not_found() {
    // The same vocabulary, but points of another place: matches exist, a pose must not.
    let place = Place::new(1);
    let map = open(&place.map());
    let mut negative = Place::new(2);
    negative.profile = place.profile.clone();
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let options = SealOptions::unprotected_points();
    let query = negative.query(&pose(0.0, 0.0));
    let sealed = seal(query, &negative.camera, &place.profile, &options, &mut rng).expect("sealed");
    let lost = localize(&sealed, &map, &LocalizeOptions::default()).expect_err("nothing agrees");
    assert!(matches!(lost, LocalizeError::NoPose { .. }), "{lost}");
}

#[test]
fn an_empty_map_says_so() {
    let place = Place::new(1);
    let map = open(&MapModel::empty(place.profile.clone(), BuildSettings::default()));
    let mut rng = ChaCha20Rng::seed_from_u64(3);
    let sealed =
        seal(place.query(&pose(0.0, 0.0)), &place.camera, &place.profile, &SealOptions::default(), &mut rng)
            .expect("sealed");
    let refused = localize(&sealed, &map, &LocalizeOptions::default()).expect_err("nothing to find");
    assert!(matches!(refused, LocalizeError::EmptyMap), "{refused}");
}
