//! Tests of maps of a synthetic scene with known points, keypoints and descriptors, without rendered images.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use veiloc_descriptor::{DescriptorKind, Descriptors, Vocabulary};
use veiloc_geometry::nalgebra::{Rotation3, Vector3};
use veiloc_geometry::{CameraFromWorld, Intrinsics};
use veiloc_map::{BuildSettings, MapModel, MapPoint, PosedImage};
use veiloc_protocol::Profile;

use crate::build::change::{VocabularyUpdate, join, remove};
use crate::build::vocabulary::learn;
use crate::build::{append_images, match_images, sort_points};
use crate::error::MappingError;
use crate::input::cache::ExtractedFeatures;
use crate::triangulation::complete::grow;
use crate::triangulation::scene::Scene;
use crate::triangulation::view::View;

/// Cameras on an arc, points in a box in front of them.
pub(super) struct KnownScene {
    posed: Vec<PosedImage>,
    points: Vec<Vector3<f64>>,
    features: Vec<ExtractedFeatures>,
    /// `[images][N]`, the true point of each keypoint; none for clutter.
    truth: Vec<Vec<Option<usize>>>,
}

const NOISE_PX: f32 = 0.3;

pub(super) fn known_scene(images: u32, points: usize) -> KnownScene {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let camera: Intrinsics = "OPENCV,640,480,500,505,322,238,-0.08,0.02,0.001,-0.0005".parse().unwrap();
    let points: Vec<Vector3<f64>> = (0..points)
        .map(|_| {
            Vector3::new(
                rng.random_range(-2.0..2.0),
                rng.random_range(-1.0..1.0),
                rng.random_range(-1.0..1.5),
            )
        })
        .collect();
    let looks: Vec<[u8; 128]> =
        points.iter().map(|_| std::array::from_fn(|_| rng.random_range(0..90))).collect();
    let posed: Vec<PosedImage> = (0..images)
        .map(|i| {
            let a = (f64::from(i) - f64::from(images) / 2.0) * 0.06;
            let center = Vector3::new(5.0 * a.sin(), 0.2 * f64::from(i % 3), -5.0 * a.cos());
            let look = Rotation3::look_at_lh(&-center, &Vector3::y());
            PosedImage {
                name: format!("{i}.jpg"),
                camera,
                cam_from_world: CameraFromWorld::new(look, -(look * center)),
                seen: Vec::new(),
            }
        })
        .collect();
    let (mut features, mut truth) = (Vec::new(), Vec::new());
    for image in &posed {
        let view = View::new(camera, image.cam_from_world, &[], 3.0, 3.0);
        let (mut keypoints, mut shown) = (Vec::new(), Vec::new());
        let mut descriptors = Descriptors::empty(DescriptorKind::ROOT_SIFT);
        for (p, point) in points.iter().enumerate() {
            // Three quarters of the visible points are detected.
            let Some(pixel) = view.pixel_inside(point).filter(|_| rng.random_bool(0.75)) else { continue };
            let mut shift = || rng.random_range(-NOISE_PX..NOISE_PX);
            keypoints.push([pixel.u as f32 + shift(), pixel.v as f32 + shift()]);
            descriptors.push(&looks[p].map(|c| c.saturating_add_signed(rng.random_range(-6..6)))).unwrap();
            shown.push(Some(p));
        }
        for _ in 0..points.len() / 4 {
            keypoints.push([rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)]);
            descriptors.push(&std::array::from_fn::<u8, 128, _>(|_| rng.random_range(0..90))).unwrap();
            shown.push(None);
        }
        features.push(ExtractedFeatures { keypoints, descriptors, global: None });
        truth.push(shown);
    }
    KnownScene { posed, points, features, truth }
}

fn copy(features: &ExtractedFeatures) -> ExtractedFeatures {
    ExtractedFeatures {
        keypoints: features.keypoints.clone(),
        descriptors: features.descriptors.clone(),
        global: None,
    }
}

fn empty_map() -> MapModel {
    let words = Descriptors::new(DescriptorKind::ROOT_SIFT, vec![30; 128]).unwrap();
    let profile = Profile::vlad(Vocabulary::new(words).unwrap());
    MapModel::empty(profile, BuildSettings::default())
}

/// The steps of `add` after extraction, without a comparison of frames.
fn integrate(model: &mut MapModel, images: &[&PosedImage], features: Vec<ExtractedFeatures>) {
    let before = model.images.len();
    append_images(model, images, features).unwrap();
    join(model, before, None, &());
}

/// The steps of `build` after extraction.
pub(super) fn map_of(known_scene: &KnownScene, settings: &BuildSettings) -> MapModel {
    let mut model = empty_map();
    model.settings = *settings;
    let images: Vec<&PosedImage> = known_scene.posed.iter().collect();
    append_images(&mut model, &images, known_scene.features.iter().map(copy).collect()).unwrap();
    let mut scene = Scene::of(&model, settings);
    let focus: Vec<u32> = (0..images.len() as u32).collect();
    let edges = match_images(&scene, vec![Vec::new(); images.len()], &focus, settings, None, &()).edges;
    grow(&mut scene, &edges.verified, settings);
    model.points = scene.finish();
    sort_points(&mut model);
    model.link_keypoints();
    model.validate().unwrap();
    model
}

/// Returns the true point of most observations of a map point, and their share.
fn shown_by(known_scene: &KnownScene, point: &MapPoint, names: &[usize]) -> (usize, f64) {
    let mut votes = std::collections::BTreeMap::<usize, usize>::new();
    for o in &point.track {
        if let Some(p) = known_scene.truth[names[o.image as usize]][o.keypoint as usize] {
            *votes.entry(p).or_default() += 1;
        }
    }
    let (p, n) = votes.into_iter().max_by_key(|(_, n)| *n).unwrap_or((0, 0));
    (p, n as f64 / point.track.len() as f64)
}

#[test]
fn points_of_known_scene_are_recovered() {
    let known_scene = known_scene(16, 400);
    let model = map_of(&known_scene, &BuildSettings::default());
    let all: Vec<usize> = (0..16).collect();
    let mut found = vec![0; known_scene.points.len()];
    for point in &model.points {
        let (p, share) = shown_by(&known_scene, point, &all);
        assert!(share > 0.99, "a track with keypoints of several points");
        let apart = (point.position.coords - known_scene.points[p]).norm();
        assert!(
            apart < 0.05,
            "{apart}: 0.3 px at f = 500 and 5 units is 3 mm across, some times that in depth"
        );
        assert!(point.error < NOISE_PX.into(), "{}", point.error);
        found[p] += 1;
    }
    // A point in fewer than three images cannot be found; a point found twice was not merged.
    let shown = |p: usize| known_scene.truth.iter().flatten().filter(|t| **t == Some(p)).count();
    let visible = (0..known_scene.points.len()).filter(|p| shown(*p) >= 4);
    let missed = visible.clone().filter(|p| found[*p] == 0).count();
    assert!(missed * 50 <= visible.count(), "{missed} points missed");
    assert!(found.iter().filter(|n| **n > 1).count() <= 2, "points found twice");
    let observations = model.observation_count() as f64;
    let true_ones = known_scene.truth.iter().flatten().flatten().count() as f64;
    assert!(observations > 0.95 * true_ones, "{observations} of {true_ones} observations");
}

#[test]
fn result_is_independent_of_thread_count() {
    let known_scene = known_scene(8, 150);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| map_of(&known_scene, &BuildSettings::default()))
    };
    let one = with(1);
    assert_eq!(one, with(2));
    assert_eq!(one, with(5));
}

#[test]
fn removed_and_re_added_images_give_similar_points() {
    let known_scene = known_scene(16, 400);
    let before = map_of(&known_scene, &BuildSettings::default());
    let mut model = before.clone();
    let names = ["15.jpg".to_owned(), "14.jpg".to_owned()];
    remove(&mut model, &names, VocabularyUpdate::Keep, &()).unwrap();
    model.validate().unwrap();
    assert_eq!(model.images.len(), 14);
    let unseen = |p: &&MapPoint| p.track.iter().all(|o| o.image < 14);
    for old in before.points.iter().filter(unseen) {
        assert!(model.points.contains(old), "a point that the images do not observe changed");
    }
    assert!(model.points.iter().flat_map(|p| &p.track).all(|o| o.image < 14));

    let without = model.clone();
    let chosen: Vec<&PosedImage> = [14, 15].iter().map(|i| &known_scene.posed[*i]).collect();
    integrate(&mut model, &chosen, [14, 15].map(|i| copy(&known_scene.features[i])).into());
    model.validate().unwrap();
    assert_eq!(model.profile, before.profile);
    for (new, old) in model.points.iter().zip(&without.points) {
        if new.track == old.track {
            assert_eq!(new, old, "a point without new observations changed");
        }
    }
    let (observations, all) = (model.observation_count() as f64, before.observation_count() as f64);
    assert!((observations / all - 1.0).abs() < 0.02, "{observations} observations, {all} before");
    let same = |p: &MapPoint| {
        before.points.iter().any(|q| q.track == p.track && q.position.distance(&p.position) < 1e-4)
    };
    let equal = model.points.iter().filter(|p| same(p)).count();
    assert!(equal * 100 >= 95 * before.points.len(), "{equal} of {} points", before.points.len());
}

#[test]
fn emptied_map_can_be_extended_again() {
    let known_scene = known_scene(8, 150);
    let mut model = map_of(&known_scene, &BuildSettings::default());
    let names: Vec<String> = model.images.iter().map(|i| i.name.clone()).collect();
    remove(&mut model, &names, VocabularyUpdate::Keep, &()).unwrap();
    model.validate().unwrap();
    assert_eq!((model.images.len(), model.points.len(), model.cameras.len()), (0, 0, 0));
    let images: Vec<&PosedImage> = known_scene.posed.iter().collect();
    integrate(&mut model, &images, known_scene.features.iter().map(copy).collect());
    assert!(model.points.len() > 100, "{}", model.points.len());
    model.validate().unwrap();
}

#[test]
fn invalid_removals_leave_map_unchanged() {
    let known_scene = known_scene(4, 60);
    let before = map_of(&known_scene, &BuildSettings::default());
    let mut model = before.clone();
    for (names, expected) in [
        (vec![], "empty"),
        (vec!["0.jpg", "0.jpg"], "0.jpg is in the list twice"),
        (vec!["1.jpg", "nobody.jpg"], "nobody.jpg is not in the map"),
        (vec!["nobody.jpg", "none.jpg"], "nobody.jpg, none.jpg are not in the map"),
    ] {
        let names: Vec<String> = names.into_iter().map(str::to_owned).collect();
        let error = remove(&mut model, &names, VocabularyUpdate::Keep, &()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
        assert_eq!(model, before);
    }
}

#[test]
fn removed_images_are_found_in_other_spellings() {
    let mut model = map_of(&known_scene(4, 60), &BuildSettings::default());
    model.images[0].name = "Ku\u{308}che.jpg".to_owned();
    model.images[1].name = r"cam0\a.jpg".to_owned();
    let names = ["K\u{fc}che.jpg", "cam0/a.jpg"].map(str::to_owned);
    let twice = [names[0].clone(), model.images[0].name.clone()];
    let error = remove(&mut model, &twice, VocabularyUpdate::Keep, &()).unwrap_err().to_string();
    assert!(error.contains("in the list twice"), "{error}");
    remove(&mut model, &names, VocabularyUpdate::Keep, &()).unwrap();
    assert_eq!(model.images.iter().map(|i| i.name.as_str()).collect::<Vec<_>>(), ["2.jpg", "3.jpg"]);
}

/// A map is changed with the settings of its build.
#[test]
fn changes_use_the_build_settings() {
    let known_scene = known_scene(10, 200);
    let strict = BuildSettings { min_track_length: 8, pairs_per_image: 3, ..BuildSettings::default() };
    let grown = |settings: &BuildSettings| {
        let all = map_of(&known_scene, &BuildSettings::default());
        let mut model = MapModel { settings: *settings, ..all.clone() };
        let names: Vec<String> = all.images.iter().map(|i| i.name.clone()).collect();
        remove(&mut model, &names, VocabularyUpdate::Keep, &()).unwrap();
        assert_eq!(model.settings, *settings);
        let images: Vec<&PosedImage> = known_scene.posed.iter().collect();
        integrate(&mut model, &images, known_scene.features.iter().map(copy).collect());
        model.validate().unwrap();
        model
    };
    let (usual, strict) = (grown(&BuildSettings::default()), grown(&strict));
    assert!(usual.points.iter().any(|p| p.track.len() < 8));
    assert!(!strict.points.is_empty() && strict.points.iter().all(|p| p.track.len() >= 8));
}

/// The vocabulary equals that of a map that never had the removed images.
#[test]
fn retrained_vocabulary_is_independent_of_removed_images() {
    let known_scene = known_scene(10, 200);
    let settings = BuildSettings::default();
    let whole = {
        let mut model = map_of(&known_scene, &settings);
        let all: Vec<_> = model.images.iter().map(|i| i.descriptors.view()).collect();
        let words = learn(&all, &settings, &()).unwrap();
        model.profile = Profile::vlad(words.clone());
        for image in &mut model.images {
            image.global = words.aggregate(image.descriptors.view());
        }
        model.validate().unwrap();
        model
    };
    let left: Vec<_> = known_scene.features[..7].iter().map(|f| f.descriptors.view()).collect();
    let of_left = learn(&left, &settings, &()).unwrap();
    let leaving = [7, 8, 9].map(|i| format!("{i}.jpg"));

    let mut not_retrained = whole.clone();
    remove(&mut not_retrained, &leaving, VocabularyUpdate::Keep, &()).unwrap();
    assert_eq!(not_retrained.profile, whole.profile, "queries sealed for the map are still valid");

    let mut retrained = whole.clone();
    remove(&mut retrained, &leaving, VocabularyUpdate::Retrain, &()).unwrap();
    retrained.validate().unwrap();
    assert_eq!(retrained.profile.vocabulary(), Some(&of_left));
    assert_ne!(retrained.profile.id(), whole.profile.id());
    for (image, features) in retrained.images.iter().zip(&known_scene.features) {
        assert_eq!(image.global, of_left.aggregate(features.descriptors.view()));
    }
    // Everything else is the same as without retraining.
    assert_eq!((&retrained.points, &retrained.cameras), (&not_retrained.points, &not_retrained.cameras));
    assert_eq!(retrained.profile.limits(), whole.profile.limits());

    // The map is the same for any content of the removed images, so it contains nothing of them.
    let mut other = whole.clone();
    for image in &mut other.images[7..] {
        let reversed: Vec<u8> = image.descriptors.as_bytes().iter().rev().copied().collect();
        image.descriptors = Descriptors::new(image.descriptors.kind(), reversed).unwrap();
    }
    remove(&mut other, &leaving, VocabularyUpdate::Retrain, &()).unwrap();
    assert_eq!(other, retrained);

    let all: Vec<String> = whole.images.iter().map(|i| i.name.clone()).collect();
    let mut none = whole.clone();
    let error = remove(&mut none, &all, VocabularyUpdate::Retrain, &()).unwrap_err();
    assert!(matches!(error, MappingError::NothingLeft), "{error}");
    assert_eq!(none, whole);
}

/// Five camera models, written by pycolmap with all digits: its reprojection errors equal ours.
#[test]
fn reprojection_errors_equal_pycolmaps() {
    for format in ["text", "binary"] {
        let dir = std::path::Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("../../server/map/tests/data/colmap")
            .join(format);
        let colmap = veiloc_map::colmap::read_model(&dir).unwrap();
        assert_eq!(colmap.points().len(), 12);
        for point in colmap.points() {
            let error = crate::build::import::recomputed_error(&colmap, point).unwrap();
            assert!((error - point.error).abs() < 1e-9, "{error}, pycolmap says {}", point.error);
        }
    }
}
