//! L13, what is hidden: nothing under a mask leaves the device, neither by what is sent of it nor by what it changes in the rest.

use super::common;

use std::path::{Path, PathBuf};

use common::{options, profile, rng};
use image::{GrayImage, Luma};
use rand::Rng;
use veiloc_features::{Extractor, FeatureError, Features, Image, Limits, Mask, Sift, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{
    Orientation, SealError, SealOptions, Session, SessionOptions, extract, extract_masked, seal,
};
use veiloc_protocol::{ExtractionLimits, Profile};
use veiloc_testdata::real_data_test;

const SCHEMES: [&str; 4] = ["points", "random-lines", "coordinate-permutation", "dcl"];
const SIZE: (u32, u32) = (640, 480);

fn camera() -> Intrinsics {
    "SIMPLE_RADIAL,640,480,520,318,242,-0.03".parse().expect("valid")
}

/// An upright ellipse, as of a person.
fn person() -> Mask {
    let inside = |x: u32, y: u32| ((f64::from(x) - 250.0) / 70.0).hypot((f64::from(y) - 260.0) / 160.0) < 1.0;
    Mask::new(SIZE.0, SIZE.1, inside).expect("a part of it")
}

/// An image full of blobs of all sizes; under the mask they are drawn by another seed.
fn scene(folder: &Path, seed: u64) -> PathBuf {
    let draw = |seed: u64| {
        let mut rng = rng(seed);
        let blob = |_| {
            let place = [rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)];
            (place, 3.0 * 14.0_f64.powf(rng.random()), rng.random_range(-90.0..90.0))
        };
        let blobs: Vec<([f64; 2], f64, f64)> = (0..700).map(blob).collect();
        move |x: u32, y: u32| {
            let at = |([u, v], radius, height): &([f64; 2], f64, f64)| {
                let far = (f64::from(x) - u).hypot(f64::from(y) - v) / radius;
                if far < 3.0 { height * (-far * far).exp() } else { 0.0 }
            };
            (128.0 + blobs.iter().map(at).sum::<f64>()).clamp(0.0, 255.0) as u8
        }
    };
    let (mask, around, hidden) = (person(), draw(1), draw(seed));
    let pixel = |x, y| Luma([if mask.hides(x, y) { hidden(x, y) } else { around(x, y) }]);
    let path = folder.join(format!("{seed}.png"));
    GrayImage::from_fn(SIZE.0, SIZE.1, pixel).save(&path).expect("written");
    path
}

fn small(side: u32) -> Profile {
    profile().with_limits(ExtractionLimits { max_keypoints: 1024, max_image_side: side }).expect("allowed")
}

fn sealed(features: (Features, Intrinsics), profile: &Profile, options: &SealOptions) -> Vec<u8> {
    let (features, camera) = features;
    seal(features, &camera, profile, options, &mut rng(13)).expect("sealed").encode()
}

/// Two images that differ under the mask only give the same bytes: rows, order, decoys, global descriptor and all.
#[test]
fn l13_what_is_hidden_changes_no_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let images = [scene(folder.path(), 2), scene(folder.path(), 3)];
    let mask = person();
    // As it is, and made smaller first: what is shrunk together must be hidden together.
    for profile in [small(640), small(300)] {
        for scheme in SCHEMES {
            let options = options(scheme);
            let bytes = |image: &PathBuf| {
                let features =
                    extract_masked(image, &mask, &camera(), &profile, &options).expect("extracted");
                sealed(features, &profile, &options)
            };
            assert!(bytes(&images[0]) == bytes(&images[1]), "{scheme}");
            // The leak: the image is extracted as it is, and keypoints under the mask are left out.
            let leak = |image: &PathBuf| {
                let (mut features, small) = extract(image, &camera(), &profile, &options).expect("extracted");
                let scale = f64::from(SIZE.0) / f64::from(small.width);
                let shown: Vec<usize> = (0..features.keypoints.len())
                    .filter(|&i| {
                        let at = features.keypoints[i].pixel;
                        !mask.hides((at.u * scale) as u32, (at.v * scale) as u32)
                    })
                    .collect();
                features.keypoints = shown.iter().map(|&i| features.keypoints[i]).collect();
                features.descriptors = features.descriptors.select(shown);
                sealed((features, small), &profile, &options)
            };
            assert!(leak(&images[0]) != leak(&images[1]), "{scheme}: the measure does not see the leak");
        }
    }
}

/// A session remembers what it told, and would tell of what is hidden in a later frame.
#[test]
fn l13_a_session_remembers_nothing_that_is_hidden() {
    let folder = tempfile::tempdir().expect("a folder");
    let images = [scene(folder.path(), 2), scene(folder.path(), 3)];
    let (mask, profile, options) = (person(), small(640), SealOptions::default());
    let told = |image: &PathBuf| {
        let mut rng = rng(13);
        let mut session = Session::new(SessionOptions::default(), &mut rng);
        let mut frames = Vec::new();
        for _ in 0..2 {
            let (features, camera) =
                extract_masked(image, &mask, &camera(), &profile, &options).expect("extracted");
            let held = Orientation::unknown();
            let query = session.seal(features, &camera, &profile, &options, &held, &mut rng).expect("sealed");
            frames.push(query.encode());
        }
        (frames, session.to_bytes())
    };
    assert!(told(&images[0]) == told(&images[1]));
}

/// Keypoints whose disc, of the descriptor's reach, has something of the mask in it.
fn looking(features: &Features, mask: &Mask) -> usize {
    let reach = Sift::default().reach();
    let looks = |k: &veiloc_features::Keypoint| {
        let radius = reach * f64::from(k.scale);
        let away = |at: f64, low: u32| (f64::from(low) - at).max(at - f64::from(low) - 1.0).max(0.0);
        (0..mask.height()).any(|y| {
            away(k.pixel.v, y) <= radius
                && (0..mask.width())
                    .any(|x| mask.hides(x, y) && away(k.pixel.u, x).hypot(away(k.pixel.v, y)) <= radius)
        })
    };
    features.keypoints.iter().filter(|k| looks(k)).count()
}

/// The mask's own border must not show: no descriptor looks there.
#[test]
fn l13_no_descriptor_looks_under_the_mask() {
    let folder = tempfile::tempdir().expect("a folder");
    let (image, mask, profile) = (scene(folder.path(), 2), person(), small(640));
    let options = SealOptions::default();
    let (features, _) = extract_masked(&image, &mask, &camera(), &profile, &options).expect("extracted");
    assert!(features.keypoints.len() > 200, "{}", features.keypoints.len());
    assert_eq!(looking(&features, &mask), 0);
    // The leak: the same image, and all that an extractor finds in it.
    let filled = Image::from(load_gray(&image).expect("an image")).without(&mask).expect("of its size");
    let all = Sift::for_sealing().extract(&filled, 1024).expect("extracted");
    assert!(looking(&all, &mask) > 20, "the measure does not see the leak: {}", looking(&all, &mask));
}

#[test]
fn a_mask_of_another_size_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = scene(folder.path(), 2);
    let turned = Mask::new(480, 640, |x, _| x < 10).expect("a part of it");
    let refused = extract_masked(&image, &turned, &camera(), &profile(), &SealOptions::default());
    let Err(SealError::Image(error @ FeatureError::MaskSize { .. })) = refused else { panic!("{refused:?}") };
    assert!(error.to_string().contains("480x640") && error.to_string().contains("640x480"), "{error}");
}

/// On a real image: rows beside the mask are what they were without one, and there are nearly as many.
#[real_data_test]
fn the_rest_of_a_photograph_is_described_as_without_a_mask(data: &Path) {
    let image = data.join("photos/01.jpg");
    let mask = Mask::new(1024, 768, |x, y| {
        ((f64::from(x) - 500.0) / 110.0).hypot((f64::from(y) - 420.0) / 275.0) < 1.0
    });
    let plain = Image::from(load_gray(&image).expect("an image"));
    let masked = plain.clone().without(&mask.expect("a part of it")).expect("of its size");
    let features = |image: Image, max_keypoints: usize| {
        let limits = Limits { max_keypoints, max_side: 1600 };
        let path = Path::new("01.jpg");
        veiloc_features::extract_loaded(image, path, None, &Sift::for_sealing(), limits)
            .expect("extracted")
            .features
    };
    // Where the strongest are hidden weaker ones are kept: all there are must be there to be found again.
    let (all, rest) = (features(plain, 20_000), features(masked, 2730));
    let (mut same, mut changed) = (0, 0);
    for (i, keypoint) in rest.keypoints.iter().enumerate() {
        let twin = all
            .keypoints
            .iter()
            .position(|k| k.pixel == keypoint.pixel && (k.orientation - keypoint.orientation).abs() < 1e-3);
        match twin.map(|twin| {
            let (a, b) = (all.descriptors.row(twin), rest.descriptors.row(i));
            a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
        }) {
            Some(0..=2) => same += 1,
            _ => changed += 1,
        }
    }
    println!(
        "{} keypoints without a mask, {} with one: {same} as they were, {changed} not",
        all.keypoints.len(),
        rest.keypoints.len()
    );
    assert!(rest.keypoints.len() > 2048, "{} keypoints", rest.keypoints.len());
    assert!(changed * 20 < same, "{changed} changed, {same} did not");
}
