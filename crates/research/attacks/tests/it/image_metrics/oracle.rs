//! Comparison with scikit-image (`research/oracles/image_metrics.py`) on synthetic images, and networks of
//! `research/oracles/tiny_networks.py`.

use std::path::{Path, PathBuf};

use serde_json::Value;
use veiloc_attacks::image_metrics::{Classifier, PerceptualDistance, psnr, ssim};
use veiloc_features::ColourImage;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/image_metrics").join(name)
}

/// The same as `drawn` in the script.
fn drawn(width: u32, height: u32, kind: u64) -> ColourImage {
    let pixel = |x: i64, y: i64, colour: i64| {
        let (a, b) = (x / 11, y / 13);
        let block = (a * 7 + b * 11 + (a ^ b) * 37) % 160;
        (block + (x * 7 + y * 13 + x * y * (colour + 1)) % 31 + (x * (colour + 2)) % 50) % 256
    };
    let (w, h) = (i64::from(width), i64::from(height));
    let mut data = Vec::new();
    for (y, x, colour) in (0..h).flat_map(|y| (0..w).flat_map(move |x| (0..3).map(move |c| (y, x, c)))) {
        data.push(match kind {
            0 => pixel(x, y, colour),
            1 => (pixel(x, y, colour) + (x * 5 + y * 3) % 23 - 11).clamp(0, 255),
            _ => (pixel(w - 1 - x, h - 1 - y, colour) * 3 + 40) % 256,
        } as u8);
    }
    ColourImage::new(width, height, data).expect("three bytes a pixel")
}

#[test]
fn metrics_equal_scikit_image() {
    let rows: Vec<Value> =
        serde_json::from_str(include_str!("../../data/image_metrics/oracle.json")).expect("the script's");
    assert_eq!(rows.len(), 4);
    for row in &rows {
        let number = |key: &str| row[key].as_f64().expect(key);
        let size = [0, 1].map(|i| row["size"][i].as_u64().expect("a side") as u32);
        let kind = row["kind"].as_u64().expect("a kind");
        let (a, b) = (drawn(size[0], size[1], 0), drawn(size[0], size[1], kind));
        let sum = |image: &ColourImage| image.data().iter().map(|v| u64::from(*v)).sum::<u64>();
        assert_eq!(
            [Some(sum(&a)), Some(sum(&b))],
            [0, 1].map(|i| row["sums"][i].as_u64()),
            "the same images"
        );
        let near = |what: &str, ours: f64, most: f64| {
            assert!(
                (ours - number(what)).abs() < most,
                "{size:?} {kind} {what}: {ours} against {}",
                number(what)
            );
        };
        near("psnr", psnr(&a, &b).expect("one size"), 1e-9);
        near("ssim", ssim(&a, &b).expect("one size"), 1e-9);
    }
}

#[test]
fn equal_images_have_zero_distance_and_other_sizes_are_refused() {
    let (a, wider) = (drawn(64, 48, 0), drawn(65, 48, 0));
    let distance = PerceptualDistance::open(&data("distance.onnx")).expect("a network");
    assert_eq!(psnr(&a, &a).expect("one size"), f64::INFINITY);
    assert!((ssim(&a, &a).expect("one size") - 1.0).abs() < 1e-12);
    assert_eq!(distance.between(&a, &a).expect("one size"), 0.0);
    for refused in [psnr(&a, &wider), ssim(&a, &wider), distance.between(&a, &wider)] {
        let words = refused.expect_err("two sizes").to_string();
        assert!(words.contains("64x48") && words.contains("65x48"), "{words}");
    }
    let small = drawn(20, 10, 0);
    assert!(ssim(&small, &small).expect_err("small").to_string().contains("must have 11"));
}

#[test]
fn perceptual_distance_inputs_are_scaled_to_unit_range() {
    let distance = PerceptualDistance::open(&data("distance.onnx")).expect("a network");
    let (a, b) = (drawn(40, 30, 0), drawn(40, 30, 2));
    // The network computes the mean squared difference.
    let square = |(x, y): (&u8, &u8)| (f64::from(x.abs_diff(*y)) / 255.0).powi(2);
    let expected = a.data().iter().zip(b.data()).map(square).sum::<f64>() / a.data().len() as f64;
    let found = distance.between(&a, &b).expect("one size");
    assert!((found - expected).abs() < 1e-5 * expected, "{found} {expected}");
}

#[test]
fn classifier_returns_five_likeliest_classes() {
    let classifier = Classifier::open(&data("classifier.onnx")).expect("a network");
    let of = |colour: [u8; 3]| {
        let image = ColourImage::new(50, 40, colour.repeat(50 * 40)).expect("three bytes a pixel");
        classifier.classes(&image).expect("it runs")
    };
    assert_eq!(of([200, 100, 150]), [10, 30, 20, 0, 1]);
    assert_eq!(of([1, 255, 2]), [20, 30, 10, 0, 1]);
    assert_eq!(of([9, 9, 9]), [10, 20, 30, 0, 1], "equal ones by number");
}

#[test]
fn networks_with_other_inputs_are_refused() {
    let swapped =
        PerceptualDistance::open(&data("classifier.onnx")).expect_err("another network").to_string();
    assert!(swapped.contains("classifier.onnx") && swapped.contains("\"distance\""), "{swapped}");
    let swapped = Classifier::open(&data("distance.onnx")).expect_err("another network").to_string();
    assert!(swapped.contains("distance.onnx") && swapped.contains("\"logits\""), "{swapped}");
    let none = Classifier::open(&data("oracle.json")).expect_err("no network").to_string();
    assert!(none.contains("oracle.json"), "{none}");
    assert!(Classifier::open(&data("gone.onnx")).expect_err("no file").to_string().contains("gone.onnx"));
}
