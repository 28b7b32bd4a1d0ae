//! L13, masks: pixels under a mask have no influence on the query, neither directly nor through other rows.

use super::common;

use std::path::{Path, PathBuf};

use common::{options, profile, rng};
use image::{GrayImage, Luma};
use rand::Rng;
use veiloc_features::{Extractor, FeatureError, Features, Image, Limits, Mask, Sift, load_gray};
use veiloc_geometry::Intrinsics;
use veiloc_obfuscation::{Extracted, Sealer, Session, SessionOptions};
use veiloc_protocol::{ExtractionLimits, Profile};
use veiloc_testdata::real_data_test;

const SCHEMES: [&str; 4] = ["points", "random-lines", "coordinate-permutation", "dcl"];
const SIZE: (u32, u32) = (640, 480);

fn camera() -> Intrinsics {
    "SIMPLE_RADIAL,640,480,520,318,242,-0.03".parse().expect("valid")
}

/// An upright ellipse, the size of a person.
fn person() -> Mask {
    let inside = |x: u32, y: u32| ((f64::from(x) - 250.0) / 70.0).hypot((f64::from(y) - 260.0) / 160.0) < 1.0;
    Mask::new(SIZE.0, SIZE.1, inside).expect("a part of it")
}

/// An image with blobs of all sizes; those under the mask are drawn with another seed.
fn scene(folder: &Path, seed: u64) -> PathBuf {
    let draw = |seed: u64| {
        let mut rng = rng(seed);
        let blob = |_| {
            let center = [rng.random_range(0.0..640.0), rng.random_range(0.0..480.0)];
            (center, 3.0 * 14.0_f64.powf(rng.random()), rng.random_range(-90.0..90.0))
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

fn sealer(side: u32, scheme: &str) -> Sealer {
    Sealer::new(&small(side), options(scheme)).expect("its profile")
}

/// The features of an image, without what the mask hides.
fn extract(sealer: &Sealer, image: &Path, mask: Option<&Mask>) -> Extracted {
    let image = Image::open(image).expect("written");
    let image = mask.map_or(Ok(image.clone()), |mask| image.without(mask)).expect("of its size");
    sealer.extract(image, camera()).expect("extracted")
}

/// Two images that differ only under the mask give the same bytes: rows, order, decoys and global descriptor.
#[test]
fn l13_masked_pixels_change_no_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let images = [scene(folder.path(), 2), scene(folder.path(), 3)];
    let mask = person();
    // At full size, and scaled down first: pixels that are averaged together must be hidden together.
    for side in [640, 300] {
        for scheme in SCHEMES {
            let sealer = sealer(side, scheme);
            let sealed = |extracted| sealer.seal(extracted, &mut rng(13)).expect("sealed").encode();
            let bytes = |image: &PathBuf| sealed(extract(&sealer, image, Some(&mask)));
            assert!(bytes(&images[0]) == bytes(&images[1]), "{scheme}");
            // The leak: features are extracted from the whole image, and keypoints under the mask are dropped.
            let leak = |image: &PathBuf| {
                let extracted = extract(&sealer, image, None);
                let (mut features, camera) = (extracted.features().clone(), *extracted.camera());
                let scale = f64::from(SIZE.0) / f64::from(camera.intrinsics.width);
                let shown: Vec<usize> = (0..features.keypoints.len())
                    .filter(|&i| {
                        let at = features.keypoints[i].pixel;
                        !mask.hides((at.u * scale) as u32, (at.v * scale) as u32)
                    })
                    .collect();
                features.keypoints = shown.iter().map(|&i| features.keypoints[i]).collect();
                features.descriptors = features.descriptors.select(shown);
                sealed(Extracted::new(features, camera))
            };
            assert!(leak(&images[0]) != leak(&images[1]), "{scheme}: the measure does not see the leak");
        }
    }
}

/// A session stores sent rows, which could reveal hidden pixels in a later frame.
#[test]
fn l13_session_stores_no_masked_pixels() {
    let folder = tempfile::tempdir().expect("a folder");
    let images = [scene(folder.path(), 2), scene(folder.path(), 3)];
    let (mask, sealer) = (person(), sealer(640, "dcl"));
    let sealed_frames = |image: &PathBuf| {
        let mut rng = rng(13);
        let mut session = Session::new(SessionOptions::default(), &mut rng);
        let mut frames = Vec::new();
        for _ in 0..2 {
            let extracted = extract(&sealer, image, Some(&mask));
            let query = sealer.in_session(&mut session).seal(extracted, &mut rng).expect("sealed");
            frames.push(query.encode());
        }
        (frames, session.to_bytes())
    };
    assert!(sealed_frames(&images[0]) == sealed_frames(&images[1]));
}

/// Number of keypoints whose descriptor window touches the mask.
fn looking(features: &Features, mask: &Mask) -> usize {
    let reach = Sift::default().support_radius();
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

/// The mask's border must not show: no descriptor window touches it.
#[test]
fn l13_no_descriptor_window_touches_the_mask() {
    let folder = tempfile::tempdir().expect("a folder");
    let (image, mask) = (scene(folder.path(), 2), person());
    let extracted = extract(&sealer(640, "dcl"), &image, Some(&mask));
    let features = extracted.features();
    assert!(features.keypoints.len() > 200, "{}", features.keypoints.len());
    assert_eq!(looking(features, &mask), 0);
    // The leak: all features of the same image.
    let filled = Image::from(load_gray(&image).expect("an image")).without(&mask).expect("of its size");
    let all = Sift::for_sealing().extract(&filled, 1024).expect("extracted");
    assert!(looking(&all, &mask) > 20, "the measure does not see the leak: {}", looking(&all, &mask));
}

#[test]
fn mask_of_another_size_is_rejected() {
    let folder = tempfile::tempdir().expect("a folder");
    let image = scene(folder.path(), 2);
    let turned = Mask::new(480, 640, |x, _| x < 10).expect("a part of it");
    let refused = Image::open(&image).expect("written").without(&turned);
    let Err(error @ FeatureError::MaskSize { .. }) = refused else { panic!("{refused:?}") };
    assert!(error.to_string().contains("480x640") && error.to_string().contains("640x480"), "{error}");
}

/// On a real photo: rows away from the mask are the same as without one, and there are nearly as many.
#[real_data_test]
fn unmasked_rows_equal_those_without_mask(data: &Path) {
    let image = data.join("photos/01.jpg");
    let mask = Mask::new(1024, 768, |x, y| {
        ((f64::from(x) - 500.0) / 110.0).hypot((f64::from(y) - 420.0) / 275.0) < 1.0
    });
    let plain = Image::from(load_gray(&image).expect("an image"));
    let masked = plain.clone().without(&mask.expect("a part of it")).expect("of its size");
    let features = |image: Image, max_keypoints: usize| {
        let limits = Limits { max_keypoints, max_side: 1600 };
        veiloc_features::extract_loaded(image, None, &Sift::for_sealing(), limits)
            .expect("extracted")
            .features
    };
    // The mask hides some strong keypoints, and weaker ones replace them: their counterparts must be among all
    // features.
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
