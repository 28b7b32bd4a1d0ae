//! Against scikit-image and NumPy (`scripts/oracle_judge.py`), on images and weights made by formulas.

use std::path::Path;

use serde_json::Value;
use veiloc_attacks::image_metrics::{FeatureDistance, Lpips, psnr, ssim};
use veiloc_features::ColourImage;
use veiloc_features::learned::{Backbone, Tensor, Weights};
use veiloc_testdata::real_data_test;

/// The script's `drawn`.
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

/// The script's `made_up`.
fn made_up(count: usize, seed: u64, scale: f64) -> Vec<f32> {
    let number = |i: u64| ((i + seed * 7919) * 2_654_435_761 % (1 << 32)) as f64 / (1_u64 << 32) as f64 - 0.5;
    (0..count as u64).map(|i| (number(i) * scale) as f32).collect()
}

/// A kernel `[to, from, side, side]` and its bias.
fn layer(weights: Weights, name: &str, [from, to, side]: [usize; 3], seed: u64) -> Weights {
    let inputs = from * side * side;
    let kernel = made_up(to * inputs, seed, 4.0 / (inputs as f64).sqrt());
    weights
        .with(&format!("{name}.weight"), Tensor { shape: vec![to, from, side, side], data: kernel })
        .with(&format!("{name}.bias"), Tensor { shape: vec![to], data: made_up(to, seed + 100, 0.2) })
}

const ALEX: [(u64, [usize; 3]); 5] =
    [(0, [3, 64, 11]), (3, [64, 192, 5]), (6, [192, 384, 3]), (8, [384, 256, 3]), (10, [256, 256, 3])];

fn lpips() -> Lpips {
    let mut weights = Weights::default();
    let mut linear = Weights::default();
    for (at, (number, sides)) in ALEX.into_iter().enumerate() {
        weights = layer(weights, &format!("features.{number}"), sides, number);
        let data = made_up(sides[1], at as u64 + 1, 2.0).into_iter().map(f32::abs).collect();
        let tensor = Tensor { shape: vec![1, sides[1], 1, 1], data };
        linear = linear.with(&format!("lin{at}.model.1.weight"), tensor);
    }
    Lpips::new(Backbone::alexnet(&weights).expect("of its shape"), &linear).expect("of its shape")
}

fn superpoint() -> Weights {
    let sides = [("1a", 1, 64), ("1b", 64, 64), ("2a", 64, 64), ("2b", 64, 64)];
    let deep = [("3a", 64, 128), ("3b", 128, 128), ("4a", 128, 128), ("4b", 128, 128)];
    let all = sides.into_iter().chain(deep).enumerate();
    all.fold(Weights::default(), |weights, (at, (name, from, to))| {
        layer(weights, &format!("conv{name}"), [from, to, 3], 20 + at as u64)
    })
}

#[test]
fn measures_are_those_of_the_oracle() {
    let rows: Vec<Value> =
        serde_json::from_str(include_str!("../../data/image_metrics/oracle.json")).expect("the script's");
    assert_eq!(rows.len(), 4);
    let lpips = lpips();
    let distance = FeatureDistance::new(&superpoint()).expect("of its shape");
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
        near("lpips_made_up", lpips.between(&a, &b).expect("one size"), 1e-5 * number("lpips_made_up"));
        let ours = distance.between(&a, &b).expect("one size");
        near("feature_distance_made_up", ours, 1e-5);
    }
}

#[test]
fn equal_images_are_equal_and_others_are_refused() {
    let (a, wider) = (drawn(64, 48, 0), drawn(65, 48, 0));
    let (lpips, distance) = (lpips(), FeatureDistance::new(&superpoint()).expect("of its shape"));
    assert_eq!(psnr(&a, &a).expect("one size"), f64::INFINITY);
    assert!((ssim(&a, &a).expect("one size") - 1.0).abs() < 1e-12);
    assert_eq!(lpips.between(&a, &a).expect("one size"), 0.0);
    assert!(distance.between(&a, &a).expect("one size") < 1e-6);
    let refused =
        [psnr(&a, &wider), ssim(&a, &wider), lpips.between(&a, &wider), distance.between(&a, &wider)];
    for refused in refused {
        let words = refused.expect_err("two sizes").to_string();
        assert!(words.contains("64x48") && words.contains("65x48"), "{words}");
    }
    let small = drawn(20, 10, 0);
    assert!(ssim(&small, &small).expect_err("small").to_string().contains("must have 11"));
    assert!(lpips.between(&small, &small).is_err(), "nothing is left of it");
    assert!(
        Backbone::alexnet(&Weights::default()).is_err_and(|e| e.to_string().contains("features.0.weight"))
    );
    let other = Lpips::new(alexnet(), &Weights::default());
    assert!(other.expect_err("no weights").to_string().contains("lin0.model.1.weight"));
}

fn alexnet() -> Backbone {
    let layers = |weights, (number, sides)| layer(weights, &format!("features.{number}"), sides, number);
    Backbone::alexnet(&ALEX.into_iter().fold(Weights::default(), layers)).expect("of its shape")
}

/// The files that users have: LPIPS's own weights fit the networks, and SuperPoint's encoder is read without its heads.
#[real_data_test]
fn real_weights_are_read(data: &Path) {
    let folder = data.join("../weights");
    let linear = Weights::open(&folder.join("lpips/alex.npz")).expect("read");
    let lpips = Lpips::new(alexnet(), &linear).expect("five layers of AlexNet");
    let distance =
        FeatureDistance::open(&folder.join("superpoint/superpoint_v1_encoder_desc.npz")).expect("read");
    let [a, near, far] = [0, 1, 2].map(|kind| drawn(96, 80, kind));
    let of = |other: &ColourImage| {
        [lpips.between(&a, other).expect("one size"), distance.between(&a, other).expect("one size")]
    };
    let (near, far) = (of(&near), of(&far));
    assert!(near[0] > 0.0 && near[0] < far[0], "{near:?} {far:?}");
    assert!(near[1] > 0.0 && near[1] < far[1] && far[1] <= 1.0, "{near:?} {far:?}");
}
