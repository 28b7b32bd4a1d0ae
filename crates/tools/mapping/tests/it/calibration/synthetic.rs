//! Self-tests of a scene with known points: a left-out image has no influence, and broken maps fail.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::frames::World;
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics, PlanePoint, Point3, Rigid3};
use veiloc_map::{BuildSettings, MapImage, MapModel, MapPoint, Observation, PointEvidence};
use veiloc_mapping::calibration::{
    SelfTest, SelfTestOptions, chosen, self_test, self_test_compressed, smallest_within, summarize_trials,
    trials,
};
use veiloc_mapping::{CompressOptions, MapWarning, compress};
use veiloc_protocol::{Profile, Scheme};
use veiloc_synthetic::problems::normal;

const IMAGES: usize = 10;
const NOISE_PX: f64 = 0.4;

fn camera() -> Intrinsics {
    "OPENCV,640,480,520,521,322,238,-0.05,0.01,0.0005,-0.0003".parse().expect("a camera")
}

fn pose(image: usize) -> CameraFromWorld {
    let (yaw, shift) = (image as f64 * 0.06 - 0.3, (image % 3) as f64 * 0.3);
    Rigid3::new(
        Rotation3::from_scaled_axis(Vector3::new(0.05, yaw, -0.02)),
        Vector3::new(shift - 5.0 * yaw, 0.1, 0.4),
    )
}

/// Random points with random descriptors, observed with noise; the points themselves are exact.
fn known_map() -> MapModel {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let points: Vec<Point3<World>> = (0..900)
        .map(|_| {
            let mut within = |low: f64, high: f64| rng.random_range(low..high);
            Point3::new(within(-3.0, 3.0), within(-2.0, 2.0), within(4.0, 9.0))
        })
        .collect();
    let looks: Vec<[u8; 128]> =
        points.iter().map(|_| std::array::from_fn(|_| rng.random_range(0..120))).collect();
    let rows = Descriptors::new(DescriptorKind::ROOT_SIFT, looks.concat()).expect("whole rows");
    let profile = Profile::vlad(Vocabulary::train(rows.view(), 16, &mut rng).expect("enough samples"));
    let mut model = MapModel::empty(profile, BuildSettings::default());
    model.cameras.push(camera());
    let mut tracks = vec![Vec::new(); points.len()];
    for image in 0..IMAGES {
        let pose = pose(image);
        let (mut keypoints, mut bytes) = (Vec::new(), Vec::new());
        for (p, point) in points.iter().enumerate() {
            let Some(plane) = PlanePoint::from_camera_point(&pose.transform(point)) else { continue };
            let pixel = camera().project(plane);
            if !(pixel.u > 2.0 && pixel.v > 2.0 && pixel.u < 638.0 && pixel.v < 478.0) {
                continue;
            }
            tracks[p].push(Observation { image: image as u32, keypoint: keypoints.len() as u32 });
            keypoints.push([pixel.u + NOISE_PX * normal(&mut rng), pixel.v + NOISE_PX * normal(&mut rng)]);
            bytes.extend(looks[p].map(|d| d.saturating_add(rng.random_range(0..12))));
        }
        let descriptors = Descriptors::new(DescriptorKind::ROOT_SIFT, bytes).expect("whole rows");
        model.images.push(MapImage {
            name: format!("{image}.jpg"),
            camera: 0,
            cam_from_world: pose,
            point_of_keypoint: vec![None; keypoints.len()],
            keypoints: keypoints.iter().map(|k| k.map(|c| c as f32)).collect(),
            global: model.profile.global_model().of_rows(descriptors.view()).expect("VLAD"),
            descriptors,
        });
    }
    for (position, track) in points.iter().zip(tracks) {
        if track.len() >= 3 {
            model.points.push(MapPoint { position: *position, track, error: 0.5 });
        }
    }
    model.link_keypoints();
    model
}

fn tested(model: &MapModel, schemes: &[Scheme]) -> SelfTest {
    let mut options = SelfTestOptions::default();
    options.schemes = schemes.into();
    self_test(model, &options, &()).expect("a map that can be tested")
}

#[test]
fn correct_map_localizes_its_images_under_every_scheme() {
    let model = known_map();
    let test = tested(&model, &Scheme::ALL);
    assert_eq!((test.images, test.schemes.len()), (10, 4));
    assert!((4.0..9.0).contains(&test.scale), "{}", test.scale);
    assert!(!test.failed());
    for scheme in &test.schemes {
        assert_eq!((scheme.localized, scheme.trusted), (10, 10), "{scheme:?}");
        assert!(scheme.within_of_scale[1] == 10 && scheme.median_translation < 0.02, "{scheme:?}");
        assert!(scheme.median_noise_px > 0.2 && scheme.median_noise_px < 2.0, "{scheme:?}");
        assert!((0.4..4.0).contains(&scheme.calibration.factor), "{scheme:?}");
    }
    // The self-test is stored in the map, and the map is otherwise the same.
    let unchanged = MapModel { self_test: Some(test.clone()), ..model.clone() };
    unchanged.validate().expect("a map with a self-test is valid");
    assert_eq!(tested(&unchanged, &Scheme::ALL), test, "an existing calibration has no influence");
}

#[test]
fn result_is_independent_of_thread_count() {
    let model = known_map();
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| tested(&model, &[Scheme::default()]))
    };
    assert_eq!(with(1), with(4));
}

/// Matches are transferred between schemes, with the same result as separate matching.
#[test]
fn schemes_are_independent() {
    let model = known_map();
    let together = tested(&model, &[Scheme::Points, Scheme::default()]);
    let alone = tested(&model, &[Scheme::default()]);
    assert_eq!(together.of_scheme(Scheme::default()), alone.of_scheme(Scheme::default()));
}

/// An image with a wrong pose and its own points at that pose: if it were used, it would find itself there.
#[test]
fn left_out_image_has_no_influence() {
    let mut model = known_map();
    let wrong = 4;
    let away = Vector3::new(0.0, 0.0, 40.0);
    let image = &mut model.images[wrong];
    image.cam_from_world =
        CameraFromWorld::new(*image.cam_from_world.rotation(), image.cam_from_world.translation() + away);
    let (camera, pose) = (camera(), model.images[wrong].cam_from_world.inverse());
    for point in &mut model.points {
        point.track.retain(|o| o.image as usize != wrong);
    }
    model.points.retain(|p| !p.track.is_empty());
    for (keypoint, [u, v]) in model.images[wrong].keypoints.clone().into_iter().enumerate() {
        let plane = camera.unproject(veiloc_geometry::Pixel::new(u.into(), v.into())).expect("a ray");
        let depth = 4.0 + (keypoint % 5) as f64;
        let position = pose.transform(&Point3::from_vector(plane.homogeneous() * depth));
        let track = vec![Observation { image: wrong as u32, keypoint: keypoint as u32 }];
        model.points.push(MapPoint { position, track, error: 0.0 });
    }
    model.link_keypoints();
    model.validate().expect("a map");

    let test = tested(&model, &[Scheme::Points]);
    let points = test.of_scheme(Scheme::Points).expect("tested");
    assert_eq!(points.localized, 10, "the other images restore the position");
    assert_eq!(points.within_of_scale[2], 9, "the stored position is wrong");
}

/// A point whose position only the left-out image supports moves back to where the others see it, or is removed.
#[test]
fn points_are_retriangulated_without_the_image() {
    let model = known_map();
    let id = model.images[3].point_of_keypoint.iter().flatten().next().expect("the image observes a point");
    let truth = model.points[id.index()].position;
    let mut bent = model.clone();
    // Along the ray of image 3, which therefore still agrees; the others do not.
    let center = model.images[3].cam_from_world.center().coords;
    bent.points[id.index()].position = Point3::from_vector(center + (truth.coords - center) * 1.5);
    let without = veiloc_mapping::HoldOutMap::of(&bent).without(&[3].into());
    assert_eq!(without.images, [3].into());
    let point = without.points[id].as_ref().expect("other images observe the point");
    assert!(point.position.distance(&truth) < 0.05, "{:?}", point.position);
    let PointEvidence::Track(track) = &point.evidence else { panic!("{point:?}") };
    assert!(track.iter().all(|o| o.image != 3) && track.len() >= 3);
    let all = model.images[3].point_of_keypoint.iter().flatten().count();
    assert_eq!(without.points.len(), all, "only the points that it observes");
    // Two of three views remain, which is too few.
    let three = model.points.iter().position(|p| p.track.len() == 3).expect("a point with three views");
    let image = model.points[three].track[1].image as usize;
    let without = veiloc_mapping::HoldOutMap::of(&model).without(&[image].into());
    assert_eq!(without.points[&veiloc_map::PointId(three as u32)], None);
}

#[test]
fn parts_that_look_alike_are_named() {
    let plain = known_map();
    let result = |model: &MapModel| {
        let mut options = SelfTestOptions::default();
        options.schemes = vec![Scheme::Points, Scheme::default()];
        let images = chosen(model, &options);
        let tried = trials(model, &images, &options, &()).expect("a map that can be tested");
        (MapWarning::of_trials(model, &images, &tried), summarize_trials(model, &tried, &options))
    };
    assert_eq!(result(&plain).0, None);
    let twin = veiloc_testing::with_copy(&plain, 5, Vector3::new(15.0, 0.0, 4.0));
    let (warning, test) = result(&twin);
    let Some(MapWarning::PlacesLookAlike { queries, images, examples }) = warning else {
        panic!("no warning")
    };
    // An answer in the other part does not widen the ± of all answers.
    for scheme in &test.schemes {
        assert!(scheme.calibration.translation_floor < 0.1 && scheme.calibration.factor < 10.0, "{scheme:?}");
    }
    assert!(images == 15 && queries >= 10, "{queries} of {images}");
    assert_eq!(examples.len(), 3);
    let is_copy = |name: &String| name.starts_with("copy/");
    assert!(examples.iter().all(|[a, b]| is_copy(a) != is_copy(b)), "{examples:?}");
}

#[test]
fn wrong_poses_fail_the_self_test() {
    let mut model = known_map();
    let poses: Vec<CameraFromWorld> = model.images.iter().map(|i| i.cam_from_world).collect();
    for (i, image) in model.images.iter_mut().enumerate() {
        let turned = poses[(i * 7 + 3) % IMAGES].inverse();
        image.cam_from_world = CameraFromWorld::new(*turned.rotation(), *turned.translation());
    }
    assert!(tested(&model, &[Scheme::Points]).failed());
    let empty = MapModel::empty(model.profile, model.settings);
    assert_eq!(tested(&empty, &Scheme::ALL).images, 0);
}

/// A compressed map localizes images of the whole map, left out of both, and trusts the poses; points without an image
/// equal those of the whole map, not those from the few keypoints in the compressed map.
#[test]
fn compressed_map_localizes_images_of_the_whole_map() {
    let whole = known_map();
    let bytes = veiloc_map::byte_count(&whole) / 6;
    let small = compress(&whole, &CompressOptions::new(bytes), &()).expect("a small map");
    let mut options = SelfTestOptions::default();
    options.schemes = vec![Scheme::Points, Scheme::default()];
    let test = self_test_compressed(&whole, &small, &options, &()).expect("a map that can be tested");
    assert_eq!(test.images, 10);
    for scheme in &test.schemes {
        assert_eq!((scheme.localized, scheme.trusted), (10, 10), "{scheme:?}");
        assert!(scheme.within_of_scale[1] == 10, "{scheme:?}");
        assert!((0.2..4.0).contains(&scheme.calibration.factor), "{scheme:?}");
    }
    let unchanged = MapModel { self_test: Some(test), ..small.model };
    unchanged.validate().expect("a compressed map with a self-test is valid");
}

/// The smallest map without loss is smaller than the whole one, and as good in its own test.
#[test]
fn smallest_map_within_recall_loss_is_found() {
    let whole = known_map();
    let mut options = SelfTestOptions::default();
    options.schemes = vec![Scheme::default()];
    let found = smallest_within(&whole, 0.0, &CompressOptions::new(1), &options, &());
    let small = found.expect("a map that can be tested").expect("a map without recall loss");
    assert!(veiloc_map::byte_count(&small.model) * 4 < veiloc_map::byte_count(&whole));
    let test = small.model.self_test.expect("tested");
    assert_eq!((test.schemes[0].trusted, test.schemes[0].within_of_scale[1]), (10, 10));
}
