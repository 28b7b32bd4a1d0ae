//! Gaussian blobs at known positions: unbiased position in every octave, proportional scale, mirror symmetry.

use veiloc_features::{Features, GrayImage, SiftOptions, extract_sift};

/// An image of Gaussian blobs `(u, v, sigma)`, the centre of the first pixel at (0.5, 0.5).
fn blobs(width: u32, height: u32, blobs: &[[f64; 3]]) -> GrayImage {
    let mut data = vec![0.2f32; (width * height) as usize];
    for &[u, v, sigma] in blobs {
        for (i, sample) in data.iter_mut().enumerate() {
            let (x, y) = (f64::from(i as u32 % width) + 0.5, f64::from(i as u32 / width) + 0.5);
            let square = (x - u).powi(2) + (y - v).powi(2);
            *sample += 0.6 * (-square / (2.0 * sigma * sigma)).exp() as f32;
        }
    }
    GrayImage::new(width, height, data).expect("finite samples")
}

fn options(upsample: bool) -> SiftOptions {
    let mut options = SiftOptions::default();
    options.upsample = upsample;
    options
}

/// Keypoint nearest to (`u`, `v`): distances along both axes, and its scale.
fn nearest(features: &Features, u: f64, v: f64) -> [f64; 3] {
    let distance = |k: &&veiloc_features::Keypoint| (k.pixel.u - u).hypot(k.pixel.v - v);
    let best = features
        .keypoints
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .expect("a blob is a keypoint");
    [best.pixel.u - u, best.pixel.v - v, f64::from(best.scale)]
}

/// A blob at 64 positions within 4x4 pixels, for one sigma; mean and largest offset, and mean scale relative to sigma.
fn check_offsets(sigma: f64, upsample: bool, largest_allowed: f64) {
    let mut sum = [0.0; 2];
    let mut largest = 0.0f64;
    let mut ratio = 0.0;
    let side = (16.0 * sigma).ceil().max(48.0) as u32 + 5;
    for i in 0..64 {
        let (du, dv) = (f64::from(i % 8) / 2.0 + 0.03, f64::from(i / 8) / 2.0 + 0.17);
        let (u, v) = (f64::from(side) / 2.0 - 2.0 + du, f64::from(side) / 2.0 - 2.0 + dv);
        let features = extract_sift(&blobs(side, side + 3, &[[u, v, sigma]]), &options(upsample));
        let [eu, ev, scale] = nearest(&features, u, v);
        sum = [sum[0] + eu, sum[1] + ev];
        largest = largest.max(eu.hypot(ev));
        ratio += scale / sigma / 64.0;
    }
    let bias = (sum[0] / 64.0).hypot(sum[1] / 64.0);
    assert!(bias < 0.02, "sigma {sigma}, upsample {upsample}: bias {bias} px");
    assert!(largest < largest_allowed, "sigma {sigma}, upsample {upsample}: worst {largest} px");
    assert!((0.8..1.2).contains(&ratio), "sigma {sigma}, upsample {upsample}: scale is {ratio} sigma");
}

#[test]
fn blob_positions_have_no_bias_in_any_octave() {
    // Scales of 1.2, 2, ... pixels belong to octaves 0, 1, 2, 3 of the doubled image.
    for (sigma, largest_allowed) in [(1.2, 0.02), (2.0, 0.02), (4.0, 0.04), (8.0, 0.08)] {
        check_offsets(sigma, true, largest_allowed);
    }
    for (sigma, largest_allowed) in [(2.4, 0.04), (5.0, 0.08)] {
        check_offsets(sigma, false, largest_allowed);
    }
}

#[test]
fn a_mirrored_image_has_mirrored_keypoints() {
    let centres: Vec<[f64; 3]> = (0..12)
        .map(|i| {
            let (column, row) = (f64::from(i % 4), f64::from(i / 4));
            [30.3 + 44.7 * column, 33.6 + 41.2 * row, 1.5 + 0.5 * f64::from(i)]
        })
        .collect();
    // Widths that are not multiples of a power of two.
    let (width, height) = (203, 157);
    let mirrored: Vec<[f64; 3]> = centres.iter().map(|&[u, v, s]| [f64::from(width) - u, v, s]).collect();
    let here = extract_sift(&blobs(width, height, &centres), &options(true));
    let there = extract_sift(&blobs(width, height, &mirrored), &options(true));
    for [u, v, sigma] in centres {
        let [eu, ev, scale] = nearest(&here, u, v);
        let [mu, mv, mirrored_scale] = nearest(&there, f64::from(width) - u, v);
        assert!((eu + mu).abs() < 0.04 * sigma, "blob {sigma}: {eu} against {mu}");
        assert!((ev - mv).abs() < 0.02 * sigma, "blob {sigma}: {ev} against {mv}");
        assert!((scale / mirrored_scale - 1.0).abs() < 0.02, "blob {sigma}: {scale}, {mirrored_scale}");
    }
}

#[test]
fn orientation_is_the_direction_of_the_gradient() {
    // A blob on a ramp: the gradient of the ramp determines the orientation.
    for degrees in [-170.0f64, -90.0, -31.0, 0.0, 45.0, 120.0, 180.0] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let blob = blobs(64, 64, &[[32.3, 31.8, 3.0]]);
        let ramp = |i: usize| 0.01 * (cos * (i % 64) as f64 + sin * (i / 64) as f64) as f32;
        let data = blob.data().iter().enumerate().map(|(i, sample)| 0.3 * sample + ramp(i)).collect();
        let features = extract_sift(&GrayImage::new(64, 64, data).expect("finite"), &options(true));
        let turn = |k: &veiloc_features::Keypoint| {
            let difference = (f64::from(k.orientation).to_degrees() - degrees).rem_euclid(360.0);
            difference.min(360.0 - difference)
        };
        let near = features.keypoints.iter().filter(|k| (k.pixel.u - 32.3).hypot(k.pixel.v - 31.8) < 3.0);
        let best = near.map(turn).fold(f64::INFINITY, f64::min);
        assert!(best < 3.0, "{degrees} degrees: off by {best}");
    }
}
